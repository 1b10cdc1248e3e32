// Pools the noise of pixels that are alike. The half spreads of many pixels give each of them a variance, or their
// sample variances give each of them a steadier variance.
//
// Single pixels are compared, not patches: dark pixels have to be pooled with dark ones. Deviations are averaged
// instead of their squares, because one firefly would decide the sum of the squares.
//
// An invocation computes PIXELS pixels in a row: their windows share most of their pixels, and loads are the main cost.
#import stein::noise::{NoiseParams}
#import stein::planes::{clamped_index, largest_channel, pixel_index}

const FEATURE_GROUPS: i32 = #{FEATURE_GROUPS};
const PIXELS: i32 = #{PIXELS};

@group(0) @binding(0) var<uniform> params: NoiseParams;
// Two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
// Output of noise_guess.
@group(0) @binding(2) var<storage, read> guess: array<vec4<f32>>;
#if FEATURE_GROUPS != 0
// Output of noise_feature.
@group(0) @binding(3) var<storage, read> features: array<vec4<f32>>;
#endif
#ifdef VARIANCE
@group(0) @binding(4) var<storage, read> sample_variance: array<vec4<f32>>;
#endif
// One plane for the colour; then one plane per group, if the noise of features is pooled as well.
@group(0) @binding(5) var<storage, read_write> pooled_variance: array<vec4<f32>>;

const HALF_PI: f32 = 1.57079633;

// Read once: software adapters read a parameter anew wherever it is used.
var<private> rule: NoiseParams;

// Values by which pixels are compared.
struct Pixel {
    color: vec3<f32>,
    variance: vec3<f32>,
    magnitude: f32,
#if FEATURE_GROUPS != 0
    features: array<vec4<f32>, FEATURE_GROUPS>,
    feature_variances: array<vec4<f32>, FEATURE_GROUPS>,
#endif
}

struct Sums {
    weight: f32,
    deviation: vec3<f32>,
#ifdef FEATURE_NOISE
    features: array<vec4<f32>, FEATURE_GROUPS>,
#endif
}

fn pixel_at(at: i32) -> Pixel {
    let noise = guess[at];
    var pixel: Pixel;
    pixel.color = signal[at].xyz;
    pixel.variance = noise.xyz;
    pixel.magnitude = noise.w;
#if FEATURE_GROUPS != 0
    let pixels = rule.extent.x * rule.extent.y;
    for (var group = 0; group < FEATURE_GROUPS; group++) {
        let plane = 3 * group * pixels;
        pixel.features[group] = features[plane + at];
        pixel.feature_variances[group] = features[plane + pixels + at];
    }
#endif
    return pixel;
}

// Standard deviation of the noise that a pixel claims.
fn claimed_deviation(at: i32) -> vec3<f32> {
#ifdef VARIANCE
    return sqrt(sample_variance[at].xyz);
#else
    return abs(signal[rule.extent.x * rule.extent.y + at].xyz);
#endif
}

#ifdef FEATURE_NOISE
fn feature_spread(group: i32, at: i32) -> vec4<f32> {
    return abs(features[(3 * group + 2) * rule.extent.x * rule.extent.y + at]);
}
#endif

fn largest_spread(p: vec2<i32>) -> f32 {
    return largest_channel(abs(signal[rule.extent.x * rule.extent.y + clamped_index(p, rule.extent)].xyz));
}

// Whether a pixel has noise. A pixel with almost no noise keeps its own variance, however noisy similar pixels are.
// Halves alone may agree by accident, so the halves of the pixels beside count too; and all samples of a black pixel
// may have missed the light.
fn has_noise(p: vec2<i32>) -> bool {
    let at = pixel_index(p, rule.extent);
    let value = largest_channel(abs(signal[at].xyz));
#ifdef VARIANCE
    return max(largest_spread(p), largest_channel(claimed_deviation(at))) > rule.least_noise * value;
#else
    let along_x = max(largest_spread(p - vec2<i32>(1, 0)), largest_spread(p + vec2<i32>(1, 0)));
    let along_y = max(largest_spread(p - vec2<i32>(0, 1)), largest_spread(p + vec2<i32>(0, 1)));
    let deviation = max(largest_spread(p), max(along_x, along_y));
    return value == 0.0 || deviation > rule.least_noise * value;
#endif
}

