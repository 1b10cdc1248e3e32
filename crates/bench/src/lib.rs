//! Error against run time: measures configurations of the denoiser and other programs on buffer sets, writes a report,
//! and compares runs.
//!
//! [`find_sets`] and [`Axes::configurations`] say what is measured; [`Bench`] measures it and reports to an
//! [`Observer`]; [`Folder`] holds the report of a [`Measured`] run; [`RunRatios`] compares two [`Document`]s.

mod compare;
mod configuration;
mod csv_file;
mod error;
mod external;
mod folder;
mod measure;
mod observer;
mod page;
mod plot;
mod results;
mod run;
mod sets;
mod statistics;
mod thumbnail;
mod tile;

pub use compare::{RowRatios, RunRatios, Verdict, read_document};
pub use configuration::{Axes, NoiseAxis, PreparedConfiguration, distinct};
pub use error::{Error, Result};
pub use external::{External, ExternalCause, ExternalEnd, ExternalSyntax};
pub use folder::{Folder, FolderCause};
pub use observer::Observer;
pub use results::{Configuration, Document, Errors, Parameters, Row, SCHEMA, Set, Stage, VERSION, stage_names};
pub use run::{Bench, Measured, Settings};
pub use sets::{SetFile, find_sets};
pub use thumbnail::Gallery;
