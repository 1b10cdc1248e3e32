//! Estimates the variances of the mean that a frame lacks, before any other step, and pools those that it has.

use std::sync::Arc;

use glam::IVec2;

use super::GpuSignal;
use super::frame::FeatureInput;
use super::plan::Facts;
use crate::error::Result;
use crate::frame::FeatureKind;
use crate::gpu::Recorder;
use crate::stage::noise::{
    ImageRule, NoiseRule, NoisyFeatures, noise_feature, noise_of_image, noise_pool, noise_unpack,
};

/// Variances of the mean that a method pools over pixels that are alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pooling {
    Off,
    /// Variances that the frame lacks.
    Lacking,
    /// Variances that the frame lacks, and the variance of a colour with halves.
    All,
}

impl Pooling {
    /// Returns whether a frame has variances to pool.
    pub(super) fn finds_any(self, facts: &Facts) -> bool {
        match self {
            Self::Off => false,
            Self::Lacking => facts.lacks_variance(),
            Self::All => facts.lacks_variance() || facts.has_halves,
        }
    }
}

/// How far around a pixel its estimated variance depends on the noise of others, in pixels. Beyond, it depends only on
/// their brightness.
pub(super) const POOLING_RADIUS: u32 = NoiseRule::HALVES.window_radius;

/// Gives variances of the mean to the colour and the features that lack them: from their halves, or from the image
/// itself where nothing is known of the colour's noise. [`Pooling::All`] also pools the given variance of a colour with
/// halves.
pub(super) fn estimate_noise(
    rec: &mut Recorder,
    extent: IVec2,
    color: &mut GpuSignal,
    features: &mut [FeatureInput],
    pooling: Pooling,
) -> Result<()> {
    let rule = if color.variance_of_mean.is_some() { NoiseRule::VARIANCE } else { NoiseRule::HALVES };
    let channels: Vec<u32> = features.iter().map(|feature| feature.channels).collect();
    let mut lacking = vec![false; features.len()];
    let mut noisy = None;
    if !channels.is_empty() {
        let mut packed = NoisyFeatures::take(rec, extent, &channels)?;
        for index in packed.packing.order() {
            let signal = features[index].fetch(rec, extent)?;
            lacking[index] = signal.has_halves && signal.variance_of_mean.is_none();
            let given = signal.variance_of_mean.as_deref().filter(|_| !signal.has_halves);
            noise_feature(rec, extent, &packed, packed.packing.slots[index], &signal.signal, given, &rule)?;
        }
        packed.are_pooled = !color.is_image_only() && lacking.contains(&true);
        noisy = Some(packed);
    }
    if color.is_image_only() {
        let may_explain = |kind| matches!(kind, FeatureKind::Albedo | FeatureKind::Normal);
        let explaining: Vec<usize> =
            (0..features.len()).filter(|&index| channels[index] == 3 && may_explain(features[index].kind)).collect();
        let variance = noise_of_image(rec, extent, &color.signal, noisy.as_ref(), &explaining, &ImageRule::DEFAULT)?;
        color.variance_of_mean = Some(Arc::new(variance));
        return Ok(());
    }
    let given = color.variance_of_mean.as_deref();
    let pooled = noise_pool(rec, extent, &color.signal, given, noisy.as_ref(), &rule)?;
    let for_color = given.is_none() || pooling == Pooling::All;
    let Some(noisy) = noisy.filter(|noisy| noisy.are_pooled) else {
        // The variance of the colour is the only plane.
        if for_color {
            color.variance_of_mean = Some(Arc::new(pooled.buffer));
        }
        return Ok(());
    };
    let pooled = Arc::new(pooled);
    if for_color {
        color.variance_of_mean = Some(Arc::new(noise_unpack(rec, extent, &pooled, None)?));
    }
    for (index, feature) in features.iter_mut().enumerate().filter(|(index, _)| lacking[*index]) {
        feature.pooled = Some((pooled.clone(), noisy.packing.slots[index]));
    }
    Ok(())
}
