// The squared error of a blend of candidates, summed over the channels: x, at least 0. It is the sum of three parts,
// each of which shows what the others cannot:
//
//   * spread: the difference of the halves, which is noise that the filter left. It misses noise that both halves have
//     in common, because they were filtered by the same weights.
//   * disagreement: how far the candidates that share in the blend lie apart from it. Where filters differ, they differ
//     by their bias.
//   * own noise: σ²·dF/du, the noise of the pixel itself that its own weight lets through.
//
// SURE adds and subtracts terms many times larger than the remaining sum, and claims a negative error for half of an
// image; none of these parts is ever negative. Their weights are measured.
//
// ADDED: the sum is added to the errors that exist already.
#import stein::planes::{pixel_index}

const CANDIDATES: i32 = #{CANDIDATES};

struct ErrorBlendParams {
    extent: vec2<i32>,
    // Weights of the parts.
    spread: f32,
    disagreement: f32,
    own_noise: f32,
}

@group(0) @binding(0) var<uniform> params: ErrorBlendParams;
// Two planes: mean, half spread.
@group(0) @binding(1) var<storage, read> blended: array<vec4<f32>>;
// Variance of the mean of the input.
@group(0) @binding(2) var<storage, read> variance_of_mean: array<vec4<f32>>;
// One plane for each candidate: dF_i/du_i per channel.
@group(0) @binding(3) var<storage, read> derivatives: array<vec4<f32>>;
#ifdef SHARED
// One plane for four candidates, one component for each. Without it, the only candidate is the blend.
@group(0) @binding(4) var<storage, read> shares: array<vec4<f32>>;
// One plane for each candidate: the mean.
@group(0) @binding(5) var<storage, read> means: array<vec4<f32>>;
#endif
@group(0) @binding(6) var<storage, read_write> errors: array<vec4<f32>>;

// Σ_i σ_i²·dF_i/du_i of a candidate. A derivative outside 0 to 1 comes from changing weights; it is not the share of
// the pixel's own noise that is left.
fn own_noise(candidate: i32, at: i32) -> f32 {
    let derivative = derivatives[candidate * params.extent.x * params.extent.y + at].xyz;
    return dot(variance_of_mean[at].xyz, clamp(derivative, vec3<f32>(0.0), vec3<f32>(1.0)));
}

fn squared(difference: vec3<f32>) -> f32 {
    return dot(difference, difference);
}

// Error that a candidate adds by its share of the blend.
fn of_candidate(share: f32, candidate: i32, filtered: vec3<f32>, mean: vec3<f32>, at: i32) -> f32 {
    // A candidate that has no share may hold anything.
    return select(0.0, share * (params.disagreement * squared(filtered - mean) + params.own_noise
        * own_noise(candidate, at)), share > 0.0);
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    var error = params.spread * squared(blended[pixels + at].xyz);
#ifdef SHARED
    let mean = blended[at].xyz;
    for (var candidate = 0; candidate < CANDIDATES; candidate++) {
        let share = shares[candidate / 4 * pixels + at][candidate % 4];
        error += of_candidate(share, candidate, means[candidate * pixels + at].xyz, mean, at);
    }
#else
    error += params.own_noise * own_noise(0, at);
#endif
#ifdef ADDED
    errors[at].x += error;
#else
    errors[at] = vec4<f32>(error, 0.0, 0.0, 0.0);
#endif
}
