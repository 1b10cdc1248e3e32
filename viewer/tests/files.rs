//! The window with every file of `testdata/`, and with every layer.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod common;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use common::{drop_files, settle, testdata, window};
use eframe::Storage;
use eframe::egui::{Key, Modifiers, Role};
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT, Queryable};
use stein::{Denoiser, Image, Preset};
use stein_exr::picture_file::{self, Format, PngEncoding};
use stein_exr::{BufferSet, BufferSetRequest, LayerRef, NamedLayer, read_reference, write_layers};
use stein_viewer::document::Source;
use stein_viewer::files::{Purpose, is_reference, short_name};
use stein_viewer::panel::Panel;
use stein_viewer::settings::{Parameters, Settings};
use stein_viewer::{Start, Viewer, words};

/// A method that is done soon.
fn quick(method: &str) -> Option<Parameters> {
    let parameters = Parameters::of(method, Preset::Default).unwrap();
    match parameters.method.with_parameter("window_radius", 2) {
        Ok(method) => Some(Parameters { method, ..parameters }),
        Err(_) => Some(parameters),
    }
}

/// OpenEXR files of a folder, in order.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "exr"));
    files.sort();
    files
}

#[test]
fn every_buffer_set_is_opened_and_denoised() {
    let folders = ["", "anim", "mitsuba"].map(testdata);
    let (references, inputs): (Vec<_>, Vec<_>) =
        folders.iter().flat_map(|folder| files(folder)).partition(|path| is_reference(path));
    assert!(inputs.len() >= 12 && references.len() >= 8, "{inputs:?} {references:?}");
    let mut harness = window(Start { parameters: quick("dfc"), ..Default::default() });
    for input in inputs {
        // cornell_8spp.exr and cornell_reference.exr; shot.0001.exr and reference.0001.exr.
        let (name, folder) = (short_name(&input), input.parent());
        let stem = name.rsplit_once('_').map_or(name.as_str(), |(stem, _)| stem);
        let belongs = |path: &&PathBuf| {
            let other = short_name(path);
            path.parent() == folder
                && (other == format!("{stem}_reference.exr") || other == name.replace("shot", "reference"))
        };
        let reference = references.iter().find(belongs).cloned();
        harness.state_mut().open(Source::whole(input.clone(), reference.clone()));
        settle(&mut harness);
        let viewer = harness.state();
        assert!(viewer.trouble.is_none(), "{}: {:?}", input.display(), viewer.trouble);
        let document = viewer.document.as_ref().unwrap();
        assert_eq!(document.opened.source.as_ref().unwrap().request.input, input);
        let denoised = document.denoised.as_ref().unwrap();
        assert!(denoised.estimate.color.planes.iter().flatten().all(|value| value.is_finite()), "{}", input.display());
        assert_eq!(denoised.error.is_some(), reference.is_some(), "{}", input.display());
    }
}

#[test]
fn every_layer_of_each_method_is_shown_and_its_pixel_told() {
    let input = Some(Source::whole(testdata("anim/shot.0001.exr"), Some(testdata("anim/reference.0001.exr"))));
    for method in Parameters::METHODS {
        let start = Start {
            source: input.clone(),
            parameters: quick(method),
            panel: Panel::Pixel,
            layer: Some("result".into()),
            ..Default::default()
        };
        let mut harness = window(start);
        let names: Vec<_> =
            harness.state().document.as_ref().unwrap().layers().iter().map(|layer| layer.name().to_owned()).collect();
        assert!(names.len() > 15, "{method}: {names:?}");
        for (place, name) in names.iter().enumerate() {
            if place > 0 {
                harness.key_press(Key::Period);
                harness.run_steps(1);
            }
            assert_eq!(harness.state().view.layer, *name, "{method}");
        }
        harness.key_press(Key::Comma);
        harness.state_mut().view.pinned = Some([7, 21]);
        harness.run_steps(2);
        assert_eq!(harness.state().view.layer, names[names.len() - 2]);
        harness.get_by_label("Pixel (7, 21)");
        // A picture of the last one comes from the device without an error.
        harness.render().unwrap();
    }
}

