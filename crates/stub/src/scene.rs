//! The scene: shapes with materials, light from far away, a camera.

use glam::Vec3;

use super::camera::Camera;
use super::light::{Environment, Light};
use super::material::Material;
use super::shape::{Ray, Shape};

/// A scene, built by adding shapes. [`super::scene`] returns the built-in ones by name.
#[derive(Clone, Debug)]
pub struct Scene {
    pub(super) camera: Camera,
    pub(super) environment: Environment,
    pub(super) shapes: Vec<Shape>,
    pub(super) materials: Vec<Material>,
    pub(super) lights: Vec<Light>,
}

/// The point where a ray meets a shape.
pub(super) struct Hit {
    pub(super) shape: usize,
    pub(super) distance: f32,
}

impl Scene {
    /// An empty scene.
    pub fn new(camera: Camera, environment: Environment) -> Self {
        let mut lights = Vec::new();
        if environment.zenith != Vec3::ZERO || environment.horizon != Vec3::ZERO {
            lights.push(Light::Sky);
        }
        lights.extend(environment.sun.map(Light::Sun));
        Self { camera, environment, shapes: Vec::new(), materials: Vec::new(), lights }
    }

    /// Returns the scene with one more shape.
    #[must_use]
    pub fn with(mut self, shape: Shape, material: Material) -> Self {
        if matches!(material, Material::Light(_)) {
            self.lights.push(Light::Shape(self.shapes.len()));
        }
        self.shapes.push(shape);
        self.materials.push(material);
        self
    }

    /// Returns the nearest hit.
    pub(super) fn hit(&self, ray: &Ray) -> Option<Hit> {
        let mut nearest = Hit { shape: 0, distance: f32::INFINITY };
        for (shape, candidate) in self.shapes.iter().enumerate() {
            let distance = candidate.distance(ray);
            if distance < nearest.distance {
                nearest = Hit { shape, distance };
            }
        }
        (nearest.distance < f32::INFINITY).then_some(nearest)
    }

    /// Whether any shape is nearer than `distance`.
    pub(super) fn blocks(&self, ray: &Ray, distance: f32) -> bool {
        self.shapes.iter().any(|shape| shape.distance(ray) < distance)
    }
}
