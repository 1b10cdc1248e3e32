// Writes 1 (ONES) or 0 in exact tiles, which have no noise within the reach of a filter, and leaves the other tiles
// alone: there a filter has weights and derivatives of 1, and no variance is left.
#import stein::planes::{pixel_index}
#import stein::exact::{ExactParams, tile_index}

@group(0) @binding(0) var<uniform> params: ExactParams;
// For each tile of the frame, row by row: 1 for an exact tile, else 0.
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var<storage, read_write> result: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    if tiles[tile_index(p, params)] == 0u {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    for (var plane = 0; plane < params.planes; plane++) {
#ifdef ONES
        result[plane * pixels + at] = vec4<f32>(1.0, 1.0, 1.0, 0.0);
#else
        result[plane * pixels + at] = vec4<f32>(0.0);
#endif
    }
}
