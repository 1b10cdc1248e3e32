// Chooses between pass 1 and the second pass, pixel by pixel (Algorithm 1 lines 34–37, with a limit).
//
// The second pass removes noise that pass 1 left. A correction far beyond any noise of the pixel does not remove noise:
// a patch that differs in few of its pixels can be near, so that a clean pixel at the edge of a lamp, without any
// similar pixel, takes the value of the nearest ones.
#import stein::planes::{pixel_index}

struct SelectPassParams {
    extent: vec2<i32>,
    // Square of the largest correction, in standard deviations.
    squared_sigmas: f32,
}

@group(0) @binding(0) var<uniform> params: SelectPassParams;
// Signals: mean and half spread.
@group(0) @binding(1) var<storage, read> pass1: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> pass2: array<vec4<f32>>;
// Variance of the mean of the input.
@group(0) @binding(3) var<storage, read> variance_of_mean: array<vec4<f32>>;
// The w of the half spread becomes 1 where the second pass is chosen, else 0.
@group(0) @binding(4) var<storage, read_write> result: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let mean = pass1[at];
    let spread = pass1[pixels + at];
    let correction = pass2[at].xyz - mean.xyz;
    // Noise that a neighbour added shows in the spread of pass 1, not in the pixel's own variance.
    let noise = dot(variance_of_mean[at].xyz, vec3<f32>(1.0)) + dot(spread.xyz, spread.xyz);
    if dot(correction, correction) > params.squared_sigmas * noise {
        result[at] = mean;
        result[pixels + at] = vec4<f32>(spread.xyz, 0.0);
    } else {
        result[at] = pass2[at];
        result[pixels + at] = vec4<f32>(pass2[pixels + at].xyz, 1.0);
    }
}