#[test]
fn broken_files_are_told_and_the_window_goes_on() {
    let start = Start {
        source: Some(Source::whole(testdata("anim/shot.0000.exr"), None)),
        parameters: quick("gem"),
        ..Default::default()
    };
    let mut harness = window(start);
    let mut refused = 0;
    let broken = files(&testdata("broken"));
    assert!(broken.len() > 40, "{broken:?}");
    for input in broken {
        let name = short_name(&input);
        harness.state_mut().open(Source::whole(input.clone(), None));
        settle(&mut harness);
        let viewer = harness.state();
        // What can be repaired is opened.
        let is_open = viewer.document.as_ref().unwrap().opened.source.as_ref().unwrap().request.input == input;
        assert_ne!(viewer.trouble.is_some(), is_open, "{name}: {:?}", viewer.trouble);
        assert!(viewer.document.as_ref().unwrap().denoised.is_some(), "{name}");
        if !is_open {
            refused += 1;
            let (_, error) = viewer.trouble.as_ref().unwrap();
            assert!(error.to_string().contains(&name), "{error}");
            harness.get_by_label_contains("Remedy:");
            harness.get_by_label("Dismiss").click();
            harness.run_steps(2);
            assert!(harness.query_by_label("Dismiss").is_none());
        }
    }
    assert!(refused > 30, "{refused}");
    let reference = testdata("anim/reference.0001.exr");
    harness.state_mut().open(Source::whole(testdata("cornell_8spp.exr"), Some(reference)));
    settle(&mut harness);
    harness.get_by_label_contains("reference.0001.exr, layer");
    assert!(harness.state().trouble.as_ref().unwrap().1.to_string().contains("another resolution"));
}

#[test]
fn files_that_are_dropped_are_opened_and_a_reference_is_told_by_its_name() {
    let mut harness = window(Start { parameters: quick("gem"), ..Default::default() });
    let [first, second, reference] =
        ["anim/shot.0000.exr", "anim/shot.0001.exr", "anim/reference.0001.exr"].map(testdata);
    let is_open = |harness: &Harness<'static, Viewer>, input: &PathBuf, reference: Option<&PathBuf>| {
        let document = harness.state().document.as_ref().unwrap();
        let source = document.opened.source.as_ref().unwrap();
        assert_eq!(*source, Source::whole(input.clone(), reference.cloned()));
        assert_eq!(document.denoised.as_ref().unwrap().error.is_some(), reference.is_some());
    };
    harness.get_by_label("Drop the files of a frame here");
    drop_files(&mut harness, std::slice::from_ref(&first));
    is_open(&harness, &first, None);
    // In whichever order they come.
    for files in [[&second, &reference], [&reference, &second]] {
        drop_files(&mut harness, &files.map(PathBuf::clone));
        is_open(&harness, &second, Some(&reference));
        drop_files(&mut harness, std::slice::from_ref(&first));
        is_open(&harness, &first, None);
    }
    // By itself it is that of what is open, and stays nowhere else.
    drop_files(&mut harness, std::slice::from_ref(&reference));
    is_open(&harness, &first, Some(&reference));

    let broken = testdata("broken/cut_in_block_1.exr");
    drop_files(&mut harness, std::slice::from_ref(&broken));
    harness.get_by_label_contains("cut_in_block_1.exr");
    is_open(&harness, &first, Some(&reference));
    drop_files(&mut harness, &[second.clone(), broken]);
    assert!(harness.state().trouble.is_none(), "one file is opened, the first");
    harness.get_by_label_contains("only shot.0001.exr is open: ");
    harness.get_by_label_contains("cut_in_block_1.exr");
    is_open(&harness, &second, None);
    drop_files(&mut harness, &[reference.clone(), testdata("cornell_reference.exr")]);
    harness.get_by_label("A frame has one reference, left out: cornell_reference.exr");
    is_open(&harness, &second, Some(&reference));

    // With nothing to compare with, it waits for the next frame, and for no other.
    let mut harness = window(Start { parameters: quick("gem"), ..Default::default() });
    drop_files(&mut harness, std::slice::from_ref(&reference));
    harness.get_by_label("The reference reference.0001.exr waits for its frame.");
    drop_files(&mut harness, std::slice::from_ref(&second));
    is_open(&harness, &second, Some(&reference));
    drop_files(&mut harness, std::slice::from_ref(&first));
    is_open(&harness, &first, None);

    // What is being read is what it belongs to.
    let context = harness.ctx.clone();
    harness.state_mut().open(Source::whole(second.clone(), None));
    harness.state_mut().take_file(Purpose::Reference, reference.clone(), &context);
    settle(&mut harness);
    is_open(&harness, &second, Some(&reference));

    // Where it is broken, the frame is opened without.
    let folder = tempfile::tempdir().unwrap();
    let reference = folder.path().join("reference.exr");
    std::fs::copy(testdata("broken/cut_in_block_1.exr"), &reference).unwrap();
    let mut harness = window(Start { parameters: quick("gem"), ..Default::default() });
    drop_files(&mut harness, &[reference]);
    drop_files(&mut harness, std::slice::from_ref(&first));
    harness.get_by_label_contains("reference.exr");
    is_open(&harness, &first, None);
}

