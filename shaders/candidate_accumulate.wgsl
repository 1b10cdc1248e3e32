// The three candidate filters of DFC in one pass over the window (thesis 8.2–8.4, Algorithm 1 lines 11–17): mean and half spread filtered by
// min(colour weight, feature weight), and the same sums with each channel of the centre pixel perturbed, for the finite differences of SURE.
//
// FIRST and SECOND share the pixel distance and the features and differ in the box; THIRD shares the features' numerators. The perturbed weights need no second
// pass: a step δ in channel i of p changes the pixel distances that p takes part in, and those alone, so the patch sums change by a few closed terms.
#import stein::planes::{inside, pixel_index, clamped_index}
#import stein::nlm::{NlmParams, PairWeights, EPSILON, DISTANCE_LIMIT, pair_offset, next_offset, has_opposite, patch_pairs, patch_triples, pair_weights}
#import stein::candidates::{CandidateParams, WEIGHT_LANES, LARGEST_LANES, MEAN_SUM, PERTURBED_SUM, SPREAD_SUM, PLANES_WITH_COLOR, THIRD_MEAN_SUM, THIRD_SPREAD_SUM, difference_step}

const FIRST_RADIUS: i32 = #{SMALL_PATCH_RADIUS};
const SECOND_RADIUS: i32 = #{PATCH_RADIUS};
const FEATURE_GROUPS: i32 = #{FEATURE_GROUPS};

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<uniform> candidate: CandidateParams;
@group(0) @binding(2) var<storage, read> columns: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> columns_small: array<vec4<f32>>;
// Two planes: the mean, then the half spread.
@group(0) @binding(4) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> variance_of_mean: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> state: array<vec4<f32>>;
#if FEATURE_GROUPS != 0
@group(0) @binding(7) var<storage, read> features: array<vec4<f32>>;
#endif
#ifdef OTHER_FRAME
// Of the frame beside that q is taken from. Bindings of their own only there: a single image needs none of them.
@group(0) @binding(8) var<storage, read> neighbours_signal: array<vec4<f32>>;
@group(0) @binding(9) var<storage, read> neighbours_variance: array<vec4<f32>>;
#if FEATURE_GROUPS != 0
@group(0) @binding(10) var<storage, read> neighbours_features: array<vec4<f32>>;
#endif
#endif

fn neighbour_signal(at: i32) -> vec3<f32> {
#ifdef OTHER_FRAME
    return neighbours_signal[at].xyz;
#else
    return signal[at].xyz;
#endif
}

fn neighbour_variance(at: i32) -> vec3<f32> {
#ifdef OTHER_FRAME
    return neighbours_variance[at].xyz;
#else
    return variance_of_mean[at].xyz;
#endif
}

#if FEATURE_GROUPS != 0
fn neighbour_feature(at: i32) -> vec4<f32> {
#ifdef OTHER_FRAME
    return neighbours_features[at];
#else
    return features[at];
#endif
}
#endif

// Running sums of one candidate with a colour term.
struct Sums {
    weight: vec4<f32>,
    largest: vec4<f32>,
    mean: vec3<f32>,
    perturbed: vec3<f32>,
    spread: vec3<f32>,
}

// One neighbour, as differences to the centre pixel.
struct Neighbour {
    exists: bool,
    mean: vec3<f32>,
    spread: vec3<f32>,
}

fn add(sums: ptr<function, Sums>, q: Neighbour, color_weight: vec4<f32>, feature_weight: f32) {
    let w = select(vec4<f32>(0.0), min(color_weight, vec4<f32>(feature_weight)), q.exists);
    (*sums).weight += w;
    (*sums).largest = max((*sums).largest, w);
    (*sums).mean += w.x * q.mean;
    (*sums).perturbed += w.yzw * q.mean;
    (*sums).spread += w.x * q.spread;
}

// What a step of the centre value does to a squared difference t², over its denominator.
fn step_change(step: vec3<f32>, difference: vec3<f32>, denominator: vec3<f32>) -> vec3<f32> {
    return clamp(step * (2.0 * difference + step) / denominator, vec3<f32>(-DISTANCE_LIMIT), vec3<f32>(DISTANCE_LIMIT));
}

