//! The sampler interface and the stub renderer: sums that add up, light that is conserved, numbers that do not depend
//! on threads or passes.
//!
//! Everything is drawn with fixed seeds, so a test that passes once passes always; where a bound is statistical, it is
//! four standard errors.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::f32::consts::PI;
use std::ops::ControlFlow;
use stein::frame::RawSignal;

use glam::Vec3;
use stein::error::Error;
use stein::frame::SamplesPerPixel;
use stein::sampling::{PixelAccumulator, SampleCounts, Sampler, Samples};
use stein::{Extent, Image};
use stein_exr::{BufferSet, BufferSetRequest};
use stein_stub::{
    Camera, Environment, Material, Scene, Sequence, Shape, StubSampler, Sun, Texture, Transport, scene, scenes,
};

const BOTH: [Sequence; 2] = [Sequence::Random, Sequence::LowDiscrepancy];

fn square(side: u32) -> Extent {
    Extent { width: side, height: side }
}

fn render(scene: Scene, side: u32, samples: u32, seed: u64, sequence: Sequence) -> Samples {
    let counts = SampleCounts::uniform(square(side), samples).unwrap();
    StubSampler::new(scene, square(side), seed, sequence).sample(&counts, None).unwrap()
}

fn plain(value: f32) -> Texture {
    Texture::Plain(Vec3::splat(value))
}

/// A camera at `eye` that sees a very small piece of the world around `target`.
fn spot(eye: Vec3, target: Vec3) -> Camera {
    Camera { eye, target, field_of_view: 1e-3, lens_radius: 0.0, focus: 1.0 }
}

/// Mean over all pixels and channels, and its standard error from the pixels' variances.
fn mean_and_error(raw: &RawSignal) -> (f64, f64) {
    let values = |image: &Image| image.planes.iter().flatten().map(|&value| f64::from(value)).sum::<f64>();
    let count = (raw.mean.channels() * raw.mean.extent.pixels()) as f64;
    // Channels of a pixel are noisy together: at worst, all as one.
    let error = (values(raw.variance_of_mean.as_ref().unwrap()) * raw.mean.channels() as f64).sqrt() / count;
    (values(&raw.mean) / count, error)
}

#[track_caller]
fn assert_mean(raw: &RawSignal, expected: f64) {
    let (mean, error) = mean_and_error(raw);
    assert!((mean - expected).abs() <= 4.0 * error + 1e-5 * expected, "{mean} ± {error}, expected {expected}");
    assert!(error < 0.02 * expected, "too noisy to tell: {mean} ± {error}");
}

/// A floor of albedo 0.5 under this light, seen in the origin: its radiance is half the irradiance over π.
fn irradiance(environment: Environment, light: Option<(Shape, Vec3)>) -> RawSignal {
    let mut scene = Scene::new(spot(Vec3::new(3.0, 1.0, 0.0), Vec3::ZERO), environment).with(
        Shape::quad(Vec3::new(-50.0, 0.0, -50.0), Vec3::Z * 100.0, Vec3::X * 100.0),
        Material::Diffuse(plain(0.5)),
    );
    if let Some((shape, radiance)) = light {
        scene = scene.with(shape, Material::Light(radiance));
    }
    render(scene, 8, 256, 5, Sequence::Random).color()
}

#[test]
fn a_white_surface_vanishes_in_a_white_furnace() {
    let camera =
        Camera { eye: Vec3::new(0.0, 0.0, 4.0), target: Vec3::ZERO, field_of_view: 0.8, lens_radius: 0.0, focus: 4.0 };
    for material in [Material::Diffuse(plain(1.0)), Material::Mirror(Vec3::ONE), Material::Glass(1.5)] {
        for sequence in BOTH {
            let scene =
                Scene::new(camera, Environment::constant(Vec3::ONE)).with(Shape::sphere(Vec3::ZERO, 1.0), material);
            assert_mean(&render(scene, 16, 64, 1, sequence).color(), 1.0);
        }
    }
}

