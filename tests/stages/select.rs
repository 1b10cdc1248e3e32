//! `error_sure`, the `select_` stages and `sample_density`: from the candidates to their average and to the sampling
//! density.

use std::sync::Arc;

use stein::gpu::{Buffer, Gpu, Recorder};
use stein::stage::candidate::Candidates;
use stein::stage::candidate_filter::CandidateFilter;
use stein::stage::error::{ErrorParts, error_blend, error_blend_more, error_difference, error_spikes, error_sure};
use stein::stage::nlm::Filtered;
use stein::stage::sample::{GpuSamples, sample_density};
use stein::stage::select::{
    Evidence, Guard, Harm, Noisy, Significance, WithColorOnly, select_blend, select_color_only, select_frames,
    select_frames_of_filtered, select_least, select_pass, select_share,
};

use crate::common::{
    Scene, assert_near, checked_gpu, extent_of, flat, gpu, own_size, packed, packed_signal, read, rounded, run, scene,
    upload,
};
use crate::reference::dfc::{Pass, limited};
use crate::reference::random::Random;
use crate::reference::{self, Grid, Planes, Point};

/// Gives a device.
type Device = fn() -> &'static Gpu;

/// Devices, odd sizes, and how many candidates there are: one, two, the thesis's three, as many as a plane of numbers
/// holds, one more, all there may be.
const SIZES_AND_COUNTS: [(Device, usize, usize, usize); 9] = [
    (gpu, 257, 89, 3),
    (gpu, 7, 300, 3),
    (gpu, 1, 1, 3),
    (checked_gpu, 24, 20, 3),
    (gpu, 7, 300, 2),
    (gpu, 31, 43, 4),
    (gpu, 31, 43, 5),
    (gpu, 257, 89, 8),
    (checked_gpu, 24, 20, 1),
];

const NAMES: [&str; 8] = ["0", "1", "2", "3", "4", "5", "6", "7"];

/// Filters, of which the first has the second as its rival, and the fifth the third.
fn filters(count: usize) -> Vec<CandidateFilter> {
    let rival = |k: usize| match k {
        0 => Some(NAMES[1]),
        4 => Some(NAMES[2]),
        _ => None,
    };
    (0..count).map(|k| CandidateFilter { name: NAMES[k], color: None, features: None, rival: rival(k) }).collect()
}

/// The place of each rival among so many filters.
fn rivals(count: usize) -> Vec<Option<usize>> {
    let rival = |k: usize| [Some(1), None, None, None, Some(2), None, None, None][k].filter(|rival| *rival < count);
    (0..count).map(rival).collect()
}

/// Filtered images and derivatives, independent of each other.
struct Bank {
    means: Vec<Planes>,
    spreads: Vec<Planes>,
    derivatives: Vec<Planes>,
    weight_sums: Vec<Grid>,
}

impl Bank {
    fn count(&self) -> usize {
        self.means.len()
    }
}

fn bank(width: usize, height: usize, count: usize) -> Bank {
    seeded_bank(width, height, count, 41)
}

fn seeded_bank(width: usize, height: usize, count: usize, seed: u64) -> Bank {
    let mut random = Random(seed);
    let mut planes = |low: f64, high: f64| -> Planes {
        (0..3).map(|_| rounded(random.uniform_grid(width, height, low, high))).collect()
    };
    Bank {
        means: (0..count).map(|_| planes(-1.0, 3.0)).collect(),
        spreads: (0..count).map(|_| planes(-0.2, 0.2)).collect(),
        derivatives: (0..count).map(|_| planes(-0.5, 1.5)).collect(),
        weight_sums: (0..count).map(|_| planes(1.0, 400.0).remove(0)).collect(),
    }
}

fn upload_bank(rec: &mut Recorder, bank: &Bank) -> stein::Result<Candidates> {
    let planes = |of: &[Planes]| of.iter().flat_map(|planes| packed(planes)).collect::<Vec<f32>>();
    let with_sums = bank.means.iter().zip(&bank.weight_sums);
    let means: Vec<Planes> =
        with_sums.map(|(mean, sum)| [mean.as_slice(), std::slice::from_ref(sum)].concat()).collect();
    Ok(Candidates {
        filters: filters(bank.count()),
        means: Arc::new(rec.upload("means", &planes(&means))?),
        spreads: Arc::new(rec.upload("half spreads", &planes(&bank.spreads))?),
        derivatives: Some(Arc::new(rec.upload("derivatives", &planes(&bank.derivatives))?)),
        payload: Vec::new(),
    })
}

