// Up to three candidate filters in one pass over the window (thesis 8.2–8.4, Algorithm 1 lines 11–17): mean and half
// spread filtered by min(colour weight, feature weight), and the same sums with each channel of the centre pixel
// perturbed, for the finite differences of SURE.
//
// The first two filters compare patches of the colour, small and large ones. They share pixel distances and features,
// and differ only in the size of the box. The third filter compares the features alone and shares their numerators. The
// three candidates of Algorithm 1 are such a pass. The perturbed weights need no second pass: a step δ in channel i of
// p changes only the pixel distances that p takes part in, so the patch sums change by a few closed terms.
//
// LARGE, SMALL and FEATURES_ALONE name the filters that take part, SMALL only beside LARGE. DERIVATIVES computes the
// perturbed sums; the mean of the payload is then the guide that nlm_distance compared. HALVES filters the half spread.
// GREY means that all channels of the colour are equal. WEIGHTS leaves the weights behind the running sums, for
// payload_accumulate.
//
// An invocation filters PIXELS pixels in a row and goes through the offsets row by row: each offset has the same
// neighbours as the offset before, except for one. Neighbours and running sums stay in registers.
#import stein::nlm::{NlmParams, PairWeights, EPSILON, DISTANCE_LIMIT, has_opposite, patch_members, pair_weights}
#import stein::candidates::{CandidateParams, FeatureGroup, feature_group, feature_distances, WEIGHT_LANES,
    LARGEST_LANES, MEAN_SUM, PERTURBED_SUM, SPREAD_SUM, PLANES_WITH_COLOR, ALONE_MEAN_SUM, ALONE_SPREAD_SUM,
    SUM_PLANES, difference_step}

const LARGE_RADIUS: i32 = #{PATCH_RADIUS};
const SMALL_RADIUS: i32 = #{SMALL_PATCH_RADIUS};
const PIXELS: i32 = #{PIXELS};
const FEATURE_GROUPS: i32 = #{FEATURE_GROUPS};

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<uniform> candidate: CandidateParams;
#ifdef COLOR
// Column sums of the large patch, and behind them of the small patch, if there is one.
@group(0) @binding(2) var<storage, read> columns: array<vec3<f32>>;
#endif
// Image to average. Two planes: the mean, then the half spread.
@group(0) @binding(3) var<storage, read> payload: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> variance_of_mean: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> state: array<vec4<f32>>;
#if FEATURE_GROUPS != 0
@group(0) @binding(6) var<storage, read> features: array<vec4<f32>>;
#endif
#ifdef OTHER_FRAME
// Frame beside that holds the neighbours q. Only this case has these bindings: a single image needs none of them.
@group(0) @binding(7) var<storage, read> neighbours_payload: array<vec4<f32>>;
@group(0) @binding(8) var<storage, read> neighbours_variance: array<vec4<f32>>;
#if FEATURE_GROUPS != 0
@group(0) @binding(9) var<storage, read> neighbours_features: array<vec4<f32>>;
#endif
#endif

// Read once: software adapters read a parameter anew wherever it is used.
var<private> nlm: NlmParams;
var<private> filter_params: CandidateParams;

// Values at a pixel.
struct Pixel {
    mean: vec3<f32>,
    spread: vec3<f32>,
    variance: vec3<f32>,
#if FEATURE_GROUPS != 0
    features: array<FeatureGroup, FEATURE_GROUPS>,
#endif
}

// Running sums of one candidate with a colour term.
struct Sums {
    weight: vec4<f32>,
    largest: vec4<f32>,
    mean: vec3<f32>,
    perturbed: vec3<f32>,
    spread: vec3<f32>,
}

// If all three channels are equal, the first one stands for all, and the others are not computed.
fn channels(value: vec3<f32>) -> vec3<f32> {
#ifdef GREY
    return value.xxx;
#else
    return value;
#endif
}

// Does the same as `channels`, for the lanes of the filter itself and of the filters with one channel perturbed.
fn lanes(value: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(value.x, channels(value.yzw));
}

