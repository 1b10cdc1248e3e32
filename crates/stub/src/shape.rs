//! Shapes: spheres, parallelograms and boxes, each of which may move in a straight line while the shutter is open.

use glam::Vec3;

/// A ray, at a time between 0 (shutter opens) and 1 (closes). The direction has length 1.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    pub(super) origin: Vec3,
    pub(super) direction: Vec3,
    pub(super) time: f32,
}

/// A shape at time 0, and its motion.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    pub(super) form: Form,
    /// Displacement from time 0 to time 1.
    pub(super) velocity: Vec3,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Form {
    Sphere { center: Vec3, radius: f32 },
    Quad(Quad),
    Block { center: Vec3, half_size: Vec3, yaw: (f32, f32) },
}

/// A parallelogram, with values prepared for its intersection.
#[derive(Clone, Copy, Debug)]
pub(super) struct Quad {
    pub(super) corner: Vec3,
    pub(super) edges: [Vec3; 2],
    pub(super) normal: Vec3,
    pub(super) area: f32,
    /// Dual vectors of the edges: dotted with a vector from the corner, they give its coordinates along the edges.
    duals: [Vec3; 2],
}

impl Shape {
    /// Creates a sphere. Its light goes outwards.
    pub fn sphere(center: Vec3, radius: f32) -> Self {
        Self::still(Form::Sphere { center, radius })
    }

    /// Creates a parallelogram. Its normal has the direction of `edge_u × edge_v`, and its light goes to that side.
    pub fn quad(corner: Vec3, edge_u: Vec3, edge_v: Vec3) -> Self {
        let cross = edge_u.cross(edge_v);
        let area = cross.length();
        let duals = [edge_v.cross(cross) / area.powi(2), cross.cross(edge_u) / area.powi(2)];
        Self::still(Form::Quad(Quad { corner, edges: [edge_u, edge_v], normal: cross / area, area, duals }))
    }

    /// Creates a box, turned about the vertical (y) through its centre by `yaw` in radians.
    pub fn block(center: Vec3, size: Vec3, yaw: f32) -> Self {
        Self::still(Form::Block { center, half_size: size / 2.0, yaw: yaw.sin_cos() })
    }

    /// Returns the shape, moving by `displacement` while the shutter is open.
    #[must_use]
    pub fn moving(mut self, displacement: Vec3) -> Self {
        self.velocity = displacement;
        self
    }

    fn still(form: Form) -> Self {
        Self { form, velocity: Vec3::ZERO }
    }

    /// Returns the distance to the nearest point that the ray hits, not counting its origin; infinite if there is none.
    pub(super) fn distance(&self, ray: &Ray) -> f32 {
        let origin = ray.origin - self.velocity * ray.time;
        match &self.form {
            Form::Sphere { center, radius } => sphere_distance(*center - origin, ray.direction, *radius),
            Form::Quad(quad) => quad.distance(origin, ray.direction),
            Form::Block { center, half_size, yaw } => {
                block_distance(turn(origin - *center, *yaw), turn(ray.direction, *yaw), *half_size)
            }
        }
    }

    /// Returns where a point of the shape was at time 0.
    pub(super) fn at_rest(&self, point: Vec3, time: f32) -> Vec3 {
        point - self.velocity * time
    }

    /// Returns the outward normal at a point of the surface, in coordinates of time 0.
    pub(super) fn normal(&self, point: Vec3) -> Vec3 {
        match &self.form {
            Form::Sphere { center, radius } => (point - *center) / *radius,
            Form::Quad(quad) => quad.normal,
            Form::Block { center, half_size, yaw } => {
                let inside = turn(point - *center, *yaw) / *half_size;
                let size = inside.abs();
                let axis = if size.x > size.y && size.x > size.z {
                    Vec3::X
                } else if size.y > size.z {
                    Vec3::Y
                } else {
                    Vec3::Z
                };
                turn(axis * inside.signum(), (-yaw.0, yaw.1))
            }
        }
    }
}

impl Quad {
    fn distance(&self, origin: Vec3, direction: Vec3) -> f32 {
        let distance = (self.corner - origin).dot(self.normal) / direction.dot(self.normal);
        let inside = origin + direction * distance - self.corner;
        let [u, v] = self.duals.map(|dual| dual.dot(inside));
        // A ray in the quad's plane gives NaN, for which every comparison is false.
        let hit = distance > 0.0 && (0.0..=1.0).contains(&u) && (0.0..=1.0).contains(&v);
        if hit { distance } else { f32::INFINITY }
    }
}

/// Returns the shortest root of |to_center − t·direction| = radius. The discriminant is taken from the distance between
/// centre and ray, which keeps its digits for large spheres and far origins, unlike b² − c.
fn sphere_distance(to_center: Vec3, direction: Vec3, radius: f32) -> f32 {
    let along = to_center.dot(direction);
    let across = to_center - direction * along;
    let discriminant = radius * radius - across.length_squared();
    if discriminant < 0.0 {
        return f32::INFINITY;
    }
    let half_chord = discriminant.sqrt();
    if along > half_chord {
        along - half_chord
    } else if along > -half_chord {
        along + half_chord
    } else {
        f32::INFINITY
    }
}

/// Returns the distance by the slabs test, in the box's own coordinates.
fn block_distance(origin: Vec3, direction: Vec3, half_size: Vec3) -> f32 {
    let inverse = direction.recip();
    let middle = -origin * inverse;
    let half = half_size * inverse.abs();
    let (enter, leave) = ((middle - half).max_element(), (middle + half).min_element());
    if enter > leave || leave <= 0.0 {
        f32::INFINITY
    } else if enter > 0.0 {
        enter
    } else {
        leave
    }
}

/// Turns about the y axis; `yaw` is sine and cosine.
fn turn(v: Vec3, (sine, cosine): (f32, f32)) -> Vec3 {
    Vec3::new(cosine * v.x - sine * v.z, v.y, sine * v.x + cosine * v.z)
}
