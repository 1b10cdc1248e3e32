// The weights of one pixel's neighbours as nlm_filter uses them, each with the distance behind it.
//
// Works on the chunk of offsets whose column sums nlm_distance has written, and also nlm_weight if the guide is
// patchwise (PATCHWISE). An invocation computes one pair of neighbours. The cell in the middle is not written: the
// weight of the pixel itself follows from the others.
#import stein::planes::{inside}
#import stein::nlm::{NlmParams, patch_members, weights_from_sums}
#import stein::window::{WindowParams, window_cell}

const PATCH_RADIUS: i32 = #{PATCH_RADIUS};

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<uniform> window: WindowParams;
// Column sums of distances; for a patchwise guide with f more rows above and below.
@group(0) @binding(2) var<storage, read> columns: array<vec3<f32>>;
#ifdef PATCHWISE
@group(0) @binding(3) var<storage, read> weight_columns: array<vec3<f32>>;
#endif
// One plane. x: weight, 0 for a neighbour that does not exist; y: distance; z: weight of the pair alone.
@group(0) @binding(4) var<storage, read_write> cells: array<vec4<f32>>;

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let in_chunk = vec2<i32>(id.xy);
    if any(in_chunk >= params.offsets) {
        return;
    }
    let offset = params.first_offset + in_chunk;
    let p = window.pixel;
    let ahead_inside = inside(p + offset, params.extent);
    let behind_inside = inside(p - offset, params.extent);
    let members = patch_members(p.x, offset.x, params.extent.x, PATCH_RADIUS)
        * patch_members(p.y, offset.y, params.extent.y, PATCH_RADIUS);

    let plane = in_chunk.y * params.offsets.x + in_chunk.x;
    let row = p.y - params.first_row;
    let column = p.x - params.first_column;
#ifdef PATCHWISE
    let margin = PATCH_RADIUS;
#else
    let margin = 0;
#endif
    let at = (plane * (params.rows + 2 * margin) + row + margin) * params.stride + column;
    var patch_sum = vec3<f32>(0.0);
    for (var n = 0; n <= 2 * PATCH_RADIUS; n++) {
        patch_sum += columns[at + n];
    }
    let d = patch_sum * params.inverse_channels / max(members, vec3<f32>(1.0));
    let of_pair = weights_from_sums(patch_sum, members, params.inverse_channels, ahead_inside, behind_inside);
#ifdef PATCHWISE
    let at_weights = (plane * params.rows + row) * params.stride + column;
    var weight_sum = vec2<f32>(0.0);
    for (var n = 0; n <= 2 * PATCH_RADIUS; n++) {
        weight_sum += weight_columns[at_weights + n].xy;
    }
    let weight = select(vec2<f32>(0.0), weight_sum / max(members.xy, vec2<f32>(1.0)),
        vec2<bool>(ahead_inside, behind_inside));
#else
    let weight = of_pair;
#endif
    let kept = select(vec2<f32>(0.0), weight, weight >= vec2<f32>(params.cut));
    cells[window_cell(offset, window)] = vec4<f32>(kept.x, d.x, of_pair.x, 0.0);
    cells[window_cell(-offset, window)] = vec4<f32>(kept.y, d.y, of_pair.y, 0.0);
}
