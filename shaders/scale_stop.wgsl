// Binary stopping map of a pair of scales (eq. 6.1): 1 where the step to the coarse scale adds more bias than it
// removes variance, averaged over the channels.
#import stein::planes::{pixel_index}

struct ScaleStopParams {
    extent: vec2<i32>,
    // (r_c² + r_f²) / (r_c² − r_f²): the difference of the squared biases in terms of (c − f)², positive.
    bias_factor: f32,
    // z(γ), the weight of the bias term.
    bias_weight: f32,
}

@group(0) @binding(0) var<uniform> params: ScaleStopParams;
@group(0) @binding(1) var<storage, read> fine: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> fine_variance: array<vec4<f32>>;
// In w the mean number of samples per pixel.
@group(0) @binding(3) var<storage, read> coarse: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> coarse_variance: array<vec4<f32>>;
// x: the map, y: the weighted bias term, summed over the channels.
@group(0) @binding(5) var<storage, read_write> stops: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    // ρ = 1 − 1/n corrects for variances that few samples estimate too low. One sample has no variance, which is no
    // reason to blur. A count of 0 is unknown.
    let count = coarse[at].w;
    let rho = select(1.0, 1.0 - 1.0 / max(count, 2.0), count > 0.0);
    let change = coarse[at].xyz - fine[at].xyz;
    let bias = rho * params.bias_weight * params.bias_factor * dot(change, change);
    let selector = bias + dot(vec3<f32>(1.0), coarse_variance[at].xyz - fine_variance[at].xyz);
    stops[at] = vec4<f32>(select(0.0, 1.0, selector > 0.0), bias, 0.0, 0.0);
}
