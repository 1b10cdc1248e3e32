//! `stein layouts`, what `stein info` says of the files of several renderers, and `--strict`.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "common/process.rs"]
mod process;

use std::path::Path;

use process::{Folder, Outcome, command, stein, test_image};
use stein::Image;
use stein::frame::RawSignal;
use stein_exr::{BufferSet, BufferSetRequest, NamedLayer};

/// Runs `stein info` in the folder of the layouts' files, so that the paths are short.
fn info(arguments: &[&str]) -> Outcome {
    let output = command(&[&["info"], arguments].concat()).current_dir(test_image("layouts")).output().unwrap();
    Outcome {
        code: output.status.code().unwrap(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

/// The colour of a render of 8 samples per pixel, with its halves and its variance.
fn color() -> RawSignal {
    let request = BufferSetRequest { input: test_image("cornell_8spp.exr").into(), ..Default::default() };
    BufferSet::read(&request).unwrap().color()
}

fn rgb(name: &str, image: Image) -> NamedLayer {
    NamedLayer { name: name.into(), channels: ["R", "G", "B"].map(String::from).to_vec(), image }
}

/// Compares the text with a file of `testdata/layouts/info`.
#[track_caller]
fn assert_text(told: &Outcome, code: i32, name: &str) {
    assert_eq!(told.code, code, "{}", told.stderr);
    let expected = std::fs::read_to_string(test_image(&format!("layouts/info/{name}.txt"))).unwrap();
    assert!(told.stdout == expected, "{}\ninstead of\n{expected}", told.stdout);
}

#[test]
fn a_file_of_pbrt_is_explained() {
    assert_text(&info(&["pbrt/gbuffer.exr"]), 0, "pbrt");
}

#[test]
fn view_layers_of_cycles_are_explained() {
    assert_text(&info(&["cycles/two_view_layers.exr"]), 0, "cycles");
}

#[test]
fn a_set_of_files_of_tungsten_is_explained() {
    assert_text(&info(&["tungsten/color.exr"]), 0, "tungsten");
}

#[test]
fn a_file_of_renderman_is_explained() {
    assert_text(&info(&["renderman/ci.0001.exr"]), 0, "renderman");
}

#[test]
fn moments_of_mitsuba_need_the_number_of_samples() {
    let asked = info(&["mitsuba/moment_of_aov.exr"]);
    assert_text(&asked, 3, "mitsuba");
    asked.failed(3, &["mitsuba/moment_of_aov.exr, layer 'm2_nested.img'", "second moment", "--samples N"]);
    let told = info(&["mitsuba/moment_of_aov.exr", "--samples", "16"]).succeeded();
    told.said(&[
        ": ready to be denoised",
        "noise     known from variance (m2_nested.img, a second moment: converted)",
        "command   stein denoise mitsuba/moment_of_aov.exr -o mitsuba/moment_of_aov.denoised.exr --samples 16\n",
    ]);
}

#[test]
fn what_looks_like_a_variance_and_is_none_is_named() {
    info(&["vray/maya.exr"]).succeeded().said(&[
        "its noise is not known",
        "not used  noiseLevel: a renderer's noise heuristic, not a variance",
        "along     2 light layers, alpha",
        "copied    2 ids, 1 denoised by the renderer, 4 others (-v lists them)",
    ]);
}

#[test]
fn options_say_what_is_denoised_along() {
    let file = "renderman/ci.0001.exr";
    info(&[file, "--aovs", "none"]).succeeded().said(&["along     alpha\n", "copied    4 lights", " --aovs none\n"]);
    info(&[file, "--aovs", "diffuse", "--no-alpha", "--alpha", "straight"])
        .succeeded()
        .said(&["along     1 light layer\n", "--aovs diffuse --alpha straight --no-alpha\n"]);
    info(&[file, "--aovs", "difuse"]).failed(3, &[file, "'difuse'", "diffuse", "remedy: ", "--aovs"]);
    info(&[file, "--aovs", "id"]).failed(3, &[file, "remedy: ", "--aovs"]);
    info(&[file, "--alpha", "none"]).failed(2, &["straight", "premultiplied"]);
    info(&[file, "-v"])
        .succeeded()
        .said(&["light, denoised along", "a half or variance of a layer that is denoised along"]);
}

#[test]
fn seeds_are_named_and_belong_to_the_command() {
    info(&["altus/room.b0.0001.exr"]).succeeded().said(&["seeds     merged with room.b1.0001.exr"]);
    let folder = Folder::new();
    let [a, b] = ["a.exr", "b.exr"].map(|name| folder.path(name));
    let color = color();
    for (half, file) in [(color.half_a, &a), (color.half_b, &b)] {
        stein_exr::write_layers(Path::new(file), &[rgb("", half.unwrap())], &[]).unwrap();
    }
    let output = folder.path("a.denoised.exr");
    stein(&["info", &a]).succeeded().said(&[
        "a.exr: can be denoised, but its noise is not known and has to be estimated",
        &format!("command   stein denoise {a} -o {output}\n"),
        &format!("stein denoise {a} OTHER_SEED.exr -o {output}\n"),
    ]);
    stein(&["info", &a, "--seed", &b]).succeeded().said(&[
        "a.exr: ready to be denoised",
        "seeds     merged with b.exr",
        "check     no contradiction between the halves and the noise in the image",
        &format!("command   stein denoise {a} {b} -o {output}\n"),
    ]);
    stein(&["denoise", &a, &b, "-o", &output, "--dry-run"]).succeeded().said(&[&format!("with: {b} (another seed)")]);
}

#[test]
fn every_layer_is_listed_on_request_and_in_documents() {
    let told = info(&["cycles/5_0.exr", "-v"]).succeeded();
    told.said(&[
        "    ViewLayer.Vector [",
        "motion in pixels",
        "    ViewLayer.Denoising Albedo [R G B] float: feature albedo",
    ]);
    let document = info(&["cycles/5_0.exr", "--json"]).succeeded().json();
    let file = &document["files"][0];
    assert_eq!(file["layers"].as_array().unwrap().len(), 16);
    assert_eq!(file["layout"]["name"], "cycles");
    assert_eq!(file["verdict"]["state"], "noise_unknown");
    assert_eq!(file["verdict"]["copied"]["lights"], 0);
    assert_eq!(file["along"]["lights"].as_array().unwrap().len(), 3);
    assert!(file["verdict"]["better"]["command"].as_str().unwrap().contains("OTHER_SEED.exr"));
    assert!(file["frame"]["check"]["contradiction"].is_null());
}

#[test]
fn files_that_cannot_be_read_are_refused_with_the_way_out() {
    let folder = Folder::new();
    let bytes = std::fs::read(test_image("layouts/pbrt/gbuffer.exr")).unwrap();
    for (name, content) in [("empty.exr", &bytes[..0]), ("cut.exr", &bytes[..bytes.len() / 2]), ("a.txt", b"text")] {
        let file = folder.path(name);
        std::fs::write(&file, content).unwrap();
        stein(&["info", &file]).failed(3, &[name, "remedy: "]);
    }
    stein(&["info", &folder.path("")]).failed(3, &["remedy: "]);
    stein(&["info", &test_image("cornell_8spp.exr"), "--layer", "nothing"]).failed(3, &["'nothing'", "remedy: "]);
}

#[test]
fn layouts_are_listed_and_serve_as_a_beginning() {
    let list = stein(&["layouts"]).succeeded();
    list.said(&["  cycles   ", "  native   ", "pbrt-v4 (GBufferFilm)\n"]);
    let document = stein(&["layouts", "--json"]).succeeded().json();
    let layouts = document["layouts"].as_array().unwrap();
    assert_eq!(layouts.len(), list.stdout.lines().count());
    assert!(layouts.iter().any(|layout| layout["name"] == "vray" && layout["title"] == "V-Ray"));

    let shown = stein(&["layouts", "--show", "pbrt"]).succeeded();
    shown.said(&["title = \"pbrt-v4 (GBufferFilm)\"", "[[recognise]]"]);
    assert_eq!(stein(&["layouts", "--show=pbrt", "--json"]).json()["layouts"][0]["document"], shown.stdout.as_str());
    let (folder, pbrt) = (Folder::new(), test_image("layouts/pbrt/gbuffer.exr"));
    let own = folder.path("own.toml");
    std::fs::write(&own, shown.stdout.replace("pbrt-v4 (GBufferFilm)", "my renderer")).unwrap();
    stein(&["layouts", "--show", &own]).succeeded().said(&["title = \"my renderer\""]);
    stein(&["info", &pbrt, "--layout", &own])
        .succeeded()
        .said(&["renderer  my renderer; layout own, as requested", &format!("--layout {own}")]);

    stein(&["layouts", "--show", "nothing"]).failed(3, &["neither a layout nor a file", "altus", "remedy: "]);
    std::fs::write(&own, "title = 1").unwrap();
    stein(&["layouts", "--show", &own]).failed(3, &["own.toml", "is no layout", "remedy: "]);
    stein(&["denoise", "--help"]).succeeded().said(&["stein layouts"]);
}

/// Writes the colour of a render of 8 samples per pixel with the variance of one sample, and with its halves if
/// `halves` says so.
fn write_variance_of_one_sample(halves: bool, to: &str) {
    let color = color();
    let mut variance = color.variance_of_mean.unwrap();
    variance.planes.iter_mut().flatten().for_each(|value| *value *= 8.0);
    let mut layers = vec![rgb("", color.mean), rgb("variance", variance)];
    if halves {
        layers.extend([rgb("halfA", color.half_a.unwrap()), rgb("halfB", color.half_b.unwrap())]);
    }
    stein_exr::write_layers(Path::new(to), &layers, &[("samples".into(), "8".into())]).unwrap();
}

#[test]
fn a_contradiction_is_told_with_its_remedy_which_helps() {
    let folder = Folder::new();
    let (input, output) = (folder.path("in.exr"), folder.path("out.exr"));
    write_variance_of_one_sample(true, &input);
    let told = stein(&["info", &input]).succeeded();
    told.said(&[
        "in.exr: can be denoised, but what it tells of its noise is contradictory",
        "check     the variance is ",
        "times too large",
        "variance of one sample",
        "--layout FILE",
        "--samples N",
    ]);
    let check = &stein(&["info", &input, "--json"]).succeeded().json()["files"][0]["frame"]["check"];
    let factor = check["contradiction"]["factor"].as_f64().unwrap();
    assert!((5.0..12.0).contains(&factor), "{check}");
    assert_eq!(check["contradiction"]["kind"], "variance_too_large");
    assert!(check["halves_over_variance"].as_f64().unwrap() < 0.2, "{check}");
    stein(&["denoise", &input, "-o", &output, "--dry-run"]).succeeded().said(&[
        "contradiction in the noise: the variance is ",
        "remedy: ",
        "nothing is written",
    ]);

    // The remedy: a layout that says what the layer holds.
    let native = stein(&["layouts", "--show", "native"]).succeeded().stdout;
    let rule = "name = [\"{group}variance\", \"{group}var\", \"{group}mse\"]\nexact = true\nrole = \"color\"\n";
    assert!(native.contains(rule), "{native}");
    let corrected = native.replace(
        &format!("{rule}quantity = \"variance of the mean\""),
        &format!("{rule}quantity = \"variance of one sample\""),
    );
    assert_ne!(corrected, native);
    let layout = folder.path("corrected.toml");
    std::fs::write(&layout, corrected).unwrap();
    stein(&["info", &input, "--layout", &layout, "--samples=8", "--strict"]).succeeded().said(&[
        ": ready to be denoised",
        "(variance, of one sample: divided by the samples per pixel)",
        "check     no contradiction between halves, variance and the noise in the image",
    ]);
}

#[test]
fn strict_makes_a_contradiction_an_error() {
    let folder = Folder::new();
    let (input, output) = (folder.path("in.exr"), folder.path("out.exr"));
    write_variance_of_one_sample(true, &input);
    let words = [&input, "times too large", "remedy: ", "--samples N"];
    for arguments in [
        &["info", &input][..],
        &["denoise", &input, "-o", &output],
        &["kernel", &input, "--pixel=4,4"],
        &["sample-map", &input, "-o", &output, "--budget=8"],
        &["bench", &input],
    ] {
        stein(&[arguments, &["--strict"]].concat()).failed(3, &words);
    }
    let refused = stein(&["info", &input, "--strict", "--json"]);
    refused.failed(3, &words);
    assert_eq!(refused.json()["files"][0]["verdict"]["state"], "contradiction");
    assert_eq!(folder.names(), ["in.exr"], "nothing is written");
    stein(&["info", &test_image("cornell_8spp.exr"), "--strict"]).succeeded();
}
