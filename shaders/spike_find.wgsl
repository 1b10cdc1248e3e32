// Finds spikes, and lights of few pixels, and replaces them by the level of their surroundings.
//
// A spike stands out from the pixels of its kind around it, as a small light does, but its excess rests on very few
// samples. If k of the n samples of a pixel are bright, its excess over the level is about √k standard deviations of
// its mean, for any n and any brightness. Both the sample variance and the halves show this; the larger of them is
// used, because either may miss it. A light has many bright samples, and without noise infinitely many. It is set
// aside, so that no average includes it, and comes back at the end.
#import stein::planes::{pixel_index}
#import stein::spike::{brightness, has_noise}
#import stein::spike_kind::{params, is_like}

// Two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
#ifdef VARIANCE
@group(0) @binding(3) var<storage, read> sample_variance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> repaired_variance: array<vec4<f32>>;
#endif
@group(0) @binding(5) var<storage, read_write> repaired: array<vec4<f32>>;
// Three planes: the amount taken from each pixel, 0 for a pixel that is no spike; then, in w, 1 for a pixel with noise,
// else 0; then, in z, the brightness of the brightest neighbour that counts for the level.
@group(0) @binding(6) var<storage, read_write> spikes: array<vec4<f32>>;
// Two planes: the mean of a light, in w its variance, summed over the channels; and its half spread, in w 1 for a
// light, else 0.
@group(0) @binding(7) var<storage, read_write> lights: array<vec4<f32>>;

// Variance from the halves alone: their squared spread is as likely to be too small as too large.
fn two_buffer_variance(at: i32) -> vec3<f32> {
    let spread = signal[params.extent.x * params.extent.y + at].xyz;
    return spread * spread;
}

fn claimed_variance(at: i32) -> vec3<f32> {
#ifdef VARIANCE
    return sample_variance[at].xyz;
#else
    return two_buffer_variance(at);
#endif
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let pixels = extent.x * extent.y;
    let at_p = pixel_index(p, extent);
    let first = max(p - params.window_radius, vec2<i32>(0));
    let last = min(p + params.window_radius, extent - 1);
    let own = signal[at_p].xyz;
    let own_brightness = brightness(own);
#ifdef VARIANCE
    let sampled = sample_variance[at_p].xyz;
#else
    let sampled = vec3<f32>(0.0);
#endif
    let is_noisy = has_noise(own, signal[pixels + at_p].xyz, sampled, params.least_noise);

    // Two neighbours may be parts of the same spike, so the third brightest neighbour is the first to show how bright
    // pixels of this kind are. Most pixels are no brighter than that, which is found early.
    var brighter = 0;
    for (var y = first.y; y <= last.y && brighter < 3; y++) {
        for (var x = first.x; x <= last.x && brighter < 3; x++) {
            let at_q = pixel_index(vec2<i32>(x, y), extent);
            if at_q != at_p && brightness(signal[at_q].xyz) >= own_brightness && is_like(at_p, at_q) {
                brighter++;
            }
        }
    }
    var neighbours = 0.0;
    var brightest = vec3<f32>(-3.4e38);
    if brighter < 3 {
        for (var y = first.y; y <= last.y; y++) {
            for (var x = first.x; x <= last.x; x++) {
                let at_q = pixel_index(vec2<i32>(x, y), extent);
                if at_q != at_p && is_like(at_p, at_q) {
                    let value = brightness(signal[at_q].xyz);
                    let second = max(brightest.y, min(brightest.x, value));
                    let third = max(brightest.z, min(brightest.y, value));
                    brightest = vec3<f32>(max(brightest.x, value), second, third);
                    neighbours += 1.0;
                }
            }
        }
    }
    let bright = brightest.z;

    var is_spike = neighbours >= params.least_neighbours;
    var is_light = false;
    var own_variance = vec3<f32>(0.0);
    var level = vec3<f32>(0.0);
    var level_variance = vec3<f32>(0.0);
    if is_spike {
        // The level is the mean of all neighbours of its kind that are no brighter than the third brightest.
        var members = 0.0;
        for (var y = first.y; y <= last.y; y++) {
            for (var x = first.x; x <= last.x; x++) {
                let at_q = pixel_index(vec2<i32>(x, y), extent);
                let color = signal[at_q].xyz;
                if at_q != at_p && brightness(color) <= bright && is_like(at_p, at_q) {
                    level += color;
                    level_variance += claimed_variance(at_q);
                    members += 1.0;
                }
            }
        }
        level /= members;
        level_variance /= members;
        let excess = own - level;
        let level_brightness = brightness(level);
        own_variance = max(claimed_variance(at_p), two_buffer_variance(at_p));
        let noise = dot(own_variance, vec3<f32>(1.0));
        let squared = dot(excess, excess);
        let stands_out = own_brightness - level_brightness > params.prominence * (bright - level_brightness);
        is_spike = stands_out && is_noisy && squared <= params.most_samples * noise;
        is_light = stands_out && squared > params.light_samples * noise;
    }

    let spread = signal[pixels + at_p];
    var excess = vec3<f32>(0.0);
    var aside = vec4<f32>(0.0);
    var aside_spread = vec4<f32>(0.0);
    if is_spike || is_light {
        excess = own - level;
        let deviation = sqrt(level_variance);
        repaired[at_p] = vec4<f32>(level, signal[at_p].w);
        let level_spread = clamp(spread.xyz, -deviation, deviation);
        repaired[pixels + at_p] = vec4<f32>(level_spread, spread.w);
        if is_light {
            aside = vec4<f32>(own, dot(own_variance, vec3<f32>(1.0)));
            aside_spread = vec4<f32>(spread.xyz, 1.0);
            excess = vec3<f32>(0.0);
        }
    } else {
        repaired[at_p] = signal[at_p];
        repaired[pixels + at_p] = spread;
    }
    spikes[at_p] = vec4<f32>(excess, 0.0);
    spikes[pixels + at_p] = vec4<f32>(0.0, 0.0, 0.0, select(0.0, 1.0, is_noisy));
    spikes[2 * pixels + at_p] = vec4<f32>(0.0, 0.0, bright, 0.0);
    lights[at_p] = aside;
    lights[pixels + at_p] = aside_spread;
#ifdef VARIANCE
    repaired_variance[at_p] = select(sample_variance[at_p], vec4<f32>(level_variance, 0.0), is_spike || is_light);
#endif
}
