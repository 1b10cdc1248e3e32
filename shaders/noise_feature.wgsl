// Brings one feature into the form in which pixels are compared to pool their noise: value, variance, half spread.
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
// Where there is one and no halves.
#ifdef VARIANCE
@group(0) @binding(2) var<storage, read> sample_variance: array<vec4<f32>>;
#endif
// Three planes per group: value, variance, half spread.
@group(0) @binding(3) var<storage, read_write> features: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let pixels = extent.x * extent.y;
    let first = max(p - params.radius, vec2<i32>(0));
    let last = min(p + params.radius, extent - 1);
    var sum = vec4<f32>(0.0);
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let at_q = pixel_index(vec2<i32>(x, y), extent);
#ifdef VARIANCE
            sum += sample_variance[at_q];
#else
            let spread = signal[pixels + at_q];
            sum += spread * spread;
#endif
        }
    }
    let size = last - first + 1;
    let variance = sum / f32(size.x * size.y);
    let at_p = pixel_index(p, extent);
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
