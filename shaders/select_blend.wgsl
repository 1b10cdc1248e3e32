// Averages the candidates by their shares (Algorithm 1 line 33).
#import stein::planes::{pixel_index}

struct SelectBlendParams {
    extent: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: SelectBlendParams;
// x: FIRST, y: SECOND, z: THIRD; they sum to 1.
@group(0) @binding(1) var<storage, read> shares: array<vec4<f32>>;
#ifdef FIRST
@group(0) @binding(2) var<storage, read> first: array<vec4<f32>>;
#endif
#ifdef SECOND
@group(0) @binding(3) var<storage, read> second: array<vec4<f32>>;
#endif
#ifdef THIRD
@group(0) @binding(4) var<storage, read> third: array<vec4<f32>>;
#endif
// Two planes: mean with the blended Σ w in w, half spread.
@group(0) @binding(5) var<storage, read_write> blended: array<vec4<f32>>;

// Average of the candidates at the index `at` of a signal.
fn average(share: vec4<f32>, at: i32) -> vec4<f32> {
    var sum = vec4<f32>(0.0);
#ifdef FIRST
    sum += share.x * first[at];
#endif
#ifdef SECOND
    sum += share.y * second[at];
#endif
#ifdef THIRD
    sum += share.z * third[at];
#endif
    return sum;
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let share = shares[at];
    blended[at] = average(share, at);
    blended[pixels + at] = average(share, pixels + at);
}