fn distance_of_color(p: Pixel, q: Pixel) -> f32 {
    let difference = p.color - q.color;
    let expected = p.variance + min(p.variance, q.variance);
    return dot((difference * difference - expected) / max(p.variance + q.variance, vec3<f32>(1e-30)),
        vec3<f32>(1.0 / 3.0));
}

#if FEATURE_GROUPS != 0
fn distance_of_features(p: Pixel, q: Pixel) -> f32 {
    var farthest = 0.0;
    for (var group = 0; group < FEATURE_GROUPS; group++) {
        let difference = p.features[group] - q.features[group];
        let variance_p = p.feature_variances[group];
        let variance_q = q.feature_variances[group];
        let expected = variance_p + min(variance_p, variance_q);
        let scale = rule.squared_feature_k * max(vec4<f32>(rule.feature_tau), variance_p + variance_q);
        let distance = (difference * difference - expected) / scale;
        farthest = max(farthest, max(dot(distance.xyz, rule.triple_weights[group].xyz), distance.w));
    }
    return farthest;
}
#endif

fn weight(p: Pixel, q: Pixel) -> f32 {
    var distance = distance_of_color(p, q);
#if FEATURE_GROUPS != 0
    distance = max(distance, distance_of_features(p, q));
#endif
    let similarly_bright = q.magnitude <= rule.gate * p.magnitude && p.magnitude <= rule.gate * q.magnitude;
    return select(0.0, exp(-max(distance, 0.0)), similarly_bright && distance <= rule.largest_distance);
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    rule = params;
    let extent = rule.extent;
    let first = vec2<i32>(id.xy) * vec2<i32>(PIXELS, 1);
    if any(first >= extent) {
        return;
    }
    let radius = rule.window_radius;
    let at_first = pixel_index(first, extent);
    var own: array<Pixel, PIXELS>;
    for (var i = 0; i < PIXELS; i++) {
        own[i] = pixel_at(clamped_index(first + vec2<i32>(i, 0), extent));
    }
    var sums: array<Sums, PIXELS>;
    for (var y = max(first.y - radius, 0); y <= min(first.y + radius, extent.y - 1); y++) {
        for (var x = max(first.x - radius, 0); x <= min(first.x + PIXELS - 1 + radius, extent.x - 1); x++) {
            let at_q = pixel_index(vec2<i32>(x, y), extent);
            let q = pixel_at(at_q);
            let deviation = claimed_deviation(at_q);
            for (var i = 0; i < PIXELS; i++) {
                // The pixel itself counts once, whatever its distance to itself is.
                let any_weight = select(weight(own[i], q), 1.0, at_q == at_first + i);
                let w = select(0.0, any_weight, abs(x - first.x - i) <= radius);
                sums[i].weight += w;
                sums[i].deviation += w * deviation;
#ifdef FEATURE_NOISE
                for (var group = 0; group < FEATURE_GROUPS; group++) {
                    sums[i].features[group] += w * feature_spread(group, at_q);
                }
#endif
            }
        }
    }
    for (var i = 0; i < PIXELS; i++) {
        if first.x + i < extent.x {
            store(first + vec2<i32>(i, 0), sums[i]);
        }
    }
}

fn store(p: vec2<i32>, sums: Sums) {
    let at = pixel_index(p, rule.extent);
    let own_deviation = claimed_deviation(at);
    let own_variance = own_deviation * own_deviation;
    let mean_deviation = sums.deviation / sums.weight;
#ifdef VARIANCE
    let with_own = 0.5 * (mean_deviation * mean_deviation + own_variance);
#else
    // For Gaussian noise, E|D| = σ·√(2/π).
    let pooled = HALF_PI * mean_deviation * mean_deviation;
    // The pixel's own halves count a little: a firefly claims a part of its own variance.
    let own = dot(own_variance / max(pooled, vec3<f32>(1e-30)), vec3<f32>(1.0 / 3.0));
    let with_own = pooled * (rule.pooled_share + own) / (rule.pooled_share + 1.0);
#endif
    pooled_variance[at] = vec4<f32>(select(own_variance, with_own, has_noise(p)), 0.0);
#ifdef FEATURE_NOISE
    for (var group = 0; group < FEATURE_GROUPS; group++) {
        let mean = sums.features[group] / sums.weight;
        let own_spread = feature_spread(group, at);
        let of_group = (rule.pooled_share * HALF_PI * mean * mean + own_spread * own_spread) / (rule.pooled_share
            + 1.0);
        pooled_variance[(1 + group) * rule.extent.x * rule.extent.y + at] = of_group;
    }
#endif
}
