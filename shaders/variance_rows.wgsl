// Horizontal half of the box sums of variance_scale: per channel Σ spread² and Σ sample variance over a row of 2·radius+1 pixels, existing ones only.
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

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    var spread_sum = vec4<f32>(0.0);
    var sample_sum = vec4<f32>(0.0);
    for (var x = max(p.x - params.radius, 0); x <= min(p.x + params.radius, params.extent.x - 1); x++) {
        let at = pixel_index(vec2<i32>(x, p.y), params.extent);
        let spread = signal[pixels + at];
        spread_sum += spread * spread;
        sample_sum += sample_variance[at];
    }
    let at_p = pixel_index(p, params.extent);
    spread_rows[at_p] = spread_sum;
    sample_rows[at_p] = sample_sum;
}
