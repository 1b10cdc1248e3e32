// Brings one feature into the form that noise_pool reads to compare pixels: value, variance, half spread.
//
// A group of features is one vec4 per pixel and quantity: a feature of up to three channels in x, y, z (the triple) and
// a feature of one channel in w (the single).
#import stein::planes::{pixel_index}

struct NoiseFeatureParams {
    extent: vec2<i32>,
    // Radius of the box over which the noise is averaged.
    radius: i32,
    group: i32,
    // 1: the feature goes to w and leaves the triple as it is; 0: it goes to x, y, z and clears w.
    single: i32,
}

@group(0) @binding(0) var<uniform> params: NoiseFeatureParams;
// Two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
// Sample variance, for a feature that has one and no halves.
#ifdef VARIANCE
@group(0) @binding(2) var<storage, read> sample_variance: array<vec4<f32>>;
#endif
// Three planes per group: value, variance, half spread.
@group(0) @binding(3) var<storage, read_write> features: array<vec4<f32>>;

const PIXELS: i32 = #{PIXELS};

// An invocation computes PIXELS pixels in a row: their boxes share most of their pixels, and loads are the main cost.
@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let first = vec2<i32>(id.xy) * vec2<i32>(PIXELS, 1);
    if any(first >= extent) {
        return;
    }
    let pixels = extent.x * extent.y;
    let radius = params.radius;
    let rows = vec2<i32>(max(first.y - radius, 0), min(first.y + radius, extent.y - 1));
    var sums: array<vec4<f32>, PIXELS>;
    for (var y = rows.x; y <= rows.y; y++) {
        for (var x = max(first.x - radius, 0); x <= min(first.x + PIXELS - 1 + radius, extent.x - 1); x++) {
            let at = pixel_index(vec2<i32>(x, y), extent);
#ifdef VARIANCE
            let noise = sample_variance[at];
#else
            let spread = signal[pixels + at];
            let noise = spread * spread;
#endif
            for (var i = 0; i < PIXELS; i++) {
                sums[i] += select(vec4<f32>(0.0), noise, abs(x - first.x - i) <= radius);
            }
        }
    }
    for (var i = 0; i < PIXELS; i++) {
        let p = first + vec2<i32>(i, 0);
        if p.x < extent.x {
            let columns = min(p.x + radius, extent.x - 1) - max(p.x - radius, 0) + 1;
            store(p, sums[i] / f32(columns * (rows.y - rows.x + 1)));
        }
    }
}

fn store(p: vec2<i32>, variance: vec4<f32>) {
    let pixels = params.extent.x * params.extent.y;
    let at_p = pixel_index(p, params.extent);
    let value = signal[at_p];
    let spread = signal[pixels + at_p];
    let at = params.group * 3 * pixels + at_p;
    if params.single == 1 {
        features[at].w = value.x;
        features[at + pixels].w = variance.x;
        features[at + 2 * pixels].w = spread.x;
    } else {
        features[at] = vec4<f32>(value.xyz, 0.0);
        features[at + pixels] = vec4<f32>(variance.xyz, 0.0);
        features[at + 2 * pixels] = vec4<f32>(spread.xyz, 0.0);
    }
}
