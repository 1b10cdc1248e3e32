// Computes the part of a spike that the pixels around it get.
//
// The pixels that get a part are all pixels of the spike's kind in a wide window that have noise and are about as
// bright; a pixel gets less the further away it is, and a pixel without noise gets nothing. One spike says little about
// the amount of light: it stands for all the pixels up to the next spike. A spike that would raise the level around it
// by more than a certain part is rarer than that: the more it would raise the level, the more of the spike is left out.
#import stein::planes::{pixel_index}
#import stein::spike::{affinity, brightness, falloff}
#import stein::spike_kind::{params, is_like}

// Output of spike_find: the amount taken from each pixel. Here w becomes the part of this amount that other pixels get;
// the second plane becomes the amount that one of them would get at the position of the spike, and the y of the third
// the number of those pixels, each as far as it gets a part.
@group(0) @binding(1) var<storage, read_write> spikes: array<vec4<f32>>;
// Output of spike_level.
@group(0) @binding(3) var<storage, read> levels: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let pixels = extent.x * extent.y;
    let at_p = pixel_index(p, extent);
    let taken = spikes[at_p].xyz;
    // Channels below the level got brighter by the repair; no other pixel has to give that back.
    let excess = max(taken, vec3<f32>(0.0));
    var part = 0.0;
    var share = vec3<f32>(0.0);
    var members = 0.0;
    if any(taken != vec3<f32>(0.0)) {
        let first = max(p - params.spread_radius, vec2<i32>(0));
        let last = min(p + params.spread_radius, extent - 1);
        let level = levels[at_p].x;
        var member_levels = 0.0;
        for (var y = first.y; y <= last.y; y++) {
            for (var x = first.x; x <= last.x; x++) {
                let at_q = pixel_index(vec2<i32>(x, y), extent);
                let of_q = levels[at_q];
                let gets = falloff(vec2<i32>(x, y) - p, params.spread_radius) * affinity(level, of_q.x) * of_q.y;
                if gets > 0.0 && is_like(at_p, at_q) {
                    members += gets;
                    member_levels += gets * of_q.x;
                }
            }
        }
        if members > 0.0 {
            let even = excess / members;
            let limit = params.share_limit * min(level, member_levels / members);
            part = limit / max(limit + brightness(even), 1e-30);
            share = part * even;
        }
    }
    spikes[at_p].w = part;
    spikes[pixels + at_p] = vec4<f32>(share, 0.0);
    spikes[2 * pixels + at_p].y = members;
}
