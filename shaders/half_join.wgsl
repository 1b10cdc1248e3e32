// Joins two filtered halves to a signal (thesis 7.1.1): the mean of both, with the mean of their w, and their half
// spread. `weights` gets the mean of their Σ w.
#import stein::planes::{pixel_index}

struct HalfParams {
    extent: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: HalfParams;
@group(0) @binding(1) var<storage, read> half_a: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> half_b: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> weights_a: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> weights_b: array<vec4<f32>>;
// Two planes: the mean, then the half spread.
@group(0) @binding(5) var<storage, read_write> signal: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> weights: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    let a = half_a[at];
    let b = half_b[at];
    signal[at] = 0.5 * (a + b);
    signal[params.extent.x * params.extent.y + at] = vec4<f32>(0.5 * (a.xyz - b.xyz), 0.0);
    weights[at] = vec4<f32>(0.5 * (weights_a[at].x + weights_b[at].x), 0.0, 0.0, 0.0);
}
