//! The one NL-means operator: *payload* planes averaged with weights from a *guide* colour and from *features*, both
//! optional (`flt` of Algorithm 1; sections 7.1.1, 8.2 and 8.3).

use super::{Grid, Planes, Point, map_pixels, square};

/// ε of eq. 7.4, "very small in order to preserve features in dark areas": between two black pixels without variance.
/// All other pixels have a variance, see `variance::floored`.
const EPSILON: f64 = 1e-30;

/// Beyond this distance a weight is e⁻²⁵ or less, and the ratio of the weights of a pair means nothing.
const BLENDING_DISTANCE: f64 = 25.0;

/// The centre's weight if no neighbour is similar.
const SMALLEST_CENTRE_WEIGHT: f64 = 1e-3;

/// The weight of a pixel in its own average.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CentreWeight {
    /// 1: the distance of a pixel to itself is 0.
    One,
    /// The largest final weight among the neighbours, so that a spike, which is like no neighbour, does not hold on to
    /// itself.
    LargestNeighbour,
}

#[derive(Clone, Copy, Debug)]
pub struct FilterParams {
    /// r: the window is 2r + 1 pixels wide.
    pub window_radius: usize,
    /// f: the patches are 2f + 1 pixels wide.
    pub patch_radius: usize,
    /// k_c; infinite: the colour does not matter.
    pub k_color: f64,
    /// k_f; infinite: the features do not matter.
    pub k_feature: f64,
    /// τ: the least squared feature contrast that matters.
    pub tau: f64,
    /// Whether feature distances are scaled by both pixels. Otherwise the formula as printed in section 8.3.
    pub symmetric_features: bool,
    /// Weights from pairs of opposite neighbours (eq. 7.6), for colour and features.
    pub blend_pairs: bool,
    pub centre: CentreWeight,
}

/// The image whose patches are compared, and the variance of its pixels.
#[derive(Clone, Copy)]
pub struct Guide<'a> {
    pub mean: &'a [Grid],
    pub variance: &'a [Grid],
}

/// A denoised feature of one or more channels.
#[derive(Clone, Debug)]
pub struct Feature {
    pub mean: Planes,
    pub residual_variance: Planes,
    pub gradient_squared: Planes,
}

pub struct Filtered {
    /// The payload, filtered.
    pub planes: Planes,
    /// C(p) of eq. 8.1, with the centre's weight.
    pub weight_sum: Grid,
}

/// Eq. 8.1 for every payload plane.
pub fn nlm_filter(payload: &[Grid], guide: Option<Guide>, features: &[Feature], params: &FilterParams) -> Filtered {
    let like = &payload[0];
    let windows = map_pixels(like.width, like.height, |p| {
        let weights = window_weights(like, p, guide, features, params);
        let averages: Vec<f64> = payload.iter().map(|plane| weights.average(plane)).collect();
        (averages, weights.sum())
    });
    let plane = |values: Vec<f64>| Grid { values, ..*like };
    Filtered {
        planes: (0..payload.len()).map(|i| plane(windows.iter().map(|(averages, _)| averages[i]).collect())).collect(),
        weight_sum: plane(windows.iter().map(|&(_, sum)| sum).collect()),
    }
}

/// The variance of the filtered mean if the weights were fixed and the pixels independent: Σw²V/C².
pub fn nlm_variance(variance: &[Grid], guide: Option<Guide>, features: &[Feature], params: &FilterParams) -> Planes {
    variance
        .iter()
        .map(|plane| plane.like(|p| window_weights(plane, p, guide, features, params).variance_of_average(plane)))
        .collect()
}

/// w(p, q) for one p and all q of its window that exist.
pub struct WindowWeights {
    /// w(p, p).
    pub centre: (Point, f64),
    pub neighbours: Vec<(Point, f64)>,
}

impl WindowWeights {
    pub fn iter(&self) -> impl Iterator<Item = (Point, f64)> {
        std::iter::once(self.centre).chain(self.neighbours.iter().copied())
    }

    pub fn sum(&self) -> f64 {
        self.iter().map(|(_, weight)| weight).sum()
    }

