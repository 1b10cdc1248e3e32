//! From what the files said to what the denoisers may rely on.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::{Path, PathBuf};

use stein::buffers::{BufferSet, BufferSetRequest, NamedLayer, read_reference, write_layers};
use stein::frame::{Frame, NoiseKnowledge, Repairs, SamplesPerPixel, Signal, half_spread};
use stein::image::{Extent, Image};
use stein::metric;

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
    let (frame, repairs) = Frame::from_buffer_set(&set).unwrap();
    assert!(repairs.is_empty(), "{repairs}");
    let color = frame.color();
    let sum = |image: &Image, power: i32| -> f64 { image.planes.iter().flatten().map(|value| f64::from(*value).powi(power)).sum() };
    let two_buffer = sum(color.half_spread.as_ref().unwrap(), 2);
    let ratio = two_buffer / sum(color.variance_of_mean.as_ref().unwrap(), 1);
    assert!((0.8..1.25).contains(&ratio), "a factor of two is lost: {ratio}");
    // The guess without a reference is of the size that the reference shows.
    let reference = read_reference(&testdata("dof_spheres_reference.exr"), None).unwrap();
    let error = metric::relative_mse(&color.mean, &reference).unwrap();
    assert!((0.6..1.6).contains(&(frame.noise_level() / error)), "{} {error}", frame.noise_level());
    assert_eq!(frame.features().len(), 4);
    assert_eq!(*frame.samples_per_pixel(), SamplesPerPixel::Uniform(32.0));
    assert_finite(&frame);
}

#[test]
fn nan_pixels_take_their_neighbours_value() {
    let mut poisoned = color();
    poisoned.mean.planes[1][5] = f32::NAN;
    let (frame, repairs) = frame(poisoned, vec![]);
    // Around pixel 5 lie 0, 1, 2, 4, 6, 8, 9 and 10, each worth its number plus one: 6 on average.
    for plane in &frame.color().mean.planes {
        assert_eq!(plane[5], 6.0, "the whole pixel is replaced");
        assert_eq!(plane[6], 7.0, "no other pixel is");
    }
    let found = repairs.layer("colour").unwrap();
    assert_eq!((found.nan_values, found.pixels_replaced, found.variances_replaced), (1, 1, 0));
    assert!(repairs.to_string().contains("1 values NaN"), "{repairs}");
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
    // As large as this, a search for the nearest usable pixel from each that is not would not come to its end.
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
fn a_layer_without_one_usable_pixel_is_an_error_that_names_it() {
    let dead = Signal { mean: flat(f32::NAN, 3), ..color() };
    assert!(failure(dead, vec![]).contains("colour"));
    let message = failure(color(), vec![depth([f32::NAN; 12])]);
    assert!(message.contains("depth") && message.contains("`BufferSetRequest::skip_features`"), "{message}");
    let blind = Signal { variance_of_mean: Some(flat(f32::INFINITY, 3)), ..color() };
    assert!(failure(blind, vec![]).contains("variance"));
}

#[test]
fn what_is_known_of_the_noise_decides_what_works() {
    let with =
        |halves: bool, variance: bool| Signal { half_spread: halves.then(|| flat(0.5, 3)), variance_of_mean: variance.then(|| flat(0.25, 3)), ..color() };
    assert_eq!(frame(with(true, true), vec![]).0.noise_knowledge(), NoiseKnowledge::HalvesAndVariance);
    assert_eq!(frame(with(true, false), vec![]).0.noise_knowledge(), NoiseKnowledge::HalvesOnly);
    let (variance_only, repairs) = frame(with(false, true), vec![]);
    assert_eq!(variance_only.noise_knowledge(), NoiseKnowledge::VarianceOnly);
    assert!(repairs.to_string().contains("no second pass"));
    assert!(failure(with(false, false), vec![]).contains("`BufferSetRequest::half_a`"));
    let levels = [with(true, true), with(true, false)].map(|signal| frame(signal, vec![]).0.noise_level());
    assert_eq!(levels[0], levels[1], "0.5² is 0.25");
}

#[test]
fn identical_halves_are_not_taken_for_a_noise_free_image() {
    let same = Signal { half_spread: Some(flat(0.0, 3)), variance_of_mean: None, ..color() };
    let message = failure(same, vec![]);
    assert!(message.contains("identical") && message.contains("seeds"), "{message}");
}

/// As of a render with one sample per pixel.
#[test]
fn an_empty_half_is_not_taken_for_noise() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("render.exr");
    let rgb = || ["R", "G", "B"].map(str::to_owned).to_vec();
    let layer = |name: &str, image: Image| NamedLayer { name: name.into(), channels: rgb(), image };
    let half = |name: &str, value: f32| layer(name, flat(value, 3));
    let layers = [layer("", color().mean), half("halfA", 3.0), half("halfB", 0.0), half("variance", 0.25), layer("albedo", color().mean)];
    let settled = |layers: &[NamedLayer]| {
        write_layers(&path, layers, &[]).unwrap();
        Frame::from_buffer_set(&BufferSet::read(&BufferSetRequest { input: path.clone(), ..Default::default() }).unwrap())
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

    let refused = settled(&layers[..3]).unwrap_err().to_string();
    assert!(refused.contains("half B of the colour is empty") && refused.contains("remedy"), "{refused}");
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
    let (_, repairs) = Frame::from_buffer_set(&BufferSet::read(&request).unwrap()).unwrap();
    assert!(repairs.to_string().contains("not the average of the halves"), "{repairs}");
    request.input = other;
    let (_, repairs) = Frame::from_buffer_set(&BufferSet::read(&request).unwrap()).unwrap();
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
    let mut mean = ramp();
    mean[7] = f32::INFINITY;
    let signal = Signal { mean: image(mean, 3), half_spread: None, variance_of_mean: None };
    let (frame, repairs) = frame(color(), vec![("albedo".into(), signal)]);
    assert!(frame.features()[0].signal.mean.planes[0][7] < 1.0);
    let found = repairs.layer("albedo").unwrap();
    assert_eq!((found.misses, found.pixels_replaced), (0, 1));
    assert!(repairs.to_string().contains("free of noise"), "{repairs}");
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
    let nine = (0..9).map(|index| (format!("f{index}"), depth(ramp()).1)).collect();
    assert!(failure(color(), nine).contains("at most 8"));
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
}
