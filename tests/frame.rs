//! From raw signals to frames: what is repaired, left out and refused.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::{Path, PathBuf};

use stein::frame::{
    Contradiction, Frame, LargeVariance, NoiseKnowledge, Repairs, SamplesPerPixel, Signal, half_spread,
};
use stein::image::{Extent, Image};
use stein_exr::{BufferSet, BufferSetRequest, NamedLayer, read_reference, write_layers};
use stein_metric as metric;

const EXTENT: Extent = Extent { width: 4, height: 3 };

fn image(plane: [f32; 12], channels: usize) -> Image {
    Image { extent: EXTENT, planes: vec![plane.to_vec(); channels] }
}

fn flat(value: f32, channels: usize) -> Image {
    Image::filled(EXTENT, channels, value)
}

/// A colour that brightens from pixel to pixel, with halves and variance.
fn color() -> Signal {
    let mean = image(std::array::from_fn(|pixel| 1.0 + pixel as f32), 3);
    Signal { mean, half_spread: Some(flat(0.5, 3)), variance_of_mean: Some(flat(0.25, 3)) }
}

fn depth(mean: [f32; 12]) -> (String, Signal) {
    let mean = image(mean, 1);
    ("depth".into(), Signal { mean, half_spread: Some(flat(2.0, 1)), variance_of_mean: Some(flat(8.0, 1)) })
}

fn ramp() -> [f32; 12] {
    std::array::from_fn(|pixel| 10.0 + 2.0 * pixel as f32)
}

fn frame(color: Signal, features: Vec<(String, Signal)>) -> (Frame, Repairs) {
    Frame::new(color, features, SamplesPerPixel::Unknown).unwrap()
}

fn failure(color: Signal, features: Vec<(String, Signal)>) -> String {
    Frame::new(color, features, SamplesPerPixel::Unknown).map(|_| ()).unwrap_err().to_string()
}

fn testdata(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata").join(name)
}

fn assert_finite(frame: &Frame) {
    for signal in std::iter::once(frame.color()).chain(frame.features().iter().map(|feature| &feature.signal)) {
        let images = [Some(&signal.mean), signal.half_spread.as_ref(), signal.variance_of_mean.as_ref()];
        assert!(images.into_iter().flatten().flat_map(|image| &image.planes).flatten().all(|value| value.is_finite()));
        let variance = signal.variance_of_mean.iter().flat_map(|image| &image.planes).flatten();
        assert!(variance.copied().all(|value| value >= 0.0));
    }
}

#[test]
fn equal_halves_give_the_variance_of_the_mean_and_not_of_one_half() {
    let (a, b) = (flat(7.0, 1), flat(3.0, 1));
    let spread = half_spread(&a, &b, 1.0, 1.0).planes[0][0];
    // (A − B)²/4, not the (A − B)²/2 of chapter 7.
    assert_eq!(spread * spread, 16.0 / 4.0);
    assert_eq!((5.0 + spread, 5.0 - spread), (7.0, 3.0), "the halves are mean ± spread");
    // (A − B)²·n_A·n_B/n² = 16·3/16.
    let unequal = half_spread(&a, &b, 3.0, 1.0).planes[0][0];
    assert!((unequal * unequal - 3.0).abs() < 1e-5);
    assert!((half_spread(&a, &b, 24.0, 8.0).planes[0][0] - unequal).abs() < 1e-6);
}

#[test]
fn the_two_buffer_variance_of_a_real_render_agrees_with_its_sample_variance() {
    let input = testdata("dof_spheres_32spp.exr");
    let set = BufferSet::read(&BufferSetRequest { input, ..BufferSetRequest::default() }).unwrap();
    let (frame, repairs) = set.to_frame().unwrap();
    assert!(repairs.is_empty(), "{repairs}");
    let color = frame.color();
    let sum = |image: &Image, power: i32| -> f64 {
        image.planes.iter().flatten().map(|value| f64::from(*value).powi(power)).sum()
    };
    let two_buffer = sum(color.half_spread.as_ref().unwrap(), 2);
    let ratio = two_buffer / sum(color.variance_of_mean.as_ref().unwrap(), 1);
    assert!((0.8..1.25).contains(&ratio), "a factor of two is lost: {ratio}");
    // The prediction without a reference has the size of the true error.
    let reference = read_reference(&testdata("dof_spheres_reference.exr"), None).unwrap();
    let error = metric::relative_mse(&color.mean, &reference).unwrap();
    let level = frame.noise_level().unwrap();
    assert!((0.6..1.6).contains(&(level / error)), "{level} {error}");
    assert_eq!(frame.features().len(), 4);
    assert_eq!(*frame.samples_per_pixel(), SamplesPerPixel::Uniform(32.0));
    assert_finite(&frame);
}

#[test]
fn nan_values_take_their_neighbours_value() {
    let mut poisoned = color();
    poisoned.mean.planes[1][0] = f32::NAN;
    let (frame, repairs) = frame(poisoned, vec![]);
    // The neighbours of pixel 0 are 1, 4 and 5, with their number plus one as value: 13/3 on average.
    let first = [0, 1, 2].map(|channel| frame.color().mean.planes[channel][0]);
    assert_eq!(first, [1.0, 13.0 / 3.0, 1.0], "the damaged channel alone is replaced");
    assert!(
        frame.color().mean.planes.iter().all(|plane| plane[1..] == color().mean.planes[0][1..]),
        "no other pixel is"
    );
    let found = repairs.layer("colour").unwrap();
    assert_eq!((found.nan_values, found.pixels_replaced, found.variances_replaced), (1, 1, 0));
    assert!(repairs.to_string().contains("1 values NaN") && repairs.to_string().contains("mean G 1"), "{repairs}");
}

/// The values of the neighbours show which pixels and channels were replaced.
#[test]
fn damage_is_counted_and_repaired_by_image_and_channel() {
    let ramp = |from: f32| image(std::array::from_fn(|pixel| from + pixel as f32), 3);
    let sound = Signal { mean: ramp(1.0), half_spread: Some(ramp(100.0)), variance_of_mean: Some(ramp(1000.0)) };
    let mut damaged = sound.clone();
    damaged.mean.planes[0][0] = f32::INFINITY;
    damaged.mean.planes[1][11] = f32::NEG_INFINITY;
    damaged.half_spread.as_mut().unwrap().planes[2][3] = f32::NAN;
    damaged.variance_of_mean.as_mut().unwrap().planes[0][8] = f32::INFINITY;
    let (frame, repairs) = frame(damaged, vec![]);
    assert_finite(&frame);

    // Channel and pixel, and the images that are replaced there; neighbours lie inwards, so that their average differs.
    let replaced = [
        (0, 0, "mean halves variance"),
        (1, 11, "mean halves variance"),
        (2, 3, "mean halves variance"),
        (0, 8, "variance"),
    ];
    let repaired = frame.color();
    let images = |signal: &Signal| {
        [signal.mean.clone(), signal.half_spread.clone().unwrap(), signal.variance_of_mean.clone().unwrap()]
    };
    for (name, (before, after)) in
        ["mean", "halves", "variance"].into_iter().zip(images(&sound).iter().zip(&images(repaired)))
    {
        for (channel, pixel) in (0..3).flat_map(|channel| (0..12).map(move |pixel| (channel, pixel))) {
            let is_replaced =
                replaced.iter().any(|(c, p, images)| (*c, *p) == (channel, pixel) && images.contains(name));
            let differs = before.planes[channel][pixel] != after.planes[channel][pixel];
            assert_eq!(differs, is_replaced, "{name}, channel {channel}, pixel {pixel}");
        }
    }
    let found = repairs.layer("colour").unwrap();
    assert_eq!(
        (found.infinite_values, found.nan_values, found.pixels_replaced, found.variances_replaced),
        (3, 1, 3, 1)
    );
    let places: Vec<_> =
        found.damage.iter().map(|damage| format!("{} {} {}", damage.image, damage.channel, damage.values)).collect();
    assert_eq!(places, ["mean R 1", "variance R 1", "mean G 1", "halves B 1"]);
}