    pub fn average(&self, plane: &Grid) -> f64 {
        self.iter().map(|(q, w)| w * plane.at(q)).sum::<f64>() / self.sum()
    }

    pub fn variance_of_average(&self, variance: &Grid) -> f64 {
        let sum = self.sum();
        self.iter().map(|(q, w)| w * w * variance.at(q)).sum::<f64>() / (sum * sum)
    }
}

/// A frame beside the one that is filtered (sections 7.3 and 8.6): its pixels take part as neighbours, compared by
/// patches inside their own frame.
#[derive(Clone, Copy)]
pub struct Beside<'a> {
    pub guide: Option<Guide<'a>>,
    pub features: &'a [Feature],
}

/// The weights of a window that reaches into other frames: those of the neighbours in its own frame, then those of each
/// frame beside.
pub fn window_weights_in_time(
    like: &Grid,
    p: Point,
    guide: Option<Guide>,
    features: &[Feature],
    beside: &[Beside],
    params: &FilterParams,
) -> (WindowWeights, Vec<Vec<(Point, f64)>>) {
    let mut own = window_weights(like, p, guide, features, params);
    let others: Vec<Vec<(Point, f64)>> = beside
        .iter()
        .map(|other| {
            // The same position is a neighbour too, without an opposite.
            let here = Pair { p, q1: Some(p), q2: None };
            let pairs =
                std::iter::once(here).chain(half_window(params.window_radius).map(|offset| Pair::new(like, p, offset)));
            let weights = |pair: Pair| {
                let color = guide
                    .zip(other.guide)
                    .filter(|_| params.k_color.is_finite())
                    .map(|guides| color_weights(guides, &pair, params));
                let weights =
                    smaller(color.unwrap_or([1.0; 2]), feature_weights([features, other.features], &pair, params));
                pair.neighbours().zip(weights).filter_map(|(q, w)| Some((q?, w))).collect::<Vec<_>>()
            };
            pairs.flat_map(weights).collect()
        })
        .collect();
    if params.centre == CentreWeight::LargestNeighbour {
        own.centre.1 = others.iter().flatten().fold(own.centre.1, |largest, (_, w)| w.max(largest));
    }
    (own, others)
}

/// The weights of one window; `like` has the extent of the image.
pub fn window_weights(
    like: &Grid,
    p: Point,
    guide: Option<Guide>,
    features: &[Feature],
    params: &FilterParams,
) -> WindowWeights {
    let mut neighbours = Vec::new();
    for offset in half_window(params.window_radius) {
        let pair = Pair::new(like, p, offset);
        let color =
            guide.filter(|_| params.k_color.is_finite()).map(|guide| color_weights((guide, guide), &pair, params));
        let features = feature_weights([features; 2], &pair, params);
        let weights = smaller(color.unwrap_or([1.0; 2]), features);
        neighbours.extend(pair.neighbours().zip(weights).filter_map(|(q, w)| Some((q?, w))));
    }
    let largest = neighbours.iter().fold(SMALLEST_CENTRE_WEIGHT, |largest, (_, w)| w.max(largest));
    let centre = match params.centre {
        CentreWeight::One => 1.0,
        CentreWeight::LargestNeighbour => largest,
    };
    WindowWeights { centre: (p, centre), neighbours }
}

/// One of each two opposite offsets, without the centre.
pub fn half_window(radius: usize) -> impl Iterator<Item = Point> {
    square(radius).filter(|o| o.y > 0 || (o.y == 0 && o.x > 0))
}

/// A pixel and two opposite neighbours, q1 = p + o and q2 = p − o, as far as they exist.
#[derive(Clone, Copy)]
pub struct Pair {
    pub p: Point,
    pub q1: Option<Point>,
    pub q2: Option<Point>,
}

impl Pair {
    pub fn new(like: &Grid, p: Point, offset: Point) -> Pair {
        Pair {
            p,
            q1: Some(p + offset).filter(|&q| like.contains(q)),
            q2: Some(p - offset).filter(|&q| like.contains(q)),
        }
    }

    pub fn neighbours(&self) -> impl Iterator<Item = Option<Point>> {
        [self.q1, self.q2].into_iter()
    }
}

