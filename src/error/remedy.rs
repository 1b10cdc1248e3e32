//! Remedies: actions that help the user.

use std::fmt;

use crate::gpu::AdapterSummary;

/// An action that helps the user. It displays in the words of this library; programs render the actions for which they
/// have other words, such as an option.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "remedies", derive(strum::EnumIter))]
#[non_exhaustive]
pub enum Remedy {
    /// Allow more of the device's memory.
    RaiseMemoryLimit,
    /// Allow less of the device's memory, so that the image is processed in smaller pieces.
    LowerMemoryLimit,
    /// Choose a smaller window.
    SmallerWindow,
    /// Denoise with fewer frames beside the one.
    FewerFramesBeside,
    /// Leave features out.
    LeaveFeaturesOut,
    /// Crop the image.
    CropImage,
    /// Cut the image into pieces.
    CutImage,
    /// Choose another adapter.
    AnotherAdapter,
    /// Choose one of the computer's adapters.
    ChooseAdapter {
        /// All adapters of the computer.
        adapters: Vec<AdapterSummary>,
    },
    /// Install a driver.
    InstallDriver,
    /// Update the driver.
    UpdateDriver,
    /// Close programs that use the adapter.
    CloseGraphicsPrograms,
    /// Close programs.
    ClosePrograms,
    /// Raise the system's limit on the memory of a process.
    RaiseSystemLimit,
    /// Use a computer with more memory.
    MoreMemory,
    /// Leave layers of the file out.
    LeaveLayersOut,
    /// Run again.
    RunAgain,
    /// Report a defect.
    ReportDefect {
        /// Information that helps to find the defect.
        with: &'static str,
    },
    /// Have a writable folder for compiled pipelines, or none.
    PipelineFolder,
    /// Change the program that calls this library. No user of a program can do this.
    ChangeCall(&'static str),

    /// Choose a value that is allowed.
    ChooseValue {
        /// Allowed values.
        rule: String,
    },
    /// Choose one of these parameters.
    ChooseParameter {
        /// Names of the parameters.
        names: Vec<String>,
    },
    /// Turn on the group that a parameter is in.
    TurnOn {
        /// Name of the group.
        group: String,
    },
    /// Leave a parameter out.
    LeaveOut,
    /// Write the parameters as TOML.
    WriteToml,
    /// Name a file of parameters.
    NameParameters,
    /// Choose another method.
    AnotherMethod,
    /// Denoise frames one by one.
    OneFrameAtATime,
    /// Turn on the estimate of the noise from the image itself.
    EstimateNoise,

    /// Render and give two halves.
    GiveHalves,
    /// Render and give a variance.
    GiveVariance,
    /// Say what kind of quantity a variance is.
    SayQuantity {
        /// The quantity that it is, as layouts spell it, such as `variance of one sample`.
        quantity: &'static str,
    },
    /// Give the image as it was before any filter.
    GiveUnfiltered,
    /// Find out what is wrong with a layer.
    LookAtLayer,
    /// Find out what is wrong with the halves and the variance.
    LookAtHalves,
    /// Render the layer again.
    RenderAgain,
    /// Render both halves again.
    RenderHalvesAgain,
    /// Render all frames or layers alike.
    RenderAlike,
    /// Give images of one extent and the same channels.
    GiveOneExtent,
    /// Give red, green and blue.
    GiveRgb,
    /// Give a count for each pixel.
    OneCountPerPixel,
    /// Give even sample counts.
    EvenCounts,
    /// Give halves and variance of all signals.
    GiveStatistics,
    /// Give the halves of the same samples.
    HalvesOfTheMean,
    /// Merge passes over the same image with the same features.
    MergeAlike,
    /// Draw no more samples.
    StopSampling,
    /// Raise the cap on the samples of a pixel.
    RaiseCap,
    /// Lower the budget of samples.
    LowerBudget,
    /// Ask for more iterations.
    MoreIterations,
    /// Ask for fewer iterations.
    FewerIterations,

    /// Name the layer to take.
    NameLayer,
    /// Name one of the layers that the message lists.
    NameListedLayer,
    /// Name a layer behind the file.
    NameLayerInFile,
    /// Add the half that is missing.
    GiveOtherHalf {
        /// The missing half: `A` or `B`.
        half: char,
    },
    /// Give companions the channels of their layer, or another name.
    MatchChannels,
    /// Leave a feature out.
    SkipFeature,
    /// Name a feature that the file has among those to skip.
    NameFeatureToSkip,
    /// Name layers that can be filtered along with the colour, or none.
    NameLayersAlong,
    /// Give each feature once.
    GiveFeatureOnce,
    /// Give the feature, too.
    GiveFeatureToo,
    /// Say how many samples a pixel has.
    GiveSamples,
    /// Give renders of one frame with different seeds.
    GiveSeedsOfOneFrame,
    /// Split a layer into several features.
    SplitFeature,
    /// Choose another name.
    AnotherName,
    /// Have the renderer write the number of samples.
    WriteSampleCounts,
    /// Give a sampling map.
    GiveMap,
    /// Name a file in the folder.
    NameFileInFolder,
    /// Write a stream to a file.
    WriteToFile,
    /// Check path, permissions and disk.
    CheckPath,
    /// Check that the folder exists and can be written to.
    CheckFolder,
    /// Render or copy a file again.
    WriteAgain,
    /// Give a file in a format that can be read.
    GiveKnownFormat,
    /// Write the file in a form that can be read.
    WriteAs {
        /// The form.
        form: &'static str,
    },
    /// Leave the input as it is while it is worked on.
    LeaveInputAlone,

    /// An action in the words of a program or a crate around the library.
    Other(String),
}

impl Remedy {
    /// Actions against a lack of memory in the computer.
    pub const MORE_HOST_MEMORY: [Self; 5] =
        [Self::CropImage, Self::LeaveLayersOut, Self::RaiseSystemLimit, Self::ClosePrograms, Self::MoreMemory];

