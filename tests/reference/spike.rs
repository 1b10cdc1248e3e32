//! Spikes: pixels that stand out from similar ones and rest on very few samples.

use super::keep_clean::Kept;
use super::nlm::Feature;
use super::variance::Signal;
use super::{Grid, Planes, Point, channel_mean, lower_median, square};

/// Rules for a spike, and for spreading it.
#[derive(Clone, Copy, Debug)]
pub struct SpikeParams {
    pub window_radius: usize,
    pub spread_radius: usize,
    pub least_neighbours: usize,
    /// Least excess over the level, in distances from the level to the third brightest neighbour.
    pub prominence: f64,
    pub most_samples: f64,
    /// Least number of samples that a light of few pixels rests on.
    pub light_samples: f64,
    /// None: the excess is lost.
    pub share_limit: Option<f64>,
    pub k_feature: f64,
    pub tau: f64,
}

/// The parameters that measured best on renders.
impl Default for SpikeParams {
    fn default() -> SpikeParams {
        SpikeParams {
            window_radius: 3,
            spread_radius: 13,
            least_neighbours: 12,
            prominence: 3.0,
            most_samples: 2.0,
            light_samples: 25.0,
            share_limit: Some(0.1),
            k_feature: 0.6,
            tau: 0.1,
        }
    }
}

pub struct Repaired {
    pub signal: Signal,
    /// The energy removed from each pixel.
    pub taken: Planes,
    /// The share of that energy that the pixels around got.
    pub part: Grid,
    /// The squares of the energy that each pixel got, summed over spikes and channels.
    pub squares: Grid,
    pub lights: Lights,
}

/// Lights of few pixels with their values; 0 everywhere else.
#[derive(Clone)]
pub struct Lights {
    /// 1 for a light.
    pub flags: Grid,
    pub mean: Planes,
    pub spread: Planes,
    /// Summed over the channels.
    pub variance: Grid,
}

impl Lights {
    pub fn is_light(&self, p: Point) -> bool {
        self.flags.at(p) != 0.0
    }

    /// A filtered signal and its error, with the lights.
    pub fn added_to(&self, Kept { mean, spread, error }: Kept) -> Kept {
        let one = |other: &Grid, light: &Grid| other.like(|p| if self.is_light(p) { light.at(p) } else { other.at(p) });
        let all = |others: &[Grid], lights: &[Grid]| -> Planes {
            others.iter().zip(lights).map(|(other, light)| one(other, light)).collect()
        };
        Kept {
            mean: all(&mean, &self.mean),
            spread: spread.map(|spread| all(&spread, &self.spread)),
            error: one(&error, &self.variance),
        }
    }
}

struct Spike {
    /// The neighbours whose mean is the level.
    neighbours: Vec<Point>,
    level: Vec<f64>,
    /// Variance after the repair, from the neighbours' variances.
    variance: Vec<f64>,
    excess: Vec<f64>,
    /// For a light of few pixels, which is kept aside, the variance that its samples show. None for a spike.
    light: Option<f64>,
}

/// The share of a spike that is spread, and the sum of the parts.
struct Share {
    part: f64,
    members: f64,
}

/// Spikes and lights of a colour, and how spikes are spread.
struct Found {
    /// A spike or light for each pixel that is one.
    spikes: Vec<Option<Spike>>,
    /// Brightness around each pixel.
    levels: Grid,
    shares: Vec<Share>,
}

/// A colour, its features and the rules, to find its spikes with.
#[derive(Clone, Copy)]
struct Input<'a> {
    color: &'a Signal,
    features: &'a [Feature],
    params: &'a SpikeParams,
}