/// w_c of eq. 8.2 for both neighbours; the guides are those of the frame of p and of the frame of the neighbours.
pub(super) fn color_weights(guides: (Guide, Guide), pair: &Pair, params: &FilterParams) -> [f64; 2] {
    let (f, k, p) = (params.patch_radius, params.k_color, pair.p);
    pair_weights(
        pair,
        params.blend_pairs,
        |q| patch_distance(guides, k, f, p, q),
        |q1, q2| patch_distance_to_mean(guides, k, f, p, q1, q2),
    )
}

/// The least weight of all features (eq. 8.3) for both neighbours; 1 without features. The features are those of the
/// frame of p and of the frame of the neighbours.
pub fn feature_weights(features: [&[Feature]; 2], pair: &Pair, params: &FilterParams) -> [f64; 2] {
    if params.k_feature.is_infinite() {
        return [1.0; 2];
    }
    let [own, other] = features;
    own.iter().zip(other).fold([1.0; 2], |least, features| {
        let weights = pair_weights(
            pair,
            params.blend_pairs,
            |q| feature_distance(features, params, pair.p, q),
            |q1, q2| feature_distance_to_mean(features, params, pair.p, q1, q2),
        );
        smaller(least, weights)
    })
}

/// Weights of two opposite neighbours from their distances. In a smooth gradient each is far from p while their mean is
/// close: where the mean's weight exceeds the sum of both, section 7.1.1 puts it in place of both. Doing so by degrees
/// keeps the weights continuous, so that their finite differences mean something. The weight of a neighbour that does
/// not exist is 0.
fn pair_weights(
    pair: &Pair,
    blend: bool,
    distance: impl Fn(Point) -> f64,
    distance_to_mean: impl Fn(Point, Point) -> f64,
) -> [f64; 2] {
    let d1 = pair.q1.map_or(f64::INFINITY, &distance);
    let d2 = pair.q2.map_or(f64::INFINITY, &distance);
    let (w1, w2) = (weight(d1), weight(d2));
    match (pair.q1, pair.q2) {
        (Some(q1), Some(q2)) if blend && blendable(d1, d2) => {
            let w_mean = weight(distance_to_mean(q1, q2));
            let share = (w_mean / (w1 + w2) - 1.0).clamp(0.0, 1.0);
            [w1, w2].map(|w| share * w_mean + (1.0 - share) * w)
        }
        _ => [w1, w2],
    }
}

pub fn blendable(d1: f64, d2: f64) -> bool {
    d1 < BLENDING_DISTANCE && d2 < BLENDING_DISTANCE
}

/// Eq. 7.5.
pub fn weight(distance: f64) -> f64 {
    (-distance.max(0.0)).exp()
}

/// Eq. 8.4.
fn smaller(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0].min(b[0]), a[1].min(b[1])]
}

/// d² of section 8.2: the mean of Δ² over the channels and over the pairs (p + n, q + n) that lie inside.
pub fn patch_distance((at_p, at_q): (Guide, Guide), k: f64, f: usize, p: Point, q: Point) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for n in square(f) {
        if !at_p.mean[0].contains(p + n) || !at_q.mean[0].contains(q + n) {
            continue;
        }
        for c in 0..at_p.mean.len() {
            let (u_p, v_p) = (at_p.mean[c].at(p + n), at_p.variance[c].at(p + n));
            let (u_q, v_q) = (at_q.mean[c].at(q + n), at_q.variance[c].at(q + n));
            sum += pixel_distance(u_p, u_q, v_p, v_q, k);
            count += 1;
        }
    }
    sum / f64::from(count)
}

/// Δ² of section 8.2 in one channel. Not symmetric in p and q: the cancellation clamps the variance of q to that of p.
fn pixel_distance(u_p: f64, u_q: f64, v_p: f64, v_q: f64, k: f64) -> f64 {
    let difference = u_p - u_q;
    let cancellation = v_p + v_q.min(v_p);
    (difference * difference - cancellation) / pixel_distance_scale(v_p, v_q, k)
}

