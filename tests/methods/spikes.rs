//! Pixels that stand out, in all methods: those that rest on few samples are removed, likely energy is kept, and lights
//! stay.

use stein::frame::Signal;
use stein::method::{Intermediate, Method, SpikeReport, Spikes};
use stein::{Denoiser, DfcParams, Estimate, Frame, GemParams, NlmParams, Options};

use crate::behaviour::{assert_same, image, memory_for_strips};
use crate::common::{gpu, rounded};
use crate::frames::new_frame;
use crate::reference::random::Random;
use crate::reference::{Grid, Planes};

const WIDTH: usize = 48;
const HEIGHT: usize = 40;
const LEVEL: f64 = 1.0;
const SIGMA: f64 = 0.05;

fn methods() -> [Method; 3] {
    [
        DfcParams { window_radius: 4, ..DfcParams::default() }.into(),
        NlmParams { window_radius: 4, ..NlmParams::default() }.into(),
        GemParams::default().into(),
    ]
}

/// The values of a planted pixel.
#[derive(Clone, Copy)]
struct Planted {
    at: (usize, usize),
    mean: f64,
    half_spread: f64,
    variance: f64,
}

/// A grey wall with noise, in which some pixels are replaced by planted ones.
fn wall(planted: &[Planted], seed: u64) -> Signal {
    let mut random = Random(seed);
    let mut noise = |mean: f64| random.gaussian_grid(WIDTH, HEIGHT, mean, SIGMA);
    let (mut mean, mut spread) = (noise(LEVEL), noise(0.0));
    let mut variance = Grid::filled(WIDTH, HEIGHT, SIGMA * SIGMA);
    for pixel in planted {
        let i = pixel.at.1 * WIDTH + pixel.at.0;
        (mean.values[i], spread.values[i], variance.values[i]) = (pixel.mean, pixel.half_spread, pixel.variance);
    }
    let grey = |grid: Grid| -> Planes { vec![rounded(grid); 3] };
    Signal {
        mean: image(&grey(mean)),
        half_spread: Some(image(&grey(spread))),
        variance_of_mean: Some(image(&grey(variance))),
    }
}

fn denoised(method: Method, frames: &[&Frame], keep: &[Intermediate]) -> Estimate {
    let denoiser = Denoiser::new(gpu(), method).unwrap_or_else(|error| panic!("{error}"));
    denoiser
        .denoise_window(frames, frames.len() / 2, Options { keep, ..Options::default() })
        .unwrap_or_else(|error| panic!("{error}"))
}

fn found(estimate: &Estimate) -> SpikeReport {
    estimate.spikes.unwrap_or_else(|| panic!("nobody looked for spikes"))
}

fn frame(signal: Signal) -> Frame {
    new_frame(signal, Vec::new())
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len() as f64
}

/// One bright sample of many, in half A, with almost no variance claimed.
fn unadmitted(at: (usize, usize), height: f64) -> Planted {
    Planted { at, mean: height, half_spread: height, variance: 1e-6 }
}

#[test]
fn spikes_that_claim_a_small_variance_do_not_survive() {
    let clusters = [
        vec![(20, 20)],
        vec![(20, 20), (21, 20)],
        vec![(20, 20), (21, 20), (20, 21)],
        vec![(0, 0)],
        vec![(47, 39), (46, 38)],
    ];
    for method in methods() {
        for cluster in &clusters {
            let planted: Vec<_> = cluster.iter().map(|&at| unadmitted(at, 1e6)).collect();
            let frame = frame(wall(&planted, 5));
            let estimate = denoised(method, &[&frame], &[]);
            assert_eq!(found(&estimate).pixels, cluster.len(), "{}: {cluster:?}", method.name());
            // No spike is left, and the wall keeps its brightness: each spike has given at most a tenth of the level to
            // the pixels around.
            let plane = &estimate.color.planes[0];
            let farthest = plane.iter().fold(0.0f64, |most, value| most.max((f64::from(*value) - LEVEL).abs()));
            let bound = 0.1 * cluster.len() as f64 + 4.0 * SIGMA;
            assert!(farthest < bound, "{}: {cluster:?}: {farthest} off", method.name());
            let energy = mean(plane) / LEVEL;
            assert!(
                (0.99..1.0 + 0.1 * cluster.len() as f64).contains(&energy),
                "{}: {cluster:?}: energy {energy}",
                method.name()
            );
        }
    }
}

