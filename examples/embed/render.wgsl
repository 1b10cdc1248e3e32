// Stands in for a renderer: a lit sphere over a checked floor, with the noise of a few samples per pixel.
//
// Writes the input of the denoiser, one vec4 per pixel and plane:   color   two planes: the mean, then (A − B)/2 of the
// two halves   albedo  two planes of the same kind, in the unit range   noise   one plane: the variance of the mean,
// s²/n

struct Params {
    width: u32,
    height: u32,
    // Samples per pixel of each half; at least 2.
    samples: u32,
    frame: u32,
}

@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> color: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> albedo: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> noise: array<vec4<f32>>;

// PCG: one random number in [0, 1) for each state.
fn random(state: ptr<function, u32>) -> f32 {
    *state = *state * 747796405u + 2891336453u;
    let word = ((*state >> ((*state >> 28u) + 4u)) ^ *state) * 277803737u;
    return f32((word >> 22u) ^ word) / 4294967296.0;
}

struct Surface {
    albedo: vec3<f32>,
    radiance: vec3<f32>,
}

fn surface(at: vec2<f32>) -> Surface {
    let from_centre = (at - vec2<f32>(0.5, 0.45)) / 0.3;
    let squared = dot(from_centre, from_centre);
    if squared < 1.0 {
        let normal = vec3<f32>(from_centre.x, -from_centre.y, sqrt(1.0 - squared));
        let cosine = max(dot(normal, normalize(vec3<f32>(-1.0, 1.5, 1.0))), 0.0);
        let paint = vec3<f32>(0.8, 0.4, 0.2);
        return Surface(paint, paint * (0.3 + 2.0 * cosine));
    }
    let square = (i32(floor(8.0 * at.x)) + i32(floor(8.0 * at.y))) & 1;
    let paint = select(vec3<f32>(0.2), vec3<f32>(0.8), square == 1);
    return Surface(paint, paint * (0.5 + at.y));
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.width || id.y >= params.height {
        return;
    }
    let pixels = params.width * params.height;
    let pixel = id.y * params.width + id.x;
    let extent = vec2<f32>(f32(params.width), f32(params.height));
    var state = pixel + 7919u * params.frame;
    var colors = array<vec3<f32>, 2>(vec3<f32>(0.0), vec3<f32>(0.0));
    var albedos = colors;
    var squares = vec3<f32>(0.0);
    for (var half = 0; half < 2; half++) {
        for (var sample = 0u; sample < params.samples; sample++) {
            let jitter = vec2<f32>(random(&state), random(&state));
            let found = surface((vec2<f32>(id.xy) + jitter) / extent);
            // Light that only some of the paths find.
            let value = found.radiance * -log(1.0 - random(&state));
            colors[half] += value;
            albedos[half] += found.albedo;
            squares += value * value;
        }
    }
    let n = f32(params.samples);
    let mean = (colors[0] + colors[1]) / (2.0 * n);
    color[pixel] = vec4<f32>(mean, 0.0);
    color[pixels + pixel] = vec4<f32>((colors[0] - colors[1]) / (2.0 * n), 0.0);
    albedo[pixel] = vec4<f32>((albedos[0] + albedos[1]) / (2.0 * n), 0.0);
    albedo[pixels + pixel] = vec4<f32>((albedos[0] - albedos[1]) / (2.0 * n), 0.0);
    let variance = max(squares / (2.0 * n) - mean * mean, vec3<f32>(0.0)) / (2.0 * n - 1.0);
    noise[pixel] = vec4<f32>(variance, 0.0);
}