/// OpenEXR files of a folder and of the folders in it.
fn files_below(folder: &Path) -> Vec<PathBuf> {
    let folders = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_dir());
    let below: Vec<PathBuf> = folders.flat_map(|folder| files_below(&folder)).collect();
    files(folder).into_iter().chain(below).collect()
}

#[test]
fn every_renderers_file_is_opened_or_told_with_a_remedy() {
    let mut harness = window(Start { parameters: quick("gem"), panel: Panel::Report, ..Default::default() });
    let inputs = files_below(&testdata("layouts"));
    assert!(inputs.len() > 100, "{inputs:?}");
    let mut refused = Vec::new();
    for input in &inputs {
        harness.state_mut().open(Source::whole(input.clone(), None));
        settle(&mut harness);
        let viewer = harness.state();
        if let Some((_, error)) = &viewer.trouble {
            let told = words::told(error);
            assert!(told.contains(&short_name(input)) && told.contains("remedy: "), "{}: {told}", input.display());
            refused.push(told);
            harness.get_by_label("Dismiss").click();
            harness.run_steps(2);
            continue;
        }
        let document = viewer.document.as_ref().unwrap();
        assert_eq!(document.opened.source.as_ref().unwrap().request.input, *input);
        assert!(document.denoised.is_some(), "{}", input.display());
        let layout = document.opened.input.as_ref().unwrap().layout.title.clone();
        harness.get_by_label_contains(&format!("layout: {layout} ("));
    }
    assert!(refused.len() < 10, "{}", refused.join("\n"));
}

#[test]
fn a_file_of_several_pictures_opens_with_the_first_and_a_choice_of_the_others() {
    let input = testdata("layouts/cycles/two_view_layers.exr");
    let start = Start {
        source: Some(Source::whole(input.clone(), None)),
        parameters: quick("gem"),
        panel: Panel::Report,
        ..Default::default()
    };
    let mut harness = window(start);
    let is_open = |harness: &Harness<'static, Viewer>, layer: Option<&str>, picture: &str| {
        let document = harness.state().document.as_ref().unwrap();
        let request = &document.opened.source.as_ref().unwrap().request;
        assert_eq!((&request.input, request.layer.as_deref()), (&input, layer));
        assert_eq!(document.opened.input.as_ref().unwrap().pictures, ["ViewLayer.Combined", "fg.Combined"]);
        let set = BufferSet::read(&BufferSetRequest { layer: Some(picture.into()), ..request.clone() }).unwrap();
        assert!(document.opened.frame.color().mean == set.to_frame().unwrap().0.color().mean, "another picture");
        assert_eq!(harness.get_by_role(Role::ComboBox).value().as_deref(), Some(picture));
    };
    is_open(&harness, None, "ViewLayer.Combined");
    harness.get_by_label("picture 1 of 2 in the file: ViewLayer.Combined");
    harness.get_by_label_contains("layout: Blender Cycles");

    harness.get_by_role(Role::ComboBox).click();
    harness.run_steps(2);
    harness.get_by_label("fg.Combined").click();
    settle(&mut harness);
    is_open(&harness, Some("fg.Combined"), "fg.Combined");
    harness.get_by_label("picture 2 of 2 in the file: fg.Combined");
    // By keys, round and round.
    harness.key_press(Key::P);
    settle(&mut harness);
    is_open(&harness, None, "ViewLayer.Combined");
    harness.key_press_modifiers(Modifiers::SHIFT, Key::P);
    settle(&mut harness);
    is_open(&harness, Some("fg.Combined"), "fg.Combined");

    // A file of one picture has no choice.
    harness.state_mut().open(Source::whole(testdata("anim/shot.0000.exr"), None));
    settle(&mut harness);
    assert!(harness.query_by_role(Role::ComboBox).is_none());
    harness.key_press(Key::P);
    settle(&mut harness);
    assert!(harness.state().trouble.is_none());
}

