// Keeps pixels without noise as they are: moves a filtered pixel back to its input where the input's noise is below
// what its values are rounded by.
//
// Weights alone do not ensure this. A patch that differs in one pixel can be near, and the variance of a neighbour with
// noise says nothing about a pixel that has none.
//
// A black pixel without noise may be a pixel whose samples all missed the light. It counts as black only if all pixels
// around it are black and without noise, too.
#import stein::planes::{clamped_index, pixel_index}

struct KeepCleanParams {
    extent: vec2<i32>,
    // Square of the noise above which a pixel is filtered freely, in parts of its value.
    squared_noise: f32,
    // Square of the correction that a pixel with less noise may get, in standard deviations; it grows without limit
    // towards that noise.
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
// A signal.
@group(0) @binding(3) var<storage, read> filtered: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> kept: array<vec4<f32>>;
#ifdef ERROR
// Changed in place: a pixel that stays has the noise of its input.
@group(0) @binding(5) var<storage, read_write> errors: array<vec4<f32>>;
#endif

const ANY: f32 = 3.4e38;

// Squared spread of the nearest pixel of the image: beyond the border that is a pixel that counts anyway.
fn spread_squared(p: vec2<i32>) -> f32 {
    let spread = signal[params.extent.x * params.extent.y + clamped_index(p, params.extent)].xyz;
    return dot(spread, spread);
}

// Σ over the channels of the variance that the samples of a pixel show. Halves alone may agree by accident, so the
// halves of the pixels beside count too.
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

// The square of the correction that a pixel may get; ANY where nothing limits it.
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
        kept[pixels + at] = spread;
        return;
    }
    let correction = mean.xyz - own;
    let squared = dot(correction, correction);
    let share = select(1.0, sqrt(allowed / squared), squared > allowed);
    kept[at] = vec4<f32>(own + share * correction, mean.w);
    kept[pixels + at] = vec4<f32>(own_spread + share * (spread.xyz - own_spread), spread.w);
#ifdef ERROR
    // A pixel that moves so little has no more error than its noise and the largest correction that it may get.
    errors[at][params.error_component] = min(errors[at][params.error_component], noise_at(p) + allowed);
#endif
}
