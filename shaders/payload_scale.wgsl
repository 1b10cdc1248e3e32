// Takes the pixels of a payload at a coarse scale wherever the colour has moved on to that scale (thesis 6.2.1).
#import stein::planes::{pixel_index}

struct PayloadScaleParams {
    extent: vec2<i32>,
    // Number of planes of the payload.
    planes: i32,
    // σ of the coarse scale, in pixels.
    sigma: f32,
}

@group(0) @binding(0) var<uniform> params: PayloadScaleParams;
// x: σ of the scale that the colour has reached, in pixels.
@group(0) @binding(1) var<storage, read> choice: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> coarse: array<vec4<f32>>;
// Changed in place.
@group(0) @binding(3) var<storage, read_write> selected: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    if choice[at].x != params.sigma {
        return;
    }
    for (var plane = 0; plane < params.planes; plane++) {
        selected[plane * pixels + at] = coarse[plane * pixels + at];
    }
}