/// The share of light that GGX facets with Smith's height-correlated masking reflect once towards this cosine, by the
/// midpoint rule.
fn albedo_of_facets(cosine: f64, roughness: f64) -> f64 {
    let (cells, squared) = (400, roughness * roughness);
    let smith = |cosine: f64| ((1.0 + squared * (1.0 / (cosine * cosine) - 1.0)).sqrt() - 1.0) / 2.0;
    let mut sum = 0.0;
    for (row, column) in (0..cells).flat_map(|row| (0..cells).map(move |column| (row, column))) {
        let (z, azimuth) = (
            (f64::from(row) + 0.5) / f64::from(cells),
            f64::from(column) / f64::from(cells) * 2.0 * std::f64::consts::PI,
        );
        let half = [
            (1.0 - z * z).sqrt() * azimuth.cos() + (1.0 - cosine * cosine).sqrt(),
            (1.0 - z * z).sqrt() * azimuth.sin(),
            z + cosine,
        ];
        let half_z_squared = half[2].powi(2) / half.iter().map(|x| x * x).sum::<f64>();
        let facets = squared / (std::f64::consts::PI * (1.0 + half_z_squared * (squared - 1.0)).powi(2));
        sum += facets / (4.0 * cosine * (1.0 + smith(cosine) + smith(z)));
    }
    sum * 2.0 * std::f64::consts::PI / f64::from(cells * cells)
}

#[test]
fn rough_metal_and_plastic_in_a_white_furnace_lose_what_theory_says() {
    let eye = Vec3::new(3.0, 4.0, 0.0);
    let furnace = |base, reflectance, roughness| {
        let material = Material::Glossy { base: plain(base), reflectance: Vec3::splat(reflectance), roughness };
        let floor = Shape::quad(Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0);
        render(
            Scene::new(spot(eye, Vec3::ZERO), Environment::constant(Vec3::ONE)).with(floor, material),
            8,
            512,
            2,
            Sequence::Random,
        )
    };
    for roughness in [0.1_f32, 0.4, 0.9] {
        assert_mean(&furnace(0.0, 1.0, roughness).color(), albedo_of_facets(0.8, f64::from(roughness)));
        let (plastic, error) = mean_and_error(&furnace(1.0, 0.04, roughness).color());
        assert!(plastic < 1.0 && plastic > 0.85 && error < 0.01, "roughness {roughness}: {plastic} ± {error}");
    }
}

#[test]
fn a_lamp_gives_what_its_form_factor_says() {
    // A rectangle parallel to the floor, over the origin with a corner at (0.5, 2, 0.25) and the opposite one at (−1,
    // 2, −0.75).
    let lamp = Shape::quad(Vec3::new(-1.0, 2.0, -0.75), Vec3::X * 1.5, Vec3::Z * 1.0);
    let corner = |width: f64, depth: f64| corner_form_factor(width / 2.0, depth / 2.0);
    let form_factor = corner(0.5, 0.25) + corner(1.0, 0.25) + corner(0.5, 0.75) + corner(1.0, 0.75);
    assert_mean(&irradiance(Environment::dark(), Some((lamp, Vec3::splat(4.0)))), 0.5 * 4.0 * form_factor);
    // Turned over, it shines upwards.
    let turned = Shape::quad(Vec3::new(-1.0, 2.0, -0.75), Vec3::Z * 1.0, Vec3::X * 1.5);
    assert_eq!(mean_and_error(&irradiance(Environment::dark(), Some((turned, Vec3::splat(4.0))))), (0.0, 0.0));
}

