// The NL-means filter of one guide applied to a payload of one or more planes (eq. 7.1): all filters of NLM, and all
// filters of DFC except the candidates.
//
// Works on the chunk of offsets whose column sums of distances nlm_distance has written, or whose column sums of
// weights nlm_weight has written (PATCHWISE); `filtered` and `weights` carry the sums from chunk to chunk and hold the
// result after the last. Sums are taken of the differences to the centre pixel: F = u_p + Σ w·(u_q − u_p) / Σ w loses
// no digits to a large common offset.
//
// An invocation filters PIXELS pixels in a row and goes through the offsets row by row, as candidate_accumulate does:
// values that two pixels or two offsets share are loaded once.
#import stein::nlm::{NlmParams, has_opposite, patch_members, weights_from_sums, centre_weight}

const PATCH_RADIUS: i32 = #{PATCH_RADIUS};
const PAYLOAD_PLANES: i32 = #{PAYLOAD_PLANES};
const PIXELS: i32 = #{PIXELS};

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<storage, read> columns: array<vec3<f32>>;
@group(0) @binding(2) var<storage, read> payload: array<vec4<f32>>;
// Image that holds the neighbours q: the payload again, or a frame beside.
@group(0) @binding(3) var<storage, read> neighbours: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> filtered: array<vec4<f32>>;
// x: Σ w, the centre included after the last chunk; y: largest weight of a neighbour.
@group(0) @binding(5) var<storage, read_write> weights: array<vec4<f32>>;
#ifdef RESIDUAL
// Without halves, the variance left in the filtered value is the variance of a weighted mean of independent pixels: Σ
// w²·Var / (Σ w)².
@group(0) @binding(6) var<storage, read> variance_of_mean: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> neighbours_variance: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read_write> residual_variance: array<vec4<f32>>;
#endif

// Read once: software adapters read a parameter anew wherever it is used.
var<private> nlm: NlmParams;

// Components of each plane that are averaged: all four, or one number that is in x alone (ONE_LANE), or in x, y and z
// (GREY).
#ifdef ONE_LANE
alias Value = f32;
fn value_of(stored: vec4<f32>) -> Value {
    return stored.x;
}
fn stored(value: Value) -> vec4<f32> {
#ifdef GREY
    return vec4<f32>(vec3<f32>(value), 0.0);
#else
    return vec4<f32>(value, 0.0, 0.0, 0.0);
#endif
}
#else
alias Value = vec4<f32>;
fn value_of(stored: vec4<f32>) -> Value {
    return stored;
}
fn stored(value: Value) -> vec4<f32> {
    return value;
}
#endif

// Values at a pixel.
struct Pixel {
    planes: array<Value, PAYLOAD_PLANES>,
#ifdef RESIDUAL
    variance: Value,
#endif
}

// Running sums of one pixel.
struct Sums {
    planes: array<Value, PAYLOAD_PLANES>,
    weight: f32,
    largest: f32,
#ifdef RESIDUAL
    squared: Value,
#endif
}

// Loads the pixel in this row nearest to column x.
fn neighbour_at(x: i32, row: i32) -> Pixel {
    let at = row * nlm.extent.x + clamp(x, 0, nlm.extent.x - 1);
    var pixel: Pixel;
    for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
        pixel.planes[plane] = value_of(neighbours[plane * nlm.extent.x * nlm.extent.y + at]);
    }
#ifdef RESIDUAL
    pixel.variance = value_of(neighbours_variance[at]);
#endif
    return pixel;
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    nlm = params;
    let extent = nlm.extent;
    let row = i32(id.y);
    let y = nlm.first_row + row;
    let first_column = i32(id.x) * PIXELS;
    let first_x = nlm.first_column + first_column;
    if first_column >= nlm.width || row >= nlm.rows {
        return;
    }
    let pixels = extent.x * extent.y;
    var centres: array<array<Value, PAYLOAD_PLANES>, PIXELS>;
    var sums: array<Sums, PIXELS>;
    for (var i = 0; i < PIXELS; i++) {
        let at_p = y * extent.x + min(first_x + i, extent.x - 1);
        for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
            centres[i][plane] = value_of(payload[plane * pixels + at_p]);
        }
        if nlm.starts == 0 {
            for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
                sums[i].planes[plane] = value_of(filtered[plane * pixels + at_p]);
            }
            sums[i].weight = weights[at_p].x;
            sums[i].largest = weights[at_p].y;
#ifdef RESIDUAL
            sums[i].squared = value_of(residual_variance[at_p]);
