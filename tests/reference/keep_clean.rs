//! Pixels without noise stay as they are, and so do lights of one pixel. None of the text's.

use super::variance::Signal;
use super::{Grid, Planes, Point, square};

/// Which pixels count as clean.
#[derive(Clone, Copy, Debug)]
pub struct CleanParams {
    /// The noise from which on a pixel is filtered freely, in parts of its value.
    pub noise: f64,
    /// The standard deviations that one with next to no noise may move by.
    pub sigmas: f64,
    /// The standard deviations by which a pixel may become darker, up to which it gets all of its correction …
    pub least_sigmas_out: f64,
    /// … and from which on it gets nothing of it.
    pub most_sigmas_out: f64,
    pub black_radius: usize,
}

impl Default for CleanParams {
    fn default() -> CleanParams {
        CleanParams { noise: 1e-3, sigmas: 4.0, least_sigmas_out: 4.0, most_sigmas_out: 5.0, black_radius: 3 }
    }
}

/// The square of the correction that each pixel may get: 0 where it has no noise, infinite where it has enough of it.
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

/// How much of its correction each pixel gets, and the largest squared error that it has then.
pub struct Limits {
    pub shares: Grid,
    /// Infinite where nothing limits the correction.
    pub error: Grid,
}

pub fn limits(input: &Signal, filtered: &[Grid], params: CleanParams) -> Limits {
    let (allowed, noise) = (allowed(input, params), noise(input));
    let change = |p: Point| input.mean.iter().zip(filtered).map(move |(u, f)| f.at(p) - u.at(p));
    let squared = |p: Point| change(p).map(|change| change * change).sum::<f64>();
    // What becomes darker by more than its noise explains is a light of its own.
    let of_light = |p: Point| {
        let sigmas = (squared(p) / noise.at(p)).sqrt();
        if change(p).sum::<f64>() >= 0.0 || !(sigmas > params.least_sigmas_out) {
            return 1.0;
        }
        ((params.most_sigmas_out - sigmas) / (params.most_sigmas_out - params.least_sigmas_out)).max(0.0)
    };
    let shares = noise.like(|p| {
        let clean = if squared(p) > allowed.at(p) { (allowed.at(p) / squared(p)).sqrt() } else { 1.0 };
        clean.min(of_light(p))
    });
    let error = noise.like(|p| {
        let light = of_light(p);
        let of_light = if light < 1.0 { light * light * squared(p) } else { f64::INFINITY };
        noise.at(p) + allowed.at(p).min(of_light)
    });
    Limits { shares, error }
}

/// A filtered signal in which clean pixels are those of the input.
pub struct Kept {
    pub mean: Planes,
    /// None without halves.
    pub spread: Option<Planes>,
    /// Squared, summed over the channels.
    pub error: Grid,
}

pub fn keep_clean(input: &Signal, mean: &[Grid], spread: Option<&[Grid]>, error: &Grid, params: CleanParams) -> Kept {
    let Limits { shares, error: most } = limits(input, mean, params);
    let of_halves = |spread: &[Grid]| input.spread.as_ref().map_or_else(|| spread.to_vec(), |own| kept(own, spread, &shares));
    Kept { mean: kept(&input.mean, mean, &shares), spread: spread.map(of_halves), error: error.like(|p| error.at(p).min(most.at(p))) }
}

/// What the samples of each pixel show of its variance, summed over the channels. Without sample variance two halves may agree by accident: then the pixels beside have a say too.
pub fn noise(input: &Signal) -> Grid {
    let spread = |i: usize, p: Point| input.spread.as_ref().map_or(0.0, |spread| spread[i].at(p).powi(2));
    let channels = 0..input.mean.len();
    let like = &input.mean[0];
    match &input.sample_variance {
        Some(variance) => like.like(|p| channels.clone().map(|i| variance[i].at(p).max(spread(i, p))).sum()),
        None => {
            let own = like.like(|p| channels.clone().map(|i| spread(i, p)).sum());
            let beside = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)].map(|(x, y)| Point { x, y });
            own.like(|p| beside.iter().map(|o| p + *o).filter(|&q| own.contains(q)).map(|q| own.at(q)).fold(0.0, f64::max))
        }
    }
}

/// The filtered planes, moved back to the input's by the shares.
pub fn kept(input: &[Grid], filtered: &[Grid], shares: &Grid) -> Planes {
    input.iter().zip(filtered).map(|(u, f)| u.like(|p| if shares.at(p) == 1.0 { f.at(p) } else { u.at(p) + shares.at(p) * (f.at(p) - u.at(p)) })).collect()
}