#[test]
fn a_ball_a_sun_and_a_sky_light_a_floor_as_they_should() {
    // A disc of half angle α, wholly above the horizon at elevation e, has the form factor sin²α·sin e.
    let towards = Vec3::new(1.0, 2.0, -1.5);
    let sine_of_elevation = f64::from(towards.normalize().y);
    let ball = Shape::sphere(towards, 0.4);
    let sine = f64::from(0.4 / towards.length());
    assert_mean(
        &irradiance(Environment::dark(), Some((ball, Vec3::splat(20.0)))),
        0.5 * 20.0 * sine.powi(2) * sine_of_elevation,
    );
    for radius in [0.0047_f32, 0.3] {
        let environment = Environment {
            sun: Some(Sun { direction: towards, radius, radiance: Vec3::splat(20.0) }),
            ..Environment::dark()
        };
        assert_mean(&irradiance(environment, None), 0.5 * 20.0 * f64::from(radius).sin().powi(2) * sine_of_elevation);
    }
    // ∫(h + (z − h)·cos)·cos dω/π = h + ⅔(z − h)
    let environment = Environment { zenith: Vec3::splat(3.0), horizon: Vec3::splat(1.0), sun: None };
    assert_mean(&irradiance(environment, None), 0.5 * (1.0 + 4.0 / 3.0));
}

/// The form factor of a rectangle at height 1, parallel to a floor, that reaches from the zenith this far in two
/// directions.
fn corner_form_factor(a: f64, b: f64) -> f64 {
    let side = |a: f64, b: f64| a / (1.0 + a * a).sqrt() * (b / (1.0 + a * a).sqrt()).atan();
    (side(a, b) + side(b, a)) / (2.0 * std::f64::consts::PI)
}

#[test]
fn a_lamp_in_a_mirror_is_a_caustic() {
    // The lamp at height 1 shines upwards; the floor sees its image at height 5 in a mirror at height 3, and nothing
    // else.
    let lamp = Shape::quad(Vec3::new(2.0, 1.0, 0.0), Vec3::Z * 2.0, Vec3::X * 2.0);
    let mirror = Shape::quad(Vec3::new(-20.0, 3.0, -20.0), Vec3::X * 40.0, Vec3::Z * 40.0);
    let scene = Scene::new(spot(Vec3::new(0.0, 1.0, 3.0), Vec3::ZERO), Environment::dark())
        .with(Shape::quad(Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0), Material::Diffuse(plain(0.5)))
        .with(lamp, Material::Light(Vec3::new(1.0, 2.0, 3.0)))
        .with(mirror, Material::Mirror(Vec3::splat(0.8)));
    let samples = render(scene, 16, 512, 14, Sequence::Random);
    let caustic = samples.features().find(|(name, _)| *name == "caustic").unwrap().1;
    assert_mean(&caustic, 0.5 * 2.0 * 0.8 * (corner_form_factor(0.8, 0.4) - corner_form_factor(0.4, 0.4)));
    // The rest went from the floor to the mirror and back.
    let ratio = mean_and_error(&caustic).0 / mean_and_error(&samples.color()).0;
    assert!((0.95..1.0).contains(&ratio), "{ratio}");
}

#[test]
fn features_say_what_the_first_hit_is() {
    // A floor beside a tall black wall that hides half of the sky; beyond the floor's edge there is nothing.
    let scene = |target| {
        Scene::new(spot(Vec3::new(3.0, 4.0, 0.0), target), Environment::constant(Vec3::ONE))
            .with(
                Shape::quad(Vec3::new(-1.0, 0.0, -1.0), Vec3::Z * 2.0, Vec3::X * 2.0),
                Material::Diffuse(Texture::Plain(Vec3::new(0.2, 0.4, 0.6))),
            )
            .with(
                Shape::quad(Vec3::new(-0.01, 0.0, -900.0), Vec3::Y * 900.0, Vec3::Z * 1800.0),
                Material::Diffuse(plain(0.0)),
            )
    };
    let features = |target| {
        let samples = render(scene(target), 8, 64, 15, Sequence::Random);
        let mean =
            |raw: RawSignal| raw.mean.planes.iter().map(|plane| plane.iter().sum::<f32>() / 64.0).collect::<Vec<_>>();
        samples.features().map(|(name, raw)| (name.to_owned(), mean(raw))).collect::<Vec<_>>()
    };
    let expected = [
        ("albedo", vec![0.2, 0.4, 0.6]),
        ("normal", vec![0.0, 1.0, 0.0]),
        ("depth", vec![5.0]),
        ("visibility", vec![0.5]),
        ("caustic", vec![0.0; 3]),
    ];
    for ((name, found), (expected_name, expected)) in features(Vec3::ZERO).iter().zip(&expected) {
        assert_eq!(name, expected_name);
        assert!(
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 0.02),
            "{name}: {found:?}, not {expected:?}"
        );
    }
    let nothing: Vec<_> = features(Vec3::new(2.0, 0.0, 0.0)).into_iter().map(|(_, values)| values).collect();
    assert_eq!(nothing, [vec![0.0; 3], vec![0.0; 3], vec![0.0], vec![1.0], vec![0.0; 3]]);
}

