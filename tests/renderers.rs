//! Files of renderers on the command line: seeds, view layers, files beside the input, PFM and PNG.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "common/process.rs"]
mod process;

use std::path::Path;

use process::{Folder, channels, stein, test_image};
use stein_exr::{BufferSet, BufferSetRequest, MapFile, NamedLayer, Windows, write_layers, write_layers_in};

const RADIUS: &str = "--radius=2";

/// Writes the halves of a test image as two renders with different seeds.
fn write_seeds(image: &str, a: &str, b: &str) {
    let set = BufferSet::read(&BufferSetRequest { input: test_image(image).into(), ..Default::default() }).unwrap();
    let color = set.color();
    let features: Vec<_> = set.features().map(|(name, raw)| (name.to_owned(), raw)).collect();
    let layer = |name: &str, image: &stein::Image| NamedLayer {
        name: name.into(),
        channels: ["R", "G", "B"][..image.channels()].iter().map(ToString::to_string).collect(),
        image: image.clone(),
    };
    for (path, is_a) in [(a, true), (b, false)] {
        let half = |raw: &stein::frame::RawSignal| if is_a { raw.half_a.clone() } else { raw.half_b.clone() }.unwrap();
        let mut layers = vec![layer("", &half(&color)), layer("diffuse", &half(&color))];
        layers.extend(features.iter().map(|(name, raw)| layer(name, &half(raw))));
        write_layers(Path::new(path), &layers, &[("samples".into(), "16".into())]).unwrap();
    }
}

fn copy_set(folder: &Folder, set: &str) {
    for name in Folder::names_in(&test_image(&format!("layouts/{set}"))) {
        std::fs::copy(test_image(&format!("layouts/{set}/{name}")), folder.path(&name)).unwrap();
    }
}

#[test]
fn two_seeds_are_merged_and_tell_the_noise_of_colour_and_features() {
    let folder = Folder::new();
    let [a, b, out] = ["a.exr", "b.exr", "out.exr"].map(|name| folder.path(name));
    write_seeds("cornell_32spp.exr", &a, &b);
    let reference = test_image("cornell_reference.exr");
    let document = stein(&["denoise", &a, &b, "-o", &out, RADIUS, "--ref", &reference, "--json"]).succeeded().json();
    assert_eq!(document["input"]["frame"]["mode"], "two seeds");
    assert_eq!(document["input"]["seeds"].as_array().unwrap().len(), 1);
    assert_eq!(document["input"]["samples_per_pixel"]["uniform"], 32.0);
    let noise = document["input"]["frame"]["feature_noise"].as_array().unwrap();
    assert!(noise.iter().all(|feature| feature["noise_knowledge"] == "HalvesOnly"), "{noise:?}");
    let errors = document["errors"].as_array().unwrap();
    let error =
        |name: &str| errors.iter().find(|errors| errors["image"] == name).unwrap()["relative_mse"].as_f64().unwrap();
    assert!(error("result") < 0.3 * error("noisy"), "{errors:?}");
    // Light layers are the means of the seeds, and denoised along unless they are left out.
    let plane =
        |path: &str, channel: &str| match channels(path).into_iter().find(|(name, _)| name == channel).unwrap().1 {
            exr::prelude::FlatSamples::F32(values) => values,
            _ => panic!("not 32-bit floats"),
        };
    let are_means = |out: &str| {
        let means = plane(&a, "diffuse.R").into_iter().zip(plane(&b, "diffuse.R")).map(|(a, b)| (a + b) / 2.0);
        plane(out, "diffuse.R").into_iter().zip(means).all(|(found, mean)| (found - mean).abs() <= 1e-6 * mean)
    };
    assert!(!are_means(&out));
    let merged = folder.path("merged.exr");
    stein(&["denoise", &a, &b, "-o", &merged, RADIUS, "--aovs", "none"]).succeeded();
    assert!(are_means(&merged));

    stein(&["info", &a, "--seed", &b]).succeeded().said(&["two seeds", "b.exr"]);
    stein(&["kernel", &a, &b, "--pixel", "5,5", RADIUS]).succeeded();
    stein(&["denoise", &a, &a, "-o", &out]).failed(3, &["a.exr", "the same pixels", "remedy: "]);
    stein(&["denoise", &a, &b, "-o", &b]).failed(5, &["b.exr", "is also read"]);
    let other = test_image("anim/shot.0000.exr");
    stein(&["denoise", &a, &other, "-o", &out]).failed(3, &["shot.0000.exr", "another resolution", "remedy: "]);
}

