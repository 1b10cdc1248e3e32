//! Greedy error minimisation (chapter 6): all scales, all stopping maps, then for each pixel the finest scale whose map
//! says stop.

use super::gaussian::{gaussian, gaussian_neighbours, gaussian_variance};
use super::keep_clean::{CleanParams, Kept, keep_clean};
use super::noise::{NoiseParams, completed};
use super::spike::{self, Lights, SpikeParams};
use super::variance::{BoxWeight, Signal, input_variance};
use super::{Grid, Planes, Point};

/// γ, the scales, and how outliers are removed (6.2.4, 6.4).
#[derive(Clone, Debug)]
pub struct GemParams {
    pub gamma: f64,
    /// σ from fine to coarse, in pixels, without the pixel filter.
    pub sigmas: Vec<f64>,
    /// Size of the outlier filter, in sizes of the coarse scale.
    pub outlier_size: f64,
    pub coarser_only: bool,
    /// None: spikes stay.
    pub spikes: Option<SpikeParams>,
    /// None: pixels without noise are filtered like all others.
    pub keep_clean: Option<CleanParams>,
    /// None: missing variances are smoothed squares of the half spread.
    pub noise: Option<NoiseParams>,
}

impl GemParams {
    pub fn while_sampling(gamma: f64) -> Self {
        Self {
            gamma,
            sigmas: vec![1.0, 2.0, 4.0, 8.0],
            outlier_size: 1.0,
            coarser_only: false,
            spikes: None,
            keep_clean: None,
            noise: None,
        }
    }

    pub fn for_the_final_image(gamma: f64, outlier_size: f64) -> Self {
        Self {
            gamma,
            sigmas: (1..=8).map(|step| 2f64.powf(0.5 * f64::from(step))).collect(),
            outlier_size,
            coarser_only: true,
            spikes: None,
            keep_clean: None,
            noise: None,
        }
    }
}

/// The image at one scale.
#[derive(Clone, Debug)]
pub struct Scale {
    /// 0 for the pixel filter.
    pub sigma: f64,
    pub mean: Planes,
    pub spread: Planes,
    pub variance: Planes,
    /// Mean number of samples per pixel; 0 if unknown.
    pub samples: Grid,
    /// Number of pixels that take part, 1/Σw².
    pub pixels: Grid,
}

fn radius(sigma: f64) -> usize {
    (3.0 * sigma).ceil() as usize
}

/// Everything at a coarser scale: variances with the squared filter (equation 6.2).
pub fn scaled(pixel: &Scale, sigma: f64) -> Scale {
    let mean = |grid: &Grid| gaussian(grid, sigma, radius(sigma));
    let variance = |grid: &Grid| gaussian_variance(grid, sigma, radius(sigma));
    let of_one = variance(&pixel.samples.like(|_| 1.0));
    Scale {
        sigma,
        mean: pixel.mean.iter().map(mean).collect(),
        spread: pixel.spread.iter().map(mean).collect(),
        variance: pixel.variance.iter().map(variance).collect(),
        samples: mean(&pixel.samples),
        pixels: of_one.like(|p| 1.0 / of_one.at(p)),
    }
}

/// z(γ) of section 6.2.3.
pub fn bias_weight(gamma: f64) -> f64 {
    -(1.0 - (1.9 * gamma).powf(1.0 / 2f64.sqrt())).ln()
}

/// One comparison of a fine and a coarse scale, summed over the channels.
#[derive(Clone, Debug)]
pub struct Step {
    pub bias_term: Grid,
    pub variance_term: Grid,
}

impl Step {
    pub fn selector(&self, p: Point) -> f64 {
        self.bias_term.at(p) + self.variance_term.at(p)
    }

    /// The binary stopping map.
    pub fn stops(&self) -> Grid {
        self.bias_term.like(|p| f64::from(self.selector(p) > 0.0))
    }
}

/// Equation 6.1 with the bias term weighted by ρ·z(γ).
pub fn step(fine: &Scale, coarse: &Scale, bias_weight: f64) -> Step {
    let (r_f, r_c) = (fine.sigma, coarse.sigma);
    let factor = if r_f == 0.0 { 1.0 } else { (r_c * r_c + r_f * r_f) / (r_c * r_c - r_f * r_f) };
    let rho = |p: Point| {
        let n = coarse.samples.at(p);
        // One sample has no variance.
        if n == 0.0 { 1.0 } else { 1.0 - 1.0 / n.max(2.0) }
    };
    let squared_change = |p: Point| (0..3).map(|i| (coarse.mean[i].at(p) - fine.mean[i].at(p)).powi(2)).sum::<f64>();
    let change_of_variance = |p: Point| (0..3).map(|i| coarse.variance[i].at(p) - fine.variance[i].at(p)).sum::<f64>();
    Step {
        bias_term: fine.samples.like(|p| rho(p) * bias_weight * factor * squared_change(p)),
        variance_term: fine.samples.like(change_of_variance),
    }
}

