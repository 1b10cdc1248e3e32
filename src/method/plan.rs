//! The steps of a method that a frame needs. They are decided before anything runs, from the parameters, the requested
//! results and a look at the frame.
//!
//! A method asks its plan before every step, so that the plan decides what runs. Each method has a plan of its own
//! type: asking for a step that the plan does not know does not compile.

use glam::IVec2;
use serde::Serialize;

use super::frame::Units;
use super::noise::{POOLING_RADIUS, Pooling};
use super::{DfcPlan, GemPlan, GpuFrame, GpuSignal, Intermediate, NlmPlan, Spikes};
use crate::frame::{Feature, Frame, NoiseTiles, TILE};
use crate::gpu::Recorder;
use crate::stage::exact::ExactTiles;
use crate::stage::frames::Frames;
use crate::stage::payload::PAYLOAD_STEP;
use crate::stage::variance::INPUT_SMOOTHING;

/// The steps of a method for a frame, those that run and those that are left out.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The steps by name and type.
    pub method: MethodPlan,
    /// Strips that the image is cut into; 1 where it fits as a whole.
    pub strips: usize,
    /// Rounds over the strips, each with other layers along; 1 where all layers fit.
    pub rounds: usize,
    /// Time that the look at the frames took, in seconds on the host.
    pub analysis_seconds: f64,
}

/// The steps of one of the methods.
#[derive(Clone, Debug, PartialEq)]
pub enum MethodPlan {
    /// Steps of DFC.
    Dfc(Box<DfcPlan>),
    /// Steps of GEM.
    Gem(Box<GemPlan>),
    /// Steps of NLM.
    Nlm(Box<NlmPlan>),
}

/// A step of a plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlannedStep {
    /// Name that users read. Times are listed under it ([`Gpu::step_timings`](crate::gpu::Gpu::step_timings)).
    #[serde(rename = "step")]
    pub name: String,
    /// Whether the step runs.
    pub runs: bool,
    /// Reason to run the step, or to leave it out.
    pub why: String,
    /// Share of the pixels that skip the step, 0 to 1; 1 if it does not run.
    pub skipped: f64,
    /// Whether [`kernels`](super::kernels) depend on the step. If so, leaving it out explains why a filter is missing,
    /// or why a feature does not separate neighbours.
    #[serde(skip)]
    pub makes_kernels: bool,
    /// Tiles that skip the step.
    #[serde(skip)]
    pub(super) exact: Option<ExactTiles>,
}

impl PlannedStep {
    /// Names the step for the dispatches that are recorded from here on, if it runs.
    pub(super) fn begin(&self, rec: &mut Recorder) {
        if self.runs {
            rec.begin_step(&self.name);
        }
    }

    /// Lets these tiles skip the step, if it runs.
    pub(super) fn but_for(mut self, exact: Option<&ExactTiles>) -> Self {
        if let Some(exact) = exact.filter(|_| self.runs) {
            self.skipped = exact.share();
            self.exact = Some(exact.clone());
        }
        self
    }

    /// Marks a step that kernels do not depend on.
    pub(super) fn beside_kernels(self) -> Self {
        Self { makes_kernels: false, ..self }
    }
}

/// A part of a plan: one step, a step that some frames do not have, a list of steps, or a whole plan.
pub(super) trait Steps {
    /// Appends the steps in their order.
    fn list<'a>(&'a self, into: &mut Vec<&'a PlannedStep>);
    /// Changes each step.
    fn change(&mut self, change: &mut dyn FnMut(&mut PlannedStep));
}

impl Steps for PlannedStep {
    fn list<'a>(&'a self, into: &mut Vec<&'a PlannedStep>) {
        into.push(self);
    }

    fn change(&mut self, change: &mut dyn FnMut(&mut PlannedStep)) {
        change(self);
    }
}

impl Steps for Option<PlannedStep> {
    fn list<'a>(&'a self, into: &mut Vec<&'a PlannedStep>) {
        into.extend(self);
    }

    fn change(&mut self, change: &mut dyn FnMut(&mut PlannedStep)) {
        self.iter_mut().for_each(change);
    }
}

impl Steps for Vec<PlannedStep> {
    fn list<'a>(&'a self, into: &mut Vec<&'a PlannedStep>) {
        into.extend(self);
    }

    fn change(&mut self, change: &mut dyn FnMut(&mut PlannedStep)) {
        self.iter_mut().for_each(change);
    }
}