// Loads the pixel in this row nearest to column x.
fn centre_at(x: i32, row: i32) -> Pixel {
    let pixels = nlm.extent.x * nlm.extent.y;
    let at = row * nlm.extent.x + clamp(x, 0, nlm.extent.x - 1);
    var pixel: Pixel;
    pixel.mean = payload[at].xyz;
#ifdef HALVES
    pixel.spread = payload[pixels + at].xyz;
#endif
    pixel.variance = variance_of_mean[at].xyz;
#if FEATURE_GROUPS != 0
    for (var group = 0; group < FEATURE_GROUPS; group++) {
        let first = 3 * group * pixels + at;
        let scale = features[first + 2 * pixels];
        pixel.features[group] = feature_group(features[first], features[first + pixels], scale,
            filter_params.feature_tau, filter_params.feature_tau_alone);
    }
#endif
    return pixel;
}

fn neighbour_at(x: i32, row: i32) -> Pixel {
#ifdef OTHER_FRAME
    let pixels = nlm.extent.x * nlm.extent.y;
    let at = row * nlm.extent.x + clamp(x, 0, nlm.extent.x - 1);
    var pixel: Pixel;
    pixel.mean = neighbours_payload[at].xyz;
#ifdef HALVES
    pixel.spread = neighbours_payload[pixels + at].xyz;
#endif
    pixel.variance = neighbours_variance[at].xyz;
#if FEATURE_GROUPS != 0
    for (var group = 0; group < FEATURE_GROUPS; group++) {
        let first = 3 * group * pixels + at;
        let value = neighbours_features[first];
        let scale = neighbours_features[first + 2 * pixels];
        pixel.features[group] = feature_group(value, neighbours_features[first + pixels], scale,
            filter_params.feature_tau, filter_params.feature_tau_alone);
    }
#endif
    return pixel;
#else
    return centre_at(x, row);
#endif
}

fn added(before: Sums, weights: vec4<f32>, mean: vec3<f32>, spread: vec3<f32>) -> Sums {
    let w = lanes(weights);
#ifdef HALVES
    let spread_sum = before.spread + w.x * spread;
#else
    let spread_sum = before.spread;
#endif
    return Sums(before.weight + w, max(before.largest, w), before.mean + w.x * mean, before.perturbed + w.yzw * mean,
        spread_sum);
}

// Change of a squared difference t², over its denominator, by a step of the centre value.
fn step_change(step: vec3<f32>, difference: vec3<f32>, denominator: vec3<f32>) -> vec3<f32> {
    return clamp(step * (2.0 * difference + step) / denominator, vec3<f32>(-DISTANCE_LIMIT), vec3<f32>(DISTANCE_LIMIT));
}

struct PatchChanges {
    q1: vec3<f32>,
    q2: vec3<f32>,
    both: vec3<f32>,
}

#ifdef NEAR
// Change of the symmetric distance centred at q, one of whose two neighbours is p: the step counts half, with the
// opposite sign. `beyond` is the other neighbour.
fn symmetric_change_at(q: Pixel, beyond: Pixel, exists: bool, p: Pixel, step: vec3<f32>) -> vec3<f32> {
    let difference = q.mean - 0.5 * (p.mean + beyond.mean);
    let denominator = EPSILON + nlm.k_squared * (q.variance + 0.25 * (p.variance + beyond.variance));
    return select(vec3<f32>(0.0), step_change(-0.5 * step, difference, denominator), exists);
}
#endif

