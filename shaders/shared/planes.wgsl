// A plane holds one vec4 per pixel, row by row from the top; a buffer may hold several planes, one behind the other.
// Channels are in x, y, z; unused components are 0. Neighbours outside the image do not exist: they are loaded from a
// clamped position, so that every load is in bounds, and have the weight 0.
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

// The median of the first `count` values, at least one; of an even number the lower one of the two in the middle.
fn lower_median(values: array<f32, 9>, count: i32) -> f32 {
    var sorted = values;
    for (var next = 1; next < count; next++) {
        let value = sorted[next];
        var place = next;
        while place > 0 && sorted[place - 1] > value {
            sorted[place] = sorted[place - 1];
            place--;
        }
        sorted[place] = value;
    }
    return sorted[(count - 1) / 2];
}
