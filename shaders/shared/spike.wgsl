// What the stages that find and spread spikes share: their parameters, and which pixels count as of one kind by their
// features.
#define_import_path stein::spike
#import stein::planes::{largest_channel}

struct SpikeParams {
    extent: vec2<i32>,
    // Half widths of the windows that spikes are judged in, and spread over.
    window_radius: i32,
    spread_radius: i32,
    // Neighbours of its kind that it takes to judge a pixel.
    least_neighbours: f32,
    // How far above the level a spike is, in distances from the level to the third brightest neighbour.
    prominence: f32,
    // How many samples a spike rests on at the most.
    most_samples: f32,
    // How many a light of few pixels rests on at the least.
    light_samples: f32,
    // Noise from which on a pixel takes part: its standard deviation in parts of its value.
    least_noise: f32,
    // The part of the level that a spike adds to its surroundings at the most.
    share_limit: f32,
    // 1 / k_f² and τ: how large a difference between features counts.
    inverse_feature_k_squared: f32,
    feature_tau: f32,
    // 1 / number of channels, per channel of the triple.
    triple_weights: array<vec4<f32>, 8>,
}

// What has next to no noise is what it is: it is no spike, and gets nothing of one. A spread counts before it is
// squared, which may leave nothing of it.
fn has_noise(value: vec3<f32>, spread: vec3<f32>, variance: vec3<f32>, least_noise: f32) -> bool {
    return largest_channel(max(abs(spread), sqrt(variance))) > least_noise * largest_channel(abs(value));
}

// Of one pixel's prefiltered features, four channels.
struct SpikeFeatures {
    value: vec4<f32>,
    residual_variance: vec4<f32>,
    // The larger of residual variance and squared gradient.
    scale: vec4<f32>,
}

// Whether the distance of no feature of this group is above 1: as eq. 8.3, scaled by both pixels.
fn are_alike(p: SpikeFeatures, q: SpikeFeatures, triple: vec3<f32>, params: SpikeParams) -> bool {
    let difference = p.value - q.value;
    let squared = difference * difference - (p.residual_variance + min(p.residual_variance, q.residual_variance));
    let tau = vec4<f32>(params.feature_tau);
    let distance = squared * params.inverse_feature_k_squared / (max(tau, p.scale) + max(tau, q.scale));
    return dot(distance.xyz, triple) <= 1.0 && distance.w <= 1.0;
}

// What a pixel gets of a spike at this offset, in parts of what one in its place would get: less towards the rim of the
// window, so that no border shows.
fn falloff(offset: vec2<i32>, radius: i32) -> f32 {
    let away = vec2<f32>(offset) / f32(radius + 1);
    return max(1.0 - dot(away, away), 0.0);
}

// How much two pixels count as equally bright, by the levels of their surroundings: 1 up to four times as bright, 0
// from eight times on.
fn affinity(level_p: f32, level_q: f32) -> f32 {
    let brighter = max(level_p, level_q);
    return select(1.0, clamp(8.0 * min(level_p, level_q) / brighter - 1.0, 0.0, 1.0), brighter > 0.0);
}

fn brightness(color: vec3<f32>) -> f32 {
    return dot(color, vec3<f32>(1.0 / 3.0));
}
