//! Results of a method, and its intermediates.

use std::sync::Arc;

use glam::UVec2;

use crate::gpu::Buffer;

/// Intermediates to keep for inspection. Each method has some of them:
/// [`Method::intermediates`](super::Method::intermediates).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Intermediate {
    /// Radiance that was taken from spikes; none if spikes stay.
    Spikes,
    /// Variance of the colour's mean as the filters use it: scaled (thesis 8.2); for NLM as
    /// [`NlmVariance`](super::nlm::NlmVariance) says.
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
    /// Sampling density: where the next samples reduce the error most. For GEM the quantities it is made of, for
    /// [`sampling_density`](crate::sampling::sampling_density).
    Density,
}

impl Intermediate {
    /// All of them, whatever the method.
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

    /// Its name on the command line.
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
    /// As the colour.
    Color,
    /// As the square of the colour.
    ColorSquared,
    /// As the unit-range value of this feature.
    Feature(usize),
    /// As the square of the unit-range value of this feature.
    FeatureSquared(usize),
    /// A pure number.
    Number,
}

/// One plane that was kept.
#[derive(Debug)]
pub struct KeptPlane {
    /// The intermediate that it is part of.
    pub intermediate: Intermediate,
    /// Layer name.
    pub layer: String,
    /// Names of the channels in x, y, z.
    pub channels: Vec<String>,
    /// What the values mean.
    pub unit: Unit,
    /// The buffer that holds it.
    pub buffer: Arc<Buffer>,
    /// Which plane of the buffer.
    pub plane: u32,
}

/// One number per pixel: a component of a plane.
#[derive(Clone, Debug)]
pub struct Lane {
    /// The buffer that holds it.
    pub buffer: Arc<Buffer>,
    /// Which plane of the buffer.
    pub plane: u32,
    /// 0 to 3, x to w.
    pub component: u32,
}

/// The share of a candidate in each pixel.
#[derive(Clone, Debug)]
pub enum Share {
    /// It takes no part.
    None,
    /// All: it is the only candidate.
    Whole,
    /// As an image says, from 0 to 1.
    Lane(Lane),
}

/// What a method knows of the true image, on the GPU.
#[derive(Debug)]
pub struct GpuEstimate {
    /// The denoised signal: mean, behind it the half spread (0 without halves).
    pub signal: Arc<Buffer>,
    /// The estimated squared error, summed over the channels, at least 0. `None` where the plan leaves it out.
    pub error: Option<Lane>,
    /// How many pixels took part in a pixel's average.
    pub weight_sum: Lane,
    /// The candidates by name, and the share of each, where the method has candidates.
    pub selection: Option<Vec<(&'static str, Share)>>,
    /// What was taken from spikes, the colour of each in x, y and z, and in w the part of it that the pixels around
    /// got. `None` where nobody looked for any.
    pub spikes: Option<Arc<Buffer>>,
    /// What was asked for.
    pub kept: Vec<KeptPlane>,
}

impl GpuEstimate {
    /// Columns and rows beside a pixel that what is known of it depends on, by a dry run.
    pub(crate) fn reach(&self) -> UVec2 {
        let Self { signal, error, weight_sum, selection, spikes, kept } = self;
        let shares = selection.iter().flatten().filter_map(|(_, share)| match share {
            Share::Lane(lane) => Some(&lane.buffer),
            Share::None | Share::Whole => None,
        });
        let buffers = [signal, &weight_sum.buffer]
            .into_iter()
            .chain(error.as_ref().map(|error| &error.buffer))
            .chain(shares)
            .chain(spikes)
            .chain(kept.iter().map(|kept| &kept.buffer));
        buffers.fold(UVec2::ZERO, |most, buffer| most.max(buffer.reach()))
    }
}

/// Collects the planes that were asked for.
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

    /// Keeps a plane if it was asked for.
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

    /// Keeps planes of numbers, one for each of `names`, if they were asked for: four to a plane, each plane a layer.
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