#endif
        }
    }

    for (var j = 0; j < nlm.offsets.y; j++) {
        let dy = nlm.first_offset.y + j;
        let ahead_row_inside = y + dy < extent.y;
        let behind_row_inside = y - dy >= 0;
        let ahead_row = min(y + dy, extent.y - 1);
        let behind_row = max(y - dy, 0);
        let members_y = patch_members(y, dy, extent.y, PATCH_RADIUS);

        // The neighbours that the first offset shares with the offset before it.
        var aheads: array<Pixel, PIXELS>;
        var behinds: array<Pixel, PIXELS>;
        for (var i = 0; i < PIXELS - 1; i++) {
            aheads[i + 1] = neighbour_at(first_x + i + nlm.first_offset.x, ahead_row);
            behinds[i] = neighbour_at(first_x + i + 1 - nlm.first_offset.x, behind_row);
        }
        for (var o = 0; o < nlm.offsets.x; o++) {
            let dx = nlm.first_offset.x + o;
            for (var i = 0; i < PIXELS - 1; i++) {
                aheads[i] = aheads[i + 1];
                behinds[PIXELS - 1 - i] = behinds[PIXELS - 2 - i];
            }
            aheads[PIXELS - 1] = neighbour_at(first_x + PIXELS - 1 + dx, ahead_row);
            behinds[0] = neighbour_at(first_x - dx, behind_row);

            let column = ((j * nlm.offsets.x + o) * nlm.rows + row) * nlm.stride + first_column;
            var patch_columns: array<vec3<f32>, PIXELS + 2 * PATCH_RADIUS>;
            for (var n = 0; n < PIXELS + 2 * PATCH_RADIUS; n++) {
                patch_columns[n] = columns[column + n];
            }
            for (var i = 0; i < PIXELS; i++) {
                let x = first_x + i;
                let q1_inside = ahead_row_inside && x + dx >= 0 && x + dx < extent.x;
                let q2_inside = behind_row_inside && x - dx >= 0 && x - dx < extent.x
                    && has_opposite(vec2<i32>(dx, dy));
                var patch_sum = vec3<f32>(0.0);
                for (var n = 0; n <= 2 * PATCH_RADIUS; n++) {
                    patch_sum += patch_columns[i + n];
                }
                let members = members_y * patch_members(x, dx, extent.x, PATCH_RADIUS);
#ifdef PATCHWISE
                // Thesis 7.1.1: W(p, q), the mean of w(p + n, q + n) over the patch.
                let pair_weight = select(vec2<f32>(0.0), patch_sum.xy / max(members.xy, vec2<f32>(1.0)),
                    vec2<bool>(q1_inside, q2_inside));
#else
                let pair_weight = weights_from_sums(patch_sum, members, nlm.inverse_channels, q1_inside, q2_inside);
#endif
                let w1 = select(0.0, pair_weight.x, pair_weight.x >= nlm.cut);
                let w2 = select(0.0, pair_weight.y, pair_weight.y >= nlm.cut);
                for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
                    let centre = centres[i][plane];
                    sums[i].planes[plane] += w1 * (aheads[i].planes[plane] - centre) + w2
                        * (behinds[i].planes[plane] - centre);
                }
                sums[i].weight += w1 + w2;
                sums[i].largest = max(sums[i].largest, max(w1, w2));
#ifdef RESIDUAL
                sums[i].squared += w1 * w1 * aheads[i].variance + w2 * w2 * behinds[i].variance;
#endif
            }
        }
    }

    for (var i = 0; i < PIXELS; i++) {
        if first_column + i >= nlm.width {
            continue;
        }
        let at_p = y * extent.x + first_x + i;
        if nlm.completes == 0 {
            for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
                filtered[plane * pixels + at_p] = stored(sums[i].planes[plane]);
            }
            weights[at_p] = vec4<f32>(sums[i].weight, sums[i].largest, 0.0, 0.0);
#ifdef RESIDUAL
            residual_variance[at_p] = stored(sums[i].squared);
#endif
            continue;
        }
        let w_centre = centre_weight(vec4<f32>(sums[i].largest), nlm.centre_floor).x;
        let total = sums[i].weight + w_centre;
        for (var plane = 0; plane < PAYLOAD_PLANES; plane++) {
            filtered[plane * pixels + at_p] = stored(centres[i][plane] + sums[i].planes[plane] / total);
        }
        weights[at_p] = vec4<f32>(total, sums[i].largest, 0.0, 0.0);
#ifdef RESIDUAL
        residual_variance[at_p] = stored((sums[i].squared + w_centre * w_centre
            * value_of(variance_of_mean[at_p])) / (total * total));
#endif
    }
}
