// NL-means weights of every pair of neighbours in a chunk, box-filtered vertically: the vertical half of the patchwise
// mean of thesis 7.1.1, where the weight of p and q is the mean of w(p + n, q + n) over the patch. The box over
// distances comes first, then exp, then the box over weights.
//
// One invocation walks down PIXELS columns for one offset, with their last 2f+1 weights in registers, as nlm_distance
// does with distances; the horizontal half is summed in nlm_filter. Sums are unnormalised: x = w(p, q1), y = w(p, q2);
// pixels and neighbours outside the image add nothing. The scratch rows are padded by f on both sides.
#import stein::planes::{inside}
#import stein::nlm::{NlmParams, has_opposite, patch_members, weights_from_sums}

const PATCH_RADIUS: i32 = #{PATCH_RADIUS};
const SIDE: i32 = 2 * PATCH_RADIUS + 1;
const PIXELS: i32 = #{PIXELS};

@group(0) @binding(0) var<uniform> params: NlmParams;
// Column sums of distances, for the rows of the strip and f more rows above and below.
@group(0) @binding(1) var<storage, read> columns: array<vec3<f32>>;
@group(0) @binding(2) var<storage, read_write> weight_columns: array<vec3<f32>>;

// Read once: software adapters read a parameter anew wherever it is used.
var<private> nlm: NlmParams;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    nlm = params;
    let first_column = i32(id.x) * PIXELS;
    let first = i32(id.y) * nlm.block_rows;
    if first_column >= nlm.stride || first >= nlm.rows {
        return;
    }
    let plane = i32(id.z);
    let offset = nlm.first_offset + vec2<i32>(plane % nlm.offsets.x, plane / nlm.offsets.x);
    let end = min(first + nlm.block_rows, nlm.rows);
    let first_x = nlm.first_column + first_column - PATCH_RADIUS;
    var members_x: array<vec3<f32>, PIXELS>;
    for (var i = 0; i < PIXELS; i++) {
        members_x[i] = patch_members(first_x + i, offset.x, nlm.extent.x, PATCH_RADIUS);
    }
    var recent: array<array<vec2<f32>, SIDE>, PIXELS>;
    for (var row = first - PATCH_RADIUS; row < end + PATCH_RADIUS; row++) {
        let y = nlm.first_row + row;
        let members_y = patch_members(y, offset.y, nlm.extent.y, PATCH_RADIUS);
        let source = (plane * (nlm.rows + 2 * PATCH_RADIUS) + row + PATCH_RADIUS) * nlm.stride;
        var patch_columns: array<vec3<f32>, PIXELS + 2 * PATCH_RADIUS>;
        for (var n = 0; n < PIXELS + 2 * PATCH_RADIUS; n++) {
            patch_columns[n] = columns[source + clamp(first_column - PATCH_RADIUS + n, 0, nlm.stride - 1)];
        }
        let centre = row - PATCH_RADIUS;
        for (var i = 0; i < PIXELS; i++) {
            let p = vec2<i32>(first_x + i, y);
            var patch_sum = vec3<f32>(0.0);
            for (var n = 0; n < SIDE; n++) {
                patch_sum += patch_columns[i + n];
            }
            let p_inside = inside(p, nlm.extent);
            let ahead_inside = p_inside && inside(p + offset, nlm.extent);
            let behind_inside = p_inside && inside(p - offset, nlm.extent) && has_opposite(offset);
            for (var n = 0; n < SIDE - 1; n++) {
                recent[i][n] = recent[i][n + 1];
            }
            recent[i][SIDE - 1] = weights_from_sums(patch_sum, members_y * members_x[i], nlm.inverse_channels,
                ahead_inside, behind_inside);
            if centre >= first && first_column + i < nlm.stride {
                var sum = vec2<f32>(0.0);
                for (var n = 0; n < SIDE; n++) {
                    sum += recent[i][n];
                }
                weight_columns[(plane * nlm.rows + centre) * nlm.stride + first_column + i] = vec3<f32>(sum, 0.0);
            }
        }
    }
}