#[test]
fn files_that_come_together_are_seeds_or_belong_to_one_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let set = BufferSet::read(&BufferSetRequest { input: testdata("cornell_8spp.exr"), ..Default::default() }).unwrap();
    let color = set.color();
    let write = |name: &str, image: &Image| {
        let channels = ["R", "G", "B"].map(String::from).into();
        write_layers(&folder.path().join(name), &[NamedLayer { name: "".into(), channels, image: image.clone() }], &[])
            .unwrap();
        folder.path().join(name)
    };
    let seeds = [write("a.exr", color.half_a.as_ref().unwrap()), write("b.exr", color.half_b.as_ref().unwrap())];
    let request = |input: &Path, seeds: &[PathBuf]| BufferSetRequest {
        input: input.to_owned(),
        seeds: seeds.to_vec(),
        ..Default::default()
    };
    let is_open = |harness: &Harness<'static, Viewer>, expected: BufferSetRequest, reference: Option<PathBuf>| {
        assert!(harness.state().trouble.is_none(), "{:?}", harness.state().trouble);
        let opened = &harness.state().document.as_ref().unwrap().opened;
        let reference = reference.map(LayerRef::whole);
        assert_eq!(opened.source, Some(Source { request: expected, reference }));
        opened.clone()
    };
    let mut harness = window(Start { parameters: quick("gem"), panel: Panel::Report, ..Default::default() });
    let truth = testdata("cornell_reference.exr");
    drop_files(&mut harness, &[seeds[0].clone(), truth.clone(), seeds[1].clone()]);
    let opened = is_open(&harness, request(&seeds[0], &seeds[1..]), Some(truth));
    assert!(opened.frame.color().half_spread.is_some() && opened.contradiction.is_none(), "{:?}", opened.contradiction);
    assert!(opened.left_out.is_none());
    harness.get_by_label_contains("another seed: ");
    // None of them is replaced by a result.
    let context = harness.ctx.clone();
    harness.state_mut().take_file(Purpose::SaveResult, seeds[1].clone(), &context);
    settle(&mut harness);
    harness.get_by_label_contains("is open here, and would be replaced");
    harness.get_by_label("Dismiss").click();

    // Another image of the same size, of which no header tells that it is another one.
    let (_, albedo) = set.features().find(|(name, _)| *name == "albedo").unwrap();
    drop_files(&mut harness, &[seeds[0].clone(), write("other.exr", &albedo.mean)]);
    is_open(&harness, request(&seeds[0], &[]), None);
    harness.get_by_label_contains("the halves differ by more than noise");

    // Frames of a shot, and files of other sizes.
    let shot = ["anim/shot.0000.exr", "anim/shot.0001.exr"].map(testdata);
    for files in [&shot, &[seeds[0].clone(), shot[1].clone()]] {
        drop_files(&mut harness, files);
        is_open(&harness, request(&files[0], &[]), None);
        harness.get_by_label_contains(&format!("only {} is open: ", short_name(&files[0])));
    }
    harness.get_by_label("Dismiss").click();
    harness.run_steps(2);
    assert!(harness.query_by_label("Dismiss").is_none());

    // Files with other buffers have the same size, and are no seeds.
    let buffers = ["albedo.exr", "albedoVariance.exr", "color.exr", "colorA.exr", "colorB.exr", "colorVariance.exr"];
    let buffers = buffers.map(|name| testdata("layouts/tungsten").join(name));
    drop_files(&mut harness, &buffers);
    let opened = is_open(&harness, request(&buffers[2], &[]), None);
    assert!(opened.left_out.is_none());
    let siblings = opened.input.unwrap().siblings;
    assert!(buffers.iter().all(|file| *file == buffers[2] || siblings.contains(file)), "{siblings:?}");
    harness.get_by_label_contains("found beside it: ");
    harness.state_mut().take_file(Purpose::SaveResult, buffers[0].clone(), &context);
    settle(&mut harness);
    harness.get_by_label_contains("is open here, and would be replaced");
    drop_files(&mut harness, &[&buffers[..], &shot[..1]].concat());
    is_open(&harness, request(&buffers[2], &[]), None);
    harness.get_by_label_contains("left out: shot.0000.exr");
}

