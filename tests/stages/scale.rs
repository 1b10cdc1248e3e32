//! `scale_pixel`, `scale_stop`, `scale_advance` and `scale_reduction`: from the scales of an image to the scale of each
//! pixel.

use stein::gpu::{Gpu, Recorder};
use stein::stage::sample::GpuSamples;
use stein::stage::scale::{Scale, scale_advance, scale_gaussian, scale_pixel, scale_reduction, scale_stop};

use crate::common::{
    assert_near, checked_gpu, extent_of, flat, gpu, own_size, packed, packed_signal, read, rounded, run, scene, upload,
};
use crate::reference::gem::{self as twin, Chosen, Step, choose, decided, relative_mse, step};
use crate::reference::random::Random;
use crate::reference::{Grid, Planes};

const SIZES: [(usize, usize); 3] = [(257, 89), (7, 300), (1, 1)];

/// Scales that have nothing in common, finest first.
fn unrelated_scales(width: usize, height: usize, known_samples: bool) -> Vec<twin::Scale> {
    let mut random = Random(71);
    let mut scale = |seed: u64, sigma: f64| {
        let scene = scene(width, height, seed);
        let mut grid = |low: f64, high: f64| rounded(random.uniform_grid(width, height, low, high));
        let samples = if known_samples { grid(2.0, 64.0) } else { Grid::filled(width, height, 0.0) };
        // The kernels are given 1/pixels.
        let inverse_pixels = if sigma == 0.0 { Grid::filled(width, height, 1.0) } else { grid(0.01, 0.9) };
        let pixels = inverse_pixels.like(|p| 1.0 / inverse_pixels.at(p));
        twin::Scale { sigma, mean: scene.mean, spread: scene.spread, variance: scene.variance, samples, pixels }
    };
    vec![scale(72, 0.0), scale(73, 1.0), scale(74, 2.0), scale(75, 4.0)]
}

fn upload_scale(rec: &mut Recorder, scale: &twin::Scale) -> stein::Result<Scale> {
    let mean = [scale.mean.as_slice(), std::slice::from_ref(&scale.samples)].concat();
    let inverse_pixels = scale.pixels.like(|p| 1.0 / scale.pixels.at(p));
    Ok(Scale {
        sigma: scale.sigma as f32,
        signal: rec.upload("signal", &packed_signal(&mean, &scale.spread))?,
        variance: rec.upload("variance", &packed(&[scale.variance.as_slice(), &[inverse_pixels]].concat()))?,
    })
}

fn upload_samples(rec: &mut Recorder, samples: &Grid) -> stein::Result<GpuSamples> {
    Ok(if samples.values[0] == 0.0 {
        GpuSamples::Uniform(0.0)
    } else {
        GpuSamples::PerPixel(upload(rec, std::slice::from_ref(samples))?)
    })
}

#[test]
fn the_selector_is_equation_6_1() {
    for (gpu, sizes) in [(gpu(), &SIZES[..]), (checked_gpu(), &[(24, 20)][..])] {
        for &(width, height) in sizes {
            for known in [true, false] {
                let scales = unrelated_scales(width, height, known);
                let extent = extent_of(&scales[0].samples);
                for pair in scales.windows(2) {
                    let buffer = run(gpu, |rec| {
                        let (fine, coarse) = (upload_scale(rec, &pair[0])?, upload_scale(rec, &pair[1])?);
                        scale_stop(rec, extent, &fine, &coarse, 0.7)
                    });
                    let actual = read(gpu, &buffer, extent).remove(0);
                    let Step { bias_term, variance_term } = step(&pair[0], &pair[1], f64::from(0.7f32));
                    let what = |part: &str| {
                        format!("scale_stop, {width}×{height}, σ {}, samples {known}: {part}", pair[0].sigma)
                    };
                    // Differences of rounded values.
                    let size =
                        |p| (0..3).map(|i| pair[0].mean[i].at(p).powi(2) + pair[1].mean[i].at(p).powi(2)).sum::<f64>();
                    let scale = bias_term.like(|p| bias_term.at(p) + 0.1 * size(p));
                    assert_near(
                        &what("bias term"),
                        &actual[1..],
                        std::slice::from_ref(&bias_term),
                        &[scale],
                        2e-6,
                        0.0,
                    );
                    let stops = Step { bias_term, variance_term }.stops();
                    assert_near(
                        &what("map"),
                        &actual,
                        std::slice::from_ref(&stops),
                        &flat(std::slice::from_ref(&stops), 1.0),
                        1e-9,
                        1e-4,
                    );
                    assert!(width * height < 100 || (0.1..0.9).contains(&stops.mean()), "{}", stops.mean());
                }
            }
        }
    }
}

