//! The path tracer: unidirectional, with next-event estimation, multiple importance sampling by the power heuristic,
//! and Russian roulette (Veach 1997).

use glam::Vec3;

use super::Transport;
use super::light::{self, Light, Towards};
use super::material::{self, Bounce, Lobes, Scattering};
use super::random::Numbers;
use super::scene::Scene;
use super::shape::Ray;

/// Names of the features, in their order, with the numbers of their channels.
pub(super) const FEATURES: [(&str, usize); 5] =
    [("albedo", 3), ("normal", 3), ("depth", 1), ("visibility", 1), ("caustic", 3)];
/// Number of channels of the colour and all features.
pub(super) const CHANNELS: usize = 14;

/// Largest number of bounces: enough that light caught in glass gets out.
const LONGEST_PATH: usize = 64;
/// Number of bounces before roulette begins.
const SAFE_BOUNCES: usize = 3;

/// Contribution of one sample to its pixel.
pub(super) struct Sample {
    color: Vec3,
    /// Albedo of the first hit, as the normal and the depth are; 0 on a miss.
    albedo: Vec3,
    normal: Vec3,
    depth: f32,
    /// Visibility: 1 if the shadow ray of the first vertex that scatters light met nothing, or if there was no such
    /// vertex.
    visibility: f32,
    /// Part of the colour that came from a light by way of mirrors or glass to a surface that scatters it, and from
    /// there without further scattering.
    caustic: Vec3,
}

impl Sample {
    pub(super) fn channels(&self) -> [f32; CHANNELS] {
        let mut channels = [0.0; CHANNELS];
        for (at, vector) in [(0, self.color), (3, self.albedo), (6, self.normal), (11, self.caustic)] {
            vector.write_to_slice(&mut channels[at..]);
        }
        channels[9] = self.depth;
        channels[10] = self.visibility;
        channels
    }
}

/// The last bounce of the path.
#[derive(Clone, Copy)]
enum Last {
    /// No bounce, or one that light sampling cannot imitate.
    Sharp,
    /// A bounce with this density, at a surface of this normal.
    Spread { density: f32, normal: Vec3 },
}

/// A point of a surface, seen from the path.
struct Vertex<'a> {
    point: Vec3,
    /// Normal on the side that the path came from.
    normal: Vec3,
    tangents: (Vec3, Vec3),
    /// Direction back along the path, in the local frame.
    from: Vec3,
    lobes: &'a Lobes,
    time: f32,
}

pub(super) fn trace(scene: &Scene, transport: Transport, mut ray: Ray, numbers: &mut Numbers) -> Sample {
    let mut sample = Sample {
        color: Vec3::ZERO,
        albedo: Vec3::ZERO,
        normal: Vec3::ZERO,
        depth: 0.0,
        visibility: 1.0,
        caustic: Vec3::ZERO,
    };
    let mut throughput = Vec3::ONE;
    let mut last = Last::Sharp;
    let mut spread_bounces = 0;
    for bounce in 0..LONGEST_PATH {
        let is_caustic = spread_bounces == 1 && matches!(last, Last::Sharp);
        let mut arrive = |radiance: Vec3| {
            sample.color += radiance;
            if is_caustic {
                sample.caustic += radiance;
            }
        };
        let Some(hit) = scene.hit(&ray) else {
            arrive(throughput * from_afar(scene, transport, &ray, last));
            break;
        };
        let shape = &scene.shapes[hit.shape];
        let point = ray.origin + ray.direction * hit.distance;
        let at_rest = shape.at_rest(point, ray.time);
        let outward = shape.normal(at_rest);
        let is_outside = ray.direction.dot(outward) < 0.0;
        let normal = if is_outside { outward } else { -outward };
        let scattering = scene.materials[hit.shape].at(at_rest);
        if let Scattering::Light(radiance) = scattering
            && is_outside
        {
            let density = light::shape_density(shape, &ray, hit.distance);
            arrive(throughput * radiance * chance_weight(scene, transport, last, density));
        }
        if bounce == 0 {
            sample.albedo = scattering.albedo();
            sample.normal = normal;
            sample.depth = hit.distance;
        }

        let numbers_of_light = numbers.next_four();
        let numbers_of_bounce = numbers.next_four();
        let choice = numbers_of_bounce[2];
        let tangents = normal.any_orthonormal_pair();
        let from = to_local(-ray.direction, normal, tangents);
        let bounced = match &scattering {
            Scattering::Light(_) => None,
            Scattering::Mirror(reflectance) => {
                Some(Bounce { direction: Vec3::new(-from.x, -from.y, from.z), weight: *reflectance, density: 0.0 })
            }
            Scattering::Glass(index) => {
                // From inside, `normal` points inwards.
                let relative = if is_outside { *index } else { 1.0 / index };
                Some(Bounce { direction: material::glass(relative, from, choice), weight: Vec3::ONE, density: 0.0 })
            }
            Scattering::Spread(lobes) => {
                if transport == Transport::LightSampling && !scene.lights.is_empty() {
                    let vertex = Vertex { point, normal, tangents, from, lobes, time: ray.time };
                    let seen = next_event(scene, &vertex, numbers_of_light);
                    sample.color += throughput * seen.unwrap_or(Vec3::ZERO);
                    if spread_bounces == 0 {
                        sample.visibility = f32::from(u8::from(seen.is_some()));
                    }
                }
                lobes.sample(from, [numbers_of_bounce[0], numbers_of_bounce[1], choice])
            }
        };
        let Some(Bounce { direction, weight, density }) = bounced else { break };
        throughput *= weight;
        last = match scattering {
            Scattering::Spread(_) => {
                spread_bounces += 1;
                Last::Spread { density, normal }
            }
            _ => Last::Sharp,
        };
        if bounce >= SAFE_BOUNCES {
            let survival = throughput.max_element().min(0.95);
            if numbers_of_bounce[3] >= survival {
                break;
            }
            throughput /= survival;
        }
        let side = normal * direction.z.signum();
        ray = Ray {
            origin: leave(point, side),
            direction: to_world(direction, normal, tangents).normalize(),
            time: ray.time,
        };
    }
    sample
}

