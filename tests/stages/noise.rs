//! Estimated variances: `noise_magnitude`, `noise_guess`, `noise_feature`, `noise_pool` and `noise_unpack`; for an
//! image alone `noise_highpass`, `noise_residual`, `noise_jump` and `noise_hold`. Distances divide differences of
//! values of the order of 1 by the noise, so that weights have four digits; the averaged values are positive.

use stein::gpu::{Gpu, Recorder};
use stein::stage::noise::{
    ImageRule, NoiseRule, NoisyFeatures, noise_feature, noise_of_image, noise_pool, noise_unpack,
};

use crate::common::{
    Scene, assert_near, checked_gpu, extent_of, gpu, own_size, packed_signal, read, rounded, run, scene, upload,
};
use crate::reference::noise::{ImageParams, NoiseParams, of_image, pooled};
use crate::reference::random::Random;
use crate::reference::variance::Signal;
use crate::reference::{Grid, Planes, Point};

const WEIGHTED_MEANS: f64 = 2e-4;

/// Stripes of three materials, each with noise of its own size, and a part as dark as a thousandth of the rest. Some
/// pixels have no noise, and every second of them is black.
fn lit(width: usize, height: usize, seed: u64) -> Signal {
    let Scene { mean, spread, variance } = scene(width, height, seed);
    let light = |p: Point| if p.x as usize > 2 * width / 3 { 1e-3 } else { 1.0 };
    let is_clean = |p: Point| p.x % 9 == 4 && p.y % 7 == 3;
    let value = |p: Point| if is_clean(p) && p.y % 2 == 0 { 0.0 } else { light(p) };
    let noise = |p: Point| if is_clean(p) { 0.0 } else { light(p) };
    let scaled = |planes: &Planes, factor: &(dyn Fn(Point) -> f64 + Sync)| -> Planes {
        planes.iter().map(|grid| rounded(grid.like(|p| grid.at(p) * factor(p)))).collect()
    };
    Signal {
        mean: scaled(&mean, &value),
        spread: Some(scaled(&spread, &noise)),
        sample_variance: Some(scaled(&variance, &|p| noise(p).powi(2))),
    }
}

/// Knowledge of the noise of a colour with halves.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Known {
    Halves,
    HalvesAndVariance,
}

/// With halves, with a variance alone, and with neither, in turn.
fn features(width: usize, height: usize, channels: &[usize], seed: u64) -> Vec<Signal> {
    let mut random = Random(seed);
    let mut feature = |index: usize, channels: usize| {
        let mut planes = |least: f64, greatest: f64| -> Planes {
            (0..channels).map(|_| rounded(random.uniform_grid(width, height, least, greatest))).collect()
        };
        let (noise, spread, variance) = (planes(-0.02, 0.02), planes(-0.02, 0.02), planes(0.0, 0.001));
        let stripes =
            |noise: &Grid| rounded(noise.like(|p| ((p.x as usize / (5 + index)) % 3) as f64 / 2.0 + noise.at(p)));
        Signal {
            mean: noise.iter().map(stripes).collect(),
            spread: index.is_multiple_of(3).then_some(spread),
            sample_variance: (index % 3 == 1).then_some(variance),
        }
    };
    channels.iter().enumerate().map(|(index, channels)| feature(index, *channels)).collect()
}

/// Both planes of a signal; without halves the second is 0.
fn packed(signal: &Signal) -> Vec<f32> {
    let zero = || signal.mean.iter().map(|grid| grid.like(|_| 0.0)).collect();
    packed_signal(&signal.mean, &signal.spread.clone().unwrap_or_else(zero))
}

fn packed_features(rec: &mut Recorder, features: &[Signal]) -> stein::Result<Option<NoisyFeatures>> {
    let Some(first) = features.first() else { return Ok(None) };
    let extent = extent_of(&first.mean[0]);
    let channels: Vec<u32> = features.iter().map(|feature| feature.mean.len() as u32).collect();
    let mut room = NoisyFeatures::take(rec, extent, &channels)?;
    for index in room.packing.order() {
        let feature = rec.upload("feature", &packed(&features[index]))?;
        let variance = features[index].sample_variance.as_ref().map(|variance| upload(rec, variance)).transpose()?;
        noise_feature(rec, extent, &room, room.packing.slots[index], &feature, variance.as_ref(), &NoiseRule::HALVES)?;
    }
    room.are_pooled = features.iter().any(|feature| feature.spread.is_some());
    Ok(Some(room))
}