/// Three steps, each with its own maps and scales, so that pixels end on all four scales.
fn chosen(gpu: &Gpu, width: usize, height: usize, known: bool, coarser_only: bool) {
    let mut random = Random(76);
    let scales = unrelated_scales(width, height, known);
    let extent = extent_of(&scales[0].samples);
    let mut maps = || -> (Grid, Grid) {
        let (stops, smoothed) =
            (random.uniform_grid(width, height, 0.0, 1.0), random.uniform_grid(width, height, 0.0, 1.0));
        (stops.like(|p| stops.at(p).round()), rounded(smoothed))
    };
    let maps: Vec<(Grid, Grid)> = (0..3).map(|_| maps()).collect();
    let steps: Vec<Step> = scales.windows(2).map(|pair| step(&pair[0], &pair[1], 0.7)).collect();
    let selected = run(gpu, |rec| {
        let signal = rec.upload("signal", &packed_signal(&scales[0].mean, &scales[0].spread))?;
        let variance = upload(rec, &scales[0].variance)?;
        let samples = upload_samples(rec, &scales[0].samples)?;
        let (mut fine, mut selected) = scale_pixel(rec, extent, &signal, &variance, &samples)?;
        for (coarse, ((stops, smoothed), step)) in scales[1..].iter().zip(maps.iter().zip(&steps)) {
            let coarse = upload_scale(rec, coarse)?;
            let (stops, smoothed) =
                (upload(rec, &[stops.clone(), step.bias_term.clone()])?, upload(rec, std::slice::from_ref(smoothed))?);
            scale_advance(rec, extent, &mut selected, &fine, &coarse, &stops, &smoothed, coarser_only)?;
            fine = coarse;
        }
        let reduction = scale_reduction(rec, extent, &selected)?;
        Ok((selected, reduction))
    });
    let decided: Vec<Grid> = maps.iter().map(|(stops, smoothed)| decided(stops, smoothed, coarser_only)).collect();
    let expected = choose(&scales, &steps, &decided);
    let relative_mse = relative_mse(&expected);
    let Chosen { sigma, mean, spread, error, pixels, support } = expected;
    let (selected, reduction) = selected;
    let what =
        |part: &str| format!("scale_advance, {width}×{height}, samples {known}, coarser only {coarser_only}: {part}");
    let check = |part: &str, actual: &[Grid], expected: &[Grid]| {
        assert_near(&what(part), actual, expected, &own_size(expected, 0.0), 1e-6, 0.0);
    };
    let signal = read(gpu, &selected.signal, extent);
    check("mean and pixels", &signal[0], &[mean.as_slice(), std::slice::from_ref(&pixels)].concat());
    check("half spread", &signal[1], &spread);
    let choice = read(gpu, &selected.choice, extent).remove(0);
    check("σ", &choice, std::slice::from_ref(&sigma));
    check("support", &choice[3..], std::slice::from_ref(&support));
    // Sums of terms that cancel.
    let terms = error.like(|p| {
        steps.iter().map(|step| step.bias_term.at(p)).sum::<f64>()
            + scales.iter().flat_map(|s| &s.variance).map(|v| v.at(p)).sum::<f64>()
    });
    assert_near(&what("error"), &choice[2..], std::slice::from_ref(&error), std::slice::from_ref(&terms), 1e-6, 0.0);
    let reduction = read(gpu, &reduction, extent).remove(0);
    let scale = relative_mse.like(|p| (relative_mse.at(p) / error.at(p).max(1e-30) * terms.at(p)).abs() + 1e-6);
    assert_near(&what("relative MSE"), &reduction, &[relative_mse], &[scale], 2e-6, 0.0);
    check("support again", &reduction[1..], &[support, sigma]);
}

#[test]
fn the_finest_scale_with_value_1_is_chosen() {
    for known in [true, false] {
        for coarser_only in [true, false] {
            for (width, height) in SIZES {
                chosen(gpu(), width, height, known, coarser_only);
            }
            chosen(checked_gpu(), 24, 20, known, coarser_only);
        }
    }
}

#[test]
fn scales_carry_means_variances_and_counts() {
    let (width, height) = (33, 21);
    let pixel = unrelated_scales(width, height, true).remove(0);
    let extent = extent_of(&pixel.samples);
    let gpu = gpu();
    let coarse = run(gpu, |rec| {
        let signal = rec.upload("signal", &packed_signal(&pixel.mean, &pixel.spread))?;
        let variance = upload(rec, &pixel.variance)?;
        let samples = upload_samples(rec, &pixel.samples)?;
        let (finest, _) = scale_pixel(rec, extent, &signal, &variance, &samples)?;
        scale_gaussian(rec, extent, &finest, 2.0)
    });
    let expected = twin::scaled(&pixel, 2.0);
    let size = |planes: &[Grid]| -> Planes {
        let magnitude = |grid: &Grid| crate::reference::gaussian::gaussian(&grid.like(|p| grid.at(p).abs()), 2.0, 6);
        planes.iter().map(magnitude).collect()
    };
    let signal = read(gpu, &coarse.signal, extent);
    assert_near("mean", &signal[0], &expected.mean, &size(&pixel.mean), 1e-5, 0.0);
    assert_near(
        "samples",
        &signal[0][3..],
        std::slice::from_ref(&expected.samples),
        std::slice::from_ref(&expected.samples),
        1e-5,
        0.0,
    );
    assert_near("half spread", &signal[1], &expected.spread, &size(&pixel.spread), 1e-5, 0.0);
    let variance = read(gpu, &coarse.variance, extent).remove(0);
    assert_near("variance", &variance, &expected.variance, &own_size(&expected.variance, 0.0), 1e-5, 0.0);
    let inverse = expected.pixels.like(|p| 1.0 / expected.pixels.at(p));
    assert_near("1/pixels", &variance[3..], std::slice::from_ref(&inverse), std::slice::from_ref(&inverse), 1e-5, 0.0);
}
