//! Causes that lie in files and their layers.

use std::path::PathBuf;

use super::{Remedy, RequestCause};
use crate::host_memory::Shortage;
use crate::text;

/// The reason why a file cannot be read or written.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FileCause {
    /// The file cannot be read.
    #[error("cannot be read: {reason}")]
    Unreadable {
        /// Message of the system.
        reason: String,
    },
    /// The file is a folder.
    #[error("cannot be read: it is a folder")]
    Folder,
    /// The file is a stream.
    #[error("cannot be read: it is a pipe or a device, in which one cannot go back and forth")]
    Stream,
    /// The file has none of the formats that can be read.
    #[error("is not an OpenEXR file, nor a PFM or PNG file")]
    UnknownFormat,
    /// The file has no bytes.
    #[error("is empty")]
    Empty,
    /// The file contradicts itself or ends too early.
    #[error("is damaged or incomplete: {reason}")]
    Damaged {
        /// Description of the damage and its position.
        reason: String,
    },
    /// The file is valid, but cannot be read here.
    #[error("{what}, which cannot be read here")]
    Unsupported {
        /// Unsupported content of the file, with its verb.
        what: String,
        /// Form in which the file can be read.
        form: &'static str,
    },
    /// A name in the file is longer than the format allows.
    #[error("has a {what} whose name {name} is longer than the {most} bytes that OpenEXR stores")]
    LongName {
        /// Kind of the thing with the name, such as `channel`.
        what: &'static str,
        /// The beginning of the name, for messages.
        name: String,
        /// Length of the longest name in bytes.
        most: usize,
    },
    /// The computer lacks memory for the file's content.
    #[error("cannot be {doing} in memory: that {shortage}")]
    NoMemory {
        /// Purpose of the memory: `held` or `made ready`.
        doing: &'static str,
        /// Needed and free bytes.
        shortage: Shortage,
    },
    /// The file has changed since it was read first.
    #[error("has changed while it was worked on")]
    Changed,
    /// The file cannot be written.
    #[error("cannot be written: {reason}")]
    Unwritable {
        /// Message of the system.
        reason: String,
    },
    /// The compiled pipelines cannot be stored.
    #[error("the compiled pipelines cannot be kept: {reason}")]
    PipelinesNotKept {
        /// Message of the system.
        reason: String,
    },
    /// The file of parameters cannot be read.
    #[error("cannot be read: {reason}")]
    NoParameters {
        /// Message of the system.
        reason: String,
    },
    /// No layer can be the colour.
    #[error("has no colour, that is no channels R, G and B; it holds {layers}")]
    NoColor {
        /// Layers of the file, for messages.
        layers: String,
    },
    /// Several layers can be the colour.
    #[error("has several layers that could be the colour: {layers}")]
    SeveralColors {
        /// Those layers, for messages.
        layers: String,
    },
    /// The file holds several pictures, and layers are given for one of them.
    #[error("holds {pictures} pictures, and it is open which one the given layers belong to")]
    SeveralPictures {
        /// Number of pictures.
        pictures: usize,
    },
    /// The file is not another render of the same frame.
    #[error("is no other seed of {}: {reason}", text::path(of))]
    NotASeed {
        /// The render that it should belong to.
        of: PathBuf,
        /// The difference.
        reason: String,
    },
    /// The file belongs to another frame or view than the input.
    #[error("does not belong to {}: {reason}", text::path(of))]
    OtherFrame {
        /// The input.
        of: PathBuf,
        /// The difference.
        reason: String,
    },
    /// A feature to skip is not in the file.
    #[error("there is no feature '{}' to skip; it holds {layers}", text::name(name))]
    NoFeatureToSkip {
        /// Name of the feature.
        name: String,
        /// Layers of the file, for messages.
        layers: String,
    },
    /// A layer to filter along with the colour is not in the file.
    #[error("there is no layer '{}' to denoise along with the colour; it holds {layers}", text::name(name))]
    NoLayerAlong {
        /// Name of the layer.
        name: String,
        /// Layers of the file, for messages.
        layers: String,
    },
    /// The file does not say how many samples its pixels have.
    #[error("does not say how many samples its pixels have, so that further samples cannot be added")]
    NoSampleCounts,
    /// A pixel has another number of samples than two equal halves.
    #[error("has {samples} samples in some pixel, which are not two equal halves")]
    UnevenSamples {
        /// Number of samples of the pixel.
        samples: f32,
    },
    /// The file is not a sampling map.
    #[error("has no layer 'samples' that says how many samples to draw; its layers are {layers}")]
    NoMap {
        /// Layers of the file, for messages.
        layers: String,
    },
    /// A request that concerns the file's content is impossible.
    #[error("{0}")]
    Request(Box<RequestCause>),
    /// A defect of a crate around the library.
    #[error("{problem}")]
    Defect {
        /// Cause of the failure.
        problem: String,
        /// Information that helps to find the defect.
        with: &'static str,
    },
    /// A failure of a program or a crate around the library, in its own words.
    #[error("{problem}")]
    Other {
        /// Cause of the failure.
        problem: String,
        /// Action that helps the user.
        remedy: String,
    },
}