/// A scene with all kinds of lights and surfaces; the lights are large enough to be hit by chance.
fn everything() -> Scene {
    let camera = Camera {
        eye: Vec3::new(0.0, 1.2, 4.0),
        target: Vec3::new(0.0, 0.6, 0.0),
        field_of_view: 0.8,
        lens_radius: 0.05,
        focus: 4.0,
    };
    let sun = Sun { direction: Vec3::new(1.0, 1.0, 1.0), radius: 0.4, radiance: Vec3::new(2.0, 1.5, 1.0) };
    let environment = Environment { zenith: Vec3::new(0.2, 0.3, 0.5), horizon: Vec3::splat(0.5), sun: Some(sun) };
    let glossy =
        |roughness, base| Material::Glossy { base: plain(base), reflectance: Vec3::new(0.6, 0.3, 0.1), roughness };
    Scene::new(camera, environment)
        .with(Shape::quad(Vec3::new(-5.0, 0.0, -5.0), Vec3::Z * 10.0, Vec3::X * 10.0), Material::Diffuse(plain(0.6)))
        .with(Shape::quad(Vec3::new(-2.0, 2.5, -1.0), Vec3::X * 1.5, Vec3::Z * 1.5), Material::Light(Vec3::splat(3.0)))
        .with(
            Shape::sphere(Vec3::new(1.5, 1.8, 0.0), 0.5).moving(Vec3::X * 0.3),
            Material::Light(Vec3::new(1.0, 2.0, 4.0)),
        )
        .with(Shape::sphere(Vec3::new(-0.7, 0.5, 0.0), 0.5), glossy(0.3, 0.3))
        .with(Shape::block(Vec3::new(0.6, 0.4, -0.5), Vec3::splat(0.8), 0.6), glossy(0.6, 0.0))
        .with(Shape::sphere(Vec3::new(0.2, 0.3, 1.0), 0.3).moving(Vec3::Y * 0.2), Material::Glass(1.5))
}

#[test]
fn light_sampling_and_chance_agree_in_the_mean() {
    let counts = SampleCounts::uniform(square(16), 512).unwrap();
    // With different seeds: otherwise the camera's rays are the same.
    let draw = |transport, seed| {
        StubSampler::new(everything(), square(16), seed, Sequence::Random)
            .with_transport(transport)
            .sample(&counts, None)
            .unwrap()
    };
    let (sampled, chance) = (draw(Transport::LightSampling, 3).color(), draw(Transport::Chance, 4).color());
    let ((a, error_a), (b, error_b)) = (mean_and_error(&sampled), mean_and_error(&chance));
    assert!(error_a < 0.8 * error_b, "light sampling should be less noisy: {error_a} {error_b}");
    assert!((a - b).abs() < 4.0 * error_a.hypot(error_b), "{a} ± {error_a}, {b} ± {error_b}");
    // For each pixel too: the squared difference agrees with the variances.
    let mut ratios = Vec::new();
    for channel in 0..3 {
        let variance = |raw: &RawSignal, pixel: usize| raw.variance_of_mean.as_ref().unwrap().planes[channel][pixel];
        for pixel in 0..256 {
            let difference = sampled.mean.planes[channel][pixel] - chance.mean.planes[channel][pixel];
            ratios.push(difference.powi(2) / (variance(&sampled, pixel) + variance(&chance, pixel)).max(1e-12));
        }
    }
    let mean = ratios.iter().sum::<f32>() / ratios.len() as f32;
    assert!((0.7..1.3).contains(&mean), "squared difference over variance: {mean}");
}

