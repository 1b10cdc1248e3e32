//! The display shader against the same formulas in float64, pixel by pixel: every kind of layer, tone, channel, scale
//! and comparison.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::sync::Arc;

use eframe::egui::Rect;
use stein::{Extent, Gpu, Image, gpu::DeviceChoice};
use stein_viewer::layer::{Kind, Range, Scale, Shown};
use stein_viewer::screenshot::{Offscreen, Picture};
use stein_viewer::view::colormap::Colormap;
use stein_viewer::view::display::{Draw, Operation, RELATIVE_EPSILON, Slots};
use stein_viewer::view::{Channel, Tone};

const EXTENT: Extent = Extent { width: 13, height: 9 };
const SIDE: f32 = 64.0;
const BACKGROUND: [f32; 3] = [0.2, 0.4, 0.6];
/// Of 255: rounding, and the pow of a GPU.
const TOLERANCE: f64 = 1.6;

/// Values over many magnitudes and of both signs, without any pattern.
fn image(channels: usize, seed: u32) -> Arc<Image> {
    let value = |index: usize| {
        let mut bits = (index as u32).wrapping_mul(0x9e37_79b9) ^ seed.wrapping_mul(0x85eb_ca6b);
        bits = (bits ^ (bits >> 15)).wrapping_mul(0x2c1b_3c6d);
        bits = (bits ^ (bits >> 12)).wrapping_mul(0x297a_2d39);
        bits ^= bits >> 15;
        let uniform = (bits >> 8) as f32 / (1 << 24) as f32;
        (uniform * 8.0 - 6.0).exp2() * if bits & 7 == 0 { -1.0 } else { 1.0 }
    };
    let plane = |plane: usize| (0..EXTENT.pixels()).map(|pixel| value(pixel * 3 + plane)).collect();
    Arc::new(Image { extent: EXTENT, planes: (0..channels).map(plane).collect() })
}

fn draw(image: Arc<Image>, kind: Kind) -> Draw {
    Draw {
        a: Shown::new(image),
        b: None,
        kind,
        operation: Operation::Single,
        // No pixel of the target lies on an edge between two of the image.
        first: [-1.03, -2.01],
        step: 0.247,
        channel: Channel::All,
        tone: Tone::Srgb,
        exposure: 0.5,
        offset: 0.02,
        gamma: 1.8,
        range: Range { low: 0.05, high: 1.5 },
        scale: Scale::Linear,
        colormap: Colormap::Viridis,
        background: BACKGROUND,
    }
}

fn on_gpu(window: &mut Offscreen, slots: &mut Slots, draw: &Draw) -> Picture {
    let format = window.format();
    let show = |ui: &mut eframe::egui::Ui| {
        slots.begin(format);
        let rect = Rect::from_min_size(Default::default(), eframe::egui::Vec2::splat(SIDE));
        ui.painter().add(slots.paint(rect, draw.clone()));
    };
    window.frame(show).unwrap()
}

fn srgb(value: f64) -> f64 {
    let value = value.clamp(0.0, 1.0);
    if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 }
}

fn tone_mapped(draw: &Draw, value: f64) -> f64 {
    let value = (value * f64::from(draw.exposure).exp2() + f64::from(draw.offset)).max(0.0);
    match draw.tone {
        Tone::Srgb => srgb(value),
        Tone::Gamma => value.min(1.0).powf(1.0 / f64::from(draw.gamma)),
        Tone::Reinhard => srgb(value / (1.0 + value)),
        Tone::Filmic => srgb(value * (2.51 * value + 0.03) / (value * (2.43 * value + 0.59) + 0.14)),
    }
}

fn false_color(draw: &Draw, value: f64, diverges: bool) -> [f64; 3] {
    let (low, high) = (f64::from(draw.range.low), f64::from(draw.range.high));
    let place = match draw.scale {
        Scale::Log if !diverges && value <= 0.0 => 0.0,
        Scale::Log if !diverges => (value / low).log2() / (high / low).log2(),
        _ => (value - low) / (high - low),
    };
    let colormap = if diverges { Colormap::Diverging } else { draw.colormap };
    colormap.color(place as f32).map(f64::from)
}

fn number(draw: &Draw, values: &[f64]) -> f64 {
    match draw.channel {
        Channel::All => values.iter().sum::<f64>() / values.len() as f64,
        channel => values
            .get(channel as usize - 1)
            .copied()
            .unwrap_or_else(|| values.iter().sum::<f64>() / values.len() as f64),
    }
}

/// The mean over what a pixel of the target covers.
fn fetch(draw: &Draw, image: &Image, x: f64, y: f64) -> Vec<f64> {
    let taps = draw.step.ceil().clamp(1.0, 8.0) as usize;
    let at = |place: f64, size: u32| (place.floor() as i64).clamp(0, i64::from(size) - 1) as usize;
    let tap = |index: usize| ((index as f64 + 0.5) / taps as f64 - 0.5) * f64::from(draw.step);
    let mean = |plane: &Vec<f32>| {
        let mut sum = 0.0;
        for row in 0..taps {
            for column in 0..taps {
                sum += f64::from(
                    plane[at(y + tap(row), EXTENT.height) * EXTENT.width as usize + at(x + tap(column), EXTENT.width)],
                );
            }
        }
        sum / (taps * taps) as f64
    };
    image.planes.iter().map(mean).collect()
}

