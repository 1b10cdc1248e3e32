//! OpenEXR files to buffer sets and back.
//!
//! A [`BufferSet`] holds the layers of the files and their use: the colour, its halves, its variance and its features.
//! Nothing in it is checked for NaN or meaning yet; [`BufferSet::to_frame`] does that.
//!
//! A [`Layout`] says what the layers of a renderer's files are called and what they mean; it is recognised by the file.
//! The native layout: `R G B`, `halfA.*`, `halfB.*`, `variance.*` (sample variance of the mean) and for every feature F
//! `F.*`, `F_halfA.*`, `F_halfB.*`, `F_variance.*`; the samples per pixel in a header attribute or a channel `samples`.
//! One part or many, channels in any order and of any type. Each of these layers can also come from a file of its own,
//! and several renders of a frame with different seeds can be merged: see [`BufferSetRequest`].
//!
//! Wherever an OpenEXR file is read, a PFM or PNG file may stand: a colour without statistics, see [`picture_file`].

mod along;
mod alpha;
mod assign;
pub mod atomic_file;
mod buffer_set;
mod classify;
mod counts;
mod decode;
mod estimate;
mod file;
mod header;
pub mod json_document;
mod layer_ref;
mod layers;
mod layout;
mod map_file;
mod multiplier;
mod names;
#[cfg(feature = "programs")]
pub mod options;
pub mod picture_file;
mod request;
mod samples;
mod seeds;
mod siblings;
mod source;
mod uses;
mod write;

pub use along::{AlphaEncoding, Aovs};
pub use buffer_set::{BufferSet, References, picture_name, read_reference};
pub use estimate::{Written, write_estimate, write_estimates};
pub use layer_ref::{LayerRef, LayerUse, Role, SampleKind, SignalPart, same_file};
pub use layout::{Layout, LayoutUse, Quantity, RecognisedBy, RoleName, Unit};
pub use map_file::MapFile;
pub use request::BufferSetRequest;
pub use samples::write_samples;
pub use write::{DenoisedLayers, NamedLayer, Windows, WriteReport, write_denoised, write_layers, write_layers_in};