/// Values for each candidate, packed four to a plane.
fn upload_numbers(rec: &mut Recorder, numbers: &[Grid]) -> stein::Result<Buffer> {
    let planes: Vec<f32> = numbers.chunks(4).flat_map(packed).collect();
    rec.upload("numbers", &planes)
}

/// The values of this many candidates, followed by the unused ones of the last plane.
fn numbers(planes: Vec<Planes>) -> Planes {
    planes.into_iter().flatten().collect()
}

#[test]
fn sure_is_equation_8_5() {
    for (gpu, width, height, count) in SIZES_AND_COUNTS {
        let gpu = gpu();
        let (scene, bank) = (scene(width, height, 42), bank(width, height, count));
        let extent = extent_of(&scene.mean[0]);
        let buffer = run(gpu, |rec| {
            let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
            let variance = upload(rec, &scene.variance)?;
            let candidates = upload_bank(rec, &bank)?;
            error_sure(rec, extent, &signal, &variance, &candidates, 1.5)
        });
        let sure =
            |k: usize| reference::sure::sure(&scene.mean, &scene.variance, &bank.means[k], &bank.derivatives[k], 1.5);
        let expected: Planes = (0..count).map(sure).collect();
        // The terms cancel; each is rounded by itself.
        let terms = |k: usize| {
            let (means, derivatives) = (&bank.means[k], &bank.derivatives[k]);
            scene.mean[0].like(|p| {
                let term = |i: usize| {
                    let (residual, variance) = (means[i].at(p) - scene.mean[i].at(p), scene.variance[i].at(p));
                    residual * residual + variance * (1.0 + 3.0 * derivatives[i].at(p).abs())
                };
                (0..3).map(term).sum()
            })
        };
        let scale: Planes = (0..count).map(terms).collect();
        let actual = numbers(read(gpu, &buffer, extent));
        let (actual, rest) = actual.split_at(count);
        assert_near(&format!("error_sure, {width}×{height}, {count}"), actual, &expected, &scale, 1e-6, 0.0);
        assert!(rest.iter().flat_map(|grid| &grid.values).all(|value| *value == 0.0), "nothing is left to chance");
    }
}

/// Derivatives far outside 0 to 1, candidates without a share, and a single candidate in place of the blend.
#[test]
fn the_error_of_a_blend_has_four_parts() {
    let parts = ErrorParts { spread: 0.75, disagreement: 2.0, own_noise: 0.375, spikes: 3.0 };
    let twin_parts = reference::sure::ErrorParts { spread: 0.75, disagreement: 2.0, own_noise: 0.375, spikes: 3.0 };
    for (gpu, width, height, count) in SIZES_AND_COUNTS {
        let gpu = gpu();
        let (scene, mut bank) = (scene(width, height, 48), bank(width, height, count));
        let extent = extent_of(&scene.mean[0]);
        let mut random = Random(49);
        bank.derivatives
            .iter_mut()
            .flatten()
            .for_each(|plane| *plane = rounded(random.uniform_grid(width, height, -1.0, 2.0)));
        let shares: Planes = (0..count)
            .map(|_| {
                let share = random.uniform_grid(width, height, -0.5, 1.0);
                rounded(share.like(|p| share.at(p).max(0.0)))
            })
            .collect();
        // Half of the pixels got no energy of a spike.
        let squares = random.uniform_grid(width, height, -1.0, 1.0);
        let squares = rounded(squares.like(|p| squares.at(p).max(0.0)));
        for (shared, with_spikes) in [(true, true), (false, true), (true, false)] {
            if !shared && count > 1 {
                continue;
            }
            let buffer = run(gpu, |rec| {
                let blended = rec.upload("blend", &packed_signal(&scene.mean, &scene.spread))?;
                let (variance, shares) = (upload(rec, &scene.variance)?, upload_numbers(rec, &shares)?);
                let candidates = upload_bank(rec, &bank)?;
                let shares = shared.then_some(&shares);
                let planes =
                    [vec![f32::NAN; 8 * width * height], packed(&[squares.clone(), squares.clone(), squares.clone()])]
                        .concat();
                let spikes = if with_spikes { Some(rec.upload("spikes", &planes)?) } else { None };
                let errors = error_blend(rec, extent, &blended, &variance, &candidates, shares, parts)?;
                match &spikes {
                    Some(spikes) => error_spikes(rec, extent, errors, spikes, parts),
                    None => Ok(errors),
                }
            });
            let all = scene.mean[0].like(|_| 1.0);
            let share = |k: usize| if shared { &shares[k] } else { &all };
            // A single candidate is the blend.
            let mean = |k: usize| if shared { bank.means[k].as_slice() } else { scene.mean.as_slice() };
            let part =
                |k: usize| reference::sure::Part { share: share(k), mean: mean(k), derivative: &bank.derivatives[k] };
            let made_of: Vec<_> = (0..count).map(part).collect();
            let expected = [reference::sure::error_blend(
                &scene.mean,
                Some(&scene.spread),
                &scene.variance,
                &made_of,
                with_spikes.then_some(&squares),
                twin_parts,
            )];
            let what = format!("error_blend, {width}×{height}, {count}, shared {shared}, spikes {with_spikes}");
            assert_near(&what, &read(gpu, &buffer, extent).remove(0), &expected, &own_size(&expected, 0.0), 2e-6, 0.0);
            assert!(expected[0].values.iter().all(|error| *error >= 0.0));
        }
    }
}

