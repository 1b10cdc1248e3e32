// Mixes two versions of a payload, pixel by pixel, as the colour was mixed: `first` where the share is 0, `second`
// where it is 1.
#import stein::planes::{pixel_index}

struct PayloadMixParams {
    extent: vec2<i32>,
    // Number of planes of the payload.
    planes: i32,
    // Plane and component of `shares` that hold the share of `second`.
    share_plane: i32,
    share_component: i32,
    // The share of `second` without SHARED.
    share: f32,
}

@group(0) @binding(0) var<uniform> params: PayloadMixParams;
@group(0) @binding(1) var<storage, read> first: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> second: array<vec4<f32>>;
#ifdef SHARED
@group(0) @binding(3) var<storage, read> shares: array<vec4<f32>>;
#endif
@group(0) @binding(4) var<storage, read_write> mixed: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
#ifdef SHARED
    let share = shares[params.share_plane * pixels + at][params.share_component];
#else
    let share = params.share;
#endif
    for (var plane = 0; plane < params.planes; plane++) {
        mixed[plane * pixels + at] = mix(first[plane * pixels + at], second[plane * pixels + at], share);
    }
}
