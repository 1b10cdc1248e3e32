// Holds a variance above the rounding of the values it belongs to, so that distances do not divide by zero and depend
// only on the pixels that they compare (eq. 7.4).
//
// An ε of one size for the whole image would blur dark parts beside bright ones: every squared difference in them is
// smaller than ε.
#import stein::planes::{largest_channel, pixel_index}

struct VarianceFloorParams {
    extent: vec2<i32>,
    // The least standard deviation, in parts of the pixel's brightness …
    own: f32,
    // … in parts of the brightness around it …
    around: f32,
    // … and in the unit of the values.
    absolute: f32,
}

@group(0) @binding(0) var<uniform> params: VarianceFloorParams;
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> variance: array<vec4<f32>>;
// In w the brightness around the pixel: the largest magnitude of any channel in the 3×3 pixels around it. Finite
// differences take their least step from it.
@group(0) @binding(3) var<storage, read_write> floored_variance: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let first = max(p - 1, vec2<i32>(0));
    let last = min(p + 1, extent - 1);
    var most = vec3<f32>(0.0);
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            most = max(most, abs(signal[pixel_index(vec2<i32>(x, y), extent)].xyz));
        }
    }
    let at = pixel_index(p, extent);
    let around = largest_channel(most);
    let least = max(max(params.own * largest_channel(abs(signal[at].xyz)), params.around * around), params.absolute);
    floored_variance[at] = vec4<f32>(max(variance[at].xyz, vec3<f32>(least * least)), around);
}
