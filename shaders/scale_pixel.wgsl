// The finest scale, the pixel filter (thesis 6.4), and the selection that starts with it: every pixel may still move on
// to coarser scales.
#import stein::planes::{pixel_index}

struct ScalePixelParams {
    extent: vec2<i32>,
    // Samples per pixel, used where there is no map of them; 0 if unknown.
    samples_per_pixel: f32,
}

@group(0) @binding(0) var<uniform> params: ScalePixelParams;
// Two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> input: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> variance_of_mean: array<vec4<f32>>;
#ifdef SAMPLES_VARY
@group(0) @binding(3) var<storage, read> samples: array<vec4<f32>>;
#endif
// Two planes, in the w of the first the mean number of samples per pixel.
@group(0) @binding(4) var<storage, read_write> signal: array<vec4<f32>>;
// The w holds the factor by which filtering lowers the variance: 1 / number of pixels that take part.
@group(0) @binding(5) var<storage, read_write> variance: array<vec4<f32>>;
// Two planes, in the w of the first the number of pixels that take part.
@group(0) @binding(6) var<storage, read_write> selected: array<vec4<f32>>;
// x: σ in pixels, y: 1 while coarser scales may follow, z: estimated MSE, summed over the channels, w: samples that
// take part.
@group(0) @binding(7) var<storage, read_write> choice: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
#ifdef SAMPLES_VARY
    let count = samples[at].x;
#else
    let count = params.samples_per_pixel;
#endif
    let mean = input[at].xyz;
    let spread = vec4<f32>(input[pixels + at].xyz, 0.0);
    let noise = variance_of_mean[at].xyz;
    signal[at] = vec4<f32>(mean, count);
    signal[pixels + at] = spread;
    variance[at] = vec4<f32>(noise, 1.0);
    selected[at] = vec4<f32>(mean, 1.0);
    selected[pixels + at] = spread;
    // The pixel filter is unbiased: its error is its variance.
    choice[at] = vec4<f32>(0.0, 1.0, dot(vec3<f32>(1.0), noise), count);
}
