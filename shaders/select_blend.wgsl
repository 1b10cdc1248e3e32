// Averages the candidates by their shares (Algorithm 1 line 33). Without SHARED, there is one candidate, which is the
// average.
#import stein::planes::{pixel_index}

const CANDIDATES: i32 = #{CANDIDATES};

struct SelectBlendParams {
    extent: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: SelectBlendParams;
#ifdef SHARED
// One plane for four candidates, one component for each; they sum to 1.
@group(0) @binding(1) var<storage, read> shares: array<vec4<f32>>;
#endif
// One plane for each candidate: the mean with Σ w in w, and the half spread.
@group(0) @binding(2) var<storage, read> means: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> spreads: array<vec4<f32>>;
// Two planes: mean with the blended Σ w in w, half spread.
@group(0) @binding(4) var<storage, read_write> blended: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
#ifdef SHARED
    var mean = vec4<f32>(0.0);
    var spread = vec4<f32>(0.0);
    for (var candidate = 0; candidate < CANDIDATES; candidate++) {
        let share = shares[candidate / 4 * pixels + at][candidate % 4];
        mean += share * means[candidate * pixels + at];
        spread += share * spreads[candidate * pixels + at];
    }
    blended[at] = mean;
    blended[pixels + at] = spread;
#else
    blended[at] = means[at];
    blended[pixels + at] = spreads[at];
#endif
}
