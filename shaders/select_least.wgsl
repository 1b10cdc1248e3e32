// Binary selection maps (Algorithm 1 lines 24–26, with the typo of line 26 corrected): 1 for the candidate with the
// least smoothed error, 0 for the others.
//
// On ties the later, more robust candidate wins. A candidate may have a rival: the candidate may win only where it
// filters more than the rival, that is, where its mean derivative is smaller (thesis 8.4). In Algorithm 1, SECOND is
// the rival of FIRST, because SURE does not notice noise that FIRST keeps. An error that is not finite cannot win; if
// no error can win, the last candidate wins.
#import stein::planes::{pixel_index}

const CANDIDATES: i32 = #{CANDIDATES};

struct SelectLeastParams {
    extent: vec2<i32>,
    // Index of each candidate's rival, −1 for none.
    rivals: array<vec4<i32>, 2>,
}

@group(0) @binding(0) var<uniform> params: SelectLeastParams;
// Smoothed errors. One plane for four candidates, one component for each.
@group(0) @binding(1) var<storage, read> errors: array<vec4<f32>>;
#ifdef RIVALS
// One plane for each candidate: dF_i/du_i per channel.
@group(0) @binding(2) var<storage, read> derivatives: array<vec4<f32>>;
#endif
// The maps, laid out as the errors.
@group(0) @binding(3) var<storage, read_write> selected: array<vec4<f32>>;

// Tests the bits: a compiler may assume that a comparison never meets NaN.
fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

#ifdef RIVALS
fn derivative_sum(candidate: i32, at: i32) -> f32 {
    return dot(vec3<f32>(1.0), derivatives[candidate * params.extent.x * params.extent.y + at].xyz);
}
#endif

fn filters_more_than_its_rival(candidate: i32, at: i32) -> bool {
#ifdef RIVALS
    let rival = params.rivals[candidate / 4][candidate % 4];
    if rival >= 0 {
        return derivative_sum(candidate, at) < derivative_sum(rival, at);
    }
#endif
    return true;
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    var winner = CANDIDATES - 1;
    var least = 3.4e38;
    for (var candidate = CANDIDATES - 1; candidate >= 0; candidate--) {
        let error = errors[candidate / 4 * pixels + at][candidate % 4];
        if is_finite(error) && error < least && filters_more_than_its_rival(candidate, at) {
            winner = candidate;
            least = error;
        }
    }
    for (var first = 0; first < CANDIDATES; first += 4) {
        selected[first / 4 * pixels + at] = select(vec4<f32>(0.0), vec4<f32>(1.0),
            vec4<i32>(winner - first) == vec4<i32>(0, 1, 2, 3));
    }
}
