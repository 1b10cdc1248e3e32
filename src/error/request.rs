//! Causes of impossible requests.

use std::path::PathBuf;

use super::Remedy;
use crate::frame::Contradiction;
use crate::image::Extent;
use crate::method::LARGEST_PATCH_RADIUS;
use crate::stage::candidate_filter::MOST_CANDIDATES;
use crate::text;

/// The reason why a request is impossible.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RequestCause {
    /// A parameter cannot have this value.
    #[error("`{name}` cannot be {value}")]
    ParameterValue {
        /// Name of the parameter.
        name: String,
        /// The value, as people write it.
        value: String,
        /// Allowed values.
        rule: String,
    },
    /// Two parameters contradict each other.
    #[error("`first_patch_radius` is {first}, and `second_patch_radius` {second}")]
    PatchRadii {
        /// Patch radius of FIRST in pixels.
        first: u32,
        /// Patch radius of SECOND in pixels.
        second: u32,
    },
    /// There are more candidates than a method can compare.
    #[error("there are {count} candidates")]
    TooManyCandidates {
        /// Number of candidates.
        count: usize,
    },
    /// A number of a candidate filter is out of range, or another candidate has its name.
    #[error("the candidate '{name}' is out of range, or another one has its name")]
    Candidate {
        /// Name of the candidate.
        name: &'static str,
    },
    /// The group that the parameter is in is left out.
    #[error("`{name}` is none where `{group}` is left out")]
    GroupLeftOut {
        /// Name of the parameter.
        name: String,
        /// Name of the group.
        group: String,
    },
    /// The name is that of a group of parameters.
    #[error("`{name}` is a group of parameters")]
    ParameterGroup {
        /// Name of the group.
        name: String,
        /// Names of its parameters.
        members: Vec<String>,
    },
    /// Only other methods have this parameter.
    #[error("`{name}` is no parameter of {method}, but of {}", others.join(" and "))]
    ParameterOfOthers {
        /// Name of the parameter.
        name: String,
        /// Name of the method.
        method: &'static str,
        /// Names of the methods that have it.
        others: Vec<&'static str>,
    },
    /// No method has this parameter.
    #[error("`{name}` is no parameter of {method}")]
    NoSuchParameter {
        /// The unknown name.
        name: String,
        /// Name of the method.
        method: &'static str,
        /// Names of the parameters in the same group.
        names: Vec<String>,
    },
    /// A document of parameters is not TOML.
    #[error("this is not TOML: {reason}")]
    NotToml {
        /// Message of the parser.
        reason: String,
    },
    /// A line of a document of parameters is wrong.
    #[error("line {line}: {cause}")]
    InLine {
        /// The line; 1 is the first.
        line: usize,
        /// Fault in the line.
        cause: Box<RequestCause>,
    },
    /// The method has no filter over several frames.
    #[error("{method} does not filter over several frames")]
    NotInTime {
        /// Name of the method.
        method: &'static str,
    },
    /// The frame to denoise is not in the window.
    #[error("frame {centre} of a window of {frames} frames is to be denoised")]
    NoSuchFrame {
        /// Index of the frame to denoise; 0 is the first.
        centre: usize,
        /// Number of frames in the window.
        frames: usize,
    },
    /// A frame of the window has another extent than the one to denoise.
    #[error("frame {index} of the window is of {extent}, but the one to denoise of {expected}")]
    FrameExtent {
        /// Index of the frame; 0 is the first.
        index: usize,
        /// Extent of that frame.
        extent: Extent,
        /// Extent of the frame to denoise.
        expected: Extent,
    },
    /// A frame of the window has other halves or another variance than the one to denoise.
    #[error("frame {index} of the window does not come with the same halves and variance")]
    FrameNoise {
        /// Index of the frame; 0 is the first.
        index: usize,
    },
    /// A frame of a window on the device has another shape than the one to denoise.
    #[error("a frame of the window has another extent, other halves or other features than the one to denoise")]
    FrameShape,
    /// The colour has another number of channels than three.
    #[error("colour has {channels} channels, not 3")]
    ColorChannels {
        /// Number of channels of the colour.
        channels: usize,
    },
    /// A signal has no pixels.
    #[error("{signal} has no pixels")]
    NoPixels {
        /// The signal.
        signal: String,
    },
    /// The images of a signal have other extents than the colour.
    #[error("the images of {signal} do not all have the extent of the colour, {extent}")]
    ImageExtents {
        /// The signal.
        signal: String,
        /// Extent of the colour.
        extent: Extent,
    },
    /// A plane has another number of values than its extent requires.
    #[error("a plane of {signal} does not have the {} values that its extent of {extent} asks for", extent.pixels())]
    PlaneLength {
        /// The signal.
        signal: String,
        /// Extent of the image.
        extent: Extent,
    },
    /// The images of a layer have different shapes.
    #[error("the images of {layer} do not all have {channels} channels of {values} values")]
    LayerShape {
        /// The layer.
        layer: String,
        /// Number of channels of its mean.
        channels: usize,
        /// Number of pixels.
        values: usize,
    },
    /// A payload layer has no planes, or too many.
    #[error("layer {layer} has {channels} planes, not 1 to 4")]
    PayloadChannels {
        /// Name of the layer.
        layer: String,
        /// Number of planes.
        channels: usize,
    },
    /// The colour has no finite value.
    #[error("layer colour: not one pixel has a usable value{channels}")]
    NoUsableValue {
        /// Names the channels, as in ` in G`; empty for all.
        channels: String,
    },
    /// The noise of the colour is unknown.
    #[error("nothing is known of the colour's noise: {}", noise_reasons(reasons))]
    UnknownNoise {
        /// Reasons why given halves or a given variance are not used. Empty if none were given.
        reasons: Vec<String>,
    },
    /// The sources from which the noise of the colour is known contradict each other.
    #[error("{0}")]
    Contradiction(Contradiction),
    /// The noise of the colour is unknown, and the parameters leave its estimate out.
    #[error("nothing is known of the colour's noise, and the parameters leave out to estimate it")]
    NoiseNotEstimated,
    /// The pixel lies outside of the frame.
    #[error("pixel ({x}, {y}) lies outside of a frame of {extent} pixels")]
    PixelOutside {
        /// Column of the pixel; 0 is the leftmost column.
        x: u32,
        /// Row of the pixel; 0 is the top row.
        y: u32,
        /// Extent of the frame.
        extent: Extent,
    },
    /// The sample counts are not one plane of the frame's extent.
    #[error("the sample counts are not one plane of {extent}")]
    CountsShape {
        /// Extent of the frame.
        extent: Extent,
    },
    /// The number of sample counts differs from the number of pixels of the image.
    #[error("{counts} sample counts do not fit an image of {extent}")]
    CountsLength {
        /// Number of sample counts.
        counts: usize,
        /// Extent of the image.
        extent: Extent,
    },
    /// An odd number of samples cannot be shared out to two halves.
    #[error("{samples} samples in pixel {pixel} cannot be drawn in equal numbers for both halves")]
    OddCount {
        /// Samples of the pixel.
        samples: u32,
        /// Index of the pixel, row by row from the top.
        pixel: usize,
    },
    /// A pixel has more samples than can be counted.
    #[error("a pixel has more than 2^33 samples")]
    TooManySamples,
    /// A signal lacks statistics to which samples could be added.
    #[error("{signal}: there is no {missing}, so that further samples cannot be added")]
    MissingStatistics {
        /// The signal.
        signal: String,
        /// The missing statistics: `half A`, `half B` or `variance`.
        missing: &'static str,
    },
    /// The mean is not the average of the halves.
    #[error(
        "{signal}: the mean is not the average of the halves in {differing} values, so that they are not halves of the \
         same samples"
    )]
    NotHalves {
        /// The signal.
        signal: String,
        /// Number of values in which they differ.
        differing: usize,
    },
    /// Two passes of samples have different extents or features.
    #[error("samples of {other} cannot be added to samples of {own}, or their features differ")]
    PassesDiffer {
        /// Extent of the samples that there are.
        own: Extent,
        /// Extent of the added samples.
        other: Extent,
    },
    /// A budget is not finite or negative.
    #[error("a budget of {samples_per_pixel} samples per pixel cannot be handed out")]
    Budget {
        /// The budget in samples per pixel.
        samples_per_pixel: f64,
    },
    /// The cap does not hold the budget.
    #[error("a budget of {samples_per_pixel} samples per pixel does not fit under a cap of {cap} per pixel")]
    BudgetAboveCap {
        /// The budget in samples per pixel.
        samples_per_pixel: f64,
        /// Largest number of samples of a pixel.
        cap: f64,
    },
    /// An iteration draws more samples than the cap allows.
    #[error("an iteration draws {samples_per_pixel} samples per pixel, more than the cap")]
    IterationAboveCap {
        /// Samples per pixel that the iteration draws.
        samples_per_pixel: u32,
    },
    /// There are no iterations.
    #[error("0 iterations draw nothing")]
    NoIterations,
    /// The samples cannot be shared out to the iterations.
    #[error("{samples_per_pixel} samples per pixel cannot be shared out to {iterations} iterations in whole pairs")]
    IterationShares {
        /// Samples per pixel in all iterations together.
        samples_per_pixel: u32,
        /// Number of iterations.
        iterations: u32,
    },
    /// A feature is given twice.
    #[error("the feature '{}' is given twice", text::name(name))]
    FeatureTwice {
        /// Name of the feature.
        name: String,
    },
    /// Halves or a variance are given for a feature that is not used.
    #[error("halves or a variance are given for the feature '{}', which is not used", text::name(name))]
    NoSuchFeature {
        /// Name of the feature.
        name: String,
    },
    /// More features are given than can be used.
    #[error("{given} features are given, but at most {most} can be used")]
    TooManyFeatures {
        /// Number of given features.
        given: usize,
        /// Largest number of features.
        most: usize,
    },
    /// A layer to read beside the input is the input itself.
    #[error("{} is the input itself", text::path(file))]
    InputItself {
        /// The input.
        file: PathBuf,
    },
    /// A name cannot be written.
    #[error("{what} cannot be written: {reason}")]
    UnusableName {
        /// Kind of the thing with the name, such as `a channel`.
        what: String,
        /// Description of the fault in the name.
        reason: String,
    },
    /// A program calls this library, or a crate around it, in a way that cannot work.
    #[error("{problem}")]
    Misuse {
        /// Cause of the failure.
        problem: String,
        /// Change in the calling program.
        change: &'static str,
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

impl RequestCause {
    /// Returns actions that help the user, the best one first.
    pub fn remedies(&self) -> Vec<Remedy> {
        let choose = |rule: String| Remedy::ChooseValue { rule };
        match self {
            Self::ParameterValue { rule, .. } => vec![choose(rule.clone())],
            Self::PatchRadii { .. } => vec![choose("the patches of FIRST no larger than those of SECOND".into())],
            Self::TooManyCandidates { .. } => vec![choose(format!("at most {MOST_CANDIDATES} candidates"))],
            Self::Candidate { .. } => {
                vec![choose(format!(
                    "k and τ above 0, patches of at most {LARGEST_PATCH_RADIUS} pixels, and a name of its own"
                ))]
            }
            Self::GroupLeftOut { group, .. } => vec![Remedy::TurnOn { group: group.clone() }],
            Self::ParameterGroup { members, .. } => vec![Remedy::ChooseParameter { names: members.clone() }],
            Self::ParameterOfOthers { .. } => vec![Remedy::LeaveOut, Remedy::AnotherMethod],
            Self::NoSuchParameter { names, .. } => {
                vec![Remedy::LeaveOut, Remedy::ChooseParameter { names: names.clone() }]
            }
            Self::NotToml { .. } => vec![Remedy::WriteToml],
            Self::InLine { cause, .. } => cause.remedies(),
            Self::NotInTime { .. } => vec![Remedy::OneFrameAtATime, Remedy::AnotherMethod],
            Self::NoSuchFrame { .. } => vec![Remedy::ChangeCall("count frames from 0")],
            Self::FrameExtent { .. } | Self::FrameNoise { .. } | Self::FrameShape => vec![Remedy::RenderAlike],
            Self::ColorChannels { .. } => vec![Remedy::GiveRgb],
            Self::NoPixels { .. } | Self::ImageExtents { .. } | Self::PlaneLength { .. } | Self::LayerShape { .. } => {
                vec![Remedy::GiveOneExtent]
            }
            Self::PayloadChannels { .. } => vec![Remedy::ChangeCall("split it into layers of up to 4 planes")],
            Self::NoUsableValue { .. } => vec![Remedy::LookAtLayer, Remedy::RenderAgain],
            Self::UnknownNoise { reasons } if reasons.is_empty() => vec![Remedy::GiveHalves, Remedy::GiveVariance],
            Self::UnknownNoise { .. } => vec![Remedy::LookAtHalves, Remedy::RenderHalvesAgain],
            Self::Contradiction(contradiction) => contradiction.remedies(),
            Self::NoiseNotEstimated => vec![Remedy::EstimateNoise, Remedy::GiveHalves, Remedy::GiveVariance],
            Self::PixelOutside { extent, .. } => {
                let (column, row) = (extent.width.saturating_sub(1), extent.height.saturating_sub(1));
                vec![choose(format!("a column from 0 to {column} and a row from 0 to {row}"))]
            }
            Self::CountsShape { .. } | Self::CountsLength { .. } => vec![Remedy::OneCountPerPixel],
            Self::OddCount { .. } => vec![Remedy::EvenCounts],
            Self::TooManySamples => vec![Remedy::StopSampling],
            Self::MissingStatistics { .. } => vec![Remedy::GiveStatistics],
            Self::NotHalves { .. } => vec![Remedy::HalvesOfTheMean],
            Self::PassesDiffer { .. } => vec![Remedy::MergeAlike],
            Self::Budget { .. } => vec![choose("it finite and at least 0".into())],
            Self::BudgetAboveCap { .. } => vec![Remedy::RaiseCap, Remedy::LowerBudget],
            Self::IterationAboveCap { .. } => vec![Remedy::RaiseCap, Remedy::MoreIterations],
            Self::NoIterations => vec![Remedy::MoreIterations],
            Self::IterationShares { iterations, .. } => {
                let least = u64::from(*iterations) * 2;
                vec![choose(format!("an even number of at least {least}")), Remedy::FewerIterations]
            }
            Self::NoSuchFeature { .. } => vec![Remedy::GiveFeatureToo],
            Self::FeatureTwice { .. } => vec![Remedy::GiveFeatureOnce],
            Self::TooManyFeatures { .. } => vec![Remedy::LeaveFeaturesOut],
            Self::InputItself { .. } => vec![Remedy::NameLayerInFile],
            Self::UnusableName { .. } => vec![Remedy::AnotherName],
            Self::Misuse { change, .. } => vec![Remedy::ChangeCall(change)],
            Self::Other { remedy, .. } => vec![Remedy::Other(remedy.clone())],
        }
    }
}

fn noise_reasons(reasons: &[String]) -> String {
    if reasons.is_empty() { "there are neither two halves nor a variance".into() } else { reasons.join("; ") }
}
