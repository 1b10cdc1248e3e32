//! The methods. Each method is one straight function that reads like its chapter. Methods know the stages, but not the
//! GPU interface beneath them.
//!
//! DFC and GEM have one shape: a bank of candidates, an error for each candidate, a smoothed choice. NLM is one filter
//! whose two halves tell its error.

mod common;
pub mod dfc;
mod estimate;
mod frame;
pub mod gem;
pub mod kernels;
mod memory;
pub mod nlm;
mod noise;
mod parameters;
mod payload;
pub mod plan;
mod spikes;
#[cfg(feature = "toml")]
mod toml;

use glam::{IVec2, Vec3};
use serde::Serialize;

use crate::error::{Error, RequestCause, Result};
use crate::frame::Frame;
use crate::gpu::{Gpu, Recorder, Run};
use crate::parameters::choices;
use crate::stage::frames::Frames;
use crate::stage::nlm::Schedule;
use crate::stage::payload::MOST_PLANES;
use kernels::KernelOnGpu;
use noise::Pooling;

pub(crate) use common::LARGEST_PATCH_RADIUS;
pub use dfc::{DfcParams, DfcPlan};
pub use estimate::{GpuEstimate, Intermediate, KeptPlane, Lane, Share, Unit};
pub(crate) use frame::{FrameInput, Units};
pub use frame::{GpuFeature, GpuFrame, GpuPayload, GpuSignal};
pub use gem::{GemParams, GemPlan};
pub(crate) use memory::{DeviceMemory, Footprint, Strip, strips};
pub use nlm::{NlmParams, NlmPlan};
pub use payload::PayloadLeft;
pub(crate) use payload::PayloadPlace;
pub(crate) use plan::{Facts, Wishes};
pub use plan::{MethodPlan, Plan, PlannedStep};
pub use spikes::{SpikeReport, Spikes};

/// A method with its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "method", rename_all = "lowercase")]
pub enum Method {
    /// Combined colour and feature filters (thesis chapter 8).
    Dfc(DfcParams),
    /// Greedy error minimisation over Gaussian scales (thesis chapter 6).
    Gem(GemParams),
    /// Cross-filtered halves (thesis chapter 7).
    Nlm(NlmParams),
}

choices! {
    /// Named parameter sets.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Preset {
        /// Values that measured best.
        Default => "default",
        /// The published algorithm to the letter, with its misprints corrected.
        Thesis => "thesis",
    }
}

impl Default for Method {
    fn default() -> Self {
        Self::Dfc(DfcParams::default())
    }
}

impl From<DfcParams> for Method {
    fn from(params: DfcParams) -> Self {
        Self::Dfc(params)
    }
}

