// Averages the candidates by their smoothed selection maps (Algorithm 1 line 33), with a guard.
//
// Smoothing hands a rejected candidate some weight near the border of its region. Where it is wildly wrong there, as THIRD is beside a visible lamp that shares all
// features with the ceiling, that share would ruin the blend. So a candidate takes part in a pixel only where its own error there is comparable to the winner's.
#import stein::planes::{pixel_index}

struct SelectBlendParams {
    extent: vec2<i32>,
    // A candidate takes part where its error exceeds the winner's by at most guard_error·|winner's error| + guard_noise·Σ_i σ_i². Negative: no guard.
    guard_error: f32,
    guard_noise: f32,
}

@group(0) @binding(0) var<uniform> params: SelectBlendParams;
// Smoothed binary maps, the binary maps themselves, smoothed errors. x: FIRST, y: SECOND, z: THIRD.
@group(0) @binding(1) var<storage, read> smoothed: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> selected: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> errors: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> variance_of_mean: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> first: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> second: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> third: array<vec4<f32>>;
// Shares of the candidates, sum 1; w: blended error Σ share·error.
@group(0) @binding(8) var<storage, read_write> selection: array<vec4<f32>>;
// Two planes: mean with the blended Σ w in w, half spread.
@group(0) @binding(9) var<storage, read_write> blended: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let error = errors[at].xyz;
    let winner = selected[at].xyz;
    var share = max(smoothed[at].xyz, vec3<f32>(0.0));
    if params.guard_error >= 0.0 {
        let least = dot(winner, error);
        let allowed = params.guard_error * abs(least) + params.guard_noise * dot(vec3<f32>(1.0), variance_of_mean[at].xyz);
        // The winner always takes part, with a little at the least, so that something is left to normalise.
        share = select(vec3<f32>(0.0), share, error - least <= vec3<f32>(allowed));
        share = max(share, 1e-6 * winner);
    }
    let total = share.x + share.y + share.z;
    share = select(winner, share / max(total, 1e-20), total > 1e-20);
    selection[at] = vec4<f32>(share, dot(share, error));
    blended[at] = share.x * first[at] + share.y * second[at] + share.z * third[at];
    blended[pixels + at] = share.x * first[pixels + at] + share.y * second[pixels + at] + share.z * third[pixels + at];
}