#[test]
fn pictures_without_layers_are_opened_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let set = BufferSet::read(&BufferSetRequest { input: testdata("cornell_8spp.exr"), ..Default::default() }).unwrap();
    let (_, albedo) = set.features().find(|(name, _)| *name == "albedo").unwrap();
    let mean = set.color().mean;
    for (name, image) in [("color.pfm", &mean), ("color.png", &mean), ("tint.pfm", &albedo.mean)] {
        let format = Format::from_extension(Path::new(name)).unwrap();
        picture_file::write(&path(name), image, format, PngEncoding::Srgb).unwrap();
    }
    let features = vec![("albedo".to_owned(), LayerRef::whole(path("tint.pfm")))];
    let request = BufferSetRequest { input: path("color.pfm"), features, ..Default::default() };
    let source = Source { request, reference: Some(LayerRef::whole(testdata("cornell_reference.exr"))) };
    let mut harness = window(Start { source: Some(source), parameters: quick("dfc"), ..Default::default() });
    assert!(harness.state().trouble.is_none(), "{:?}", harness.state().trouble);
    let document = harness.state().document.as_ref().unwrap();
    assert!(document.opened.frame.color().mean == mean && document.opened.frame.features().len() == 1);
    let result = document.denoised.as_ref().unwrap().estimate.color.clone();

    let context = harness.ctx.clone();
    harness.state_mut().take_file(Purpose::SaveResult, path("result.pfm"), &context);
    settle(&mut harness);
    harness.get_by_label("Wrote result.pfm; without other layers");
    assert!(read_reference(&path("result.pfm"), None).unwrap() == result, "other bits than the result's");
    harness.state_mut().take_file(Purpose::SaveResult, path("result.png"), &context);
    settle(&mut harness);
    harness.get_by_label_contains("Wrote result.png; without other layers");
    assert_eq!(read_reference(&path("result.png"), None).unwrap().extent, result.extent);

    drop_files(&mut harness, &[path("color.png")]);
    assert!(harness.state().trouble.is_none(), "{:?}", harness.state().trouble);
    let opened = &harness.state().document.as_ref().unwrap().opened;
    assert_eq!(opened.source, Some(Source::whole(path("color.png"), None)));
}

#[test]
fn a_file_that_does_not_tell_its_samples_asks_for_their_number() {
    let input = testdata("layouts/mitsuba/moment_of_aov.exr");
    let mut harness = window(Start {
        source: Some(Source::whole(input.clone(), None)),
        parameters: quick("gem"),
        panel: Panel::Report,
        ..Default::default()
    });
    harness.get_by_label_contains("nothing says how many samples a pixel has");
    for (text, is_number) in [("0", false), ("16", true)] {
        let edit = harness.get_by_role(Role::TextInput);
        edit.focus();
        edit.type_text(text);
        harness.run_steps(2);
        assert_eq!(harness.get_by_label("Open with these").accesskit_node().is_disabled(), !is_number);
        harness.key_press_modifiers(Modifiers::COMMAND, Key::A);
        harness.run_steps(1);
    }
    harness.get_by_label("Open with these").click();
    settle(&mut harness);
    assert!(harness.state().trouble.is_none() && harness.query_by_role(Role::TextInput).is_none());
    let opened = &harness.state().document.as_ref().unwrap().opened;
    let request = BufferSetRequest { input, samples: Some(16), ..Default::default() };
    assert_eq!(opened.source, Some(Source { request, reference: None }));
    assert!(opened.frame.color().variance_of_mean.is_some());
}

