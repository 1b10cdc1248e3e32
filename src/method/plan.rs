//! The steps of a method that a frame needs. They are decided before anything runs, from the parameters, the requested
//! results and a look at the frame.
//!
//! A method asks its plan at every step, so that the plan is what happens and not a description beside it.

use glam::IVec2;
use serde::{Serialize, Serializer};

use super::frame::Units;
use super::noise::{POOLING_RADIUS, Pooling};
use super::{GpuFrame, GpuSignal, Intermediate};
use crate::frame::{Feature, Frame, NoiseTiles, TILE};
use crate::gpu::Recorder;
use crate::stage::exact::ExactTiles;
use crate::stage::variance::INPUT_SMOOTHING;

/// The steps of a method in their order, those that run and those that are left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// In the order of the method.
    pub steps: Vec<PlannedStep>,
    /// Intermediates to keep.
    #[serde(skip)]
    pub keep: Vec<Intermediate>,
    /// Strips that the image is cut into; 1 where it fits as a whole.
    pub strips: usize,
    /// Time to look at the frames, in seconds on the host.
    pub analysis_seconds: f64,
}

/// One step of a plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedStep {
    /// The step.
    pub step: Step,
    /// Whether it runs.
    pub runs: bool,
    /// Reason to run it, or to leave it out.
    pub why: String,
    /// Share of the pixels that skip it, 0 to 1; 1 if it does not run.
    pub skipped: f64,
    /// Tiles that skip it.
    #[serde(skip)]
    exact: Option<ExactTiles>,
}

/// A step of a method. Times are listed under the name of the step
/// ([`Gpu::step_timings`](crate::gpu::Gpu::step_timings)).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// Variances that the frame lacks, estimated; given ones, pooled.
    Noise,
    /// Spikes taken out of the colour.
    Spikes,
    /// The variance of the colour's mean as the filters want it (thesis 8.2).
    Variance,
    /// Use of a feature. Listed if the feature is not used.
    Feature(String),
    /// Prefiltering of a feature (Algorithm 1 lines 4 to 10).
    Prefilter(String),
    /// Gradients of the features, and their packing.
    Features,
    /// The filters that the result is chosen from, over all frames of the window.
    Candidates,
    /// One of the candidates.
    Candidate(&'static str),
    /// Derivatives of the candidates.
    Derivatives,
    /// Half spreads of the candidates.
    HalfSpread,
    /// All three channels of the colour; without it one channel stands for all.
    Channels,
    /// The candidates over the own frame alone as well; frames beside are left out of pixels that they harm.
    Frames,
    /// SURE of the candidates (eq. 8.5).
    Sure,
    /// Smoothing of SURE (lines 18 to 22).
    SureSmoothing,
    /// Binary selection maps (lines 23 to 26).
    Selection,
    /// Smoothing of the selection maps (lines 27 to 31).
    SelectionSmoothing,
    /// Averaging of the candidates (lines 32 and 33).
    Blend,
    /// Sampling density: where the next samples reduce the error most (thesis 8.6).
    Density,
    /// The filter of the noise that pass 1 leaves (lines 34 to 37).
    SecondPass,
    /// Halves to be filtered by each other (thesis 7.1.1).
    Halves,
    /// The filter of NLM.
    Filter,
    /// The filter of NLM over the own frame alone, to judge the frames beside by.
    FilterAlone,
    /// The estimated error of the result.
    Error,
    /// The scales of GEM and their choice (thesis 6.2).
    Scales,
    /// Pixels without noise put back.
    KeepClean,
    /// A filter by the colour only, where features are without noise.
    ColorOnly,
}

impl Step {
    /// Name that users read.
    pub fn name(&self) -> String {
        let name = match self {
            Self::Feature(name) => return format!("feature {name}"),
            Self::Prefilter(name) => return format!("prefilter {name}"),
            Self::Candidate(name) => name,
            Self::Noise => "noise",
            Self::Spikes => "spikes",
            Self::Variance => "variance",
            Self::Features => "features",
            Self::Candidates => "candidates",
            Self::Derivatives => "derivatives",
            Self::HalfSpread => "half spread",
            Self::Channels => "three channels",
            Self::Frames => "frames that harm",
            Self::Sure => "SURE",
            Self::SureSmoothing => "SURE smoothing",
            Self::Selection => "selection",
            Self::SelectionSmoothing => "selection smoothing",
            Self::Blend => "blend",
            Self::Density => "sampling density",
            Self::SecondPass => "second pass",
            Self::Halves => "halves",
            Self::Filter => "filter",
            Self::FilterAlone => "filter over one frame",
            Self::Error => "error",
            Self::Scales => "scales",
            Self::KeepClean => "clean pixels",
            Self::ColorOnly => "colour only",
        };
        name.to_owned()
    }

