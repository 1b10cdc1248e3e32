// Exact tiles: tiles of a frame without noise within the reach of a filter, seen from an image that is a part of the
// frame.
#define_import_path stein::exact

struct ExactParams {
    extent: vec2<i32>,
    // Side of a tile in pixels, and tiles in a row of the frame.
    tile: i32,
    tile_columns: i32,
    // Pixel of the frame at which the image begins.
    first: vec2<i32>,
    // Planes, where the first one is read, and where it is written.
    from_plane: i32,
    to_plane: i32,
    planes: i32,
}

fn tile_index(p: vec2<i32>, params: ExactParams) -> i32 {
    let tile = (p + params.first) / params.tile;
    return tile.y * params.tile_columns + tile.x;
}
