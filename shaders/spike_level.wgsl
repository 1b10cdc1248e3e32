// How bright each pixel's surroundings are without spikes, and whether the pixel has noise: what tells spike_share and spike_spread who gets a part of a spike.
//
// The median of the 3×3 pixels around follows an edge of light, where a mean would mix both of its sides.
#import stein::planes::{pixel_index}
#import stein::spike::{SpikeParams, brightness, has_noise}

@group(0) @binding(0) var<uniform> params: SpikeParams;
// As spike_find got it: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
#ifdef VARIANCE
@group(0) @binding(2) var<storage, read> sample_variance: array<vec4<f32>>;
#endif
// As spike_find left it.
@group(0) @binding(3) var<storage, read> repaired: array<vec4<f32>>;
// x: the level, a brightness, at least 0; y: 1 for a pixel with noise, else 0.
@group(0) @binding(4) var<storage, read_write> levels: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let first = max(p - 1, vec2<i32>(0));
    let last = min(p + 1, extent - 1);
    let members = (last.x - first.x + 1) * (last.y - first.y + 1);
    // The member with so many below it: of an even number the lower one of the two in the middle.
    let wanted = (members - 1) / 2;
    var level = 0.0;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let value = brightness(repaired[pixel_index(vec2<i32>(x, y), extent)].xyz);
            var below = 0;
            var same = 0;
            for (var v = first.y; v <= last.y; v++) {
                for (var u = first.x; u <= last.x; u++) {
                    let other = brightness(repaired[pixel_index(vec2<i32>(u, v), extent)].xyz);
                    below += select(0, 1, other < value);
                    same += select(0, 1, other == value);
                }
            }
            if below <= wanted && wanted < below + same {
                level = value;
            }
        }
    }
    let at = pixel_index(p, extent);
#ifdef VARIANCE
    let variance = sample_variance[at].xyz;
#else
    let variance = vec3<f32>(0.0);
#endif
    let noisy = has_noise(signal[at].xyz, signal[extent.x * extent.y + at].xyz, variance);
    levels[at] = vec4<f32>(max(level, 0.0), select(0.0, 1.0, noisy), 0.0, 0.0);
}