#[test]
fn the_number_of_threads_changes_nothing() {
    for sequence in BOTH {
        let draw = |threads| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap()
                .install(|| render(everything(), 12, 8, 4, sequence))
        };
        let (one, two) = (draw(1), draw(2));
        assert!(one.color() == two.color());
        assert!(one.features().eq(two.features()));
    }
}

#[test]
fn seeds_and_pixels_and_halves_have_their_own_numbers() {
    for sequence in BOTH {
        let (one, other) =
            (render(everything(), 8, 2, 4, sequence).color(), render(everything(), 8, 2, 5, sequence).color());
        assert!(one.mean != other.mean && one.half_a != one.half_b);
    }
}

/// Largest difference between two sets, in units of the values' sizes.
#[track_caller]
fn assert_close(a: &Samples, b: &Samples) {
    assert_eq!(a.counts(), b.counts());
    let close = |name: &str, a: &RawSignal, b: &RawSignal| {
        let images = |raw: &RawSignal| {
            [Some(raw.mean.clone()), raw.half_a.clone(), raw.half_b.clone(), raw.variance_of_mean.clone()]
        };
        for (a, b) in images(a).into_iter().flatten().zip(images(b).into_iter().flatten()) {
            for (a, b) in a.planes.iter().flatten().zip(b.planes.iter().flatten()) {
                let same = (a.is_nan() && b.is_nan()) || (a - b).abs() <= 2e-6 * a.abs().max(b.abs()) + 1e-9;
                assert!(same, "{name}: {a} {b}");
            }
        }
    };
    close("colour", &a.color(), &b.color());
    for ((name, a), (_, b)) in a.features().zip(b.features()) {
        close(name, &a, &b);
    }
}

#[test]
fn four_samples_and_four_more_are_eight() {
    let extent = square(8);
    let (four, eight) = (SampleCounts::uniform(extent, 4).unwrap(), SampleCounts::uniform(extent, 8).unwrap());
    for sequence in BOTH {
        let new = || StubSampler::new(everything(), extent, 6, sequence);
        let whole = new().sample(&eight, None).unwrap();
        let mut sampler = new();
        let mut sum = sampler.sample(&four, None).unwrap();
        sum.merge(&sampler.sample(&four, None).unwrap()).unwrap();
        assert_close(&sum, &whole);
        // Another process goes on where the first one stopped.
        let mut sum = new().sample(&four, None).unwrap();
        let mut continued = new().continue_after(&sum.counts()).unwrap();
        sum.merge(&continued.sample(&four, None).unwrap()).unwrap();
        assert_close(&sum, &whole);
    }
}

#[test]
fn passes_with_other_counts_in_every_pixel_add_up() {
    let extent = Extent { width: 3, height: 2 };
    let first = SampleCounts::from_samples(extent, &[2, 2, 16, 0, 1000, 0]).unwrap();
    let second = SampleCounts::from_samples(extent, &[0, 1000, 4, 6, 2, 0]).unwrap();
    let both = SampleCounts::from_samples(extent, &[2, 1002, 20, 6, 1002, 0]).unwrap();
    let mut sampler = StubSampler::new(everything(), extent, 7, Sequence::Random);
    let mut sum = sampler.sample(&first, None).unwrap();
    sum.merge(&sampler.sample(&second, None).unwrap()).unwrap();
    assert_eq!((sum.counts(), both.total_samples()), (both.clone(), 2032));
    let whole = StubSampler::new(everything(), extent, 7, Sequence::Random).sample(&both, None).unwrap();
    assert_close(&sum, &whole);
}