/// Returns the light from sky and sun along a ray that hits nothing.
fn from_afar(scene: &Scene, transport: Transport, ray: &Ray, last: Last) -> Vec3 {
    let sky_density = match last {
        Last::Sharp => 0.0,
        Last::Spread { normal, .. } => light::sky_density(normal, ray.direction),
    };
    let sky = scene.environment.sky(ray.direction) * chance_weight(scene, transport, last, sky_density);
    match &scene.environment.sun {
        None => sky,
        Some(sun) => {
            sky + scene.environment.sun(ray.direction) * chance_weight(scene, transport, last, light::sun_density(sun))
        }
    }
}

/// Returns the weight of light that a bounce met by chance, if light sampling finds the same direction with
/// `light_density`.
fn chance_weight(scene: &Scene, transport: Transport, last: Last, light_density: f32) -> f32 {
    match (transport, last) {
        (Transport::LightSampling, Last::Spread { density, .. }) => {
            power_heuristic(density, light_density / scene.lights.len() as f32)
        }
        _ => 1.0,
    }
}

/// Returns direct light at a vertex from one light, chosen at random; `None` if the light cannot be seen from there.
fn next_event(scene: &Scene, vertex: &Vertex<'_>, [choice, u, v, _]: [f32; 4]) -> Option<Vec3> {
    let count = scene.lights.len();
    let light = &scene.lights[((choice * count as f32) as usize).min(count - 1)];
    let origin = leave(vertex.point, vertex.normal);
    let Towards { direction, distance, density } = match light {
        Light::Shape(shape) => light::towards_shape(&scene.shapes[*shape], origin, vertex.time, [u, v])?,
        Light::Sun(sun) => light::towards_sun(sun, [u, v]),
        Light::Sky => light::towards_sky(vertex.normal, [u, v]),
    };
    let to = to_local(direction, vertex.normal, vertex.tangents);
    // The distance is a little shorter, so that the light does not block itself.
    if to.z <= 0.0 || scene.blocks(&Ray { origin, direction, time: vertex.time }, distance * 0.9995) {
        return None;
    }
    let radiance = match light {
        Light::Shape(shape) => match scene.materials[*shape] {
            super::Material::Light(radiance) => radiance,
            _ => Vec3::ZERO,
        },
        Light::Sun(sun) => sun.radiance,
        Light::Sky => scene.environment.sky(direction),
    };
    let density = density / count as f32;
    let (value, bounce_density) = vertex.lobes.evaluate(vertex.from, to);
    Some(value * radiance * (power_heuristic(density, bounce_density) / density))
}

/// Returns the weight of a direction found with density `own` that another technique finds with density `other`.
/// Densities may be infinite, as for a direction along the edge of a light.
fn power_heuristic(own: f32, other: f32) -> f32 {
    if own.is_infinite() {
        return 1.0;
    }
    let ratio = other / own;
    1.0 / (1.0 + ratio * ratio)
}

/// Returns a point so far off the surface that rounding does not put it back on or behind the surface.
fn leave(point: Vec3, side: Vec3) -> Vec3 {
    point + side * (1e-4 * point.abs().max_element().max(1.0))
}

fn to_local(direction: Vec3, normal: Vec3, (tangent, bitangent): (Vec3, Vec3)) -> Vec3 {
    Vec3::new(direction.dot(tangent), direction.dot(bitangent), direction.dot(normal))
}

fn to_world(direction: Vec3, normal: Vec3, (tangent, bitangent): (Vec3, Vec3)) -> Vec3 {
    tangent * direction.x + bitangent * direction.y + normal * direction.z
}