/// Shares of so many candidates that sum to 1, some of which are 0.
fn shares_of(count: usize, width: usize, height: usize, seed: u64) -> Planes {
    let mut random = Random(seed);
    let raw: Planes = (0..count).map(|_| random.uniform_grid(width, height, -0.3, 1.0)).collect();
    let total = raw[0].like(|p| raw.iter().map(|grid| grid.at(p).max(0.0)).sum::<f64>());
    (0..count)
        .map(|k| {
            rounded(raw[k].like(|p| {
                if total.at(p) > 0.0 { raw[k].at(p).max(0.0) / total.at(p) } else { f64::from(u8::from(k == 0)) }
            }))
        })
        .collect()
}

/// One filter, near the first of a bank.
fn color_only_of(bank: &Bank, width: usize, height: usize) -> Bank {
    let mut other = seeded_bank(width, height, 1, 61);
    for (own, of_bank) in other.means[0].iter_mut().zip(&bank.means[0]) {
        *own = rounded(own.like(|p| 0.7 * of_bank.at(p) + 0.3 * own.at(p)));
    }
    other
}

const SIZES_OF_BLENDS: [(Device, usize, usize, usize); 5] =
    [(gpu, 257, 89, 3), (gpu, 7, 300, 3), (gpu, 1, 1, 3), (checked_gpu, 24, 20, 3), (gpu, 31, 43, 6)];

#[test]
fn sure_of_a_blend_is_compared_with_that_of_one_filter_more() {
    for (gpu, width, height, count) in SIZES_OF_BLENDS {
        let gpu = gpu();
        let (scene, bank) = (scene(width, height, 62), bank(width, height, count));
        let (shares, other) = (shares_of(count, width, height, 63), color_only_of(&bank, width, height));
        let extent = extent_of(&scene.mean[0]);
        let buffer = run(gpu, |rec| {
            let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
            let variance = upload(rec, &scene.variance)?;
            let blended = rec.upload("blend", &packed_signal(&bank.means[0], &bank.spreads[0]))?;
            let (candidates, other) = (upload_bank(rec, &bank)?, upload_bank(rec, &other)?);
            let shares = upload_numbers(rec, &shares)?;
            error_difference(rec, extent, &signal, &variance, &blended, &shares, &candidates, &other, 1.5)
        });
        let mixed =
            |i: usize| scene.mean[0].like(|p| (0..count).map(|k| shares[k].at(p) * bank.derivatives[k][i].at(p)).sum());
        let derivative: Planes = (0..3).map(mixed).collect();
        let of_blend = reference::sure::sure(&scene.mean, &scene.variance, &bank.means[0], &derivative, 1.5);
        let of_other = reference::sure::sure(&scene.mean, &scene.variance, &other.means[0], &other.derivatives[0], 1.5);
        let difference = reference::select::differences(&of_other, &of_blend, &scene.variance);
        let terms = |p: Point| {
            let term = |i: usize| {
                let residuals = (bank.means[0][i].at(p) - scene.mean[i].at(p)).powi(2)
                    + (other.means[0][i].at(p) - scene.mean[i].at(p)).powi(2);
                residuals
                    + scene.variance[i].at(p)
                        * (2.0 + 3.0 * derivative[i].at(p).abs() + 3.0 * other.derivatives[0][i].at(p).abs())
            };
            (0..3).map(term).sum::<f64>()
        };
        let actual = read(gpu, &buffer, extent).remove(0);
        let squares = difference.like(|p| difference.at(p).powi(2));
        let scale = [difference.like(terms), difference.like(|p| terms(p) * (terms(p) + difference.at(p).abs()))];
        assert_near(&format!("error_difference, {width}×{height}"), &actual, &[difference, squares], &scale, 2e-6, 0.0);
    }
}

