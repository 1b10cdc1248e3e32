// Averages the candidates by their shares (Algorithm 1 line 33).
#import stein::planes::{pixel_index}

const CANDIDATES: i32 = #{CANDIDATES};

struct SelectBlendParams {
    extent: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: SelectBlendParams;
// One plane for four candidates, one component for each; they sum to 1.
@group(0) @binding(1) var<storage, read> shares: array<vec4<f32>>;
// Two planes for each candidate: mean with Σ w in w, half spread.
@group(0) @binding(2) var<storage, read> candidates: array<vec4<f32>>;
// Two planes: mean with the blended Σ w in w, half spread.
@group(0) @binding(3) var<storage, read_write> blended: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    var mean = vec4<f32>(0.0);
    var spread = vec4<f32>(0.0);
    for (var candidate = 0; candidate < CANDIDATES; candidate++) {
        let share = shares[candidate / 4 * pixels + at][candidate % 4];
        mean += share * candidates[2 * candidate * pixels + at];
        spread += share * candidates[(2 * candidate + 1) * pixels + at];
    }
    blended[at] = mean;
    blended[pixels + at] = spread;
}
