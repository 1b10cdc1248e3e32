// The squared error that is left in a filtered signal, and the gain to be expected from a sample drawn in each pixel
// (thesis 7.1.2 and 7.1.3): E·W, with the squared relative difference E of the filtered halves and W(p) = Σ w / (1 + Σ
// w·n). One plane, x: the gain, y: the squared error, summed over the channels. Neither is smoothed.
//
// The error covers noise but not bias, which the filter has to keep small.
#import stein::planes::{pixel_index}

struct ErrorHalvesParams {
    extent: vec2<i32>,
    // Added to the squared value in relative errors, so that dark pixels do not take everything.
    relative_floor: f32,
}

@group(0) @binding(0) var<uniform> params: ErrorHalvesParams;
// Two planes: the mean with the average number of samples, Σ w·n / Σ w, in w; then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
// x: Σ w.
@group(0) @binding(2) var<storage, read> weights: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> errors: array<vec4<f32>>;
#ifndef HALVES
@group(0) @binding(4) var<storage, read> residual_variance: array<vec4<f32>>;
#endif

// The squared difference of the halves, relative to one of them: the mean over the channels.
fn relative(squared_difference: vec3<f32>, value: vec3<f32>) -> f32 {
    return dot(squared_difference / (params.relative_floor + value * value), vec3<f32>(1.0 / 3.0));
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    let mean = signal[at].xyz;
    // The variance of the mean of two halves is the square of their half spread, a quarter of their squared difference.
#ifdef HALVES
    let spread = signal[params.extent.x * params.extent.y + at].xyz;
    let variance = spread * spread;
    let both = relative(4.0 * variance, mean + spread) + relative(4.0 * variance, mean - spread);
#else
    let variance = residual_variance[at].xyz;
    let both = 2.0 * relative(4.0 * variance, mean);
#endif
    let weight_sum = weights[at].x;
    errors[at] = vec4<f32>(both * weight_sum / (1.0 + weight_sum * signal[at].w), dot(variance, vec3<f32>(1.0)), 0.0,
        0.0);
}
