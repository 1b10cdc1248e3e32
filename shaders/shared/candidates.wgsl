// Code shared by the stages around the candidate filters: the parameters of a pass over the window, the layout of its
// sums, the finite-difference step, the errors of one pixel.
#define_import_path stein::candidates

struct CandidateParams {
    // 1 / k_f².
    inverse_feature_k_squared: f32,
    // Least scale of a feature difference: τ beside patches of the colour, then τ of the features alone.
    feature_tau: f32,
    feature_tau_alone: f32,
    // 1 / number of channels, per channel of the triple: turns a sum over channels into their mean.
    triple_weights: array<vec4<f32>, 8>,
}

// Values of one group of features at a pixel. x, y, z: the triple, w: the single.
struct FeatureGroup {
    value: vec4<f32>,
    residual: vec4<f32>,
    // max(τ, scale), with the τ beside patches, then with the τ of the features alone.
    reach: vec4<f32>,
    alone_reach: vec4<f32>,
}

// Makes a group from its three planes.
fn feature_group(value: vec4<f32>, residual: vec4<f32>, scale: vec4<f32>, tau: f32, tau_alone: f32) -> FeatureGroup {
    return FeatureGroup(value, residual, max(vec4<f32>(tau), scale), max(vec4<f32>(tau_alone), scale));
}

// Distances of a group from p to a pair of neighbours (eq. 8.3). x: the distance of the triple, y: the distance of the
// single. The fields `alone_` use the τ of the features alone.
struct FeatureDistances {
    ahead: vec2<f32>,
    behind: vec2<f32>,
    both: vec2<f32>,
    alone_ahead: vec2<f32>,
    alone_behind: vec2<f32>,
}

// x: the mean over the channels of the triple, y: the single.
fn over_triple(distances: vec4<f32>, triple_weights: vec3<f32>) -> vec2<f32> {
    return vec2<f32>(dot(distances.xyz, triple_weights), distances.w);
}

fn feature_distances(p: FeatureGroup, ahead: FeatureGroup, behind: FeatureGroup, triple_weights: vec3<f32>,
    inverse_k_squared: f32) -> FeatureDistances {
    let to_ahead = p.value - ahead.value;
    let to_behind = p.value - behind.value;
#ifdef SYMMETRIC
    let least_ahead = min(p.residual, ahead.residual);
    let least_behind = min(p.residual, behind.residual);
    let squared_ahead = (to_ahead * to_ahead - (p.residual + least_ahead)) * inverse_k_squared;
    let squared_behind = (to_behind * to_behind - (p.residual + least_behind)) * inverse_k_squared;
    let to_both = 0.5 * (to_ahead + to_behind);
    let squared_both = (to_both * to_both - (p.residual + 0.25 * (least_ahead + least_behind))) * inverse_k_squared;
    return FeatureDistances(
        over_triple(squared_ahead / (p.reach + ahead.reach), triple_weights),
        over_triple(squared_behind / (p.reach + behind.reach), triple_weights),
        over_triple(squared_both / (p.reach + 0.25 * (ahead.reach + behind.reach)), triple_weights),
        over_triple(squared_ahead / (p.alone_reach + ahead.alone_reach), triple_weights),
        over_triple(squared_behind / (p.alone_reach + behind.alone_reach), triple_weights),
    );
#else
    // The printed form: the scale of p alone, the full variance of q.
    let squared_ahead = (to_ahead * to_ahead - (p.residual + ahead.residual)) * inverse_k_squared;
    let squared_behind = (to_behind * to_behind - (p.residual + behind.residual)) * inverse_k_squared;
    return FeatureDistances(
        over_triple(squared_ahead / p.reach, triple_weights),
        over_triple(squared_behind / p.reach, triple_weights),
        vec2<f32>(0.0),
        over_triple(squared_ahead / p.alone_reach, triple_weights),
        over_triple(squared_behind / p.alone_reach, triple_weights),
    );
#endif
}

// Planes of the running sums of one pass: five for each of two filters with a colour term, then two for a filter
// without one. Lane 0 of a "lanes" plane belongs to the filter itself, lanes 1 to 3 to the filter with channel 0 to 2
// of the centre pixel perturbed.
const WEIGHT_LANES: i32 = 0;       // Σ w
const LARGEST_LANES: i32 = 1;      // largest w
const MEAN_SUM: i32 = 2;           // Σ w·(u_q − u_p)
const PERTURBED_SUM: i32 = 3;      // Σ w'·(u_q − u_p), channel by channel with the weights perturbed in that channel
const SPREAD_SUM: i32 = 4;         // Σ w·(spread_q − spread_p)
const PLANES_WITH_COLOR: i32 = 5;
// A filter by the features alone has no colour term, so there is nothing to perturb: its Σ w is in the w of MEAN_SUM,
// its largest weight in the w of SPREAD_SUM.
const ALONE_MEAN_SUM: i32 = 10;
const ALONE_SPREAD_SUM: i32 = 11;
const SUM_PLANES: i32 = 12;

// Step of the finite differences: 1 % of the value (thesis 8.4), at least 1 % of the pixel's noise, and at least the
// difference that float32 can resolve. Without these limits the step would vanish at u ≈ 0. The w of the variance is
// the brightness around the pixel.
fn difference_step(u: vec3<f32>, variance_of_mean: vec4<f32>) -> vec3<f32> {
    let size = max(max(0.01 * abs(u), 0.01 * sqrt(variance_of_mean.xyz)),
        vec3<f32>(max(1e-6 * variance_of_mean.w, 1e-18)));
    return select(size, -size, u < vec3<f32>(0.0));
}

// Stein's unbiased risk estimate (eq. 8.5), summed over the channels. Its last term stands for the covariance of noise
// and filtered value and is multiplied by `covariance`. The estimate may be negative.
fn sure(u: vec3<f32>, variance: vec3<f32>, filtered: vec3<f32>, derivative: vec3<f32>, covariance: f32) -> f32 {
    let change = filtered - u;
    return dot(vec3<f32>(1.0), change * change - variance + 2.0 * covariance * variance * derivative);
}

// Amount by which the errors of two filtered values may differ by chance. `apart` is the difference of the values; the
// difference of their errors has a standard deviation of 2·√Σ σ_i²·apart_i².
fn error_by_chance(apart: vec3<f32>, variance: vec3<f32>, sigmas: f32, share_of_noise: f32) -> f32 {
    return 2.0 * sigmas * sqrt(dot(variance, apart * apart)) + share_of_noise * dot(vec3<f32>(1.0), variance);
}