#[test]
fn a_variance_that_the_image_contradicts_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let set = BufferSet::read(&BufferSetRequest { input: testdata("cornell_8spp.exr"), ..Default::default() }).unwrap();
    let color = set.color();
    let mut variance = color.variance_of_mean.unwrap();
    variance.planes.iter_mut().flatten().for_each(|value| *value *= 40.0);
    let layer = |name: &str, image: Image| NamedLayer {
        name: name.into(),
        channels: ["R", "G", "B"].map(String::from).into(),
        image,
    };
    let input = folder.path().join("render.exr");
    write_layers(&input, &[layer("", color.mean), layer("variance", variance)], &[]).unwrap();
    let source = Some(Source::whole(input, None));
    let harness = window(Start { source, parameters: quick("gem"), panel: Panel::Report, ..Default::default() });
    harness.get_by_label_contains("times too large for the noise in the image");
}

/// A set whose parts are in files of their own, some of them among other layers, and its reference.
fn scattered(folder: &Path) -> Source {
    let set = BufferSet::read(&BufferSetRequest { input: testdata("cornell_8spp.exr"), ..Default::default() }).unwrap();
    let color = set.color();
    let (_, albedo) = set.features().find(|(name, _)| *name == "albedo").unwrap();
    let layer = |name: &str, image: &Image| NamedLayer {
        name: name.into(),
        channels: ["R", "G", "B"].map(String::from).into(),
        image: image.clone(),
    };
    let other = Image::filled(set.extent(), 3, 0.25);
    let write = |name: &str, layers: &[NamedLayer]| {
        write_layers(&folder.join(name), layers, &[]).unwrap();
        folder.join(name)
    };
    let of = |file: PathBuf, name: &str| LayerRef { file, layer: Some(name.into()) };
    let half_b = write("b.exr", &[layer("seed1", &other), layer("seed2", color.half_b.as_ref().unwrap())]);
    let features = [
        layer("tint", &albedo.mean),
        layer("tint_halfA", albedo.half_a.as_ref().unwrap()),
        layer("tint_halfB", albedo.half_b.as_ref().unwrap()),
        layer("position", &other),
    ];
    let truth = read_reference(&testdata("cornell_reference.exr"), None).unwrap();
    Source {
        request: BufferSetRequest {
            input: write("both.exr", &[layer("left", &color.mean), layer("right", &other), layer("normal", &other)]),
            layer: Some("left".into()),
            half_a: Some(LayerRef::whole(write("a.exr", &[layer("", color.half_a.as_ref().unwrap())]))),
            half_b: Some(of(half_b, "seed2")),
            variance: color
                .variance_of_mean
                .map(|variance| LayerRef::whole(write("variance.exr", &[layer("", &variance)]))),
            features: vec![("albedo".into(), of(write("aux.exr", &features), "tint"))],
            skip_features: vec!["normal".into()],
            no_features: false,
            ..Default::default()
        },
        reference: Some(of(
            write("truth.exr", &[layer("noisy", &color.mean), layer("converged", &truth)]),
            "converged",
        )),
    }
}

/// What a window remembers.
#[derive(Default)]
struct Memory(HashMap<String, String>);

impl Storage for Memory {
    fn get_string(&self, key: &str) -> Option<String> {
        self.0.get(key).cloned()
    }
    fn set_string(&mut self, key: &str, value: String) {
        self.0.insert(key.to_owned(), value);
    }
    fn remove_string(&mut self, key: &str) {
        self.0.remove(key);
    }
    fn flush(&mut self) {}
}

