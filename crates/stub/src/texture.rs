//! Colours that depend on the position: patterns in space, attached to their shape.

use glam::Vec3;

/// A surface's colour, each channel in [0, 1].
#[derive(Clone, Copy, Debug)]
pub enum Texture {
    /// The same colour everywhere.
    Plain(Vec3),
    /// A function of the position, in the scene's coordinates at time 0.
    Pattern(fn(Vec3) -> Vec3),
}

impl Texture {
    pub(super) fn at(&self, place: Vec3) -> Vec3 {
        match self {
            Self::Plain(color) => *color,
            Self::Pattern(pattern) => pattern(place),
        }
    }
}

/// Returns 0 or 1 on the fields of a board whose unit is 1.
pub(super) fn checker(u: f32, v: f32) -> f32 {
    (u.floor() + v.floor()).rem_euclid(2.0)
}

/// Smooth noise in [0, 1] whose features have the size of 1: random values at whole coordinates, blended by cubics.
pub(super) fn noise(place: Vec3) -> f32 {
    let cell = place.floor();
    let inside = place - cell;
    let weight = inside * inside * (Vec3::splat(3.0) - 2.0 * inside);
    let corner = |x: f32, y: f32, z: f32| lattice(cell + Vec3::new(x, y, z));
    let along_x = |y, z| mix(corner(0.0, y, z), corner(1.0, y, z), weight.x);
    let along_y = |z| mix(along_x(0.0, z), along_x(1.0, z), weight.y);
    mix(along_y(0.0), along_y(1.0), weight.z)
}

/// Noise of several octaves in [0, 1], each half as large and half as strong as the one before.
pub(super) fn turbulence(place: Vec3, octaves: u32) -> f32 {
    let (mut sum, mut total, mut strength, mut scale) = (0.0, 0.0, 1.0, 1.0);
    for _ in 0..octaves {
        sum += strength * noise(place * scale);
        total += strength;
        strength *= 0.5;
        scale *= 2.0;
    }
    sum / total
}

fn mix(a: f32, b: f32, weight: f32) -> f32 {
    a + (b - a) * weight
}

/// A random value in [0, 1) for a point with whole coordinates.
fn lattice(point: Vec3) -> f32 {
    let [x, y, z] = point.to_array().map(|coordinate| coordinate as i32 as u32);
    let mut hash = x.wrapping_mul(0x8da6_b343) ^ y.wrapping_mul(0xd816_3841) ^ z.wrapping_mul(0xcb1a_b31f);
    hash = (hash ^ (hash >> 15)).wrapping_mul(0x2c1b_3c6d);
    hash = (hash ^ (hash >> 12)).wrapping_mul(0x297a_2d39);
    ((hash ^ (hash >> 15)) >> 8) as f32 / (1 << 24) as f32
}
