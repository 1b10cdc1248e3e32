// Turns the sums of candidate_accumulate into the candidates: filtered mean and half spread, the derivative of each channel, Σ w (thesis 8.4).
#import stein::planes::{pixel_index}
#import stein::nlm::{NlmParams, centre_weight}
#import stein::candidates::{WEIGHT_LANES, LARGEST_LANES, MEAN_SUM, PERTURBED_SUM, SPREAD_SUM, PLANES_WITH_COLOR, THIRD_MEAN_SUM, THIRD_SPREAD_SUM, difference_step}

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> variance_of_mean: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> state: array<vec4<f32>>;
// Two planes each: mean with Σ w in w, half spread.
@group(0) @binding(4) var<storage, read_write> first: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> second: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> third: array<vec4<f32>>;
// Three planes, one per candidate: dF_i/du_i per channel.
@group(0) @binding(7) var<storage, read_write> derivatives: array<vec4<f32>>;

struct Resolved {
    // Filtered value minus the centre's.
    mean: vec3<f32>,
    spread: vec3<f32>,
    derivative: vec3<f32>,
    weight_sum: f32,
}

fn resolve_with_color(base: i32, strip_pixels: i32, at: i32, step: vec3<f32>) -> Resolved {
    let centre = centre_weight(state[(base + LARGEST_LANES) * strip_pixels + at], params.centre_floor);
    let total = state[(base + WEIGHT_LANES) * strip_pixels + at] + centre;
    let mean = state[(base + MEAN_SUM) * strip_pixels + at].xyz / total.x;
    // The perturbed centre differs from the centre by the step.
    let perturbed = (state[(base + PERTURBED_SUM) * strip_pixels + at].xyz + centre.yzw * step) / total.yzw;
    let spread = state[(base + SPREAD_SUM) * strip_pixels + at].xyz / total.x;
    return Resolved(mean, spread, (perturbed - mean) / step, total.x);
}

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
    let strip_pixels = params.rows * params.width;
    let at_state = row * params.width + column;
    let u_p = signal[at_p].xyz;
    let spread_p = signal[pixels + at_p].xyz;
    let step = difference_step(u_p, variance_of_mean[at_p].xyz);

    let of_first = resolve_with_color(0, strip_pixels, at_state, step);
    first[at_p] = vec4<f32>(u_p + of_first.mean, of_first.weight_sum);
    first[pixels + at_p] = vec4<f32>(spread_p + of_first.spread, 0.0);
    derivatives[at_p] = vec4<f32>(of_first.derivative, 0.0);

    let of_second = resolve_with_color(PLANES_WITH_COLOR, strip_pixels, at_state, step);
    second[at_p] = vec4<f32>(u_p + of_second.mean, of_second.weight_sum);
    second[pixels + at_p] = vec4<f32>(spread_p + of_second.spread, 0.0);
    derivatives[pixels + at_p] = vec4<f32>(of_second.derivative, 0.0);

    // Without a colour term the weights do not depend on u(p): dF_i/du_i = w(p, p) / Σ w exactly.
    let third_mean = state[THIRD_MEAN_SUM * strip_pixels + at_state];
    let third_spread = state[THIRD_SPREAD_SUM * strip_pixels + at_state];
    let centre = centre_weight(vec4<f32>(third_spread.w), params.centre_floor).x;
    let total = third_mean.w + centre;
    third[at_p] = vec4<f32>(u_p + third_mean.xyz / total, total);
    third[pixels + at_p] = vec4<f32>(spread_p + third_spread.xyz / total, 0.0);
    derivatives[2 * pixels + at_p] = vec4<f32>(vec3<f32>(centre / total), 0.0);
}
