//! A thin-lens camera.

use glam::Vec3;

use super::material::on_circle;
use super::shape::Ray;
use stein::image::Extent;

/// Position and lens of the camera. Lengths are in the scene's unit.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    /// Centre of the lens.
    pub eye: Vec3,
    /// A point in the middle of the picture. Up in the picture is y.
    pub target: Vec3,
    /// The picture's height as an angle in radians, below π.
    pub field_of_view: f32,
    /// Radius of the lens; with 0 everything is sharp.
    pub lens_radius: f32,
    /// Distance along the view direction at which things are sharp; above 0.
    pub focus: f32,
}

/// A camera with its axes worked out for an image's extent.
pub(super) struct View {
    eye: Vec3,
    lens_radius: f32,
    /// Top left corner of the picture in the plane of focus; `per_column` and `per_row` lead from pixel to pixel.
    corner: Vec3,
    per_column: Vec3,
    per_row: Vec3,
    right: Vec3,
    down: Vec3,
}

impl View {
    pub(super) fn new(camera: &Camera, extent: Extent) -> Self {
        let forward = (camera.target - camera.eye).normalize();
        let right = forward.cross(Vec3::Y).try_normalize().unwrap_or(Vec3::X);
        let down = forward.cross(right);
        let pixel = 2.0 * (camera.field_of_view / 2.0).tan() * camera.focus / extent.height as f32;
        let corner =
            forward * camera.focus - (right * extent.width as f32 + down * extent.height as f32) * (pixel / 2.0);
        Self {
            eye: camera.eye,
            lens_radius: camera.lens_radius,
            corner,
            per_column: right * pixel,
            per_row: down * pixel,
            right,
            down,
        }
    }

    /// Returns the ray through a point of the picture, in pixels from its top left corner, and through a point of the
    /// lens.
    pub(super) fn ray(&self, x: f32, y: f32, [u, v]: [f32; 2], time: f32) -> Ray {
        let on_lens = on_circle(u, self.lens_radius * v.sqrt());
        let lens = self.right * on_lens.x + self.down * on_lens.y;
        let in_focus = self.corner + self.per_column * x + self.per_row * y;
        Ray { origin: self.eye + lens, direction: (in_focus - lens).normalize(), time }
    }
}
