// The NL-means filter of one guide applied to a payload of one or more planes (eq. 7.1): all of NLM's filters, and those of DFC but for the candidates.
//
// Works on the chunk of pairs whose column sums nlm_distance has left, or of which nlm_weight has made column sums of weights (PATCHWISE); `filtered` and `weights` carry
// the sums from chunk to chunk and hold the result after the last.
// Sums are taken of the differences to the centre pixel: F = u_p + Σ w·(u_q − u_p) / Σ w loses no digits to a large common offset.
#import stein::planes::{inside, pixel_index, clamped_index}
#import stein::nlm::{NlmParams, pair_offset, next_offset, has_opposite, patch_pairs, weights_from_sums, centre_weight}

const PATCH_RADIUS: i32 = #{PATCH_RADIUS};
const PAYLOAD_PLANES: i32 = #{PAYLOAD_PLANES};

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<storage, read> columns: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> payload: array<vec4<f32>>;
// What q is taken from: the same again, or a frame beside.
@group(0) @binding(3) var<storage, read> neighbours: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> filtered: array<vec4<f32>>;
// x: Σ w, the centre included after the last chunk; y: largest weight of a neighbour.
@group(0) @binding(5) var<storage, read_write> weights: array<vec4<f32>>;
#ifdef RESIDUAL
// Without halves, the variance left in the filtered value is that of a weighted mean of independent pixels: Σ w²·Var / (Σ w)².
@group(0) @binding(6) var<storage, read> variance_of_mean: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> neighbours_variance: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> residual_variance: array<vec4<f32>>;
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(i32(id.x), params.first_row + i32(id.y));
    if p.x >= extent.x || i32(id.y) >= params.rows {
        return;
    }
    let pixels = extent.x * extent.y;
    let at_p = pixel_index(p, extent);
    var centre: array<vec4<f32>, PAYLOAD_PLANES>;
    var sum: array<vec4<f32>, PAYLOAD_PLANES>;
    for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
        centre[plane] = payload[plane * pixels + at_p];
    }
    var weight_sum = 0.0;
    var largest = 0.0;
#ifdef RESIDUAL
    var squared_sum = vec4<f32>(0.0);
#endif
    if params.starts == 0 {
        for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
            sum[plane] = filtered[plane * pixels + at_p];
        }
        weight_sum = weights[at_p].x;
        largest = weights[at_p].y;
#ifdef RESIDUAL
        squared_sum = residual_variance[at_p];
#endif
    }

    let stride = extent.x + 2 * PATCH_RADIUS;
    var offset = pair_offset(params.first_pair, params.window_radius);
    for (var pair = 0; pair < params.pairs; pair++) {
        let q1 = p + offset;
        let q2 = p - offset;
        let q1_inside = inside(q1, extent);
        let q2_inside = inside(q2, extent) && has_opposite(offset);
        let column = (pair * params.rows + i32(id.y)) * stride + i32(id.x);
        var patch_sum = vec3<f32>(0.0);
        for (var n = 0; n <= 2 * PATCH_RADIUS; n++) {
            patch_sum += columns[column + n].xyz;
        }
#ifdef PATCHWISE
        // Thesis 7.1.1: W(p, q), the mean of w(p + n, q + n) over the patch.
        let members = vec2<f32>(patch_pairs(p, offset, extent, PATCH_RADIUS), patch_pairs(p, -offset, extent, PATCH_RADIUS));
        let pair_weight = select(vec2<f32>(0.0), patch_sum.xy / members, vec2<bool>(q1_inside, q2_inside));
#else
        let pair_weight = weights_from_sums(patch_sum, p, offset, extent, PATCH_RADIUS, params.inverse_channels, q1_inside, q2_inside);
#endif
        let w1 = select(0.0, pair_weight.x, pair_weight.x >= params.cut);
        let w2 = select(0.0, pair_weight.y, pair_weight.y >= params.cut);
        let at_q1 = clamped_index(q1, extent);
        let at_q2 = clamped_index(q2, extent);
        for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
            sum[plane] += w1 * (neighbours[plane * pixels + at_q1] - centre[plane]) + w2 * (neighbours[plane * pixels + at_q2] - centre[plane]);
        }
        weight_sum += w1 + w2;
        largest = max(largest, max(w1, w2));
#ifdef RESIDUAL
        squared_sum += w1 * w1 * neighbours_variance[at_q1] + w2 * w2 * neighbours_variance[at_q2];
#endif
        offset = next_offset(offset, params.window_radius);
    }

    if params.completes == 0 {
        for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
            filtered[plane * pixels + at_p] = sum[plane];
        }
        weights[at_p] = vec4<f32>(weight_sum, largest, 0.0, 0.0);
#ifdef RESIDUAL
        residual_variance[at_p] = squared_sum;
#endif
        return;
    }
    let w_centre = centre_weight(vec4<f32>(largest), params.centre_floor).x;
    let total = weight_sum + w_centre;
    for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
        filtered[plane * pixels + at_p] = centre[plane] + sum[plane] / total;
    }
    weights[at_p] = vec4<f32>(total, largest, 0.0, 0.0);
#ifdef RESIDUAL
    residual_variance[at_p] = (squared_sum + w_centre * w_centre * variance_of_mean[at_p]) / (total * total);
#endif
}