#[test]
fn a_set_that_went_through_a_file_can_be_continued() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pass.exr");
    let extent = Extent { width: 4, height: 2 };
    for counts in [
        SampleCounts::from_samples(extent, &[2, 1000, 4, 16, 0, 8, 2, 6]).unwrap(),
        SampleCounts::uniform(extent, 4).unwrap(),
    ] {
        let mut sampler = StubSampler::new(everything(), extent, 8, Sequence::LowDiscrepancy);
        let mut direct = sampler.sample(&counts, None).unwrap();
        stein_exr::write_samples(&direct, &path, &[("scene".into(), "everything".into())]).unwrap();
        let set = BufferSet::read(&BufferSetRequest { input: path.clone(), ..Default::default() }).unwrap();
        let mut read = set.to_samples().unwrap();
        assert_eq!(read.feature_names().len(), 5);
        assert_eq!(read.counts(), counts);
        let uniform = counts.pairs().iter().all(|pairs| *pairs == counts.pairs()[0]);
        assert_eq!(matches!(set.samples_per_pixel(), SamplesPerPixel::Uniform(_)), uniform);
        let more =
            sampler.sample(&SampleCounts::from_pairs(extent, vec![1, 1, 500, 0, 0, 2, 3, 4]).unwrap(), None).unwrap();
        direct.merge(&more).unwrap();
        // The file's features come in its own order.
        let by_name = |name: &str| more.features().find(|(found, _)| *found == name).unwrap().1;
        let features = read.feature_names().map(|name| (name.to_owned(), by_name(name))).collect();
        read.merge(&Samples::from_signals(more.color(), features, &more.counts()).unwrap()).unwrap();
        let features = direct
            .feature_names()
            .map(|name| (name.to_owned(), read.features().find(|(found, _)| *found == name).unwrap().1))
            .collect();
        assert_close(&Samples::from_signals(read.color(), features, &read.counts()).unwrap(), &direct);
    }
}

#[test]
fn moments_are_those_of_the_textbook() {
    let pairs = [[1.0, 4.0], [3.0, 5.0], [8.0, 3.0]];
    let extent = square(1);
    let mut accumulator = PixelAccumulator::default();
    for [a, b] in pairs {
        // A large constant must not cost the digits of a small spread.
        accumulator.add_pair([&[a, 0.0, 4096.0 + a], &[b, 0.0, 4096.0 + b]]);
    }
    let mut samples = Samples::none(extent, &[]);
    samples.set(0, &accumulator);
    let raw = samples.color();
    let all = [1.0, 3.0, 8.0, 4.0, 5.0, 3.0];
    let variance = all.iter().map(|x: &f32| (x - 4.0).powi(2)).sum::<f32>() / 30.0;
    let values = |image: &Image| image.planes.iter().map(|plane| plane[0]).collect::<Vec<_>>();
    assert_eq!(values(&raw.mean), [4.0, 0.0, 4100.0]);
    assert_eq!((values(raw.half_a.as_ref().unwrap())[0], values(raw.half_b.as_ref().unwrap())[0]), (4.0, 4.0));
    let found = values(raw.variance_of_mean.as_ref().unwrap());
    assert!(
        (found[0] - variance).abs() < 1e-6 && found[1] == 0.0 && (found[2] - variance).abs() < 1e-6,
        "{found:?} {variance}"
    );
}

/// Mean over pixels of the squared half spread, over the mean of the sample variance.
fn spread_over_variance(samples: &Samples) -> f64 {
    let raw = samples.color();
    let (a, b) = (raw.half_a.unwrap(), raw.half_b.unwrap());
    let spread: f64 =
        a.planes.iter().flatten().zip(b.planes.iter().flatten()).map(|(a, b)| f64::from((a - b) / 2.0).powi(2)).sum();
    spread / raw.variance_of_mean.unwrap().planes.iter().flatten().map(|&value| f64::from(value)).sum::<f64>()
}

