// Binary selection maps (Algorithm 1 lines 24–26, the typo of line 26 mended): 1 for the candidate with the least
// smoothed error, 0 for the others.
//
// On ties the later, more robust candidate wins. FIRST may win only where it filters more than SECOND, shown by the
// smaller mean derivative (thesis 8.4): SURE does not notice noise that FIRST keeps. Without SECOND this condition does
// not apply. An error that is not finite cannot win; if no error is finite, the last candidate that takes part wins.
#import stein::planes::{pixel_index}

struct SelectLeastParams {
    extent: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: SelectLeastParams;
// Smoothed errors, x: FIRST, y: SECOND, z: THIRD.
@group(0) @binding(1) var<storage, read> errors: array<vec4<f32>>;
#ifdef FIRST
#ifdef SECOND
@group(0) @binding(2) var<storage, read> derivatives: array<vec4<f32>>;
#endif
#endif
@group(0) @binding(3) var<storage, read_write> selected: array<vec4<f32>>;

// Tests the bits: a compiler may assume that a comparison never meets NaN.
fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    let error = errors[at];
    var least = 3.4e38;
    var map = vec4<f32>(0.0);
#ifdef THIRD
    map = vec4<f32>(0.0, 0.0, 1.0, 0.0);
    if is_finite(error.z) {
        least = error.z;
    }
#endif
#ifdef SECOND
    if (is_finite(error.y) && error.y < least) || all(map == vec4<f32>(0.0)) {
        map = vec4<f32>(0.0, 1.0, 0.0, 0.0);
        if is_finite(error.y) {
            least = error.y;
        }
    }
#endif
#ifdef FIRST
    var may_win = true;
#ifdef SECOND
    let pixels = params.extent.x * params.extent.y;
    let one = vec3<f32>(1.0);
    may_win = dot(one, derivatives[at].xyz) < dot(one, derivatives[pixels + at].xyz);
#endif
    if (is_finite(error.x) && error.x < least && may_win) || all(map == vec4<f32>(0.0)) {
        map = vec4<f32>(1.0, 0.0, 0.0, 0.0);
    }
#endif
    selected[at] = map;
}