// Change of the symmetric distance centred at q, one of whose two neighbours is p: half a step, with the other sign.
fn symmetric_change_at(
    at_q: i32, beyond: vec2<i32>, exists: bool,
    u_p: vec3<f32>, var_p: vec3<f32>, step: vec3<f32>,
) -> vec3<f32> {
    let at_beyond = clamped_index(beyond, params.extent);
    let difference = signal[at_q].xyz - 0.5 * (u_p + signal[at_beyond].xyz);
    let denominator = EPSILON + params.k_squared * (variance_of_mean[at_q].xyz + 0.25 * (var_p + variance_of_mean[at_beyond].xyz));
    let change = step_change(-0.5 * step, difference, denominator);
    return select(vec3<f32>(0.0), change, exists && inside(beyond, params.extent));
}

struct PatchChanges {
    q1: vec3<f32>,
    q2: vec3<f32>,
    both: vec3<f32>,
}

fn color_weights(
    sums: vec3<f32>, changes: PatchChanges, p: vec2<i32>, offset: vec2<i32>, patch_radius: i32, both_inside: bool,
) -> PairWeights {
    let members = vec3<f32>(
        patch_pairs(p, offset, params.extent, patch_radius),
        patch_pairs(p, -offset, params.extent, patch_radius),
        patch_triples(p, offset, params.extent, patch_radius),
    );
    let normalise = params.inverse_channels / members;
    return pair_weights(
        (vec4<f32>(sums.x) + vec4<f32>(0.0, changes.q1)) * normalise.x,
        (vec4<f32>(sums.y) + vec4<f32>(0.0, changes.q2)) * normalise.y,
        (vec4<f32>(sums.z) + vec4<f32>(0.0, changes.both)) * normalise.z,
        both_inside,
    );
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let row = i32(id.y);
    let p = vec2<i32>(i32(id.x), params.first_row + row);
    if p.x >= extent.x || row >= params.rows {
        return;
    }
    let pixels = extent.x * extent.y;
    let at_p = pixel_index(p, extent);
    let u_p = signal[at_p].xyz;
    let spread_p = signal[pixels + at_p].xyz;
    let var_p = variance_of_mean[at_p].xyz;
    let step = difference_step(u_p, var_p);
#if FEATURE_GROUPS != 0
    var value_p: array<vec4<f32>, FEATURE_GROUPS>;
    var residual_p: array<vec4<f32>, FEATURE_GROUPS>;
    var scale_p: array<vec4<f32>, FEATURE_GROUPS>;
    for (var group = 0; group < FEATURE_GROUPS; group++) {
        value_p[group] = features[3 * group * pixels + at_p];
        residual_p[group] = features[(3 * group + 1) * pixels + at_p];
        scale_p[group] = features[(3 * group + 2) * pixels + at_p];
    }
#endif

    let strip_pixels = params.rows * extent.x;
    let at_state = row * extent.x + p.x;
    var first: Sums;
    var second: Sums;
    // xyz: Σ w·(u_q − u_p), w: Σ w; and for the spread, with the largest weight in w.
    var third_mean = vec4<f32>(0.0);
    var third_spread = vec4<f32>(0.0);
    if params.starts == 0 {
        first = load_sums(0, strip_pixels, at_state);
        second = load_sums(PLANES_WITH_COLOR, strip_pixels, at_state);
        third_mean = state[THIRD_MEAN_SUM * strip_pixels + at_state];
        third_spread = state[THIRD_SPREAD_SUM * strip_pixels + at_state];
    }

    let stride = extent.x + 2 * SECOND_RADIUS;
    var offset = pair_offset(params.first_pair, params.window_radius);
    for (var pair = 0; pair < params.pairs; pair++) {
        let p_q1 = p + offset;
        let p_q2 = p - offset;
        let q1_inside = inside(p_q1, extent);
        let q2_inside = inside(p_q2, extent) && has_opposite(offset);
        let both_inside = q1_inside && q2_inside;
        let at_q1 = clamped_index(p_q1, extent);
        let at_q2 = clamped_index(p_q2, extent);

        // Feature weights (eq. 8.3).
        var feature_q1 = 1.0;
        var feature_q2 = 1.0;
        var third_distance_q1 = 0.0;
        var third_distance_q2 = 0.0;
#if FEATURE_GROUPS != 0
        for (var group = 0; group < FEATURE_GROUPS; group++) {
            let triple = candidate.triple_weights[group].xyz;
            let plane = 3 * group * pixels;
            let value_q1 = neighbour_feature(plane + at_q1);
            let residual_q1 = neighbour_feature(plane + pixels + at_q1);
            let scale_q1 = neighbour_feature(plane + 2 * pixels + at_q1);
            let value_q2 = neighbour_feature(plane + at_q2);
            let residual_q2 = neighbour_feature(plane + pixels + at_q2);
            let scale_q2 = neighbour_feature(plane + 2 * pixels + at_q2);
            let to_q1 = value_p[group] - value_q1;
            let to_q2 = value_p[group] - value_q2;
            let tau = vec4<f32>(candidate.feature_tau);
            let tau_third = vec4<f32>(candidate.feature_tau_third);
#ifdef SYMMETRIC
            let least_q1 = min(residual_p[group], residual_q1);
            let least_q2 = min(residual_p[group], residual_q2);
            let squared_q1 = (to_q1 * to_q1 - (residual_p[group] + least_q1)) * candidate.inverse_feature_k_squared;
            let squared_q2 = (to_q2 * to_q2 - (residual_p[group] + least_q2)) * candidate.inverse_feature_k_squared;
            let to_both = 0.5 * (to_q1 + to_q2);
            let squared_both = (to_both * to_both - (residual_p[group] + 0.25 * (least_q1 + least_q2))) * candidate.inverse_feature_k_squared;
            let reach_p = max(tau, scale_p[group]);
            let reach_q1 = max(tau, scale_q1);
            let reach_q2 = max(tau, scale_q2);
            let phi_q1 = squared_q1 / (reach_p + reach_q1);
            let phi_q2 = squared_q2 / (reach_p + reach_q2);
            let phi_both = squared_both / (reach_p + 0.25 * (reach_q1 + reach_q2));
            let third_reach_p = max(tau_third, scale_p[group]);
            let phi_third_q1 = squared_q1 / (third_reach_p + max(tau_third, scale_q1));
            let phi_third_q2 = squared_q2 / (third_reach_p + max(tau_third, scale_q2));
#else
            // The printed form: the scale of p alone, the full variance of q.
            let squared_q1 = (to_q1 * to_q1 - (residual_p[group] + residual_q1)) * candidate.inverse_feature_k_squared;
            let squared_q2 = (to_q2 * to_q2 - (residual_p[group] + residual_q2)) * candidate.inverse_feature_k_squared;
            let phi_q1 = squared_q1 / max(tau, scale_p[group]);
            let phi_q2 = squared_q2 / max(tau, scale_p[group]);
            let phi_both = vec4<f32>(0.0);
            let phi_third_q1 = squared_q1 / max(tau_third, scale_p[group]);
            let phi_third_q2 = squared_q2 / max(tau_third, scale_p[group]);
#endif
            // Lane 0: the triple, lane 1: the single.
            let w = pair_weights(
                vec4<f32>(dot(phi_q1.xyz, triple), phi_q1.w, 0.0, 0.0),
                vec4<f32>(dot(phi_q2.xyz, triple), phi_q2.w, 0.0, 0.0),
                vec4<f32>(dot(phi_both.xyz, triple), phi_both.w, 0.0, 0.0),
                both_inside,
            );
            feature_q1 = min(feature_q1, min(w.ahead.x, w.ahead.y));
            feature_q2 = min(feature_q2, min(w.behind.x, w.behind.y));
            third_distance_q1 = max(third_distance_q1, max(dot(phi_third_q1.xyz, triple), phi_third_q1.w));
            third_distance_q2 = max(third_distance_q2, max(dot(phi_third_q2.xyz, triple), phi_third_q2.w));
        }
#endif

        // What a step in each channel of p does to the patch sums: the pair (p, q) itself, and where p lies in its neighbour's patch, the pair that ends in p.
        // In another frame's patches p lies nowhere.
        let u_q1 = neighbour_signal(at_q1);
        let u_q2 = neighbour_signal(at_q2);
        let var_q1 = neighbour_variance(at_q1);
        let var_q2 = neighbour_variance(at_q2);
        let zero = vec3<f32>(0.0);
        let change_q1 = select(zero, step_change(step, u_p - u_q1, EPSILON + params.k_squared * (var_p + var_q1)), q1_inside);
        let change_q2 = select(zero, step_change(step, u_p - u_q2, EPSILON + params.k_squared * (var_p + var_q2)), q2_inside);
        var first_changes = PatchChanges(change_q1, change_q2, zero);
        var second_changes = first_changes;
#ifdef SYMMETRIC
        let change_both = select(
            zero,
            step_change(step, u_p - 0.5 * (u_q1 + u_q2), EPSILON + params.k_squared * (var_p + 0.25 * (var_q1 + var_q2))),
            both_inside,
        );
        first_changes.both = change_both;
        second_changes.both = change_both;
#endif
#ifndef OTHER_FRAME
        let reach = max(abs(offset.x), abs(offset.y));
        if reach <= max(FIRST_RADIUS, SECOND_RADIUS) {
            var near = PatchChanges(change_q2, change_q1, zero);
#ifdef SYMMETRIC
            near.both = symmetric_change_at(at_q1, p + 2 * offset, q1_inside, u_p, var_p, step)
                + symmetric_change_at(at_q2, p - 2 * offset, q2_inside, u_p, var_p, step);
#endif
            if reach <= FIRST_RADIUS {
                first_changes = PatchChanges(change_q1 + near.q1, change_q2 + near.q2, first_changes.both + near.both);
            }
            if reach <= SECOND_RADIUS {
                second_changes = PatchChanges(change_q1 + near.q1, change_q2 + near.q2, second_changes.both + near.both);
            }
        }
#endif

        // Colour weights (eq. 8.2): the horizontal half of the patch sums.
        let column = (pair * params.rows + row) * stride + p.x + SECOND_RADIUS;
        var first_patch = zero;
        for (var n = -FIRST_RADIUS; n <= FIRST_RADIUS; n++) {
            first_patch += columns_small[column + n].xyz;
        }
        var second_patch = zero;
        for (var n = -SECOND_RADIUS; n <= SECOND_RADIUS; n++) {
            second_patch += columns[column + n].xyz;
        }
        let first_weights = color_weights(first_patch, first_changes, p, offset, FIRST_RADIUS, both_inside);
        let second_weights = color_weights(second_patch, second_changes, p, offset, SECOND_RADIUS, both_inside);

        let q1 = Neighbour(q1_inside, u_q1 - u_p, neighbour_signal(pixels + at_q1) - spread_p);
        let q2 = Neighbour(q2_inside, u_q2 - u_p, neighbour_signal(pixels + at_q2) - spread_p);
        add(&first, q1, first_weights.ahead, feature_q1);
        add(&first, q2, first_weights.behind, feature_q2);
        add(&second, q1, second_weights.ahead, feature_q1);
        add(&second, q2, second_weights.behind, feature_q2);
        let third_q1 = select(0.0, exp(-third_distance_q1), q1_inside);
        let third_q2 = select(0.0, exp(-third_distance_q2), q2_inside);
        third_mean += vec4<f32>(third_q1 * q1.mean + third_q2 * q2.mean, third_q1 + third_q2);
        third_spread = vec4<f32>(third_spread.xyz + third_q1 * q1.spread + third_q2 * q2.spread, max(third_spread.w, max(third_q1, third_q2)));
        offset = next_offset(offset, params.window_radius);
    }

    store_sums(first, 0, strip_pixels, at_state);
    store_sums(second, PLANES_WITH_COLOR, strip_pixels, at_state);
    state[THIRD_MEAN_SUM * strip_pixels + at_state] = third_mean;
    state[THIRD_SPREAD_SUM * strip_pixels + at_state] = third_spread;
}

fn load_sums(base: i32, strip_pixels: i32, at: i32) -> Sums {
    return Sums(
        state[(base + WEIGHT_LANES) * strip_pixels + at],
        state[(base + LARGEST_LANES) * strip_pixels + at],
        state[(base + MEAN_SUM) * strip_pixels + at].xyz,
        state[(base + PERTURBED_SUM) * strip_pixels + at].xyz,
        state[(base + SPREAD_SUM) * strip_pixels + at].xyz,
    );
}

fn store_sums(sums: Sums, base: i32, strip_pixels: i32, at: i32) {
    state[(base + WEIGHT_LANES) * strip_pixels + at] = sums.weight;
    state[(base + LARGEST_LANES) * strip_pixels + at] = sums.largest;
    state[(base + MEAN_SUM) * strip_pixels + at] = vec4<f32>(sums.mean, 0.0);
    state[(base + PERTURBED_SUM) * strip_pixels + at] = vec4<f32>(sums.perturbed, 0.0);
    state[(base + SPREAD_SUM) * strip_pixels + at] = vec4<f32>(sums.spread, 0.0);
}
