//! The stages of the payload: layers averaged with the weights of the candidates, blended, mixed, chosen by scale,
//! taken as halves, and freed from spikes where the colour has them.

use std::sync::Arc;

use glam::IVec2;
use stein::error::Result;
use stein::gpu::{Gpu, Recorder};
use stein::stage::candidate::{CandidateFrame, Needed, candidates};
use stein::stage::candidate_filter::CandidateFilter;
use stein::stage::frames::Frames;
use stein::stage::nlm::{CentreWeight, Schedule};
use stein::stage::payload::{
    Half, MixShare, PayloadGroup, payload_blend, payload_copy, payload_half, payload_mix, payload_repair, payload_scale,
};
use stein::stage::spike::{SpikeRule, spike_find, spike_spread};

use crate::candidate::{Case, filters, some_filters, twin_params, upload_variance, window_of};
use crate::common::{
    Scene, assert_near, bits, calm_scene, checked_gpu, extent_of, flat, gpu, own_size, packed, packed_signal, read,
    rounded, run, schedules, upload,
};
use crate::feature::{features, pack};
use crate::reference::nlm::{Feature, Guide};
use crate::reference::random::Random;
use crate::reference::spike::{SpikeParams, repaired_payload};
use crate::reference::variance::Signal;
use crate::reference::{Grid, Planes, Point};
use crate::spike::{FLIPPED, spiky_scene};
use crate::{FILTERED, FilteredTwin, filtered_twin};

const SIZES: [(usize, usize); 3] = [(257, 89), (7, 300), (1, 1)];

/// Layers that have nothing to do with the colour.
fn layers(width: usize, height: usize, channels: usize, seed: u64) -> Planes {
    let mut random = Random(seed);
    (0..channels).map(|_| rounded(random.uniform_grid(width, height, -1.0, 3.0))).collect()
}

/// Uploads channels as groups of up to four planes, four channels to a plane.
fn groups(rec: &mut Recorder, channels: &[Grid]) -> Result<Vec<PayloadGroup>> {
    let groups = channels.chunks(16).map(|group| {
        let planes: Vec<&[Grid]> = group.chunks(4).collect();
        let values: Vec<f32> = planes.iter().flat_map(|plane| packed(plane)).collect();
        Ok(PayloadGroup { buffer: Arc::new(rec.upload("payload", &values)?), planes: planes.len() as u32 })
    });
    groups.collect()
}

/// The channels of groups.
fn channels_of(gpu: &Gpu, groups: &[PayloadGroup], extent: IVec2, channels: usize) -> Planes {
    groups.iter().flat_map(|group| read(gpu, &group.buffer, extent)).flatten().take(channels).collect()
}

/// Shares of candidates that sum to 1.
fn shares(width: usize, height: usize, count: usize, seed: u64) -> Planes {
    let mut random = Random(seed);
    let parts: Planes = (0..count).map(|_| random.uniform_grid(width, height, 0.01, 1.0)).collect();
    let sum = |p: Point| parts.iter().map(|part| part.at(p)).sum::<f64>();
    parts.iter().map(|part| rounded(part.like(|p| part.at(p) / sum(p)))).collect()
}

struct Blended {
    groups: Vec<PayloadGroup>,
    extent: IVec2,
}

#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
fn blended(
    gpu: &Gpu,
    case: Case,
    filters: &[CandidateFilter],
    scene: &Scene,
    guides: &[Feature],
    payload: &[Grid],
    shares: Option<&[Grid]>,
    schedule: Schedule,
) -> Blended {
    let extent = extent_of(&scene.mean[0]);
    let groups = run(gpu, |rec| {
        let signal = &rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
        let variance_of_mean = &upload_variance(rec, scene)?;
        let guides = if guides.is_empty() { None } else { Some(pack(rec, guides)?) };
        let layers = &groups(rec, payload)?;
        let frame =
            CandidateFrame { payload: signal, guide: None, variance_of_mean, features: guides.as_ref(), layers };
        let (frames, window) = (Frames::one(frame), window_of(case));
        let needed = Needed { derivatives: false, ..Needed::EVERYTHING };
        let mut found = candidates(rec, extent, &frames, filters, window, needed, schedule, |_, _| Ok(()))?.together;
        let shares = shares.map(|shares| upload(rec, shares)).transpose()?;
        let sums = std::mem::take(&mut found.payload);
        payload_blend(rec, extent, shares.as_ref(), &found, layers, sums, None)
    });
    Blended { groups, extent }
}

