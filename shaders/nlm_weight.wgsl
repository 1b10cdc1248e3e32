// NL-means weights of every pair of neighbours in a chunk, box-filtered vertically: the vertical half of the patchwise mean of thesis 7.1.1, where the weight of p and q is the
// mean of w(p + n, q + n) over the patch. The box over distances comes first, then exp, then the box over weights.
//
// One invocation walks down one column for one pair, with the last 2f+1 weights in registers, as nlm_distance does with distances; the horizontal half is summed in
// nlm_filter. Sums are unnormalised: x = w(p, q1), y = w(p, q2); pixels and neighbours outside the image add nothing. The scratch rows are padded by f on both sides.
#import stein::planes::{inside}
#import stein::nlm::{NlmParams, pair_offset, has_opposite, weights_from_sums}

const PATCH_RADIUS: i32 = #{PATCH_RADIUS};
const SIDE: i32 = 2 * PATCH_RADIUS + 1;

@group(0) @binding(0) var<uniform> params: NlmParams;
// Of the rows of the strip and f more above and below.
@group(0) @binding(1) var<storage, read> columns: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> weight_columns: array<vec4<f32>>;

// Of the pixel p in this row of the strip.
fn weights_at(p: vec2<i32>, row: i32, pair: i32, offset: vec2<i32>) -> vec2<f32> {
    if !inside(p, params.extent) {
        return vec2<f32>(0.0);
    }
    let stride = params.extent.x + 2 * PATCH_RADIUS;
    let column = (pair * (params.rows + 2 * PATCH_RADIUS) + row + PATCH_RADIUS) * stride + p.x;
    var patch_sum = vec3<f32>(0.0);
    for (var n = 0; n < SIDE; n++) {
        patch_sum += columns[column + n].xyz;
    }
    let ahead_inside = inside(p + offset, params.extent);
    let behind_inside = inside(p - offset, params.extent) && has_opposite(offset);
    return weights_from_sums(patch_sum, p, offset, params.extent, PATCH_RADIUS, params.inverse_channels, ahead_inside, behind_inside);
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let stride = params.extent.x + 2 * PATCH_RADIUS;
    let column = i32(id.x);
    if column >= stride {
        return;
    }
    let pair = i32(id.z);
    let offset = pair_offset(params.first_pair + pair, params.window_radius);
    let first = i32(id.y) * params.block_rows;
    let end = min(first + params.block_rows, params.rows);
    var recent: array<vec2<f32>, SIDE>;
    for (var row = first - PATCH_RADIUS; row < end + PATCH_RADIUS; row++) {
        for (var n = 0; n < SIDE - 1; n++) {
            recent[n] = recent[n + 1];
        }
        recent[SIDE - 1] = weights_at(vec2<i32>(column - PATCH_RADIUS, params.first_row + row), row, pair, offset);
        let centre = row - PATCH_RADIUS;
        if centre >= first {
            var sum = vec2<f32>(0.0);
            for (var n = 0; n < SIDE; n++) {
                sum += recent[n];
            }
            weight_columns[(pair * params.rows + centre) * stride + column] = vec4<f32>(sum, 0.0, 0.0);
        }
    }
}