#[test]
fn infinite_oversized_and_spoilt_half_pixels_leave_no_trace() {
    let mut poisoned = color();
    poisoned.mean.planes[0][0] = f32::INFINITY;
    poisoned.mean.planes[0][11] = -1e30;
    poisoned.half_spread.as_mut().unwrap().planes[2][6] = f32::NEG_INFINITY;
    let (frame, repairs) = frame(poisoned, vec![]);
    assert_finite(&frame);
    assert!(frame.color().mean.planes.iter().flatten().all(|value| (1.0..=12.0).contains(value)));
    assert_eq!(frame.color().half_spread.as_ref().unwrap().planes[2][6], 0.5);
    let found = repairs.layer("colour").unwrap();
    assert_eq!((found.infinite_values, found.oversized_values, found.pixels_replaced), (2, 1, 3));
}

#[test]
fn a_bad_variance_alone_leaves_the_pixel_alone() {
    let mut poisoned = color();
    let variance = &mut poisoned.variance_of_mean.as_mut().unwrap().planes;
    variance[0][5] = f32::NAN;
    variance[1][2] = -1e-9;
    variance[1][3] = -0.5;
    let (frame, repairs) = frame(poisoned, vec![]);
    assert_eq!(frame.color().mean, color().mean);
    let variance = &frame.color().variance_of_mean.as_ref().unwrap().planes;
    assert_eq!((variance[0][5], variance[1][2], variance[1][3]), (0.25, 0.0, 0.0));
    let found = repairs.layer("colour").unwrap();
    assert_eq!((found.pixels_replaced, found.variances_replaced, found.negative_variances), (0, 1, 2));
}

#[test]
fn half_an_image_of_nan_is_filled_always_the_same() {
    // At this size, a search for the nearest usable pixel from each unusable one would take too long.
    let extent = Extent { width: 600, height: 600 };
    let value = |pixel: usize| {
        if pixel % 600 < 300 { f32::NAN } else { (pixel % 7) as f32 }
    };
    let poisoned = || Signal {
        mean: Image { extent, planes: vec![(0..extent.pixels()).map(value).collect(); 3] },
        half_spread: None,
        variance_of_mean: Some(Image::filled(extent, 3, 1.0)),
    };
    let (first, _) = frame(poisoned(), vec![]);
    let (second, _) = frame(poisoned(), vec![]);
    assert_eq!(first.color().mean, second.color().mean);
    assert!(first.color().mean.planes[0].iter().all(|value| (0.0..=6.0).contains(value)));
}

#[test]
fn a_colour_without_one_usable_pixel_is_an_error_that_names_it() {
    let dead = Signal { mean: flat(f32::NAN, 3), ..color() };
    assert!(failure(dead, vec![]).contains("layer colour: not one pixel has a usable value\n"));
    let mut blue = color();
    blue.mean.planes[2].fill(f32::INFINITY);
    assert!(failure(blue, vec![]).contains("not one pixel has a usable value in B"));
}

/// A frame whose noise is estimated from the image itself, and the refusal if that is not allowed.
#[track_caller]
fn assert_image_only((frame, repairs): (Frame, Repairs), said: &[&str]) {
    assert_eq!(
        (frame.noise_knowledge(), frame.color().noise_knowledge(), frame.noise_level()),
        (NoiseKnowledge::ImageOnly, None, None)
    );
    assert!(frame.color().half_spread.is_none() && frame.color().variance_of_mean.is_none());
    let remark =
        repairs.notes.iter().find(|note| note.starts_with("colour: its noise is estimated from the image itself"));
    assert!(
        remark.is_some_and(|remark| ["different seeds", "give both"].iter().all(|word| remark.contains(word))),
        "{repairs}"
    );
    assert!(
        !repairs.to_string().contains("no second pass") && !repairs.to_string().contains("nothing is filtered"),
        "{repairs}"
    );
    let refused = frame.require_noise(&repairs).unwrap_err().to_string();
    for word in [&["nothing is known of the colour's noise", "different seeds", "remedy: "], said].concat() {
        assert!(refused.contains(word), "no '{word}' in {refused}");
    }
    assert!(!refused.contains("is estimated from the image itself"), "{refused}");
}

#[test]
fn without_halves_and_variance_that_can_be_used_the_noise_is_estimated_from_the_image() {
    let with = |half_spread: Option<Image>, variance_of_mean: Option<Image>| {
        frame(Signal { half_spread, variance_of_mean, ..color() }, vec![])
    };
    let neither = with(None, None);
    assert_eq!(neither.1.notes.len(), 1, "{}", neither.1);
    assert_image_only(neither, &["neither two halves nor a variance", "give both as halves", "layer `variance`"]);
    let infinite = || Some(flat(f32::INFINITY, 3));
    assert_image_only(with(None, infinite()), &["the variance has no usable value", "image viewer"]);
    assert_image_only(with(infinite(), None), &["the halves have no usable value", "image viewer"]);
    assert_image_only(
        with(infinite(), infinite()),
        &["the halves have no usable value", "the variance has no usable value"],
    );
    assert_image_only(with(Some(flat(0.5, 1)), None), &["halves of 1 channels do not fit a mean of 3"]);
    // The halves and the variance are kept.
    for known in [
        with(Some(flat(0.5, 3)), infinite()),
        with(infinite(), Some(flat(0.25, 3))),
        with(Some(flat(0.0, 3)), Some(flat(0.25, 3))),
    ] {
        assert_ne!(known.0.noise_knowledge(), NoiseKnowledge::ImageOnly);
        assert!(known.0.noise_level().is_some_and(|level| level > 0.0) && known.0.require_noise(&known.1).is_ok());
    }
}