fn check(gpu: &Gpu, width: usize, height: usize, channels: &[usize], known: Known) {
    let mut color = lit(width, height, 61);
    color.sample_variance = color.sample_variance.filter(|_| known == Known::HalvesAndVariance);
    let features = features(width, height, channels, 62);
    let extent = extent_of(&color.mean[0]);
    let (of_color, of_features) = run(gpu, |rec| {
        let signal = rec.upload("signal", &packed(&color))?;
        let noisy = packed_features(rec, &features)?;
        let given = color.sample_variance.as_ref().map(|variance| upload(rec, variance)).transpose()?;
        let rule = if given.is_some() { NoiseRule::VARIANCE } else { NoiseRule::HALVES };
        let pooled = noise_pool(rec, extent, &signal, given.as_ref(), noisy.as_ref(), &rule)?;
        let slots = noisy.iter().flat_map(|noisy| &noisy.packing.slots);
        let of_features =
            slots.map(|slot| noise_unpack(rec, extent, &pooled, Some(*slot))).collect::<stein::Result<Vec<_>>>()?;
        Ok((noise_unpack(rec, extent, &pooled, None)?, of_features))
    });

    let params = NoiseParams::default();
    let gate = params.given_gate.filter(|_| known == Known::HalvesAndVariance).unwrap_or(params.gate);
    let expected = pooled(&color, &features, &NoiseParams { gate, ..params });
    let what = format!("{width}×{height}, features of {channels:?} channels, {known:?}");
    let near = |what: &str, actual: &[Grid], expected: &[Grid]| {
        assert_near(what, actual, expected, &own_size(expected, 1e-12), WEIGHTED_MEANS, 1e-3);
    };
    near(&format!("colour, {what}"), &read(gpu, &of_color, extent)[0][..3], &expected.color);
    for (index, ((actual, expected), signal)) in of_features.iter().zip(&expected.features).zip(&features).enumerate() {
        if signal.spread.is_some() {
            near(&format!("feature {index}, {what}"), &read(gpu, actual, extent)[0][..expected.len()], expected);
        }
    }
}

#[test]
fn noise_is_pooled_from_the_halves_of_pixels_that_are_alike() {
    check(gpu(), 257, 89, &[3, 1], Known::Halves);
    check(gpu(), 7, 300, &[], Known::Halves);
    check(gpu(), 1, 1, &[3], Known::Halves);
    check(gpu(), 24, 20, &[1, 3, 2, 1, 3, 1, 1, 3], Known::Halves);
    check(checked_gpu(), 31, 9, &[3, 1, 1], Known::Halves);
}

#[test]
fn a_sample_variance_is_pooled_with_those_of_pixels_that_are_alike() {
    check(gpu(), 257, 89, &[3, 1], Known::HalvesAndVariance);
    check(gpu(), 7, 300, &[], Known::HalvesAndVariance);
    check(gpu(), 1, 1, &[3], Known::HalvesAndVariance);
    check(gpu(), 24, 20, &[1, 3, 2, 1, 3, 1, 1, 3], Known::HalvesAndVariance);
    check(checked_gpu(), 31, 9, &[3, 1, 1], Known::HalvesAndVariance);
}

/// With a sample variance, a pixel without noise gets none, black or not: clean tiles stay clean.
#[test]
fn pooling_gives_no_noise_to_pixels_whose_variance_is_zero() {
    let color = lit(64, 40, 66);
    let extent = extent_of(&color.mean[0]);
    let buffer = run(gpu(), |rec| {
        let signal = rec.upload("signal", &packed(&color))?;
        let given = color.sample_variance.as_ref().map(|variance| upload(rec, variance)).transpose()?;
        let pooled = noise_pool(rec, extent, &signal, given.as_ref(), None, &NoiseRule::VARIANCE)?;
        noise_unpack(rec, extent, &pooled, None)
    });
    let given = color.sample_variance.unwrap_or_default();
    for (pooled, given) in read(gpu(), &buffer, extent)[0].iter().zip(&given) {
        let of = |given: &Grid, is_clean: bool| {
            given
                .values
                .iter()
                .zip(&pooled.values)
                .filter(move |(given, _)| (**given == 0.0) == is_clean)
                .map(|(_, v)| *v)
                .collect::<Vec<_>>()
        };
        assert!(of(given, true).iter().all(|v| *v == 0.0) && of(given, true).len() > 30);
        assert!(of(given, false).iter().all(|v| *v > 0.0));
    }
}

