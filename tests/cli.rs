//! The command line, as a process.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "common/process.rs"]
mod process;

use std::path::{Path, PathBuf};
use std::process::Stdio;

use exr::prelude::*;
use process::{Folder, channels, command, stein, test_image, write_without};
use serde_json::Value;
use stein_exr::{BufferSet, BufferSetRequest};

/// A small radius, so that a software adapter is done in a second.
const RADIUS: &str = "--radius=2";

fn attribute(path: &str, name: &str) -> Option<String> {
    let image = read_all_flat_layers_from_file(path).unwrap();
    let attributes = &image.layer_data[0].attributes.other;
    attributes.get(&Text::new_or_none(name).unwrap()).map(|value| match value {
        AttributeValue::Text(text) => text.to_string(),
        other => format!("{other:?}"),
    })
}

fn error_of<'a>(document: &'a Value, image: &str) -> &'a Value {
    document["errors"]
        .as_array()
        .unwrap()
        .iter()
        .find(|errors| errors["image"] == image)
        .unwrap_or_else(|| panic!("no {image}"))
}

#[test]
fn a_render_with_everything_is_denoised_compared_and_told_as_json() {
    let folder = Folder::new();
    let (input, reference, output) =
        (test_image("cornell_8spp.exr"), test_image("cornell_reference.exr"), folder.path("out.exr"));
    let document = stein(&["denoise", &input, "-o", &output, "--ref", &reference, "--keep=all", "--json", RADIUS])
        .succeeded()
        .json();

    assert_eq!(document["input"]["frame"]["mode"], "variance and two seeds");
    assert_eq!(document["input"]["frame"]["noise_knowledge"], "HalvesAndVariance");
    assert_eq!(document["parameters"]["window_radius"], 2);
    assert_eq!(document["strips"], 1);
    assert!(document["run"]["peak_bytes"].as_u64().unwrap() > 0);
    let error = |image: &str| error_of(&document, image)["relative_mse"].as_f64().unwrap();
    assert!(error("result") < error("pass1") && error("pass1") < error("noisy") / 2.0, "{}", document["errors"]);
    assert!(error_of(&document, "result")["ssim"].as_f64() > error_of(&document, "noisy")["ssim"].as_f64());
    for candidate in ["first", "second", "third"] {
        assert!(error_of(&document, candidate)["estimated_squared_error"].is_f64());
    }

    let (before, after) = (channels(&input), channels(&output));
    let find = |list: &[(String, FlatSamples)], name: &str| {
        list.iter().find(|(other, _)| other == name).map(|(_, samples)| samples.clone())
    };
    for (name, samples) in &before {
        let own = !name.contains('.') || name.starts_with("half") || name.starts_with("variance.");
        assert_eq!(find(&after, name).as_ref() == Some(samples), !own, "{name}");
    }
    assert!(find(&after, "variance.R").is_none(), "the variance of the noisy colour is not that of the denoised one");
    for layer in [
        "error.V",
        "first.R",
        "third_derivative.G",
        "sure.second",
        "sure_smoothed.first",
        "selected.third",
        "selection.first",
        "pass1.B",
    ] {
        assert!(find(&after, &format!("stein.{layer}")).is_some(), "{layer}");
    }
    for layer in ["scaled_variance.R", "albedo_prefiltered.x", "depth_residual_variance.x"] {
        assert!(find(&after, &format!("stein.{layer}")).is_some(), "{layer}");
    }
    for name in ["samples", "scene", "sampler"] {
        assert_eq!(attribute(&output, name), attribute(&input, name));
    }
    assert!(attribute(&output, "stein.parameters").unwrap().contains("window_radius"));

    let set = BufferSet::read(&BufferSetRequest { input: output.clone().into(), ..Default::default() }).unwrap();
    let raw = set.color();
    let (a, b) = (raw.half_a.unwrap(), raw.half_b.unwrap());
    for (mean, (a, b)) in raw.mean.planes.iter().flatten().zip(a.planes.iter().flatten().zip(b.planes.iter().flatten()))
    {
        assert!(((a + b) / 2.0 - mean).abs() <= 1e-5 * mean.abs().max(1.0), "{a} {b} {mean}");
    }

    // A denoised file can be denoised again, in place.
    let again = stein(&["denoise", &output, "-o", &output, RADIUS]).succeeded();
    again.said(&["noise: known from two seeds", "denoised before"]);
    // With --no-error, the error of an earlier run is removed too.
    let has_error = || channels(&output).iter().any(|(name, _)| name.starts_with("stein.error"));
    assert!(has_error());
    stein(&["denoise", &output, "-o", &output, RADIUS, "--no-error"]).succeeded().said(&["denoised before"]);
    assert!(!has_error());
    assert_eq!(folder.names(), ["out.exr"]);
}

