// Gain to be expected from a sample drawn in each pixel (thesis 8.6): the relative error estimate of the blend, times
// W(p) = Σ w / (1 + n_p).
//
// With halves, the error is the two-buffer variance that is left in the blend, as in thesis 7.1.2. One more sample
// lowers the variance of its pixel by a factor n_p / (1 + n_p), and serves all pixels to which the filter lets it
// contribute. One plane, x.
#import stein::planes::{pixel_index}

struct SampleDensityParams {
    extent: vec2<i32>,
    // Samples per pixel, used where there is no map of them.
    samples_per_pixel: f32,
    // Added to the squared value in the relative error, so that dark pixels do not take everything.
    relative_floor: f32,
}

@group(0) @binding(0) var<uniform> params: SampleDensityParams;
// The blend, two planes: mean with Σ w in w, half spread.
@group(0) @binding(1) var<storage, read> blended: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> density: array<vec4<f32>>;
#ifndef HALVES
// The squared error of the blend, summed over the channels, in x.
@group(0) @binding(3) var<storage, read> errors: array<vec4<f32>>;
#endif
#ifdef SAMPLES_VARY
@group(0) @binding(4) var<storage, read> samples: array<vec4<f32>>;
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    let value = blended[at];
#ifdef HALVES
    let left = blended[params.extent.x * params.extent.y + at].xyz;
    let error = dot(left, left);
#else
    let error = errors[at].x;
#endif
    let relative = error / (dot(value.xyz, value.xyz) + 3.0 * params.relative_floor);
#ifdef SAMPLES_VARY
    let count = samples[at].x;
#else
    let count = params.samples_per_pixel;
#endif
    density[at] = vec4<f32>(relative * value.w / (1.0 + count), 0.0, 0.0, 0.0);
}