    /// Returns a remedy of each variant, with empty data: for tests that a program has words for all of them.
    #[cfg(feature = "remedies")]
    pub fn all() -> impl Iterator<Item = Self> {
        <Self as strum::IntoEnumIterator>::iter()
    }
}

impl fmt::Display for Remedy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::RaiseMemoryLimit => "raise the memory limit (`Denoiser::with_max_memory`)",
            Self::LowerMemoryLimit => "lower the memory limit (`Denoiser::with_max_memory`)",
            Self::SmallerWindow => "choose a smaller window",
            Self::FewerFramesBeside => "give fewer frames beside",
            Self::LeaveFeaturesOut => "leave features out",
            Self::CropImage => "crop the image",
            Self::CutImage => "cut the image into pieces and denoise each",
            Self::AnotherAdapter => "choose another adapter (`Gpu::adapters` lists them)",
            Self::ChooseAdapter { adapters } => {
                f.write_str("choose one of these:")?;
                return adapters.iter().try_for_each(|adapter| write!(f, "\n    {adapter}"));
            }
            Self::InstallDriver => {
                "install a Vulkan driver for your graphics card, or a software one (Debian, Ubuntu: `apt-get install \
                 mesa-vulkan-drivers`; scripts/setup.sh does it)"
            }
            Self::UpdateDriver => "update the graphics driver",
            Self::CloseGraphicsPrograms => "close other programs that use the graphics card",
            Self::ClosePrograms => "close other programs",
            Self::RaiseSystemLimit => "raise the limit on memory where there is one (`ulimit -v`)",
            Self::MoreMemory => "use a computer with more memory",
            Self::LeaveLayersOut => "leave layers out",
            Self::RunAgain => "run again",
            Self::ReportDefect { with } => return write!(f, "report this defect of stein with {with}"),
            Self::PipelineFolder => "have `GpuOptions::pipeline_folder` name a folder that may be written to, or none",
            Self::ChangeCall(change) => change,