/// The map with its outliers removed: rounded, and in the final reconstruction only from 1 to 0.
pub fn decided(stops: &Grid, smoothed: &Grid, coarser_only: bool) -> Grid {
    stops.like(|p| {
        let rounded = f64::from(smoothed.at(p) >= 0.5);
        if coarser_only { rounded.min(stops.at(p)) } else { rounded }
    })
}

/// The choice for each pixel.
#[derive(Clone, Debug)]
pub struct Chosen {
    pub sigma: Grid,
    pub mean: Planes,
    pub spread: Planes,
    /// Variance of the finest scale and the estimated changes of the MSE up to the chosen one, summed over the
    /// channels.
    pub error: Grid,
    pub pixels: Grid,
    /// Samples in the support.
    pub support: Grid,
}

/// The finest scale whose map is 1; the coarsest scale if there is none. `steps[k]` and `maps[k]` compare `scales[k]`
/// with `scales[k + 1]`.
pub fn choose(scales: &[Scale], steps: &[Step], maps: &[Grid]) -> Chosen {
    let like = &scales[0].samples;
    let level = |p: Point| maps.iter().position(|map| map.at(p) == 1.0).unwrap_or(maps.len());
    let plane = |of: &(dyn Fn(&Scale) -> &Grid + Sync)| like.like(|p| of(&scales[level(p)]).at(p));
    let finest_variance = |p: Point| scales[0].variance.iter().map(|grid| grid.at(p)).sum::<f64>();
    let pixels = plane(&|scale| &scale.pixels);
    let samples = plane(&|scale| &scale.samples);
    Chosen {
        sigma: like.like(|p| scales[level(p)].sigma),
        mean: (0..3).map(|i| plane(&|scale| &scale.mean[i])).collect(),
        spread: (0..3).map(|i| plane(&|scale| &scale.spread[i])).collect(),
        error: like.like(|p| finest_variance(p) + steps[..level(p)].iter().map(|step| step.selector(p)).sum::<f64>()),
        support: pixels.like(|p| pixels.at(p) * samples.at(p)),
        pixels,
    }
}

/// All values of GEM.
pub struct Gem {
    /// The input without spikes and lights of few pixels.
    pub color: Signal,
    /// None where spikes stay.
    pub lights: Option<Lights>,
    pub variance: Planes,
    /// The pixel filter first.
    pub scales: Vec<Scale>,
    pub steps: Vec<Step>,
    pub smoothed: Vec<Grid>,
    pub chosen: Chosen,
}

pub fn gem(color: &Signal, samples: &Grid, params: &GemParams) -> Gem {
    let completed = params.noise.map(|noise| completed(color, &[], &[], &noise).0);
    let color = completed.as_ref().unwrap_or(color);
    let repaired = params.spikes.map(|params| spike::repaired(color, &[], &params));
    let color = repaired.as_ref().map_or(color, |repaired| &repaired.signal);
    let variance = input_variance(color, BoxWeight::Even);
    let zero = || color.mean.iter().map(|grid| grid.like(|_| 0.0)).collect();
    let spread = color.spread.clone().unwrap_or_else(zero);
    let pixel = Scale {
        sigma: 0.0,
        mean: color.mean.clone(),
        spread,
        variance: variance.clone(),
        samples: samples.clone(),
        pixels: samples.like(|_| 1.0),
    };
    let mut scales = vec![pixel];
    scales.extend(params.sigmas.iter().map(|&sigma| scaled(&scales[0], sigma)).collect::<Vec<_>>());
    let steps: Vec<Step> = scales.windows(2).map(|pair| step(&pair[0], &pair[1], bias_weight(params.gamma))).collect();
    let smooth = |(step, sigma): (&Step, &f64)| {
        gaussian_neighbours(&step.stops(), params.outlier_size * sigma, radius(params.outlier_size * sigma))
    };
    let smoothed: Vec<Grid> = steps.iter().zip(&params.sigmas).map(smooth).collect();
    let maps: Vec<Grid> = steps
        .iter()
        .zip(&smoothed)
        .map(|(step, smoothed)| decided(&step.stops(), smoothed, params.coarser_only))
        .collect();
    let chosen = choose(&scales, &steps, &maps);
    Gem {
        color: color.clone(),
        lights: repaired.as_ref().map(|repaired| repaired.lights.clone()),
        variance,
        scales,
        steps,
        smoothed,
        chosen,
    }
}

/// The choice, with clean pixels and lights replaced by those of the input.
pub fn result(gem: &Gem, chosen: &Chosen, params: &GemParams) -> Kept {
    let Chosen { mean, spread, error, .. } = chosen;
    let kept = match params.keep_clean {
        Some(clean) => keep_clean(&gem.color, mean, Some(spread), error, clean),
        None => Kept { mean: mean.clone(), spread: Some(spread.clone()), error: error.clone() },
    };
    match &gem.lights {
        Some(lights) => lights.added_to(kept),
        None => kept,
    }
}

/// Estimated error relative to the squared value (section 6.3), for three channels.
pub fn relative_mse(chosen: &Chosen) -> Grid {
    chosen.error.like(|p| chosen.error.at(p) / chosen.mean.iter().map(|grid| grid.at(p).powi(2) + 0.001).sum::<f64>())
}
