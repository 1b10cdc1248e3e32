//! Features in the form that the bilateral weights read (thesis 8.3).

use glam::{IVec2, Vec4};

use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! { struct FeaturePackParams { extent: IVec2, group: i32, single: i32 } }
bindings! {
    struct FeaturePack<'a> {
        uniform params: FeaturePackParams, around filtered, optional residual_variance, write features,
    }
}

/// Number of groups that the shaders hold parameters for; this many features of three channels fit.
pub const MAX_GROUPS: usize = 8;

/// Position of a feature: a group of four channels, and in the group x, y, z or w alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot {
    /// Group, from 0.
    pub group: u32,
    /// Whether the feature is alone in w.
    pub single: bool,
}

/// Slots of features, chosen by their numbers of channels: each feature of two or three channels takes x, y, z of a
/// group; features of one channel fill the w of these groups, then pairs of them share further groups.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packing {
    /// One slot per feature.
    pub slots: Vec<Slot>,
    /// Number of groups.
    pub groups: u32,
    channels: Vec<u32>,
}

impl Packing {
    /// Finds a slot for each feature.
    pub fn new(channels: &[u32]) -> Self {
        let mut slots = vec![Slot { group: 0, single: false }; channels.len()];
        let mut groups = 0;
        let mut free_singles = std::collections::VecDeque::new();
        // Wide features first, so that the narrow ones fill the gaps.
        for wide in [true, false] {
            for (slot, _) in slots.iter_mut().zip(channels).filter(|(_, count)| (**count > 1) == wide) {
                // A wide feature does not fit into a w, so it must not take one out of the queue.
                let free_single = if wide { None } else { free_singles.pop_front() };
                *slot = match free_single {
                    Some(group) => Slot { group, single: true },
                    None => {
                        free_singles.push_back(groups);
                        groups += 1;
                        Slot { group: groups - 1, single: false }
                    }
                };
            }
        }
        Self { slots, groups, channels: channels.to_vec() }
    }

    /// Returns the features in an order in which the triple of a group comes before its single: the triple clears the
    /// group.
    pub fn order(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.slots.len()).collect();
        order.sort_by_key(|index| self.slots[*index].single);
        order
    }

    /// Returns 1 / number of channels for each channel of each group's triple: the distance of a feature is the mean
    /// over its channels.
    pub(super) fn triple_weights(&self) -> [Vec4; MAX_GROUPS] {
        let mut weights = [Vec4::ZERO; MAX_GROUPS];
        for (slot, &count) in self.slots.iter().zip(&self.channels).filter(|(slot, _)| !slot.single) {
            let weight = |channel: u32| if channel < count { 1.0 / count as f32 } else { 0.0 };
            weights[slot.group as usize] = Vec4::new(weight(0), weight(1), weight(2), 0.0);
        }
        weights
    }
}

/// Prefiltered features on the GPU.
#[derive(Debug)]
pub struct Features {
    /// Three planes per group: value, residual variance, the larger of residual variance and squared gradient.
    pub buffer: Buffer,
    /// Group and component of each feature.
    pub packing: Packing,
}

impl Features {
    /// Takes a buffer for features with these numbers of channels. [`feature_pack`] fills it, in any order in which the
    /// triple of a group comes before its single.
    ///
    /// # Errors
    /// As [`Recorder::take`].
    pub fn take(rec: &mut Recorder, extent: IVec2, channels: &[u32]) -> Result<Self> {
        let packing = Packing::new(channels);
        Ok(Self { buffer: rec.take("features", plane_bytes(extent, 3 * packing.groups))?, packing })
    }
}

/// Writes one prefiltered feature (unit range, first plane of `filtered`) to its slot, with its residual variance, if
/// it has noise, and its squared gradient. The gradient along each axis is the smaller of the two one-sided differences
/// over half a pixel.
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn feature_pack(
    rec: &mut Recorder,
    extent: IVec2,
    features: &Features,
    slot: Slot,
    filtered: &Buffer,
    residual_variance: Option<&Buffer>,
) -> Result<()> {
    let params = FeaturePackParams { extent, group: slot.group as i32, single: i32::from(slot.single) };
    rec.dispatch(
        "feature_pack",
        &[("NOISY", residual_variance.is_some().into())],
        &FeaturePack { params, filtered: filtered.within(1).front(), residual_variance, features: &features.buffer },
        per_pixel(extent),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All lists of up to [`MAX_GROUPS`] features of one to three channels.
    fn channel_lists() -> impl Iterator<Item = Vec<u32>> {
        (0..=MAX_GROUPS as u32).flat_map(|features| {
            (0..3u32.pow(features))
                .map(move |list| (0..features).map(|feature| list / 3u32.pow(feature) % 3 + 1).collect())
        })
    }

    #[test]
    fn features_share_no_channel_and_take_the_fewest_groups() {
        for channels in channel_lists() {
            let Packing { slots, groups, .. } = Packing::new(&channels);
            assert_eq!(slots.len(), channels.len());
            let mut is_taken = vec![[false; 4]; groups as usize];
            for (slot, &count) in slots.iter().zip(&channels) {
                assert!(!slot.single || count == 1, "{channels:?}: {slot:?} holds one channel");
                let places = if slot.single { 3..4 } else { 0..count as usize };
                for taken in &mut is_taken[slot.group as usize][places] {
                    assert!(!std::mem::replace(taken, true), "{channels:?}: two features share {slot:?}");
                }
            }
            // Each group holds one wide feature or one single in its triple, and one single in its w.
            let wide = channels.iter().filter(|count| **count > 1).count();
            let singles_without_a_wide_one = (channels.len() - wide).saturating_sub(wide);
            assert_eq!(groups as usize, wide + singles_without_a_wide_one.div_ceil(2), "{channels:?}");
        }
    }

    #[test]
    fn every_triple_of_a_group_is_written_before_its_single() {
        // A single clears nothing, so that the channels beside it would stay as they were in a group without a triple.
        for channels in channel_lists() {
            let packing = Packing::new(&channels);
            for group in 0..packing.groups {
                assert!(
                    packing.slots.contains(&Slot { group, single: false }),
                    "{channels:?}: group {group} has no triple"
                );
            }
        }
    }
}
