// Finds sharp borders of light, such as the rim of a lamp: there a pixel stands out from its neighbours without noise.
#import stein::noise::{NoiseHoldParams}
#import stein::planes::{pixel_index}

@group(0) @binding(0) var<uniform> params: NoiseHoldParams;
// Output of noise_magnitude.
@group(0) @binding(1) var<storage, read> relative_spread: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> pooled_variance: array<vec4<f32>>;
// The variance in parts of the squared magnitude; in w 1 where brightness jumps.
@group(0) @binding(3) var<storage, read_write> relative_variance: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let pixels = extent.x * extent.y;
    let first = max(p - params.jump_radius, vec2<i32>(0));
    let last = min(p + params.jump_radius, extent - 1);
    var brightest = params.least_magnitude;
    var darkest = 3.4e38;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let median = max(relative_spread[pixels + pixel_index(vec2<i32>(x, y), extent)].x, params.least_magnitude);
            brightest = max(brightest, median);
            darkest = min(darkest, median);
        }
    }
    let at = pixel_index(p, extent);
    let magnitude = relative_spread[at].w;
    let jumps = select(0.0, 1.0, brightest > params.jump * darkest);
    relative_variance[at] = vec4<f32>(pooled_variance[at].xyz / (magnitude * magnitude), jumps);
}
