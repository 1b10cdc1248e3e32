// Difference of a pixel from the mean of its two neighbours, along x and along y: for the colour, and for the features
// that may explain it.
#import stein::planes::{pixel_index}

// Number of features, of three channels each.
const REGRESSORS: i32 = #{REGRESSORS};

struct NoiseHighpassParams {
    extent: vec2<i32>,
    // Groups that hold the features.
    groups: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: NoiseHighpassParams;
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
// Output of noise_magnitude.
@group(0) @binding(2) var<storage, read> relative_spread: array<vec4<f32>>;
#if REGRESSORS != 0
// Output of noise_feature.
@group(0) @binding(3) var<storage, read> features: array<vec4<f32>>;
#endif
// Two planes for the colour, along x and along y, with the magnitude in w; then two planes for each feature.
@group(0) @binding(4) var<storage, read_write> highpass: array<vec4<f32>>;

// The neighbours of p along an axis. At the border one neighbour stands for both; without neighbours, p itself does.
fn neighbours(p: vec2<i32>, axis: vec2<i32>) -> vec2<i32> {
    let has_previous = all(p - axis >= vec2<i32>(0));
    let has_next = all(p + axis < params.extent);
    let next = select(select(p, p - axis, has_previous), p + axis, has_next);
    let previous = select(next, p - axis, has_previous);
    return vec2<i32>(pixel_index(previous, params.extent), pixel_index(next, params.extent));
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    for (var axis = 0; axis < 2; axis++) {
        let beside = neighbours(p, vec2<i32>(1 - axis, axis));
        let difference = signal[at].xyz - 0.5 * (signal[beside.x].xyz + signal[beside.y].xyz);
        highpass[axis * pixels + at] = vec4<f32>(difference, relative_spread[at].w);
#if REGRESSORS != 0
        for (var feature = 0; feature < REGRESSORS; feature++) {
            let plane = 3 * params.groups[feature] * pixels;
            let difference = features[plane + at].xyz - 0.5
                * (features[plane + beside.x].xyz + features[plane + beside.y].xyz);
            highpass[(2 + 2 * feature + axis) * pixels + at] = vec4<f32>(difference, 0.0);
        }
#endif
    }
}
