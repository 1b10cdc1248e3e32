// The weights of one pixel's neighbours as candidate_accumulate uses them, each with the distances that it comes from
// (thesis 8.2 and 8.3).
//
// FIRST, SECOND and THIRD say which candidates take part. Works on the chunk of offsets whose column sums nlm_distance
// has left; an invocation computes one pair of neighbours. The cell in the middle is not written: the weight of the
// pixel itself follows from the others.
#import stein::planes::{inside, clamped_index}
#import stein::nlm::{NlmParams, patch_members, pair_weights, weights_from_sums}
#import stein::candidates::{CandidateParams, FeatureGroup, feature_group, feature_distances}
#import stein::window::{WindowParams, window_cell, window_cells}

#ifdef SECOND
const SECOND_RADIUS: i32 = #{PATCH_RADIUS};
const FIRST_RADIUS: i32 = #{SMALL_PATCH_RADIUS};
#else
const SECOND_RADIUS: i32 = 0;
const FIRST_RADIUS: i32 = #{PATCH_RADIUS};
#endif
const FEATURE_GROUPS: i32 = #{FEATURE_GROUPS};

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<uniform> candidate: CandidateParams;
@group(0) @binding(2) var<uniform> window: WindowParams;
#ifdef COLOR
// Column sums of SECOND's patch, and behind them of FIRST's patch; if only one of the two takes part, of its patch.
@group(0) @binding(3) var<storage, read> columns: array<vec3<f32>>;
#endif
#if FEATURE_GROUPS != 0
@group(0) @binding(4) var<storage, read> features: array<vec4<f32>>;
#endif
// Planes: the weights of FIRST, SECOND and THIRD, 0 for a neighbour that does not exist; the colour's distances for
// FIRST and SECOND, and the weights that these give; then two planes for each group of features, for FIRST and SECOND
// and for THIRD: distances of the triple and of the single, and the weights that these give.
@group(0) @binding(5) var<storage, read_write> cells: array<vec4<f32>>;

#if FEATURE_GROUPS != 0
fn group_at(group: i32, q: vec2<i32>) -> FeatureGroup {
    let pixels = params.extent.x * params.extent.y;
    let at = 3 * group * pixels + clamped_index(q, params.extent);
    return feature_group(features[at], features[at + pixels], features[at + 2 * pixels], candidate.feature_tau,
        candidate.feature_tau_third);
}
#endif

// Distances and weights of a pair by the colour. x: the neighbour ahead, y: the neighbour behind.
struct ColorTerm {
    distance: vec2<f32>,
    weight: vec2<f32>,
}

#ifdef COLOR
// Computes the term from the column sums of a patch, of which the first is `first_column`.
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
    var third_distance = vec2<f32>(0.0);
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
        third_distance = max(third_distance,
            vec2<f32>(max(d.third_ahead.x, d.third_ahead.y), max(d.third_behind.x, d.third_behind.y)));
        let at = (2 + 2 * group) * plane;
        cells[at + ahead] = vec4<f32>(d.ahead, exists.x * w.ahead.xy);
        cells[at + behind] = vec4<f32>(d.behind, exists.y * w.behind.xy);
        cells[at + plane + ahead] = vec4<f32>(d.third_ahead, exists.x * exp(-max(d.third_ahead, vec2<f32>(0.0))));
        cells[at + plane + behind] = vec4<f32>(d.third_behind, exists.y * exp(-max(d.third_behind, vec2<f32>(0.0))));
    }
#endif

    // Colour weights (eq. 8.2).
    var first = ColorTerm(vec2<f32>(0.0), vec2<f32>(0.0));
    var second = first;
    let in_plane = in_chunk.y * params.offsets.x + in_chunk.x;
    let column = (in_plane * params.rows + p.y - params.first_row) * params.stride + p.x - params.first_column;
#ifdef SECOND
    second = color_term(column, SECOND_RADIUS, offset, ahead_inside, behind_inside);
#ifdef FIRST
    let of_first = params.offsets.x * params.offsets.y * params.rows * params.stride + SECOND_RADIUS - FIRST_RADIUS;
    first = color_term(of_first + column, FIRST_RADIUS, offset, ahead_inside, behind_inside);
#endif
#else ifdef FIRST
    first = color_term(column, FIRST_RADIUS, offset, ahead_inside, behind_inside);
#endif
    var third = vec2<f32>(0.0);
#ifdef THIRD
    third = exists * exp(-third_distance);
#endif
    let weights_first = min(first.weight, feature_weight);
    let weights_second = min(second.weight, feature_weight);
    cells[ahead] = vec4<f32>(weights_first.x, weights_second.x, third.x, 0.0);
    cells[behind] = vec4<f32>(weights_first.y, weights_second.y, third.y, 0.0);
    cells[plane + ahead] = vec4<f32>(first.distance.x, second.distance.x, first.weight.x, second.weight.x);
    cells[plane + behind] = vec4<f32>(first.distance.y, second.distance.y, first.weight.y, second.weight.y);
}
