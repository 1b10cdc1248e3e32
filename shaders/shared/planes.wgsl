// A plane holds one vec4 per pixel, row by row from the top; a buffer may hold several planes, one behind the other. Channels sit in x, y, z; unused components are 0.
// Neighbours outside the image do not exist: they are loaded from a clamped position, so that every load is in bounds, and take no weight.
#define_import_path stein::planes

fn inside(p: vec2<i32>, extent: vec2<i32>) -> bool {
    return all(p >= vec2<i32>(0)) && all(p < extent);
}

fn pixel_index(p: vec2<i32>, extent: vec2<i32>) -> i32 {
    return p.y * extent.x + p.x;
}

fn clamped_index(p: vec2<i32>, extent: vec2<i32>) -> i32 {
    return pixel_index(clamp(p, vec2<i32>(0), extent - 1), extent);
}

fn largest_channel(color: vec3<f32>) -> f32 {
    return max(color.x, max(color.y, color.z));
}
