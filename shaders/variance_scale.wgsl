// Scales the sample variance to the magnitude of the two-buffer variance (thesis 8.2): sample variance has the finer structure, the halves have no bias
// whatever the sampler. The ratio is that of two box means over the same pixels, so the sums of variance_rows serve.
#import stein::planes::{pixel_index}

struct VarianceScaleParams {
    extent: vec2<i32>,
    radius: i32,
}

@group(0) @binding(0) var<uniform> params: VarianceScaleParams;
@group(0) @binding(1) var<storage, read> spread_rows: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> sample_rows: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> sample_variance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> scaled_variance: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    var spread_sum = vec4<f32>(0.0);
    var sample_sum = vec4<f32>(0.0);
    for (var y = max(p.y - params.radius, 0); y <= min(p.y + params.radius, params.extent.y - 1); y++) {
        let at = pixel_index(vec2<i32>(p.x, y), params.extent);
        spread_sum += spread_rows[at];
        sample_sum += sample_rows[at];
    }
    let at_p = pixel_index(p, params.extent);
    // Divided before it is multiplied: the pixel's share of the box is at most 1, where the ratio alone could overflow.
    let share = sample_variance[at_p] / select(vec4<f32>(1.0), sample_sum, sample_sum > vec4<f32>(0.0));
    scaled_variance[at_p] = select(vec4<f32>(0.0), share * spread_sum, sample_sum > vec4<f32>(0.0));
}
