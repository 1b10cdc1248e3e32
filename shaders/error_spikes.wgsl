// Adds to the squared error of a filtered signal the error that spikes around a pixel leave in it: the squares of the
// amounts that the pixel got from each.
#import stein::planes::{pixel_index}

struct ErrorSpikesParams {
    extent: vec2<i32>,
    // Weight of the squares.
    spikes: f32,
}

@group(0) @binding(0) var<uniform> params: ErrorSpikesParams;
// Output of spike_spread, three planes: the last holds in x the squares, summed over spikes and channels.
@group(0) @binding(1) var<storage, read> spikes: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> errors: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    errors[at].x += params.spikes * spikes[2 * params.extent.x * params.extent.y + at].x;
}