#[test]
fn the_colour_only_gets_a_share_where_it_is_significantly_better() {
    for (gpu, width, height, count) in SIZES_OF_BLENDS {
        let gpu = gpu();
        let bank = bank(width, height, count);
        let (shares, other) = (shares_of(count, width, height, 64), color_only_of(&bank, width, height));
        let extent = extent_of(&shares[0]);
        let noise = Random(65).gaussian_grid(width, height, 0.0, 1.0);
        // From clearly better on the left to clearly worse on the right.
        let difference = rounded(noise.like(|p| noise.at(p) + 0.8 * (2.0 * (p.x as f64 + 0.5) / width as f64 - 1.0)));
        let squares = rounded(difference.like(|p| difference.at(p).powi(2)));
        let (found, left) = run(gpu, |rec| {
            let differences = upload(rec, &[difference.clone(), squares.clone()])?;
            let blend = rec.upload("blend", &packed_signal(&bank.means[0], &bank.spreads[0]))?;
            let (color_only, shares) = (upload_bank(rec, &other)?, upload_numbers(rec, &shares)?);
            let significance = Significance::MEASURED;
            let found =
                select_color_only(rec, extent, &differences, &blend, count, &color_only, &shares, significance)?;
            Ok((found, shares))
        });
        let WithColorOnly { blended, shares: of_color_only } = found;
        let share = reference::select::color_only_share(&difference, reference::select::Significance::default());
        let what = |part: &str| format!("select_color_only, {width}×{height}: {part}");
        let actual = read(gpu, &of_color_only, extent).remove(0);
        // A mean of hundreds of values over its standard error.
        let share = [share];
        assert_near(&what("share"), &actual[..1], &share, &flat(&share, 1.0), 1e-3, 0.0);
        let share = actual[0].clone();
        let rest = reference::dfc::rest_of(&shares, &share);
        assert_near(&what("rest"), &numbers(read(gpu, &left, extent))[..count], &rest, &flat(&rest, 1.0), 1e-6, 0.0);
        let blended = read(gpu, &blended, extent);
        for (part, actual, a, b) in [
            ("mean", &blended[0], &bank.means[0], &other.means[0]),
            ("spread", &blended[1], &bank.spreads[0], &other.spreads[0]),
        ] {
            let expected: Planes = a
                .iter()
                .zip(b)
                .map(|(a, b)| a.like(|p| (1.0 - share.at(p)) * a.at(p) + share.at(p) * b.at(p)))
                .collect();
            assert_near(&what(part), &actual[..3], &expected, &flat(&expected, 4.0), 1e-6, 0.0);
        }
        let mean = share.values.iter().sum::<f64>() / share.values.len() as f64;
        assert!(width < 257 || (mean > 0.1 && mean < 0.9), "{mean} of the pixels go to the colour");
    }
}

#[test]
fn what_further_candidates_stand_for_is_added_to_the_error() {
    let parts = ErrorParts { spread: 0.75, disagreement: 2.0, own_noise: 0.375, spikes: 3.0 };
    let twin_parts = reference::sure::ErrorParts { spread: 0.0, disagreement: 2.0, own_noise: 0.375, spikes: 3.0 };
    for (gpu, width, height) in [(gpu(), 31, 43), (gpu(), 1, 1), (checked_gpu(), 24, 20)] {
        let (scene, bank) = (scene(width, height, 66), bank(width, height, 1));
        let extent = extent_of(&scene.mean[0]);
        let mut random = Random(67);
        let (before, share) = (
            rounded(random.uniform_grid(width, height, 0.0, 2.0)),
            rounded(random.uniform_grid(width, height, 0.0, 1.0)),
        );
        let buffer = run(gpu, |rec| {
            let blended = rec.upload("blend", &packed_signal(&scene.mean, &scene.spread))?;
            let variance = upload(rec, &scene.variance)?;
            let candidates = upload_bank(rec, &bank)?;
            let (shares, errors) =
                (upload(rec, std::slice::from_ref(&share))?, upload(rec, std::slice::from_ref(&before))?);
            error_blend_more(rec, extent, &blended, &variance, &candidates, &shares, parts, errors)
        });
        let part = reference::sure::Part { share: &share, mean: &bank.means[0], derivative: &bank.derivatives[0] };
        let added = reference::sure::error_blend(&scene.mean, None, &scene.variance, &[part], None, twin_parts);
        let expected = [before.like(|p| before.at(p) + added.at(p))];
        assert_near(
            "error_blend_more",
            &read(gpu, &buffer, extent).remove(0),
            &expected,
            &own_size(&expected, 0.0),
            2e-6,
            0.0,
        );
    }
}