#[test]
fn gem_is_a_method_with_options_and_intermediates_of_its_own() {
    let (input, reference) = (test_image("cornell_8spp.exr"), test_image("cornell_reference.exr"));
    let folder = Folder::new();
    let output = folder.path("out.exr");
    let arguments = ["denoise", &input, "-o", &output, "--method=gem"];
    let with = |more: &[&str]| stein(&[&arguments[..], more].concat());
    let document = with(&["--set=gamma=0.1", "--ref", &reference, "--keep=all", "--json"]).succeeded().json();
    assert_eq!(document["parameters"]["method"], "gem");
    assert_eq!((document["parameters"]["gamma"].as_f64().unwrap() * 1e3).round(), 100.0);
    assert_eq!(document["kept"], serde_json::json!(["spikes", "variance", "stopping", "scale", "density"]));
    let error = |image: &str| error_of(&document, image)["relative_mse"].as_f64().unwrap();
    assert!(error("result") < error("noisy") / 3.0, "{}", document["errors"]);
    let names: Vec<String> = channels(&output).into_iter().map(|(name, _)| name).collect();
    for name in [
        "stein.error.V",
        "stein.scale.V",
        "stein.stopping_1.V",
        "stein.stopping_8_smoothed.V",
        "stein.reduction.relative_mse",
    ] {
        assert!(names.iter().any(|other| other == name), "no {name} in {names:?}");
    }
    assert!(attribute(&output, "stein.parameters").unwrap().contains("gem"));

    with(&["--radius=5"]).failed(2, &["--radius is no option of the method gem", "remedy: "]);
    with(&["--set=gamma=0.5"]).failed(2, &["`gamma` cannot be 0.5", "below 0.4"]);
    with(&["--keep=candidates"]).failed(2, &["gem has no such intermediate", "stopping"]);
    with(&["--feature", "albedo=a.exr"]).failed(2, &["gem uses no features"]);
    stein(&["denoise", &input, "--set=gamma=0.2"])
        .failed(2, &["`gamma` is no parameter of dfc, but of gem", "remedy: "]);
}

#[test]
fn spikes_are_counted_kept_as_a_layer_and_may_stay() {
    let input = test_image("caustic_ring_32spp.exr");
    let folder = Folder::new();
    let output = folder.path("out.exr");
    let with = |more: &[&str]| stein(&[&["denoise", &input, "-o", &output, "--method=gem"], more].concat());
    with(&["--explain"]).succeeded().said(&[
        "spikes taken out with",
        "% of the energy",
        "what rests on few samples is spread",
    ]);
    let report = |more: &[&str]| with(&[&["--json"], more].concat()).succeeded().json();
    let spread = report(&["--keep=spikes"]);
    let found = |document: &Value, name: &str| document["run"]["spikes"][name].as_f64().unwrap();
    assert!(
        found(&spread, "pixels") > 3.0 && found(&spread, "spread") < found(&spread, "taken"),
        "{}",
        spread["run"]["spikes"]
    );
    assert!(
        channels(&output)
            .iter()
            .any(|(name, values)| name == "stein.spikes.R" && values.values_as_f32().any(|value| value != 0.0))
    );
    let clamped = report(&["--spikes=clamp"]);
    assert_eq!((found(&clamped, "pixels"), found(&clamped, "spread")), (found(&spread, "pixels"), 0.0));
    assert!(report(&["--spikes=keep"])["run"]["spikes"].is_null());
    stein(&["sample-map", &input, "-o", &output, "--budget=8", "--spikes=spread"])
        .failed(2, &["--spikes", "remedy: leave it out"]);
    let thesis = report(&["--preset=thesis"]);
    assert!(thesis["parameters"]["spikes"] == "keep" && thesis["run"]["spikes"].is_null());
}

#[test]
fn a_user_sees_what_was_taken_for_what_and_how_good_it_became() {
    let (folder, input) = Folder::with("cornell_8spp.exr");
    let output = folder.path("render.denoised.exr");
    let first = stein(&["denoise", &input, "--ref", &test_image("cornell_reference.exr"), "-v", RADIUS]).succeeded();
    first.said(&[
        "96×96, 8 samples per pixel",
        "feature albedo",
        "halfA, halfB",
        "noise: known from variance and two seeds",
        &output,
        "relative MSE",
        "noisy",
        "second",
        "result",
        "nlm_filter",
    ]);
    assert_eq!(first.stderr, "", "there is no progress where nobody watches");
    assert_eq!(folder.names(), ["render.denoised.exr", "render.exr"]);
    assert!(
        !channels(&output).iter().any(|(name, _)| name.starts_with("stein.first")),
        "candidates are written on request only"
    );

    let (written, pixels) = (std::fs::read(&output).unwrap(), channels(&output));
    stein(&["denoise", &input, "--no-clobber", "--radius=1"])
        .failed(5, &["stein: error:", "render.denoised.exr", "remedy: "]);
    let dry = stein(&["denoise", &input, "--dry-run", "--radius=1"]).succeeded();
    dry.said(&["feature albedo", "nothing is written"]);
    assert_eq!(std::fs::read(&output).unwrap(), written);

    let quiet = stein(&["denoise", &input, "--quiet", RADIUS]).succeeded();
    assert_eq!((quiet.stdout.as_str(), quiet.stderr.as_str()), ("", ""));
    assert_eq!(channels(&output), pixels, "the same input gives the same output");
    assert_eq!(folder.names(), ["render.denoised.exr", "render.exr"]);
}

