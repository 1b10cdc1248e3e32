//! How surfaces scatter light.

use std::f32::consts::PI;

use glam::Vec3;

use super::texture::Texture;

/// The way in which a surface scatters or emits light.
#[derive(Clone, Copy, Debug)]
pub enum Material {
    /// Lambertian reflection.
    Diffuse(Texture),
    /// A rough reflecting layer over a diffuse base: plastic, or metal where the base is black. GGX microfacets with
    /// Smith's height-correlated masking and Schlick's Fresnel term; light scattered more than once between facets is
    /// lost.
    Glossy {
        /// Albedo of the base.
        base: Texture,
        /// Reflectance at normal incidence, 0 to 1: 0.04 for plastic.
        reflectance: Vec3,
        /// GGX α, 0.01 (nearly a mirror) to 1.
        roughness: f32,
    },
    /// A perfect mirror of this reflectance.
    Mirror(Vec3),
    /// A smooth dielectric in vacuum, with this index of refraction (above 1). Light that passes through it is not
    /// absorbed.
    Glass(f32),
    /// Emits this radiance on its outer side, reflects nothing.
    Light(Vec3),
}

/// A material at one point, with its textures looked up: how it treats the light there.
pub(super) enum Scattering {
    /// Scatters over many directions: the only kind for which lights can be sampled.
    Spread(Lobes),
    Mirror(Vec3),
    Glass(f32),
    Light(Vec3),
}

/// A diffuse lobe, a glossy one, or both.
pub(super) struct Lobes {
    base: Vec3,
    reflectance: Vec3,
    /// Roughness as GGX α; 0 without a glossy lobe.
    roughness: f32,
}

/// A direction in which the path goes on.
pub(super) struct Bounce {
    /// Direction in the local frame, whose z is the normal.
    pub(super) direction: Vec3,
    /// Weight of the direction: BSDF × cosine / density.
    pub(super) weight: Vec3,
    /// Density per solid angle; meaningless for mirrors and glass.
    pub(super) density: f32,
}

impl Material {
    pub(super) fn at(&self, place: Vec3) -> Scattering {
        match self {
            Self::Diffuse(albedo) => {
                Scattering::Spread(Lobes { base: albedo.at(place), reflectance: Vec3::ZERO, roughness: 0.0 })
            }
            Self::Glossy { base, reflectance, roughness } => Scattering::Spread(Lobes {
                base: base.at(place),
                reflectance: *reflectance,
                roughness: roughness.clamp(0.01, 1.0),
            }),
            Self::Mirror(reflectance) => Scattering::Mirror(*reflectance),
            Self::Glass(index) => Scattering::Glass(*index),
            Self::Light(radiance) => Scattering::Light(*radiance),
        }
    }
}

impl Scattering {
    /// Returns roughly the reflected share of white light, for the albedo feature.
    pub(super) fn albedo(&self) -> Vec3 {
        match self {
            Self::Spread(lobes) => (lobes.base + lobes.reflectance).min(Vec3::ONE),
            Self::Mirror(reflectance) => *reflectance,
            Self::Glass(_) => Vec3::ONE,
            Self::Light(_) => Vec3::ZERO,
        }
    }
}

impl Lobes {
    /// Returns BSDF × cosine, and the density with which [`Self::sample`] finds `to`. Both directions lead away from
    /// the surface, in the local frame.
    pub(super) fn evaluate(&self, from: Vec3, to: Vec3) -> (Vec3, f32) {
        if from.z <= 0.0 || to.z <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let diffuse = self.base * (to.z / PI);
        if self.roughness == 0.0 {
            return (diffuse, to.z / PI);
        }
        let half = (from + to).normalize();
        let squared = self.roughness * self.roughness;
        let facets = squared / (PI * (1.0 + half.z * half.z * (squared - 1.0)).powi(2));
        let (shadow_from, shadow_to) = (smith(from.z, squared), smith(to.z, squared));
        let glossy =
            schlick(self.reflectance, from.dot(half)) * (facets / (4.0 * from.z * (1.0 + shadow_from + shadow_to)));
        // Light that the layer reflects does not reach the base, in either direction.
        let through = (Vec3::ONE - schlick(self.reflectance, from.z)) * (Vec3::ONE - schlick(self.reflectance, to.z));
        let share = self.glossy_share(from);
        let density = share * facets / (4.0 * from.z * (1.0 + shadow_from)) + (1.0 - share) * to.z / PI;
        (glossy + diffuse * through, density)
    }

