//! The built-in scenes, each stressing one thing.

use glam::Vec3;

use super::camera::Camera;
use super::light::{Environment, Sun};
use super::material::Material;
use super::scene::Scene;
use super::shape::Shape;
use super::texture::{Texture, checker, noise, turbulence};

/// Name, description and construction.
type Entry = (&'static str, &'static str, fn() -> Scene);

const SCENES: [Entry; 6] = [
    ("soft", "a room lit through a window: nearly all light is indirect", soft),
    ("dof", "spheres on a finely tiled floor, most of it out of focus", dof),
    ("motion", "moving balls and boxes over a striped floor: motion blur", motion),
    ("caustic", "a glass ball and a mirror over a matte floor: light focused through them", caustic),
    ("texture", "fine procedural textures under an even sky: detail that is no noise", texture),
    ("spikes", "a small bright lamp beside polished metal: rare paths that carry much light", spikes),
];

/// Returns the scene with this name.
pub fn scene(name: &str) -> Option<Scene> {
    SCENES.iter().find(|(known, ..)| *known == name).map(|(_, _, build)| build())
}

/// Names and one-line descriptions of all scenes.
pub fn scenes() -> impl ExactSizeIterator<Item = (&'static str, &'static str)> {
    SCENES.iter().map(|(name, description, _)| (*name, *description))
}

fn diffuse(r: f32, g: f32, b: f32) -> Material {
    Material::Diffuse(Texture::Plain(Vec3::new(r, g, b)))
}

fn metal(reflectance: Vec3, roughness: f32) -> Material {
    Material::Glossy { base: Texture::Plain(Vec3::ZERO), reflectance, roughness }
}

fn plastic(base: Texture, roughness: f32) -> Material {
    Material::Glossy { base, reflectance: Vec3::splat(0.04), roughness }
}

fn pinhole(eye: Vec3, target: Vec3, field_of_view: f32) -> Camera {
    Camera { eye, target, field_of_view, lens_radius: 0.0, focus: 1.0 }
}

/// A horizontal square about the origin, facing up.
fn floor(size: f32, material: Material) -> (Shape, Material) {
    let half = size / 2.0;
    (Shape::quad(Vec3::new(-half, 0.0, -half), Vec3::Z * size, Vec3::X * size), material)
}

/// A room of 4 × 3 × 6, seen from its back wall; sun and sky come in by a window in the left wall, out of the picture.
fn soft() -> Scene {
    let sun =
        Sun { direction: Vec3::new(-0.8, 0.62, 0.15), radius: 0.03, radiance: Vec3::new(1.0, 0.86, 0.66) * 7000.0 };
    let environment = Environment {
        zenith: Vec3::new(0.5, 0.7, 1.0) * 12.0,
        horizon: Vec3::new(0.9, 0.95, 1.0) * 8.0,
        sun: Some(sun),
    };
    let camera = pinhole(Vec3::new(0.3, 1.5, 2.8), Vec3::new(-0.1, 1.15, -3.0), 0.95);
    let wall = diffuse(0.75, 0.72, 0.68);
    let boards = |place: Vec3| {
        let board = (place.x * 5.0).floor();
        let grain = turbulence(Vec3::new(place.x * 40.0, board * 7.0, place.z * 2.5), 3);
        Vec3::new(0.46, 0.3, 0.18) * (0.7 + 0.5 * grain)
    };
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    let left = |from_y: f32, to_y: f32, from_z: f32, to_z: f32| {
        Shape::quad(Vec3::new(-2.0, from_y, from_z), y * (to_y - from_y), z * (to_z - from_z))
    };
    Scene::new(camera, environment)
        .with(Shape::quad(Vec3::new(-2.0, 0.0, -3.0), z * 6.0, x * 4.0), Material::Diffuse(Texture::Pattern(boards)))
        .with(Shape::quad(Vec3::new(-2.0, 3.0, -3.0), x * 4.0, z * 6.0), wall)
        .with(Shape::quad(Vec3::new(-2.0, 0.0, -3.0), x * 4.0, y * 3.0), wall)
        .with(Shape::quad(Vec3::new(-2.0, 0.0, 3.0), y * 3.0, x * 4.0), wall)
        .with(Shape::quad(Vec3::new(2.0, 0.0, -3.0), z * 6.0, y * 3.0), diffuse(0.62, 0.22, 0.16))
        .with(left(0.0, 1.0, -3.0, 3.0), wall)
        .with(left(2.5, 3.0, -3.0, 3.0), wall)
        .with(left(1.0, 2.5, -3.0, -0.4), wall)
        .with(left(1.0, 2.5, 1.4, 3.0), wall)
        .with(Shape::block(Vec3::new(0.9, 0.4, -1.7), Vec3::new(0.8, 0.8, 0.8), 0.4), diffuse(0.3, 0.42, 0.55))
        .with(Shape::sphere(Vec3::new(0.9, 1.1, -1.7), 0.3), plastic(Texture::Plain(Vec3::new(0.75, 0.6, 0.2)), 0.2))
        .with(Shape::block(Vec3::new(-0.9, 0.75, -2.2), Vec3::new(0.7, 1.5, 0.7), -0.3), diffuse(0.7, 0.7, 0.7))
}