#[test]
fn a_user_sees_what_runs_what_is_left_out_and_why() {
    let (folder, input) = Folder::with("cornell_8spp.exr");
    let (output, other) = (folder.path("out.exr"), folder.path("other.exr"));
    let arguments = [
        "denoise",
        &input,
        "-o",
        &output,
        RADIUS,
        "--skip-feature=albedo",
        "--candidates=second",
        "--no-error",
        "--explain",
    ];
    let with = |more: &[&str]| stein(&[&arguments[..], more].concat());
    let told = [
        "prefilter depth",
        "it has noise",
        "the parameters leave it out",
        "there is one candidate",
        "second pass",
        "in one piece",
    ];
    with(&[]).succeeded().said(&told);
    let names: Vec<String> = channels(&output).into_iter().map(|(name, _)| name).collect();
    assert!(!names.iter().any(|name| name.starts_with("stein.error")), "{names:?}");
    let planned = channels(&output);

    let document = with(&["--json"]).succeeded().json();
    assert_eq!(document["parameters"]["candidates"], serde_json::json!(["second"]));
    assert_eq!(document["run"]["mean_estimated_squared_error"], Value::Null);
    let step = |document: &Value, name: &str| {
        let steps = document["plan"]["steps"].as_array().unwrap();
        steps.iter().find(|step| step["step"] == name).unwrap_or_else(|| panic!("no {name} in {steps:?}")).clone()
    };
    let (candidates, selection) = (step(&document, "candidates"), step(&document, "selection"));
    assert!(
        candidates["seconds"].as_f64() > Some(0.0)
            && candidates["share"].as_f64() > Some(0.0)
            && candidates["stages"].as_array().unwrap().len() > 1
    );
    assert_eq!(
        (&selection["runs"], &selection["skipped"], &selection["seconds"]),
        (&false.into(), &1.0.into(), &Value::Null)
    );
    let dry = with(&["--json", "-n"]).succeeded().json();
    assert_eq!(
        (step(&dry, "candidates")["runs"].clone(), step(&dry, "candidates")["seconds"].clone()),
        (true.into(), Value::Null)
    );
    with(&["-n"]).succeeded().said(&told);

    // The same frame with --everything.
    let everything = stein(&[
        "denoise",
        &input,
        "-o",
        &other,
        RADIUS,
        "--skip-feature=albedo",
        "--candidates=second",
        "--everything",
        "--explain",
        "--json",
    ]);
    assert_eq!(step(&everything.succeeded().json(), "selection")["runs"], true);
    let with_everything = channels(&other);
    assert!(planned.iter().all(|channel| with_everything.contains(channel)));

    stein(&["denoise", &input, "--candidates=fourth"]).failed(2, &["fourth", "first", "second", "third"]);
    for method in ["nlm", "gem"] {
        stein(&["denoise", &input, "--method", method, "--candidates=first"])
            .failed(2, &["--candidates is no option of the method", "remedy: "]);
        let told =
            stein(&["denoise", &input, "-o", &output, "--method", method, "--explain", "--no-error"]).succeeded();
        told.said(&["variance", "sampling density", "left out"]);
    }
    assert_eq!(folder.names(), ["other.exr", "out.exr", "render.exr"]);
}