#[test]
fn a_frame_can_be_told_less_of_its_noise() {
    use NoiseKnowledge::{HalvesAndVariance, HalvesOnly, ImageOnly, VarianceOnly};
    let (full, _) = frame(color(), vec![depth(ramp())]);
    for knowledge in [HalvesAndVariance, HalvesOnly, VarianceOnly, ImageOnly] {
        let less = full.with_noise_known_from(knowledge).unwrap();
        assert_eq!(less.noise_knowledge(), knowledge);
        let signals = |frame: &Frame| [frame.color().clone(), frame.features()[0].signal.clone()];
        for (less, full) in signals(&less).iter().zip(&signals(&full)) {
            assert_eq!(less.mean, full.mean);
            assert_eq!(less.half_spread, full.half_spread.clone().filter(|_| knowledge.has_halves()));
            assert_eq!(less.variance_of_mean, full.variance_of_mean.clone().filter(|_| knowledge.has_variance()));
        }
        let again = less.with_noise_known_from(HalvesOnly);
        assert_eq!(again.is_some(), knowledge.has_halves(), "what is not known cannot be given");
        assert_eq!(less.with_noise_known_from(VarianceOnly).is_some(), knowledge.has_variance());
    }
}

#[test]
fn what_is_optional_is_left_out_where_it_cannot_be_used() {
    let told = |signal: Signal, features: Vec<(String, Signal)>, knowledge: NoiseKnowledge, note: &str| {
        let (frame, repairs) = frame(signal, features);
        assert_finite(&frame);
        assert_eq!(frame.noise_knowledge(), knowledge, "{repairs}");
        assert!(repairs.notes.iter().any(|found| found.contains(note)), "{note}: {repairs}");
        (frame, repairs)
    };
    let plane = |channel: usize, value: f32, of: Image| {
        let mut image = of;
        image.planes[channel].fill(value);
        Some(image)
    };
    use NoiseKnowledge::{HalvesAndVariance, HalvesOnly, VarianceOnly};
    let infinite = Signal { variance_of_mean: Some(flat(f32::INFINITY, 3)), ..color() };
    told(infinite, vec![], HalvesOnly, "colour: the variance has no usable value and is left out");
    let of_one_channel = Signal { variance_of_mean: Some(flat(0.25, 1)), ..color() };
    told(of_one_channel, vec![], HalvesOnly, "colour: variance of 1 channels do not fit a mean of 3");
    let nan_half = Signal { half_spread: plane(1, f32::NAN, flat(0.5, 3)), ..color() };
    told(nan_half, vec![], VarianceOnly, "colour: the halves have no usable value in G and are left out");
    // The other channels of the variance stay.
    let without_green = Signal { variance_of_mean: plane(1, f32::NAN, flat(0.25, 3)), ..color() };
    let (settled, _) = told(without_green, vec![], HalvesAndVariance, "colour: the variance has no usable value in G");
    let variance = settled.color().variance_of_mean.as_ref().unwrap();
    assert!(variance.planes.iter().flatten().all(|value| (value - 0.25).abs() < 1e-6), "0.5² is 0.25: {variance:?}");

    let (settled, repairs) = told(
        color(),
        vec![depth([f32::NAN; 12]), depth(ramp())],
        HalvesAndVariance,
        "feature depth: not one pixel has a usable value",
    );
    assert_eq!((settled.features().len(), repairs.dropped_features), (1, vec!["depth".to_owned()]));
    assert!(settled.constant_features().is_empty());
    let with_bad_noise = |spread: f32, variance: f32| {
        let (name, signal) = depth(ramp());
        (name, Signal { half_spread: Some(flat(spread, 1)), variance_of_mean: Some(flat(variance, 1)), ..signal })
    };
    let knowledge = |frame: &Frame| frame.features()[0].signal.noise_knowledge();
    let (settled, _) = told(
        color(),
        vec![with_bad_noise(2.0, f32::NAN)],
        HalvesAndVariance,
        "feature depth: the variance has no usable value",
    );
    assert_eq!(knowledge(&settled), Some(HalvesOnly));
    let (settled, _) = told(
        color(),
        vec![with_bad_noise(f32::NAN, 8.0)],
        HalvesAndVariance,
        "feature depth: the halves have no usable value",
    );
    assert_eq!(knowledge(&settled), Some(VarianceOnly));
    let (settled, _) = told(
        color(),
        vec![with_bad_noise(f32::NAN, f32::NAN)],
        HalvesAndVariance,
        "feature depth: neither halves nor variance",
    );
    assert_eq!(knowledge(&settled), None);

    let mut albedo = image(ramp(), 3);
    albedo.planes[1].fill(f32::NAN);
    albedo.planes.iter_mut().flatten().for_each(|value| *value /= 32.0);
    let albedo = Signal { mean: albedo, half_spread: None, variance_of_mean: None };
    let (settled, _) = told(
        color(),
        vec![("albedo".into(), albedo)],
        HalvesAndVariance,
        "feature albedo: not one pixel has a usable value in channel 2",
    );
    assert_eq!(settled.features().len(), 1);
    let nine = (0..9).map(|index| (format!("f{index}"), depth(ramp()).1)).collect();
    let (settled, repairs) =
        told(color(), nine, HalvesAndVariance, "feature f8: at most 8 features can be used, left out");
    assert_eq!((settled.features().len(), repairs.dropped_features), (8, vec!["f8".to_owned()]));
    let wide = Signal { mean: flat(1.0, 4), half_spread: None, variance_of_mean: None };
    told(color(), vec![("rgba".into(), wide)], HalvesAndVariance, "feature rgba: it has 4 channels");
}

#[test]
fn what_is_known_of_the_noise_decides_what_works() {
    let with = |halves: bool, variance: bool| Signal {
        half_spread: halves.then(|| flat(0.5, 3)),
        variance_of_mean: variance.then(|| flat(0.25, 3)),
        ..color()
    };
    assert_eq!(frame(with(true, true), vec![]).0.noise_knowledge(), NoiseKnowledge::HalvesAndVariance);
    assert_eq!(frame(with(true, false), vec![]).0.noise_knowledge(), NoiseKnowledge::HalvesOnly);
    let (variance_only, repairs) = frame(with(false, true), vec![]);
    assert_eq!(variance_only.noise_knowledge(), NoiseKnowledge::VarianceOnly);
    assert!(repairs.to_string().contains("no second pass"));
    assert_eq!(frame(with(false, false), vec![]).0.noise_knowledge(), NoiseKnowledge::ImageOnly);
    let levels = [with(true, true), with(true, false)].map(|signal| frame(signal, vec![]).0.noise_level());
    assert_eq!(levels[0], levels[1], "0.5² is 0.25");
}

#[test]
fn identical_halves_are_not_taken_for_a_noise_free_image() {
    let same = Signal { half_spread: Some(flat(0.0, 3)), variance_of_mean: None, ..color() };
    assert_image_only(frame(same, vec![]), &["the two halves are identical", "seeds"]);
}