impl Input<'_> {
    fn found(self) -> Found {
        let Input { color, features, params } = self;
        let mean = &color.mean;
        // A frame without noise is left alone.
        let any_noise = [&color.spread, &color.sample_variance]
            .into_iter()
            .flatten()
            .flatten()
            .any(|plane| plane.values.iter().any(|value| *value != 0.0));
        let spikes: Vec<Option<Spike>> = super::map_pixels(mean[0].width, mean[0].height, |p| {
            if any_noise { spike(color, features, params, p) } else { None }
        });
        let at = |p: Point| spikes[mean[0].index(p)].as_ref();
        let without: Planes =
            (0..mean.len()).map(|i| mean[i].like(|p| at(p).map_or(mean[i].at(p), |spike| spike.level[i]))).collect();
        let levels = mean[0].like(|p| level_around(&without, p));
        let shares: Vec<Share> = super::map_pixels(mean[0].width, mean[0].height, |p| {
            let spike = at(p).filter(|spike| spike.light.is_none());
            let members: f64 = self.around(p).filter(|_| spike.is_some()).map(|q| self.gets(&levels, p, q)).sum();
            let Some(spike) = spike.filter(|_| members > 0.0) else { return Share { part: 0.0, members: 1.0 } };
            let level_of_members =
                self.around(p).map(|q| self.gets(&levels, p, q) * levels.at(q)).sum::<f64>() / members;
            let limit = params.share_limit.unwrap_or(0.0) * levels.at(p).min(level_of_members);
            let even =
                spike.excess.iter().map(|excess| excess.max(0.0)).sum::<f64>() / spike.excess.len() as f64 / members;
            Share { part: if limit > 0.0 { limit / (limit + even) } else { 0.0 }, members }
        });
        Found { spikes, levels, shares }
    }

    /// The pixels that a spike is spread over, or that spread to a pixel.
    fn around(&self, p: Point) -> impl Iterator<Item = Point> + use<'_> {
        square(self.params.spread_radius).map(move |o| p + o).filter(|&q| self.color.mean[0].contains(q))
    }

    /// The part that q gets of a spike at p, relative to the part of a pixel in its place.
    fn gets(&self, levels: &Grid, p: Point, q: Point) -> f64 {
        let alike = is_noisy(self.color, q) && alike(self.features, self.params, p, q);
        if alike { falloff(self.params, p, q) * affinity(levels.at(p), levels.at(q)) } else { 0.0 }
    }

    /// Σ of the amounts, each to this power, that q gets from the spikes around, of which each gives `excess`.
    fn received(&self, found: &Found, q: Point, power: i32, excess: &dyn Fn(Point, &Spike) -> f64) -> f64 {
        let index = |p: Point| self.color.mean[0].index(p);
        let share = |p: Point| {
            let Share { part, members } = found.shares[index(p)];
            let spike = found.spikes[index(p)].as_ref().filter(|spike| spike.light.is_none());
            spike.map_or(0.0, |spike| self.gets(&found.levels, p, q) * part * excess(p, spike) / members)
        };
        self.around(q).map(|p| share(p).powi(power)).sum()
    }
}

pub fn repaired(color: &Signal, features: &[Feature], params: &SpikeParams) -> Repaired {
    let input = Input { color, features, params };
    let found = input.found();
    let mean = &color.mean;
    let at = |p: Point| found.spikes[mean[0].index(p)].as_ref();
    let spike_at = |p: Point| at(p).filter(|spike| spike.light.is_none());
    let light_at = |p: Point| at(p).filter(|spike| spike.light.is_some());
    let received =
        |i: usize, q: Point, power: i32| input.received(&found, q, power, &|_, spike| spike.excess[i].max(0.0));
    let channels = 0..mean.len();
    let plane = |i: usize| mean[i].like(|p| at(p).map_or(mean[i].at(p), |spike| spike.level[i]) + received(i, p, 1));
    let spread = |planes: &Planes| {
        let held = |i: usize, p: Point| at(p).map_or(f64::INFINITY, |spike| spike.variance[i].sqrt());
        planes.iter().enumerate().map(|(i, plane)| plane.like(|p| plane.at(p).clamp(-held(i, p), held(i, p)))).collect()
    };
    let variance = |planes: &Planes| {
        planes
            .iter()
            .enumerate()
            .map(|(i, plane)| plane.like(|p| at(p).map_or(plane.at(p), |spike| spike.variance[i])))
            .collect()
    };
    let own_spread = |i: usize, p: Point| color.spread.as_ref().map_or(0.0, |spread| spread[i].at(p));
    Repaired {
        signal: Signal {
            mean: channels.clone().map(plane).collect(),
            spread: color.spread.as_ref().map(spread),
            sample_variance: color.sample_variance.as_ref().map(variance),
        },
        squares: mean[0].like(|p| channels.clone().map(|i| received(i, p, 2)).sum()),
        taken: channels.clone().map(|i| mean[i].like(|p| spike_at(p).map_or(0.0, |spike| spike.excess[i]))).collect(),
        lights: Lights {
            flags: mean[0].like(|p| light_at(p).map_or(0.0, |_| 1.0)),
            mean: channels.map(|i| mean[i].like(|p| light_at(p).map_or(0.0, |_| mean[i].at(p)))).collect(),
            spread: mean
                .iter()
                .enumerate()
                .map(|(i, plane)| plane.like(|p| light_at(p).map_or(0.0, |_| own_spread(i, p))))
                .collect(),
            variance: mean[0].like(|p| light_at(p).and_then(|light| light.light).unwrap_or(0.0)),
        },
        part: mean[0].like(|p| found.shares[mean[0].index(p)].part),
    }
}