    /// Draws a direction with a density near BSDF × cosine; `None` if the direction would go below the surface.
    pub(super) fn sample(&self, from: Vec3, [u, v, choice]: [f32; 3]) -> Option<Bounce> {
        let direction =
            if choice < self.glossy_share(from) { self.sample_facet(from, u, v) } else { cosine_hemisphere(u, v) };
        let (value, density) = self.evaluate(from, direction);
        (density > 0.0).then(|| Bounce { direction, weight: value / density, density })
    }

    /// Returns the probability of sampling the glossy lobe.
    fn glossy_share(&self, from: Vec3) -> f32 {
        if self.roughness == 0.0 {
            return 0.0;
        }
        let reflected = schlick(self.reflectance, from.z);
        let (glossy, diffuse) = (reflected.element_sum(), ((Vec3::ONE - reflected) * self.base).element_sum());
        if diffuse == 0.0 { 1.0 } else { (glossy / (glossy + diffuse)).clamp(0.1, 0.9) }
    }

    /// Reflects at a facet drawn from those visible, by the spherical cap of Dupuy and Benyoub (2023).
    fn sample_facet(&self, from: Vec3, u: f32, v: f32) -> Vec3 {
        let stretch = Vec3::new(self.roughness, self.roughness, 1.0);
        let view = (from * stretch).normalize();
        let z = (1.0 - v) * (1.0 + view.z) - view.z;
        let cap = on_circle(u, (1.0 - z * z).max(0.0).sqrt()).extend(z);
        let facet = ((cap + view) * stretch).normalize();
        facet * (2.0 * from.dot(facet)) - from
    }
}

/// Returns Smith's Λ for GGX, from the cosine to the normal.
fn smith(cosine: f32, squared_roughness: f32) -> f32 {
    let squared = cosine * cosine;
    ((1.0 + squared_roughness * (1.0 - squared).max(0.0) / squared).sqrt() - 1.0) / 2.0
}

fn schlick(reflectance: Vec3, cosine: f32) -> Vec3 {
    // Without a layer there is no reflection at grazing angles either.
    if reflectance == Vec3::ZERO {
        return Vec3::ZERO;
    }
    reflectance + (Vec3::ONE - reflectance) * (1.0 - cosine.clamp(0.0, 1.0)).powi(5)
}

/// Chooses what light does at a smooth boundary of a dielectric: reflection with the probability of Fresnel's formulas,
/// else refraction. `from` leads away from the surface, in a frame whose normal points outwards. The scaling of
/// radiance inside is left out: it cancels for a camera and lights outside.
pub(super) fn glass(index: f32, from: Vec3, choice: f32) -> Vec3 {
    let mirrored = Vec3::new(-from.x, -from.y, from.z);
    let relative = if from.z > 0.0 { 1.0 / index } else { index };
    let sine_squared = relative * relative * (1.0 - from.z * from.z);
    if sine_squared >= 1.0 {
        return mirrored;
    }
    let (cosine_in, cosine_out) = (from.z.abs(), (1.0 - sine_squared).sqrt());
    let parallel = (cosine_in - relative * cosine_out) / (cosine_in + relative * cosine_out);
    let perpendicular = (relative * cosine_in - cosine_out) / (relative * cosine_in + cosine_out);
    if choice < (parallel * parallel + perpendicular * perpendicular) / 2.0 {
        mirrored
    } else {
        Vec3::new(-relative * from.x, -relative * from.y, -cosine_out * from.z.signum())
    }
}

/// Returns a direction with density cosine/π.
pub(super) fn cosine_hemisphere(u: f32, v: f32) -> Vec3 {
    on_circle(u, v.sqrt()).extend((1.0 - v).sqrt())
}

/// Returns the point of a circle about the origin at `turn` revolutions.
pub(super) fn on_circle(turn: f32, radius: f32) -> glam::Vec2 {
    let (sine, cosine) = (2.0 * PI * turn).sin_cos();
    glam::Vec2::new(radius * cosine, radius * sine)
}
