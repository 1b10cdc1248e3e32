//! Layers that are filtered along with the colour: they take the colour's own weights, in all methods.

use stein::frame::{PayloadKind, PayloadLayer, SamplesPerPixel, Signal};
use stein::method::{Intermediate, Spikes};
use stein::{
    Denoiser, DfcParams, Estimate, Extent, Frame, GemParams, Image, Method, NlmParams, Options, PayloadLeft, Preset,
};

use crate::behaviour::{calm_frame, memory_for_strips_of_window, random_frame};
use crate::common::gpu;
use crate::frames::{self, EVERYTHING, Keep};
use crate::reference::random::Random;

const WIDTH: usize = 53;
const HEIGHT: usize = 39;

/// Methods with small windows, of both presets.
fn methods() -> Vec<Method> {
    let mut methods = Vec::new();
    for preset in Preset::ALL {
        for method in Method::all() {
            let method = method.of_preset(*preset);
            methods.push(method.with_window_radius(4));
        }
    }
    // All that the presets leave out or take in.
    methods.push(DfcParams { window_radius: 4, spikes: Spikes::Clamp, ..DfcParams::default() }.into());
    methods
        .push(DfcParams { window_radius: 4, spikes: Spikes::Keep, second_pass: None, ..DfcParams::default() }.into());
    methods.push(NlmParams { window_radius: 4, dual_buffer: false, ..NlmParams::default() }.into());
    methods
}

/// A part of a render with planted spikes and a planted light of one pixel.
fn with_spikes(seed: usize, keep: Keep) -> Frame {
    let set = frames::noisy("dof_spheres_32spp");
    let frame = frames::frame(&set, [8 * seed, 5, WIDTH, HEIGHT], keep);
    let mut color = frame.color().clone();
    let mut plant = |x: usize, y: usize, values: [f32; 3], relative_noise: f32| {
        for (channel, value) in values.into_iter().enumerate() {
            let pixel = y * WIDTH + x;
            color.mean.planes[channel][pixel] = value;
            let spread = value * relative_noise;
            if let Some(spreads) = &mut color.half_spread {
                spreads.planes[channel][pixel] = spread;
            }
            if let Some(variance) = &mut color.variance_of_mean {
                variance.planes[channel][pixel] = spread * spread;
            }
        }
    };
    plant(20, 11, [900.0, 500.0, 30.0], 1.0);
    plant(21, 11, [90.0, 600.0, 30.0], 1.0);
    plant(40, 30, [70.0, 0.0, 55.0], 0.9);
    plant(9, 28, [300.0, 280.0, 260.0], 0.001);
    let features = set.features().filter(|(name, _)| keep.features.contains(name));
    let features = features.map(|(name, raw)| {
        let crop = |image: &Image| frames::cropped(image, 8 * seed, 5, WIDTH, HEIGHT);
        let halves = raw.half_a.as_ref().zip(raw.half_b.as_ref()).filter(|_| keep.halves);
        let half_spread = halves.map(|(a, b)| stein::frame::half_spread(&crop(a), &crop(b), 1.0, 1.0));
        (name.to_owned(), Signal { mean: crop(&raw.mean), half_spread, variance_of_mean: None })
    });
    frames::new_frame(color, features.collect())
}

fn layer(name: &str, mean: &Image, half_spread: Option<&Image>) -> PayloadLayer {
    PayloadLayer { name: name.into(), kind: PayloadKind::Light, mean: mean.clone(), half_spread: half_spread.cloned() }
}

fn with_payload(frame: Frame, layers: Vec<PayloadLayer>) -> Frame {
    frame.with_payload(layers).unwrap_or_else(|error| panic!("{error}")).0
}

/// The frame with its colour as a layer, too.
fn with_itself(frame: Frame) -> Frame {
    let own = layer("itself", &frame.color().mean, frame.color().half_spread.as_ref());
    with_payload(frame, vec![own])
}

/// Parts of the colour that add up to it but for rounding: three lights, whose shares vary from pixel to pixel.
fn lights(frame: &Frame) -> [PayloadLayer; 3] {
    let mut random = Random(3);
    let shares: Vec<[f32; 3]> = (0..WIDTH * HEIGHT)
        .map(|_| {
            let parts = [0; 3].map(|_| random.uniform() as f32);
            parts.map(|part| part / parts.iter().sum::<f32>())
        })
        .collect();
    [0, 1, 2].map(|light| {
        let part = |image: &Image| Image {
            extent: image.extent,
            planes: image
                .planes
                .iter()
                .map(|plane| plane.iter().zip(&shares).map(|(value, shares)| value * shares[light]).collect())
                .collect(),
        };
        let spread = frame.color().half_spread.as_ref().map(part);
        layer(["key", "fill", "rim"][light], &part(&frame.color().mean), spread.as_ref())
    })
}