/// The patch distance to the mean of q1 and q2: eq. 7.6 with the ε and k² of eq. 7.4.
pub fn patch_distance_to_mean((at_p, at_q): (Guide, Guide), k: f64, f: usize, p: Point, q1: Point, q2: Point) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for n in square(f) {
        if ![p + n, q1 + n, q2 + n].iter().all(|&x| at_p.mean[0].contains(x)) {
            continue;
        }
        for c in 0..at_p.mean.len() {
            let (u, v) = (&at_q.mean[c], &at_q.variance[c]);
            let (v_p, v_1, v_2) = (at_p.variance[c].at(p + n), v.at(q1 + n), v.at(q2 + n));
            let difference = at_p.mean[c].at(p + n) - (u.at(q1 + n) + u.at(q2 + n)) / 2.0;
            let cancellation = v_p + (v_1.min(v_p) + v_2.min(v_p)) / 4.0;
            sum += (difference * difference - cancellation) / distance_to_mean_scale(v_p, v_1, v_2, k);
            count += 1;
        }
    }
    sum / f64::from(count)
}

/// The denominator of eq. 7.4.
pub fn pixel_distance_scale(v_p: f64, v_q: f64, k: f64) -> f64 {
    EPSILON + k * k * (v_p + v_q)
}

/// The denominator of eq. 7.6.
pub fn distance_to_mean_scale(v_p: f64, v_1: f64, v_2: f64, k: f64) -> f64 {
    EPSILON + k * k * (v_p + (v_1 + v_2) / 4.0)
}

/// Φ² of section 8.3, the mean over the feature's channels. As printed it is normalised by p alone and cancels all of
/// q's variance; the symmetric filter treats the features as section 8.2 treats the colour, and scales by both pixels.
pub(super) fn feature_distance(features: (&Feature, &Feature), params: &FilterParams, p: Point, q: Point) -> f64 {
    let k_squared = params.k_feature * params.k_feature;
    mean_over_channels(features, params.tau, |at_p, at_q| {
        let difference = at_p.mean(p) - at_q.mean(q);
        let (v_p, v_q) = (at_p.variance(p), at_q.variance(q));
        let (cancellation, scale) = if params.symmetric_features {
            (v_p + v_q.min(v_p), at_p.contrast(p) + at_q.contrast(q))
        } else {
            (v_p + v_q, at_p.contrast(p))
        };
        (difference * difference - cancellation) / (k_squared * scale)
    })
}

/// Φ² between p and the mean of q1 and q2, after the manner of eq. 7.6.
fn feature_distance_to_mean(
    features: (&Feature, &Feature),
    params: &FilterParams,
    p: Point,
    q1: Point,
    q2: Point,
) -> f64 {
    let k_squared = params.k_feature * params.k_feature;
    mean_over_channels(features, params.tau, |at_p, at_q| {
        let difference = at_p.mean(p) - (at_q.mean(q1) + at_q.mean(q2)) / 2.0;
        let v_p = at_p.variance(p);
        let cancellation = v_p + (at_q.variance(q1).min(v_p) + at_q.variance(q2).min(v_p)) / 4.0;
        let scale = at_p.contrast(p) + (at_q.contrast(q1) + at_q.contrast(q2)) / 4.0;
        (difference * difference - cancellation) / (k_squared * scale)
    })
}

/// One channel of a feature.
struct Channel<'a> {
    feature: &'a Feature,
    channel: usize,
    tau: f64,
}

impl Channel<'_> {
    fn mean(&self, x: Point) -> f64 {
        self.feature.mean[self.channel].at(x)
    }

    fn variance(&self, x: Point) -> f64 {
        self.feature.residual_variance[self.channel].at(x)
    }

    /// Scale of differences: the residual noise or the feature's own gradient, at least τ.
    fn contrast(&self, x: Point) -> f64 {
        self.tau.max(self.variance(x)).max(self.feature.gradient_squared[self.channel].at(x))
    }
}

/// The mean over a feature's channels of a distance between the frame of p and the frame of q.
fn mean_over_channels((at_p, at_q): (&Feature, &Feature), tau: f64, distance: impl Fn(Channel, Channel) -> f64) -> f64 {
    let channels = at_p.mean.len();
    let of = |feature, channel| Channel { feature, channel, tau };
    (0..channels).map(|channel| distance(of(at_p, channel), of(at_q, channel))).sum::<f64>() / channels as f64
}