/// Every combination of filters, with and without shares.
fn check(gpu: &Gpu, case: Case, takes_part: [bool; 3], channels: usize) {
    let filters = some_filters(case, takes_part);
    let scene = calm_scene(case.width, case.height, 91);
    let guides =
        if case.features.is_empty() { Vec::new() } else { features(case.width, case.height, case.features, 92) };
    let payload = layers(case.width, case.height, channels, 93);
    let shares = (filters.len() > 1).then(|| shares(case.width, case.height, filters.len(), 94));
    let Blended { groups, extent } =
        blended(gpu, case, &filters, &scene, &guides, &payload, shares.as_deref(), Schedule::SOFTWARE);
    let guide = Guide { mean: &scene.mean, variance: &scene.variance };
    let of_candidates: Vec<FilteredTwin> = filters
        .iter()
        .map(|filter| filtered_twin(&payload, Some(guide), &guides, &twin_params(case, filter)))
        .collect();
    let share = |k: usize, p: Point| shares.as_ref().map_or(1.0, |shares| shares[k].at(p));
    let sum = |value: &dyn Fn(&FilteredTwin, usize) -> Grid| -> Planes {
        (0..channels)
            .map(|i| {
                let planes: Planes = of_candidates.iter().map(|twin| value(twin, i)).collect();
                planes[0].like(|p| planes.iter().enumerate().map(|(k, plane)| share(k, p) * plane.at(p)).sum())
            })
            .collect()
    };
    let expected = sum(&|twin, i| twin.planes[i].clone());
    let span = sum(&|twin, i| twin.span[i].clone());
    let actual = channels_of(gpu, &groups, extent, channels);
    assert_near(&format!("{case:?}, {takes_part:?}"), &actual, &expected, &span, FILTERED, 0.0);
}

const CASE: Case = Case {
    width: 257,
    height: 89,
    window_radius: 2,
    patch_radii: [1, 3],
    features: &[3, 1],
    symmetric: true,
    centre: CentreWeight::LargestNeighbour,
};

#[test]
fn layers_are_averaged_with_the_weights_of_the_candidates() {
    for (width, height) in SIZES {
        check(gpu(), Case { width, height, ..CASE }, [true; 3], 5);
    }
    // More than one group, and all combinations of filters.
    let small = Case { width: 23, height: 31, window_radius: 3, ..CASE };
    for takes_part in [[true, true, false], [true, false, true], [false, true, true], [true, false, false]] {
        check(gpu(), small, takes_part, 18);
    }
    check(gpu(), small, [false, false, true], 2);
    check(gpu(), Case { features: &[], symmetric: false, centre: CentreWeight::One, ..small }, [true; 3], 3);
    check(checked_gpu(), Case { width: 19, height: 14, ..small }, [true; 3], 7);
}

#[test]
fn every_schedule_gives_the_same_bits() {
    let case = Case { width: 37, height: 25, window_radius: 4, ..CASE };
    let scene = calm_scene(case.width, case.height, 95);
    let guides = features(case.width, case.height, case.features, 96);
    let payload = layers(case.width, case.height, 6, 97);
    let shares = shares(case.width, case.height, 3, 98);
    let result = |schedule| {
        let filters = filters(case);
        let blended = blended(gpu(), case, &filters, &scene, &guides, &payload, Some(&shares), schedule);
        blended.groups.iter().flat_map(|group| bits(gpu(), &group.buffer)).collect::<Vec<_>>()
    };
    let whole = result(Schedule { scratch_bytes: 64 << 20, block_rows: 16, ..Schedule::SOFTWARE });
    for schedule in schedules() {
        assert!(result(schedule) == whole, "{schedule:?}");
    }
}

