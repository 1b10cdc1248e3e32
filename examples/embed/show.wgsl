// Stands in for a renderer's display: converts a linear colour to a picture.

@group(0) @binding(0) var<storage, read> color: array<vec4<f32>>;
@group(0) @binding(1) var picture: texture_storage_2d<rgba8unorm, write>;

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = textureDimensions(picture);
    if id.x >= extent.x || id.y >= extent.y {
        return;
    }
    let linear = color[id.y * extent.x + id.x].xyz;
    let shown = pow(clamp(linear, vec3<f32>(0.0), vec3<f32>(1.0)), vec3<f32>(1.0 / 2.2));
    textureStore(picture, id.xy, vec4<f32>(shown, 1.0));
}