/// Gaussian noise whose size depends on the material, estimated from two halves alone.
#[test]
fn pooled_variance_is_that_of_the_noise() {
    let (width, height) = (96, 96);
    let mut random = Random(63);
    // Two materials that touch; one is ten times as bright, with a hundred times the variance.
    let is_bright = |p: Point| p.x >= 48;
    let deviation = |p: Point| if is_bright(p) { 0.2 } else { 0.02 };
    let mut half = || -> Planes {
        let mut plane = || {
            let noise = random.gaussian_grid(width, height, 0.0, 1.0);
            noise.like(|p| if is_bright(p) { 1.0 } else { 0.1 } + deviation(p) * f64::sqrt(2.0) * noise.at(p))
        };
        vec![plane(), plane(), plane()]
    };
    let (a, b) = (half(), half());
    let combined = |sign: f64| -> Planes {
        a.iter().zip(&b).map(|(a, b)| rounded(a.like(|p| (a.at(p) + sign * b.at(p)) / 2.0))).collect()
    };
    let (mean, spread) = (combined(1.0), combined(-1.0));
    let gpu = gpu();
    let extent = extent_of(&mean[0]);
    let buffer = run(gpu, |rec| {
        let signal = rec.upload("signal", &packed_signal(&mean, &spread))?;
        let pooled = noise_pool(rec, extent, &signal, None, None, &NoiseRule::HALVES)?;
        noise_unpack(rec, extent, &pooled, None)
    });
    let variance = read(gpu, &buffer, extent).remove(0);
    for bright in [false, true] {
        let ratio = |plane: &Grid, beside: bool| {
            let of_kind: Vec<f64> = (0..height * width)
                .map(|at| Point { x: (at % width) as isize, y: (at / width) as isize })
                .filter(|&p| is_bright(p) == bright && (!beside || (44..52).contains(&p.x)))
                .map(|p| plane.at(p) / deviation(p).powi(2))
                .collect();
            of_kind.iter().sum::<f64>() / of_kind.len() as f64
        };
        for plane in &variance[..3] {
            // All pixels, and those within four pixels of the border between both materials.
            let (all, beside) = (ratio(plane, false), ratio(plane, true));
            assert!(
                (0.9..1.1).contains(&all) && (0.85..1.2).contains(&beside),
                "bright {bright}: {all} and {beside} times the variance"
            );
        }
    }
}

fn check_image(gpu: &Gpu, width: usize, height: usize, channels: &[usize], explaining: &[usize]) {
    let color = Signal { spread: None, sample_variance: None, ..lit(width, height, 64) };
    let features: Vec<Signal> = features(width, height, channels, 65)
        .into_iter()
        .map(|feature| Signal { spread: None, sample_variance: None, ..feature })
        .collect();
    let extent = extent_of(&color.mean[0]);
    let buffer = run(gpu, |rec| {
        let signal = rec.upload("signal", &packed(&color))?;
        let features = packed_features(rec, &features)?;
        noise_of_image(rec, extent, &signal, features.as_ref(), explaining, &ImageRule::DEFAULT)
    });
    let expected = of_image(&color.mean, &features, explaining, &ImageParams::default());
    let what = format!("{width}×{height}, features of {channels:?} channels, {explaining:?} explain");
    // A fit solves for six numbers.
    assert_near(&what, &read(gpu, &buffer, extent)[0][..3], &expected, &own_size(&expected, 1e-9), 2e-3, 3e-3);
}

#[test]
fn noise_is_told_from_an_image_alone() {
    check_image(gpu(), 257, 89, &[3, 1, 3], &[0, 2]);
    check_image(gpu(), 7, 300, &[], &[]);
    check_image(gpu(), 1, 1, &[3], &[0]);
    check_image(gpu(), 1, 40, &[3], &[0]);
    check_image(gpu(), 40, 1, &[], &[]);
    check_image(checked_gpu(), 31, 9, &[1, 3], &[1]);
}

/// For Gaussian noise on a texture that a feature explains, the estimate is about right; without the feature it is far
/// too high.
#[test]
fn texture_that_features_explain_is_not_all_noise() {
    let (width, height, deviation) = (96, 96, 0.02);
    let mut random = Random(66);
    let texture = rounded(random.uniform_grid(width, height, 0.0, 1.0));
    let mut plane = || {
        let noise = random.gaussian_grid(width, height, 0.0, deviation);
        rounded(texture.like(|p| 0.5 + 0.3 * texture.at(p) + noise.at(p)))
    };
    let color = Signal { mean: vec![plane(), plane(), plane()], spread: None, sample_variance: None };
    let albedo =
        Signal { mean: vec![texture.clone(), texture.clone(), texture.clone()], spread: None, sample_variance: None };
    let gpu = gpu();
    let extent = extent_of(&texture);
    let deviations = |explaining: &[usize]| {
        let buffer = run(gpu, |rec| {
            let signal = rec.upload("signal", &packed(&color))?;
            let features = packed_features(rec, std::slice::from_ref(&albedo))?;
            noise_of_image(rec, extent, &signal, features.as_ref(), explaining, &ImageRule::DEFAULT)
        });
        read(gpu, &buffer, extent)[0][0].mean().sqrt() / deviation
    };
    let (with, without) = (deviations(&[0]), deviations(&[]));
    assert!(
        with > 0.9 && with < 0.75 * without,
        "{with} times the deviation with the texture, {without} times without"
    );
}