#[test]
fn compiled_shaders_are_kept_where_the_user_says() {
    let folder = Folder::new();
    let (input, output) = (test_image("cornell_8spp.exr"), folder.path("out.exr"));
    let with_cache = |cache: &str| {
        let output = command(&["denoise", &input, "-o", &output, "-v", "--method=gem"])
            .env("STEIN_CACHE", cache)
            .output()
            .unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    assert!(!with_cache("").contains("compiled shaders"));
    let cache = folder.path("cache");
    let first = with_cache(&cache);
    // Not every adapter hands out its pipelines.
    if first.contains("compiled shaders") {
        assert_eq!(std::fs::read_dir(&cache).unwrap().count(), 1, "{first}");
        assert!(first.contains(&cache) && with_cache(&cache).contains("as before"), "{first}");
        let told = with_cache(&format!("{output}/cache"));
        assert!(told.contains("cannot be kept") && told.contains("remedy: have STEIN_CACHE"), "{told}");
    }
}

#[test]
fn little_memory_gives_the_same_pixels() {
    let folder = Folder::new();
    let (input, whole, strips) = (test_image("cornell_32spp.exr"), folder.path("whole.exr"), folder.path("strips.exr"));
    // Without spikes and pooled variances, which reach further than half of this image.
    let denoise = |more: &[&str]| {
        stein(&[&["denoise", &input, RADIUS, "--method=nlm", "--spikes=keep", "--json"], more].concat())
    };
    // The least sufficient memory.
    let least = (10..80)
        .map(|step| format!("{}k", 100 * step))
        .find(|size| denoise(&["--dry-run", "--max-memory", size]).code == 0)
        .unwrap();
    assert_eq!(denoise(&["-o", &whole]).succeeded().json()["strips"], 1);
    let document = denoise(&["-o", &strips, "--max-memory", &least]).succeeded().json();
    assert!(document["strips"].as_u64().unwrap() > 1, "{least}");
    assert_eq!(channels(&whole), channels(&strips));
    denoise(&["-n", "--max-memory=100k"]).failed(4, &["--max-memory", "remedy: "]);
}

#[test]
fn inputs_that_cannot_be_denoised_say_why_and_what_to_do() {
    let folder = Folder::new();
    let output = folder.path("out.exr");
    stein(&["denoise", "no/such/file.exr", "-o", &output]).failed(3, &["stein: error: no/such/file.exr", "remedy: "]);
    let (reference, input) = (test_image("cornell_reference.exr"), test_image("cornell_8spp.exr"));
    stein(&["denoise", &reference, "-o", &output, "--require-noise"])
        .failed(3, &[&reference, "seed1.exr seed2.exr", "--seed", "--variance"]);
    stein(&["denoise", &input, "-o", &output, "--layer", "beauty"]).failed(3, &[&input, "'beauty'", "halfA"]);
    stein(&["denoise", &input, "-o", &output, "--skip-feature", "albdo"]).failed(3, &["'albdo'"]);
    let text = folder.path("text.exr");
    std::fs::write(&text, "not an image").unwrap();
    stein(&["denoise", &input, "-o", &output, "--ref", &text]).failed(3, &[&text, "is not an OpenEXR file"]);
    assert_eq!(folder.names(), ["text.exr"]);
}

/// The inputs that most renderers can write: two seeds, or one image.
#[test]
fn two_seeds_and_an_image_alone_come_out_better_than_they_were() {
    let (folder, reference) = (Folder::new(), test_image("cornell_reference.exr"));
    for (parts, mode, most) in
        [(&["variance"][..], "two seeds", 0.15), (&["variance", "halfA", "halfB"], "the image itself", 0.25)]
    {
        let (input, output) = (folder.path("input.exr"), folder.path("output.exr"));
        write_without(parts, &test_image("cornell_32spp.exr"), &input);
        let document =
            stein(&["denoise", &input, "-o", &output, "--radius=5", "--ref", &reference, "--json"]).succeeded().json();
        assert_eq!(document["input"]["frame"]["mode"], mode);
        let [noisy, result] = [0, 1].map(|index| document["errors"][index]["relative_mse"].as_f64().unwrap());
        assert!(result < most * noisy, "{mode}: the error {noisy} became {result}");
        let told = stein(&["denoise", &input, "-o", &output, "--radius=2", "--explain"]).succeeded();
        told.said(&["noise                   runs      known from ", mode]);
    }
}

#[test]
fn outputs_that_cannot_be_written_are_told_before_the_work() {
    let (folder, input) = Folder::with("cornell_8spp.exr");
    stein(&["denoise", &input, "-o", &folder.path("missing/out.exr")]).failed(5, &["missing/out.exr", "remedy: "]);
    stein(&["denoise", &input, "-o", &folder.path("render.exr/out.exr")])
        .failed(5, &["render.exr/out.exr", "remedy: "]);
    let reference = folder.path("reference.exr");
    std::fs::copy(test_image("cornell_reference.exr"), &reference).unwrap();
    stein(&["denoise", &input, "-o", &reference, "--ref", &reference]).failed(5, &["is also read", "remedy: "]);
    stein(&["denoise", &input, "-o", &folder.path("out.jpg")]).failed(2, &["out.jpg", ".exr"]);
    assert_eq!(folder.names(), ["reference.exr", "render.exr"]);
}

#[test]
fn wrong_arguments_are_told_with_the_right_ones() {
    let input = test_image("cornell_8spp.exr");
    stein(&["denoise", &input, "--keep", "candidates,shure"])
        .failed(2, &["shure", "sure", "selection", "pass1", "derivatives"]);
    stein(&["denoise", &input, "--max-memory", "lots"]).failed(2, &["512M"]);
    stein(&["denoise", &input, "--radius", "100"]).failed(2, &["`window_radius` cannot be 100", "from 1 to 64"]);
    stein(&["denoise", &input, "--set", "patch_radius=1"])
        .failed(2, &["`patch_radius` is no parameter of dfc, but of nlm", "remedy: "]);
    stein(&["denoise", &input, "--set", "guards=false"])
        .failed(2, &["`guards` is no parameter of dfc", "guard.own_sigmas"]);
    stein(&["denoise", &input, "--set", "guard=maybe"]).failed(2, &["`guard` cannot be maybe", "true or false"]);
    stein(&["denoise", &input, "--set", "guard"]).failed(2, &["NAME=VALUE"]);
    stein(&["denoise", &input, "--set=guard=false", "--set=guard.own_sigmas=3"])
        .failed(2, &["`guard.own_sigmas` is none where `guard` is left out"]);
    stein(&["bench", &input, "--set=dual_buffer=false"])
        .failed(2, &["`dual_buffer` is no parameter of dfc, but of nlm", "remedy: "]);
    stein(&["denoise", &input, "--method", "nlm", "--set=patch_radius=9"])
        .failed(2, &["`patch_radius` cannot be 9", "from 0 to 5"]);
    stein(&["denoise", &input, "--method", "nlm", "--keep", "sure", "--dry-run"])
        .failed(2, &["--keep sure: nlm has no such intermediate", "halves"]);
    stein(&["denoise", &input, "--feature", "albedo"]).failed(2, &["NAME=FILE"]);
    stein(&["bench", &input, "--size", "big"]).failed(2, &["1024x1024"]);
    stein(&["bench", &input, "--ref", &input, "--ref", &input]).failed(2, &["2 references", "1 inputs"]);
    stein(&["denoise"]).failed(2, &["IN"]);
    for subcommand in ["denoise", "info", "layouts", "bench", "devices"] {
        stein(&[subcommand, "--help"]).succeeded().said(&["Example"]);
    }
    stein(&["--help"]).succeeded().said(&["Exit codes", "denoise"]);
}

#[test]
fn nlm_says_what_it_did() {
    let (folder, input) = Folder::with("cornell_8spp.exr");
    let output = folder.path("out.exr");
    let options = [
        "patch_radius=1",
        "k=0.5",
        "alpha=0.5",
        "weighting.symmetric=off",
        "cut=0.1",
        "patchwise=false",
        "dual_buffer=false",
        "variance=uniform",
    ];
    let options: Vec<_> =
        ["--method=nlm"].into_iter().chain(options.into_iter().flat_map(|setting| ["--set", setting])).collect();
    let arguments = ["denoise", &input, "-o", &output, RADIUS, "--ref", &test_image("cornell_reference.exr"), "--json"];
    let document = stein(&[&arguments[..], &options].concat()).succeeded().json();
    let parameters = &document["parameters"];
    let expected = serde_json::json!({
        "method": "nlm", "window_radius": 2, "patch_radius": 1, "k": 0.5, "alpha": 0.5, "cut": 0.1,
        "patchwise": false, "dual_buffer": false, "variance": "uniform", "guard_frames": true, "keep_clean": true,
        "pooled_variance": true, "spikes": "spread", "weighting": { "symmetric": "off", "centre": "One" },
    });
    assert_eq!(parameters, &expected);
    assert!(document["errors"].as_array().unwrap().iter().any(|errors| errors["image"] == "half_b"));
    assert!(attribute(&output, "stein.parameters").unwrap().contains("uniform"));
    // No feature is reported as used, and options about features are refused.
    let text = stein(&["denoise", &input, "-o", &output, RADIUS, "--method=nlm", "--keep=all"]).succeeded();
    assert!(!text.stdout.contains("feature albedo"), "{}", text.stdout);
    stein(&["denoise", &input, "-o", &output, "--method=nlm", "--skip-feature=depth"])
        .failed(2, &["--skip-feature depth", "nlm uses no features", "remedy: "]);
    stein(&["denoise", &input, "-o", &output, RADIUS, "--no-features", "--keep=features"])
        .succeeded()
        .said(&["--keep features: there is nothing"]);
    stein(&["denoise", &input, "-o", &output, RADIUS, "--method=nlm", "--keep=all"]).succeeded();
    let layers = stein(&["info", &output, "-v"]).succeeded();
    layers.said(&["stein.half_a", "stein.half_b", "stein.density", "stein.variance_of_mean", "stein.error"]);
    let map = folder.path("map.exr");
    stein(&["sample-map", &input, "-o", &map, RADIUS, "--method=nlm", "--budget=8"])
        .succeeded()
        .said(&["8.000 per pixel"]);
}

#[test]
fn an_unknown_device_is_told_with_those_that_exist() {
    let document = stein(&["devices", "--json"]).succeeded().json();
    let name = document["devices"][0]["name"].as_str().expect("an adapter, be it a software one").to_owned();
    stein(&["devices"]).succeeded().said(&[&name]);
    stein(&["--list-devices"]).succeeded().said(&[&name]);
    stein(&["denoise", "--list-devices"]).succeeded().said(&[&name]);
    let (folder, input) = Folder::with("cornell_8spp.exr");
    stein(&["denoise", &input, "--device", "Voodoo 2"]).failed(4, &["Voodoo 2", &name]);
    stein(&["denoise", &input, "--device", "0", "--dry-run"]).succeeded().said(&[&name]);
    assert_eq!(folder.names(), ["render.exr"]);
}

#[test]
fn info_tells_what_denoise_would_do_with_each_file() {
    let (render, reference) = (test_image("cornell_8spp.exr"), test_image("cornell_reference.exr"));
    let both = stein(&["info", &render, &reference, "-v"]).succeeded();
    both.said(&[
        "data window 96×96 at (0, 0)",
        "visibility (V) float",
        "noise: known from variance and two seeds",
        "relative MSE of the noise: about 0.0",
        "noise of feature albedo: known from variance and two seeds",
        "noise: known from the image itself",
        "relative MSE of the noise: unknown",
        "colour: its noise is estimated from the image itself",
    ]);
    assert!(!both.stdout.contains("cannot be denoised"), "{}", both.stdout);
    let required = stein(&["info", &render, &reference, "--require-noise"]).succeeded();
    required.said(&[
        "noise     known from variance and two seeds",
        "cannot be denoised",
        "nothing is known of the colour's noise",
        "--seed",
    ]);

    let document = stein(&["info", &render, &reference, "--json"]).succeeded().json();
    let layers = document["files"][0]["layers"].as_array().unwrap();
    assert_eq!(layers.len(), 20);
    assert!(layers.iter().any(|layer| layer["layer"] == "halfA" && layer["role"] == "HalfA"));
    assert!(document["files"][0]["frame"]["noise_level"].as_f64().unwrap() > 0.0);
    let alone = &document["files"][1]["frame"];
    assert_eq!(
        (&alone["mode"], &alone["noise_knowledge"], &alone["noise_level"]),
        (&"the image itself".into(), &"ImageOnly".into(), &Value::Null)
    );
    assert!(alone["repairs"]["notes"].to_string().contains("two renders with different seeds"), "{alone}");
    assert_eq!(
        document["files"][0]["frame"]["feature_noise"][0],
        serde_json::json!({ "name": "albedo", "noise_knowledge": "HalvesAndVariance" })
    );

    let layer = |name: &str| format!("{render}::{name}");
    let variance_only = stein(&["info", &reference, "-v", "--variance", &layer("variance")]).succeeded();
    variance_only.said(&["noise: known from variance\n", &layer("variance")]);
    let halves_only =
        stein(&["info", &reference, "-v", "--half-a", &layer("halfA"), "--half-b", &layer("halfB")]).succeeded();
    halves_only.said(&["noise: known from two seeds, pooled from the halves of similar pixels", &layer("halfB")]);
    let feature =
        stein(&["info", &render, "-v", "--no-features", "--feature", &format!("tint={}", layer("albedo"))]).succeeded();
    feature.said(&["feature tint", "albedo_halfA, albedo_halfB"]);
    assert!(!feature.stdout.contains("feature normal"));
    let bare =
        stein(&["info", &reference, "-v", "--no-features", "--feature", &format!("tint={}", layer("albedo_halfA"))])
            .succeeded();
    bare.said(&["noise of feature tint: none"]);

    let one_missing = stein(&["info", "missing.exr", &render]);
    one_missing.failed(3, &["missing.exr"]);
    one_missing.said(&["noise     known from variance and two seeds"]);
}

#[test]
fn a_reader_that_goes_away_ends_the_text_but_not_the_work() {
    let (folder, input) = Folder::with("cornell_8spp.exr");
    let mut child =
        command(&["denoise", &input, "-v", RADIUS]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let ended = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(ended.stderr).unwrap();
    assert!(ended.status.success() && stderr.is_empty(), "{stderr}");
    assert!(PathBuf::from(folder.path("render.denoised.exr")).exists());
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_behind_standard_output_is_told() {
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let ended = command(&["info", &test_image("cornell_8spp.exr")]).stdout(full).output().unwrap();
    assert_eq!(ended.status.code(), Some(5), "{}", String::from_utf8_lossy(&ended.stderr));
}

#[test]
fn the_kernel_of_a_pixel_is_told_and_written() {
    let (folder, input) = Folder::with("cornell_8spp.exr");
    let window = folder.path("window.exr");
    let told =
        stein(&["kernel", &input, "--pixel=3,50", "-o", &window, "--skip-feature=visibility", RADIUS]).succeeded();
    told.said(&[
        "pixel 3,50",
        "first",
        "second",
        "third",
        "normal",
        "second_pass",
        "pass 1: ",
        " % SECOND",
        "window.exr",
    ]);
    let written = channels(&window);
    assert!(written.iter().all(|(_, samples)| samples.len() == 25));
    for channel in [
        "first.weight.V",
        "second.colour.G",
        "first.distance.colour.V",
        "third.alone.albedo.V",
        "third.distance.normal.V",
        "second_pass.colour.B",
    ] {
        assert!(written.iter().any(|(name, _)| name == channel), "{channel}");
    }
    // A window of 3×3 within that of 5×5.
    let of = |channel: &str| -> Vec<f32> {
        written.iter().find(|(name, _)| name == channel).unwrap().1.values_as_f32().collect()
    };
    let (weights, distances) = (of("second_pass.weight.V"), of("second_pass.distance.colour.V"));
    for cell in 0..25 {
        let is_inside = (1..4).contains(&(cell % 5)) && (1..4).contains(&(cell / 5));
        assert!(distances[cell].is_finite() == is_inside && (is_inside || weights[cell] == 0.0), "cell {cell}");
    }
    assert!(!written.iter().any(|(name, _)| name == "third.distance.colour.V" || name.contains("visibility")));
    assert_eq!(attribute(&window, "pixel").as_deref(), Some("3,50"));

    let document = stein(&["kernel", &input, "--pixel=0,0", "--method=gem", "--json"]).succeeded().json();
    assert_eq!((&document["filters"][0]["filter"], &document["output"]), (&Value::from("scale"), &Value::Null));
    assert!(document["filters"][0]["sigma"].as_f64().unwrap() >= 0.0 && document["filters"][0]["share"].is_null());
    assert_eq!(document["filters"][0]["rule"], "gaussian");
    let document =
        stein(&["kernel", &input, "--pixel=0,0", "--candidates=first,third", "--json", RADIUS]).succeeded().json();
    assert_eq!(
        (&document["filters"][1]["filter"], &document["left_out"][0]["step"]),
        (&Value::from("third"), &Value::from("second"))
    );
    let shares = [0, 1].map(|filter| document["filters"][filter]["share"].as_f64().unwrap());
    assert!((shares[0] + shares[1] - 1.0).abs() < 1e-6, "{shares:?}");
    assert_eq!(document["filters"][2]["filter"], "second_pass");
    let of_third = document["filters"][1]["decided"].as_array().unwrap();
    assert!(
        of_third.iter().map(|decided| decided["neighbours"].as_u64().unwrap()).sum::<u64>() <= 8,
        "nine pixels of the window exist"
    );

    stein(&["kernel", &input, "--pixel=96,0", RADIUS]).failed(2, &["--pixel", "96×96", "from 0 to 95"]);
    stein(&["kernel", &input, "--pixel=96"]).failed(2, &["120,64"]);
    stein(&["kernel", &input]).failed(2, &["--pixel"]);
    stein(&["kernel", &input, "--pixel=1,1", "-o", "window.png", RADIUS]).failed(2, &[".exr"]);
}

#[test]
fn a_file_of_parameters_stands_for_options() {
    let (folder, input) = Folder::with("cornell_8spp.exr");
    let (file, output) = (folder.path("own.toml"), folder.path("out.exr"));
    let options = ["--method=nlm", "--preset=thesis", RADIUS, "--set=patch_radius=1", "--set=weighting.symmetric=off"];
    stein(&[&["params", "-o", &file][..], &options].concat()).succeeded();
    assert_eq!(stein(&["params", "--params", &file]).succeeded().stdout, std::fs::read_to_string(&file).unwrap());
    let denoise = |more: &[&str]| stein(&[&["denoise", &input, "-o", &output, "--json", "--dry-run"], more].concat());
    let of_options = denoise(&options).succeeded().json();
    let of_file = denoise(&["--params", &file]).succeeded().json();
    assert_eq!((&of_file["parameters"], &of_file["preset"]), (&of_options["parameters"], &of_options["preset"]));
    assert_eq!(of_file["preset"], "thesis");

    // Options override the file, and its own method and preset may be repeated.
    let document = denoise(&["--params", &file, "--radius=3", "--spikes=clamp", "--method=nlm", "--preset=thesis"])
        .succeeded()
        .json();
    let parameters = &document["parameters"];
    assert_eq!(
        (&parameters["window_radius"], &parameters["spikes"], &parameters["patch_radius"]),
        (&3.into(), &"clamp".into(), &1.into())
    );
    denoise(&["--params", &file, "--method=dfc"])
        .failed(2, &["--method dfc", "own.toml is for nlm", "remedy: ", "method = \"dfc\""]);
    denoise(&["--params", &file, "--preset=default"])
        .failed(2, &["--preset default", "own.toml is for thesis", "remedy: "]);
    denoise(&["--params", &file, "--set=gamma=0.2"]).failed(2, &["`gamma` is no parameter of nlm, but of gem"]);
    let adapt = ["adapt", "dof", "--spp=8", "-o", &folder.path("loop"), "--params", &file];
    stein(&[&adapt[..], &["--method=gem"]].concat()).failed(2, &["own.toml is for nlm"]);
    stein(&["bench", &input, "--params", &file, "--methods=nlm,dfc"])
        .failed(2, &["--methods dfc", "own.toml is for nlm"]);
    stein(&["bench", &input, "--params", &file, "--candidates=first"])
        .failed(2, &["--candidates is no option of the method nlm"]);
}

#[test]
fn a_file_of_parameters_that_cannot_be_meant_is_told_with_its_line() {
    let (folder, input) = Folder::with("cornell_8spp.exr");
    let file = folder.path("own.toml");
    let denoise = || stein(&["denoise", &input, "--params", &file]);
    denoise().failed(3, &["own.toml: cannot be read", "remedy: ", "stein params"]);
    std::fs::write(&file, "preset = \"thesis\"\nwindow_radius = 100\n").unwrap();
    denoise().failed(
        3,
        &["own.toml: line 2: `window_radius` cannot be 100", "remedy: choose a whole number from 1 to 64 pixels"],
    );
    std::fs::write(&file, "gama = 1").unwrap();
    denoise().failed(3, &["own.toml: line 1: `gama` is no parameter of dfc", "remedy: "]);
    std::fs::write(&file, b"\xff\xfe").unwrap();
    denoise().failed(3, &["own.toml: cannot be read", "remedy: "]);
    assert_eq!(folder.names(), ["own.toml", "render.exr"]);
}

#[test]
fn parameters_are_listed() {
    let listed = stein(&["params", "--list", "--radius=7", "--preset=thesis"]).succeeded();
    let row = |name: &str| {
        listed
            .stdout
            .lines()
            .find(|line| line.split_whitespace().next() == Some(name))
            .unwrap()
            .split_whitespace()
            .collect::<Vec<_>>()
            .join(" ")
    };
    assert!(
        row("window_radius").starts_with("window_radius 7 10 10 from 1 to 64 pixels R, the radius of the window"),
        "{}",
        row("window_radius")
    );
    assert!(row("guard").starts_with("guard false true false Keeps"), "{}", row("guard"));

    let folder = Folder::new();
    stein(&["params", "-o", &folder.path("missing/own.toml")]).failed(5, &["own.toml: cannot be written", "remedy: "]);
    stein(&["params", "--radius=100"]).failed(2, &["`window_radius` cannot be 100"]);
    stein(&["params", "--markdown", "--radius=5"]).failed(2, &["--markdown"]);
}

#[test]
fn the_page_about_parameters_is_what_the_program_prints() {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/parameters.md")).unwrap();
    let printed = stein(&["params", "--markdown"]).succeeded().stdout;
    assert!(
        page == printed,
        "docs/parameters.md is out of date: write it again with `stein params --markdown > docs/parameters.md`"
    );
}

/// The pixels of a small image that is denoised quickly.
fn small() -> String {
    test_image("anim/shot.0000.exr")
}

const QUICK: [&str; 3] = ["--method=gem", "--no-error", "--quiet"];

#[test]
#[cfg(unix)]
fn only_small_files_are_read_whole() {
    let (folder, input) = Folder::with("cornell_8spp.exr");
    stein(&["denoise", &input, "--params=/dev/zero"])
        .failed(3, &["/dev/zero: cannot be read: it is a pipe or a device", "remedy: "]);
    stein(&["denoise", &input, "--params", &folder.path("")]).failed(3, &["it is a folder", "remedy: "]);
    stein(&["bench", "--compare=/dev/zero"])
        .failed(3, &["/dev/zero: cannot be read: it is a pipe or a device", "remedy: "]);
    stein(&["selftest", "--compare=/dev/zero"]).failed(3, &["/dev/zero", "it is a pipe or a device", "remedy: "]);
    let pipe = folder.path("pipe.exr");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    stein(&["bench", &pipe]).failed(3, &["pipe.exr", "it is a pipe or a device", "remedy: "]);
    let large = folder.path("large.toml");
    std::fs::File::create(&large).unwrap().set_len(1 << 40).unwrap();
    stein(&["denoise", &input, "--params", &large])
        .failed(3, &["large.toml", "it is larger than 1048576 bytes", "remedy: "]);
}

#[test]
#[cfg(unix)]
fn a_file_that_is_replaced_keeps_its_mode() {
    use std::os::unix::fs::PermissionsExt;
    let mode = |path: &str| std::fs::metadata(path).unwrap().permissions().mode() & 0o7777;
    let set_mode = |path: &str, mode: u32| std::fs::set_permissions(path, PermissionsExt::from_mode(mode)).unwrap();
    let (folder, input) = Folder::with("anim/shot.0000.exr");
    let (output, params) = (folder.path("render.denoised.exr"), folder.path("own.toml"));
    stein(&[&["denoise", &input][..], &QUICK].concat()).succeeded();
    std::fs::write(folder.path("new"), "").unwrap();
    assert_eq!(mode(&output), mode(&folder.path("new")), "a new file is as readable as others");
    for kept in [0o640, 0o600, 0o664, 0o444] {
        set_mode(&input, kept);
        set_mode(&output, kept);
        stein(&[&["denoise", &input][..], &QUICK].concat()).succeeded();
        stein(&[&["denoise", &input, "-o", &input][..], &QUICK].concat()).succeeded();
        assert_eq!((mode(&input), mode(&output)), (kept, kept));
    }
    std::fs::write(&params, "").unwrap();
    set_mode(&params, 0o640);
    stein(&["params", "-o", &params]).succeeded();
    assert_eq!(mode(&params), 0o640);
}

/// Messages hold no control sequences for a terminal.
#[track_caller]
fn assert_harmless(text: &str) {
    assert!(text.chars().all(|character| character == '\n' || !character.is_control()), "{text:?}");
}

#[test]
#[cfg(unix)]
fn names_out_of_files_are_shown_escaped_and_documents_hold_them_as_they_are() {
    let folder = Folder::new();
    let input = folder.path("in\u{1b}[2J\n.exr");
    std::fs::copy(small(), &input).unwrap();
    let told =
        stein(&["denoise", &input, "--feature", &format!("a\u{1b}b={input}::depth"), "--radius=1", "-v"]).succeeded();
    assert_harmless(&told.stdout);
    told.said(&[r"in\u{1b}[2J\n.exr: 32×32", r"feature a\u{1b}b", r"in\u{1b}[2J\n.denoised.exr: "]);
    let status = stein(&[&["denoise", &input, "--method=gem", "--progress=openjd"][..]].concat()).succeeded();
    status.said(&[r"openjd_status: "]);
    assert_harmless(&status.stdout);
    let document =
        stein(&["info", &input, "--json", "--feature", &format!("a\u{1b}b={input}::depth")]).succeeded().json();
    assert_eq!(document["files"][0]["file"], input.as_str());
    assert!(
        document["files"][0]["layers"]
            .as_array()
            .unwrap()
            .iter()
            .any(|layer| layer["role"]["Feature"][0] == "a\u{1b}b")
    );
    let failed = stein(&["denoise", &folder.path("no\u{9b}file\n.exr")]);
    failed.failed(3, &[r"no\u{9b}file\n.exr: "]);
    assert_harmless(&failed.stderr);
}

#[test]
#[cfg(unix)]
fn files_are_found_whatever_their_names_hold() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let folder = Folder::new();
    for name in ["show #3", "50%d", "a::b"] {
        std::fs::create_dir(folder.path(name)).unwrap();
    }
    let names = [
        "my shot v2 #3.0001.exr",
        "100%.0001.exr",
        "a::b.0001.exr",
        "a{b}$HOME.exr",
        "-dash.exr",
        "noext",
        "UPPER.EXR",
        "take#.exr",
        "a=b.exr",
        "[x]*.exr",
        "new\nline.exr",
        "café %d.exr",
        "show #3/in.exr",
        "50%d/in.exr",
        "a::b/in.exr",
    ];
    for name in names {
        let input = folder.path(name);
        std::fs::copy(small(), &input).unwrap();
        let of = |layer: &str| format!("{input}::{layer}");
        // Each of these names the same pixels in another way.
        let others =
            ["--half-a", &of("halfA"), "--half-b", &of("halfB"), "--variance", &of("variance"), "--ref", &input];
        let feature = format!("tint={}", of("depth"));
        stein(&[&["denoise", &input, "--feature", &feature, "--radius=1"][..], &others].concat())
            .succeeded()
            .said(&["feature tint", "variance"]);
        stein(&["denoise", &input, "--literal", "-n"])
            .succeeded()
            .said(&["noise: known from variance and two seeds", "nothing is written"]);
        let output = Path::new(&input).with_extension("").to_str().unwrap().to_owned() + ".denoised.exr";
        assert!(Path::new(&output).exists(), "{output}");
        // An output in a folder with such a name, and an output that replaces such a file.
        stein(&[&["denoise", &input, "-o", &output][..], &QUICK].concat()).succeeded();
    }
    let bad = Path::new(&folder.path("")).join(OsStr::from_bytes(b"bad\xff\xfe.exr"));
    std::fs::copy(small(), &bad).unwrap();
    let layer = |layer: &str| {
        let mut named = bad.clone().into_os_string();
        named.push(layer);
        named
    };
    let told = command(&["denoise", "--json", "--method=gem", "--variance"])
        .arg(layer("::variance"))
        .arg(&bad)
        .output()
        .unwrap();
    let document: Value = serde_json::from_slice(&told.stdout).unwrap();
    assert!(document["output"]["file"].as_str().unwrap().ends_with(r"bad\xff\xfe.denoised.exr"), "{document}");
}

#[test]
fn a_path_is_taken_as_it_is_where_that_is_said() {
    let (folder, input) = Folder::with("anim/shot.0000.exr");
    let output = folder.path("take#.exr");
    stein(&[&["denoise", &input, "-o", &output][..], &QUICK].concat()).failed(2, &["is a single image", "--literal"]);
    stein(&[&["denoise", &input, "-o", &output, "--literal"][..], &QUICK].concat()).succeeded();
    // Now the file exists.
    stein(&[&["denoise", &input, "-o", &output][..], &QUICK].concat()).succeeded();
    stein(&["denoise", &folder.path("shot.#.exr"), "--literal"]).failed(3, &["shot.#.exr: cannot be read", "remedy: "]);
    stein(&["denoise", &folder.path("shot.#.exr")])
        .failed(3, &["shot.#.exr", "there is no such file; if it is a pattern, there is no such frame"]);
    let layer = format!("{input}::depth");
    stein(&["denoise", &input, "--half-a", &layer, "--literal"]).failed(3, &["render.exr::depth: cannot be read"]);
    stein(&["denoise", &input, "--ref", &layer, "--literal"]).failed(3, &["render.exr::depth: cannot be read"]);
    stein(&["bench", &input, "--ref", &layer, "--literal"]).failed(3, &["render.exr::depth: cannot be read"]);
    let adapt = ["adapt", "dof", "--spp=8", "-o", &folder.path("loop"), "--literal", "--ref", &layer];
    stein(&adapt).failed(3, &["render.exr::depth: cannot be read"]);
    for subcommand in ["info", "kernel", "sample-map"] {
        stein(&[subcommand, "--help"]).succeeded().said(&["--literal"]);
    }
    assert_eq!(folder.names(), ["render.exr", "take#.exr"]);
}