impl FileCause {
    /// Returns actions that help the user, the best one first.
    pub fn remedies(&self) -> Vec<Remedy> {
        match self {
            Self::Unreadable { .. } => vec![Remedy::CheckPath],
            Self::Folder => vec![Remedy::NameFileInFolder],
            Self::Stream => vec![Remedy::WriteToFile],
            Self::UnknownFormat => vec![Remedy::GiveKnownFormat],
            Self::Empty | Self::Damaged { .. } => vec![Remedy::WriteAgain],
            Self::Unsupported { form, .. } => vec![Remedy::WriteAs { form }],
            Self::LongName { .. } => vec![Remedy::WriteAs { form: "under a shorter name" }],
            Self::NoMemory { .. } => Remedy::MORE_HOST_MEMORY.to_vec(),
            Self::Changed => vec![Remedy::LeaveInputAlone],
            Self::Unwritable { .. } => vec![Remedy::CheckFolder],
            Self::PipelinesNotKept { .. } => vec![Remedy::PipelineFolder],
            Self::NoParameters { .. } => vec![Remedy::NameParameters],
            Self::NoColor { .. } => vec![Remedy::WriteAs { form: "with channels R, G and B" }, Remedy::NameLayer],
            Self::SeveralColors { .. } => vec![Remedy::NameLayer],
            Self::SeveralPictures { .. } => vec![Remedy::NameLayer],
            Self::OtherFrame { .. } => vec![Remedy::RenderAlike],
            Self::NotASeed { .. } => vec![Remedy::GiveSeedsOfOneFrame],
            Self::NoFeatureToSkip { .. } => vec![Remedy::NameFeatureToSkip],
            Self::NoLayerAlong { .. } => vec![Remedy::NameLayersAlong],
            Self::NoSampleCounts => vec![Remedy::WriteSampleCounts],
            Self::UnevenSamples { .. } => vec![Remedy::EvenCounts],
            Self::NoMap { .. } => vec![Remedy::GiveMap],
            Self::Request(cause) => cause.remedies(),
            Self::Defect { with, .. } => vec![Remedy::ReportDefect { with }],
            Self::Other { remedy, .. } => vec![Remedy::Other(remedy.clone())],
        }
    }
}

/// The reason why a layer is missing or cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LayerCause {
    /// The file has no such layer.
    #[error("there is no such layer; the file holds {layers}")]
    Missing {
        /// Layers of the file with similar names, for messages.
        layers: String,
    },
    /// The layer is no colour.
    #[error("it has no channels R, G and B; the file holds {layers}")]
    NoColor {
        /// Layers of the file, for messages.
        layers: String,
    },
    /// The layer has too many channels for a feature.
    #[error("a feature has one to three channels, this has {channels}")]
    FeatureChannels {
        /// Number of channels of the layer.
        channels: usize,
    },
    /// The layer covers other pixels than the colour.
    #[error("its data window is {found}, but the colour's in {} is {expected}", text::path(color_file))]
    DataWindow {
        /// Data window of the layer, for messages.
        found: String,
        /// Data window of the colour, for messages.
        expected: String,
        /// File of the colour.
        color_file: PathBuf,
    },
    /// The layer has another resolution than the colour.
    #[error("it has another resolution: its whole picture is {found}, and the colour's {expected}")]
    Resolution {
        /// Extent of the layer's display window, or of the layer, for messages.
        found: String,
        /// Extent of the colour's display window, or of the colour, for messages.
        expected: String,
    },
    /// A half or a variance has other channels than its layer.
    #[error("its channels do not match those of the layer that it belongs to, '{of}'")]
    CompanionChannels {
        /// Name of the layer that it belongs to.
        of: String,
    },
    /// A quantity needs the number of samples, which nothing tells.
    #[error("it is a {quantity}, and nothing says how many samples a pixel has")]
    NeedsSamples {
        /// The quantity, such as `variance of one sample`.
        quantity: String,
    },
    /// The layer is easily mistaken for a variance.
    #[error("it is {why}")]
    NotAVariance {
        /// What it is instead.
        why: String,
    },
    /// A half has no other half.
    #[error("it is one half of the samples, but half {missing} is missing")]
    SingleHalf {
        /// The missing half: `A` or `B`.
        missing: char,
    },
    /// The layer cannot be filtered along with the colour.
    #[error("it cannot be denoised along with the colour: {why}")]
    NotAlong {
        /// The reason.
        why: &'static str,
    },
    /// Sample counts are not whole and even.
    #[error("holds numbers that are not whole and even")]
    UnevenCounts,
    /// Planes to write have another shape than the layer.
    #[error("{problem}")]
    PlanesDoNotFit {
        /// Both shapes.
        problem: String,
    },
    /// A channel cannot be written under this name.
    #[error("{reason}")]
    UnusableName {
        /// Description of the fault in the name.
        reason: String,
    },
}

impl LayerCause {
    /// Returns actions that help the user, the best one first.
    pub fn remedies(&self) -> Vec<Remedy> {
        match self {
            Self::Missing { .. } => vec![Remedy::NameListedLayer],
            Self::NoColor { .. } => vec![Remedy::NameLayer],
            Self::FeatureChannels { .. } => vec![Remedy::SplitFeature],
            Self::Resolution { .. } => vec![Remedy::RenderAlike],
            Self::DataWindow { .. } => vec![Remedy::RenderAlike, Remedy::SkipFeature],
            Self::CompanionChannels { .. } => vec![Remedy::MatchChannels],
            Self::NeedsSamples { .. } => vec![Remedy::GiveSamples],
            Self::NotAVariance { .. } => vec![Remedy::GiveVariance],
            Self::SingleHalf { missing } => vec![Remedy::GiveOtherHalf { half: *missing }],
            Self::NotAlong { .. } => vec![Remedy::NameLayersAlong],
            Self::UnevenCounts => vec![Remedy::EvenCounts],
            Self::PlanesDoNotFit { .. } => {
                vec![Remedy::ChangeCall("give planes of the input's extent, one for each channel")]
            }
            Self::UnusableName { .. } => vec![Remedy::AnotherName],
        }
    }
}
