// A first guess at the variance: the squared half spread, smoothed in parts of the magnitude. Smoothed as it is, it
// would carry the noise of a light into the dark beside it.
#import stein::noise::{NoiseParams}
#import stein::planes::{pixel_index}

@group(0) @binding(0) var<uniform> params: NoiseParams;
// As noise_magnitude left it.
@group(0) @binding(1) var<storage, read> relative_spread: array<vec4<f32>>;
// In w the magnitude.
@group(0) @binding(2) var<storage, read_write> guess: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let first = max(p - params.guess_radius, vec2<i32>(0));
    let last = min(p + params.guess_radius, params.extent - 1);
    var sum = vec3<f32>(0.0);
    var weight_sum = 0.0;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let offset = vec2<f32>(vec2<i32>(x, y) - p);
            let w = exp(params.guess_exponent * dot(offset, offset));
            let spread = relative_spread[pixel_index(vec2<i32>(x, y), params.extent)].xyz;
            sum += w * spread * spread;
            weight_sum += w;
        }
    }
    let at = pixel_index(p, params.extent);
    let magnitude = relative_spread[at].w;
    guess[at] = vec4<f32>(magnitude * magnitude * sum / weight_sum, magnitude);
}