/// Errors with ties and with NaN.
fn errors(width: usize, height: usize, count: usize) -> Planes {
    let mut random = Random(43);
    let mut plane = || {
        let level = random.uniform_grid(width, height, -2.0, 4.0);
        rounded(level.like(|p| match (level.at(p) * 1e6) as i64 % 11 {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => f64::NEG_INFINITY,
            3..7 => level.at(p).round(),
            _ => level.at(p),
        }))
    };
    (0..count).map(|_| plane()).collect()
}

fn selected(gpu: &Gpu, errors: &[Grid], bank: &Bank) -> Planes {
    let extent = extent_of(&errors[0]);
    let buffer = run(gpu, |rec| {
        let (errors, candidates) = (upload_numbers(rec, errors)?, upload_bank(rec, bank)?);
        select_least(rec, extent, &errors, &candidates)
    });
    let mut maps = numbers(read(gpu, &buffer, extent));
    let rest = maps.split_off(bank.count());
    assert!(rest.iter().flat_map(|grid| &grid.values).all(|value| *value == 0.0), "nothing is left to chance");
    maps
}

#[test]
fn the_least_error_wins() {
    for (gpu, width, height, count) in SIZES_AND_COUNTS {
        let (errors, bank) = (errors(width, height, count), bank(width, height, count));
        let actual = selected(gpu(), &errors, &bank);
        let derivatives: Vec<_> = bank.derivatives.iter().map(Vec::as_slice).collect();
        let expected = reference::select::select(&errors, &derivatives, &rivals(count));
        let what = format!("select_least, {width}×{height}, {count}");
        assert_near(&what, &actual, &expected, &flat(&expected, 1.0), 1e-9, 0.0);
        let wins: Vec<f64> = actual.iter().map(Grid::mean).collect();
        assert!(width * height < 100 || wins.iter().all(|share| *share > 0.04), "{wins:?}");
    }
}

