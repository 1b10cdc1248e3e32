//! Pixels without noise stay as they are. Not in the thesis.

use super::variance::Signal;
use super::{Grid, Planes, Point, square};

/// Which pixels count as clean.
#[derive(Clone, Copy, Debug)]
pub struct CleanParams {
    /// Noise from which on a pixel is filtered freely, relative to its value.
    pub noise: f64,
    /// Largest change of a pixel with almost no noise, in standard deviations.
    pub sigmas: f64,
    pub black_radius: usize,
}

impl Default for CleanParams {
    fn default() -> CleanParams {
        CleanParams { noise: 1e-3, sigmas: 4.0, black_radius: 3 }
    }
}

/// The square of the largest correction of each pixel: 0 without noise, infinite with enough noise.
pub fn allowed(input: &Signal, params: CleanParams) -> Grid {
    let noise = noise(input);
    let value = |p: Point| input.mean.iter().map(|plane| plane.at(p).powi(2)).sum::<f64>();
    noise.like(|p| {
        if value(p) == 0.0 {
            let mut around = square(params.black_radius).map(|o| p + o).filter(|&q| noise.contains(q));
            return if around.all(|q| value(q) == 0.0 && noise.at(q) == 0.0) { 0.0 } else { f64::INFINITY };
        }
        let closeness = noise.at(p) / (params.noise * params.noise * value(p));
        if closeness >= 1.0 { f64::INFINITY } else { params.sigmas * params.sigmas * noise.at(p) / (1.0 - closeness) }
    })
}

/// The share of its correction that each pixel gets.
pub fn clean_shares(input: &Signal, filtered: &[Grid], params: CleanParams) -> Grid {
    let allowed = allowed(input, params);
    allowed.like(|p| {
        let correction: f64 = input.mean.iter().zip(filtered).map(|(u, f)| (f.at(p) - u.at(p)).powi(2)).sum();
        if correction > allowed.at(p) { (allowed.at(p) / correction).sqrt() } else { 1.0 }
    })
}

/// A filtered signal with clean pixels replaced by those of the input.
pub struct Kept {
    pub mean: Planes,
    /// None without halves.
    pub spread: Option<Planes>,
    /// Squared, summed over the channels.
    pub error: Grid,
}

pub fn keep_clean(input: &Signal, mean: &[Grid], spread: Option<&[Grid]>, error: &Grid, params: CleanParams) -> Kept {
    let shares = clean_shares(input, mean, params);
    let of_halves =
        |spread: &[Grid]| input.spread.as_ref().map_or_else(|| spread.to_vec(), |own| kept(own, spread, &shares));
    Kept {
        mean: kept(&input.mean, mean, &shares),
        spread: spread.map(of_halves),
        error: kept_error(error, input, params),
    }
}

/// The variance that the samples of each pixel show, summed over the channels. Without sample variance two halves may
/// agree by accident, so the neighbours count too.
pub fn noise(input: &Signal) -> Grid {
    let spread = |i: usize, p: Point| input.spread.as_ref().map_or(0.0, |spread| spread[i].at(p).powi(2));
    let channels = 0..input.mean.len();
    let like = &input.mean[0];
    match &input.sample_variance {
        Some(variance) => like.like(|p| channels.clone().map(|i| variance[i].at(p).max(spread(i, p))).sum()),
        None => {
            let own = like.like(|p| channels.clone().map(|i| spread(i, p)).sum());
            let beside = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)].map(|(x, y)| Point { x, y });
            own.like(|p| {
                beside.iter().map(|o| p + *o).filter(|&q| own.contains(q)).map(|q| own.at(q)).fold(0.0, f64::max)
            })
        }
    }
}

/// The filtered planes, moved towards the input by the shares.
pub fn kept(input: &[Grid], filtered: &[Grid], shares: &Grid) -> Planes {
    input
        .iter()
        .zip(filtered)
        .map(|(u, f)| {
            u.like(|p| if shares.at(p) == 1.0 { f.at(p) } else { u.at(p) + shares.at(p) * (f.at(p) - u.at(p)) })
        })
        .collect()
}

/// The squared error of kept pixels: at most their noise and the allowed correction.
pub fn kept_error(error: &Grid, input: &Signal, params: CleanParams) -> Grid {
    let (noise, allowed) = (noise(input), allowed(input, params));
    error.like(|p| error.at(p).min(noise.at(p) + allowed.at(p)))
}
