// Moves pixels on to the coarse scale unless this stopping map or the map of a finer scale stops them. Outliers of the
// maps are removed first (thesis 6.2.4).
#import stein::planes::{pixel_index}

struct ScaleAdvanceParams {
    extent: vec2<i32>,
    // σ of the coarse scale, in pixels.
    sigma: f32,
}

@group(0) @binding(0) var<uniform> params: ScaleAdvanceParams;
// x: the binary map, y: the bias term.
@group(0) @binding(1) var<storage, read> stops: array<vec4<f32>>;
// x: the map, smoothed.
@group(0) @binding(2) var<storage, read> smoothed: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> fine_variance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> coarse: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> coarse_variance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> selected: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> choice: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let state = choice[at];
    var stop = smoothed[at].x >= 0.5;
#ifdef COARSER_ONLY
    stop = stop && stops[at].x == 1.0;
#endif
    if state.y == 0.0 || stop {
        choice[at].y = 0.0;
        return;
    }
    // A pixel that comes to the fine scale has the variance of that scale plus the bias of the steps so far as its
    // error.
    let ones = vec3<f32>(1.0);
    let bias = max(state.z - dot(ones, fine_variance[at].xyz), 0.0) + stops[at].y;
    let taking_part = 1.0 / coarse_variance[at].w;
    selected[at] = vec4<f32>(coarse[at].xyz, taking_part);
    selected[pixels + at] = coarse[pixels + at];
    choice[at] = vec4<f32>(params.sigma, 1.0, bias + dot(ones, coarse_variance[at].xyz), taking_part * coarse[at].w);
}
