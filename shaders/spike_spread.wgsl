// Adds parts of the spikes around to each pixel that has noise and is about as bright, and records how uncertain they
// are: a spike might as well have fallen elsewhere, so the pixel gets its part or nothing. Therefore the squares of the
// parts are summed.
#import stein::planes::{pixel_index}
#import stein::spike::{affinity, falloff}
#import stein::spike_kind::{params, is_like}

// The first plane holds the amount taken from each pixel. The second holds the amount that a pixel of the spike's kind
// gets at the spike's position, and in w 1 if a spike lies in the row around the pixel. The x of the
// third is written: the squares of the parts, summed over spikes and channels.
@group(0) @binding(1) var<storage, read_write> spikes: array<vec4<f32>>;
// Output of spike_level.
@group(0) @binding(3) var<storage, read> levels: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> repaired: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let q = vec2<i32>(id.xy);
    if any(q >= extent) {
        return;
    }
    let pixels = extent.x * extent.y;
    let at_q = pixel_index(q, extent);
    let own = levels[at_q];
    if own.y == 0.0 {
        spikes[2 * pixels + at_q].x = 0.0;
        return;
    }
    let first = max(q - params.spread_radius, vec2<i32>(0));
    let last = min(q + params.spread_radius, extent - 1);
    var sum = vec3<f32>(0.0);
    var squares = 0.0;
    for (var y = first.y; y <= last.y; y++) {
        // Spikes are rare: most rows have none.
        if spikes[pixels + pixel_index(vec2<i32>(q.x, y), extent)].w > 0.0 {
            for (var x = first.x; x <= last.x; x++) {
                let at_p = pixel_index(vec2<i32>(x, y), extent);
                let share = spikes[pixels + at_p].xyz;
                if any(share != vec3<f32>(0.0)) && is_like(at_p, at_q) {
                    let gets = falloff(vec2<i32>(x, y) - q, params.spread_radius) * affinity(levels[at_p].x, own.x)
                        * share;
                    sum += gets;
                    squares += dot(gets, gets);
                }
            }
        }
    }
    spikes[2 * pixels + at_q].x = squares;
    repaired[at_q] = vec4<f32>(repaired[at_q].xyz + sum, repaired[at_q].w);
}
