// Extracts the pooled variance of the colour, or of one feature.
#import stein::planes::{pixel_index}

struct NoiseUnpackParams {
    extent: vec2<i32>,
    // Plane that holds the variance.
    plane: i32,
    // 1: the variance is in w; 0: it is in x, y, z.
    single: i32,
}

@group(0) @binding(0) var<uniform> params: NoiseUnpackParams;
// Output of noise_pool: one plane for the colour, then one per group of features.
@group(0) @binding(1) var<storage, read> pooled_variance: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> variance: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    let packed = pooled_variance[params.plane * params.extent.x * params.extent.y + at];
    variance[at] = select(vec4<f32>(packed.xyz, 0.0), vec4<f32>(packed.w, 0.0, 0.0, 0.0), params.single == 1);
}