/// A payload without the spikes of a colour. Its first three planes belong to the channels of the colour; further planes
/// belong to all of them.
pub fn repaired_payload(color: &Signal, features: &[Feature], params: &SpikeParams, payload: &[Grid]) -> Planes {
    let input = Input { color, features, params };
    let found = input.found();
    let level = |plane: &Grid, p: Point| match &found.spikes[plane.index(p)] {
        Some(Spike { neighbours, .. }) => {
            neighbours.iter().map(|&q| plane.at(q)).sum::<f64>() / neighbours.len() as f64
        }
        None => plane.at(p),
    };
    let repaired = |(i, plane): (usize, &Grid)| {
        let excess = |p: Point, spike: &Spike| {
            let gives = spike.excess.get(i).is_none_or(|excess| *excess > 0.0);
            if gives { plane.at(p) - level(plane, p) } else { 0.0 }
        };
        plane.like(|p| {
            let gets = if is_noisy(color, p) { input.received(&found, p, 1, &excess) } else { 0.0 };
            level(plane, p) + gets
        })
    };
    payload.iter().enumerate().map(repaired).collect()
}

fn spike(color: &Signal, features: &[Feature], params: &SpikeParams, p: Point) -> Option<Spike> {
    let mean = &color.mean;
    let window = |radius: usize| {
        square(radius).map(move |o| p + o).filter(|&q| mean[0].contains(q) && alike(features, params, p, q))
    };
    let mut neighbours: Vec<Point> = window(params.window_radius).filter(|&q| q != p).collect();
    if neighbours.len() < params.least_neighbours.max(3) {
        return None;
    }
    // The third brightest: two may be parts of the same spike.
    neighbours.sort_by(|&a, &b| channel_mean(mean, b).total_cmp(&channel_mean(mean, a)));
    let bright = channel_mean(mean, neighbours[2]);
    neighbours.retain(|&q| channel_mean(mean, q) <= bright);
    let of_neighbours = |value: &dyn Fn(usize, Point) -> f64| -> Vec<f64> {
        (0..mean.len())
            .map(|i| neighbours.iter().map(|&q| value(i, q)).sum::<f64>() / neighbours.len() as f64)
            .collect()
    };
    let two_buffer = |i: usize, q: Point| color.spread.as_ref().map_or(0.0, |spread| spread[i].at(q).powi(2));
    let claimed = |i: usize, q: Point| {
        color.sample_variance.as_ref().map_or_else(|| two_buffer(i, q), |variance| variance[i].at(q))
    };
    let level = of_neighbours(&|i, q| mean[i].at(q));
    let excess: Vec<f64> = level.iter().enumerate().map(|(i, level)| mean[i].at(p) - level).collect();
    let brightness = |color: &[f64]| color.iter().sum::<f64>() / color.len() as f64;

    // √k standard deviations for k bright samples.
    let noise: f64 = (0..mean.len()).map(|i| claimed(i, p).max(two_buffer(i, p))).sum();
    let stands_out =
        channel_mean(mean, p) > bright && brightness(&excess) > params.prominence * (bright - brightness(&level));
    let squared: f64 = excess.iter().map(|e| e * e).sum();
    let is_spike = is_noisy(color, p) && squared <= params.most_samples * noise;
    let light = (squared > params.light_samples * noise).then_some(noise);
    if !stands_out || !is_spike && light.is_none() {
        return None;
    }
    let variance = of_neighbours(&claimed);
    Some(Spike { neighbours, variance, level, excess, light })
}

/// The brightness of the 3×3 pixels around: their median (of an even number the lower middle one), at least 0. A median
/// keeps an edge of light, which a mean would blur.
fn level_around(without_spikes: &[Grid], p: Point) -> f64 {
    let around = square(1).map(|o| p + o).filter(|&q| without_spikes[0].contains(q));
    lower_median(around.map(|q| channel_mean(without_spikes, q)).collect()).max(0.0)
}

/// The degree to which two levels count as equally bright: 1 up to a factor of four, 0 from eight on.
fn affinity(level_p: f64, level_q: f64) -> f64 {
    let brighter = level_p.max(level_q);
    if brighter > 0.0 { (8.0 * level_p.min(level_q) / brighter - 1.0).clamp(0.0, 1.0) } else { 1.0 }
}

/// The part of a pixel, relative to the part of a pixel in the place of the spike.
fn falloff(params: &SpikeParams, p: Point, q: Point) -> f64 {
    let squared = |a: isize, b: isize| ((a - b) as f64 / (params.spread_radius + 1) as f64).powi(2);
    (1.0 - squared(p.x, q.x) - squared(p.y, q.y)).max(0.0)
}

/// Pixels with noise below a thousandth of their value are exact.
fn is_noisy(color: &Signal, p: Point) -> bool {
    let largest =
        |planes: &Planes, size: fn(f64) -> f64| planes.iter().map(|plane| size(plane.at(p))).fold(0.0, f64::max);
    let spread = color.spread.as_ref().map_or(0.0, |spread| largest(spread, f64::abs));
    let deviation = color.sample_variance.as_ref().map_or(0.0, |variance| largest(variance, f64::sqrt));
    spread.max(deviation) > 1e-3 * largest(&color.mean, f64::abs)
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
