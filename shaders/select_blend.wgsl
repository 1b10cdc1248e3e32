// Averages the candidates by their shares (Algorithm 1 line 33).
#import stein::planes::{pixel_index}

struct SelectBlendParams {
    extent: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: SelectBlendParams;
// x: FIRST, y: SECOND, z: THIRD; they sum to 1.
@group(0) @binding(1) var<storage, read> shares: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> first: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> second: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> third: array<vec4<f32>>;
// Two planes: mean with the blended Σ w in w, half spread.
@group(0) @binding(5) var<storage, read_write> blended: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let share = shares[at];
    blended[at] = share.x * first[at] + share.y * second[at] + share.z * third[at];
    blended[pixels + at] = share.x * first[pixels + at] + share.y * second[pixels + at] + share.z * third[pixels + at];
}