/// A colour and a feature of 64×64 pixels, noisy: truth 0.5 or 0.8 in blocks, halves that differ by a deviation of 0.1,
/// and the variance that fits.
fn noisy(channels: usize) -> Signal {
    let extent = Extent { width: 64, height: 64 };
    let mut state = 1u64;
    let mut gaussian = || {
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        (0..12).map(|_| uniform()).sum::<f32>() - 6.0
    };
    let truth = |pixel: usize| if (pixel / 8 + pixel / 512).is_multiple_of(2) { 0.5 } else { 0.8 };
    let mut plane = |level: bool| {
        (0..extent.pixels()).map(|pixel| 0.1 * gaussian() + if level { truth(pixel) } else { 0.0 }).collect()
    };
    let mut planes = |level: bool| Image { extent, planes: (0..channels).map(|_| plane(level)).collect() };
    Signal {
        mean: planes(true),
        half_spread: Some(planes(false)),
        variance_of_mean: Some(Image::filled(extent, channels, 0.01)),
    }
}

fn without(image: &Option<Image>, channels: &[usize]) -> Option<Image> {
    let mut image = image.clone().unwrap();
    channels.iter().for_each(|&channel| image.planes[channel].fill(0.0));
    Some(image)
}

#[test]
fn the_source_that_says_something_is_used() {
    let sound = noisy(3);
    let settled = |signal: &Signal| {
        // The same for a feature.
        let (as_color, repairs) = frame(signal.clone(), vec![("caustic".into(), signal.clone())]);
        let feature = as_color.features()[0].signal.clone();
        (as_color.color().clone(), feature, repairs)
    };
    let (color, feature, repairs) = settled(&sound);
    assert_eq!((&color, repairs.notes.as_slice()), (&sound, [].as_slice()), "both sources agree");
    assert_eq!(feature.noise_knowledge(), Some(NoiseKnowledge::HalvesAndVariance));

    let silent_variance = Signal { variance_of_mean: without(&sound.variance_of_mean, &[0, 1, 2]), ..sound.clone() };
    let (color, feature, repairs) = settled(&silent_variance);
    assert_eq!(color, Signal { variance_of_mean: None, ..sound.clone() });
    assert_eq!(feature.noise_knowledge(), Some(NoiseKnowledge::HalvesOnly));
    for layer in ["colour", "feature caustic"] {
        assert!(
            repairs
                .notes
                .contains(&format!("{layer}: the variance is 0 everywhere although the halves differ; it is left out")),
            "{repairs}"
        );
    }

    let silent_channels = Signal { variance_of_mean: without(&sound.variance_of_mean, &[1, 2]), ..sound.clone() };
    let (color, feature, repairs) = settled(&silent_channels);
    for variance in [color.variance_of_mean.as_ref().unwrap(), feature.variance_of_mean.as_ref().unwrap()] {
        let mean = |channel: usize| variance.planes[channel].iter().sum::<f32>() / 4096.0;
        for channel in [1, 2] {
            assert!(
                (mean(channel) / mean(0) - 1.0).abs() < 0.1,
                "the variance of channel {channel} is {} times that of channel 0",
                mean(channel) / mean(0)
            );
        }
    }
    assert_eq!(color.variance_of_mean.as_ref().unwrap().planes[0], sound.variance_of_mean.as_ref().unwrap().planes[0]);
    assert!(
        repairs.to_string().contains("colour: the variance is 0 everywhere in G and B although the halves differ"),
        "{repairs}"
    );
    assert!(
        repairs
            .to_string()
            .contains("feature caustic: the variance is 0 everywhere in channel 2 and channel 3 although"),
        "{repairs}"
    );

    for silent in [vec![0, 1, 2], vec![1]] {
        let identical = Signal { half_spread: without(&sound.half_spread, &silent), ..sound.clone() };
        let (color, feature, repairs) = settled(&identical);
        assert_eq!(color, Signal { half_spread: None, ..sound.clone() });
        assert_eq!(feature.noise_knowledge(), Some(NoiseKnowledge::VarianceOnly));
        assert!(repairs.to_string().contains("colour: the two halves are identical"), "{repairs}");
    }
    // A channel in which halves and variance are both 0 is free of noise.
    let blue = |image: &Option<Image>| without(image, &[2]);
    let clean_blue = Signal {
        half_spread: blue(&sound.half_spread),
        variance_of_mean: blue(&sound.variance_of_mean),
        ..sound.clone()
    };
    assert_eq!(settled(&clean_blue).0, clean_blue);
    // Rounding errors are not noise.
    let mut exact = clean_blue.clone();
    exact.variance_of_mean.as_mut().unwrap().planes[2].fill(1e-12);
    let (color, _, repairs) = settled(&exact);
    assert_eq!((color, repairs.notes.len()), (exact, 0));
}

#[test]
fn sources_that_contradict_each_other_are_pointed_out_with_the_factor() {
    let sound = noisy(3);
    for (factor, told) in [(1.0, None), (2.5, None), (0.4, None), (16.0, Some("0.06")), (0.01, Some("10"))] {
        let mut signal = sound.clone();
        signal.variance_of_mean.as_mut().unwrap().planes.iter_mut().flatten().for_each(|value| *value *= factor);
        // A spike must not change the factor.
        signal.half_spread.as_mut().unwrap().planes[0][77] = 1e6;
        let (_, repairs) = frame(signal, vec![]);
        let note = repairs.notes.iter().find(|note| note.contains("times the variance that is given"));
        assert_eq!(note.is_some(), told.is_some(), "{factor}: {repairs}");
        assert!(note.is_none_or(|note| note.contains(told.unwrap_or_default())), "{repairs}");
    }
}

#[test]
fn where_nothing_tells_of_noise_it_is_said_that_nothing_is_filtered() {
    let sound = noisy(3);
    let zero = Some(Image::filled(sound.mean.extent, 3, 0.0));
    for half_spread in [None, zero.clone()] {
        let silent = Signal { half_spread, variance_of_mean: zero.clone(), ..sound.clone() };
        let (settled, repairs) = frame(silent.clone(), vec![]);
        assert_eq!(*settled.color(), silent);
        assert!(repairs.to_string().contains("nothing is filtered"), "{repairs}");
    }
    let one_noisy_pixel = |value: f32| {
        let mut image = zero.clone().unwrap();
        image.planes[1][9] = value;
        Some(image)
    };
    let one = Signal { half_spread: one_noisy_pixel(0.1), variance_of_mean: one_noisy_pixel(0.01), ..sound };
    let (settled, repairs) = frame(one.clone(), vec![]);
    assert_eq!((settled.color(), repairs.notes.len()), (&one, 0));
}

#[test]
fn noise_that_neighbours_share_is_pointed_out() {
    let sound = noisy(3);
    assert!(frame(sound.clone(), vec![]).1.is_empty());
    let mut blurred = sound;
    for plane in &mut blurred.half_spread.as_mut().unwrap().planes {
        let before = plane.clone();
        // A spike in every row, whose signs must not count for more.
        plane.iter_mut().enumerate().skip(1).for_each(|(pixel, value)| {
            *value = (before[pixel] + before[pixel - 1]) / 2.0 + if pixel % 64 == 9 { 1e5 } else { 0.0 }
        });
    }
    let (_, repairs) = frame(blurred, vec![]);
    assert!(
        repairs.to_string().contains("neighbouring pixels share their noise")
            && repairs.to_string().contains("box pixel filter"),
        "{repairs}"
    );
}