#[test]
fn spikes_that_admit_to_it_do_not_survive_either() {
    // The two bright samples are in different halves, so that the halves agree.
    let planted = [
        Planted { at: (10, 10), mean: 50.0, half_spread: 0.0, variance: 50.0 * 50.0 / 2.0 },
        Planted { at: (30, 25), mean: 50.0, half_spread: 50.0, variance: 2500.0 },
    ];
    let signal = wall(&planted, 6);
    for (what, signal, spikes) in [
        ("halves and variance", signal.clone(), 2),
        ("halves", Signal { variance_of_mean: None, ..signal.clone() }, 1),
        ("variance", Signal { half_spread: None, ..signal }, 2),
    ] {
        for method in methods() {
            let estimate = denoised(method, &[&frame(signal.clone())], &[]);
            assert_eq!(found(&estimate).pixels, spikes, "{}: {what}", method.name());
            if spikes == 2 {
                let farthest = estimate.color.planes[0]
                    .iter()
                    .fold(0.0f64, |most, value| most.max((f64::from(*value) - LEVEL).abs()));
                assert!(farthest < 0.2 + 4.0 * SIGMA, "{}: {what}: {farthest} off", method.name());
            }
        }
    }
}

/// Likely spikes, of little energy: their energy is kept.
#[test]
fn likely_energy_is_kept() {
    let heights = [1.5, 2.0, 3.0, 5.0];
    let planted: Vec<_> = heights
        .iter()
        .zip([(12, 12), (36, 12), (12, 28), (36, 28)])
        .map(|(height, at)| unadmitted(at, LEVEL + height))
        .collect();
    let frame = frame(wall(&planted, 7));
    let energy = mean(&frame.color().mean.planes[0]);
    for method in methods() {
        let [kept, spread, clamped] = [Spikes::Keep, Spikes::Spread, Spikes::Clamp]
            .map(|spikes| denoised(method.with_spikes(spikes), &[&frame], &[]));
        assert_eq!(kept.spikes, None);
        for estimate in [&spread, &clamped] {
            let taken = heights.iter().sum::<f64>() / (WIDTH * HEIGHT) as f64 / energy;
            assert!(
                found(estimate).pixels == 4 && (found(estimate).taken / taken - 1.0).abs() < 0.05,
                "{}",
                found(estimate)
            );
        }
        assert_eq!(found(&clamped).spread, 0.0);
        // 5 spread over 441 pixels is a ninth of the value at which half is left out.
        let part = found(&spread).spread / found(&spread).taken;
        assert!((0.85..1.0).contains(&part), "{part} of the energy is kept");
        let [spread, clamped] = [spread, clamped].map(|estimate| mean(&estimate.color.planes[0]));
        assert!((spread / energy - 1.0).abs() < 0.003, "{}: {spread} of {energy}", method.name());
        assert!(clamped < spread - 0.003, "{}: {clamped} of {energy}", method.name());
    }
}

/// Lights of one pixel keep their value to the bit, and none of their light gets into the pixels around.
#[test]
fn lights_stay() {
    // Clean in a noisy image; noisy, but on many samples.
    let lights = [
        Planted { at: (20, 20), mean: 100.0, half_spread: 0.0, variance: 0.0 },
        Planted { at: (8, 30), mean: 1e6, half_spread: 1e-3, variance: 1e-6 },
        Planted { at: (40, 10), mean: 20.0, half_spread: 3.0, variance: 9.0 },
    ];
    let signal = wall(&lights, 8);
    let clean = |image: &stein::Image| stein::Image {
        planes: image.planes.iter().map(|plane| vec![0.0; plane.len()]).collect(),
        ..image.clone()
    };
    let noise_free = Signal {
        half_spread: signal.half_spread.as_ref().map(clean),
        variance_of_mean: signal.variance_of_mean.as_ref().map(clean),
        ..signal.clone()
    };
    let two_seeds = Signal { variance_of_mean: None, ..signal.clone() };
    for (what, signal) in [("noisy", &signal), ("two seeds", &two_seeds), ("without noise", &noise_free)] {
        let frame = frame(signal.clone());
        for method in methods() {
            let estimate = denoised(method, &[&frame], &[]);
            assert!(estimate.spikes.is_none_or(|spikes| spikes == SpikeReport::default()), "{what}");
            let is_light = |at: usize| lights.iter().any(|light| light.at == (at % WIDTH, at / WIDTH));
            for (plane, input) in estimate.color.planes.iter().zip(&signal.mean.planes) {
                for (at, (value, input)) in plane.iter().zip(input).enumerate() {
                    if is_light(at) {
                        assert_eq!(value, input, "{}, {what}: a light", method.name());
                    } else {
                        let off = (f64::from(*value) - LEVEL).abs();
                        assert!(
                            off < 5.0 * SIGMA,
                            "{}, {what}: {off} off at x {}, y {}",
                            method.name(),
                            at % WIDTH,
                            at / WIDTH
                        );
                    }
                }
            }
        }
    }
}