fn dof() -> Scene {
    let tiles = |place: Vec3| {
        let shade = checker(place.x * 4.0, place.z * 4.0);
        let grout = (place.x * 8.0).rem_euclid(2.0) < 0.12 || (place.z * 8.0).rem_euclid(2.0) < 0.12;
        let tone = 0.75 + 0.25 * noise(place * 30.0);
        if grout { Vec3::splat(0.25) } else { Vec3::new(0.75, 0.7, 0.6).lerp(Vec3::new(0.15, 0.2, 0.35), shade) * tone }
    };
    let dots = |place: Vec3| {
        let inside = (place * 6.0).fract_gl() - Vec3::splat(0.5);
        if inside.length() < 0.36 { Vec3::new(0.85, 0.75, 0.2) } else { Vec3::new(0.6, 0.08, 0.06) }
    };
    let sun = Sun { direction: Vec3::new(0.5, 0.8, 0.45), radius: 0.05, radiance: Vec3::new(1.0, 0.93, 0.8) * 250.0 };
    let environment =
        Environment { zenith: Vec3::new(0.35, 0.55, 0.95), horizon: Vec3::new(0.85, 0.9, 1.0), sun: Some(sun) };
    let eye = Vec3::new(0.0, 1.3, 4.5);
    let camera = Camera { eye, target: Vec3::new(0.0, 0.45, 0.0), field_of_view: 0.62, lens_radius: 0.13, focus: 4.6 };
    let (ground, tiles) = floor(60.0, Material::Diffuse(Texture::Pattern(tiles)));
    Scene::new(camera, environment)
        .with(ground, tiles)
        .with(Shape::sphere(Vec3::new(0.0, 0.5, 0.0), 0.5), plastic(Texture::Pattern(dots), 0.15))
        .with(Shape::sphere(Vec3::new(-0.95, 0.35, 1.7), 0.35), diffuse(0.2, 0.55, 0.25))
        .with(Shape::sphere(Vec3::new(1.5, 0.6, -2.2), 0.6), metal(Vec3::new(0.95, 0.8, 0.5), 0.3))
        .with(Shape::sphere(Vec3::new(-2.2, 0.8, -4.5), 0.8), diffuse(0.7, 0.3, 0.15))
        .with(Shape::block(Vec3::new(3.4, 1.5, -9.0), Vec3::new(1.2, 3.0, 1.2), 0.5), diffuse(0.6, 0.6, 0.65))
        .with(Shape::sphere(Vec3::new(0.85, 0.22, 2.3), 0.22), diffuse(0.8, 0.6, 0.15))
}