/// As from a render with one sample per pixel.
#[test]
fn an_empty_half_is_not_taken_for_noise() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("render.exr");
    let rgb = || ["R", "G", "B"].map(str::to_owned).to_vec();
    let layer = |name: &str, image: Image| NamedLayer { name: name.into(), channels: rgb(), image };
    let half = |name: &str, value: f32| layer(name, flat(value, 3));
    let layers = [
        layer("", color().mean),
        half("halfA", 3.0),
        half("halfB", 0.0),
        half("variance", 0.25),
        layer("albedo", image(ramp().map(|value| value / 32.0), 3)),
    ];
    let settled = |layers: &[NamedLayer]| {
        write_layers(&path, layers, &[]).unwrap();
        BufferSet::read(&BufferSetRequest { input: path.clone(), ..Default::default() }).unwrap().to_frame()
    };
    let (frame, repairs) = settled(&layers).unwrap();
    assert_eq!(frame.noise_knowledge(), NoiseKnowledge::VarianceOnly);
    assert!(repairs.notes.iter().any(|note| note.contains("half B is empty")), "{repairs}");
    assert!(!repairs.notes.iter().any(|note| note.contains("not the average")), "{repairs}");

    let mut feature_halves = layers.to_vec();
    feature_halves.extend([half("albedo_halfA", 0.0), half("albedo_halfB", 1.0)]);
    let (frame, repairs) = settled(&feature_halves).unwrap();
    assert_eq!(frame.features()[0].signal.noise_knowledge(), None);
    assert!(repairs.notes.iter().any(|note| note.contains("albedo: half A is empty")), "{repairs}");

    assert_image_only(settled(&layers[..3]).unwrap(), &["half B is empty"]);
    // Black is black in both.
    let black = [layer("", flat(0.0, 3)), half("halfA", 0.0), half("halfB", 0.0), half("variance", 0.0)];
    assert_eq!(settled(&black).unwrap().0.noise_knowledge(), NoiseKnowledge::HalvesAndVariance);
}

#[test]
fn halves_of_another_render_than_the_input_are_pointed_out() {
    let input = testdata("cornell_32spp.exr");
    let other = testdata("cornell_8spp.exr");
    let half = |layer: &str| Some(format!("{}::{layer}", other.display()).parse().unwrap());
    let mut request = BufferSetRequest { input, half_a: half("halfA"), half_b: half("halfB"), ..Default::default() };
    let (_, repairs) = BufferSet::read(&request).unwrap().to_frame().unwrap();
    assert!(repairs.to_string().contains("not the average of the halves"), "{repairs}");
    request.input = other;
    let (_, repairs) = BufferSet::read(&request).unwrap().to_frame().unwrap();
    assert!(repairs.is_empty(), "{repairs}");
}

#[test]
fn a_feature_comes_to_unit_range_with_its_noise() {
    let (frame, repairs) = frame(color(), vec![depth(ramp())]);
    let feature = &frame.features()[0];
    // 10 to 32: a range of 22.
    assert_eq!((feature.unit_scale, feature.unit_offset), (22.0, 10.0));
    let mean = &feature.signal.mean.planes[0];
    assert_eq!((mean[0], mean[11]), (0.0, 1.0));
    assert!((mean[4] * feature.unit_scale + feature.unit_offset - 18.0).abs() < 1e-5);
    let first = |image: &Option<Image>| image.as_ref().unwrap().planes[0][0];
    assert!((first(&feature.signal.half_spread) - 2.0 / 22.0).abs() < 1e-7);
    assert!((first(&feature.signal.variance_of_mean) - 8.0 / 484.0).abs() < 1e-8);
    assert!(repairs.is_empty(), "{repairs}");
}

/// Depth of a scene from 1 to 5, with other values in some pixels.
fn far_depth(far: impl Fn(usize, usize) -> Option<f32>) -> Signal {
    let extent = Extent { width: 64, height: 64 };
    let value = |pixel: usize| far(pixel % 64, pixel / 64).unwrap_or(1.0 + 4.0 * ((pixel * 29) % 4096) as f32 / 4095.0);
    let mean = Image { extent, planes: vec![(0..extent.pixels()).map(value).collect()] };
    Signal {
        half_spread: Some(Image::filled(extent, 1, 0.04)),
        variance_of_mean: Some(Image::filled(extent, 1, 0.0016)),
        mean,
    }
}

fn with_depth(color: Signal, depth: Signal) -> (Frame, Repairs) {
    frame(color, vec![("depth".into(), depth)])
}

#[test]
fn outliers_do_not_stretch_a_features_range_and_stay_apart() {
    let near = |frame: &Frame| frame.features()[0].clone();
    let plain = near(&with_depth(noisy(3), far_depth(|_, _| None)).0);
    assert_eq!((plain.unit_scale, plain.unit_offset), (4.0, 1.0));
    type Far = fn(usize, usize) -> Option<f32>;
    // A pixel without a hit, a sky dome, and a sky dome whose edge is mixed with the scene in front.
    let cases: [Far; 3] = [
        |x, y| ((x, y) == (9, 9)).then_some(1e6),
        |_, y| (y < 20).then_some(1e4),
        |x, y| {
            (y < 21).then_some(if y < 20 {
                1e4
            } else if x % 3 == 0 {
                3e3
            } else {
                3.0
            })
        },
    ];
    for far in cases {
        let (frame, repairs) = with_depth(noisy(3), far_depth(far));
        let feature = near(&frame);
        assert_finite(&frame);
        assert!(
            (feature.unit_scale - 4.0).abs() < 0.01 && (feature.unit_offset - 1.0).abs() < 0.01,
            "{} {}",
            feature.unit_scale,
            feature.unit_offset
        );
        for (pixel, value) in feature.signal.mean.planes[0].iter().enumerate() {
            let is_far = far(pixel % 64, pixel / 64).is_some_and(|value| value > 100.0);
            assert_eq!(!(0.0..=1.0).contains(value), is_far, "{pixel}: {value}");
            assert!(!is_far || (2.0..20.0).contains(value), "{pixel}: {value}");
        }
        assert!(repairs.to_string().contains("lie far outside of 1"), "{repairs}");
    }
    // A tail without a gap, and two levels, keep their whole range.
    for far in [|_, y| Some(1000.0 / (1 + y) as f32), |x, _| Some(if x < 7 { 0.0 } else { 7000.0 })] as [Far; 2] {
        let (frame, repairs) = with_depth(noisy(3), far_depth(far));
        assert!(frame.features()[0].signal.mean.planes[0].iter().all(|value| (0.0..=1.0).contains(value)), "{repairs}");
        assert!(repairs.is_empty(), "{repairs}");
    }
}