#[test]
fn spikes_of_the_colour_are_taken_out_of_layers() {
    let sizes = [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 31, 9)];
    for (gpu, width, height) in sizes {
        for (channels, is_spread) in [(&[3][..], true), (&[][..], true), (&[3, 1][..], false)] {
            let scene = spiky_scene(width, height, 31);
            let guides: Vec<Feature> =
                if channels.is_empty() { Vec::new() } else { features(width, height, channels, 32) };
            let extent = extent_of(&scene.mean[0]);
            let rule = SpikeRule::DEFAULT;
            // Seven channels: the fourth belongs to all channels of the colour, and the last plane is not full.
            let payload = layers(width, height, 7, 33);
            let repaired = run(gpu, |rec| {
                let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
                let variance = upload(rec, &scene.variance)?;
                let packed = if guides.is_empty() { None } else { Some(pack(rec, &guides)?) };
                let packed = packed.as_ref();
                let mut found = spike_find(rec, extent, &signal, Some(&variance), packed, &rule)?;
                let levels = if is_spread { Some(spike_spread(rec, extent, packed, &rule, &mut found)?) } else { None };
                let layers = groups(rec, &payload)?;
                payload_repair(rec, extent, &signal, packed, &rule, &found, levels.as_ref(), &layers)
            });
            let params = SpikeParams {
                share_limit: if is_spread { SpikeParams::default().share_limit } else { None },
                ..SpikeParams::default()
            };
            let color = Signal {
                mean: scene.mean.clone(),
                spread: Some(scene.spread.clone()),
                sample_variance: Some(scene.variance.clone()),
            };
            let (first, second) = payload.split_at(4);
            let mut expected = repaired_payload(&color, &guides, &params, first);
            expected.extend(repaired_payload(&color, &guides, &params, second));
            let actual = channels_of(gpu, &repaired, extent, 7);
            let size: Planes = expected.iter().map(|grid| grid.like(|p| grid.at(p).abs() + 1.0)).collect();
            let what = format!("{width}×{height}, features {channels:?}, spread {is_spread}");
            assert_near(&what, &actual, &expected, &size, 1e-5, FLIPPED);
            if width > 1 && is_spread {
                let differing = actual[0].values.iter().zip(&payload[0].values).filter(|(a, b)| a != b).count();
                assert!(differing > 5, "{what}: {differing} pixels differ");
            }
        }
    }
}

#[test]
fn two_versions_are_mixed_by_a_share() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 31, 9)] {
        let extent = IVec2::new(width as i32, height as i32);
        let (first, second) = (layers(width, height, 18, 41), layers(width, height, 18, 42));
        let share = rounded(Random(43).uniform_grid(width, height, 0.0, 1.0));
        // All of one version in some pixels, to the bit.
        let share = share.like(|p| if p.x % 3 == 0 { share.at(p).round() } else { share.at(p) });
        let nothing = Grid::filled(width, height, 7.0);
        let signal: Planes = vec![nothing.clone(), nothing.clone(), nothing.clone(), share.clone()];
        let mixed =
            |share: &dyn Fn(&mut Recorder) -> Result<Vec<PayloadGroup>>| channels_of(gpu, &run(gpu, share), extent, 18);
        let of_signal = mixed(&|rec| {
            let (first, second) = (groups(rec, &first)?, groups(rec, &second)?);
            let signal = rec.upload("signal", &packed_signal(std::slice::from_ref(&nothing), &signal))?;
            payload_mix(rec, extent, first, second, MixShare::OfSignal(&signal))
        });
        let of_plane = mixed(&|rec| {
            let (first, second) = (groups(rec, &first)?, groups(rec, &second)?);
            let plane = upload(rec, std::slice::from_ref(&share))?;
            payload_mix(rec, extent, first, second, MixShare::Plane(&plane))
        });
        let even = mixed(&|rec| {
            let (first, second) = (groups(rec, &first)?, groups(rec, &second)?);
            payload_mix(rec, extent, first, second, MixShare::Even(0.25))
        });
        let copied = mixed(&|rec| {
            let first = groups(rec, &first)?;
            payload_copy(rec, extent, &first)
        });
        let expected = |share: &(dyn Fn(Point) -> f64 + Sync)| -> Planes {
            let mix = |(a, b): (&Grid, &Grid)| a.like(|p| (1.0 - share(p)) * a.at(p) + share(p) * b.at(p));
            first.iter().zip(&second).map(mix).collect()
        };
        let by_share = expected(&|p| share.at(p));
        let size = flat(&by_share, 3.0);
        assert_near("shares of a signal", &of_signal, &by_share, &size, 1e-6, 0.0);
        assert_near("shares of a plane", &of_plane, &by_share, &size, 1e-6, 0.0);
        assert_near("a quarter", &even, &expected(&|_| 0.25), &size, 1e-6, 0.0);
        assert_eq!(copied, first, "a copy");
        for ((mixed, first), second) in of_signal.iter().zip(&first).zip(&second) {
            for (i, share) in share.values.iter().enumerate() {
                assert!(*share != 0.0 || mixed.values[i] == first.values[i]);
                assert!(*share != 1.0 || mixed.values[i] == second.values[i]);
            }
        }
    }
}