fn motion() -> Scene {
    let stripes = |place: Vec3| {
        let stripe = ((place.x + 0.35 * place.z) * 3.0).rem_euclid(1.0);
        if stripe < 0.5 { Vec3::new(0.8, 0.78, 0.72) } else { Vec3::new(0.28, 0.33, 0.4) }
    };
    let panels = |place: Vec3| {
        if checker(place.x * 5.0, place.y * 5.0 - 0.5) > 0.5 {
            Vec3::new(0.9, 0.85, 0.8)
        } else {
            Vec3::new(0.75, 0.12, 0.08)
        }
    };
    let environment = Environment { zenith: Vec3::new(0.2, 0.3, 0.5), horizon: Vec3::new(0.55, 0.5, 0.45), sun: None };
    let camera = pinhole(Vec3::new(0.0, 2.2, 5.0), Vec3::new(0.0, 0.6, 0.0), 0.66);
    let (ground, stripes) = floor(40.0, Material::Diffuse(Texture::Pattern(stripes)));
    let lamp = Shape::quad(Vec3::new(-2.2, 3.6, 0.6), Vec3::X * 2.0, Vec3::new(0.0, 0.5, 1.8));
    Scene::new(camera, environment)
        .with(ground, stripes)
        .with(lamp, Material::Light(Vec3::new(1.0, 0.9, 0.75) * 9.0))
        .with(
            Shape::sphere(Vec3::new(-1.25, 0.5, 0.8), 0.5).moving(Vec3::new(0.45, 0.0, 0.0)),
            Material::Diffuse(Texture::Pattern(panels)),
        )
        .with(
            Shape::sphere(Vec3::new(1.15, 0.5, 0.1), 0.42).moving(Vec3::new(0.0, 0.5, 0.0)),
            plastic(Texture::Plain(Vec3::new(0.1, 0.3, 0.7)), 0.12),
        )
        .with(
            Shape::block(Vec3::new(0.0, 1.35, -1.2), Vec3::new(0.7, 0.7, 0.7), 0.6).moving(Vec3::new(0.3, -0.35, 0.0)),
            diffuse(0.2, 0.6, 0.3),
        )
        .with(Shape::sphere(Vec3::new(0.35, 0.35, 1.6), 0.35), diffuse(0.8, 0.65, 0.3))
        .with(Shape::block(Vec3::new(-1.7, 0.6, -1.6), Vec3::new(0.8, 1.2, 0.8), 0.3), diffuse(0.65, 0.65, 0.65))
}

fn caustic() -> Scene {
    let camera = pinhole(Vec3::new(0.0, 2.6, 4.6), Vec3::new(0.0, 0.45, 0.1), 0.74);
    let environment = Environment { zenith: Vec3::splat(0.05), horizon: Vec3::splat(0.08), sun: None };
    let (ground, matte) = floor(14.0, diffuse(0.6, 0.58, 0.55));
    let lamp = Shape::quad(Vec3::new(-2.6, 3.4, -1.2), Vec3::new(0.45, 0.55, 0.0), Vec3::Z * 0.7);
    Scene::new(camera, environment)
        .with(ground, matte)
        .with(lamp, Material::Light(Vec3::new(1.0, 0.92, 0.8) * 55.0))
        .with(Shape::sphere(Vec3::new(-0.55, 0.75, 0.3), 0.6), Material::Glass(1.5))
        .with(Shape::sphere(Vec3::new(0.3, 0.3, 1.5), 0.3), Material::Glass(1.5))
        .with(
            Shape::block(Vec3::new(1.35, 0.6, -0.5), Vec3::new(0.08, 1.2, 1.4), 0.5),
            Material::Mirror(Vec3::new(0.95, 0.88, 0.8)),
        )
        .with(Shape::sphere(Vec3::new(-1.6, 0.35, -1.2), 0.35), diffuse(0.25, 0.4, 0.65))
        .with(Shape::quad(Vec3::new(-7.0, 0.0, -2.5), Vec3::X * 14.0, Vec3::Y * 8.0), diffuse(0.5, 0.5, 0.52))
}

