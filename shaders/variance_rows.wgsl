// Horizontal half of the box sums of variance_scale: Σ spread² and Σ sample variance per channel, over the existing
// pixels in a row of 2·radius+1.
//
// BY_DEVIATION weights each pixel by one over the standard deviation that it claims, so that an outlier does not
// dominate the sum: a pixel that claims a million times the variance of the others in its box counts as a thousand of
// them. A pixel that claims no variance says nothing about the scale of claims. A pixel that claims a deviation of less
// than a tenth of its half spread has the weight of that tenth.
//
// An invocation computes PIXELS pixels in a row: their boxes share most of their pixels, and loads are the main cost.
#import stein::planes::{pixel_index}

struct VarianceScaleParams {
    extent: vec2<i32>,
    radius: i32,
}

@group(0) @binding(0) var<uniform> params: VarianceScaleParams;
// Two planes: the mean, then the half spread, whose square is the two-buffer variance of the mean.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> sample_variance: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> spread_rows: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> sample_rows: array<vec4<f32>>;

const PIXELS: i32 = #{PIXELS};

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let first = vec2<i32>(id.xy) * vec2<i32>(PIXELS, 1);
    if any(first >= extent) {
        return;
    }
    let pixels = extent.x * extent.y;
    let radius = params.radius;
    var spread_sums: array<vec4<f32>, PIXELS>;
    var sample_sums: array<vec4<f32>, PIXELS>;
    for (var x = max(first.x - radius, 0); x <= min(first.x + PIXELS - 1 + radius, extent.x - 1); x++) {
        let at = pixel_index(vec2<i32>(x, first.y), extent);
        let spread = signal[pixels + at];
        var two_buffer_variance = spread * spread;
        var variance = sample_variance[at];
#ifdef BY_DEVIATION
        let weight = select(vec4<f32>(0.0),
            inverseSqrt(max(max(variance, two_buffer_variance / 100.0), vec4<f32>(1e-30))), variance > vec4<f32>(0.0));
        two_buffer_variance *= weight;
        variance *= weight;
#endif
        for (var i = 0; i < PIXELS; i++) {
            let is_near = abs(x - first.x - i) <= radius;
            spread_sums[i] += select(vec4<f32>(0.0), two_buffer_variance, is_near);
            sample_sums[i] += select(vec4<f32>(0.0), variance, is_near);
        }
    }
    for (var i = 0; i < PIXELS; i++) {
        if first.x + i < extent.x {
            let at = pixel_index(first, extent) + i;
            spread_rows[at] = spread_sums[i];
            sample_rows[at] = sample_sums[i];
        }
    }
}
