// Difference by which SURE (eq. 8.5) of one more filter exceeds SURE of a blend of candidates, and its square. Averaged
// over the pixels around, both serve to decide between the filter and the blend. The derivative of the blend is the sum
// of its candidates' derivatives, weighted by their shares.
#import stein::planes::{pixel_index}
#import stein::candidates::{sure}

const CANDIDATES: i32 = #{CANDIDATES};

struct ErrorDifferenceParams {
    extent: vec2<i32>,
    // Factor of the last term of SURE.
    covariance: f32,
}

// Limit on the differences, because their squares are summed.
const LARGEST: f32 = 1e15;
const ROUNDING: f32 = 1e-5;

@group(0) @binding(0) var<uniform> params: ErrorDifferenceParams;
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> variance_of_mean: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> blended: array<vec4<f32>>;
// One plane for four candidates, one component for each; they sum to 1.
@group(0) @binding(4) var<storage, read> shares: array<vec4<f32>>;
// One plane for each candidate: dF_i/du_i per channel.
@group(0) @binding(5) var<storage, read> derivatives: array<vec4<f32>>;
// Mean and derivatives of the other filter.
@group(0) @binding(6) var<storage, read> other_means: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> other_derivatives: array<vec4<f32>>;
// x: the difference, y: its square.
@group(0) @binding(8) var<storage, read_write> differences: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    var derivative = vec3<f32>(0.0);
    for (var candidate = 0; candidate < CANDIDATES; candidate++) {
        let share = shares[candidate / 4 * pixels + at][candidate % 4];
        // A candidate that takes no part may hold anything.
        if share > 0.0 {
            derivative += share * derivatives[candidate * pixels + at].xyz;
        }
    }
    let u = signal[at].xyz;
    let variance = variance_of_mean[at].xyz;
    let of_blend = sure(u, variance, blended[at].xyz, derivative, params.covariance);
    let of_other = sure(u, variance, other_means[at].xyz, other_derivatives[at].xyz, params.covariance);
    // Two sums that differ only by rounding say nothing, however large they are.
    let terms = abs(of_other) + abs(of_blend) + dot(variance, vec3<f32>(1.0));
    let apart = of_other - of_blend;
    let difference = select(0.0, clamp(apart, -LARGEST, LARGEST), abs(apart) > ROUNDING * terms);
    differences[at] = vec4<f32>(difference, difference * difference, 0.0, 0.0);
}