/// The noise of an outlier shrinks with it: its distance to the range stays the same in standard deviations.
#[test]
fn what_lies_far_outside_keeps_its_noise_in_proportion() {
    let mut signal = noisy(1);
    let extent = signal.mean.extent;
    signal.mean.planes[0][5] = 2000.0;
    signal.half_spread.as_mut().unwrap().planes[0][5] = -20.0;
    signal.variance_of_mean.as_mut().unwrap().planes[0][5] = 400.0;
    let (frame, _) = frame(Signal { ..noisy(3) }, vec![("caustic".into(), signal)]);
    let feature = &frame.features()[0].signal;
    let at = |image: &Image| image.planes[0][5];
    let (value, spread, variance) =
        (at(&feature.mean), at(feature.half_spread.as_ref().unwrap()), at(feature.variance_of_mean.as_ref().unwrap()));
    assert!(
        value > 2.0 && spread < 0.0 && (spread * spread / variance - 1.0).abs() < 0.1,
        "{value} {spread} {variance} {extent}"
    );
    assert!((value - 1.0) / variance.sqrt() >= 100.0, "{value} {variance}");
}

/// A frame and a crop of it agree to the bit if the range of the features is the same. Cropping an outlier away does
/// not change the range.
#[test]
fn a_piece_without_the_outlier_is_as_in_the_whole() {
    type Far = fn(usize, usize) -> Option<f32>;
    // The crop holds the least and the greatest value of the scene.
    let ends = |x: usize, y: usize| match (x, y) {
        (40, 40) => Some(1.0),
        (41, 40) => Some(5.0),
        _ => None,
    };
    let cases: [Far; 2] = [|x, y| ((x, y) == (2, 2)).then_some(5e4), |_, y| (y < 8).then_some(1e4)];
    for outside in cases {
        let (color, depth) = (noisy(3), far_depth(|x, y| outside(x, y).or(ends(x, y))));
        let rows = |plane: &Vec<f32>| plane[8 * 64..].to_vec();
        let piece = |image: &Image| Image {
            extent: Extent { width: 64, height: 56 },
            planes: image.planes.iter().map(rows).collect(),
        };
        let cut = |signal: &Signal| Signal {
            mean: piece(&signal.mean),
            half_spread: signal.half_spread.as_ref().map(piece),
            variance_of_mean: signal.variance_of_mean.as_ref().map(piece),
        };
        let (part, repairs) = with_depth(cut(&color), cut(&depth));
        assert!(repairs.is_empty(), "{repairs}");
        let (whole, repairs) = with_depth(color, depth);
        assert!(!repairs.is_empty());
        let [in_whole, in_part] = [&whole.features()[0], &part.features()[0]];
        assert_eq!((in_part.unit_scale, in_part.unit_offset), (in_whole.unit_scale, in_whole.unit_offset));
        assert_eq!(in_part.signal, cut(&in_whole.signal));
    }
}

/// Normals of a ball as a camera sees it; rays outside of the ball hit nothing.
fn ball_normals() -> Signal {
    let noise = noisy(3);
    let extent = noise.mean.extent;
    let vector = |pixel: usize| {
        let (x, y) = ((pixel % 64) as f32 / 32.0 - 1.0, (pixel / 64) as f32 / 32.0 - 1.0);
        let depth = 1.0 - x * x - y * y;
        if depth > 0.0 { [x, y, depth.sqrt()] } else { [0.0; 3] }
    };
    let hit = |pixel: usize| vector(pixel) != [0.0; 3];
    let planes = |value: &dyn Fn(usize, usize) -> f32| {
        let plane = |channel: usize| {
            (0..extent.pixels()).map(|pixel| if hit(pixel) { value(pixel, channel) } else { 0.0 }).collect()
        };
        Image { extent, planes: (0..3).map(plane).collect() }
    };
    let spread = noise.half_spread.unwrap();
    Signal {
        mean: planes(&|pixel, channel| vector(pixel)[channel]),
        half_spread: Some(planes(&|pixel, channel| 0.1 * spread.planes[channel][pixel])),
        variance_of_mean: Some(planes(&|_, _| 1e-4)),
    }
}