fn check_shares_and_blend(gpu: &Gpu, width: usize, height: usize, rule: Option<Guard>, count: usize) {
    let (scene, bank) = (scene(width, height, 44), bank(width, height, count));
    let mut random = Random(45);
    let extent = extent_of(&scene.mean[0]);
    let mut error = |spoiled: Option<f64>| {
        let (level, chance) = (random.gaussian_grid(width, height, 0.02, 0.3), random.uniform());
        // The guard excludes errors that are not finite, in favour of the last candidate; without a guard the result of
        // such an error is undefined.
        let is_spoiled =
            |p: Point| rule.is_some() && spoiled.is_some() && ((p.x + 7 * p.y) as f64 * (0.1 + chance)).fract() < 0.1;
        rounded(level.like(|p| if is_spoiled(p) { spoiled.unwrap_or_default() } else { level.at(p) }))
    };
    // The last candidate wins if no error is finite, so its errors are finite here.
    let spoiled = |k: usize| [Some(f64::INFINITY), Some(f64::NAN)][k % 2].filter(|_| k + 1 < count);
    let errors: Planes = (0..count).map(|k| error(spoiled(k))).collect();
    let winners = selected(gpu, &errors, &bank);
    let sure = |k: usize, own: Grid| own.like(|p| if errors[k].at(p).is_finite() { own.at(p) } else { f64::INFINITY });
    let sure: Planes = (0..count).map(|k| sure(k, rounded(random.gaussian_grid(width, height, 0.02, 0.5)))).collect();
    // In some pixels no map has any weight, and rounding may leave one below 0.
    let holes = random.uniform_grid(width, height, 0.0, 1.0);
    let smoothed: Planes = (0..count)
        .map(|_| {
            let share = random.uniform_grid(width, height, -0.1, 0.9);
            rounded(share.like(|p| if holes.at(p) < 0.1 { 0.0 } else { share.at(p) }))
        })
        .collect();
    let (selection, signal) = run(gpu, |rec| {
        let mut upload_numbers = |numbers: &[Grid]| upload_numbers(rec, numbers);
        let (smoothed, winners) = (upload_numbers(&smoothed)?, upload_numbers(&winners)?);
        let (errors, sure) = (upload_numbers(&errors)?, upload_numbers(&sure)?);
        let variance = upload(rec, &scene.variance)?;
        let candidates = upload_bank(rec, &bank)?;
        let evidence = Evidence {
            selected: &winners,
            errors: &errors,
            sure: &sure,
            variance_of_mean: &variance,
            candidates: &candidates,
        };
        let shares = select_share(rec, extent, smoothed, evidence, rule)?;
        let blended = select_blend(rec, extent, Some(&shares), &candidates)?;
        Ok((shares, blended))
    });
    let (selection, signal) = (numbers(read(gpu, &selection, extent)), read(gpu, &signal, extent));

    let positive: Planes = smoothed.iter().map(|grid| grid.like(|p| grid.at(p).max(0.0))).collect();
    let rule_twin = rule.map(|rule| reference::select::Guard {
        smoothed_error: rule.smoothed_error.into(),
        smoothed_noise: rule.smoothed_noise.into(),
        own_sigmas: rule.own_sigmas.into(),
        own_noise: rule.own_noise.into(),
    });
    let evidence = reference::select::Evidence {
        errors: &errors,
        binary_maps: &winners,
        sure: &sure,
        candidates: &bank.means.iter().map(Vec::as_slice).collect::<Vec<_>>(),
        variance: &scene.variance,
    };
    let maps = reference::select::share(&positive, evidence, rule_twin.as_ref());
    let what = |part: &str| format!("select_share and select_blend, {width}×{height}, {count}, {rule:?}: {part}");
    // Shares are quotients of a few products. A candidate whose error is within rounding of the guard's limit may go
    // either way; there is none in these images.
    assert_near(&what("maps"), &selection[..count], &maps, &flat(&maps, 1.0), 1e-6, 0.0);
    let average = |planes: Vec<&Grid>| maps[0].like(|p| maps.iter().zip(&planes).map(|(m, g)| m.at(p) * g.at(p)).sum());
    let size = |planes: Vec<&Grid>| maps[0].like(|p| planes.iter().map(|grid| grid.at(p).abs()).sum());
    let all = |k: usize| [bank.means[k].as_slice(), &[bank.weight_sums[k].clone()], &bank.spreads[k]].concat();
    let candidates: Vec<Planes> = (0..count).map(all).collect();
    let channel = |i: usize| candidates.iter().map(|planes| &planes[i]).collect();
    let expected: Planes = (0..7).map(|i| average(channel(i))).collect();
    let scale: Planes = (0..7).map(|i| size(channel(i))).collect();
    assert_near(&what("signal"), &signal.concat()[..7], &expected, &scale, 1e-6, 0.0);
    let rejected = maps.iter().flat_map(|grid| &grid.values).filter(|share| **share == 0.0).count();
    assert!(width * height < 100 || count == 1 || rejected > width * height / 10, "{rejected} shares of 0");
}

#[test]
fn candidates_are_averaged_by_their_maps() {
    let best = Guard { smoothed_error: 4.0, smoothed_noise: 0.3, own_sigmas: 8.0, own_noise: 4.0 };
    let strict = Guard { smoothed_error: 0.0, smoothed_noise: 0.0, own_sigmas: 0.0, own_noise: 0.0 };
    let rules = [
        best,
        strict,
        Guard { own_noise: 1e6, ..best },
        Guard { smoothed_noise: 1e6, own_sigmas: 0.5, own_noise: 0.1, ..best },
    ];
    for rule in rules.map(Some).into_iter().chain([None]) {
        for (gpu, width, height, count) in SIZES_AND_COUNTS {
            check_shares_and_blend(gpu(), width, height, rule, count);
        }
    }
}

