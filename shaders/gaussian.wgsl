// One axis of a Gaussian average over the existing pixels: a separable filter is two of these, along the rows and along
// the columns. Weights of a window that is cut off at the border factorise as the window does, so each axis is
// normalised by itself.
//
// An invocation computes four pixels in a row along the axis: the weight of a tap for a pixel equals the weight of the
// tap before it for the pixel before, so that a tap costs one load and one exponential for all four.
#import stein::planes::{pixel_index}

struct GaussianParams {
    extent: vec2<i32>,
    // (1, 0) along the rows, (0, 1) along the columns.
    axis: vec2<i32>,
    radius: i32,
    // −1 / (2σ²), σ in pixels.
    exponent: f32,
}

@group(0) @binding(0) var<uniform> params: GaussianParams;
@group(0) @binding(1) var<storage, read> source: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> smoothed: array<vec4<f32>>;
#ifdef WITHOUT_CENTRE
// The image that was the `source` of the first axis.
@group(0) @binding(3) var<storage, read> centres: array<vec4<f32>>;
#endif

fn weight(offset: i32) -> f32 {
    return select(0.0, exp(params.exponent * f32(offset * offset)), abs(offset) <= params.radius);
}

// Factor by which a tap of this weight counts.
fn factor(w: f32) -> f32 {
#ifdef SQUARED
    return w * w;
#else
    return w;
#endif
}

fn store(at: i32, sum: vec4<f32>, weight_sum: f32) {
#ifdef SQUARED
    smoothed[at] = sum / (weight_sum * weight_sum);
#else ifdef KEEP_WEIGHT_SUM
    smoothed[at] = vec4<f32>(sum.xyz / weight_sum, weight_sum);
#else ifdef WITHOUT_CENTRE
    // The centre has weight 1 in the sum of both axes. A pixel that is alone keeps its own value.
    let others = source[at].w * weight_sum - 1.0;
    let centre = centres[at].xyz;
    let mean = (sum.xyz * source[at].w - centre) / select(1.0, others, others > 0.0);
    smoothed[at] = vec4<f32>(select(centre, mean, others > 0.0), 0.0);
#else
    smoothed[at] = sum / weight_sum;
#endif
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let axis = params.axis;
    let p = vec2<i32>(id.xy) * (1 + 3 * axis);
    if any(p >= extent) {
        return;
    }
    let size = dot(axis, extent);
    let step = dot(axis, vec2<i32>(1, extent.x));
    let first = dot(axis, p);
    // Index of the first pixel of this row or column, in the plane of this invocation.
    let origin = i32(id.z) * extent.x * extent.y + pixel_index(p, extent) - first * step;

    let from_tap = max(first - params.radius, 0);
    let to_tap = min(first + 3 + params.radius, size - 1);
    // The weights of the tap before the first one.
    var w = vec4<f32>(weight(from_tap - 1 - first), weight(from_tap - 2 - first), weight(from_tap - 3 - first),
        weight(from_tap - 4 - first));
    var weight_sums = vec4<f32>(0.0);
    var sum_a = vec4<f32>(0.0);
    var sum_b = vec4<f32>(0.0);
    var sum_c = vec4<f32>(0.0);
    var sum_d = vec4<f32>(0.0);
    for (var tap = from_tap; tap <= to_tap; tap++) {
        w = vec4<f32>(weight(tap - first), w.xyz);
        let value = source[origin + tap * step];
        weight_sums += w;
        sum_a += factor(w.x) * value;
        sum_b += factor(w.y) * value;
        sum_c += factor(w.z) * value;
        sum_d += factor(w.w) * value;
    }
    store(origin + first * step, sum_a, weight_sums.x);
    if first + 1 < size {
        store(origin + (first + 1) * step, sum_b, weight_sums.y);
    }
    if first + 2 < size {
        store(origin + (first + 2) * step, sum_c, weight_sums.z);
    }
    if first + 3 < size {
        store(origin + (first + 3) * step, sum_d, weight_sums.w);
    }
}
