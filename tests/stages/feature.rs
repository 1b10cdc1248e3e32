//! `feature_pack`: features in the form that the bilateral weights read. The stage has only products and a choice, so
//! six digits are right.

use stein::gpu::{Gpu, Recorder};
use stein::stage::feature::{Features, feature_pack};

use crate::common::{assert_near, checked_gpu, extent_of, gpu, own_size, read, rounded, run, upload};
use crate::reference::nlm::Feature;
use crate::reference::prefilter::gradient_squared;
use crate::reference::random::Random;
use crate::reference::{Grid, Planes};

/// Prefiltered features with edges, ramps, flat parts, and residual variances of which some are 0.
pub(crate) fn features(width: usize, height: usize, channels: &[usize], seed: u64) -> Vec<Feature> {
    let mut random = Random(seed);
    let mut feature = |index: usize, channels: usize| {
        let mut mean = || {
            let noise = random.uniform_grid(width, height, 0.0, 0.03);
            let level = random.uniform();
            rounded(noise.like(|p| {
                let stripe = (p.x as usize / (4 + index) + p.y as usize / 6) % 3;
                match stripe {
                    0 => level,
                    1 => 0.4 + 0.005 * p.x as f64 + noise.at(p),
                    _ => 0.5 + noise.at(p),
                }
            }))
        };
        let mean: Planes = (0..channels).map(|_| mean()).collect();
        // The second has no noise.
        let most = if index == 1 { 0.0 } else { 1e-3 };
        let residual_variance =
            (0..channels).map(|_| positive(rounded(random.uniform_grid(width, height, -0.5 * most, most)))).collect();
        Feature { gradient_squared: mean.iter().map(gradient_squared).collect(), mean, residual_variance }
    };
    channels.iter().enumerate().map(|(index, channels)| feature(index, *channels)).collect()
}

fn positive(grid: Grid) -> Grid {
    grid.like(|p| grid.at(p).max(0.0))
}

/// In the order of the method: a feature alone in a group's w comes after the feature that fills the rest of the group.
pub(crate) fn pack(rec: &mut Recorder, features: &[Feature]) -> stein::Result<Features> {
    let extent = extent_of(&features[0].mean[0]);
    let channels: Vec<u32> = features.iter().map(|feature| feature.mean.len() as u32).collect();
    let packed = Features::take(rec, extent, &channels)?;
    for index in packed.packing.order() {
        let (feature, slot) = (&features[index], packed.packing.slots[index]);
        let filtered = upload(rec, &feature.mean)?;
        let residual_variance = upload(rec, &feature.residual_variance)?;
        // A part that is 0 everywhere may be left out.
        let has_noise = feature.residual_variance.iter().flat_map(|grid| &grid.values).any(|variance| *variance != 0.0);
        feature_pack(rec, extent, &packed, slot, &filtered, has_noise.then_some(&residual_variance))?;
    }
    Ok(packed)
}

fn check(gpu: &Gpu, width: usize, height: usize, channels: &[usize]) {
    let features = features(width, height, channels, 21);
    let packed = run(gpu, |rec| pack(rec, &features));
    let planes = read(gpu, &packed.buffer, extent_of(&features[0].mean[0]));
    assert_eq!(planes.len(), 3 * packed.packing.groups as usize);
    let mut used = vec![[false; 4]; packed.packing.groups as usize];
    for (index, (feature, slot)) in features.iter().zip(&packed.packing.slots).enumerate() {
        let group = slot.group as usize;
        let first = if slot.single { 3 } else { 0 };
        let components = first..first + feature.mean.len();
        used[group][components.clone()].fill(true);
        let scale: Planes = feature
            .residual_variance
            .iter()
            .zip(&feature.gradient_squared)
            .map(|(v, g)| v.like(|p| v.at(p).max(g.at(p))))
            .collect();
        for (quantity, expected) in [&feature.mean, &feature.residual_variance, &scale].into_iter().enumerate() {
            let actual = &planes[3 * group + quantity][components.clone()];
            // Differences of values up to 1 have the rounding error of f32; their squares twice that.
            assert_near(
                &format!("{width}×{height}, feature {index} of {channels:?}, plane {quantity}"),
                actual,
                expected,
                &own_size(expected, 1e-6),
                1e-5,
                0.0,
            );
        }
    }
    // Unused channels are 0, because the distance sums over them.
    for (group, used) in used.iter().enumerate() {
        for component in (0..4).filter(|component| !used[*component]) {
            for quantity in 0..3 {
                assert!(
                    planes[3 * group + quantity][component].values.iter().all(|v| *v == 0.0),
                    "group {group}, component {component}, plane {quantity}"
                );
            }
        }
    }
}

#[test]
fn features_are_packed_with_their_gradients() {
    check(gpu(), 257, 89, &[3, 1]);
    check(gpu(), 7, 300, &[1, 1, 1]);
    check(gpu(), 24, 20, &[1, 3, 2, 1, 3, 1]);
    check(checked_gpu(), 24, 20, &[3, 1, 1]);
}

#[test]
fn eight_features_of_every_shape_are_packed() {
    check(gpu(), 13, 11, &[3; 8]);
    check(gpu(), 13, 11, &[1; 8]);
    check(gpu(), 13, 11, &[2, 1, 2, 1, 2, 1, 3, 1]);
}

#[test]
fn the_smallest_images_have_gradients() {
    for (width, height) in [(1, 1), (1, 5), (5, 1), (2, 2)] {
        check(gpu(), width, height, &[3, 1]);
    }
}
