// Inputs for filtering the two-buffer variance by the sample variance (thesis 7.1.1): spread², and the uncertainty of
// the sample variance.
//
// The source has a sample variance of each half, and their squared difference serves as the variance of the sample
// variance. Files have only the sample variance of all samples. Its variance over the 3×3 pixels around contains noise
// and structure, too, and requires neither the number of samples nor a distribution.
#import stein::planes::{pixel_index}

struct VariancePairParams {
    extent: vec2<i32>,
}

@group(0) @binding(0) var<uniform> params: VariancePairParams;
// Two planes: the mean, then the half spread.
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> sample_variance: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read_write> two_buffer_variance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> uncertainty: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = params.extent;
    let p = vec2<i32>(id.xy);
    if any(p >= extent) {
        return;
    }
    let first = max(p - 1, vec2<i32>(0));
    let last = min(p + 1, extent - 1);
    let members = f32((last.x - first.x + 1) * (last.y - first.y + 1));
    var mean = vec4<f32>(0.0);
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            mean += sample_variance[pixel_index(vec2<i32>(x, y), extent)];
        }
    }
    mean /= members;
    var squares = vec4<f32>(0.0);
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let difference = sample_variance[pixel_index(vec2<i32>(x, y), extent)] - mean;
            squares += difference * difference;
        }
    }
    let at = pixel_index(p, extent);
    let spread = signal[extent.x * extent.y + at];
    two_buffer_variance[at] = vec4<f32>(spread.xyz * spread.xyz, 0.0);
    uncertainty[at] = vec4<f32>(squares.xyz / members, 0.0);
}
