//! Which candidate to believe (section 8.4): binary maps of the least error, smoothed, then guarded.

use super::nlm::{FilterParams, Guide, nlm_filter};
use super::{Grid, Planes, Point, channel_mean, map_pixels};

/// Candidates in the order of Algorithm 1: each is more robust, and blinder, than the one before.
pub const FIRST: usize = 0;
pub const SECOND: usize = 1;
pub const THIRD: usize = 2;

/// When a candidate may take part in the blend: where its error exceeds the least one by no more than
/// `factor · (|least error| + noise · Σ_i V_i)`.
#[derive(Clone, Copy, Debug)]
pub struct Guard {
    pub factor: f64,
    /// How far two errors may differ for no other reason than the noise of the estimate, as a share of the pixel's variance.
    pub noise: f64,
}

/// The candidate with the least error; ties go to the more robust one. FIRST must also filter more than SECOND (line 24):
/// where it keeps noise, its error estimate may not notice. An error that is not finite cannot win, and where none can,
/// THIRD does.
pub fn select(errors: &[Grid], derivatives: [&[Grid]; 3]) -> Planes {
    binary_maps(errors, |p| {
        let first_filters_more = channel_mean(derivatives[FIRST], p) < channel_mean(derivatives[SECOND], p);
        let mut winner = None;
        for k in [FIRST, SECOND, THIRD] {
            let error = errors[k].at(p);
            let eligible = error.is_finite() && (k != FIRST || first_filters_more);
            if eligible && winner.is_none_or(|w: usize| error <= errors[w].at(p)) {
                winner = Some(k);
            }
        }
        Some(winner.unwrap_or(THIRD))
    })
}

/// Lines 24 to 26 as printed, except that line 26 asks for e_b < e_g as line 25 asks for the opposite. A pixel with a tie, or
/// where FIRST has the least error but filters less than SECOND, has no winner.
pub fn select_literally(errors: &[Grid], derivatives: [&[Grid]; 3]) -> Planes {
    binary_maps(errors, |p| {
        let [r, g, b] = [FIRST, SECOND, THIRD].map(|k| errors[k].at(p));
        let [d_r, d_g] = [FIRST, SECOND].map(|k| channel_mean(derivatives[k], p));
        if r < g && r < b && d_r < d_g {
            Some(FIRST)
        } else if g < r && g < b {
            Some(SECOND)
        } else if b < r && b < g {
            Some(THIRD)
        } else {
            None
        }
    })
}

fn binary_maps(errors: &[Grid], winner: impl Fn(Point) -> Option<usize> + Sync) -> Planes {
    let (width, height) = (errors[0].width, errors[0].height);
    let winners = map_pixels(width, height, winner);
    [FIRST, SECOND, THIRD].map(|k| Grid { width, height, values: winners.iter().map(|&winner| if winner == Some(k) { 1.0 } else { 0.0 }).collect() }).to_vec()
}

/// Lines 27 to 31 of Algorithm 1, normalised. See `sure::smooth_errors` for `aside`.
pub fn smooth_maps(binary: &[Grid], guide: Guide, aside: &FilterParams) -> Planes {
    let params = FilterParams { window_radius: 5, patch_radius: 1, k_color: 1.0, k_feature: f64::INFINITY, ..*aside };
    let smoothed = nlm_filter(binary, Some(guide), &[], &params).planes;
    normalise(&smoothed, |_| THIRD)
}

/// Smoothing hands a rejected candidate some weight near the border of its region, and one that is wildly wrong there ruins the
/// blend with any weight at all: this takes such candidates out again. Where nothing is left, the winner stands alone.
pub fn guard(maps: &[Grid], errors: &[Grid], binary: &[Grid], variance: &[Grid], guard: &Guard) -> Planes {
    let guarded: Planes = (0..maps.len())
        .map(|k| {
            maps[k].like(|p| {
                let least = errors.iter().map(|error| error.at(p)).filter(|error| error.is_finite()).fold(f64::INFINITY, f64::min);
                let noise: f64 = variance.iter().map(|v| v.at(p)).sum();
                let allowance = guard.factor * (least.abs() + guard.noise * noise);
                if errors[k].at(p) - least <= allowance { maps[k].at(p) } else { 0.0 }
            })
        })
        .collect();
    normalise(&guarded, |p| {
        let won = |k: &usize| binary[*k].at(p) == 1.0;
        (0..binary.len()).find(won).unwrap_or(THIRD)
    })
}

/// Maps that sum to 1; a pixel without weights gets the fallback alone.
fn normalise(maps: &[Grid], fallback: impl Fn(Point) -> usize + Sync) -> Planes {
    (0..maps.len())
        .map(|k| {
            maps[k].like(|p| {
                let sum: f64 = maps.iter().map(|map| map.at(p)).sum();
                if sum > 0.0 {
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
