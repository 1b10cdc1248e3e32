//! Spikes: pixels that stand out from those of their kind, and rest on very few samples for it.

use super::nlm::Feature;
use super::variance::Signal;
use super::{Grid, Planes, Point, channel_mean, square};

/// What makes a spike, and how it is spread.
#[derive(Clone, Copy, Debug)]
pub struct SpikeParams {
    pub window_radius: usize,
    pub spread_radius: usize,
    pub least_neighbours: usize,
    /// Above the level, in distances from the level to the third brightest neighbour.
    pub prominence: f64,
    pub most_samples: f64,
    /// None: what stands out is lost.
    pub share_limit: Option<f64>,
    pub k_feature: f64,
    pub tau: f64,
}

/// What renders turned out to want.
impl Default for SpikeParams {
    fn default() -> SpikeParams {
        SpikeParams {
            window_radius: 3,
            spread_radius: 13,
            least_neighbours: 12,
            prominence: 3.0,
            most_samples: 2.0,
            share_limit: Some(0.1),
            k_feature: 0.6,
            tau: 0.1,
        }
    }
}

pub struct Repaired {
    pub signal: Signal,
    /// What was taken from each pixel.
    pub taken: Planes,
    /// Which part of it the pixels around got.
    pub part: Grid,
    /// The squares of what each pixel got, summed over spikes and channels.
    pub squares: Grid,
}

struct Spike {
    level: Vec<f64>,
    /// By its neighbours' claims.
    variance: Vec<f64>,
    excess: Vec<f64>,
    /// Which part of the excess goes to how many pixels in its place.
    part: f64,
    members: f64,
}

pub fn repaired(color: &Signal, features: &[Feature], params: &SpikeParams) -> Repaired {
    let mean = &color.mean;
    let spikes: Vec<Option<Spike>> = super::map_pixels(mean[0].width, mean[0].height, |p| spike(color, features, params, p));
    let at = |p: Point| spikes[mean[0].index(p)].as_ref();
    let received = |i: usize, q: Point, power: i32| {
        let from = square(params.spread_radius).map(|o| q + o).filter(|&p| mean[0].contains(p));
        let share = |p: Point| {
            at(p).filter(|_| alike(features, params, p, q)).map_or(0.0, |spike| falloff(params, p, q) * spike.part * spike.excess[i] / spike.members)
        };
        if is_noisy(color, q) { from.map(|p| share(p).powi(power)).sum::<f64>() } else { 0.0 }
    };
    let channels = 0..mean.len();
    let plane = |i: usize| mean[i].like(|p| at(p).map_or(mean[i].at(p), |spike| spike.level[i]) + received(i, p, 1));
    let spread = |planes: &Planes| {
        let held = |i: usize, p: Point| at(p).map_or(f64::INFINITY, |spike| spike.variance[i].sqrt());
        planes.iter().enumerate().map(|(i, plane)| plane.like(|p| plane.at(p).clamp(-held(i, p), held(i, p)))).collect()
    };
    let variance = |planes: &Planes| planes.iter().enumerate().map(|(i, plane)| plane.like(|p| at(p).map_or(plane.at(p), |spike| spike.variance[i]))).collect();
    Repaired {
        signal: Signal {
            mean: channels.clone().map(plane).collect(),
            spread: color.spread.as_ref().map(spread),
            sample_variance: color.sample_variance.as_ref().map(variance),
        },
        squares: mean[0].like(|p| channels.clone().map(|i| received(i, p, 2)).sum()),
        taken: channels.map(|i| mean[i].like(|p| at(p).map_or(0.0, |spike| spike.excess[i]))).collect(),
        part: mean[0].like(|p| at(p).map_or(0.0, |spike| spike.part)),
    }
}