fn sum(images: &[&Image]) -> Image {
    let mut sum = images[0].clone();
    for image in &images[1..] {
        for (to, from) in sum.planes.iter_mut().zip(&image.planes) {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
    }
    sum
}

fn denoised(method: Method, frames: &[&Frame]) -> Estimate {
    let denoiser = Denoiser::new(gpu(), method).unwrap_or_else(|error| panic!("{error}"));
    denoise(&denoiser, frames)
}

fn denoise(denoiser: &Denoiser, frames: &[&Frame]) -> Estimate {
    denoiser.denoise_window(frames, frames.len() / 2, Options::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn assert_same_bits(actual: &Image, expected: &Image, what: &str) {
    let expected_extent = expected.extent;
    for (channel, (actual, expected)) in actual.planes.iter().zip(&expected.planes).enumerate() {
        for (pixel, (actual, expected)) in actual.iter().zip(expected).enumerate() {
            let width = expected_extent.width as usize;
            let (x, y) = (pixel % width, pixel / width);
            assert!(
                actual.to_bits() == expected.to_bits(),
                "{what}: x {x}, y {y}, channel {channel}: {actual:e} instead of {expected:e}"
            );
        }
    }
}

/// Whether the method can filter a frame with this knowledge about its noise.
fn knows_noise(method: Method, keep: Keep) -> bool {
    keep.halves || keep.variance || method.pools_variance()
}

/// Kinds of knowledge about the noise, with and without features.
fn keeps() -> [Keep; 4] {
    [
        EVERYTHING,
        Keep { variance: false, ..EVERYTHING },
        Keep { halves: false, features: &["albedo"], ..EVERYTHING },
        Keep { halves: false, variance: false, features: &[] },
    ]
}

#[test]
fn a_layer_that_equals_the_colour_comes_out_equal_to_it() {
    for keep in keeps() {
        let frame = with_itself(with_spikes(0, keep));
        for method in methods() {
            if !knows_noise(method, keep) {
                continue;
            }
            let estimate = denoised(method, &[&frame]);
            let what = format!("{method:?}, halves {}, variance {}", keep.halves, keep.variance);
            assert_eq!(estimate.payload[0].left, None, "{what}");
            assert_same_bits(&estimate.payload[0].image, &estimate.color, &what);
            // The test plants spikes and lights; something was done about them.
            if method.spikes() != Spikes::Keep {
                assert!(estimate.spikes.is_some_and(|spikes| spikes.pixels > 0), "{what}");
            }
        }
    }
}

#[test]
fn a_layer_that_equals_the_colour_comes_out_equal_to_it_in_a_shot() {
    let frames: Vec<Frame> = (0..3).map(|seed| with_itself(with_spikes(seed, EVERYTHING))).collect();
    let frames: Vec<&Frame> = frames.iter().collect();
    for method in methods().into_iter().filter(Method::filters_in_time) {
        let estimate = denoised(method, &frames);
        assert_same_bits(&estimate.payload[0].image, &estimate.color, &format!("{method:?}"));
        let alone = denoised(method, &frames[1..2]);
        assert_ne!(alone.payload[0].image, estimate.payload[0].image, "{method:?}: the frames beside changed nothing");
    }
}

/// Features without noise bring in the filter by the colour only.
#[test]
fn a_layer_that_equals_the_colour_comes_out_equal_to_it_beside_the_filter_by_colour_only() {
    let noisy = with_spikes(0, Keep { features: &["albedo"], ..EVERYTHING });
    // A sharp edge that the colour does not have.
    let edge = (0..WIDTH * HEIGHT).map(|pixel| if pixel % WIDTH > 25 { 1.0 } else { 0.0 }).collect();
    let mean = Image { extent: noisy.extent(), planes: vec![edge] };
    let features = vec![("edge".to_owned(), Signal { mean, half_spread: None, variance_of_mean: None })];
    let frame = with_itself(frames::new_frame(noisy.color().clone(), features));
    let denoiser = Denoiser::new(gpu(), DfcParams { window_radius: 4, ..DfcParams::default() });
    let denoiser = denoiser.unwrap_or_else(|error| panic!("{error}"));
    let options = Options { keep: &[Intermediate::Selection], ..Options::default() };
    let estimate = denoiser.denoise_with(&frame, options).unwrap_or_else(|error| panic!("{error}"));
    let share = estimate.layers.iter().find(|layer| layer.name == "color_only_share");
    let share = share.unwrap_or_else(|| panic!("the filter by the colour only takes no part"));
    assert!(share.image.planes[0].iter().any(|share| *share > 0.1), "the filter by the colour only has no share");
    assert_same_bits(&estimate.payload[0].image, &estimate.color, "colour only");
}

#[test]
fn the_sum_of_denoised_lights_is_the_denoised_sum() {
    for keep in keeps() {
        let frame = with_spikes(0, keep);
        let lights = lights(&frame);
        let together = sum(&[&lights[0].mean, &lights[1].mean, &lights[2].mean]);
        let spreads: Vec<&Image> = lights.iter().filter_map(|light| light.half_spread.as_ref()).collect();
        let spread = (!spreads.is_empty()).then(|| sum(&spreads));
        let [key, fill, rim] = lights;
        let layers = vec![key, fill, rim, layer("sum", &together, spread.as_ref())];
        let frame = with_payload(frame, layers);
        for method in methods() {
            if !knows_noise(method, keep) {
                continue;
            }
            let estimate = denoised(method, &[&frame]);
            let images: Vec<&Image> = estimate.payload.iter().map(|layer| &layer.image).collect();
            let (of_parts, of_sum) = (sum(&images[..3]), images[3]);
            for (name, expected) in [("the denoised sum", of_sum), ("the denoised colour", &estimate.color)] {
                let noisy = frame.color().mean.planes.iter().flatten();
                let expected = expected.planes.iter().flatten();
                for ((of_parts, expected), noisy) in of_parts.planes.iter().flatten().zip(expected).zip(noisy) {
                    // A spike that stays is far brighter than its filtered value, and so are its rounding errors.
                    assert!(
                        (of_parts - expected).abs() <= 1e-5 * expected.abs().max(noisy.abs() / 16.0),
                        "{method:?}: the lights add up to {of_parts}, {name} is {expected}"
                    );
                }
            }
        }
    }
}

/// Layers of all shapes: packing and groups change nothing.
#[test]
fn layers_do_not_depend_on_each_other() {
    let frame = with_spikes(0, EVERYTHING);
    let mut random = Random(11);
    let layers: Vec<PayloadLayer> = [3, 1, 4, 2, 3, 1, 1, 3, 3, 1, 4, 3, 1]
        .into_iter()
        .enumerate()
        .map(|(index, channels)| {
            let planes = (0..channels).map(|_| (0..WIDTH * HEIGHT).map(|_| random.uniform() as f32).collect());
            let mean = Image { extent: frame.extent(), planes: planes.collect() };
            let name = format!("layer {index}");
            let kind = if channels == 1 { PayloadKind::Alpha } else { PayloadKind::Light };
            PayloadLayer { name, kind, mean, half_spread: None }
        })
        .collect();
    let together = with_payload(frame.clone(), layers.clone());
    for method in Method::all().into_iter().map(|method| method.with_window_radius(3)) {
        let estimate = denoised(method, &[&together]);
        let colour = denoised(method, &[&frame]);
        assert_same_bits(&estimate.color, &colour.color, "the colour beside layers");
        for (index, single) in layers.iter().enumerate() {
            let alone = denoised(method, &[&with_payload(frame.clone(), vec![single.clone()])]);
            assert_eq!(estimate.payload[index].name, single.name);
            assert_same_bits(&estimate.payload[index].image, &alone.payload[0].image, &single.name);
            assert_ne!(alone.payload[0].image, single.mean, "{}: it is not filtered", single.name);
        }
    }
}

#[test]
fn strips_and_skipped_steps_change_no_bit_of_a_layer() {
    let shot = [random_frame(24, 400, 1.0), calm_frame(24, 400), random_frame(24, 400, 0.5)].map(with_itself);
    let shot = shot.each_ref();
    for method in methods() {
        let window = if method.filters_in_time() { &shot[..] } else { &shot[..1] };
        let denoiser = Denoiser::new(gpu(), method).unwrap_or_else(|error| panic!("{error}"));
        let denoise = |denoiser: &Denoiser| {
            denoiser.denoise_window(window, 0, Options::default()).unwrap_or_else(|error| panic!("{error}"))
        };
        let whole = denoise(&denoiser);
        let limit = memory_for_strips_of_window(&denoiser, window, 2, &[]);
        let in_strips = denoise(&denoiser.clone().with_max_memory(limit));
        assert!(in_strips.strips > 1, "{method:?}: one strip");
        assert!(in_strips.peak_bytes <= limit, "{method:?}: {} of {limit} bytes", in_strips.peak_bytes);
        let layer = |estimate: &Estimate| estimate.payload[0].image.clone();
        assert_same_bits(&layer(&in_strips), &layer(&whole), &format!("{method:?}, strips"));
        let everything = denoise(&denoiser.with_everything());
        assert_same_bits(&layer(&everything), &layer(&whole), &format!("{method:?}, everything"));
    }
}

/// Layers that do not fit together are filtered in several rounds.
#[test]
fn rounds_change_no_bit_of_a_layer() {
    let frame = with_spikes(0, EVERYTHING);
    let mut random = Random(12);
    let mut plane = || (0..WIDTH * HEIGHT).map(|_| random.uniform() as f32).collect();
    let layers = (0..33).map(|index| {
        let mean = Image { extent: frame.extent(), planes: vec![plane(), plane(), plane()] };
        layer(&format!("light {index}"), &mean, None)
    });
    let frame = with_payload(frame.clone(), layers.collect());
    for method in Method::all() {
        let denoiser = Denoiser::new(gpu(), method.with_window_radius(3)).unwrap_or_else(|error| panic!("{error}"));
        let whole = denoise(&denoiser, &[&frame]);
        assert_eq!((whole.plan.rounds, whole.strips), (1, 1));
        // As much as one group of layers takes. The halo is as high as the frame, so that strips save little.
        let few = with_payload(frame.clone(), frame.payload()[..4].to_vec());
        let limit = denoiser.requirements(&[&few], 0, &Options::default()).unwrap_or_else(|error| panic!("{error}"));
        let in_rounds = denoise(&denoiser.with_max_memory(limit.peak_bytes), &[&frame]);
        assert!(in_rounds.plan.rounds > 1, "{}: one round", method.name());
        assert!(in_rounds.peak_bytes <= limit.peak_bytes, "{}", method.name());
        assert_same_bits(&in_rounds.color, &whole.color, "the colour");
        assert_eq!(in_rounds.error, whole.error);
        for (in_rounds, whole) in in_rounds.payload.iter().zip(&whole.payload) {
            assert_same_bits(&in_rounds.image, &whole.image, &whole.name);
        }
    }
}

#[test]
fn forty_layers_stay_within_the_memory_limit() {
    let extent = Extent { width: 512, height: 512 };
    let mut random = Random(4);
    let mut noise = |sigma: f64| {
        let plane: Vec<f32> = (0..extent.pixels()).map(|_| (sigma * (random.uniform() - 0.5)) as f32).collect();
        Image { extent, planes: vec![plane; 3] }
    };
    let mut mean = noise(0.2);
    mean.planes.iter_mut().flatten().for_each(|value| *value += 1.0);
    let variance_of_mean = Some(Image::filled(extent, 3, 0.2 * 0.2 / 12.0));
    let color = Signal { mean, half_spread: Some(noise(0.2)), variance_of_mean };
    let (frame, _) = Frame::new(color, Vec::new(), SamplesPerPixel::Unknown).unwrap_or_else(|error| panic!("{error}"));
    let layers = (0..40).map(|index| PayloadLayer {
        name: format!("light {index}"),
        kind: PayloadKind::Light,
        mean: noise(1.0),
        half_spread: None,
    });
    let frame = with_payload(frame, layers.collect());
    let params = DfcParams { window_radius: 1, ..DfcParams::default() };
    let limit = 256 << 20;
    let denoiser = Denoiser::new(gpu(), params).unwrap_or_else(|error| panic!("{error}")).with_max_memory(limit);
    let estimate = denoise(&denoiser, &[&frame]);
    assert!(estimate.peak_bytes <= limit, "{} of {limit} bytes", estimate.peak_bytes);
    for (denoised, layer) in estimate.payload.iter().zip(frame.payload()) {
        let deviation = |image: &Image| {
            image.planes[0].iter().map(|value| f64::from(value * value)).sum::<f64>() / extent.pixels() as f64
        };
        let (before, after) = (deviation(&layer.mean), deviation(&denoised.image));
        assert!(after < 0.3 * before, "{}: {after} of {before}", layer.name);
    }
}

#[test]
fn alpha_stays_an_opacity() {
    let frame = with_spikes(0, EVERYTHING);
    // A spike is opaque where nothing else is, and transparent where all else is opaque.
    let mut alpha = vec![1.0; WIDTH * HEIGHT];
    alpha[..WIDTH * HEIGHT / 2].fill(0.0);
    for (x, y, value) in [(20, 11, 1.0), (21, 11, 1.0), (40, 30, 0.0)] {
        alpha[y * WIDTH + x] = value;
    }
    let mean = Image { extent: frame.extent(), planes: vec![alpha] };
    let alpha = PayloadLayer { name: "A".into(), kind: PayloadKind::Alpha, mean, half_spread: None };
    let frame = with_payload(frame, vec![alpha]);
    for method in methods() {
        let estimate = denoised(method, &[&frame]);
        let plane = &estimate.payload[0].image.planes[0];
        assert!(plane.iter().all(|value| (0.0..=1.0).contains(value)), "{method:?}");
        // Every method averages far less than half of the image.
        let (top, bottom) = (plane[WIDTH + 1], plane[WIDTH * HEIGHT - 2]);
        assert!(top < 0.1 && bottom > 0.9, "{method:?}: {top} and {bottom} far from the edge");
    }
}

/// A premultiplied disc whose rim is blurred over 16 pixels; colour and alpha come from the same 16 samples per pixel.
#[test]
fn a_noisy_rim_keeps_its_colour_and_loses_its_noise() {
    const SIDE: usize = 64;
    const SAMPLES: usize = 16;
    const COLOR: [f32; 3] = [0.8, 0.4, 0.2];
    let extent = Extent { width: SIDE as u32, height: SIDE as u32 };
    let mut random = Random(16);
    let distance = |pixel: usize| {
        let from_middle = |position: usize| position as f64 + 0.5 - SIDE as f64 / 2.0;
        from_middle(pixel % SIDE).hypot(from_middle(pixel / SIDE))
    };
    let truth: Vec<f32> =
        (0..extent.pixels()).map(|pixel| ((24.0 - distance(pixel)) / 16.0).clamp(0.0, 1.0) as f32).collect();
    let (mut alpha, mut spread, mut variance) = (Vec::new(), Vec::new(), Vec::new());
    for pixel in 0..extent.pixels() {
        let mut hits = [0.0_f32; 2];
        for sample in 0..SAMPLES {
            let is_hit = distance(pixel) < 8.0 + 16.0 * random.uniform();
            hits[sample % 2] += if is_hit { 1.0 } else { 0.0 };
        }
        let (half, all) = (SAMPLES as f32 / 2.0, SAMPLES as f32);
        let mean = (hits[0] + hits[1]) / all;
        alpha.push(mean);
        spread.push((hits[0] - hits[1]) / half / 2.0);
        variance.push(mean * (1.0 - mean) / (all - 1.0));
    }
    let of_color = |values: &[f32], power: i32| Image {
        extent,
        planes: COLOR.iter().map(|color| values.iter().map(|value| value * color.powi(power)).collect()).collect(),
    };
    let color = Signal {
        mean: of_color(&alpha, 1),
        half_spread: Some(of_color(&spread, 1)),
        variance_of_mean: Some(of_color(&variance, 2)),
    };
    let image = |plane: &[f32]| Image { extent, planes: vec![plane.to_vec()] };
    let layer = PayloadLayer {
        name: "A".into(),
        kind: PayloadKind::Alpha,
        mean: image(&alpha),
        half_spread: Some(image(&spread)),
    };
    let frame = with_payload(frames::new_frame(color, Vec::new()), vec![layer]);
    // Squared error of the picture over a white background.
    let error = |color: &Image, alpha: &[f32]| -> f64 {
        let channel = |(channel, plane): (usize, &Vec<f32>)| -> f64 {
            let over = |value: f32, alpha: f32| f64::from(value + 1.0 - alpha);
            let values = plane.iter().zip(alpha).zip(&truth);
            values
                .map(|((value, alpha), truth)| (over(*value, *alpha) - over(COLOR[channel] * truth, *truth)).powi(2))
                .sum()
        };
        color.planes.iter().enumerate().map(channel).sum()
    };
    for method in Method::all() {
        let estimate = denoised(method, &[&frame]);
        let denoised = &estimate.payload[0].image.planes[0];
        let (before, after) = (error(&frame.color().mean, &alpha), error(&estimate.color, denoised));
        let with_noisy_alpha = error(&estimate.color, &alpha);
        assert!(after < 0.4 * before, "{}: error {after} of {before}", method.name());
        assert!(after < 0.4 * with_noisy_alpha, "{}: {after}, with the noisy alpha {with_noisy_alpha}", method.name());
        for (pixel, alpha) in denoised.iter().enumerate() {
            for (plane, color) in estimate.color.planes.iter().zip(COLOR) {
                let rounding = 1e-6 + 1e-4 * alpha * color;
                assert!(
                    (plane[pixel] - alpha * color).abs() <= rounding,
                    "{}: {} over {alpha}",
                    method.name(),
                    plane[pixel]
                );
            }
            let is_far = distance(pixel) > 24.0 + f64::from(method.window_radius()) / 2.0;
            assert!(!is_far || *alpha < 1e-3, "{}: alpha {alpha} far from the disc", method.name());
        }
    }
}

#[test]
fn layers_that_cannot_change_or_that_a_frame_lacks_stay_as_they_are() {
    let shot: Vec<Frame> = (0..2).map(|seed| with_spikes(seed, EVERYTHING)).collect();
    let opaque = Image::filled(shot[0].extent(), 1, 1.0);
    let opaque = PayloadLayer { name: "A".into(), kind: PayloadKind::Alpha, mean: opaque, half_spread: None };
    let key = layer("key", &shot[0].color().mean, None);
    let own = with_payload(shot[0].clone(), vec![opaque.clone(), key.clone()]);
    let beside = with_payload(shot[1].clone(), vec![opaque]);
    let estimate = denoised(DfcParams { window_radius: 3, ..DfcParams::default() }.into(), &[&beside, &own]);
    let left: Vec<_> = estimate.payload.iter().map(|layer| layer.left).collect();
    assert_eq!(left, [Some(PayloadLeft::Constant), Some(PayloadLeft::LackedBeside)]);
    assert!(estimate.payload[0].image.planes[0].iter().all(|alpha| *alpha == 1.0));
    assert_same_bits(&estimate.payload[1].image, &key.mean, "key");
    // The plan names the step only where it runs.
    let names = |estimate: &Estimate| -> Vec<String> {
        estimate.plan.steps().iter().map(|step| step.name.clone()).filter(|name| name == "layers along").collect()
    };
    assert!(names(&estimate).is_empty());
    let estimate = denoised(GemParams::default().into(), &[&own]);
    assert_eq!(names(&estimate), ["layers along"]);
}

#[test]
fn damaged_layers_are_repaired_or_left_out() {
    let frame = with_spikes(0, EVERYTHING);
    let mut damaged = frame.color().mean.clone();
    damaged.planes[1][77] = f32::NAN;
    damaged.planes[2][78] = f32::INFINITY;
    let hopeless = Image::filled(frame.extent(), 1, f32::NAN);
    let layers = vec![layer("damaged", &damaged, None), layer("hopeless", &hopeless, None)];
    let (frame, repairs) = frame.with_payload(layers).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(frame.payload().len(), 1);
    assert!(frame.payload()[0].mean.planes.iter().flatten().all(|value| value.is_finite()));
    assert_eq!(repairs.layer("damaged").map(|repaired| repaired.pixels_replaced), Some(2));
    assert!(repairs.to_string().contains("layer hopeless: not one pixel has a usable value"), "{repairs}");
    let other = Image::filled(Extent { width: 3, height: 3 }, 1, 0.0);
    let refused = frame.clone().with_payload(vec![layer("small", &other, None)]);
    assert!(refused.is_err_and(|error| error.to_string().contains("small")));
    let five = Image::filled(frame.extent(), 5, 0.0);
    let refused = frame.with_payload(vec![layer("five", &five, None)]);
    assert!(refused.is_err_and(|error| error.to_string().contains("layer five has 5 planes")));
}
