// How bright each pixel's surroundings are without spikes, and whether the pixel has noise: what tells spike_share and spike_spread who gets a part of a spike.
//
// The median of the 3×3 pixels around follows an edge of light, where a mean would mix both of its sides.
#import stein::planes::{pixel_index}
#import stein::spike::{SpikeParams, brightness}

@group(0) @binding(0) var<uniform> params: SpikeParams;
// As spike_find got it: the mean, then the half spread.
// As spike_find left them: the signal without spikes, and in the w of the second plane whether a pixel has noise.
@group(0) @binding(1) var<storage, read> repaired: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> spikes: array<vec4<f32>>;
// x: the level, a brightness, at least 0; y: 1 for a pixel with noise, else 0.
@group(0) @binding(3) var<storage, read_write> levels: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let first = max(p - 1, vec2<i32>(0));
    let last = min(p + 1, extent - 1);
    var values: array<f32, 9>;
    var members = 0;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            values[members] = brightness(repaired[pixel_index(vec2<i32>(x, y), extent)].xyz);
            members++;
        }
    }
    // The member with so many below it: of an even number the lower one of the two in the middle.
    let wanted = (members - 1) / 2;
    var level = 0.0;
    for (var i = 0; i < members; i++) {
        var below = 0;
        var same = 0;
        for (var j = 0; j < members; j++) {
            below += select(0, 1, values[j] < values[i]);
            same += select(0, 1, values[j] == values[i]);
        }
        if below <= wanted && wanted < below + same {
            level = values[i];
        }
    }
    let at = pixel_index(p, extent);
    levels[at] = vec4<f32>(max(level, 0.0), spikes[extent.x * extent.y + at].w, 0.0, 0.0);
}