#[test]
fn parts_of_a_frame_come_from_other_files_and_are_saved_and_remembered_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let source = scattered(folder.path());
    let parameters = quick("dfc");
    let start = Start { source: Some(source.clone()), parameters, panel: Panel::Report, ..Default::default() };
    let mut harness = window(start.clone());
    assert!(harness.state().trouble.is_none(), "{:?}", harness.state().trouble);
    for told in [
        "both.exr::left",
        "a.exr",
        "b.exr::seed2",
        "aux.exr::tint",
        "truth.exr::converged",
        "without the feature normal",
    ] {
        harness.get_by_label_contains(told);
    }

    // The library's bits.
    let gpu = harness.state().gpu.clone();
    let method = parameters.unwrap().method;
    let read = |input: PathBuf| BufferSet::read(&BufferSetRequest { input, ..Default::default() }).unwrap();
    let set = BufferSet::read(&source.request).unwrap();
    let whole = read(testdata("cornell_8spp.exr"));
    assert!(set.color() == whole.color(), "the file that it was scattered from");
    let estimate = Denoiser::new(&gpu, method).unwrap().denoise(&set.to_frame().unwrap().0).unwrap();
    let is_the_librarys = |harness: &Harness<'static, Viewer>| {
        let document = harness.state().document.as_ref().unwrap();
        assert_eq!(document.opened.source.as_ref(), Some(&source));
        let denoised = document.denoised.as_ref().unwrap();
        assert!(
            denoised.estimate.color == estimate.color && denoised.estimate.error == estimate.error,
            "other bits than the library's"
        );
        let truth = read_reference(&testdata("cornell_reference.exr"), None).unwrap();
        assert_eq!(denoised.error.unwrap(), stein_metric::relative_mse(&estimate.color, &truth).unwrap());
    };
    is_the_librarys(&harness);

    // The result is written into the file of the colour; none that it was made from is replaced.
    let context = harness.ctx.clone();
    stein_exr::write_estimate(&estimate, set, &path("library.exr"), &[], &method).unwrap();
    harness.state_mut().take_file(Purpose::SaveResult, path("own.exr"), &context);
    settle(&mut harness);
    assert!(
        std::fs::read(path("own.exr")).unwrap() == std::fs::read(path("library.exr")).unwrap(),
        "another file than the library's"
    );
    for read in source.files() {
        let before = std::fs::read(read).unwrap();
        harness.state_mut().take_file(Purpose::SaveResult, read.to_owned(), &context);
        settle(&mut harness);
        harness.get_by_label_contains("is open here, and would be replaced");
        assert!(std::fs::read(read).unwrap() == before);
    }

    // Another start, with what was remembered of this one.
    let mut memory = Memory::default();
    eframe::App::save(harness.state_mut(), &mut memory);
    let mut harness = window(Start { parameters, ..Default::default() });
    harness.state_mut().settings = eframe::get_value(&memory, Settings::KEY).unwrap();
    harness.run_steps(2);
    harness.get_by_label("both.exr::left with truth.exr").click();
    settle(&mut harness);
    is_the_librarys(&harness);

    // What cannot be read is told, and what is open stays.
    let request = || source.request.clone();
    let features = vec![("albedo".to_owned(), LayerRef { file: path("aux.exr"), layer: Some("tnt".into()) })];
    let missing = Some(LayerRef::whole(path("missing.exr")));
    let cases: [(BufferSetRequest, &[&str]); 5] = [
        (BufferSetRequest { half_b: missing, ..request() }, &["missing.exr"]),
        (
            BufferSetRequest { half_a: None, ..request() },
            &["b.exr, layer 'seed2'", "add half A (for the colour: --half-a)"],
        ),
        (
            BufferSetRequest { skip_features: vec!["nonsense".into()], ..request() },
            &["both.exr: there is no feature 'nonsense' to skip", "--skip-feature"],
        ),
        (
            BufferSetRequest { layer: None, ..request() },
            &["both.exr: has several layers", "behind its file, on the command line: FILE::NAME"],
        ),
        (BufferSetRequest { features, ..request() }, &["aux.exr, layer 'tnt'"]),
    ];
    for (request, told) in cases {
        harness.state_mut().open(Source { request, ..source.clone() });
        settle(&mut harness);
        told.iter().for_each(|told| {
            assert!(
                harness.query_all_by_label_contains(told).next().is_some(),
                "{told}: {:?}",
                harness.state().trouble
            );
        });
        is_the_librarys(&harness);
    }
    harness.state_mut().open(Source {
        reference: Some(LayerRef { file: path("truth.exr"), layer: Some("true".into()) }),
        ..source.clone()
    });
    settle(&mut harness);
    harness.get_by_label_contains("truth.exr, layer 'true': there is no such layer");
}

