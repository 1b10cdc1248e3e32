// NL-means pixel distances of every pair of neighbours in a chunk, box-filtered vertically (the vertical half of eq.
// 7.3's patch sum).
//
// One invocation walks down one column for OFFSET_ROWS offsets, one below the other, and keeps their last 2f+1
// distances in registers. The neighbour at an offset was, one row before, the neighbour at the next offset; for the
// opposite neighbour it is the other way round. So a row costs the same loads for several offsets as for one. The
// horizontal half is summed where the weights are formed. Sums run over channels and rows, unnormalised: x = d(p, q1),
// y = d(p, q2), z = d(p, mean of q1 and q2); rows and neighbours outside the image add nothing. The scratch rows are
// padded by f on both sides, so that the horizontal sum needs no border test.
#import stein::planes::{inside, clamped_index}
#import stein::nlm::{NlmParams, has_opposite, distance, symmetric_distance}

const PATCH_RADIUS: i32 = #{PATCH_RADIUS};
const SIDE: i32 = 2 * PATCH_RADIUS + 1;
const OFFSET_ROWS: i32 = #{OFFSET_ROWS};

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<storage, read> guide: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> variance_of_mean: array<vec4<f32>>;
// Image that holds the neighbours q: the guide again, or a frame beside.
@group(0) @binding(3) var<storage, read> neighbours: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> neighbours_variance: array<vec4<f32>>;
// Column sums, one plane for each offset. Behind them lie the planes of a second, smaller patch, if there is one: two
// filters of one pass share their pixel distances and differ only in the size of the box.
@group(0) @binding(5) var<storage, read_write> columns: array<vec3<f32>>;
#if SMALL_PATCH_RADIUS != -1
const SMALL_PATCH_RADIUS: i32 = #{SMALL_PATCH_RADIUS};
#endif

// Read once: software adapters read a parameter anew wherever it is used.
var<private> nlm: NlmParams;

// Sum over the channels. For a guide of one channel, or of three equal channels, the other channels are not computed.
fn over_channels(distances: vec3<f32>) -> f32 {
#ifdef ONE_CHANNEL
    return distances.x;
#else
#ifdef GREY
    return dot(vec3<f32>(1.0), distances.xxx);
#else
    return dot(vec3<f32>(1.0), distances);
#endif
#endif
}

// Values at a pixel.
struct Pixel {
    u: vec3<f32>,
    variance: vec3<f32>,
}

fn neighbour_at(q: vec2<i32>) -> Pixel {
    let at = clamped_index(q, nlm.extent);
    return Pixel(neighbours[at].xyz, neighbours_variance[at].xyz);
}

fn pair_distances(p: vec2<i32>, offset: vec2<i32>, centre: Pixel, q1: Pixel, q2: Pixel) -> vec3<f32> {
    let p_inside = inside(p, nlm.extent);
    let q1_inside = p_inside && inside(p + offset, nlm.extent);
    let q2_inside = p_inside && inside(p - offset, nlm.extent) && has_opposite(offset);
    let d1 = select(0.0, over_channels(distance(centre.u, q1.u, centre.variance, q1.variance, nlm.k_squared,
        nlm.alpha)), q1_inside);
    let d2 = select(0.0, over_channels(distance(centre.u, q2.u, centre.variance, q2.variance, nlm.k_squared,
        nlm.alpha)), q2_inside);
#ifdef SYMMETRIC
    let both = symmetric_distance(centre.u, q1.u, q2.u, centre.variance, q1.variance, q2.variance, nlm.k_squared,
        nlm.alpha);
    return vec3<f32>(d1, d2, select(0.0, over_channels(both), q1_inside && q2_inside));
#else
    return vec3<f32>(d1, d2, 0.0);
#endif
}

@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    nlm = params;
    let column = i32(id.x);
    if column >= nlm.stride {
        return;
    }
    let x = nlm.first_column + column - PATCH_RADIUS;
    let first_row_of_offsets = (i32(id.z) / nlm.offsets.x) * OFFSET_ROWS;
    let first_plane = first_row_of_offsets * nlm.offsets.x + i32(id.z) % nlm.offsets.x;
    let first_offset = nlm.first_offset + vec2<i32>(i32(id.z) % nlm.offsets.x, first_row_of_offsets);
    let plane_size = nlm.rows * nlm.stride;
    let first = i32(id.y) * nlm.block_rows;
    let end = min(first + nlm.block_rows, nlm.rows);
    // The neighbours that the first row shares with the row above it.
    let top = vec2<i32>(x, nlm.first_row + first - PATCH_RADIUS);
    var aheads: array<Pixel, OFFSET_ROWS>;
    var behinds: array<Pixel, OFFSET_ROWS>;
    for (var k = 0; k < OFFSET_ROWS - 1; k++) {
        aheads[k + 1] = neighbour_at(top + first_offset + vec2<i32>(0, k));
        behinds[k] = neighbour_at(top - first_offset - vec2<i32>(0, k + 1));
    }
    var recent: array<array<vec3<f32>, SIDE>, OFFSET_ROWS>;
    for (var row = first - PATCH_RADIUS; row < end + PATCH_RADIUS; row++) {
        let p = vec2<i32>(x, nlm.first_row + row);
        let at_p = clamped_index(p, nlm.extent);
        let centre = Pixel(guide[at_p].xyz, variance_of_mean[at_p].xyz);
        for (var k = 0; k < OFFSET_ROWS - 1; k++) {
            aheads[k] = aheads[k + 1];
            behinds[OFFSET_ROWS - 1 - k] = behinds[OFFSET_ROWS - 2 - k];
        }
        aheads[OFFSET_ROWS - 1] = neighbour_at(p + first_offset + vec2<i32>(0, OFFSET_ROWS - 1));
        behinds[0] = neighbour_at(p - first_offset);
        let middle = row - PATCH_RADIUS;
        for (var k = 0; k < OFFSET_ROWS; k++) {
            for (var n = 0; n < SIDE - 1; n++) {
                recent[k][n] = recent[k][n + 1];
            }
            recent[k][SIDE - 1] = pair_distances(p, first_offset + vec2<i32>(0, k), centre, aheads[k], behinds[k]);
            if middle >= first {
                // Summed anew for each row: a running sum would carry one outlier's rounding error to the end of the
                // column.
                let at = (first_plane + k * nlm.offsets.x) * plane_size + middle * nlm.stride + column;
                var sum = vec3<f32>(0.0);
                for (var n = 0; n < SIDE; n++) {
                    sum += recent[k][n];
                }
                columns[at] = sum;
#if SMALL_PATCH_RADIUS != -1
                var sum_small = vec3<f32>(0.0);
                for (var n = PATCH_RADIUS - SMALL_PATCH_RADIUS; n <= PATCH_RADIUS + SMALL_PATCH_RADIUS; n++) {
                    sum_small += recent[k][n];
                }
                columns[nlm.offsets.x * nlm.offsets.y * plane_size + at] = sum_small;
#endif
            }
        }
    }
}