#[test]
fn a_shot_is_merged_with_another_shot() {
    let folder = Folder::new();
    for frame in 1..=2 {
        write_seeds(
            "cornell_8spp.exr",
            &folder.path(&format!("a.{frame:04}.exr")),
            &folder.path(&format!("b.{frame:04}.exr")),
        );
    }
    let [a, b, out] = ["a.####.exr", "b.####.exr", "out.####.exr"].map(|name| folder.path(name));
    let document = stein(&["denoise", &a, &b, "-o", &out, RADIUS, "--json"]).succeeded().json();
    let frames = document["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 2);
    assert!(frames.iter().all(|frame| frame["report"]["input"]["frame"]["mode"] == "two seeds"));
    stein(&["denoise", &a, &folder.path("b.0001.exr"), "-o", &out]).failed(2, &["b.0001.exr", "remedy: ", "####"]);
}

#[test]
fn all_view_layers_are_denoised_unless_one_is_named() {
    let folder = Folder::new();
    copy_set(&folder, "cycles");
    let input = folder.path("two_view_layers.exr");
    let out = folder.path("out.exr");
    let document = stein(&["denoise", &input, "-o", &out, RADIUS, "--json"]).succeeded().json();
    assert_eq!(document["further_pictures"].as_array().unwrap().len(), 1, "{document}");
    let (before, after) = (channels(&input), channels(&out));
    let changed: Vec<&str> = before
        .iter()
        .filter(|(name, samples)| after.iter().any(|(other, found)| other == name && found != samples))
        .map(|(name, _)| name.rsplit_once('.').unwrap().0)
        .collect();
    let pictures: Vec<&str> = document["output"]["added_layers"]
        .as_array()
        .unwrap()
        .iter()
        .map(|name| name.as_str().unwrap().strip_suffix(".stein.error").unwrap())
        .collect();
    assert_eq!(pictures.len(), 2);
    assert!(changed.iter().all(|layer| pictures.contains(layer)), "{changed:?}");
    let document = stein(&["denoise", &input, "-o", &out, RADIUS, "--layer", pictures[1], "--json"]).succeeded().json();
    assert!(document.get("further_pictures").is_none());
}

#[test]
fn files_beside_the_input_are_found_named_and_never_replaced() {
    let folder = Folder::new();
    copy_set(&folder, "tungsten");
    let input = folder.path("color.exr");
    let document = stein(&["denoise", &input, "-o", &folder.path("out.exr"), RADIUS, "--json"]).succeeded().json();
    assert_eq!(document["input"]["frame"]["mode"], "variance and two seeds");
    let beside = document["input"]["siblings"].as_array().unwrap();
    assert!(beside.iter().any(|path| path.as_str().unwrap().ends_with("colorVariance.exr")), "{beside:?}");
    stein(&["denoise", &input, "-o", &folder.path("colorA.exr")]).failed(5, &["colorA.exr", "is also read"]);
    stein(&["kernel", &input, "--pixel", "1,1", "-o", &folder.path("albedo.exr")]).failed(5, &["is also read"]);
    let document = stein(&["info", &input, "--no-siblings", "--json"]).succeeded().json();
    assert_eq!(document["files"][0]["frame"]["mode"], "the image itself");
}

#[test]
fn the_samples_are_asked_for_where_they_are_needed() {
    let folder = Folder::new();
    copy_set(&folder, "mitsuba");
    let input = folder.path("moment_of_aov.exr");
    let out = folder.path("out.exr");
    stein(&["denoise", &input, "-o", &out]).failed(3, &["m2_", "second moment", "--samples N"]);
    assert!(!Path::new(&out).exists());
    let document = stein(&["denoise", &input, "-o", &out, "--samples", "16", RADIUS, "--json"]).succeeded().json();
    assert_eq!(document["input"]["frame"]["mode"], "variance");
}

#[test]
fn pfm_and_png_are_read_and_written() {
    let (folder, input) = Folder::with("cornell_8spp.exr");
    let [pfm, png, again] = ["out.pfm", "out.png", "again.pfm"].map(|name| folder.path(name));
    stein(&["denoise", &input, "-o", &pfm, RADIUS]).succeeded();
    stein(&["denoise", &input, "-o", &png, RADIUS]).succeeded().said(&["outside of 0 to 1"]);
    assert!(std::fs::read(&pfm).unwrap().starts_with(b"PF\n96 96\n"));
    assert!(std::fs::read(&png).unwrap().starts_with(b"\x89PNG"));
    let albedo = format!("albedo={}::albedo", input);
    stein(&["denoise", &pfm, "-o", &again, "--feature", &albedo, RADIUS]).succeeded().said(&["the image itself"]);
    stein(&["denoise", &input, "-o", &folder.path("out.jpg")]).failed(2, &["out.jpg", ".pfm or .png"]);
    // A PNG is a picture of the same pixels as a PFM, but for its range.
    let read = |path: &str| {
        let set = BufferSet::read(&BufferSetRequest { input: path.into(), ..Default::default() }).unwrap();
        set.color().mean
    };
    let (from_pfm, from_png) = (read(&pfm), read(&png));
    let pairs = from_pfm.planes.iter().flatten().zip(from_png.planes.iter().flatten());
    assert!(pairs.into_iter().all(|(pfm, png)| (pfm.clamp(0.0, 1.0) - png).abs() < 1e-4));
}

#[test]
fn maps_and_kernels_keep_the_windows_of_a_crop() {
    let folder = Folder::new();
    let extent = stein::Extent { width: 24, height: 16 };
    let data = stein::image::Window { x: -5, y: 40, extent };
    let display = stein::image::Window { x: 0, y: 0, extent: stein::Extent { width: 64, height: 64 } };
    let image = |start: usize| stein::Image {
        extent,
        planes: vec![(0..extent.pixels()).map(|pixel| ((pixel * 7919 + start) % 13) as f32).collect(); 3],
    };
    let layer = |name: &str, start: usize| NamedLayer {
        name: name.into(),
        channels: ["R", "G", "B"].map(String::from).to_vec(),
        image: image(start),
    };
    let input = folder.path("in.exr");
    let layers = [layer("", 0), layer("halfA", 1), layer("halfB", 2)];
    let windows = Windows { data, display };
    write_layers_in(Some(windows), Path::new(&input), &layers, &[("samples".into(), "8".into())]).unwrap();
    let map = folder.path("map.exr");
    stein(&["sample-map", &input, "--budget", "4", "-o", &map, RADIUS]).succeeded();
    assert_eq!(MapFile::read(Path::new(&map)).unwrap().windows, Some(windows));
    let kernel = folder.path("kernel.exr");
    stein(&["kernel", &input, "--pixel", "10,3", "-o", &kernel, RADIUS]).succeeded();
    let read = exr::prelude::read_all_flat_layers_from_file(&kernel).unwrap();
    let part = &read.layer_data[0];
    let side = part.size.0 as i32;
    assert_eq!(part.attributes.layer_position, exr::prelude::Vec2(-5 + 10 - side / 2, 40 + 3 - side / 2));
}
