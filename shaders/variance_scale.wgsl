// Scales the sample variance to the magnitude of the two-buffer variance (thesis 8.2): the sample variance has the
// finer structure, the halves have no bias for any sampler. Both box means cover the same pixels with the same weights,
// so their ratio is the ratio of the sums of variance_rows.
//
// An invocation computes PIXELS pixels, one below the other, as variance_rows computes them in a row.
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

const PIXELS: i32 = #{PIXELS};

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let first = vec2<i32>(id.xy) * vec2<i32>(1, PIXELS);
    if any(first >= extent) {
        return;
    }
    let radius = params.radius;
    var spread_sums: array<vec4<f32>, PIXELS>;
    var sample_sums: array<vec4<f32>, PIXELS>;
    for (var y = max(first.y - radius, 0); y <= min(first.y + PIXELS - 1 + radius, extent.y - 1); y++) {
        let at = pixel_index(vec2<i32>(first.x, y), extent);
        let spread_row = spread_rows[at];
        let sample_row = sample_rows[at];
        for (var i = 0; i < PIXELS; i++) {
            let is_near = abs(y - first.y - i) <= radius;
            spread_sums[i] += select(vec4<f32>(0.0), spread_row, is_near);
            sample_sums[i] += select(vec4<f32>(0.0), sample_row, is_near);
        }
    }
    for (var i = 0; i < PIXELS; i++) {
        if first.y + i < extent.y {
            let at = pixel_index(first + vec2<i32>(0, i), extent);
            let has_variance = sample_sums[i] > vec4<f32>(0.0);
            // The division comes first: the ratio of the boxes alone could overflow.
            let share = sample_variance[at] / select(vec4<f32>(1.0), sample_sums[i], has_variance);
            scaled_variance[at] = select(vec4<f32>(0.0), share * spread_sums[i], has_variance);
        }
    }
}
