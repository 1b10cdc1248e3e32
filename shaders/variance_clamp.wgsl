// Holds a filtered variance below the variance that the samples claim (thesis 7.1.1): filtering raises it beside noisy
// regions.
#import stein::planes::{pixel_index}

struct VarianceClampParams {
    extent: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: VarianceClampParams;
@group(0) @binding(1) var<storage, read> variance: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> upper_bound: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> clamped_variance: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    clamped_variance[at] = vec4<f32>(min(variance[at].xyz, upper_bound[at].xyz), 0.0);
}