#[test]
fn other_frames_are_left_out_where_they_do_harm() {
    let rule = Harm { sigmas: 0.5, noise: 0.25 };
    let twin_rule =
        reference::select::Guard { smoothed_error: 4.0, smoothed_noise: 0.3, own_sigmas: 0.5, own_noise: 0.25 };
    for (gpu, width, height, count) in SIZES_OF_BLENDS {
        let gpu = gpu();
        let scene = scene(width, height, 50);
        let [alone, together] = [51, 52].map(|seed| seeded_bank(width, height, count, seed));
        let extent = extent_of(&scene.mean[0]);
        let chosen = run(gpu, |rec| {
            let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
            let variance = upload(rec, &scene.variance)?;
            let (alone, together) = (upload_bank(rec, &alone)?, upload_bank(rec, &together)?);
            let noisy = Noisy { signal: &signal, variance_of_mean: &variance };
            select_frames(rec, extent, noisy, &alone, &together, rule)?;
            Ok(together)
        });
        let (means, spreads) = (read(gpu, &chosen.means, extent), read(gpu, &chosen.spreads, extent));
        let derivatives = chosen.derivatives.map(|derivatives| read(gpu, &derivatives, extent)).unwrap_or_default();
        for k in 0..count {
            let (signal, derivatives) = ([&means[k], &spreads[k]], &derivatives[k]);
            let sure = |bank: &Bank| {
                reference::sure::sure(&scene.mean, &scene.variance, &bank.means[k], &bank.derivatives[k], 1.0)
            };
            let (sure_alone, sure_together) = (sure(&alone), sure(&together));
            let of_alone = reference::select::Filtered { mean: &alone.means[k], sure: &sure_alone };
            let of_together = reference::select::Filtered { mean: &together.means[k], sure: &sure_together };
            let harmed = |p| reference::select::harmed(of_together, of_alone, &scene.variance, &twin_rule, p);
            let choose = |alone: &[Grid], together: &[Grid]| -> Planes {
                alone.iter().zip(together).map(|(a, b)| a.like(|p| if harmed(p) { a.at(p) } else { b.at(p) })).collect()
            };
            let what = |part: &str| format!("select_frames, {width}×{height}, candidate {k}: {part}");
            for (part, actual, alone, together) in [
                ("mean", &signal[0][..3], &alone.means[k][..], &together.means[k][..]),
                ("Σ w", &signal[0][3..], &alone.weight_sums[k..=k], &together.weight_sums[k..=k]),
                ("half spread", &signal[1][..3], &alone.spreads[k], &together.spreads[k]),
                ("derivatives", &derivatives[..3], &alone.derivatives[k], &together.derivatives[k]),
            ] {
                let expected = choose(alone, together);
                assert_near(&what(part), actual, &expected, &own_size(&expected, 0.0), 1e-12, 0.0);
            }
            let left_out = choose(&alone.means[k], &together.means[k])[0]
                .values
                .iter()
                .zip(&alone.means[k][0].values)
                .filter(|(a, b)| a == b)
                .count();
            assert!(
                width * height < 100 || (width * height / 20..width * height * 19 / 20).contains(&left_out),
                "{left_out} pixels"
            );
        }
    }
}

/// Weights that do not depend on the noise of the averaged image: the derivative is the centre's share.
#[test]
fn other_frames_are_left_out_of_one_filter_where_they_do_harm() {
    let (rule, twin_rule) = (
        Harm { sigmas: 0.5, noise: 0.25 },
        reference::select::Guard { smoothed_error: 0.0, smoothed_noise: 0.0, own_sigmas: 0.5, own_noise: 0.25 },
    );
    let (width, height) = (57, 31);
    let scene = scene(width, height, 53);
    let [alone, together] = [54, 55].map(|seed| seeded_bank(width, height, 1, seed));
    let extent = extent_of(&scene.mean[0]);
    let chosen = run(gpu(), |rec| {
        let signal = rec.upload("signal", &packed_signal(&scene.mean, &scene.spread))?;
        let variance = upload(rec, &scene.variance)?;
        let mut filtered = |of: &Bank| {
            let (planes, weights) = (
                rec.upload("filtered", &packed_signal(&of.means[0], &of.spreads[0]))?,
                upload(rec, &of.weight_sums[..1])?,
            );
            Ok::<_, stein::Error>(Filtered { planes, weights, residual_variance: None })
        };
        let (alone, together) = (filtered(&alone)?, filtered(&together)?);
        select_frames_of_filtered(
            rec,
            extent,
            Noisy { signal: &signal, variance_of_mean: &variance },
            &alone,
            &together,
            rule,
        )?;
        Ok(together)
    });
    let sure = |bank: &Bank| {
        let derivative = vec![bank.weight_sums[0].like(|p| 1.0 / bank.weight_sums[0].at(p)); 3];
        reference::sure::sure(&scene.mean, &scene.variance, &bank.means[0], &derivative, 1.0)
    };
    let (sure_alone, sure_together) = (sure(&alone), sure(&together));
    let of_alone = reference::select::Filtered { mean: &alone.means[0], sure: &sure_alone };
    let of_together = reference::select::Filtered { mean: &together.means[0], sure: &sure_together };
    let choose = |a: &Grid, b: &Grid| {
        a.like(|p| {
            if reference::select::harmed(of_together, of_alone, &scene.variance, &twin_rule, p) {
                a.at(p)
            } else {
                b.at(p)
            }
        })
    };
    let expected: Planes = (0..3).map(|i| choose(&alone.means[0][i], &together.means[0][i])).collect();
    assert_near(
        "the filtered colour",
        &read(gpu(), &chosen.planes, extent)[0][..3],
        &expected,
        &own_size(&expected, 0.0),
        1e-12,
        0.0,
    );
    let expected = [choose(&alone.weight_sums[0], &together.weight_sums[0])];
    assert_near("Σ w", &read(gpu(), &chosen.weights, extent)[0][..1], &expected, &own_size(&expected, 0.0), 1e-12, 0.0);
    assert!(expected[0].values != alone.weight_sums[0].values && expected[0].values != together.weight_sums[0].values);
}

