// One pixel's window, laid out as an image: a plane holds one vec4 per cell, row by row, and the cell of the neighbour
// p + o lies at o from the middle.
#define_import_path stein::window

struct WindowParams {
    // The pixel p.
    pixel: vec2<i32>,
    // R, the radius of the window: a row has 2R+1 cells.
    radius: i32,
}

fn window_cells(window: WindowParams) -> i32 {
    let side = 2 * window.radius + 1;
    return side * side;
}

fn window_cell(offset: vec2<i32>, window: WindowParams) -> i32 {
    return (offset.y + window.radius) * (2 * window.radius + 1) + offset.x + window.radius;
}
