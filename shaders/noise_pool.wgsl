// Pools the noise of pixels that are alike: from the half spreads of many a variance of each.
//
// Single pixels are compared, not patches: what is dark has to be pooled with what is dark. The mean of the absolute
// spreads is taken and not of their squares, of which one firefly would decide.
#import stein::noise::{NoiseParams}
#import stein::planes::{clamped_index, largest_channel, pixel_index}

const FEATURE_GROUPS: i32 = #{FEATURE_GROUPS};

@group(0) @binding(0) var<uniform> params: NoiseParams;
// Two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
// As noise_guess left it.
@group(0) @binding(2) var<storage, read> guess: array<vec4<f32>>;
#if FEATURE_GROUPS != 0
// As noise_feature left them.
@group(0) @binding(3) var<storage, read> features: array<vec4<f32>>;
#endif
// One plane of the colour, then one per group of features.
@group(0) @binding(4) var<storage, read_write> pooled_variance: array<vec4<f32>>;

const HALF_PI: f32 = 1.57079633;

fn largest_spread(p: vec2<i32>) -> f32 {
    return largest_channel(abs(signal[params.extent.x * params.extent.y + clamped_index(p, params.extent)].xyz));
}

// What has next to no noise keeps it, however noisy the pixels are that look like it. Halves alone may agree by
// accident, so that those of the pixels beside have a say too. All samples of a black pixel may have missed the light.
fn has_noise(p: vec2<i32>) -> bool {
    let at = pixel_index(p, params.extent);
    let value = largest_channel(abs(signal[at].xyz));
    let along_x = max(largest_spread(p - vec2<i32>(1, 0)), largest_spread(p + vec2<i32>(1, 0)));
    let along_y = max(largest_spread(p - vec2<i32>(0, 1)), largest_spread(p + vec2<i32>(0, 1)));
    let deviation = max(largest_spread(p), max(along_x, along_y));
    return value == 0.0 || deviation > params.least_noise * value;
}

fn distance_of_color(at_p: i32, at_q: i32, guess_p: vec3<f32>, guess_q: vec3<f32>) -> f32 {
    let difference = signal[at_p].xyz - signal[at_q].xyz;
    let sum = guess_p + guess_q;
    let expected = guess_p + min(guess_p, guess_q);
    return dot((difference * difference - expected) / max(sum, vec3<f32>(1e-30)), vec3<f32>(1.0 / 3.0));
}

#if FEATURE_GROUPS != 0
fn distance_of_features(at_p: i32, at_q: i32) -> f32 {
    let pixels = params.extent.x * params.extent.y;
    var farthest = 0.0;
    for (var group = 0; group < FEATURE_GROUPS; group++) {
        let plane = 3 * group * pixels;
        let difference = features[plane + at_p] - features[plane + at_q];
        let variance_p = features[plane + pixels + at_p];
        let variance_q = features[plane + pixels + at_q];
        let expected = variance_p + min(variance_p, variance_q);
        let scale = params.squared_feature_k * max(vec4<f32>(params.feature_tau), variance_p + variance_q);
        let distance = (difference * difference - expected) / scale;
        farthest = max(farthest, max(dot(distance.xyz, params.triple_weights[group].xyz), distance.w));
    }
    return farthest;
}
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let pixels = extent.x * extent.y;
    let at_p = pixel_index(p, extent);
    let guess_p = guess[at_p];
    let first = max(p - params.window_radius, vec2<i32>(0));
    let last = min(p + params.window_radius, extent - 1);
    var spread_sum = vec3<f32>(0.0);
#if FEATURE_GROUPS != 0
    var feature_sums: array<vec4<f32>, #{FEATURE_GROUPS}>;
#endif
    var weight_sum = 0.0;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let at_q = pixel_index(vec2<i32>(x, y), extent);
            let guess_q = guess[at_q];
            var distance = distance_of_color(at_p, at_q, guess_p.xyz, guess_q.xyz);
#if FEATURE_GROUPS != 0
            distance = max(distance, distance_of_features(at_p, at_q));
#endif
            let is_alike = distance <= params.largest_distance && guess_q.w <= params.gate * guess_p.w && guess_p.w <= params.gate * guess_q.w;
            // The pixel itself counts once, whatever its distance to itself comes to.
            let w = select(select(0.0, exp(-max(distance, 0.0)), is_alike), 1.0, at_p == at_q);
            spread_sum += w * abs(signal[pixels + at_q].xyz);
#if FEATURE_GROUPS != 0
            for (var group = 0; group < FEATURE_GROUPS; group++) {
                feature_sums[group] += w * abs(features[(3 * group + 2) * pixels + at_q]);
            }
#endif
            weight_sum += w;
        }
    }
    let spread = signal[pixels + at_p].xyz;
    let own_variance = spread * spread;
    let mean_spread = spread_sum / weight_sum;
    // Of Gaussian noise, E|D| = σ·√(2/π).
    let pooled = HALF_PI * mean_spread * mean_spread;
    // What the pixel's own halves say counts a little: a firefly claims a part of its own variance.
    let own = dot(own_variance / max(pooled, vec3<f32>(1e-30)), vec3<f32>(1.0 / 3.0));
    let with_own = pooled * (params.pooled_share + own) / (params.pooled_share + 1.0);
    pooled_variance[at_p] = vec4<f32>(select(own_variance, with_own, has_noise(p)), 0.0);
#if FEATURE_GROUPS != 0
    for (var group = 0; group < FEATURE_GROUPS; group++) {
        let mean = feature_sums[group] / weight_sum;
        let own_spread = features[(3 * group + 2) * pixels + at_p];
        let of_group = (params.pooled_share * HALF_PI * mean * mean + own_spread * own_spread) / (params.pooled_share + 1.0);
        pooled_variance[(1 + group) * pixels + at_p] = of_group;
    }
#endif
}
