//! Regions beside others: a shadow beside fireflies, texture without noise beside noise, a dark part beside a bright
//! one, a blurred edge under features that are not blurred. No region may become worse than its noisy input.

use stein::frame::Signal;
use stein::method::Method;
use stein::{Denoiser, DfcParams, Estimate, Frame, GemParams, Image, NlmParams};

use crate::behaviour::image;
use crate::common::{gpu, rounded};
use crate::frames::new_frame;
use crate::reference::random::Random;
use crate::reference::{Grid, Planes, Point};

const SIZE: usize = 64;
const SAMPLES: usize = 16;

fn methods() -> [Method; 3] {
    [
        DfcParams { window_radius: 7, ..DfcParams::default() }.into(),
        NlmParams { window_radius: 7, ..NlmParams::default() }.into(),
        GemParams::default().into(),
    ]
}

fn denoised(method: Method, frame: &Frame) -> Estimate {
    let denoiser = Denoiser::new(gpu(), method).unwrap_or_else(|error| panic!("{error}"));
    denoiser.denoise(frame).unwrap_or_else(|error| panic!("{error}"))
}

/// Mean, half spread and variance of the mean of exponentially distributed samples.
fn sampled(truth: &Planes, seed: u64) -> [Planes; 3] {
    let mut random = Random(seed);
    let (mut mean, mut spread, mut variance) = (Planes::new(), Planes::new(), Planes::new());
    for plane in truth {
        let (mut of_mean, mut of_spread, mut of_variance) = (plane.clone(), plane.clone(), plane.clone());
        for (pixel, &value) in plane.values.iter().enumerate() {
            let draws: Vec<f64> = (0..SAMPLES).map(|_| -value * (1.0 - random.uniform()).ln()).collect();
            let average = |draws: &mut dyn Iterator<Item = f64>| draws.sum::<f64>();
            let total = average(&mut draws.iter().copied()) / SAMPLES as f64;
            let first = average(&mut draws.iter().step_by(2).copied()) / (SAMPLES / 2) as f64;
            of_mean.values[pixel] = total;
            of_spread.values[pixel] = first - total;
            let squares = average(&mut draws.iter().map(|draw| (draw - total).powi(2)));
            of_variance.values[pixel] = squares / (SAMPLES * (SAMPLES - 1)) as f64;
        }
        mean.push(rounded(of_mean));
        spread.push(rounded(of_spread));
        variance.push(rounded(of_variance));
    }
    [mean, spread, variance]
}

fn signal([mean, spread, variance]: &[Planes; 3]) -> Signal {
    Signal { mean: image(mean), half_spread: Some(image(spread)), variance_of_mean: Some(image(variance)) }
}

fn colored(brightness: impl Fn(Point) -> f64 + Sync) -> Planes {
    [0.8, 0.6, 0.4].map(|tint| Grid::from_fn(SIZE, SIZE, |p| tint * brightness(p))).to_vec()
}

/// A checked floor.
fn texture(p: Point) -> f64 {
    [0.3, 0.9][((p.x / 8 + p.y / 8) % 2) as usize] * (1.0 - p.x as f64 / 200.0)
}

/// Mean squared error relative to the squared truth, over the pixels of a region.
fn relative_error(image: &Image, truth: &Planes, region: impl Fn(Point) -> bool) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (plane, truth) in image.planes.iter().zip(truth) {
        for (pixel, (value, truth)) in plane.iter().zip(&truth.values).enumerate() {
            let p = Point { x: (pixel % SIZE) as isize, y: (pixel / SIZE) as isize };
            if region(p) {
                sum += (f64::from(*value) / truth - 1.0).powi(2);
                count += 1.0;
            }
        }
    }
    sum / count
}

fn is_right(p: Point) -> bool {
    p.x >= SIZE as isize / 2
}

#[test]
fn fireflies_do_not_light_up_the_shadow_beside_them() {
    for contrast in [10.0, 100.0, 1e3, 1e6] {
        let truth = colored(|p| if is_right(p) { 30.0 / contrast } else { 30.0 });
        let mut draws = sampled(&truth, 21);
        // One bright sample, in the first half, at each of three pixels near the shadow.
        for (x, y) in [(29, 12), (26, 33), (31, 50)] {
            for (channel, plane) in truth.iter().enumerate() {
                let (pixel, height) = (y * SIZE + x, 6.0 * plane.values[y * SIZE + x]);
                draws[0][channel].values[pixel] += height;
                draws[1][channel].values[pixel] += height;
                draws[2][channel].values[pixel] += height * height;
            }
        }
        let frame = new_frame(signal(&draws), Vec::new());
        for method in methods() {
            let estimate = denoised(method, &frame);
            let found = estimate.spikes.unwrap_or_default();
            assert!(found.pixels >= 3 && found.spread > 0.0, "{}: {found:?}", method.name());
            let [before, after] =
                [&frame.color().mean, &estimate.color].map(|image| relative_error(image, &truth, is_right));
            // Patches that differ in one column alone still weigh up to a hundred thousandth: one column of the shadow
            // takes as much of the light beside it.
            let leak = (1e-5 * contrast).powi(2) / (SIZE / 2) as f64;
            assert!(
                after < 0.5 * before + leak,
                "{}, {contrast} to 1: the shadow's error went from {before} to {after}",
                method.name()
            );
            let least = estimate.color.planes.iter().flatten().fold(f32::MAX, |least, value| least.min(*value));
            assert!(least > 0.0, "{}, {contrast} to 1: radiance of {least}", method.name());
        }
    }
}

type IsNoisy = fn(Point) -> bool;