fn spike(color: &Signal, features: &[Feature], params: &SpikeParams, p: Point) -> Option<Spike> {
    let mean = &color.mean;
    let window = |radius: usize| square(radius).map(move |o| p + o).filter(|&q| mean[0].contains(q) && alike(features, params, p, q));
    let mut neighbours: Vec<Point> = window(params.window_radius).filter(|&q| q != p).collect();
    if neighbours.len() < params.least_neighbours.max(3) {
        return None;
    }
    // The third brightest: two may be parts of the same spike.
    neighbours.sort_by(|&a, &b| channel_mean(mean, b).total_cmp(&channel_mean(mean, a)));
    let bright = channel_mean(mean, neighbours[2]);
    neighbours.retain(|&q| channel_mean(mean, q) <= bright);
    let of_neighbours = |value: &dyn Fn(usize, Point) -> f64| -> Vec<f64> {
        (0..mean.len()).map(|i| neighbours.iter().map(|&q| value(i, q)).sum::<f64>() / neighbours.len() as f64).collect()
    };
    let two_buffer = |i: usize, q: Point| color.spread.as_ref().map_or(0.0, |spread| spread[i].at(q).powi(2));
    let claimed = |i: usize, q: Point| color.sample_variance.as_ref().map_or_else(|| two_buffer(i, q), |variance| variance[i].at(q));
    let level = of_neighbours(&|i, q| mean[i].at(q));
    let excess: Vec<f64> = level.iter().enumerate().map(|(i, level)| mean[i].at(p) - level).collect();
    let brightness = |color: &[f64]| color.iter().sum::<f64>() / color.len() as f64;

    // √k standard deviations for k bright samples.
    let noise: f64 = (0..mean.len()).map(|i| claimed(i, p).max(two_buffer(i, p))).sum();
    let stands_out = channel_mean(mean, p) > bright && brightness(&excess) > params.prominence * (bright - brightness(&level));
    if !stands_out || excess.iter().map(|e| e * e).sum::<f64>() > params.most_samples * noise {
        return None;
    }
    let members: f64 = window(params.spread_radius).filter(|&q| is_noisy(color, q)).map(|q| falloff(params, p, q)).sum();
    // Where the spike is at the edge of a light, its own level is not that of those who get its parts.
    let darker: Vec<f64> = window(params.spread_radius).map(|q| channel_mean(mean, q)).filter(|value| *value <= bright).collect();
    let around = darker.iter().sum::<f64>() / darker.len() as f64;
    let limit = params.share_limit.unwrap_or(0.0) * brightness(&level).min(around).max(0.0);
    let part = limit / (limit + brightness(&excess) / members);
    Some(Spike { variance: of_neighbours(&claimed), level, excess, part, members })
}

/// What a pixel gets, in parts of what one in the place of the spike would get.
fn falloff(params: &SpikeParams, p: Point, q: Point) -> f64 {
    let squared = |a: isize, b: isize| ((a - b) as f64 / (params.spread_radius + 1) as f64).powi(2);
    (1.0 - squared(p.x, q.x) - squared(p.y, q.y)).max(0.0)
}

/// What has no noise is what it is.
fn is_noisy(color: &Signal, p: Point) -> bool {
    [&color.spread, &color.sample_variance].into_iter().flatten().flatten().any(|plane| plane.at(p) != 0.0)
}

/// Pixels of one kind: the distance of no feature (eq. 8.3, scaled by both pixels) is above 1.
fn alike(features: &[Feature], params: &SpikeParams, p: Point, q: Point) -> bool {
    features.iter().all(|feature| {
        let channel = |i: usize| {
            let (mean, variance) = (&feature.mean[i], &feature.residual_variance[i]);
            let scale = |p: Point| params.tau.max(variance.at(p)).max(feature.gradient_squared[i].at(p));
            let cancelled = (mean.at(p) - mean.at(q)).powi(2) - variance.at(p) - variance.at(p).min(variance.at(q));
            cancelled / (params.k_feature * params.k_feature * (scale(p) + scale(q)))
        };
        (0..feature.mean.len()).map(channel).sum::<f64>() / feature.mean.len() as f64 <= 1.0
    })
}