#[test]
fn layers_follow_the_scale_of_the_colour() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 31, 9)] {
        let extent = IVec2::new(width as i32, height as i32);
        let (fine, coarse) = (layers(width, height, 10, 51), layers(width, height, 10, 52));
        let reached = Random(53).uniform_grid(width, height, 0.0, 3.0);
        let sigma = reached.like(|p| [0.0, 2.0, 4.0][reached.at(p) as usize % 3]);
        let selected = run(gpu, |rec| {
            let choice = upload(rec, std::slice::from_ref(&sigma))?;
            let (fine, coarse) = (groups(rec, &fine)?, groups(rec, &coarse)?);
            payload_scale(rec, extent, &choice, 2.0, &coarse[0].buffer, &fine[0])?;
            Ok(fine)
        });
        let choose =
            |(fine, coarse): (&Grid, &Grid)| fine.like(|p| if sigma.at(p) == 2.0 { coarse.at(p) } else { fine.at(p) });
        let expected: Planes = fine.iter().zip(&coarse).map(choose).collect();
        assert_eq!(channels_of(gpu, &selected, extent, 10), expected, "{width}×{height}");
    }
}

/// Where the spread of the colour was narrowed, to 0 or to a part, the layer's is narrowed as much.
#[test]
fn halves_of_layers_are_narrowed_like_the_colour() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 31, 9)] {
        let extent = IVec2::new(width as i32, height as i32);
        let (mean, spread) = (layers(width, height, 4, 61), layers(width, height, 4, 62));
        let before = layers(width, height, 3, 63);
        let held = rounded(Random(64).uniform_grid(width, height, -1.0, 4.0));
        let after: Planes = before
            .iter()
            .map(|plane| plane.like(|p| plane.at(p).clamp(-held.at(p).max(0.0), held.at(p).max(0.0))))
            .collect();
        let ratio = |i: usize, p: Point| {
            let (before, after) = (before[i].at(p), after[i].at(p));
            if after.abs() < before.abs() { after / before } else { 1.0 }
        };
        let least = |p: Point| (0..3).map(|i| ratio(i, p)).fold(1.0, f64::min);
        for (half, sign) in [(Half::A, 1.0), (Half::B, -1.0)] {
            let made = run(gpu, |rec| {
                let nothing = Grid::filled(width, height, 9.0);
                let [before, after] = [&before, &after]
                    .map(|spread| rec.upload("signal", &packed_signal(std::slice::from_ref(&nothing), spread)));
                let (payload, spreads) = (groups(rec, &mean)?, groups(rec, &spread)?);
                payload_half(rec, extent, half, &payload[0], &spreads[0].buffer, [&before?, &after?])
            });
            let plane = |i: usize| {
                let factor = |p: Point| if i < 3 { ratio(i, p) } else { least(p) };
                mean[i].like(|p| mean[i].at(p) + sign * factor(p) * spread[i].at(p))
            };
            let expected: Planes = (0..4).map(plane).collect();
            let actual = channels_of(gpu, &[made], extent, 4);
            assert_near(&format!("{half:?}"), &actual, &expected, &own_size(&expected, 3.0), 1e-6, 0.0);
        }
    }
}
