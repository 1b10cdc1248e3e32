// Splits a signal into its halves A and B, one plane each (thesis 7.1.1): mean ± half spread, for halves of equal
// numbers of samples. Also computes the variance of one half. Both halves get the w of the mean.
#import stein::planes::{pixel_index}

struct HalfParams {
    extent: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: HalfParams;
// Two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> variance_of_mean: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> half_a: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> half_b: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> variance_of_half: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    let mean = signal[at];
    let spread = signal[params.extent.x * params.extent.y + at].xyz;
    half_a[at] = vec4<f32>(mean.xyz + spread, mean.w);
    half_b[at] = vec4<f32>(mean.xyz - spread, mean.w);
    // Half as many samples have twice the variance.
    variance_of_half[at] = vec4<f32>(2.0 * variance_of_mean[at].xyz, 0.0);
}