    /// Whether [`kernels`](super::kernels) depend on it. If it is left out, that explains why a filter is missing, or
    /// why a feature does not separate neighbours.
    pub fn makes_kernels(&self) -> bool {
        match self {
            Self::Noise | Self::Spikes | Self::Variance | Self::Feature(_) | Self::Prefilter(_) | Self::Features => {
                true
            }
            Self::Candidates
            | Self::Candidate(_)
            | Self::ColorOnly
            | Self::SecondPass
            | Self::Halves
            | Self::Filter
            | Self::Scales => true,
            Self::Derivatives | Self::HalfSpread | Self::Channels | Self::Frames | Self::FilterAlone => false,
            Self::Sure
            | Self::SureSmoothing
            | Self::Selection
            | Self::SelectionSmoothing
            | Self::Blend
            | Self::Density
            | Self::Error
            | Self::KeepClean => false,
        }
    }
}

impl Serialize for Step {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.name())
    }
}

impl Plan {
    fn find(&self, step: &Step) -> Option<&PlannedStep> {
        self.steps.iter().find(|planned| planned.step == *step)
    }

    /// Whether a step runs.
    pub fn runs(&self, step: &Step) -> bool {
        self.find(step).is_some_and(|planned| planned.runs)
    }

    /// Tiles that skip a step that runs.
    pub(super) fn exact(&self, step: &Step) -> Option<&ExactTiles> {
        self.find(step)?.exact.as_ref()
    }

    /// The plan for a part of the frame that begins at pixel `first`.
    pub(crate) fn starting_at(&self, first: IVec2) -> Self {
        let moved = |planned: &PlannedStep| PlannedStep {
            exact: planned.exact.as_ref().map(|exact| exact.starting_at(first)),
            ..planned.clone()
        };
        Self { steps: self.steps.iter().map(moved).collect(), ..self.clone() }
    }

    /// Begins a step if it runs. Later dispatches belong to this step.
    pub(super) fn begins(&self, rec: &mut Recorder, step: Step) -> bool {
        let runs = self.runs(&step);
        if runs {
            rec.begin_step(&step.name());
        }
        runs
    }

    /// Whether no step runs, so that the frame is the result.
    pub(crate) fn copies_the_frame(&self) -> bool {
        self.steps.iter().all(|planned| !planned.runs)
    }
}

/// Least share of exact tiles for which a filter skips them.
const LEAST_SHARE: f64 = 0.05;

/// Facts about a window of frames, found before anything runs.
#[derive(Clone, Debug)]
pub(crate) struct Facts {
    pub(super) has_halves: bool,
    pub(super) has_sample_variance: bool,
    /// Frames beside the one to denoise.
    pub(super) beside: usize,
    /// Tiles in which the colour of any frame has noise. `None` for frames that stay on the device.
    pub(super) noise: Option<NoiseTiles>,
    /// Whether all channels of the colour are equal, in all frames.
    pub(super) grey: bool,
    /// Tiles in a row.
    tile_columns: usize,
    /// The features that are used, in their order.
    pub(super) features: Vec<FeatureFacts>,
    /// Names of the features that are not used, and the reasons.
    pub(super) unused_features: Vec<(String, &'static str)>,
}

#[derive(Clone, Debug)]
pub(super) struct FeatureFacts {
    pub(super) name: String,
    /// Whether halves or a variance tell of its noise.
    pub(super) noise_is_told: bool,
    /// Whether it has a sample variance, so that a pixel without noise has the variance 0.
    has_sample_variance: bool,
    /// Tiles in which it has noise in any frame. `None` for frames that stay on the device.
    noise: Option<NoiseTiles>,
}

impl FeatureFacts {
    /// No pixel has noise.
    pub(super) fn is_noise_free(&self) -> bool {
        self.noise.as_ref().is_some_and(|noise| !noise.any())
    }
}

impl Facts {
    /// Analyses a window of frames; `frames[centre]` is the frame to denoise.
    pub(crate) fn of_window(frames: &[&Frame], centre: usize, units: &Units, with_features: bool) -> Self {
        let frame = frames[centre];
        let features = units.features.iter().map(|feature| {
            let in_all_frames = || {
                frames
                    .iter()
                    .flat_map(|frame| frame.features())
                    .filter(|other| other.name == feature.name)
                    .map(|other| &other.signal)
            };
            FeatureFacts {
                name: feature.name.clone(),
                noise_is_told: in_all_frames().any(|signal| signal.noise_knowledge().is_some()),
                has_sample_variance: in_all_frames().all(|signal| signal.variance_of_mean.is_some()),
                noise: NoiseTiles::of_all(in_all_frames()),
            }
        });
        let constant = frame.constant_features().iter().map(|name| (name.clone(), "it is the same everywhere"));
        let is_used = |feature: &Feature| units.features.iter().any(|used| used.name == feature.name);
        let all_tell = frames.iter().all(|frame| frame.color().noise_knowledge().is_some());
        let lacking = frame.features().iter().filter(|feature| !is_used(feature));
        let lacking =
            lacking.map(|feature| (feature.name.clone(), "a frame beside lacks it, or has it the same everywhere"));
        Self {
            has_halves: frame.color().half_spread.is_some(),
            has_sample_variance: frame.color().variance_of_mean.is_some(),
            beside: frames.len() - 1,
            noise: NoiseTiles::of_all(frames.iter().map(|frame| frame.color())).filter(|_| all_tell),
            grey: frames.iter().all(|frame| frame.color().is_grey()),
            tile_columns: (frame.extent().width as usize).div_ceil(TILE),
            features: features.collect(),
            unused_features: if with_features { constant.chain(lacking).collect() } else { Vec::new() },
        }
    }