#[test]
fn encoded_normals_give_the_feature_of_the_normals_themselves() {
    let plain = ball_normals();
    let mut encoded = plain.clone();
    let is_hit = |pixel: usize| (0..3).any(|channel| plain.mean.planes[channel][pixel] != 0.0);
    for channel in 0..3 {
        for pixel in (0..4096).filter(|pixel| is_hit(*pixel)) {
            encoded.mean.planes[channel][pixel] = (plain.mean.planes[channel][pixel] + 1.0) / 2.0;
            encoded.half_spread.as_mut().unwrap().planes[channel][pixel] /= 2.0;
            encoded.variance_of_mean.as_mut().unwrap().planes[channel][pixel] /= 4.0;
        }
    }
    let settled = |normal: Signal| frame(noisy(3), vec![("normal".into(), normal)]);
    let ((of_plain, plain_repairs), (of_encoded, repairs)) = (settled(plain), settled(encoded));
    assert!(plain_repairs.is_empty(), "{plain_repairs}");
    assert!(repairs.to_string().contains("feature normal: stored as (n + 1)/2"), "{repairs}");
    let (a, b) = (&of_plain.features()[0], &of_encoded.features()[0]);
    assert_eq!((a.unit_scale, a.unit_offset, b.unit_scale, b.unit_offset), (2.0, -1.0, 1.0, 0.0));
    let images = |signal: &Signal| {
        [Some(signal.mean.clone()), signal.half_spread.clone(), signal.variance_of_mean.clone()].map(Option::unwrap)
    };
    for (a, b) in images(&a.signal).iter().zip(&images(&b.signal)) {
        assert!(a.planes.iter().flatten().zip(b.planes.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}

#[test]
fn all_channels_of_a_feature_share_one_map() {
    let mut mean = flat(0.0, 3);
    mean.planes[0] = ramp().to_vec();
    mean.planes[2] = vec![-10.0; 12];
    let signal = Signal { mean, half_spread: None, variance_of_mean: None };
    let (frame, _) = frame(color(), vec![("position".into(), signal)]);
    let feature = &frame.features()[0];
    assert_eq!((feature.unit_scale, feature.unit_offset), (42.0, -10.0));
    assert_eq!(feature.signal.mean.planes[2], vec![0.0; 12]);
    assert!((feature.signal.mean.planes[1][0] - 10.0 / 42.0).abs() < 1e-6);
}

#[test]
fn normals_keep_zero_in_the_middle() {
    let plane = std::array::from_fn(|pixel| if pixel % 2 == 0 { -0.5 } else { 0.25 });
    let signal = Signal { mean: image(plane, 3), half_spread: None, variance_of_mean: Some(flat(1.0, 3)) };
    let (frame, repairs) = frame(color(), vec![("sh_normal".into(), signal)]);
    let feature = &frame.features()[0];
    assert_eq!((feature.unit_scale, feature.unit_offset), (2.0, -1.0));
    assert_eq!(feature.signal.mean.planes[0][..2], [0.25, 0.625]);
    assert_eq!(feature.signal.variance_of_mean.as_ref().unwrap().planes[0][0], 0.25);
    assert!(repairs.is_empty(), "{repairs}");
}

#[test]
fn rays_that_hit_nothing_lie_at_the_far_end_and_are_no_damage() {
    let mut mean = ramp();
    mean[0] = 1e10;
    mean[7] = f32::INFINITY;
    let mut feature = depth(mean);
    // Infinity minus infinity.
    feature.1.half_spread.as_mut().unwrap().planes[0][7] = f32::NAN;
    let (frame, repairs) = frame(color(), vec![feature]);
    let feature = &frame.features()[0];
    assert_eq!((feature.unit_scale, feature.unit_offset), (20.0, 12.0), "the range is that of the hits");
    for pixel in [0, 7] {
        let at = |image: &Option<Image>| image.as_ref().unwrap().planes[0][pixel];
        assert_eq!(feature.signal.mean.planes[0][pixel], 1.0);
        assert_eq!((at(&feature.signal.half_spread), at(&feature.signal.variance_of_mean)), (0.0, 0.0));
    }
    let found = repairs.layer("depth").unwrap();
    assert_eq!((found.misses, found.pixels_replaced, found.nan_values, found.infinite_values), (2, 0, 0, 0));
}

#[test]
fn an_infinite_albedo_is_damage_and_no_miss() {
    let mut mean = ramp().map(|value| value / 32.0);
    mean[7] = f32::INFINITY;
    let signal = Signal { mean: image(mean, 3), half_spread: None, variance_of_mean: None };
    let (frame, repairs) = frame(color(), vec![("albedo".into(), signal)]);
    assert!(frame.features()[0].signal.mean.planes[0][7] < 1.0);
    let found = repairs.layer("albedo").unwrap();
    assert_eq!((found.misses, found.pixels_replaced), (0, 1));
    assert!(repairs.to_string().contains("free of noise"), "{repairs}");
}

/// An albedo of three channels with its halves and variance.
fn albedo(mean: [f32; 12], half_spread: Option<[f32; 12]>, deviation: Option<[f32; 12]>) -> Signal {
    let variance = deviation.map(|deviation| deviation.map(|deviation| deviation * deviation));
    Signal {
        mean: image(mean, 3),
        half_spread: half_spread.map(|spread| image(spread, 3)),
        variance_of_mean: variance.map(|variance| image(variance, 3)),
    }
}

/// The feature that an albedo becomes, in the units of the file: mean, half spread and deviation of each pixel.
fn settled_albedo(name: &str, signal: Signal) -> (Vec<[f32; 3]>, Repairs) {
    let (frame, repairs) = frame(color(), vec![(name.into(), signal)]);
    let feature = &frame.features()[0];
    let at = |image: &Option<Image>, pixel: usize| image.as_ref().map_or(0.0, |image| image.planes[1][pixel]);
    let pixel = |pixel: usize| {
        let Signal { mean, half_spread, variance_of_mean } = &feature.signal;
        let in_file_units = [mean.planes[1][pixel], at(half_spread, pixel), at(variance_of_mean, pixel).sqrt()]
            .map(|value| value * feature.unit_scale);
        [in_file_units[0] + feature.unit_offset, in_file_units[1], in_file_units[2]]
    };
    ((0..12).map(pixel).collect(), repairs)
}

fn close(a: f32, b: f32) -> bool {
    (a - b).abs() < 1e-5
}

#[test]
fn albedo_beyond_1_is_clamped_with_its_noise() {
    // 0 to 0.9, and one pixel of each kind: a lamp, a lamp with different halves, an edge of a lamp, a value below 1
    // with one half above.
    let mut mean = std::array::from_fn(|pixel| pixel as f32 * 0.1);
    let (mut spread, mut deviation) = ([0.05; 12], [0.05; 12]);
    for (pixel, m, s, d) in [(3, 844.0, 2.0, 3.0), (5, 2.0, -1.5, 1.5), (7, 1.25, 0.5, 0.25), (9, 0.75, 0.5, 0.5)] {
        (mean[pixel], spread[pixel], deviation[pixel]) = (m, s, d);
    }
    (mean[10], mean[11]) = (0.9, 1.0);
    (spread[11], deviation[11]) = (0.0, 0.0);
    let (pixels, repairs) = settled_albedo("Denoising Albedo", albedo(mean, Some(spread), Some(deviation)));
    // Halves of 846 and 842; 0.5 and 3.5; 1.75 and 0.75; 1.25 and 0.25.
    let clamped = [(3, [1.0, 0.0, 0.0]), (5, [1.0, -0.25, 0.25]), (7, [1.0, 0.125, 0.0]), (9, [0.75, 0.375, 0.375])];
    for (pixel, expected) in clamped {
        assert!(
            pixels[pixel].iter().zip(expected).all(|(found, expected)| close(*found, expected)),
            "{pixel}: {:?}, not {expected:?}",
            pixels[pixel]
        );
    }
    for pixel in (0..12).filter(|pixel| clamped.iter().all(|(other, _)| other != pixel)) {
        assert!(
            close(pixels[pixel][0], mean[pixel])
                && close(pixels[pixel][1], spread[pixel])
                && close(pixels[pixel][2], deviation[pixel]),
            "{pixel}"
        );
    }
    let note = repairs.notes.iter().find(|note| note.starts_with("feature Denoising Albedo: ")).unwrap();
    assert!(
        note.contains("9 values are beyond 1, up to 844") && note.contains("3 values are within 1, but a half"),
        "{repairs}"
    );

    // Without halves the deviation bounds the samples; other features stay unchanged.
    let (pixels, repairs) = settled_albedo("albedo", albedo(mean, None, Some(deviation)));
    assert!(close(pixels[7][2], 0.0) && close(pixels[9][2], 0.375) && close(pixels[10][2], 0.05), "{pixels:?}");
    assert!(repairs.to_string().contains("9 values are beyond 1, up to 844"), "{repairs}");
    let (pixels, repairs) = settled_albedo("caustic", albedo(mean, Some(spread), Some(deviation)));
    assert!(pixels.iter().any(|[mean, ..]| *mean > 1.5) && !repairs.to_string().contains("beyond 1"), "{repairs}");
}

#[test]
fn an_albedo_within_1_stays_the_same_to_the_bit() {
    // A white wall as half floats store it, and a deviation that claims more than its halves.
    let half = |value: f32| (value * 1024.0).round() / 1024.0;
    let mean: [f32; 12] = std::array::from_fn(|pixel| half(0.5 + 0.5 * pixel as f32 / 11.0));
    let spread = mean.map(|mean| (1.0 - mean) * (1.0 + f32::EPSILON));
    let signal = albedo(mean, Some(spread), Some([0.25; 12]));
    let settled = |name: &str| {
        let (frame, repairs) = frame(color(), vec![(name.into(), signal.clone())]);
        (frame.features()[0].signal.clone(), repairs)
    };
    let ((as_albedo, repairs), (as_other, _)) = (settled("albedo"), settled("caustic"));
    assert_eq!(as_albedo, as_other);
    assert!(!repairs.to_string().contains("beyond 1"), "{repairs}");
}

#[test]
fn a_constant_feature_is_left_out_and_a_flat_wall_with_a_window_is_not() {
    let (plain, repairs) = frame(color(), vec![depth([5.0; 12])]);
    assert!(plain.features().is_empty());
    assert_eq!(repairs.dropped_features, ["depth"]);
    let mut wall = [5.0; 12];
    wall[3] = f32::INFINITY;
    let (holed, _) = frame(color(), vec![depth(wall)]);
    assert_eq!(holed.features()[0].signal.mean.planes[0][2..4], [0.0, 1.0]);
    let (sky, repairs) = frame(color(), vec![depth([f32::INFINITY; 12])]);
    assert!(sky.features().is_empty());
    assert_eq!(repairs.dropped_features, ["depth"]);
}

#[test]
fn a_tiny_range_makes_nothing_infinite() {
    let (frame, _) = frame(color(), vec![depth(std::array::from_fn(|pixel| pixel as f32 * 1e-25))]);
    assert_eq!(frame.features().len(), 1);
    assert_finite(&frame);
}

#[test]
fn images_that_do_not_fit_together_are_refused() {
    let bare = |mean: Image| Signal { mean, half_spread: None, variance_of_mean: None };
    assert!(failure(Signal { mean: flat(1.0, 1), ..color() }, vec![]).contains("1 channels"));
    let small = bare(Image::filled(Extent { width: 2, height: 3 }, 1, 1.0));
    assert!(failure(color(), vec![("depth".into(), small)]).contains("depth"));
    let mut short = color();
    short.mean.planes[1].pop();
    assert!(failure(short, vec![]).contains("12 values"));
    let nothing = Image::filled(Extent { width: 0, height: 5 }, 3, 0.0);
    assert!(failure(bare(nothing), vec![]).contains("no pixels"));
}

#[test]
fn senseless_sample_counts_become_unknown() {
    let (frame, repairs) = Frame::new(color(), vec![], SamplesPerPixel::Uniform(f32::NAN)).unwrap();
    assert_eq!(*frame.samples_per_pixel(), SamplesPerPixel::Unknown);
    assert!(repairs.to_string().contains("samples"), "{repairs}");
    assert!(Frame::new(color(), vec![], SamplesPerPixel::PerPixel(flat(1.0, 2))).is_err());
}

#[test]
fn repairs_can_be_read_by_programs() {
    let mut poisoned = color();
    poisoned.mean.planes[0][0] = f32::NAN;
    let (_, repairs) = frame(poisoned, vec![]);
    let json = serde_json::to_value(&repairs).unwrap();
    assert_eq!(json["layers"][0]["layer"], "colour");
    assert_eq!(json["layers"][0]["nan_values"], 1);
    assert_eq!(json["layers"][0]["damage"], serde_json::json!([{ "image": "mean", "channel": "R", "values": 1 }]));
}

const RENDERS: [&str; 8] = [
    "cornell_8spp.exr",
    "cornell_32spp.exr",
    "dof_spheres_32spp.exr",
    "caustic_ring_32spp.exr",
    "anim/shot.0000.exr",
    "anim/shot.0003.exr",
    "mitsuba/iteration_1.exr",
    "mitsuba/iteration_4.exr",
];

fn rendered(name: &str) -> Frame {
    let request = BufferSetRequest { input: testdata(name), no_features: true, ..Default::default() };
    BufferSet::read(&request).unwrap().to_frame().unwrap().0
}

#[test]
fn the_noise_of_renders_is_no_contradiction() {
    for name in RENDERS {
        let frame = rendered(name);
        for knowledge in [NoiseKnowledge::HalvesAndVariance, NoiseKnowledge::HalvesOnly, NoiseKnowledge::VarianceOnly] {
            let check = frame.with_noise_known_from(knowledge).unwrap().check_of_noise();
            assert_eq!(check.contradiction(), None, "{name}, {knowledge}: {check:?}");
        }
    }
}

#[test]
fn other_quantities_than_the_variance_of_the_mean_are_found_in_renders() {
    for name in RENDERS {
        let frame = rendered(name);
        let SamplesPerPixel::Uniform(samples) = *frame.samples_per_pixel() else { continue };
        let Signal { mean, half_spread, variance_of_mean } = frame.color().clone();
        let variance = variance_of_mean.unwrap();
        let mapped = |map: &dyn Fn(f32, f32) -> f32| {
            let of_plane = |(variance, mean): (&Vec<f32>, &Vec<f32>)| {
                variance.iter().zip(mean).map(|(variance, mean)| map(*variance, *mean)).collect()
            };
            Image { extent: variance.extent, planes: variance.planes.iter().zip(&mean.planes).map(of_plane).collect() }
        };
        let one_sample = mapped(&|variance, _| variance * samples);
        let second_moment = mapped(&|variance, mean| variance * (samples - 1.0) + mean * mean);
        for half_spread in [None, half_spread] {
            let meaning_of = |variance: &Image| {
                let (mean, half_spread) = (mean.clone(), half_spread.clone());
                let color = Signal { mean, half_spread, variance_of_mean: Some(variance.clone()) };
                let (frame, _) = Frame::new(color, vec![], SamplesPerPixel::Uniform(samples)).unwrap();
                match frame.check_of_noise().contradiction() {
                    Some(Contradiction::VarianceTooLarge { meaning, .. }) => meaning,
                    other => panic!("{name}: {other:?}"),
                }
            };
            let expected = LargeVariance::OneSample { samples: Some(f64::from(samples)) };
            assert_eq!(meaning_of(&one_sample), expected, "{name}");
            assert_eq!(meaning_of(&second_moment), LargeVariance::SecondMoment, "{name}");
        }
    }
}

#[test]
fn halves_of_two_scenes_are_found() {
    let [cornell, spheres] = ["cornell_32spp.exr", "dof_spheres_32spp.exr"].map(|name| rendered(name).color().clone());
    let Signal { mean, variance_of_mean, .. } = cornell;
    let half_spread = Some(half_spread(&mean, &spheres.mean, 1.0, 1.0));
    let (frame, _) = frame(Signal { mean, half_spread, variance_of_mean }, vec![]);
    for knowledge in [NoiseKnowledge::HalvesAndVariance, NoiseKnowledge::HalvesOnly] {
        let check = frame.with_noise_known_from(knowledge).unwrap().check_of_noise();
        assert!(matches!(check.contradiction(), Some(Contradiction::HalvesTooDifferent { .. })), "{check:?}");
    }
}
