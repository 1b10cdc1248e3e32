// Brightness around each pixel without spikes, and whether the pixel has noise. From these, spike_share and
// spike_spread decide which pixels get a part of a spike.
//
// The median of the 3×3 pixels around follows an edge of light, where a mean would mix both of its sides.
#import stein::planes::{lower_median, pixel_index}
#import stein::spike::{SpikeParams, brightness}

@group(0) @binding(0) var<uniform> params: SpikeParams;
// Output of spike_find: the signal without spikes, and in the w of the second plane whether a pixel has noise.
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
    let at = pixel_index(p, extent);
    levels[at] = vec4<f32>(max(lower_median(values, members), 0.0), spikes[extent.x * extent.y + at].w, 0.0, 0.0);
}