fn color_weights(sums: vec3<f32>, changes: PatchChanges, members: vec3<f32>, both_inside: bool) -> PairWeights {
    let normalise = nlm.inverse_channels / max(members, vec3<f32>(1.0));
    return pair_weights(
        (vec4<f32>(sums.x) + vec4<f32>(0.0, channels(changes.q1))) * normalise.x,
        (vec4<f32>(sums.y) + vec4<f32>(0.0, channels(changes.q2))) * normalise.y,
        (vec4<f32>(sums.z) + vec4<f32>(0.0, channels(changes.both))) * normalise.z,
        both_inside,
    );
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    nlm = params;
    filter_params = candidate;
    let extent = nlm.extent;
    let row = i32(id.y);
    let y = nlm.first_row + row;
    let first_column = i32(id.x) * PIXELS;
    let first_x = nlm.first_column + first_column;
    if first_column >= nlm.width || row >= nlm.rows {
        return;
    }
    let strip_pixels = nlm.rows * nlm.width;
    var centres: array<Pixel, PIXELS>;
    var steps: array<vec3<f32>, PIXELS>;
    var smalls: array<Sums, PIXELS>;
    var larges: array<Sums, PIXELS>;
    // Sums of the filter by features alone. Means: xyz: Σ w·(u_q − u_p), w: Σ w. Spreads: xyz: the sum for the spread,
    // w: the largest weight.
    var alone_means: array<vec4<f32>, PIXELS>;
    var alone_spreads: array<vec4<f32>, PIXELS>;
    for (var i = 0; i < PIXELS; i++) {
        centres[i] = centre_at(first_x + i, y);
        steps[i] = difference_step(centres[i].mean, variance_of_mean[y * extent.x + min(first_x + i, extent.x - 1)]);
        if nlm.starts == 0 {
            let at_state = row * nlm.width + min(first_column + i, nlm.width - 1);
#ifdef SMALL
            smalls[i] = load_sums(0, strip_pixels, at_state);
#endif
#ifdef LARGE
            larges[i] = load_sums(PLANES_WITH_COLOR, strip_pixels, at_state);
#endif
#ifdef FEATURES_ALONE
            alone_means[i] = state[ALONE_MEAN_SUM * strip_pixels + at_state];
            alone_spreads[i] = state[ALONE_SPREAD_SUM * strip_pixels + at_state];
#endif
        }
    }

    let small_columns_at = nlm.offsets.x * nlm.offsets.y * nlm.rows * nlm.stride + LARGE_RADIUS - SMALL_RADIUS;
    for (var j = 0; j < nlm.offsets.y; j++) {
        let dy = nlm.first_offset.y + j;
        let ahead_row_inside = y + dy < extent.y;
        let behind_row_inside = y - dy >= 0;
        let ahead_row = min(y + dy, extent.y - 1);
        let behind_row = max(y - dy, 0);
        let small_members_y = patch_members(y, dy, extent.y, SMALL_RADIUS);
        let large_members_y = patch_members(y, dy, extent.y, LARGE_RADIUS);

        // The neighbours that the first offset shares with the offset before it.
        var aheads: array<Pixel, PIXELS>;
        var behinds: array<Pixel, PIXELS>;
        for (var i = 0; i < PIXELS - 1; i++) {
            aheads[i + 1] = neighbour_at(first_x + i + nlm.first_offset.x, ahead_row);
            behinds[i] = neighbour_at(first_x + i + 1 - nlm.first_offset.x, behind_row);
        }
        for (var o = 0; o < nlm.offsets.x; o++) {
            let dx = nlm.first_offset.x + o;
            let offset = vec2<i32>(dx, dy);
            for (var i = 0; i < PIXELS - 1; i++) {
                aheads[i] = aheads[i + 1];
                behinds[PIXELS - 1 - i] = behinds[PIXELS - 2 - i];
            }
            aheads[PIXELS - 1] = neighbour_at(first_x + PIXELS - 1 + dx, ahead_row);
            behinds[0] = neighbour_at(first_x - dx, behind_row);

            // Colour distances: the column sums that the patches of these pixels add up horizontally.
            let column = ((j * nlm.offsets.x + o) * nlm.rows + row) * nlm.stride + first_column;
#ifdef LARGE
            var large_columns: array<vec3<f32>, PIXELS + 2 * LARGE_RADIUS>;
            for (var n = 0; n < PIXELS + 2 * LARGE_RADIUS; n++) {
                large_columns[n] = columns[column + n];
            }
#endif
#ifdef SMALL
            var small_columns: array<vec3<f32>, PIXELS + 2 * SMALL_RADIUS>;
            for (var n = 0; n < PIXELS + 2 * SMALL_RADIUS; n++) {
                small_columns[n] = columns[small_columns_at + column + n];
            }
#endif

            for (var i = 0; i < PIXELS; i++) {
                let x = first_x + i;
                let p = centres[i];
                let q1 = aheads[i];
                let q2 = behinds[i];
                let q1_inside = ahead_row_inside && x + dx >= 0 && x + dx < extent.x;
                let q2_inside = behind_row_inside && x - dx >= 0 && x - dx < extent.x && has_opposite(offset);
                let both_inside = q1_inside && q2_inside;

                // Feature weights (eq. 8.3).
                var feature_q1 = 1.0;
                var feature_q2 = 1.0;
                var alone_distance_q1 = 0.0;
                var alone_distance_q2 = 0.0;
#if FEATURE_GROUPS != 0
                for (var group = 0; group < FEATURE_GROUPS; group++) {
                    let triple = filter_params.triple_weights[group].xyz;
                    let d = feature_distances(p.features[group], q1.features[group], q2.features[group], triple,
                        filter_params.inverse_feature_k_squared);
                    // Lane 0: the triple, lane 1: the single.
                    let w = pair_weights(
                        vec4<f32>(d.ahead, 0.0, 0.0),
                        vec4<f32>(d.behind, 0.0, 0.0),
                        vec4<f32>(d.both, 0.0, 0.0),
                        both_inside,
                    );
                    feature_q1 = min(feature_q1, min(w.ahead.x, w.ahead.y));
                    feature_q2 = min(feature_q2, min(w.behind.x, w.behind.y));
                    alone_distance_q1 = max(alone_distance_q1, max(d.alone_ahead.x, d.alone_ahead.y));
                    alone_distance_q2 = max(alone_distance_q2, max(d.alone_behind.x, d.alone_behind.y));
                }
#endif

                // Changes of the patch sums by a step in each channel of p. The pair (p, q) itself changes and, if p
                // lies in its neighbour's patch, the pair that ends in p. Patches of another frame do not contain p.
                let zero = vec3<f32>(0.0);
                var small_changes = PatchChanges(zero, zero, zero);
                var large_changes = small_changes;
#ifdef DERIVATIVES
                let step = steps[i];
                let change_q1 = select(zero, step_change(step, p.mean - q1.mean,
                    EPSILON + nlm.k_squared * (p.variance + q1.variance)), q1_inside);
                let change_q2 = select(zero, step_change(step, p.mean - q2.mean,
                    EPSILON + nlm.k_squared * (p.variance + q2.variance)), q2_inside);
                small_changes = PatchChanges(change_q1, change_q2, zero);
                large_changes = small_changes;
#ifdef SYMMETRIC
                let to_mean = p.mean - 0.5 * (q1.mean + q2.mean);
                let denominator = EPSILON + nlm.k_squared * (p.variance + 0.25 * (q1.variance + q2.variance));
                let change_both = select(zero, step_change(step, to_mean, denominator), both_inside);
                small_changes.both = change_both;
                large_changes.both = change_both;
#endif
#ifdef NEAR
                let reach = max(abs(dx), dy);
                if reach <= max(SMALL_RADIUS, LARGE_RADIUS) {
                    var near = PatchChanges(change_q2, change_q1, zero);
#ifdef SYMMETRIC
                    let beyond_q1_inside = q1_inside && x + 2 * dx >= 0 && x + 2 * dx < extent.x && y + 2
                        * dy < extent.y;
                    let beyond_q2_inside = q2_inside && x - 2 * dx >= 0 && x - 2 * dx < extent.x && y - 2 * dy >= 0;
                    near.both = symmetric_change_at(q1, centre_at(x + 2 * dx, min(y + 2 * dy, extent.y - 1)),
                        beyond_q1_inside, p, step)
                        + symmetric_change_at(q2, centre_at(x - 2 * dx, max(y - 2 * dy, 0)), beyond_q2_inside, p, step);
#endif
                    if reach <= SMALL_RADIUS {
                        small_changes = PatchChanges(change_q1 + near.q1, change_q2 + near.q2,
                            small_changes.both + near.both);
                    }
                    if reach <= LARGE_RADIUS {
                        large_changes = PatchChanges(change_q1 + near.q1, change_q2 + near.q2,
                            large_changes.both + near.both);
                    }
                }
#endif
#endif

                // Colour weights (eq. 8.2).
                let none = vec4<f32>(0.0);
#ifdef WEIGHTS
                var by_color = none;
                let at_weights = SUM_PLANES * strip_pixels + column + i;
#endif
                let mean_q1 = q1.mean - p.mean;
                let mean_q2 = q2.mean - p.mean;
                let spread_q1 = q1.spread - p.spread;
                let spread_q2 = q2.spread - p.spread;
#ifdef SMALL
                var small_patch = zero;
                for (var n = 0; n <= 2 * SMALL_RADIUS; n++) {
                    small_patch += small_columns[i + n];
                }
                let small_members = small_members_y * patch_members(x, dx, extent.x, SMALL_RADIUS);
                let small_weights = color_weights(small_patch, small_changes, small_members, both_inside);
                let small_q1 = select(none, min(small_weights.ahead, vec4<f32>(feature_q1)), q1_inside);
                let small_q2 = select(none, min(small_weights.behind, vec4<f32>(feature_q2)), q2_inside);
                smalls[i] = added(smalls[i], small_q1, mean_q1, spread_q1);
                smalls[i] = added(smalls[i], small_q2, mean_q2, spread_q2);
#ifdef WEIGHTS
                by_color = vec4<f32>(small_q1.x, small_q2.x, 0.0, 0.0);
#endif
#endif
#ifdef LARGE
                var large_patch = zero;
                for (var n = 0; n <= 2 * LARGE_RADIUS; n++) {
                    large_patch += large_columns[i + n];
                }
                let large_members = large_members_y * patch_members(x, dx, extent.x, LARGE_RADIUS);
                let large_weights = color_weights(large_patch, large_changes, large_members, both_inside);
                let large_q1 = select(none, min(large_weights.ahead, vec4<f32>(feature_q1)), q1_inside);
                let large_q2 = select(none, min(large_weights.behind, vec4<f32>(feature_q2)), q2_inside);
                larges[i] = added(larges[i], large_q1, mean_q1, spread_q1);
                larges[i] = added(larges[i], large_q2, mean_q2, spread_q2);
#ifdef WEIGHTS
                state[at_weights] = vec4<f32>(by_color.xy, large_q1.x, large_q2.x);
#endif
#endif
#ifdef FEATURES_ALONE
                let alone_q1 = select(0.0, exp(-alone_distance_q1), q1_inside);
                let alone_q2 = select(0.0, exp(-alone_distance_q2), q2_inside);
                alone_means[i] += vec4<f32>(alone_q1 * mean_q1 + alone_q2 * mean_q2, alone_q1 + alone_q2);
                let before = alone_spreads[i];
#ifdef HALVES
                let spread_sum = before.xyz + alone_q1 * spread_q1 + alone_q2 * spread_q2;
#else
                let spread_sum = before.xyz;
#endif
                alone_spreads[i] = vec4<f32>(spread_sum, max(before.w, max(alone_q1, alone_q2)));
#ifdef WEIGHTS
#ifdef LARGE
                let behind_others = nlm.offsets.x * nlm.offsets.y * nlm.rows * nlm.stride;
#else
                let behind_others = 0;
#endif
                state[at_weights + behind_others] = vec4<f32>(alone_q1, alone_q2, 0.0, 0.0);
#endif
#endif
            }
        }
    }

    for (var i = 0; i < PIXELS; i++) {
        let at_state = row * nlm.width + first_column + i;
        if first_column + i < nlm.width {
#ifdef SMALL
            store_sums(smalls[i], 0, strip_pixels, at_state);
#endif
#ifdef LARGE
            store_sums(larges[i], PLANES_WITH_COLOR, strip_pixels, at_state);
#endif
#ifdef FEATURES_ALONE
            state[ALONE_MEAN_SUM * strip_pixels + at_state] = vec4<f32>(channels(alone_means[i].xyz), alone_means[i].w);
            state[ALONE_SPREAD_SUM * strip_pixels + at_state] = vec4<f32>(channels(alone_spreads[i].xyz),
                alone_spreads[i].w);
#endif
        }
    }
}

