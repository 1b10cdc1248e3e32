// Stein's unbiased risk estimate of each candidate (eq. 8.5): Σ_i (F_i − u_i)² − σ_i² + 2κ·σ_i²·dF_i/du_i. x: FIRST, y:
// SECOND, z: THIRD; 0 for candidates that take no part. It may be negative.
//
// κ is 1 by the book, for noise whose variance is known. Here a pixel that came out low claims little variance, and for
// that very reason the filter follows it: the product of the two misses most of their covariance.
#import stein::planes::{pixel_index}
#import stein::candidates::{sure}

struct SureParams {
    extent: vec2<i32>,
    // κ.
    covariance: f32,
}

@group(0) @binding(0) var<uniform> params: SureParams;
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> variance_of_mean: array<vec4<f32>>;
#ifdef FIRST
@group(0) @binding(3) var<storage, read> first: array<vec4<f32>>;
#endif
#ifdef SECOND
@group(0) @binding(4) var<storage, read> second: array<vec4<f32>>;
#endif
#ifdef THIRD
@group(0) @binding(5) var<storage, read> third: array<vec4<f32>>;
#endif
@group(0) @binding(6) var<storage, read> derivatives: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> errors: array<vec4<f32>>;

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
    var of_each = vec4<f32>(0.0);
#ifdef FIRST
    of_each.x = sure(u, variance, first[at].xyz, derivatives[at].xyz, params.covariance);
#endif
#ifdef SECOND
    of_each.y = sure(u, variance, second[at].xyz, derivatives[pixels + at].xyz, params.covariance);
#endif
#ifdef THIRD
    of_each.z = sure(u, variance, third[at].xyz, derivatives[2 * pixels + at].xyz, params.covariance);
#endif
    errors[at] = of_each;
}
