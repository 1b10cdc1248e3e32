// Brings one prefiltered feature into the form that the bilateral weights read: value, residual variance, and the
// larger of residual variance and squared gradient.
//
// A group of features is one vec4 per pixel and quantity: a feature of up to three channels in x, y, z (the triple) and
// a feature of one channel in w (the single).
#import stein::planes::{pixel_index}

struct FeaturePackParams {
    extent: vec2<i32>,
    group: i32,
    // 1: the feature goes to w and leaves the triple as it is; 0: it goes to x, y, z and clears w.
    single: i32,
}

@group(0) @binding(0) var<uniform> params: FeaturePackParams;
@group(0) @binding(1) var<storage, read> filtered: array<vec4<f32>>;
// Absent where the feature has no noise.
#ifdef NOISY
@group(0) @binding(2) var<storage, read> residual_variance: array<vec4<f32>>;
#endif
// Three planes per group: value, residual variance, scale.
@group(0) @binding(3) var<storage, read_write> features: array<vec4<f32>>;

// The smaller of the two one-sided differences over half a pixel: it keeps the gradient of an edge out of the pixels
// beside it. At the border only one of them exists.
fn half_pixel_difference(p: vec2<i32>, axis: vec2<i32>) -> vec4<f32> {
    let here = filtered[pixel_index(p, params.extent)];
    let has_next = all(p + axis < params.extent);
    let has_previous = all(p - axis >= vec2<i32>(0));
    let next = filtered[pixel_index(select(p, p + axis, has_next), params.extent)] - here;
    let previous = here - filtered[pixel_index(select(p, p - axis, has_previous), params.extent)];
    if has_next && has_previous {
        return 0.5 * select(previous, next, abs(next) < abs(previous));
    }
    // The missing difference is zero.
    return 0.5 * (next + previous);
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at_p = pixel_index(p, params.extent);
    let along_x = half_pixel_difference(p, vec2<i32>(1, 0));
    let along_y = half_pixel_difference(p, vec2<i32>(0, 1));
    let value = filtered[at_p];
#ifdef NOISY
    let residual = residual_variance[at_p];
#else
    let residual = vec4<f32>(0.0);
#endif
    let scale = max(residual, along_x * along_x + along_y * along_y);
    let at = params.group * 3 * pixels + at_p;
    if params.single == 1 {
        features[at].w = value.x;
        features[at + pixels].w = residual.x;
        features[at + 2 * pixels].w = scale.x;
    } else {
        features[at] = vec4<f32>(value.xyz, 0.0);
        features[at + pixels] = vec4<f32>(residual.xyz, 0.0);
        features[at + 2 * pixels] = vec4<f32>(scale.xyz, 0.0);
    }
}