impl Method {
    /// Returns the name of the method on the command line.
    pub fn name(&self) -> &'static str {
        let [dfc, gem, nlm] = Self::NAMES;
        match self {
            Self::Dfc(_) => dfc,
            Self::Gem(_) => gem,
            Self::Nlm(_) => nlm,
        }
    }

    /// Returns the radius of the window that the method averages over, in pixels.
    pub fn window_radius(&self) -> u32 {
        match self {
            Self::Dfc(params) => params.window_radius,
            Self::Gem(params) => params.window_radius(),
            Self::Nlm(params) => params.window_radius,
        }
    }

    /// Returns how far the influence of a pixel reaches, in pixels along either axis, for any noise statistics of the
    /// frame and any requested results.
    pub(crate) fn reach(&self, gpu: &Gpu, schedule: Schedule) -> Result<u32> {
        let wishes = Wishes { keep: self.intermediates(), error: true, everything: true };
        let mut reach = 0;
        for (has_halves, has_variance) in [(true, true), (true, false), (false, true), (false, false)] {
            if self.check_noise_is_known(!has_halves && !has_variance).is_err() {
                continue;
            }
            let rec = &mut gpu.record_in(&Run::dry(None));
            let frame = GpuFrame::least(rec, has_halves, has_variance)?;
            let plan = self.plan(&Facts::of_gpu_frame(&frame, 0, self.uses_features()), &wishes);
            let estimate = self.record(rec, Frames::one(frame.into()), &plan, schedule, |_, _| Ok(()))?;
            reach = reach.max(estimate.reach().max_element());
        }
        Ok(reach)
    }

    /// Returns whether the method uses features. If not, they are not uploaded.
    pub fn uses_features(&self) -> bool {
        match self {
            Self::Dfc(_) => true,
            Self::Gem(_) | Self::Nlm(_) => false,
        }
    }

    /// Returns whether the method filters each half of the samples with the weights of the other.
    pub fn filters_halves(&self) -> bool {
        matches!(self, Self::Nlm(NlmParams { dual_buffer: true, .. }))
    }

    /// Returns the [`GpuFrame::mean_variance`] of a frame, if the method uses it.
    pub(crate) fn mean_variance(&self, frame: &Frame, exposure: f32) -> Option<Vec3> {
        match self {
            Self::Nlm(NlmParams { variance: nlm::NlmVariance::Uniform, .. }) => frame::mean_variance(frame, exposure),
            _ => None,
        }
    }

    /// Returns the intermediates that the method has.
    pub fn intermediates(&self) -> &'static [Intermediate] {
        match self {
            Self::Dfc(_) => &dfc::INTERMEDIATES,
            Self::Gem(_) => &gem::INTERMEDIATES,
            Self::Nlm(_) => &nlm::INTERMEDIATES,
        }
    }

    /// Returns the method with the parameters for frames whose samples are still being drawn. Spikes stay, because a
    /// spike calls for more samples. A pixel whose first samples agree does not count as free of noise.
    #[must_use]
    pub fn while_sampling(self) -> Self {
        match self {
            Self::Dfc(params) => Self::Dfc(DfcParams { spikes: Spikes::Keep, keep_clean: false, ..params }),
            Self::Gem(params) => {
                Self::Gem(GemParams { phase: gem::Phase::Sampling, spikes: Spikes::Keep, keep_clean: false, ..params })
            }
            Self::Nlm(params) => Self::Nlm(params.while_sampling()),
        }
    }

    /// Checks the ranges of the parameters.
    ///
    /// # Errors
    /// [`Error::Request`] naming the parameter and its range.
    pub fn validate(&self) -> Result<()> {
        match self {
            Self::Dfc(params) => params.validate(),
            Self::Gem(params) => params.validate(),
            Self::Nlm(params) => params.validate(),
        }
    }

    /// Returns the plan for frames with these facts.
    pub(crate) fn plan(&self, facts: &Facts, wishes: &Wishes) -> Plan {
        match self {
            Self::Dfc(params) => dfc::plan(params, facts, wishes),
            Self::Gem(params) => MethodPlan::Gem(Box::new(gem::plan(params, facts, wishes))),
            Self::Nlm(params) => MethodPlan::Nlm(Box::new(nlm::plan(params, facts, wishes))),
        }
        .into()
    }

    /// Returns whether the window can hold neighbouring frames of a shot.
    pub fn filters_in_time(&self) -> bool {
        match self {
            Self::Dfc(_) | Self::Nlm(_) => true,
            Self::Gem(_) => false,
        }
    }

    /// Returns the treatment of spikes.
    pub fn spikes(&self) -> Spikes {
        match self {
            Self::Dfc(params) => params.spikes,
            Self::Gem(params) => params.spikes,
            Self::Nlm(params) => params.spikes,
        }
    }

    /// Returns the method with another treatment of spikes.
    #[must_use]
    pub fn with_spikes(self, spikes: Spikes) -> Self {
        match self {
            Self::Dfc(params) => Self::Dfc(DfcParams { spikes, ..params }),
            Self::Gem(params) => Self::Gem(GemParams { spikes, ..params }),
            Self::Nlm(params) => Self::Nlm(NlmParams { spikes, ..params }),
        }
    }

    /// The method with a window of this radius, in pixels. A method without a single window stays as it is.
    #[must_use]
    pub fn with_window_radius(self, window_radius: u32) -> Self {
        match self {
            Self::Dfc(params) => Self::Dfc(DfcParams { window_radius, ..params }),
            Self::Gem(_) => self,
            Self::Nlm(params) => Self::Nlm(NlmParams { window_radius, ..params }),
        }
    }

    /// The method with these candidates. A method without candidates stays as it is.
    #[must_use]
    pub fn with_candidates(self, candidates: dfc::CandidateSet) -> Self {
        match self {
            Self::Dfc(params) => Self::Dfc(DfcParams { candidates, ..params }),
            Self::Gem(_) | Self::Nlm(_) => self,
        }
    }

    /// Returns whether the method estimates variances of the mean that a frame lacks.
    pub fn pools_variance(&self) -> bool {
        self.pooling() != Pooling::Off
    }

    /// Returns the variances of the mean that the method pools.
    fn pooling(&self) -> Pooling {
        let (pools, pooling) = match self {
            Self::Dfc(params) => (params.pooled_variance, Pooling::All),
            Self::Gem(params) => (params.pooled_variance, Pooling::Lacking),
            Self::Nlm(params) => (params.pooled_variance, Pooling::Lacking),
        };
        if pools { pooling } else { Pooling::Off }
    }

    /// Refuses a colour of unknown noise if the method does not estimate the noise.
    pub(crate) fn check_noise_is_known(&self, is_image_only: bool) -> Result<()> {
        if !is_image_only || self.pools_variance() {
            return Ok(());
        }
        Err(Error::Request(RequestCause::NoiseNotEstimated))
    }

    /// Refuses frames beside the one to denoise if the method cannot use them.
    pub(crate) fn check_beside(&self, beside: usize) -> Result<()> {
        if beside == 0 || self.filters_in_time() {
            return Ok(());
        }
        Err(Error::Request(RequestCause::NotInTime { method: self.name() }))
    }

    /// Records the work that yields the kernels at a pixel. `frame` may be the part of the frame that the kernels
    /// depend on.
    pub(crate) fn kernels(
        &self,
        rec: &mut Recorder,
        frame: FrameInput,
        pixel: IVec2,
        plan: &Plan,
        schedule: Schedule,
    ) -> Result<Vec<KernelOnGpu>> {
        match &plan.method {
            MethodPlan::Dfc(plan) => dfc::kernels(rec, frame, pixel, plan, schedule),
            MethodPlan::Gem(plan) => gem::kernels(rec, frame, plan),
            MethodPlan::Nlm(plan) => nlm::kernels(rec, frame, pixel, plan, schedule),
        }
    }

    /// Records the planned steps for the own frame of a window. The other frames of the window have its units.
    /// `progress` receives the share of the work that is recorded, 0 to 1.
    pub(crate) fn record(
        &self,
        rec: &mut Recorder,
        frames: Frames<FrameInput>,
        plan: &Plan,
        schedule: Schedule,
        progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
    ) -> Result<GpuEstimate> {
        self.check_beside(frames.beside.len())?;
        self.check_noise_is_known(frames.own.color.is_image_only())?;
        let channels = |frame: &FrameInput| {
            if self.uses_features() {
                frame.features.iter().map(|feature| feature.channels).collect()
            } else {
                Vec::new()
            }
        };
        let groups = |frame: &FrameInput| frame.payload.iter().map(|it| it.mean.planes).collect::<Vec<_>>();
        let shape = |frame: &FrameInput| (frame.extent, frame.color.has_halves, channels(frame), groups(frame));
        if frames.beside.iter().any(|other| shape(other) != shape(&frames.own)) {
            return Err(Error::Request(RequestCause::FrameShape));
        }
        if groups(&frames.own).iter().any(|planes| !(1..=MOST_PLANES).contains(planes)) {
            return Err(Error::Request(RequestCause::Misuse {
                problem: format!("a group of the payload does not have 1 to {MOST_PLANES} planes"),
                change: "split it into groups of up to 4 planes",
            }));
        }
        match &plan.method {
            MethodPlan::Dfc(plan) => dfc::dfc(rec, frames, plan, schedule, progress),
            MethodPlan::Gem(plan) => gem::gem(rec, frames.own, plan, progress),
            MethodPlan::Nlm(plan) => nlm::nlm(rec, frames, plan, schedule, progress),
        }
    }
}
