// A first guess at the variance: the half spread relative to the magnitude is squared, smoothed and scaled back.
// Smoothing the squares themselves would carry the noise of a light into the dark beside it.
#import stein::noise::{NoiseParams}
#import stein::planes::{pixel_index}

@group(0) @binding(0) var<uniform> params: NoiseParams;
// Output of noise_magnitude.
@group(0) @binding(1) var<storage, read> relative_spread: array<vec4<f32>>;
// xyz: the guess, w: the magnitude.
@group(0) @binding(2) var<storage, read_write> guess: array<vec4<f32>>;

const PIXELS: i32 = #{PIXELS};

// An invocation computes PIXELS pixels in a row: their surroundings share most of their pixels, and loads are the main
// cost.
@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let first = vec2<i32>(id.xy) * vec2<i32>(PIXELS, 1);
    if any(first >= extent) {
        return;
    }
    let radius = params.guess_radius;
    let exponent = params.guess_exponent;
    var sums: array<vec3<f32>, PIXELS>;
    var weight_sums: array<f32, PIXELS>;
    for (var y = max(first.y - radius, 0); y <= min(first.y + radius, extent.y - 1); y++) {
        for (var x = max(first.x - radius, 0); x <= min(first.x + PIXELS - 1 + radius, extent.x - 1); x++) {
            let spread = relative_spread[pixel_index(vec2<i32>(x, y), extent)].xyz;
            for (var i = 0; i < PIXELS; i++) {
                let offset = vec2<f32>(vec2<i32>(x, y) - first - vec2<i32>(i, 0));
                let w = select(0.0, exp(exponent * dot(offset, offset)), abs(x - first.x - i) <= radius);
                sums[i] += w * spread * spread;
                weight_sums[i] += w;
            }
        }
    }
    for (var i = 0; i < PIXELS; i++) {
        if first.x + i < extent.x {
            let at = pixel_index(first, extent) + i;
            let magnitude = relative_spread[at].w;
            guess[at] = vec4<f32>(magnitude * magnitude * sums[i] / weight_sums[i], magnitude);
        }
    }
}