/// A path that one sample of eight takes: with 8 samples it is a spike, with 8000 a light.
#[test]
fn with_more_samples_spikes_are_lights() {
    let of_samples = |samples: f64| {
        let (height, hits) = (40.0, samples / 8.0);
        Planted {
            at: (24, 20),
            mean: LEVEL + height,
            half_spread: height / f64::sqrt(hits),
            variance: height * height / hits,
        }
    };
    for method in methods() {
        let taken = [8.0, 8000.0].map(|samples| {
            let estimate = denoised(method, &[&frame(wall(&[of_samples(samples)], 9))], &[Intermediate::Spikes]);
            f64::from(estimate.layers[0].image.planes[0][20 * WIDTH + 24])
        });
        assert!((taken[0] - 40.0).abs() < 4.0 * SIGMA && taken[1] == 0.0, "{}: {taken:?}", method.name());
    }
}

#[test]
fn what_was_taken_can_be_kept() {
    let planted = [unadmitted((20, 20), 51.0), unadmitted((30, 9), 11.0)];
    let frame = frame(wall(&planted, 10));
    for method in methods() {
        let estimate = denoised(method, &[&frame], &[Intermediate::Spikes]);
        let Some(layer) = estimate.layers.iter().find(|layer| layer.name == "spikes") else { panic!("no layer") };
        for (pixel, taken) in layer.image.planes[1].iter().enumerate() {
            let planted = planted.iter().find(|planted| planted.at.1 * WIDTH + planted.at.0 == pixel);
            let expected = planted.map_or(0.0, |planted| planted.mean - LEVEL);
            assert!((f64::from(*taken) - expected).abs() < SIGMA, "pixel {pixel}: {taken} in place of {expected}");
        }
    }
}

/// Each frame of a window is repaired by itself.
#[test]
fn spikes_of_frames_beside_do_no_harm() {
    let own = frame(wall(&[], 11));
    let [spiky, plain] = [vec![unadmitted((20, 20), 1e4)], Vec::new()].map(|planted| frame(wall(&planted, 12)));
    for method in methods().into_iter().filter(Method::filters_in_time) {
        let [with, without] = [&spiky, &plain].map(|beside| denoised(method, &[beside, &own, &plain], &[]));
        assert_eq!(found(&with).pixels, 0, "they are those of the frame itself");
        let difference = with.color.planes[0]
            .iter()
            .zip(&without.color.planes[0])
            .fold(0.0f32, |most, (a, b)| most.max((a - b).abs()));
        assert!(difference < 0.1, "{}: {difference}", method.name());
    }
}

/// Strips hold all pixels that a repair depends on: bits and counts are those of the whole image.
#[test]
fn strips_repair_like_the_whole() {
    let (width, height) = (24, 300);
    let mut random = Random(13);
    let (noise, halves, chosen) = (
        random.gaussian_grid(width, height, LEVEL, SIGMA),
        random.gaussian_grid(width, height, 0.0, SIGMA),
        random.uniform_grid(width, height, 0.0, 60.0),
    );
    let is_spike = |i: usize| chosen.values[i] < 1.0;
    let of = |grid: &Grid, other: &dyn Fn(usize) -> f64| -> Planes {
        let values =
            grid.values.iter().enumerate().map(|(i, value)| if is_spike(i) { other(i) } else { *value }).collect();
        vec![rounded(Grid { width, height, values }); 3]
    };
    let size = |i: usize| 3.0 + 1000.0 * chosen.values[i];
    let mean = image(&of(&noise, &|i| LEVEL + size(i)));
    let signal = Signal {
        mean,
        half_spread: Some(image(&of(&halves, &size))),
        variance_of_mean: Some(image(&of(&noise.like(|_| SIGMA * SIGMA), &|_| 1e-4))),
    };
    let features = vec![(
        "depth".to_owned(),
        Signal {
            mean: image(&[halves.like(|p| (p.y / 40) as f64)]),
            half_spread: Some(image(&[halves])),
            variance_of_mean: None,
        },
    )];
    let frame = new_frame(signal, features);
    for method in methods() {
        let whole = denoised(method, &[&frame], &[]);
        let denoiser = Denoiser::new(gpu(), method).unwrap_or_else(|error| panic!("{error}"));
        let limit = memory_for_strips(&denoiser, &frame, 3, &[]);
        let cut = denoiser.with_max_memory(limit).denoise(&frame).unwrap_or_else(|error| panic!("{error}"));
        assert!(whole.strips == 1 && cut.strips >= 3, "{}: {} strips", method.name(), cut.strips);
        assert_same(&format!("{} in {} strips", method.name(), cut.strips), &cut, &whole, 1.0);
        let (cut, whole) = (found(&cut), found(&whole));
        assert!(
            whole.pixels > 30 && cut.pixels == whole.pixels && (cut.spread / whole.spread - 1.0).abs() < 1e-9,
            "{cut:?} instead of {whole:?}"
        );
    }
}
