// Records for each pixel whether a spike lies in the row around it, so that spike_spread need not look at each pixel of
// its window.
#import stein::planes::{pixel_index}
#import stein::spike::{SpikeParams}

@group(0) @binding(0) var<uniform> params: SpikeParams;
// Output of spike_share and input of spike_spread.
@group(0) @binding(1) var<storage, read_write> spikes: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    var found = false;
    for (var x = max(p.x - params.spread_radius, 0); x <= min(p.x + params.spread_radius, extent.x - 1); x++) {
        found = found || any(spikes[pixel_index(vec2<i32>(x, p.y), extent)].xyz != vec3<f32>(0.0));
    }
    let at = extent.x * extent.y + pixel_index(p, extent);
    spikes[at].w = select(0.0, 1.0, found);
}
