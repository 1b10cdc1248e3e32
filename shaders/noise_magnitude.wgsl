// Brightness of the light around a pixel (the magnitude), and half spread of the pixel in parts of it.
//
// The median of the 3×3 pixels passes over single bright pixels. A pixel that is much darker than its neighbours has
// noise of the size of its own brightness, not of theirs.
#import stein::noise::{NoiseParams, brightness}
#import stein::planes::{lower_median, pixel_index}

@group(0) @binding(0) var<uniform> params: NoiseParams;
// Two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
// Two planes: the half spread in parts of the magnitude, in w the magnitude; then in x the median.
@group(0) @binding(2) var<storage, read_write> relative_spread: array<vec4<f32>>;

fn median_brightness(p: vec2<i32>) -> f32 {
    let first = max(p - 1, vec2<i32>(0));
    let last = min(p + 1, params.extent - 1);
    var values: array<f32, 9>;
    var count = 0;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            values[count] = brightness(signal[pixel_index(vec2<i32>(x, y), params.extent)].xyz);
            count++;
        }
    }
    return lower_median(values, count);
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    let own = brightness(signal[at].xyz);
    let median = median_brightness(p);
    let magnitude = max(min(median, params.darker * own), params.least_magnitude);
    let pixels = params.extent.x * params.extent.y;
    let spread = signal[pixels + at].xyz;
    relative_spread[at] = vec4<f32>(spread / magnitude, magnitude);
    relative_spread[pixels + at] = vec4<f32>(median, 0.0, 0.0, 0.0);
}
