// Parts of the reduction of relative MSE by new samples (thesis 6.3): x: the relative MSE, y: the samples in the
// filter's support, 0 if unknown, z: σ of the filter in pixels.
#import stein::planes::{pixel_index}

struct ScaleReductionParams {
    extent: vec2<i32>,
    // Added to the squared value in the relative error, so that dark pixels do not take everything.
    relative_floor: f32,
}

@group(0) @binding(0) var<uniform> params: ScaleReductionParams;
@group(0) @binding(1) var<storage, read> selected: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> choice: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> reduction: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    let value = selected[at].xyz;
    let relative = choice[at].z / (dot(value, value) + 3.0 * params.relative_floor);
    reduction[at] = vec4<f32>(relative, choice[at].w, choice[at].x, 0.0);
}
