//! The choice between the candidates (section 8.4): binary maps of the least error, smoothed, then guarded.

use super::gaussian::gaussian;
use super::nlm::{FilterParams, Guide, nlm_filter};
use super::{Grid, Planes, Point, channel_mean, map_pixels};

/// The guard: when a candidate may take part in the blend of a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Guard {
    /// Where its smoothed error exceeds the winner's by no more than
    /// `smoothed_error · |winner's error| + smoothed_noise · Σ_i V_i` …
    pub smoothed_error: f64,
    /// … where the second term allows for the noise of the estimate.
    pub smoothed_noise: f64,
    /// And where its unsmoothed SURE exceeds the least one, that of G, by no more than `own_sigmas` standard deviations
    /// `2·√Σ_i V_i·(F_i − G_i)²` of their difference …
    pub own_sigmas: f64,
    /// … and `own_noise · Σ_i V_i`.
    pub own_noise: f64,
}

/// The candidate with the least error; ties go to the later one, which is more robust. A candidate with a rival must
/// also filter more than the rival, as FIRST more than SECOND (line 24), because its error estimate may miss noise that
/// it keeps. An error that is not finite cannot win; if no error is finite, the last candidate wins.
pub fn select(errors: &[Grid], derivatives: &[&[Grid]], rivals: &[Option<usize>]) -> Planes {
    let (width, height) = (errors[0].width, errors[0].height);
    let winners = map_pixels(width, height, |p| {
        let mut winner = None;
        for k in 0..errors.len() {
            let filters_more =
                rivals[k].is_none_or(|rival| channel_mean(derivatives[k], p) < channel_mean(derivatives[rival], p));
            let error = errors[k].at(p);
            if error.is_finite() && filters_more && winner.is_none_or(|w: usize| error <= errors[w].at(p)) {
                winner = Some(k);
            }
        }
        winner.unwrap_or(errors.len() - 1)
    });
    let map = |k: usize| winners.iter().map(|&winner| if winner == k { 1.0 } else { 0.0 }).collect();
    (0..errors.len()).map(|k| Grid { width, height, values: map(k) }).collect()
}

/// Lines 27 to 31 of Algorithm 1, normalised. See `sure::smooth_errors` for `aside`.
pub fn smooth_maps(binary: &[Grid], guide: Guide, aside: &FilterParams) -> Planes {
    let params = FilterParams { window_radius: 5, patch_radius: 1, k_color: 1.0, k_feature: f64::INFINITY, ..*aside };
    let smoothed = nlm_filter(binary, Some(guide), &[], &params).planes;
    normalise(&smoothed, |_| binary.len() - 1)
}

/// The winner by the smoothed errors has at least this share, so that the shares do not vanish if it alone passes the
/// guard …
const SMALLEST_SHARE_OF_WINNER: f64 = 1e-6;
/// … and the winner by the pixel's own errors has this one, which matters if the first winner fails the second rule.
const SMALLEST_SHARE_OF_OWN_WINNER: f64 = 1e-9;

/// Values that the guard compares.
#[derive(Clone, Copy)]
pub struct Evidence<'a> {
    /// Smoothed.
    pub errors: &'a [Grid],
    pub binary_maps: &'a [Grid],
    /// Not smoothed.
    pub sure: &'a [Grid],
    /// The filtered colours.
    pub candidates: &'a [&'a [Grid]],
    pub variance: &'a [Grid],
}

/// Smoothing gives a rejected candidate some weight near the border of its region. If the candidate is far wrong there,
/// any weight ruins the blend: the guard removes such candidates. Smoothed errors also miss a single clean pixel among
/// noisy ones, so the guard compares the pixel's own errors too. Without a guard the maps are only normalised.
pub fn share(maps: &[Grid], evidence: Evidence, guard: Option<&Guard>) -> Planes {
    let Evidence { errors, binary_maps, sure, candidates, variance } = evidence;
    let count = maps.len();
    let noise = |p: Point| variance.iter().map(|v| v.at(p)).sum::<f64>();
    let winner = |p: Point| (0..count).find(|&k| binary_maps[k].at(p) == 1.0).unwrap_or(count - 1);
    let Some(guard) = guard else { return normalise(maps, winner) };
    // Ties go to the later one. None if no error is finite.
    let own_winner = |p: Point| {
        let finite = (0..count).rev().filter(|&k| sure[k].at(p).is_finite());
        finite.reduce(|least, k| if sure[k].at(p) < sure[least].at(p) { k } else { least })
    };
    let guarded: Planes = (0..count)
        .map(|k| {
            maps[k].like(|p| {
                let least = errors[winner(p)].at(p);
                let allowance = guard.smoothed_error * least.abs() + guard.smoothed_noise * noise(p);
                let mut share = if errors[k].at(p) - least <= allowance { maps[k].at(p) } else { 0.0 };
                if k == winner(p) {
                    share = share.max(SMALLEST_SHARE_OF_WINNER);
                }

                let Some(best) = own_winner(p) else { return 0.0 };
                if sure[k].at(p) - sure[best].at(p) > by_chance(candidates[k], candidates[best], variance, guard, p) {
                    share = 0.0;
                }
                if k == best { share.max(SMALLEST_SHARE_OF_OWN_WINNER) } else { share }
            })
        })
        .collect();
    normalise(&guarded, winner)
}