            Self::ChooseValue { rule } => return write!(f, "choose {rule}"),
            Self::ChooseParameter { names } => return write!(f, "choose one of {}", names.join(", ")),
            Self::TurnOn { group } => return write!(f, "make `{group}` true before"),
            Self::LeaveOut => "leave it out",
            Self::WriteToml => "write it like `window_radius = 10`",
            Self::NameParameters => "name a TOML file of parameters, such as `stein params -o FILE` writes",
            Self::AnotherMethod => "choose another method",
            Self::OneFrameAtATime => "give it one frame at a time",
            Self::EstimateNoise => "set `pooled_variance`",

            Self::GiveHalves => "render twice with different seeds and give both as halves, their average as the input",
            Self::GiveVariance => "let the renderer write the variance of the pixel mean, as layer `variance`",
            Self::SayQuantity { quantity } => return write!(f, "say that it is a {quantity}"),
            Self::GiveUnfiltered => "give the image before any filter",
            Self::LookAtLayer => "look at the layer in an image viewer",
            Self::LookAtHalves => "look at the halves and the variance in an image viewer",
            Self::RenderAgain => "render it again",
            Self::RenderHalvesAgain => "render both halves again, with different seeds and the same number of samples",
            Self::RenderAlike => "render all alike, with the same resolution, crop, halves and features",
            Self::GiveOneExtent => "give all images the same extent, and a layer's images the same channels",
            Self::GiveRgb => "give its planes R, G and B; of a luminance the same plane three times",
            Self::OneCountPerPixel => "give one count for each pixel",
            Self::EvenCounts => "give even sample counts, half of them for each half buffer",
            Self::GiveStatistics => {
                "give both halves and the sample variance of the mean for the colour and every feature"
            }
            Self::HalvesOfTheMean => "give the halves that the mean was made of",
            Self::MergeAlike => "merge passes over the same image with the same features",
            Self::StopSampling => "stop here",
            Self::RaiseCap => "raise the cap",
            Self::LowerBudget => "lower the budget",
            Self::MoreIterations => "ask for more iterations",
            Self::FewerIterations => "ask for fewer iterations",

            Self::NameLayer => "name the layer to take",
            Self::NameListedLayer => "name one of these, without the channel's last letter",
            Self::NameLayerInFile => "name a layer in it: FILE::LAYER",
            Self::GiveOtherHalf { half } => return write!(f, "add half {half}"),
            Self::MatchChannels => "write both with the same channels, or rename it if it is something else",
            Self::SkipFeature => "leave the feature out",
            Self::NameFeatureToSkip => "name one of these, or none",
            Self::NameLayersAlong => "name other layers, or none",
            Self::GiveFeatureOnce => "give each feature once, or under different names",
            Self::GiveFeatureToo => "give the feature itself, too, or its name as it is listed",
            Self::GiveSamples => "say how many samples a pixel has",
            Self::GiveSeedsOfOneFrame => "give renders of one frame and one view that differ in their seeds alone",
            Self::SplitFeature => "split it into several features",
            Self::AnotherName => "choose another name",
            Self::WriteSampleCounts => "let the renderer write a header attribute or a channel `samples`",
            Self::GiveMap => "give a sampling map, as `stein sample-map` writes it",
            Self::NameFileInFolder => "name a file in it",
            Self::WriteToFile => "write it to a file first",
            Self::CheckPath => "check the path, its permissions and the disk",
            Self::CheckFolder => "check that the folder exists, may be written to and has space left",
            Self::WriteAgain => {
                "render or copy it again; check whether the disk was full or the writer was interrupted"
            }
            Self::GiveKnownFormat => "give an .exr, .pfm or .png file, or convert the image to OpenEXR first",
            Self::WriteAs { form } => return write!(f, "write it {form}"),
            Self::LeaveInputAlone => "write to another file, or start again when the input is complete",

            Self::Other(action) => action,
        })
    }
}

/// Joins remedies of which each helps alone: `a, b, or c`.
pub(super) fn alternatives(remedies: &[String]) -> String {
    match remedies {
        [first @ .., last] if !first.is_empty() => format!("{}, or {last}", first.join(", ")),
        remedies => remedies.concat(),
    }
}
