// Gives the filter by the colour only a share of each pixel, as far as its error is significantly less than the error
// of the blend of candidates.
//
// Features without noise have edges of their own, sharp where motion or defocus has blurred the colour. All candidates
// keep to these edges. SURE, averaged over enough pixels, shows where this costs more than the features gain: the mean
// difference is compared with its own standard error.
#import stein::planes::{pixel_index}

struct SelectColorOnlyParams {
    extent: vec2<i32>,
    // Number of independent pixels that the average counts as.
    pixels: f32,
    // Standard errors by which the filter must be better for the least share, and for the whole pixel.
    least: f32,
    most: f32,
    // Planes of shares.
    planes: i32,
}

@group(0) @binding(0) var<uniform> params: SelectColorOnlyParams;
// x: the mean of the differences of SURE, y: the mean of their squares.
@group(0) @binding(1) var<storage, read> differences: array<vec4<f32>>;
// The blend of candidates, a signal, with Σ w in the w of the mean.
@group(0) @binding(2) var<storage, read> candidates: array<vec4<f32>>;
// Mean and half spread of the filter that knows only the colour.
@group(0) @binding(3) var<storage, read> means: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> spreads: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> blended: array<vec4<f32>>;
// Changed in place: the candidates share the rest that the colour leaves.
@group(0) @binding(6) var<storage, read_write> shares: array<vec4<f32>>;
// x: the share of the colour.
@group(0) @binding(7) var<storage, read_write> color_only_shares: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let mean = differences[at].x;
    let standard_error = sqrt(max(differences[at].y - mean * mean, 0.0) / params.pixels);
    let better_by = -mean / max(standard_error, 1e-30);
    let share = clamp((better_by - params.least) / (params.most - params.least), 0.0, 1.0);
    blended[at] = mix(candidates[at], means[at], share);
    blended[pixels + at] = mix(candidates[pixels + at], spreads[at], share);
    for (var plane = 0; plane < params.planes; plane++) {
        shares[plane * pixels + at] = (1.0 - share) * shares[plane * pixels + at];
    }
    color_only_shares[at] = vec4<f32>(share, 0.0, 0.0, 0.0);
}
