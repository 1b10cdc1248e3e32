// Averages the candidates of a payload by the shares that the candidates of the colour have, as select_blend does with
// the colour. The filtered layer of a candidate is l_p + Σ w·(l_q − l_p) / Σ w. Without SHARED, there is one candidate,
// which is the average.
#import stein::planes::{pixel_index}

const CANDIDATES: i32 = #{CANDIDATES};
const PLANES: i32 = #{PLANES};

struct PayloadBlendParams {
    extent: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: PayloadBlendParams;
#ifdef SHARED
// One plane for four candidates, one component for each; they sum to 1.
@group(0) @binding(1) var<storage, read> shares: array<vec4<f32>>;
#endif
// One plane for each candidate of the colour; w: Σ w.
@group(0) @binding(2) var<storage, read> means: array<vec4<f32>>;
// PLANES planes.
@group(0) @binding(3) var<storage, read> payload: array<vec4<f32>>;
// PLANES planes for each candidate.
@group(0) @binding(4) var<storage, read> sums: array<vec4<f32>>;
#ifdef FRAMES
// The same over the own frame alone, and a plane for each candidate of the colour in which w is 1 where select_frames
// has left out the frames beside.
@group(0) @binding(5) var<storage, read> sums_alone: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read> spreads: array<vec4<f32>>;
#endif
@group(0) @binding(7) var<storage, read_write> blended: array<vec4<f32>>;

// Filtered layer of a candidate.
fn filtered(candidate: i32, plane: i32, at: i32, pixels: i32) -> vec4<f32> {
    let of_candidate = candidate * pixels + at;
    let at_sum = (candidate * PLANES + plane) * pixels + at;
    var sum = sums[at_sum];
#ifdef FRAMES
    if spreads[of_candidate].w != 0.0 {
        sum = sums_alone[at_sum];
    }
#endif
    return payload[plane * pixels + at] + sum / means[of_candidate].w;
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    for (var plane = 0; plane < PLANES; plane++) {
#ifdef SHARED
        var mean = vec4<f32>(0.0);
        for (var candidate = 0; candidate < CANDIDATES; candidate++) {
            mean += shares[candidate / 4 * pixels + at][candidate % 4] * filtered(candidate, plane, at, pixels);
        }
        blended[plane * pixels + at] = mean;
#else
        blended[plane * pixels + at] = filtered(0, plane, at, pixels);
#endif
    }
}