    /// Facts about frames that a renderer keeps on the device. Their pixels are unknown, so every step that might be
    /// needed counts as needed.
    pub(crate) fn of_gpu_frame(frame: &GpuFrame, beside: usize, with_features: bool) -> Self {
        let told = |signal: &GpuSignal| signal.has_halves || signal.variance_of_mean.is_some();
        let features = frame.features.iter().filter(|_| with_features).map(|feature| FeatureFacts {
            name: feature.name.clone(),
            noise_is_told: told(&feature.signal),
            has_sample_variance: feature.signal.variance_of_mean.is_some(),
            noise: None,
        });
        Self {
            has_halves: frame.color.has_halves,
            has_sample_variance: frame.color.variance_of_mean.is_some(),
            beside,
            noise: None,
            grey: false,
            tile_columns: 0,
            features: features.collect(),
            unused_features: Vec::new(),
        }
    }
}

impl Facts {
    /// No pixel of any frame has noise.
    pub(super) fn is_noise_free(&self) -> bool {
        self.noise.as_ref().is_some_and(|noise| !noise.any())
    }

    /// Whether the colour's noise is known from nothing but the image.
    pub(super) fn is_image_only(&self) -> bool {
        !self.has_halves && !self.has_sample_variance
    }

    /// Whether the colour, or a feature with noise, has no sample variance. Features are judged beside the colour's
    /// halves.
    pub(super) fn lacks_variance(&self) -> bool {
        let features_lack =
            || self.features.iter().any(|feature| feature.noise_is_told && !feature.has_sample_variance);
        !self.has_sample_variance || self.has_halves && features_lack()
    }

    /// Tiles around which the colour has no noise, as far as a filter reaches, in pixels.
    pub(super) fn exact_color(&self, reach: u32) -> Option<ExactTiles> {
        self.exact(self.noise.as_ref(), self.has_sample_variance, reach)
    }

    /// Tiles around which a feature has no noise, as far as a filter reaches, in pixels.
    pub(super) fn exact_feature(&self, feature: &FeatureFacts, reach: u32) -> Option<ExactTiles> {
        self.exact(feature.noise.as_ref(), feature.has_sample_variance, reach)
    }

    /// Without a sample variance, the variance is pooled or smoothed, and reaches further than the noise. Returns
    /// `None` where so few tiles are exact that skipping them saves nothing.
    fn exact(&self, noise: Option<&NoiseTiles>, has_sample_variance: bool, reach: u32) -> Option<ExactTiles> {
        let smoothing = if has_sample_variance { 0 } else { INPUT_SMOOTHING.radius.max(POOLING_RADIUS) };
        let exact = ExactTiles::new(noise?.exact((reach + smoothing) as usize), self.tile_columns, TILE);
        Some(exact).filter(|exact| exact.share() >= LEAST_SHARE)
    }
}

/// Results that a caller asks a method for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wishes<'a> {
    /// Intermediates to keep.
    pub(crate) keep: &'a [Intermediate],
    /// Whether to estimate the error.
    pub(crate) error: bool,
    /// Whether to run the steps that the frame does not need.
    pub(crate) everything: bool,
}

