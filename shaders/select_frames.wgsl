// Chooses, for each filter and each pixel, between the filter over all frames of a window in time and the filter over
// the pixel's own frame.
//
// A moving object brings along pixels that only seem to fit: the noisy rim of a lamp, for example, may be similar to
// anything. Where the pixel's own SURE shows harm by the other frames, beyond the harm that chance explains, they are
// left out.
#import stein::planes::{pixel_index}
#import stein::candidates::{sure, error_by_chance}

const CANDIDATES: i32 = #{CANDIDATES};

struct SelectFramesParams {
    extent: vec2<i32>,
    own_sigmas: f32,
    own_noise: f32,
}

@group(0) @binding(0) var<uniform> params: SelectFramesParams;
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> variance_of_mean: array<vec4<f32>>;
// Filters over the own frame. Two planes for each: mean, half spread; behind them, one plane for each: dF_i/du_i per
// channel. With WEIGHT_SUMS there is one filter, and a plane of its own with Σ w in x: the weights do not depend on the
// noise of the averaged image, so the share of the centre, 1 / Σ w, is the derivative.
@group(0) @binding(3) var<storage, read> alone: array<vec4<f32>>;
// The same planes for the filters over all frames; they become the chosen ones.
@group(0) @binding(4) var<storage, read_write> together: array<vec4<f32>>;
#ifdef WEIGHT_SUMS
@group(0) @binding(5) var<storage, read> alone_weights: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> weights: array<vec4<f32>>;
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let u = signal[at].xyz;
    let variance = variance_of_mean[at].xyz;
    for (var candidate = 0; candidate < CANDIDATES; candidate++) {
        let at_mean = 2 * candidate * pixels + at;
#ifdef WEIGHT_SUMS
        let alone_derivative = vec3<f32>(1.0 / alone_weights[at].x);
        let derivative = vec3<f32>(1.0 / weights[at].x);
#else
        let at_derivative = (2 * CANDIDATES + candidate) * pixels + at;
        let alone_derivative = alone[at_derivative].xyz;
        let derivative = together[at_derivative].xyz;
#endif
        let error_alone = sure(u, variance, alone[at_mean].xyz, alone_derivative, 1.0);
        let error_together = sure(u, variance, together[at_mean].xyz, derivative, 1.0);
        if error_together - error_alone > error_by_chance(together[at_mean].xyz - alone[at_mean].xyz, variance,
            params.own_sigmas, params.own_noise) {
            together[at_mean] = alone[at_mean];
            together[pixels + at_mean] = alone[pixels + at_mean];
#ifdef WEIGHT_SUMS
            weights[at] = alone_weights[at];
#else
            together[at_derivative] = alone[at_derivative];
#endif
        }
    }
}
