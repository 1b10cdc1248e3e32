// The weights of one pixel's neighbours as candidate_accumulate uses them, each with the distances behind it (thesis
// 8.2 and 8.3).
//
// LARGE, SMALL and FEATURES_ALONE name the filters of the pass that take part. The stage works on the chunk of offsets
// whose column sums nlm_distance has written; an invocation computes one pair of neighbours. The cell in the middle is
// not written: the weight of the pixel itself follows from the others.
#import stein::planes::{inside, clamped_index}
#import stein::nlm::{NlmParams, patch_members, pair_weights, weights_from_sums}
#import stein::candidates::{CandidateParams, FeatureGroup, feature_group, feature_distances}
#import stein::window::{WindowParams, window_cell, window_cells}

const LARGE_RADIUS: i32 = #{PATCH_RADIUS};
const SMALL_RADIUS: i32 = #{SMALL_PATCH_RADIUS};
const FEATURE_GROUPS: i32 = #{FEATURE_GROUPS};

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<uniform> candidate: CandidateParams;
@group(0) @binding(2) var<uniform> window: WindowParams;
#ifdef COLOR
// Column sums of the large patch, and behind them of the small patch, if there is one.
@group(0) @binding(3) var<storage, read> columns: array<vec3<f32>>;
#endif
#if FEATURE_GROUPS != 0
@group(0) @binding(4) var<storage, read> features: array<vec4<f32>>;
#endif
// First plane: the weights of the filters, x: small patches, y: large patches, z: features alone; 0 for a neighbour
// that does not exist. Second plane: the distances of small and of large patches, and the weights from these distances.
// Then two planes for each group of features, beside patches and alone: distances of the triple and of the single, and
// the weights from these distances.
@group(0) @binding(5) var<storage, read_write> cells: array<vec4<f32>>;

#if FEATURE_GROUPS != 0
fn group_at(group: i32, q: vec2<i32>) -> FeatureGroup {
    let pixels = params.extent.x * params.extent.y;
    let at = 3 * group * pixels + clamped_index(q, params.extent);
    return feature_group(features[at], features[at + pixels], features[at + 2 * pixels], candidate.feature_tau,
        candidate.feature_tau_alone);
}
#endif

// Distances and weights of a pair by the colour. x: the neighbour ahead, y: the neighbour behind.
struct ColorTerm {
    distance: vec2<f32>,
    weight: vec2<f32>,
}

#ifdef COLOR
// Computes the term from the column sums of a patch; the first sum is at `first_column`.
fn color_term(first_column: i32, patch_radius: i32, offset: vec2<i32>, ahead_inside: bool,
    behind_inside: bool) -> ColorTerm {
    var patch_sum = vec3<f32>(0.0);
    for (var n = 0; n <= 2 * patch_radius; n++) {
        patch_sum += columns[first_column + n];
    }
    let p = window.pixel;
    let members = patch_members(p.x, offset.x, params.extent.x, patch_radius)
        * patch_members(p.y, offset.y, params.extent.y, patch_radius);
    let distance = patch_sum.xy * params.inverse_channels / max(members.xy, vec2<f32>(1.0));
    return ColorTerm(distance, weights_from_sums(patch_sum, members, params.inverse_channels, ahead_inside,
        behind_inside));
}
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let in_chunk = vec2<i32>(id.xy);
    if any(in_chunk >= params.offsets) {
        return;
    }
    let offset = params.first_offset + in_chunk;
    let p = window.pixel;
    let ahead_inside = inside(p + offset, params.extent);
    let behind_inside = inside(p - offset, params.extent);
    let exists = vec2<f32>(vec2<bool>(ahead_inside, behind_inside));
    let ahead = window_cell(offset, window);
    let behind = window_cell(-offset, window);
    let plane = window_cells(window);

    // Feature weights (eq. 8.3).
    var feature_weight = vec2<f32>(1.0);
    var alone_distance = vec2<f32>(0.0);
#if FEATURE_GROUPS != 0
    for (var group = 0; group < FEATURE_GROUPS; group++) {
        let d = feature_distances(
            group_at(group, p), group_at(group, p + offset), group_at(group, p - offset),
                candidate.triple_weights[group].xyz, candidate.inverse_feature_k_squared,
        );
        let both_inside = ahead_inside && behind_inside;
        let w = pair_weights(vec4<f32>(d.ahead, 0.0, 0.0), vec4<f32>(d.behind, 0.0, 0.0), vec4<f32>(d.both, 0.0, 0.0),
            both_inside);
        feature_weight = min(feature_weight, vec2<f32>(min(w.ahead.x, w.ahead.y), min(w.behind.x, w.behind.y)));
        alone_distance = max(alone_distance,
            vec2<f32>(max(d.alone_ahead.x, d.alone_ahead.y), max(d.alone_behind.x, d.alone_behind.y)));
        let at = (2 + 2 * group) * plane;
        cells[at + ahead] = vec4<f32>(d.ahead, exists.x * w.ahead.xy);
        cells[at + behind] = vec4<f32>(d.behind, exists.y * w.behind.xy);
        cells[at + plane + ahead] = vec4<f32>(d.alone_ahead, exists.x * exp(-max(d.alone_ahead, vec2<f32>(0.0))));
        cells[at + plane + behind] = vec4<f32>(d.alone_behind, exists.y * exp(-max(d.alone_behind, vec2<f32>(0.0))));
    }
#endif

    // Colour weights (eq. 8.2).
    var small = ColorTerm(vec2<f32>(0.0), vec2<f32>(0.0));
    var large = small;
    let in_plane = in_chunk.y * params.offsets.x + in_chunk.x;
    let column = (in_plane * params.rows + p.y - params.first_row) * params.stride + p.x - params.first_column;
#ifdef LARGE
    large = color_term(column, LARGE_RADIUS, offset, ahead_inside, behind_inside);
#ifdef SMALL
    let of_small = params.offsets.x * params.offsets.y * params.rows * params.stride + LARGE_RADIUS - SMALL_RADIUS;
    small = color_term(of_small + column, SMALL_RADIUS, offset, ahead_inside, behind_inside);
#endif
#endif
    var alone = vec2<f32>(0.0);
#ifdef FEATURES_ALONE
    alone = exists * exp(-alone_distance);
#endif
    let small_weights = min(small.weight, feature_weight);
    let large_weights = min(large.weight, feature_weight);
    cells[ahead] = vec4<f32>(small_weights.x, large_weights.x, alone.x, 0.0);
    cells[behind] = vec4<f32>(small_weights.y, large_weights.y, alone.y, 0.0);
    cells[plane + ahead] = vec4<f32>(small.distance.x, large.distance.x, small.weight.x, large.weight.x);
    cells[plane + behind] = vec4<f32>(small.distance.y, large.distance.y, small.weight.y, large.weight.y);
}
