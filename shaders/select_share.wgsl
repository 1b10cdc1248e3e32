// Shares of the candidates in each pixel: their smoothed selection maps, normalised to sum 1 (Algorithm 1 lines 27 to
// 32), with two guards.
// Smoothing gives a rejected candidate some weight near the border of its region. Where the candidate is wildly wrong,
// this weight would ruin the blend: THIRD of Algorithm 1 is, for example, beside a visible lamp that has all features
// of the ceiling. So a candidate takes part in a pixel only where its smoothed error is comparable to the error of the
// winner.
//
// The smoothed errors cannot tell single pixels apart: a clean pixel beside a caustic has neighbours whose errors are
// thousands of times its own. There the pixel's own error decides. Its unsmoothed SURE tells two candidates F and G
// apart with a standard deviation of 2·√Σ σ_i²(F_i − G_i)², which vanishes with the noise of the pixel. A candidate
// that is worse than the best one by many such deviations takes no part.
#import stein::planes::{pixel_index}
#import stein::candidates::{error_by_chance}

const CANDIDATES: i32 = #{CANDIDATES};

struct SelectShareParams {
    extent: vec2<i32>,
    // A candidate takes part only where its smoothed error exceeds the winner's by at most smoothed_error·|winner's
    // error| + smoothed_noise·Σ_i σ_i² …
    smoothed_error: f32,
    smoothed_noise: f32,
    // … and where its own SURE exceeds the least one by at most own_sigmas standard deviations + own_noise·Σ_i σ_i².
    own_sigmas: f32,
    own_noise: f32,
}

@group(0) @binding(0) var<uniform> params: SelectShareParams;
// The binary maps. One plane for four candidates, one component for each.
@group(0) @binding(1) var<storage, read> selected: array<vec4<f32>>;
#ifdef GUARDED
// SURE, smoothed and as computed, laid out as the maps.
@group(0) @binding(2) var<storage, read> errors: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> sure: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> variance_of_mean: array<vec4<f32>>;
// One plane for each candidate: the mean.
@group(0) @binding(5) var<storage, read> means: array<vec4<f32>>;
#endif
// Changed in place: the smoothed maps become the shares.
@group(0) @binding(6) var<storage, read_write> selection: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    var winner = array<f32, CANDIDATES>();
    var share = array<f32, CANDIDATES>();
    for (var candidate = 0; candidate < CANDIDATES; candidate++) {
        winner[candidate] = selected[candidate / 4 * pixels + at][candidate % 4];
        share[candidate] = max(selection[candidate / 4 * pixels + at][candidate % 4], 0.0);
    }
#ifdef GUARDED
    let variance = variance_of_mean[at].xyz;
    var least = 0.0;
    // On ties the later candidate is the best one, as in the selection.
    var best = vec3<f32>(0.0);
    var own_least = 3.4e38;
    var own_winner = -1;
    for (var candidate = CANDIDATES - 1; candidate >= 0; candidate--) {
        // The error of the winner is selected, not weighted: the squares of a spike overflow, and 0·∞ is no number.
        if winner[candidate] > 0.0 {
            least = errors[candidate / 4 * pixels + at][candidate % 4];
        }
        let own = sure[candidate / 4 * pixels + at][candidate % 4];
        if own < own_least {
            best = means[candidate * pixels + at].xyz;
            own_least = own;
            own_winner = candidate;
        }
    }
    let allowed = params.smoothed_error * abs(least) + params.smoothed_noise * dot(vec3<f32>(1.0), variance);
    for (var candidate = 0; candidate < CANDIDATES; candidate++) {
        let error = errors[candidate / 4 * pixels + at][candidate % 4];
        let own = sure[candidate / 4 * pixels + at][candidate % 4];
        let filtered = means[candidate * pixels + at].xyz;
        let by_chance = error_by_chance(filtered - best, variance, params.own_sigmas, params.own_noise);
        share[candidate] = select(0.0, share[candidate], error - least <= allowed);
        // The winner always takes part, at least a little, so that something is left to normalise.
        share[candidate] = max(share[candidate], 1e-6 * winner[candidate]);
        share[candidate] = select(0.0, share[candidate], own - own_least <= by_chance);
        share[candidate] = max(share[candidate], select(0.0, 1e-9, candidate == own_winner));
    }
#endif
    var total = 0.0;
    for (var candidate = 0; candidate < CANDIDATES; candidate++) {
        total += share[candidate];
    }
    for (var first = 0; first < CANDIDATES; first += 4) {
        var shares = vec4<f32>(0.0);
        for (var candidate = first; candidate < min(first + 4, CANDIDATES); candidate++) {
            shares[candidate - first] = select(winner[candidate], share[candidate] / max(total, 1e-20), total > 1e-20);
        }
        selection[first / 4 * pixels + at] = shares;
    }
}