/// What a pixel of the target shows. `None` where a value is not finite: the pixel is chequered.
fn expected(draw: &Draw, x: u32, y: u32) -> Option<[f64; 3]> {
    let place = |first: f32, at: u32| f64::from(first) + (f64::from(at) + 0.5) * f64::from(draw.step);
    let (x, y) = (place(draw.first[0], x), place(draw.first[1], y));
    if x < 0.0 || y < 0.0 || x >= f64::from(EXTENT.width) || y >= f64::from(EXTENT.height) {
        return Some(BACKGROUND.map(f64::from));
    }
    let a = fetch(draw, &draw.a.image, x, y);
    let b = draw.b.as_ref().map(|b| fetch(draw, &b.image, x, y));
    if a.iter().chain(b.iter().flatten()).any(|value| !value.is_finite()) {
        return None;
    }
    if let Some(b) = b {
        let (a, b) = (number(draw, &a), number(draw, &b));
        let difference = if draw.operation == Operation::Relative {
            (a - b) / (b.abs() + f64::from(RELATIVE_EPSILON))
        } else {
            a - b
        };
        return Some(false_color(draw, difference, true));
    }
    let single = draw.channel != Channel::All;
    let channels = if single { vec![number(draw, &a); 3] } else { a.clone() };
    let each = |color: &dyn Fn(f64) -> f64| Some([color(channels[0]), color(channels[1]), color(channels[2])]);
    match draw.kind {
        Kind::Color => each(&|value| tone_mapped(draw, value)),
        Kind::Direction => each(&|value| (value * 0.5 + 0.5).clamp(0.0, 1.0)),
        Kind::Shares => each(&|value| value.clamp(0.0, 1.0)),
        Kind::Scalar(_) => Some(false_color(draw, number(draw, &a), draw.scale == Scale::Diverging)),
    }
}

fn check(picture: &Picture, draw: &Draw, what: &str) {
    for y in 0..SIDE as u32 {
        for x in 0..SIDE as u32 {
            let found = picture.pixel(x, y);
            match expected(draw, x, y) {
                Some(expected) => {
                    let off = found
                        .iter()
                        .zip(expected)
                        .map(|(found, expected)| (f64::from(*found) - 255.0 * expected).abs())
                        .fold(0.0, f64::max);
                    assert!(
                        off <= TOLERANCE,
                        "{what}: ({x}, {y}) is {found:?}, expected {:?}",
                        expected.map(|channel| 255.0 * channel)
                    );
                }
                None => assert!(
                    [[0, 0, 0], [255, 0, 255]].contains(&found),
                    "{what}: ({x}, {y}) is {found:?}, but not finite"
                ),
            }
        }
    }
}

#[test]
fn the_shader_shows_what_the_formulas_say() {
    let gpu = Gpu::open(&DeviceChoice::Auto).unwrap();
    let mut window = Offscreen::new(&gpu, SIDE, SIDE, 1.0).unwrap();
    let mut slots = Slots::new().unwrap();
    let mut check = |draw: &Draw, what: &str| check(&on_gpu(&mut window, &mut slots, draw), draw, what);

    let color = draw(image(3, 1), Kind::Color);
    for tone in Tone::ALL {
        check(&Draw { tone, ..color.clone() }, tone.title());
    }
    for channel in Channel::ALL {
        check(&Draw { channel, ..color.clone() }, channel.title());
        check(&Draw { channel, ..draw(image(2, 2), Kind::Scalar(Scale::Linear)) }, "two channels");
    }
    for kind in [Kind::Direction, Kind::Shares] {
        check(&draw(image(3, 3), kind), "a direction, or shares");
    }
    for scale in [Scale::Linear, Scale::Log, Scale::Diverging] {
        for (seed, colormap) in (4..).zip(Colormap::SEQUENTIAL) {
            check(&Draw { scale, colormap, ..draw(image(1, seed), Kind::Scalar(scale)) }, "numbers");
        }
    }
    check(&Draw { step: 0.93, first: [-20.1, -20.2], ..color.clone() }, "beyond the image");
    check(&Draw { step: 2.43, first: [-3.1, -5.3], ..color.clone() }, "reduced");
    let b = Some(Shown::new(image(1, 9)));
    for operation in [Operation::Difference, Operation::Relative] {
        check(&Draw { operation, b: b.clone(), range: Range { low: -2.0, high: 2.0 }, ..color.clone() }, "two layers");
    }
}

#[test]
fn what_is_not_finite_is_marked() {
    let gpu = Gpu::open(&DeviceChoice::Auto).unwrap();
    let mut window = Offscreen::new(&gpu, SIDE, SIDE, 1.0).unwrap();
    let mut slots = Slots::new().unwrap();
    for (channels, kind) in [(3, Kind::Color), (1, Kind::Scalar(Scale::Log)), (3, Kind::Direction)] {
        let mut damaged = Image::clone(&image(channels, 7));
        for (pixel, value) in
            [(0, f32::NAN), (20, f32::INFINITY), (40, f32::NEG_INFINITY), (41, -f32::NAN), (116, f32::NAN)]
        {
            damaged.planes[channels - 1][pixel] = value;
        }
        let draw = draw(Arc::new(damaged), kind);
        check(&on_gpu(&mut window, &mut slots, &draw), &draw, "damaged");
        let both = Draw { b: Some(Shown::new(image(1, 8))), operation: Operation::Difference, ..draw };
        check(&on_gpu(&mut window, &mut slots, &both), &both, "damaged, compared");
    }
}