fn texture() -> Scene {
    let mosaic = |place: Vec3| {
        let (u, v) = (place.x * 14.0, place.z * 14.0);
        let color = noise(Vec3::new(u.floor() * 0.37, v.floor() * 0.37, 3.0));
        let tile = Vec3::new(0.85, 0.8, 0.65).lerp(Vec3::new(0.1, 0.25, 0.45), color);
        let edge = u.rem_euclid(1.0) < 0.1 || v.rem_euclid(1.0) < 0.1;
        if edge { Vec3::splat(0.12) } else { tile }
    };
    let marble = |place: Vec3| {
        let vein = (place.y * 10.0 + 9.0 * turbulence(place * 4.0, 5)).sin().abs().powf(0.4);
        Vec3::new(0.18, 0.2, 0.24).lerp(Vec3::new(0.88, 0.86, 0.82), vein)
    };
    let weave = |place: Vec3| {
        let (u, v) = (place.x * 30.0, place.y * 30.0);
        let over = if checker(u, v) > 0.5 { u } else { v };
        let thread = 0.6 + 0.4 * (over * std::f32::consts::PI).sin().abs();
        let color = if checker(place.x * 3.0, place.y * 3.0) > 0.5 {
            Vec3::new(0.6, 0.15, 0.12)
        } else {
            Vec3::new(0.75, 0.68, 0.5)
        };
        color * thread
    };
    let rings = |place: Vec3| {
        let ring = (Vec3::new(place.x - 0.7, place.y + 0.1, 0.0).length() * 45.0 + 1.5 * noise(place * 3.0)).sin();
        Vec3::new(0.32, 0.17, 0.07).lerp(Vec3::new(0.72, 0.48, 0.25), 0.5 + 0.5 * ring)
    };
    let pattern = |pattern| Material::Diffuse(Texture::Pattern(pattern));
    let camera = pinhole(Vec3::new(0.0, 1.7, 4.2), Vec3::new(0.1, 0.6, 0.0), 0.72);
    let environment = Environment { zenith: Vec3::splat(1.0), horizon: Vec3::splat(0.85), sun: None };
    let (ground, mosaic) = floor(30.0, pattern(mosaic));
    Scene::new(camera, environment)
        .with(ground, mosaic)
        .with(Shape::sphere(Vec3::new(-0.5, 0.65, 0.2), 0.65), pattern(marble))
        .with(Shape::block(Vec3::new(0.85, 0.45, 0.1), Vec3::new(0.8, 0.9, 0.8), 0.6), pattern(rings))
        .with(Shape::quad(Vec3::new(-4.0, 0.0, -0.9), Vec3::X * 8.0, Vec3::Y * 4.0), pattern(weave))
}

fn spikes() -> Scene {
    let camera = pinhole(Vec3::new(0.0, 1.7, 4.4), Vec3::new(0.1, 0.75, 0.0), 0.72);
    let (ground, matte) = floor(8.0, diffuse(0.55, 0.5, 0.45));
    let wall = diffuse(0.6, 0.6, 0.62);
    Scene::new(camera, Environment { zenith: Vec3::splat(0.03), horizon: Vec3::splat(0.04), sun: None })
        .with(ground, matte)
        .with(Shape::quad(Vec3::new(-4.0, 0.0, -1.8), Vec3::X * 8.0, Vec3::Y * 5.0), wall)
        .with(Shape::sphere(Vec3::new(-0.35, 1.9, 0.2), 0.04), Material::Light(Vec3::new(1.0, 0.85, 0.6) * 700.0))
        .with(Shape::sphere(Vec3::new(-0.9, 0.5, 0.2), 0.5), metal(Vec3::new(0.95, 0.64, 0.54), 0.08))
        .with(Shape::sphere(Vec3::new(0.35, 0.38, 0.9), 0.38), metal(Vec3::splat(0.9), 0.03))
        .with(
            Shape::block(Vec3::new(1.2, 0.6, -0.5), Vec3::new(0.7, 1.2, 0.7), 0.5),
            metal(Vec3::new(0.95, 0.8, 0.45), 0.15),
        )
        .with(Shape::sphere(Vec3::new(0.1, 0.2, 1.7), 0.2), plastic(Texture::Plain(Vec3::new(0.1, 0.35, 0.6)), 0.1))
}
