// Tiles of a frame around which nothing has noise, seen from an image that is a strip of it.
#define_import_path stein::exact

struct ExactParams {
    extent: vec2<i32>,
    // Side of a tile in pixels, and tiles in a row of the frame.
    tile: i32,
    tile_columns: i32,
    // Row of the frame at which the image begins.
    first_row: i32,
    planes: i32,
}

fn tile_index(p: vec2<i32>, params: ExactParams) -> i32 {
    let tile = vec2<i32>(p.x, p.y + params.first_row) / params.tile;
    return tile.y * params.tile_columns + tile.x;
}