#[test]
fn a_second_pass_is_taken_where_noise_explains_it() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 24, 20)] {
        // Both from one scene, so that corrections and noise have similar sizes.
        let (before, after) = (scene(width, height, 48), scene(width, height, 49));
        let buffer = run(gpu, |rec| {
            let pass1 = rec.upload("pass 1", &packed_signal(&before.mean, &before.spread))?;
            let pass2 = rec.upload("pass 2", &packed_signal(&after.mean, &after.spread))?;
            let variance = upload(rec, &before.variance)?;
            select_pass(rec, extent_of(&before.mean[0]), &pass1, &pass2, &variance, 1.5)
        });
        let pass = |of: &Scene| Pass { mean: of.mean.clone(), spread: Some(of.spread.clone()) };
        let expected = limited(&pass(&before), &pass(&after), &before.variance, 1.5);
        let result = read(gpu, &buffer, extent_of(&before.mean[0]));
        let what = format!("select_pass, {width}×{height}");
        assert_near(&what, &result[0][..3], &expected.mean, &own_size(&expected.mean, 0.0), 1e-12, 0.0);
        let spread = expected.spread.unwrap_or_default();
        assert_near(&what, &result[1][..3], &spread, &own_size(&spread, 0.0), 1e-12, 0.0);
        let kept = expected.mean[0].values.iter().zip(&before.mean[0].values).filter(|(a, b)| a == b).count();
        assert!(
            width * height < 100 || (width * height / 20..width * height * 19 / 20).contains(&kept),
            "{kept} pixels stay"
        );
    }
}

#[test]
fn samples_are_wanted_where_they_pay() {
    for (gpu, width, height) in [(gpu(), 257, 89), (gpu(), 7, 300), (gpu(), 1, 1), (checked_gpu(), 24, 20)] {
        let (scene, bank) = (scene(width, height, 46), bank(width, height, 1));
        let extent = extent_of(&scene.mean[0]);
        let mut random = Random(47);
        let (error, counts) = (
            rounded(random.uniform_grid(width, height, 0.0, 2.0)),
            rounded(random.uniform_grid(width, height, 1.0, 99.0)),
        );
        // With halves the error comes from the spread, without halves from the given error.
        let left = error.like(|p| scene.spread.iter().map(|plane| plane.at(p) * plane.at(p)).sum());
        for (vary, halves) in [(false, false), (true, false), (false, true), (true, true)] {
            let buffer = run(gpu, |rec| {
                let blended = rec.upload(
                    "blend",
                    &packed_signal(&[scene.mean.as_slice(), &bank.weight_sums[..1]].concat(), &scene.spread),
                )?;
                let errors = upload(rec, std::slice::from_ref(&error))?;
                let samples = if vary {
                    GpuSamples::PerPixel(upload(rec, std::slice::from_ref(&counts))?)
                } else {
                    GpuSamples::Uniform(31.0)
                };
                sample_density(rec, extent, &blended, (!halves).then_some(&errors), &samples)
            });
            let expected = reference::sure::sample_density(
                &scene.mean,
                if halves { &left } else { &error },
                &bank.weight_sums[0],
                0.0,
            );
            let expected = [expected.like(|p| expected.at(p) / (1.0 + if vary { counts.at(p) } else { 31.0 }))];
            let what = format!("sample_density, {width}×{height}, counts {vary}, halves {halves}");
            assert_near(&what, &read(gpu, &buffer, extent).remove(0), &expected, &own_size(&expected, 0.0), 2e-6, 0.0);
        }
    }
}
