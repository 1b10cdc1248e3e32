// Puts the lights that were set aside back into a filtered signal, at their own pixels.
#import stein::planes::{pixel_index}

struct LightReturnParams {
    extent: vec2<i32>,
    // Component of `errors` that holds the squared error.
    error_component: i32,
}

@group(0) @binding(0) var<uniform> params: LightReturnParams;
// Output of spike_find.
@group(0) @binding(1) var<storage, read> lights: array<vec4<f32>>;
// Signals, two planes each.
@group(0) @binding(2) var<storage, read> filtered: array<vec4<f32>>;
// The w of the half spread becomes 1 for a light, else 0.
@group(0) @binding(3) var<storage, read_write> lit: array<vec4<f32>>;
#ifdef ERROR
// Changed in place: the error of a light is the variance of its input.
@group(0) @binding(4) var<storage, read_write> errors: array<vec4<f32>>;
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let light = lights[at];
    let spread = lights[pixels + at];
    let is_light = spread.w != 0.0;
    lit[at] = select(filtered[at], vec4<f32>(light.xyz, filtered[at].w), is_light);
    lit[pixels + at] = select(vec4<f32>(filtered[pixels + at].xyz, 0.0), vec4<f32>(spread.xyz, 1.0), is_light);
#ifdef ERROR
    if is_light {
        errors[at][params.error_component] = light.w;
    }
#endif
}