#[test]
fn pixels_without_noise_stay_beside_noise() {
    let truth = colored(texture);
    let noisy = sampled(&truth, 22);
    let regions: [(&str, IsNoisy); 3] = [
        ("one pixel", |p| (p.x, p.y) == (60, 60)),
        ("the lower part", |p| p.y >= 40),
        ("every other column", |p| p.x % 2 == 1),
    ];
    for (what, is_noisy) in regions {
        // Rounding to float32 is not noise; neither is a variance of that size.
        for rest in [0.0, 1e-14] {
            let mixed = |planes: &Planes, clean: &dyn Fn(usize, Point) -> f64| -> Planes {
                let channel = |c: usize| {
                    let values = planes[c].values.iter().enumerate().map(|(pixel, value)| {
                        let p = Point { x: (pixel % SIZE) as isize, y: (pixel / SIZE) as isize };
                        if is_noisy(p) { *value } else { clean(c, p) }
                    });
                    rounded(Grid { values: values.collect(), ..planes[c] })
                };
                (0..3).map(channel).collect()
            };
            let draws = [
                mixed(&noisy[0], &|c, p| truth[c].at(p)),
                mixed(&noisy[1], &|_, _| 0.0),
                mixed(&noisy[2], &|_, _| rest),
            ];
            let sources =
                [("halves and variance", signal(&draws)), ("variance", Signal { half_spread: None, ..signal(&draws) })];
            for (knows, color) in sources {
                let frame = new_frame(color, Vec::new());
                for method in methods() {
                    let estimate = denoised(method, &frame);
                    let moved = |image: &Image| -> f64 {
                        let clean = (0..SIZE * SIZE).filter(|pixel| {
                            !is_noisy(Point { x: (pixel % SIZE) as isize, y: (pixel / SIZE) as isize })
                        });
                        let change = |c: usize, pixel: usize| {
                            (f64::from(image.planes[c][pixel]) / truth[c].values[pixel] - 1.0).abs()
                        };
                        clean.flat_map(|pixel| [0, 1, 2].map(|c| change(c, pixel))).fold(0.0, f64::max)
                    };
                    let most = moved(&estimate.color);
                    assert!(
                        most < 1e-5,
                        "{} by {knows}, {what} is noisy, the rest claims {rest}: a pixel moved by {most}",
                        method.name()
                    );
                }
            }
        }
    }
}

#[test]
fn a_dark_part_does_not_depend_on_how_bright_the_other_part_is() {
    let truth = colored(texture);
    let noisy = sampled(&truth, 23);
    for method in &methods()[..2] {
        let dark_part = |factor: f64| {
            let bright = |planes: &Planes, value: &dyn Fn(usize, Point) -> f64| -> Planes {
                (0..3)
                    .map(|c| {
                        rounded(Grid {
                            values: pixels().map(|p| if is_right(p) { value(c, p) } else { planes[c].at(p) }).collect(),
                            ..planes[c]
                        })
                    })
                    .collect()
            };
            let draws = [
                bright(&noisy[0], &|c, p| factor * truth[c].at(p)),
                bright(&noisy[1], &|_, _| 0.0),
                bright(&noisy[2], &|_, _| 0.0),
            ];
            let frame = new_frame(signal(&draws), Vec::new());
            let estimate = denoised(*method, &frame);
            let [before, after] =
                [&frame.color().mean, &estimate.color].map(|image| relative_error(image, &truth, |p| !is_right(p)));
            assert!(after < 0.5 * before, "{}, {factor} times brighter: {before} became {after}", method.name());
            after
        };
        let errors = [1e3, 1e5, 1e6, 1e8].map(dark_part);
        let [least, most] =
            [f64::min as fn(f64, f64) -> f64, f64::max].map(|of| errors.into_iter().reduce(of).unwrap_or(f64::NAN));
        assert!(most < 1.05 * least, "{}: {errors:?}", method.name());
    }
}

fn pixels() -> impl Iterator<Item = Point> {
    (0..SIZE * SIZE).map(|pixel| Point { x: (pixel % SIZE) as isize, y: (pixel / SIZE) as isize })
}

#[test]
fn features_that_are_sharper_than_the_colour_force_no_edge() {
    let share = |p: Point| ((p.x as f64 + 0.5 - 22.0) / 20.0).clamp(0.0, 1.0);
    let truth = colored(|p| 0.2 + 0.8 * share(p));
    let color = signal(&sampled(&truth, 24));
    let sharp = |low: f64, high: f64| -> Signal {
        let plane = Grid::from_fn(SIZE, SIZE, |p| if is_right(p) { high } else { low });
        Signal { mean: image(&vec![rounded(plane); 3]), half_spread: None, variance_of_mean: None }
    };
    let same_halves = Signal { half_spread: Some(Image::filled(color.mean.extent, 3, 0.0)), ..sharp(0.1, 0.9) };
    let method = methods()[0];
    let error = |features: Vec<(String, Signal)>| {
        relative_error(&denoised(method, &new_frame(color.clone(), features)).color, &truth, |_| true)
    };
    let without = error(Vec::new());
    for (what, features) in [
        ("two without noise", vec![("albedo".to_owned(), sharp(0.2, 0.8)), ("paint".to_owned(), sharp(0.0, 1.0))]),
        ("one with halves that are the same", vec![("albedo".to_owned(), same_halves)]),
    ] {
        let with = error(features);
        assert!(with < 1.5 * without, "{what}: {with}, without features {without}");
    }
    let forced = Method::from(DfcParams { window_radius: 7, color_only: false, ..DfcParams::default() });
    let frame = new_frame(color.clone(), vec![("albedo".to_owned(), sharp(0.2, 0.8))]);
    let kept = relative_error(&denoised(forced, &frame).color, &truth, |_| true);
    assert!(kept > 2.0 * without, "nothing is forced here: {kept} and {without}");
}
