// Stein's unbiased risk estimate of each candidate (eq. 8.5): Σ_i (F_i − u_i)² − σ_i² + 2κ·σ_i²·dF_i/du_i. It may be
// negative.
// κ is 1 in the formula, for noise whose variance is known. Here a pixel that came out low claims little variance, and
// for that very reason the filter follows it: the product of variance and derivative misses most of the covariance.
#import stein::planes::{pixel_index}
#import stein::candidates::{sure}

const CANDIDATES: i32 = #{CANDIDATES};

struct SureParams {
    extent: vec2<i32>,
    // κ.
    covariance: f32,
}

@group(0) @binding(0) var<uniform> params: SureParams;
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> variance_of_mean: array<vec4<f32>>;
// One plane for each candidate: the mean, and dF_i/du_i per channel.
@group(0) @binding(3) var<storage, read> means: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> derivatives: array<vec4<f32>>;
// One plane for four candidates, one component for each; 0 in components that no candidate has.
@group(0) @binding(5) var<storage, read_write> errors: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let u = signal[at].xyz;
    let variance = variance_of_mean[at].xyz;
    for (var first = 0; first < CANDIDATES; first += 4) {
        var of_each = vec4<f32>(0.0);
        for (var candidate = first; candidate < min(first + 4, CANDIDATES); candidate++) {
            let filtered = means[candidate * pixels + at].xyz;
            let derivative = derivatives[candidate * pixels + at].xyz;
            of_each[candidate - first] = sure(u, variance, filtered, derivative, params.covariance);
        }
        errors[first / 4 * pixels + at] = of_each;
    }
}