#[test]
fn halves_are_independent_and_their_spread_is_the_variance() {
    // 1024 pixels; (A − B)²/4 is the variance times a χ² of one degree, whose standard error is √(2/1024) = 4.4 % of
    // its mean if channels go together and pixels weigh the same, and some more as they do not.
    let random = spread_over_variance(&render(scene("texture").unwrap(), 32, 32, 9, Sequence::Random));
    assert!((random - 1.0).abs() < 0.25, "random: {random}");
    let low_discrepancy = spread_over_variance(&render(scene("texture").unwrap(), 32, 32, 9, Sequence::LowDiscrepancy));
    assert!(
        low_discrepancy < 0.6,
        "the sample variance should overstate that of low-discrepancy points: {low_discrepancy}"
    );
}

#[test]
fn the_sample_variance_is_the_variance_of_the_mean() {
    // 400 renders of 64 pixels with 2 and 6 samples: the scatter of the means, compared with the variance that each
    // render claims.
    for samples in [2, 6] {
        let renders: Vec<_> =
            (0..400).map(|seed| render(everything(), 8, samples, 100 + seed, Sequence::Random).color()).collect();
        let (mut scatter, mut claimed) = (0.0, 0.0);
        for (channel, pixel) in (0..3).flat_map(|channel| (0..64).map(move |pixel| (channel, pixel))) {
            let means: Vec<f64> = renders.iter().map(|raw| f64::from(raw.mean.planes[channel][pixel])).collect();
            let center = means.iter().sum::<f64>() / 400.0;
            scatter += means.iter().map(|mean| (mean - center).powi(2)).sum::<f64>() / 399.0;
            claimed += renders
                .iter()
                .map(|raw| f64::from(raw.variance_of_mean.as_ref().unwrap().planes[channel][pixel]))
                .sum::<f64>()
                / 400.0;
        }
        assert!((claimed / scatter - 1.0).abs() < 0.1, "{samples} samples: claimed {claimed}, found {scatter}");
    }
}

#[test]
fn every_scene_renders_and_its_features_are_in_range() {
    assert!(scene("no such scene").is_none());
    assert_eq!(
        scenes().map(|(name, _)| name).collect::<Vec<_>>(),
        ["soft", "dof", "motion", "caustic", "texture", "spikes"]
    );
    for ((name, description), sequence) in scenes().zip(BOTH.into_iter().cycle()) {
        assert!(description.len() > 20 && !description.contains('\n'), "{name}");
        let samples = render(scene(name).unwrap(), 24, 8, 10, sequence);
        let color = samples.color();
        assert!(color.mean.planes.iter().flatten().all(|value| value.is_finite() && *value >= 0.0), "{name}");
        assert!(mean_and_error(&color).0 > 0.05, "{name} is dark");
        for (feature, raw) in samples.features() {
            let range = match feature {
                "normal" => -1.0..=1.0,
                "depth" | "caustic" => 0.0..=f32::MAX,
                _ => 0.0..=1.0,
            };
            assert!(raw.mean.planes.iter().flatten().all(|value| range.contains(value)), "{name}: {feature}");
            if feature == "caustic" {
                let part_of_color = raw
                    .mean
                    .planes
                    .iter()
                    .flatten()
                    .zip(color.mean.planes.iter().flatten())
                    .all(|(part, whole)| *part <= whole * 1.0001);
                assert!(part_of_color, "{name}");
                let there_is_some = raw.mean.planes.iter().flatten().any(|value| *value > 0.0);
                assert_eq!(there_is_some, name == "caustic", "{name}");
            }
        }
        let (frame, repairs) = samples.to_frame().unwrap();
        assert_eq!(
            (frame.extent(), repairs.layer("colour").map(|found| found.pixels_replaced)),
            (square(24), None),
            "{name}"
        );
    }
}

