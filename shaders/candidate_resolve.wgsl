// Turns the sums of candidate_accumulate into one of the candidates: filtered mean and half spread, Σ w, and the
// derivative of each channel, if DERIVATIVES is defined (thesis 8.4).
#import stein::planes::{pixel_index}
#import stein::nlm::{NlmParams, centre_weight}
#import stein::candidates::{WEIGHT_LANES, LARGEST_LANES, MEAN_SUM, PERTURBED_SUM, SPREAD_SUM, PLANES_WITH_COLOR,
    ALONE_MEAN_SUM, ALONE_SPREAD_SUM, difference_step}

struct ResolveParams {
    // Sums of the pass to resolve. 0: small patches, 1: large patches.
    sums: i32,
    // Place among the candidates.
    candidate: i32,
}

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<uniform> resolve: ResolveParams;
@group(0) @binding(2) var<storage, read> payload: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> variance_of_mean: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> state: array<vec4<f32>>;
// One plane for each candidate: the mean with Σ w in w, the half spread, and dF_i/du_i per channel.
@group(0) @binding(5) var<storage, read_write> means: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> spreads: array<vec4<f32>>;
#ifdef DERIVATIVES
@group(0) @binding(7) var<storage, read_write> derivatives: array<vec4<f32>>;
#endif

struct Resolved {
    // Filtered value minus the value of the centre.
    mean: vec3<f32>,
    spread: vec3<f32>,
    derivative: vec3<f32>,
    weight_sum: f32,
}

#ifdef FEATURES_ALONE
// Without a colour term the weights do not depend on u(p): dF_i/du_i = w(p, p) / Σ w exactly.
fn resolved(strip_pixels: i32, at: i32, step: vec3<f32>) -> Resolved {
    let mean = state[ALONE_MEAN_SUM * strip_pixels + at];
    let spread = state[ALONE_SPREAD_SUM * strip_pixels + at];
    let centre = centre_weight(vec4<f32>(spread.w), params.centre_floor).x;
    let total = mean.w + centre;
    return Resolved(mean.xyz / total, spread.xyz / total, vec3<f32>(centre / total), total);
}
#else
fn resolved(strip_pixels: i32, at: i32, step: vec3<f32>) -> Resolved {
    let base = resolve.sums * PLANES_WITH_COLOR;
    let centre = centre_weight(state[(base + LARGEST_LANES) * strip_pixels + at], params.centre_floor);
    let total = state[(base + WEIGHT_LANES) * strip_pixels + at] + centre;
    let mean = state[(base + MEAN_SUM) * strip_pixels + at].xyz / total.x;
    let spread = state[(base + SPREAD_SUM) * strip_pixels + at].xyz / total.x;
#ifdef OTHER_GUIDE
    // Weights that come from another image do not depend on u(p) either.
    return Resolved(mean, spread, vec3<f32>(centre.x / total.x), total.x);
#else ifdef DERIVATIVES
    // The perturbed centre differs from the centre by the step.
    let perturbed = (state[(base + PERTURBED_SUM) * strip_pixels + at].xyz + centre.yzw * step) / total.yzw;
    return Resolved(mean, spread, (perturbed - mean) / step, total.x);
#else
    return Resolved(mean, spread, vec3<f32>(0.0), total.x);
#endif
}
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let column = i32(id.x);
    let row = i32(id.y);
    if column >= params.width || row >= params.rows {
        return;
    }
    let p = vec2<i32>(params.first_column + column, params.first_row + row);
    let pixels = extent.x * extent.y;
    let at_p = pixel_index(p, extent);
    let u_p = payload[at_p].xyz;
    let spread_p = payload[pixels + at_p].xyz;
    let of_candidate = resolved(params.rows * params.width, row * params.width + column,
        difference_step(u_p, variance_of_mean[at_p]));
    let at = resolve.candidate * pixels + at_p;
    means[at] = vec4<f32>(u_p + of_candidate.mean, of_candidate.weight_sum);
    spreads[at] = vec4<f32>(spread_p + of_candidate.spread, 0.0);
#ifdef DERIVATIVES
    derivatives[at] = vec4<f32>(of_candidate.derivative, 0.0);
#endif
}
