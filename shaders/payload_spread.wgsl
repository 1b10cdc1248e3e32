// Adds parts of the spikes around to each pixel of a payload, as spike_spread does with the colour: the same pixels get
// the same parts.
#import stein::planes::{pixel_index}
#import stein::spike::{affinity, falloff}
#import stein::spike_kind::{params, is_like}

const PLANES: i32 = #{PLANES};

// The second plane holds, in x, y and z, the amount of the colour that a pixel gets at the spike's position, and in w 1
// if a spike lies in the row around the pixel.
@group(0) @binding(1) var<storage, read> spikes: array<vec4<f32>>;
// Output of spike_level.
@group(0) @binding(3) var<storage, read> levels: array<vec4<f32>>;
// Output of payload_level: the amount of each plane that a pixel gets at the spike's position.
@group(0) @binding(4) var<storage, read> shares: array<vec4<f32>>;
// PLANES planes, changed in place.
@group(0) @binding(5) var<storage, read_write> repaired: array<vec4<f32>>;

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
        return;
    }
    let first = max(q - params.spread_radius, vec2<i32>(0));
    let last = min(q + params.spread_radius, extent - 1);
    var sums: array<vec4<f32>, PLANES>;
    var gets_any = false;
    for (var y = first.y; y <= last.y; y++) {
        // Spikes are rare: most rows have none.
        if spikes[pixels + pixel_index(vec2<i32>(q.x, y), extent)].w > 0.0 {
            for (var x = first.x; x <= last.x; x++) {
                let at_p = pixel_index(vec2<i32>(x, y), extent);
                if any(spikes[pixels + at_p].xyz != vec3<f32>(0.0)) && is_like(at_p, at_q) {
                    let factor = falloff(vec2<i32>(x, y) - q, params.spread_radius) * affinity(levels[at_p].x, own.x);
                    for (var plane = 0; plane < PLANES; plane++) {
                        sums[plane] += factor * shares[plane * pixels + at_p];
                    }
                    gets_any = true;
                }
            }
        }
    }
    if gets_any {
        for (var plane = 0; plane < PLANES; plane++) {
            repaired[plane * pixels + at_q] += sums[plane];
        }
    }
}