#[test]
fn the_lens_and_the_shutter_blur_what_they_should() {
    // Half of the picture is a lamp; its edge runs between two pixels, one unit in front of, at or behind the plane of
    // focus.
    let picture = |distance: f32, displacement: Vec3| {
        let camera =
            Camera { eye: Vec3::ZERO, target: Vec3::NEG_Z, field_of_view: PI / 2.0, lens_radius: 0.5, focus: 2.0 };
        let lamp = Shape::quad(Vec3::new(0.0, -9.0, -distance), Vec3::X * 9.0, Vec3::Y * 18.0).moving(displacement);
        let scene = Scene::new(camera, Environment::dark()).with(lamp, Material::Light(Vec3::ONE));
        let plane = render(scene, 4, 512, 11, Sequence::LowDiscrepancy).color().mean.planes.swap_remove(0);
        [plane[4], plane[5], plane[6], plane[7]]
    };
    assert_eq!(picture(2.0, Vec3::ZERO), [0.0, 0.0, 1.0, 1.0]);
    let behind = picture(3.0, Vec3::ZERO);
    assert!(
        behind[1] > 0.01 && behind[1] < 0.2 && behind[2] < 0.99 && (behind[1] + behind[2] - 1.0).abs() < 0.01,
        "{behind:?}"
    );
    // Over the time that the shutter is open the edge crosses the second pixel, which is one unit wide at the distance
    // of focus.
    let moved = picture(2.0, Vec3::NEG_X);
    assert!(moved[0] == 0.0 && (moved[1] - 0.5).abs() < 0.01 && moved[2] == 1.0, "{moved:?}");
}

#[test]
fn progress_is_reported_and_can_cancel() {
    let counts = SampleCounts::uniform(square(16), 2).unwrap();
    let mut sampler = StubSampler::new(everything(), square(16), 12, Sequence::Random);
    let mut shares = Vec::new();
    let cancelled = sampler.sample(
        &counts,
        Some(&mut |share| {
            shares.push(share);
            if shares.len() < 5 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        }),
    );
    assert!(matches!(cancelled, Err(Error::Cancelled)));
    assert!(shares.is_sorted() && shares[0] == 1.0 / 16.0, "{shares:?}");
    // As if it had drawn nothing.
    assert_close(&sampler.sample(&counts, None).unwrap(), &render(everything(), 16, 2, 12, Sequence::Random));
}

#[test]
fn what_does_not_fit_is_refused() {
    let request = |result: stein::error::Result<()>| assert!(matches!(result, Err(Error::Request { .. })));
    request(SampleCounts::from_samples(square(1), &[3]).map(drop));
    request(SampleCounts::from_pairs(square(2), vec![1]).map(drop));
    let other_size = SampleCounts::uniform(square(3), 2).unwrap();
    let sampler = || StubSampler::new(everything(), square(4), 0, Sequence::Random);
    request(sampler().sample(&other_size, None).map(drop));
    request(sampler().continue_after(&other_size).map(drop));
    let mut samples = render(everything(), 4, 2, 0, Sequence::Random);
    request(samples.merge(&Samples::none(square(3), &[])));
    request(samples.merge(&Samples::none(square(4), &[("depth", 1)])));
    let without_half = RawSignal { half_b: None, ..samples.color() };
    request(Samples::from_signals(without_half, Vec::new(), &samples.counts()).map(drop));
    let of_other_seed =
        RawSignal { half_b: render(everything(), 4, 2, 1, Sequence::Random).color().half_b, ..samples.color() };
    request(Samples::from_signals(of_other_seed, Vec::new(), &samples.counts()).map(drop));
    assert!(Samples::none(square(4), &[]).to_frame().is_err());
}

#[test]
fn pixels_without_samples_take_their_neighbours_average_in_a_frame() {
    let extent = Extent { width: 3, height: 1 };
    let counts = SampleCounts::from_samples(extent, &[4, 0, 4]).unwrap();
    let samples = StubSampler::new(everything(), extent, 13, Sequence::Random).sample(&counts, None).unwrap();
    assert!(samples.color().mean.planes[0][1].is_nan());
    let (frame, _) = samples.to_frame().unwrap();
    let red = &frame.color().mean.planes[0];
    assert!((red[1] - (red[0] + red[2]) / 2.0).abs() < 1e-6, "{red:?}");
}
