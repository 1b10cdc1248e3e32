// Puts the number of samples n of each pixel into the w of a signal's mean. A filter averages it along with the colour
// to Σ w·n / Σ w, the samples that contribute to a filtered value (thesis 7.1.2).
#import stein::planes::{pixel_index}

struct SampleAttachParams {
    extent: vec2<i32>,
    // Samples per pixel, used where there is no map of them.
    samples_per_pixel: f32,
}

@group(0) @binding(0) var<uniform> params: SampleAttachParams;
// Two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> with_samples: array<vec4<f32>>;
#ifdef SAMPLES_VARY
@group(0) @binding(3) var<storage, read> samples: array<vec4<f32>>;
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let at = pixel_index(p, params.extent);
    let at_spread = params.extent.x * params.extent.y + at;
#ifdef SAMPLES_VARY
    let count = samples[at].x;
#else
    let count = params.samples_per_pixel;
#endif
    // A rendered pixel has at least one sample, whatever the count says.
    with_samples[at] = vec4<f32>(signal[at].xyz, max(count, 1.0));
    with_samples[at_spread] = vec4<f32>(signal[at_spread].xyz, 0.0);
}
