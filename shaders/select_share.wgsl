// Shares of the candidates in each pixel: their smoothed selection maps, normalised to sum 1 (Algorithm 1 lines 27 to
// 32), with two guards.
//
// Smoothing hands a rejected candidate some weight near the border of its region. Where it is wildly wrong there, as
// THIRD is beside a visible lamp that shares all features with the ceiling, that share would ruin the blend. So a
// candidate takes part in a pixel only where its smoothed error there is comparable to the winner's.
//
// The smoothed errors themselves are blind to single pixels: a clean pixel beside a caustic has neighbours whose errors
// are thousands of times its own. There the pixel's own error decides: its unsmoothed SURE tells two candidates F and G
// apart with a standard deviation of 2·√Σ σ_i²(F_i − G_i)², which vanishes with its noise. A candidate that is worse
// than the best one by many such deviations takes no part.
#import stein::planes::{pixel_index}
#import stein::candidates::{error_by_chance}

struct SelectShareParams {
    extent: vec2<i32>,
    // A candidate takes part where its smoothed error exceeds the winner's by at most smoothed_error·|winner's error| +
    // smoothed_noise·Σ_i σ_i².
    smoothed_error: f32,
    smoothed_noise: f32,
    // And where its own SURE exceeds the least one by at most own_sigmas standard deviations + own_noise·Σ_i σ_i².
    own_sigmas: f32,
    own_noise: f32,
}

@group(0) @binding(0) var<uniform> params: SelectShareParams;
// The binary maps. x: FIRST, y: SECOND, z: THIRD.
@group(0) @binding(1) var<storage, read> selected: array<vec4<f32>>;
#ifdef GUARDED
// SURE, smoothed and as computed.
@group(0) @binding(2) var<storage, read> errors: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> sure: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> variance_of_mean: array<vec4<f32>>;
#ifdef FIRST
@group(0) @binding(5) var<storage, read> first: array<vec4<f32>>;
#endif
#ifdef SECOND
@group(0) @binding(6) var<storage, read> second: array<vec4<f32>>;
#endif
#ifdef THIRD
@group(0) @binding(7) var<storage, read> third: array<vec4<f32>>;
#endif
#endif
// Changed in place: the smoothed maps become the shares.
@group(0) @binding(8) var<storage, read_write> selection: array<vec4<f32>>;

#ifdef GUARDED
fn chance(apart: vec3<f32>, variance: vec3<f32>) -> f32 {
    return error_by_chance(apart, variance, params.own_sigmas, params.own_noise);
}
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    let winner = selected[at].xyz;
    var share = max(selection[at].xyz, vec3<f32>(0.0));
#ifdef GUARDED
    let variance = variance_of_mean[at].xyz;
    let error = errors[at].xyz;
    // The squares of a spike overflow: another candidate than the winner may have an error that is not finite, and 0·∞
    // is no number.
    let least = dot(winner, select(vec3<f32>(0.0), error, winner > vec3<f32>(0.0)));
    let allowed = params.smoothed_error * abs(least) + params.smoothed_noise * dot(vec3<f32>(1.0), variance);
    share = select(vec3<f32>(0.0), share, error - least <= vec3<f32>(allowed));
    // The winner always takes part, at least a little, so that something is left to normalise.
    share = max(share, 1e-6 * winner);

    let own = sure[at].xyz;
    // Candidates that take no part have no share, and their values here do not matter.
    var f = array<vec3<f32>, 3>(vec3<f32>(0.0), vec3<f32>(0.0), vec3<f32>(0.0));
    var best = vec3<f32>(0.0);
    var own_least = 3.4e38;
    var own_winner = vec3<f32>(0.0);
    // On ties the later one is the best, as in the selection.
#ifdef THIRD
    f[2] = third[at].xyz;
    if own.z < own_least {
        best = f[2];
        own_least = own.z;
        own_winner = vec3<f32>(0.0, 0.0, 1.0);
    }
#endif
#ifdef SECOND
    f[1] = second[at].xyz;
    if own.y < own_least {
        best = f[1];
        own_least = own.y;
        own_winner = vec3<f32>(0.0, 1.0, 0.0);
    }
#endif
#ifdef FIRST
    f[0] = first[at].xyz;
    if own.x < own_least {
        best = f[0];
        own_least = own.x;
        own_winner = vec3<f32>(1.0, 0.0, 0.0);
    }
#endif
    let by_chance = vec3<f32>(chance(f[0] - best, variance), chance(f[1] - best, variance),
        chance(f[2] - best, variance));
    share = select(vec3<f32>(0.0), share, own - own_least <= by_chance);
    share = max(share, 1e-9 * own_winner);
#endif
    let total = share.x + share.y + share.z;
    share = select(winner, share / max(total, 1e-20), total > 1e-20);
    selection[at] = vec4<f32>(share, 0.0);
}