/// The chance difference of SURE between two filtered values of a pixel has the standard deviation 2·√Σ σ_i²(F_i −
/// G_i)².
fn by_chance(f: &[Grid], g: &[Grid], variance: &[Grid], guard: &Guard, p: Point) -> f64 {
    let apart = |i: usize| f[i].at(p) - g[i].at(p);
    let deviation = 2.0 * (0..variance.len()).map(|i| variance[i].at(p) * apart(i) * apart(i)).sum::<f64>().sqrt();
    guard.own_sigmas * deviation + guard.own_noise * variance.iter().map(|v| v.at(p)).sum::<f64>()
}

/// The advantage that the filter by the colour only needs over the candidates' blend.
#[derive(Clone, Copy, Debug)]
pub struct Significance {
    /// σ of the Gaussian that averages the differences of SURE, cut off at 3σ.
    pub sigma: f64,
    /// Advantage in standard errors from which on it gets a share, and from which on it gets everything.
    pub least: f64,
    pub most: f64,
}

impl Default for Significance {
    fn default() -> Significance {
        Significance { sigma: 3.0, least: 1.5, most: 3.0 }
    }
}

/// The excess of one filter's SURE over the other's; 0 if float32 could not distinguish them.
pub fn differences(of_color_only: &Grid, of_blend: &Grid, variance: &[Grid]) -> Grid {
    of_color_only.like(|p| {
        let (a, b) = (of_color_only.at(p), of_blend.at(p));
        let terms = a.abs() + b.abs() + variance.iter().map(|plane| plane.at(p)).sum::<f64>();
        if (a - b).abs() > 1e-5 * terms { (a - b).clamp(-1e15, 1e15) } else { 0.0 }
    })
}

/// The share of the filter by the colour only: how many standard errors the average difference lies below 0. Σ w² of a
/// Gaussian is 1/(4πσ²).
pub fn color_only_share(differences: &Grid, params: Significance) -> Grid {
    let radius = (3.0 * params.sigma).ceil() as usize;
    let mean = gaussian(differences, params.sigma, radius);
    let squares = gaussian(&differences.like(|p| differences.at(p).powi(2)), params.sigma, radius);
    let pixels = 4.0 * std::f64::consts::PI * params.sigma * params.sigma;
    mean.like(|p| {
        let standard_error = ((squares.at(p) - mean.at(p).powi(2)).max(0.0) / pixels).sqrt();
        let better_by = -mean.at(p) / standard_error.max(1e-30);
        ((better_by - params.least) / (params.most - params.least)).clamp(0.0, 1.0)
    })
}

/// A candidate in one window, and its SURE.
#[derive(Clone, Copy)]
pub struct Filtered<'a> {
    pub mean: &'a [Grid],
    pub sure: &'a Grid,
}

/// Whether the neighbouring frames harm a pixel, which is then filtered in its own frame alone.
pub fn harmed(together: Filtered, alone: Filtered, variance: &[Grid], guard: &Guard, p: Point) -> bool {
    together.sure.at(p) - alone.sure.at(p) > by_chance(together.mean, alone.mean, variance, guard, p)
}

/// Maps that sum to 1; a pixel without weights gets the fallback alone.
fn normalise(maps: &[Grid], fallback: impl Fn(Point) -> usize + Sync) -> Planes {
    (0..maps.len())
        .map(|k| {
            maps[k].like(|p| {
                let sum: f64 = maps.iter().map(|map| map.at(p)).sum();
                if sum > 1e-20 {
                    maps[k].at(p) / sum
                } else if k == fallback(p) {
                    1.0
                } else {
                    0.0
                }
            })
        })
        .collect()
}
