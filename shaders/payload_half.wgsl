// One half of a payload (thesis 7.1.1): mean + sign · half spread. Where the repair of spikes has narrowed the half
// spread of the colour, it narrows the payload's in the same proportion.
#import stein::planes::{pixel_index}

struct PayloadHalfParams {
    extent: vec2<i32>,
    // Number of planes of the payload.
    planes: i32,
    // 1 for half A, −1 for half B.
    sign: f32,
}

@group(0) @binding(0) var<uniform> params: PayloadHalfParams;
// The payload without spikes.
@group(0) @binding(1) var<storage, read> payload: array<vec4<f32>>;
// Half spread of each plane of the payload, spikes included.
@group(0) @binding(2) var<storage, read> spreads: array<vec4<f32>>;
// The colour before and after the repair of spikes, two planes: the mean, then the half spread.
@group(0) @binding(3) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> signal_repaired: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> half: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let before = signal[pixels + at].xyz;
    let after = signal_repaired[pixels + at].xyz;
    let narrowed = (abs(after) < abs(before));
    let safe = select(vec3<f32>(1.0), before, narrowed);
    // A number that belongs to all channels is narrowed as the channel that is narrowed most.
    let factor = select(vec3<f32>(1.0), after / safe, narrowed);
    let of_all = min(factor.x, min(factor.y, factor.z));
    for (var plane = 0; plane < params.planes; plane++) {
        let spread = spreads[plane * pixels + at];
        let channels = select(spread.xyz, spread.xyz / safe * after, narrowed);
        half[plane * pixels + at] = payload[plane * pixels + at]
            + params.sign * vec4<f32>(channels, spread.w * of_all);
    }
}
