// Keeps pixels without noise as they are: moves a filtered pixel back towards its input where the noise of the input is
// a negligible part of its value. The less noise, the closer the pixel stays to its input.
//
// The weights of the filters do not ensure this. A patch that differs in one pixel can still be near, and a
// noisy neighbour has a large variance, which makes it similar to a pixel without noise.
//
// A black pixel without noise may be a pixel whose samples all missed the light. It counts as black only if all pixels
// around it are black and without noise, too.
#import stein::planes::{clamped_index, pixel_index}

struct KeepCleanParams {
    extent: vec2<i32>,
    // Noise above which a pixel is filtered freely: its variance in parts of the squared value.
    squared_noise: f32,
    // Square of the correction that a pixel with less noise may get, in variances of the pixel. The limit grows to
    // infinity as the noise approaches `squared_noise`.
    squared_sigmas: f32,
    // Half width of the window around a black pixel in which every pixel has to be black.
    black_radius: i32,
    // Component of `errors` that holds the squared error.
    error_component: i32,
}

@group(0) @binding(0) var<uniform> params: KeepCleanParams;
// Input without spikes, two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
#ifdef VARIANCE
// Variance of the mean of the input.
@group(0) @binding(2) var<storage, read> sample_variance: array<vec4<f32>>;
#endif
// The filtered signal, two planes.
@group(0) @binding(3) var<storage, read> filtered: array<vec4<f32>>;
// The w of the half spread becomes the share of the filtered signal in the pixel, 0 to 1.
@group(0) @binding(4) var<storage, read_write> kept: array<vec4<f32>>;
#ifdef ERROR
// Changed in place: the error of a pixel with a limit is at most its noise plus the squared limit.
@group(0) @binding(5) var<storage, read_write> errors: array<vec4<f32>>;
#endif

const ANY: f32 = 3.4e38;

// Squared spread of a pixel, or of the nearest pixel of the image for a position beyond the border.
fn spread_squared(p: vec2<i32>) -> f32 {
    let spread = signal[params.extent.x * params.extent.y + clamped_index(p, params.extent)].xyz;
    return dot(spread, spread);
}

// Variance that the samples of a pixel show, summed over the channels. Without a sample variance, the halves of the
// pixels beside count, too, because the halves of one pixel may agree by accident.
fn noise_at(p: vec2<i32>) -> f32 {
#ifdef VARIANCE
    let at = pixel_index(p, params.extent);
    let spread = signal[params.extent.x * params.extent.y + at].xyz;
    return dot(max(sample_variance[at].xyz, spread * spread), vec3<f32>(1.0));
#else
    let along_x = max(spread_squared(p - vec2<i32>(1, 0)), spread_squared(p + vec2<i32>(1, 0)));
    let along_y = max(spread_squared(p - vec2<i32>(0, 1)), spread_squared(p + vec2<i32>(0, 1)));
    return max(spread_squared(p), max(along_x, along_y));
#endif
}

fn is_black_around(p: vec2<i32>) -> bool {
    let first = max(p - params.black_radius, vec2<i32>(0));
    let last = min(p + params.black_radius, params.extent - 1);
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let q = vec2<i32>(x, y);
            if any(signal[pixel_index(q, params.extent)].xyz != vec3<f32>(0.0)) || noise_at(q) > 0.0 {
                return false;
            }
        }
    }
    return true;
}

// Square of the correction that a pixel may get; ANY without a limit.
fn allowed_at(p: vec2<i32>) -> f32 {
    let value = signal[pixel_index(p, params.extent)].xyz;
    if all(value == vec3<f32>(0.0)) {
        return select(ANY, 0.0, is_black_around(p));
    }
    let noise = noise_at(p);
    let closeness = noise / max(params.squared_noise * dot(value, value), 1e-37);
    return select(params.squared_sigmas * noise / (1.0 - closeness), ANY, closeness >= 1.0);
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let pixels = extent.x * extent.y;
    let at = pixel_index(p, extent);
    let mean = filtered[at];
    let spread = filtered[pixels + at];
    let own = signal[at].xyz;
    let own_spread = signal[pixels + at].xyz;
    let allowed = allowed_at(p);
    if allowed == ANY {
        kept[at] = mean;
        kept[pixels + at] = vec4<f32>(spread.xyz, 1.0);
        return;
    }
    let correction = mean.xyz - own;
    let squared = dot(correction, correction);
    let share = select(1.0, sqrt(allowed / squared), squared > allowed);
    kept[at] = vec4<f32>(mix(own, mean.xyz, share), mean.w);
    kept[pixels + at] = vec4<f32>(mix(own_spread, spread.xyz, share), share);
#ifdef ERROR
    // The pixel moves by at most the allowed correction, so its error is at most its noise plus the square of the
    // correction.
    errors[at][params.error_component] = min(errors[at][params.error_component], noise_at(p) + allowed);
#endif
}