/// Declares the plan of a method: its parameters and its steps, in the order of the method. The method can only ask for
/// these steps.
macro_rules! method_plan {
    ($(#[$meta:meta])* pub struct $name:ident of $params:ty { $($(#[$doc:meta])* $step:ident: $type:ty),+ $(,)? }) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq)]
        pub struct $name {
            /// Parameters that the plan was made from.
            pub(in crate::method) params: $params,
            /// Intermediates to keep.
            pub(in crate::method) keep: Vec<$crate::method::Intermediate>,
            $($(#[$doc])* pub $step: $type),+
        }

        impl $crate::method::plan::Steps for $name {
            fn list<'a>(&'a self, into: &mut Vec<&'a $crate::method::plan::PlannedStep>) {
                $(self.$step.list(into);)+
            }

            fn change(&mut self, change: &mut dyn FnMut(&mut $crate::method::plan::PlannedStep)) {
                $(self.$step.change(change);)+
            }
        }
    };
}
pub(super) use method_plan;

impl MethodPlan {
    fn as_steps(&self) -> &dyn Steps {
        match self {
            Self::Dfc(plan) => &**plan,
            Self::Gem(plan) => &**plan,
            Self::Nlm(plan) => &**plan,
        }
    }

    fn as_steps_mut(&mut self) -> &mut dyn Steps {
        match self {
            Self::Dfc(plan) => &mut **plan,
            Self::Gem(plan) => &mut **plan,
            Self::Nlm(plan) => &mut **plan,
        }
    }

    /// Leaves out all steps, so that the frame is the result.
    pub(super) fn leave_all_out(mut self, why: &str) -> Self {
        self.as_steps_mut().change(&mut |step| {
            if step.runs {
                *step = PlannedStep { runs: false, why: why.to_owned(), skipped: 1.0, exact: None, ..step.clone() };
            }
        });
        self
    }
}

impl Plan {
    /// Returns all steps in the order of the method.
    pub fn steps(&self) -> Vec<&PlannedStep> {
        let mut steps = Vec::new();
        self.method.as_steps().list(&mut steps);
        steps
    }

    /// Returns the plan for a part of the frame that begins at pixel `first`.
    pub(crate) fn starting_at(&self, first: IVec2) -> Self {
        let mut moved = self.clone();
        moved.method.as_steps_mut().change(&mut |step| {
            step.exact = step.exact.as_ref().map(|exact| exact.starting_at(first));
        });
        moved
    }

    /// Returns whether no step runs, so that the frame is the result.
    pub(crate) fn copies_the_frame(&self) -> bool {
        self.steps().iter().all(|step| !step.runs)
    }

    /// Returns whether the method reads the noise of a feature. `index` counts the features that are used.
    pub(super) fn reads_noise_of_feature(&self, index: usize) -> bool {
        match &self.method {
            MethodPlan::Dfc(plan) => plan.prefilters.get(index).is_some_and(|step| step.runs),
            MethodPlan::Gem(_) | MethodPlan::Nlm(_) => false,
        }
    }
}

impl From<MethodPlan> for Plan {
    fn from(method: MethodPlan) -> Self {
        Self { method, strips: 1, rounds: 1, analysis_seconds: 0.0 }
    }
}

/// Least share of exact tiles, 0 to 1, from which on a filter skips them.
const LEAST_SHARE: f64 = 0.05;

/// Facts about a window of frames, found before anything runs.
#[derive(Clone, Debug)]
pub(crate) struct Facts {
    pub(super) has_halves: bool,
    pub(super) has_sample_variance: bool,
    /// Number of frames beside the frame to denoise.
    pub(super) beside: usize,
    /// Tiles in which the colour of any frame has noise. `None` for frames that stay on the device.
    pub(super) noise: Option<NoiseTiles>,
    /// Whether all channels of the colour are equal, in all frames.
    pub(super) grey: bool,
    /// Number of layers that are filtered along with the colour.
    pub(super) payload: usize,
    /// Number of tiles in a row.
    tile_columns: usize,
    /// Features that are used, in their order.
    pub(super) features: Vec<FeatureFacts>,
    /// Names of the features that are not used, and the reasons.
    pub(super) unused_features: Vec<(String, &'static str)>,
}

#[derive(Clone, Debug)]
pub(super) struct FeatureFacts {
    pub(super) name: String,
    /// Whether halves or a variance tell the noise of the feature.
    pub(super) noise_is_told: bool,
    /// Whether the feature has a sample variance, so that a pixel without noise has the variance 0.
    has_sample_variance: bool,
    /// Tiles in which the feature has noise in any frame. `None` for frames that stay on the device.
    noise: Option<NoiseTiles>,
}

impl FeatureFacts {
    /// Returns whether no pixel has noise.
    pub(super) fn is_noise_free(&self) -> bool {
        self.noise.as_ref().is_some_and(|noise| !noise.any())
    }
}

impl Facts {
    /// Analyses a window of frames, of which the own one is to be denoised.
    pub(crate) fn of_window(window: &Frames<&Frame>, units: &Units, with_features: bool) -> Self {
        let frame = window.own;
        let features = units.features.iter().map(|feature| {
            let in_all_frames = || {
                window
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
        let all_tell = window.iter().all(|frame| frame.color().noise_knowledge().is_some());
        let lacking = frame.features().iter().filter(|feature| !is_used(feature));
        let lacking =
            lacking.map(|feature| (feature.name.clone(), "a frame beside lacks it, or has it the same everywhere"));
        Self {
            has_halves: frame.color().half_spread.is_some(),
            has_sample_variance: frame.color().variance_of_mean.is_some(),
            beside: window.beside.len(),
            noise: NoiseTiles::of_all(window.iter().map(|frame| frame.color())).filter(|_| all_tell),
            grey: window.iter().all(|frame| frame.color().is_grey()),
            payload: units.payload.filtered(),
            tile_columns: (frame.extent().width as usize).div_ceil(TILE),
            features: features.collect(),
            unused_features: if with_features { constant.chain(lacking).collect() } else { Vec::new() },
        }
    }

    /// Returns facts about frames that a renderer keeps on the device. Their pixels are unknown, so every step that
    /// might be needed counts as needed.
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
            payload: frame.payload.iter().map(|group| group.mean.planes as usize).sum(),
            tile_columns: 0,
            features: features.collect(),
            unused_features: Vec::new(),
        }
    }
}

impl Facts {
    /// Returns whether no pixel of any frame has noise.
    pub(super) fn is_noise_free(&self) -> bool {
        self.noise.as_ref().is_some_and(|noise| !noise.any())
    }

    /// Returns whether nothing but the image itself tells the noise of the colour.
    pub(super) fn is_image_only(&self) -> bool {
        !self.has_halves && !self.has_sample_variance
    }

    /// Returns whether the colour lacks a sample variance, or a feature with noise does. Features count only where the
    /// colour has halves.
    pub(super) fn lacks_variance(&self) -> bool {
        let features_lack =
            || self.features.iter().any(|feature| feature.noise_is_told && !feature.has_sample_variance);
        !self.has_sample_variance || self.has_halves && features_lack()
    }

    /// Returns the tiles without noise of the colour within `reach` pixels, if there are enough of them.
    pub(super) fn exact_color(&self, reach: u32) -> Option<ExactTiles> {
        self.exact(self.noise.as_ref(), self.has_sample_variance, reach)
    }

    /// Returns the tiles without noise of a feature within `reach` pixels, if there are enough of them.
    pub(super) fn exact_feature(&self, feature: &FeatureFacts, reach: u32) -> Option<ExactTiles> {
        self.exact(feature.noise.as_ref(), feature.has_sample_variance, reach)
    }

    /// Returns the tiles without noise within reach; `None` where so few tiles are exact that skipping them saves
    /// nothing. Without a sample variance, the variance is pooled or smoothed, so that it reaches further than the
    /// noise.
    fn exact(&self, noise: Option<&NoiseTiles>, has_sample_variance: bool, reach: u32) -> Option<ExactTiles> {
        let smoothing = if has_sample_variance { 0 } else { INPUT_SMOOTHING.radius.max(POOLING_RADIUS) };
        let exact = ExactTiles::new(noise?.exact((reach + smoothing) as usize), self.tile_columns, TILE);
        Some(exact).filter(|exact| exact.share() >= LEAST_SHARE)
    }
}

/// Results that a caller requests from a method.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wishes<'a> {
    /// Intermediates to keep.
    pub(crate) keep: &'a [Intermediate],
    /// Whether to estimate the error.
    pub(crate) error: bool,
    /// Whether to run steps that the frame does not need, too.
    pub(crate) everything: bool,
}

impl Wishes<'_> {
    pub(super) fn keeps(&self, intermediate: Intermediate) -> bool {
        self.keep.contains(&intermediate)
    }
}

/// A reason to leave out a step, and whether it holds.
pub(super) struct Unless {
    holds: bool,
    why: &'static str,
    /// Whether the step runs nevertheless under `with_everything`.
    could_run: bool,
}

/// A step that has no input, or whose result is not requested.
pub(super) fn impossible(holds: bool, why: &'static str) -> Unless {
    Unless { holds, why, could_run: false }
}

/// A step that would change nothing.
pub(super) fn needless(holds: bool, why: &'static str) -> Unless {
    Unless { holds, why, could_run: true }
}

/// Decides which steps run.
#[derive(Clone, Copy)]
pub(super) struct Planner {
    everything: bool,
}

impl Planner {
    pub(super) fn new(wishes: &Wishes) -> Self {
        Self { everything: wishes.everything }
    }

    /// Plans a step. It runs for the reason `because`, unless one of the reasons in `unless` holds.
    pub(super) fn step(self, name: impl Into<String>, because: &str, unless: &[Unless]) -> PlannedStep {
        let reason = unless.iter().find(|unless| unless.holds && !(unless.could_run && self.everything));
        let (runs, why) = reason.map_or((true, because), |reason| (false, reason.why));
        PlannedStep {
            name: name.into(),
            runs,
            why: why.to_owned(),
            skipped: if runs { 0.0 } else { 1.0 },
            makes_kernels: true,
            exact: None,
        }
    }

    /// Returns the tiles to skip; `None` if everything runs.
    pub(super) fn skipping(self, exact: Option<ExactTiles>) -> Option<ExactTiles> {
        exact.filter(|_| !self.everything)
    }

    /// Plans the pooling of variances. Returns `None` if the frame lacks no variances and the method pools none of
    /// those that it has. A step that is planned and left out means that the frame lacks variances, but the method does
    /// not pool.
    pub(super) fn noise(self, pooling: Pooling, facts: &Facts) -> Option<PlannedStep> {
        if !facts.lacks_variance() && !pooling.finds_any(facts) {
            return None;
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
        Some(self.step("noise", because, &unless))
    }

    /// Plans the repair of spikes in the colour.
    pub(super) fn spikes(self, spikes: Spikes, facts: &Facts) -> PlannedStep {
        let because = match spikes {
            Spikes::Clamp => "what rests on few samples is cut off",
            Spikes::Keep | Spikes::Spread => "what rests on few samples is spread",
        };
        let unless = [
            impossible(spikes == Spikes::Keep, "the parameters leave it out"),
            impossible(facts.is_noise_free(), "no pixel has noise"),
        ];
        self.step("spikes", because, &unless)
    }

    /// Plans the variance of the colour's mean that the filters use.
    pub(super) fn variance(self, pooling: Pooling, facts: &Facts) -> PlannedStep {
        let because = match (facts.has_sample_variance, pooling) {
            (true, Pooling::Off | Pooling::Lacking) => "the sample variance, scaled by the halves",
            (false, Pooling::Lacking) | (_, Pooling::All) => "the pooled variance, scaled by the halves",
            (false, Pooling::Off) => "the squared half spread, smoothed",
        };
        self.step(
            "variance",
            because,
            &[impossible(!facts.has_halves, "without halves the variance is taken as it is")],
        )
    }

    /// Plans that layers are filtered along with the colour. Returns `None` for a frame that has no such layers.
    pub(super) fn payload(self, facts: &Facts) -> Option<PlannedStep> {
        let count = facts.payload;
        let because = format!("{count} {} the colour's weights", if count == 1 { "takes" } else { "take" });
        (count > 0).then(|| self.step(PAYLOAD_STEP, &because, &[]).beside_kernels())
    }

    /// Plans that pixels without noise are put back.
    pub(super) fn keep_clean(self, keep_clean: bool) -> PlannedStep {
        let unless = [impossible(!keep_clean, "the parameters leave it out")];
        self.step("clean pixels", "pixels without noise stay as they are", &unless).beside_kernels()
    }
}