impl Wishes<'_> {
    pub(super) fn keeps(&self, intermediate: Intermediate) -> bool {
        self.keep.contains(&intermediate)
    }
}

/// A reason to leave a step out, if it holds.
pub(super) struct Unless {
    holds: bool,
    why: &'static str,
    /// Runs under `with_everything`.
    could_run: bool,
}

/// The step has no input, or its result is not requested.
pub(super) fn impossible(holds: bool, why: &'static str) -> Unless {
    Unless { holds, why, could_run: false }
}

/// The step would change nothing.
pub(super) fn needless(holds: bool, why: &'static str) -> Unless {
    Unless { holds, why, could_run: true }
}

/// Puts a plan together, step by step.
pub(super) struct Planner {
    everything: bool,
    keep: Vec<Intermediate>,
    steps: Vec<PlannedStep>,
}

impl Planner {
    pub(super) fn new(wishes: &Wishes) -> Self {
        Self { everything: wishes.everything, keep: wishes.keep.to_vec(), steps: Vec::new() }
    }

    /// Adds a step that runs because of a reason, unless one of the other reasons holds. Returns whether it runs.
    pub(super) fn step(&mut self, step: Step, because: &str, unless: &[Unless]) -> bool {
        let reason = unless.iter().find(|unless| unless.holds && !(unless.could_run && self.everything));
        let (runs, why) = reason.map_or((true, because), |reason| (false, reason.why));
        self.steps.push(PlannedStep {
            step,
            runs,
            why: why.to_owned(),
            skipped: if runs { 0.0 } else { 1.0 },
            exact: None,
        });
        runs
    }

    /// Lets these tiles skip the last step, if it runs.
    pub(super) fn but_for(&mut self, exact: Option<&ExactTiles>) {
        if let (Some(planned), Some(exact)) =
            (self.steps.last_mut().filter(|planned| planned.runs && !self.everything), exact)
        {
            planned.skipped = exact.share();
            planned.exact = Some(exact.clone());
        }
    }

    /// Plans the pooling of variances. Lists the step also if the frame lacks variances and the method does not pool
    /// them.
    pub(super) fn noise(&mut self, pooling: Pooling, facts: &Facts) {
        if !facts.lacks_variance() && !pooling.finds_any(facts) {
            return;
        }
        let because = match (facts.is_image_only(), facts.has_sample_variance, pooling) {
            (true, ..) => "known from the image itself",
            (false, false, _) => "known from two seeds, pooled",
            (false, true, Pooling::All) => "known from the variance, pooled",
            (false, true, Pooling::Off | Pooling::Lacking) => "of features, known from two seeds, pooled",
        };
        let unless = [
            impossible(pooling == Pooling::Off, "the parameters leave it out"),
            needless(facts.is_noise_free(), "no pixel has noise"),
        ];
        self.step(Step::Noise, because, &unless);
    }

    /// Plans the variance of the colour's mean.
    pub(super) fn variance(&mut self, pooling: Pooling, facts: &Facts) {
        let because = match (facts.has_sample_variance, pooling) {
            (true, Pooling::Off | Pooling::Lacking) => "the sample variance, scaled by the halves",
            (false, Pooling::Lacking) | (_, Pooling::All) => "the pooled variance, scaled by the halves",
            (false, Pooling::Off) => "the squared half spread, smoothed",
        };
        self.step(
            Step::Variance,
            because,
            &[impossible(!facts.has_halves, "without halves the variance is taken as it is")],
        );
    }

    /// Plans that pixels without noise keep their values.
    pub(super) fn keep_clean(&mut self, keep_clean: bool) {
        self.step(
            Step::KeepClean,
            "pixels without noise stay as they are",
            &[impossible(!keep_clean, "the parameters leave it out")],
        );
    }

    pub(super) fn finish(self) -> Plan {
        Plan { steps: self.steps, keep: self.keep, strips: 1, analysis_seconds: 0.0 }
    }

    /// Leaves out all steps: the frame is the result.
    pub(super) fn leave_all_out(mut self, why: &str) -> Plan {
        for planned in &mut self.steps {
            if planned.runs {
                *planned = PlannedStep {
                    step: planned.step.clone(),
                    runs: false,
                    why: why.to_owned(),
                    skipped: 1.0,
                    exact: None,
                };
            }
        }
        self.finish()
    }
}