#[test]
fn the_command_line_takes_parts_of_a_frame_from_other_files() {
    let folder = tempfile::tempdir().unwrap();
    scattered(folder.path());
    let picture = folder.path().join("picture.png");
    let program = |options: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_stein-viewer"));
        let output = command
            .env("STEIN_CACHE", "")
            .current_dir(&folder)
            .args(["--method=gem", "--screenshot=picture.png"])
            .args(options)
            .output()
            .unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let set = [
        "both.exr::left",
        "--half-a=a.exr",
        "--half-b=b.exr::seed2",
        "--feature=albedo=aux.exr::tint",
        "--no-features",
    ];
    let (code, said) = program(&[&set[..], &["--reference=truth.exr::converged", "--layer=true_error"]].concat());
    assert!(code == Some(0) && picture.exists(), "{said}");
    let cases: [(&[&str], i32, &[&str]); 6] = [
        (&["--reference=truth.exr::true"], 3, &["truth.exr, layer 'true'", "'converged'"]),
        (&["--reference=truth.exr"], 3, &["truth.exr: has several layers", "FILE::NAME"]),
        (
            &["--skip-feature=nonsense"],
            3,
            &["both.exr: there is no feature 'nonsense' to skip", "'normal'", "--skip-feature"],
        ),
        (&["--variance=missing.exr"], 3, &["missing.exr"]),
        (&["--feature=depth=aux.exr::depth"], 3, &["aux.exr, layer 'depth'"]),
        (&["--feature=aux.exr"], 2, &["NAME=FILE::LAYER"]),
    ];
    for (options, expected, told) in cases {
        let (code, said) = program(&[&set[..], options].concat());
        assert!(code == Some(expected) && told.iter().all(|told| said.contains(told)), "{options:?}: {code:?} {said}");
    }
    // Its path is a file's, not that of a layer.
    if cfg!(unix) {
        let odd = folder.path().join("a::b");
        std::fs::create_dir(&odd).unwrap();
        std::fs::copy(testdata("anim/shot.0000.exr"), odd.join("shot.exr")).unwrap();
        let (code, said) = program(&["a::b/shot.exr"]);
        assert_eq!(code, Some(0), "{said}");
    }
    // Further files are seeds.
    let (code, said) = program(&["a.exr", "b.exr", "--panel=report"]);
    assert!(code == Some(3) && said.contains("b.exr"), "{code:?} {said}");
    let (code, said) = program(&["a.exr", "b_reference.exr"]);
    assert!(code == Some(2) && said.contains("--reference b_reference.exr"), "{code:?} {said}");
    let (code, said) = program(&["--adapt=soft", "--half-a=a.exr"]);
    assert!(code == Some(2) && said.contains("none is given") && said.contains("remedy:"), "{said}");
}

#[test]
fn what_an_older_window_remembers_of_files_is_forgotten_and_the_rest_is_not() {
    #[derive(serde::Serialize)]
    struct Older {
        recent: Vec<(PathBuf, Option<PathBuf>)>,
        parameters: Option<String>,
    }
    let mut memory = Memory::default();
    let recent = vec![("a.exr".into(), Some("reference.exr".into())), ("b.exr".into(), None)];
    eframe::set_value(&mut memory, Settings::KEY, &Older { recent, parameters: Some("method = \"gem\"".into()) });
    let settings: Settings = eframe::get_value(&memory, Settings::KEY).unwrap();
    assert!(settings.recent.is_empty());
    assert_eq!(settings.parameters.as_deref(), Some("method = \"gem\""));
}

#[test]
#[cfg(unix)]
fn a_file_whose_name_cannot_be_written_down_costs_no_other_memory() {
    use std::os::unix::ffi::OsStringExt;
    let mut settings = Settings { parameters: Some("method = \"gem\"".into()), ..Default::default() };
    settings.remember(&Source::whole(testdata("cornell_8spp.exr"), None));
    settings.remember(&Source::whole(std::ffi::OsString::from_vec(b"\xff.exr".to_vec()).into(), None));
    let mut memory = Memory::default();
    eframe::set_value(&mut memory, Settings::KEY, &settings);
    let again: Settings = eframe::get_value(&memory, Settings::KEY).unwrap();
    assert_eq!((again.recent.len(), again.parameters), (1, settings.parameters));
}