#ifdef COLOR
fn load_sums(base: i32, strip_pixels: i32, at: i32) -> Sums {
    return Sums(
        state[(base + WEIGHT_LANES) * strip_pixels + at],
        state[(base + LARGEST_LANES) * strip_pixels + at],
        state[(base + MEAN_SUM) * strip_pixels + at].xyz,
#ifdef DERIVATIVES
        state[(base + PERTURBED_SUM) * strip_pixels + at].xyz,
#else
        vec3<f32>(0.0),
#endif
        state[(base + SPREAD_SUM) * strip_pixels + at].xyz,
    );
}

fn store_sums(sums: Sums, base: i32, strip_pixels: i32, at: i32) {
#ifdef DERIVATIVES
    state[(base + WEIGHT_LANES) * strip_pixels + at] = lanes(sums.weight);
    state[(base + LARGEST_LANES) * strip_pixels + at] = lanes(sums.largest);
    state[(base + PERTURBED_SUM) * strip_pixels + at] = vec4<f32>(channels(sums.perturbed), 0.0);
#else
    // Values that are not stored are not computed.
    state[(base + WEIGHT_LANES) * strip_pixels + at] = vec4<f32>(sums.weight.x, 0.0, 0.0, 0.0);
    state[(base + LARGEST_LANES) * strip_pixels + at] = vec4<f32>(sums.largest.x, 0.0, 0.0, 0.0);
#endif
    state[(base + MEAN_SUM) * strip_pixels + at] = vec4<f32>(channels(sums.mean), 0.0);
    state[(base + SPREAD_SUM) * strip_pixels + at] = vec4<f32>(channels(sums.spread), 0.0);
}
#endif
