// Takes spikes out of a payload as spike_find takes them out of the colour: in the pixels where the colour has a spike,
// or a light of few pixels, the payload becomes the mean of the neighbours whose mean the colour became.
//
// With SPREAD, also computes the amount that one of the pixels around gets from a spike, as spike_share does.
#import stein::planes::{pixel_index}
#import stein::spike::{brightness}
#import stein::spike_kind::{params, is_like}

const PLANES: i32 = #{PLANES};

// The colour as spike_find has seen it.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
// Three planes. First: in x, y, z the amount taken from the colour, in w the part of it that others get. Third: in y
// the number of pixels that get a part, in z the brightness of the brightest neighbour that counts.
@group(0) @binding(3) var<storage, read> spikes: array<vec4<f32>>;
// The second plane has 1 in w for a light of few pixels.
@group(0) @binding(4) var<storage, read> lights: array<vec4<f32>>;
// PLANES planes. Channels in x, y, z belong to the channels of the colour; w belongs to all of them.
@group(0) @binding(5) var<storage, read> payload: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> repaired: array<vec4<f32>>;
#ifdef SPREAD
@group(0) @binding(7) var<storage, read_write> shares: array<vec4<f32>>;
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let pixels = extent.x * extent.y;
    let at_p = pixel_index(p, extent);
    let taken = spikes[at_p].xyz;
    let is_spike = any(taken != vec3<f32>(0.0));
    let is_light = lights[pixels + at_p].w != 0.0;
    var levels: array<vec4<f32>, PLANES>;
    if is_spike || is_light {
        let bright = spikes[2 * pixels + at_p].z;
        let first = max(p - params.window_radius, vec2<i32>(0));
        let last = min(p + params.window_radius, extent - 1);
        var members = 0.0;
        for (var y = first.y; y <= last.y; y++) {
            for (var x = first.x; x <= last.x; x++) {
                let at_q = pixel_index(vec2<i32>(x, y), extent);
                if at_q != at_p && brightness(signal[at_q].xyz) <= bright && is_like(at_p, at_q) {
                    for (var plane = 0; plane < PLANES; plane++) {
                        levels[plane] += payload[plane * pixels + at_q];
                    }
                    members += 1.0;
                }
            }
        }
        for (var plane = 0; plane < PLANES; plane++) {
            levels[plane] /= members;
        }
    } else {
        for (var plane = 0; plane < PLANES; plane++) {
            levels[plane] = payload[plane * pixels + at_p];
        }
    }
    for (var plane = 0; plane < PLANES; plane++) {
        repaired[plane * pixels + at_p] = levels[plane];
    }
#ifdef SPREAD
    let part = spikes[at_p].w;
    let members = spikes[2 * pixels + at_p].y;
    // Channels of the colour that got brighter by the repair give nothing to other pixels.
    let gives = vec4<bool>(taken > vec3<f32>(0.0), is_spike) & vec4<bool>(is_spike && members > 0.0);
    for (var plane = 0; plane < PLANES; plane++) {
        let even = (payload[plane * pixels + at_p] - levels[plane]) / max(members, 1e-30);
        shares[plane * pixels + at_p] = select(vec4<f32>(0.0), part * even, gives);
    }
#endif
}
