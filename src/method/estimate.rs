//! Results of a method, and its intermediates.

use std::sync::Arc;

use glam::UVec2;

use crate::gpu::Buffer;
use crate::stage::payload::PayloadGroup;

/// Intermediates to keep for inspection. Each method has some of them:
/// [`Method::intermediates`](super::Method::intermediates).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Intermediate {
    /// Radiance that was taken from spikes; none if spikes stay.
    Spikes,
    /// Variance of the colour's mean that the filters use: scaled (thesis 8.2), or for NLM by the rule of
    /// [`NlmVariance`](super::nlm::NlmVariance).
    Variance,
    /// Prefiltered features and their residual variances; none without features.
    Features,
    /// The candidates of DFC.
    Candidates,
    /// dF_i/du_i of the candidates.
    Derivatives,
    /// SURE of the candidates, as computed and smoothed.
    Sure,
    /// Selection maps: binary, and as they entered the blend.
    Selection,
    /// The blend before the second pass; none without a second pass.
    Pass1,
    /// Stopping maps of each pair of scales: binary, and smoothed.
    Stopping,
    /// σ of the scale that was chosen, in pixels; 0 for the pixel filter.
    Scale,
    /// The filtered halves; none without halves.
    Halves,
    /// Sampling density: where the next samples reduce the error most. GEM keeps the quantities from which
    /// [`sampling_density`](crate::sampling::sampling_density) computes it.
    Density,
}

impl Intermediate {
    /// All intermediates of all methods.
    pub const ALL: [Self; 12] = [
        Self::Spikes,
        Self::Variance,
        Self::Features,
        Self::Candidates,
        Self::Derivatives,
        Self::Sure,
        Self::Selection,
        Self::Pass1,
        Self::Halves,
        Self::Stopping,
        Self::Scale,
        Self::Density,
    ];

    /// Returns the name of the intermediate on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Spikes => "spikes",
            Self::Variance => "variance",
            Self::Features => "features",
            Self::Candidates => "candidates",
            Self::Derivatives => "derivatives",
            Self::Sure => "sure",
            Self::Selection => "selection",
            Self::Pass1 => "pass1",
            Self::Stopping => "stopping",
            Self::Scale => "scale",
            Self::Halves => "halves",
            Self::Density => "density",
        }
    }
}

/// Unit of the values of a kept plane, to convert them back to the units of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Unit of the colour.
    Color,
    /// Square of the unit of the colour.
    ColorSquared,
    /// Unit range of the feature with this index.
    Feature(usize),
    /// Square of the unit range of the feature with this index.
    FeatureSquared(usize),
    /// No unit: the values are pure numbers.
    Number,
}

/// One plane that was kept.
#[derive(Debug)]
pub struct KeptPlane {
    /// The intermediate that the plane is part of.
    pub intermediate: Intermediate,
    /// Name of the layer.
    pub layer: String,
    /// Names of the channels in x, y, z.
    pub channels: Vec<String>,
    /// Unit of the values.
    pub unit: Unit,
    /// Buffer that holds the plane.
    pub buffer: Arc<Buffer>,
    /// Index of the plane in the buffer.
    pub plane: u32,
}

/// One number per pixel: a component of a plane.
#[derive(Clone, Debug)]
pub struct Lane {
    /// Buffer that holds the plane.
    pub buffer: Arc<Buffer>,
    /// Index of the plane in the buffer.
    pub plane: u32,
    /// Component of the plane, 0 to 3 for x to w.
    pub component: u32,
}

/// The share of a candidate in each pixel.
#[derive(Clone, Debug)]
pub enum Share {
    /// The candidate takes no part.
    None,
    /// The candidate has the whole pixel: it is the only one.
    Whole,
    /// The share of each pixel is a value of an image, from 0 to 1.
    Lane(Lane),
}

/// Results of a method, on the GPU.
#[derive(Debug)]
pub struct GpuEstimate {
    /// The denoised signal: mean, behind it the half spread (0 without halves).
    pub signal: Arc<Buffer>,
    /// The estimated squared error, summed over the channels, at least 0. `None` where the plan leaves it out.
    pub error: Option<Lane>,
    /// Number of pixels that took part in the average of each pixel.
    pub weight_sum: Lane,
    /// Names of the candidates and their shares; `None` where the method has no candidates.
    pub selection: Option<Vec<(&'static str, Share)>>,
    /// Amounts taken from spikes: the colour of each in x, y and z, and in w the part of the amount that the pixels
    /// around got. `None` where the method did not look for spikes.
    pub spikes: Option<Arc<Buffer>>,
    /// The layers that were filtered along with the colour, in the groups of the frame's payload.
    pub payload: Vec<PayloadGroup>,
    /// The requested intermediates.
    pub kept: Vec<KeptPlane>,
}

impl GpuEstimate {
    /// Returns the number of columns and rows beside a pixel that the results depend on, found by a dry run.
    pub(crate) fn reach(&self) -> UVec2 {
        let Self { signal, error, weight_sum, selection, spikes, payload, kept } = self;
        let shares = selection.iter().flatten().filter_map(|(_, share)| match share {
            Share::Lane(lane) => Some(&lane.buffer),
            Share::None | Share::Whole => None,
        });
        let buffers = [signal, &weight_sum.buffer]
            .into_iter()
            .chain(error.as_ref().map(|error| &error.buffer))
            .chain(shares)
            .chain(spikes)
            .chain(payload.iter().map(|group| &group.buffer))
            .chain(kept.iter().map(|kept| &kept.buffer));
        buffers.fold(UVec2::ZERO, |most, buffer| most.max(buffer.reach()))
    }
}

/// Collects the requested planes.
pub(super) struct Keeper<'a> {
    wanted: &'a [Intermediate],
    kept: Vec<KeptPlane>,
}

impl<'a> Keeper<'a> {
    pub(super) fn new(wanted: &'a [Intermediate]) -> Self {
        Self { wanted, kept: Vec::new() }
    }

    pub(super) fn wants(&self, intermediate: Intermediate) -> bool {
        self.wanted.contains(&intermediate)
    }

    /// Keeps a plane if its intermediate was requested.
    pub(super) fn keep(
        &mut self,
        intermediate: Intermediate,
        layer: impl Into<String>,
        channels: &[&str],
        unit: Unit,
        buffer: &Arc<Buffer>,
        plane: u32,
    ) {
        if self.wants(intermediate) {
            let channels = channels.iter().map(ToString::to_string).collect();
            self.kept.push(KeptPlane {
                intermediate,
                layer: layer.into(),
                channels,
                unit,
                buffer: buffer.clone(),
                plane,
            });
        }
    }

    /// Keeps planes of numbers, one number for each of `names`, if their intermediate was requested. A plane holds four
    /// numbers and becomes a layer.
    pub(super) fn keep_numbers(
        &mut self,
        intermediate: Intermediate,
        layer: &str,
        names: &[&str],
        unit: Unit,
        buffer: &Arc<Buffer>,
    ) {
        for (plane, names) in (0..).zip(names.chunks(4)) {
            let layer = if plane == 0 { layer.to_owned() } else { format!("{layer}_{}", plane + 1) };
            self.keep(intermediate, layer, names, unit, buffer, plane);
        }
    }

    pub(super) fn into_kept(self) -> Vec<KeptPlane> {
        self.kept
    }
}

pub(super) const RGB: [&str; 3] = ["R", "G", "B"];
