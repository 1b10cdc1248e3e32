//! Light sampling: towards shapes that emit, the sun and the sky.

use std::f32::consts::PI;

use glam::Vec3;

use super::material::{cosine_hemisphere, on_circle};
use super::shape::{Form, Ray, Shape};

/// Light from infinitely far away.
#[derive(Clone, Copy, Debug)]
pub struct Environment {
    /// Radiance from straight above.
    pub zenith: Vec3,
    /// Radiance from the horizon and from below it; between them it changes with the sine of the elevation.
    pub horizon: Vec3,
    /// A disc in the sky, on top of the sky's radiance.
    pub sun: Option<Sun>,
}

/// A distant disc.
#[derive(Clone, Copy, Debug)]
pub struct Sun {
    /// Towards the sun; any length.
    pub direction: Vec3,
    /// Half the angle that it spans, in radians: 0 to π/2. The real sun has 0.0047.
    pub radius: f32,
    /// Radiance of the disc.
    pub radiance: Vec3,
}

impl Environment {
    /// Constant radiance from everywhere.
    pub fn constant(radiance: Vec3) -> Self {
        Self { zenith: radiance, horizon: radiance, sun: None }
    }

    /// No light.
    pub fn dark() -> Self {
        Self::constant(Vec3::ZERO)
    }

    pub(super) fn sky(&self, direction: Vec3) -> Vec3 {
        self.horizon.lerp(self.zenith, direction.y.max(0.0))
    }

    /// Returns the sun's radiance from this direction; 0 beside the sun.
    pub(super) fn sun(&self, direction: Vec3) -> Vec3 {
        match &self.sun {
            // Squared chords keep the digits that cosines of small angles lose.
            Some(sun) if direction.distance_squared(sun.direction.normalize()) <= 2.0 * sun.cap_height() => {
                sun.radiance
            }
            _ => Vec3::ZERO,
        }
    }
}

impl Sun {
    fn cap_height(&self) -> f32 {
        2.0 * (self.radius / 2.0).sin().powi(2)
    }
}

/// A light that shadow rays are sent to.
#[derive(Clone, Copy, Debug)]
pub(super) enum Light {
    /// A shape, by its position in the scene's list.
    Shape(usize),
    Sun(Sun),
    Sky,
}

/// A direction towards a light, and its density per solid angle.
pub(super) struct Towards {
    pub(super) direction: Vec3,
    /// Distance within which nothing may be in the way; infinite for sun and sky.
    pub(super) distance: f32,
    pub(super) density: f32,
}

/// Draws a direction from `origin` to the shape's outside; `None` if the outside cannot be seen even with nothing in
/// the way.
pub(super) fn towards_shape(shape: &Shape, origin: Vec3, time: f32, [u, v]: [f32; 2]) -> Option<Towards> {
    let at_rest = shape.at_rest(origin, time);
    match &shape.form {
        Form::Quad(quad) => {
            let to_point = quad.corner + quad.edges[0] * u + quad.edges[1] * v - at_rest;
            let distance = to_point.length();
            let direction = to_point / distance;
            let cosine = -direction.dot(quad.normal);
            (cosine > 0.0).then(|| Towards { direction, distance, density: distance * distance / (cosine * quad.area) })
        }
        Form::Sphere { center, radius } => {
            let height = cap_height(*center - at_rest, *radius)?;
            let direction = in_cap((*center - at_rest).normalize(), height, [u, v]);
            let distance = shape.distance(&Ray { origin, direction, time });
            // At the rim, rounding may miss the sphere; the centre is nearly as far away there.
            let distance = distance.min((*center - at_rest).length());
            Some(Towards { direction, distance, density: cap_density(height) })
        }
        // Boxes emit too, but are found by chance only.
        Form::Block { .. } => None,
    }
}

/// Returns the density of [`towards_shape`] for the direction from `origin` to a point of the shape at `distance`.
pub(super) fn shape_density(shape: &Shape, ray: &Ray, distance: f32) -> f32 {
    match &shape.form {
        Form::Quad(quad) => distance * distance / (ray.direction.dot(quad.normal).abs() * quad.area),
        Form::Sphere { center, radius } => {
            cap_height(*center - shape.at_rest(ray.origin, ray.time), *radius).map_or(0.0, cap_density)
        }
        Form::Block { .. } => 0.0,
    }
}

pub(super) fn towards_sun(sun: &Sun, numbers: [f32; 2]) -> Towards {
    let height = sun.cap_height();
    Towards {
        direction: in_cap(sun.direction.normalize(), height, numbers),
        distance: f32::INFINITY,
        density: cap_density(height),
    }
}

pub(super) fn sun_density(sun: &Sun) -> f32 {
    cap_density(sun.cap_height())
}

/// Draws a direction towards the sky, with a density of cosine/π about the normal: the light of a smooth sky on a
/// diffuse surface has nearly that distribution.
pub(super) fn towards_sky(normal: Vec3, [u, v]: [f32; 2]) -> Towards {
    let local = cosine_hemisphere(u, v);
    let (tangent, bitangent) = normal.any_orthonormal_pair();
    let direction = tangent * local.x + bitangent * local.y + normal * local.z;
    Towards { direction, distance: f32::INFINITY, density: sky_density(normal, direction) }
}

pub(super) fn sky_density(normal: Vec3, direction: Vec3) -> f32 {
    normal.dot(direction).max(0.0) / PI
}

/// Returns the height of the cap of directions in which a sphere is seen from outside: one minus the cosine of half the
/// angle that it spans, with all digits even if the sphere is small. Returns `None` from inside.
fn cap_height(to_center: Vec3, radius: f32) -> Option<f32> {
    let sine_squared = radius * radius / to_center.length_squared();
    (sine_squared < 1.0).then(|| sine_squared / (1.0 + (1.0 - sine_squared).sqrt()))
}

/// Returns the density of uniform directions in a cap.
fn cap_density(height: f32) -> f32 {
    1.0 / (2.0 * PI * height)
}

fn in_cap(axis: Vec3, height: f32, [u, v]: [f32; 2]) -> Vec3 {
    let below = v * height;
    let local = on_circle(u, (below * (2.0 - below)).sqrt());
    let (tangent, bitangent) = axis.any_orthonormal_pair();
    (tangent * local.x + bitangent * local.y + axis * (1.0 - below)).normalize()
}
