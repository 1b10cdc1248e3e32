// NL-means pixel distances of every pair of neighbours in a chunk, box-filtered vertically (the vertical half of eq. 7.3's patch sum).
//
// One invocation walks down one column for one pair, with the last 2f+1 distances in registers; the horizontal half is summed where the weights are formed.
// Sums run over channels and rows, unnormalised: x = d(p, q1), y = d(p, q2), z = d(p, mean of q1 and q2); rows and neighbours outside the image add nothing.
// The scratch rows are padded by f on both sides, so that the horizontal sum needs no border test.
#import stein::planes::{inside, clamped_index}
#import stein::nlm::{NlmParams, pair_offset, has_opposite, distance, symmetric_distance}

const PATCH_RADIUS: i32 = #{PATCH_RADIUS};
const SIDE: i32 = 2 * PATCH_RADIUS + 1;

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<storage, read> guide: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> variance_of_mean: array<vec4<f32>>;
// What q is taken from: the same again, or a frame beside.
@group(0) @binding(3) var<storage, read> neighbours: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> neighbours_variance: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> columns: array<vec4<f32>>;
#if SMALL_PATCH_RADIUS != -1
// The same for a second, smaller patch: the candidates FIRST and SECOND share their pixel distances and differ in the box alone.
const SMALL_PATCH_RADIUS: i32 = #{SMALL_PATCH_RADIUS};
@group(0) @binding(6) var<storage, read_write> columns_small: array<vec4<f32>>;
#endif

fn pair_distances(p: vec2<i32>, offset: vec2<i32>) -> vec3<f32> {
    let q1 = p + offset;
    let q2 = p - offset;
    let p_inside = inside(p, params.extent);
    let q1_inside = p_inside && inside(q1, params.extent);
    let q2_inside = p_inside && inside(q2, params.extent) && has_opposite(offset);
    let at_p = clamped_index(p, params.extent);
    let at_q1 = clamped_index(q1, params.extent);
    let at_q2 = clamped_index(q2, params.extent);
    let u_p = guide[at_p].xyz;
    let u_q1 = neighbours[at_q1].xyz;
    let u_q2 = neighbours[at_q2].xyz;
    let var_p = variance_of_mean[at_p].xyz;
    let var_q1 = neighbours_variance[at_q1].xyz;
    let var_q2 = neighbours_variance[at_q2].xyz;
    let one = vec3<f32>(1.0);
    let d1 = select(0.0, dot(one, distance(u_p, u_q1, var_p, var_q1, params.k_squared, params.alpha)), q1_inside);
    let d2 = select(0.0, dot(one, distance(u_p, u_q2, var_p, var_q2, params.k_squared, params.alpha)), q2_inside);
#ifdef SYMMETRIC
    let both = symmetric_distance(u_p, u_q1, u_q2, var_p, var_q1, var_q2, params.k_squared, params.alpha);
    return vec3<f32>(d1, d2, select(0.0, dot(one, both), q1_inside && q2_inside));
#else
    return vec3<f32>(d1, d2, 0.0);
#endif
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
    var recent: array<vec3<f32>, SIDE>;
    for (var row = first - PATCH_RADIUS; row < end + PATCH_RADIUS; row++) {
        for (var n = 0; n < SIDE - 1; n++) {
            recent[n] = recent[n + 1];
        }
        recent[SIDE - 1] = pair_distances(vec2<i32>(column - PATCH_RADIUS, params.first_row + row), offset);
        let centre = row - PATCH_RADIUS;
        if centre >= first {
            // Summed anew for each row: a running sum would carry one outlier's rounding error to the end of the column.
            let at = (pair * params.rows + centre) * stride + column;
            var sum = vec3<f32>(0.0);
            for (var n = 0; n < SIDE; n++) {
                sum += recent[n];
            }
            columns[at] = vec4<f32>(sum, 0.0);
#if SMALL_PATCH_RADIUS != -1
            var sum_small = vec3<f32>(0.0);
            for (var n = PATCH_RADIUS - SMALL_PATCH_RADIUS; n <= PATCH_RADIUS + SMALL_PATCH_RADIUS; n++) {
                sum_small += recent[n];
            }
            columns_small[at] = vec4<f32>(sum_small, 0.0);
#endif
        }
    }
}
