// Code shared by the stages that find and spread spikes: their parameters, and the test whether pixels are of one kind
// by their features.
#define_import_path stein::spike
#import stein::planes::{largest_channel}

struct SpikeParams {
    extent: vec2<i32>,
    // Half widths of the windows that spikes are judged in, and spread over.
    window_radius: i32,
    spread_radius: i32,
    // Least number of neighbours of its kind that are needed to judge a pixel.
    least_neighbours: f32,
    // Least height of a spike above the level, in multiples of the distance from the level to the third brightest
    // neighbour.
    prominence: f32,
    // Largest number of samples that a spike rests on.
    most_samples: f32,
    // Least number of samples that a light of few pixels rests on.
    light_samples: f32,
    // Noise above which a pixel takes part: its standard deviation in parts of its value.
    least_noise: f32,
    // Largest part of the level that a spike adds to its surroundings.
    share_limit: f32,
    // 1 / k_f² and τ: how large a difference between features counts.
    inverse_feature_k_squared: f32,
    feature_tau: f32,
    // 1 / number of channels, per channel of the triple.
    triple_weights: array<vec4<f32>, 8>,
}

// Whether a pixel has noise. A pixel with almost no noise is no spike, and gets nothing from a spike. The spread is
// compared before it is squared, because its square may round to 0.
fn has_noise(value: vec3<f32>, spread: vec3<f32>, variance: vec3<f32>, least_noise: f32) -> bool {
    return largest_channel(max(abs(spread), sqrt(variance))) > least_noise * largest_channel(abs(value));
}

// Four channels of one pixel's prefiltered features.
struct SpikeFeatures {
    value: vec4<f32>,
    residual_variance: vec4<f32>,
    // The larger of residual variance and squared gradient.
    scale: vec4<f32>,
}

// Returns whether every feature of this group has a distance of at most 1, computed as in eq. 8.3 and scaled by both
// pixels.
fn are_alike(p: SpikeFeatures, q: SpikeFeatures, triple: vec3<f32>, params: SpikeParams) -> bool {
    let difference = p.value - q.value;
    let squared = difference * difference - (p.residual_variance + min(p.residual_variance, q.residual_variance));
    let tau = vec4<f32>(params.feature_tau);
    let distance = squared * params.inverse_feature_k_squared / (max(tau, p.scale) + max(tau, q.scale));
    return dot(distance.xyz, triple) <= 1.0 && distance.w <= 1.0;
}

// Amount that a pixel gets from a spike at this offset, relative to a pixel at the position of the spike: less towards
// the rim of the window, so that no border shows.
fn falloff(offset: vec2<i32>, radius: i32) -> f32 {
    let away = vec2<f32>(offset) / f32(radius + 1);
    return max(1.0 - dot(away, away), 0.0);
}

// Factor by which two pixels count as equally bright, from the levels of their surroundings: 1 if one is at most four
// times as bright as the other, 0 from eight times on.
fn affinity(level_p: f32, level_q: f32) -> f32 {
    let brighter = max(level_p, level_q);
    return select(1.0, clamp(8.0 * min(level_p, level_q) / brighter - 1.0, 0.0, 1.0), brighter > 0.0);
}

fn brightness(color: vec3<f32>) -> f32 {
    return dot(color, vec3<f32>(1.0 / 3.0));
}
