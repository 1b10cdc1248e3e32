// Two-buffer variance of a signal, smoothed with a Gaussian over the existing pixels (thesis 8.3, output variance
// estimation; Algorithm 1's buffer_var).
#import stein::planes::{pixel_index}

struct VarianceSmoothParams {
    extent: vec2<i32>,
    radius: i32,
    // −1 / (2σ²), σ in pixels.
    exponent: f32,
}

@group(0) @binding(0) var<uniform> params: VarianceSmoothParams;
// Two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> smoothed_variance: array<vec4<f32>>;
#ifdef CLAMPED
// A filtered signal cannot be noisier than the signal that it was made from.
@group(0) @binding(3) var<storage, read> upper_bound: array<vec4<f32>>;
#endif

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
    var weight_sum = 0.0;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let offset = vec2<f32>(vec2<i32>(x, y) - p);
            let w = exp(params.exponent * dot(offset, offset));
            let spread = signal[pixels + pixel_index(vec2<i32>(x, y), extent)];
            sum += w * spread * spread;
            weight_sum += w;
        }
    }
    let at_p = pixel_index(p, extent);
#ifdef CLAMPED
    smoothed_variance[at_p] = min(sum / weight_sum, upper_bound[at_p]);
#else
    smoothed_variance[at_p] = sum / weight_sum;
#endif
}
