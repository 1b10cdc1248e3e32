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
// Filters over the own frame, one plane for each: the mean, the half spread, and dF_i/du_i per channel. Or,
// WEIGHT_SUMS, one filter, two planes for mean and half spread, and Σ w in x: where the weights do not depend on the
// noise of what is averaged, the centre's share 1 / Σ w is the derivative.
@group(0) @binding(3) var<storage, read> alone: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> alone_derivatives: array<vec4<f32>>;
// The same over all frames; they become the chosen ones. The w of the half spread becomes 1 where the own frame alone
// is chosen.
@group(0) @binding(5) var<storage, read_write> together: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> derivatives: array<vec4<f32>>;
#ifndef WEIGHT_SUMS
@group(0) @binding(7) var<storage, read> alone_spreads: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> spreads: array<vec4<f32>>;
#endif

fn derivative(of_pixel: vec4<f32>) -> vec3<f32> {
#ifdef WEIGHT_SUMS
    return vec3<f32>(1.0 / of_pixel.x);
#else
    return of_pixel.xyz;
#endif
}

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
        let of_candidate = candidate * pixels + at;
        let error_alone = sure(u, variance, alone[of_candidate].xyz, derivative(alone_derivatives[of_candidate]), 1.0);
        let error_together = sure(u, variance, together[of_candidate].xyz, derivative(derivatives[of_candidate]), 1.0);
        if error_together - error_alone > error_by_chance(together[of_candidate].xyz - alone[of_candidate].xyz,
            variance, params.own_sigmas, params.own_noise) {
            together[of_candidate] = alone[of_candidate];
            derivatives[of_candidate] = alone_derivatives[of_candidate];
#ifdef WEIGHT_SUMS
            together[pixels + at] = vec4<f32>(alone[pixels + at].xyz, 1.0);
#else
            spreads[of_candidate] = vec4<f32>(alone_spreads[of_candidate].xyz, 1.0);
#endif
        }
    }
}
