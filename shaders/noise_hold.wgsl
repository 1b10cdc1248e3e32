// Limits the variance of pixels near a jump of brightness to the mean variance of their neighbours without jumps, both
// relative to the squared magnitude.
#import stein::noise::{NoiseHoldParams}
#import stein::planes::{pixel_index}

@group(0) @binding(0) var<uniform> params: NoiseHoldParams;
// Output of noise_magnitude.
@group(0) @binding(1) var<storage, read> relative_spread: array<vec4<f32>>;
// Output of noise_jump.
@group(0) @binding(2) var<storage, read> relative_variance: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> variance: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let at = pixel_index(p, extent);
    let own = relative_variance[at];
    var held = own.xyz;
    if own.w != 0.0 {
        let first = max(p - params.radius, vec2<i32>(0));
        let last = min(p + params.radius, extent - 1);
        var sum = vec3<f32>(0.0);
        var count = 0.0;
        for (var y = first.y; y <= last.y; y++) {
            for (var x = first.x; x <= last.x; x++) {
                let other = relative_variance[pixel_index(vec2<i32>(x, y), extent)];
                sum += (1.0 - other.w) * other.xyz;
                count += 1.0 - other.w;
            }
        }
        // If all pixels around have jumps, the noise counts as no larger than the magnitude.
        held = min(held, select(vec3<f32>(1.0), sum / max(count, 1.0), count > 0.0));
    }
    let magnitude = relative_spread[at].w;
    variance[at] = vec4<f32>(magnitude * magnitude * held, 0.0);
}
