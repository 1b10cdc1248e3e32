// The NL-means distance and its weights (thesis 7.1.1, 8.2), shared by every stage that filters with them.
//
// Neighbours are visited in pairs q1 = p + o, q2 = p − o, with o running over half the window: the symmetric weights
// need both at once. The distance itself is *not* symmetric: its cancellation term uses the variance of p, so d(p, q)
// of one pixel cannot be reused as d(q, p) of the other.
#define_import_path stein::nlm

struct NlmParams {
    extent: vec2<i32>,
    // The rectangle that one dispatch works on: a strip of rows of the image, or of a part of it.
    first_column: i32,
    width: i32,
    first_row: i32,
    rows: i32,
    // The chunk of offsets whose distances are in the scratch buffer at one time: a rectangle in the half window that
    // begins at `first_offset` and has as many columns and rows as `offsets` says. The half window is (1..R, 0) and all
    // of the rows 1..R below; in a frame beside it begins at (0, 0), the pixel's own position.
    first_offset: vec2<i32>,
    offsets: vec2<i32>,
    // `starts` is 1 if no sums exist yet for this strip, `completes` is 1 if this chunk completes the sums.
    starts: i32,
    completes: i32,
    // Pixels from one scratch row to the next: the rectangle's width, rounded up to whole invocations, and f on both
    // sides.
    stride: i32,
    // Rows that one invocation of nlm_distance walks down.
    block_rows: i32,
    // k_c² of the guide.
    k_squared: f32,
    // α: how much of the variance is cancelled from squared differences.
    alpha: f32,
    // 1 / number of channels of the guide.
    inverse_channels: f32,
    // Weights below this one count as 0.
    cut: f32,
    // Least weight of the centre. The centre has the largest weight among its neighbours, but no less than this one. A
    // value above 1 gives the centre the weight 1.
    centre_floor: f32,
}

// Prevents a division by zero between two black pixels (eq. 7.4): all others have a variance, which variance_floor
// holds above their rounding.
const EPSILON: f32 = 1e-30;
// A pixel distance beyond this is total dissimilarity in any patch. The limit keeps sums and perturbed sums finite: inf
// − inf would become full weight.
const DISTANCE_LIMIT: f32 = 1e8;
// Above this distance weights vanish in f32 and the ratio that judges symmetry says nothing.
const SYMMETRY_LIMIT: f32 = 25.0;

// eq. 7.4, per channel.
fn distance(u_p: vec3<f32>, u_q: vec3<f32>, var_p: vec3<f32>, var_q: vec3<f32>, k_squared: f32,
    alpha: f32) -> vec3<f32> {
    let difference = u_p - u_q;
    let cancelled = difference * difference - alpha * (var_p + min(var_p, var_q));
    return min(cancelled / (EPSILON + k_squared * (var_p + var_q)), vec3<f32>(DISTANCE_LIMIT));
}

// eq. 7.6: the distance to the mean of the two neighbours. It is eq. 7.4 with their mean in the place of q, ε, k² and α
// included.
fn symmetric_distance(
    u_p: vec3<f32>, u_q1: vec3<f32>, u_q2: vec3<f32>,
    var_p: vec3<f32>, var_q1: vec3<f32>, var_q2: vec3<f32>,
    k_squared: f32, alpha: f32,
) -> vec3<f32> {
    let difference = u_p - 0.5 * (u_q1 + u_q2);
    let cancelled = difference * difference - alpha * (var_p + 0.25 * (min(var_q1, var_p) + min(var_q2, var_p)));
    return min(cancelled / (EPSILON + k_squared * (var_p + 0.25 * (var_q1 + var_q2))), vec3<f32>(DISTANCE_LIMIT));
}

// Whether q2 = p − o is a neighbour of its own: at (0, 0) it would be q1 once more.
fn has_opposite(offset: vec2<i32>) -> bool {
    return any(offset != vec2<i32>(0));
}

// Counts, along one axis, how many of the 2f+1 members n of a patch exist at p and at the neighbours compared with p.
// x: p + n and q1 + n, y: p + n and q2 + n, z: all three. The members of a patch are the product of both axes.
fn patch_members(p: i32, offset: i32, extent: i32, patch_radius: i32) -> vec3<f32> {
    let before = min(patch_radius, p);
    let after = min(patch_radius, extent - 1 - p);
    let ahead = min(after, extent - 1 - p - offset) + min(before, p + offset);
    let behind = min(after, extent - 1 - p + offset) + min(before, p - offset);
    let reach = abs(offset);
    let both = min(after, extent - 1 - p - reach) + min(before, p - reach);
    return vec3<f32>(max(vec3<i32>(ahead, behind, both) + 1, vec3<i32>(0)));
}

struct PairWeights {
    // Weights of q1 = p + o, then of q2 = p − o.
    ahead: vec4<f32>,
    behind: vec4<f32>,
}

// Weights of a pair of neighbours from their distances (eq. 7.5), four independent pairs at a time. Where the weight of
// the mean of both neighbours exceeds the sum of their weights, it replaces both: at once, as in thesis 7.1.1
// (SYMMETRIC_HARD), or by degrees, so that finite differences keep their meaning.
fn pair_weights(distance_q1: vec4<f32>, distance_q2: vec4<f32>, distance_both: vec4<f32>,
    both_inside: bool) -> PairWeights {
    let d1 = max(distance_q1, vec4<f32>(0.0));
    let d2 = max(distance_q2, vec4<f32>(0.0));
    let w1 = exp(-d1);
    let w2 = exp(-d2);
#ifdef SYMMETRIC
    let w_both = exp(-max(distance_both, vec4<f32>(0.0)));
#ifdef SYMMETRIC_HARD
    let replaced = (w_both > w1 + w2) & vec4<bool>(both_inside);
    return PairWeights(select(w1, w_both, replaced), select(w2, w_both, replaced));
#else
    let comparable = (max(d1, d2) < vec4<f32>(SYMMETRY_LIMIT)) & vec4<bool>(both_inside);
    let judged = clamp(w_both / max(w1 + w2, vec4<f32>(1e-20)) - 1.0, vec4<f32>(0.0), vec4<f32>(1.0));
    let share = select(vec4<f32>(0.0), judged, comparable);
    return PairWeights(w1 + share * (w_both - w1), w2 + share * (w_both - w2));
#endif
#else
    return PairWeights(w1, w2);
#endif
}

// Weights of q1 and q2 in the average of p, from the unnormalised sums of their distances over a patch of `members`
// members; 0 for a neighbour that does not exist.
fn weights_from_sums(patch_sum: vec3<f32>, members: vec3<f32>, inverse_channels: f32, ahead_inside: bool,
    behind_inside: bool) -> vec2<f32> {
    let d = patch_sum * inverse_channels / max(members, vec3<f32>(1.0));
    let weights = pair_weights(vec4<f32>(d.x), vec4<f32>(d.y), vec4<f32>(d.z), ahead_inside && behind_inside);
    return select(vec2<f32>(0.0), vec2<f32>(weights.ahead.x, weights.behind.x),
        vec2<bool>(ahead_inside, behind_inside));
}

fn centre_weight(largest: vec4<f32>, centre_floor: f32) -> vec4<f32> {
    if centre_floor > 1.0 {
        return vec4<f32>(1.0);
    }
    return max(largest, vec4<f32>(centre_floor));
}
