//! Shots on the command line: patterns, windows over frames, interruptions, flicker.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "common/process.rs"]
mod process;

use std::path::{Path, PathBuf};

use process::{Folder, Outcome, channels, stein, test_image, write_without};
use serde_json::{Value, json};
use stein::{Extent, Image};
use stein_exr::{BufferSet, BufferSetRequest, NamedLayer, read_reference, write_layers};
use stein_metric as metric;

const RADIUS: &str = "--radius=2";

/// A folder with the four frames of the short shot, and their references.
fn shot() -> Folder {
    let folder = Folder::new();
    for frame in 0..4 {
        for kind in ["shot", "reference"] {
            let name = format!("{kind}.{frame:04}.exr");
            std::fs::copy(test_image(&format!("anim/{name}")), folder.path(&name)).unwrap();
        }
    }
    folder
}

/// Denoises frames of the shot to `<name>.####.exr`.
fn denoise(folder: &Folder, name: &str, more: &[&str]) -> Outcome {
    let (input, output) = (folder.path("shot.####.exr"), folder.path(&format!("{name}.%04d.exr")));
    stein(&[&["denoise", &input, "-o", &output, RADIUS], more].concat())
}

fn path(folder: &Folder, name: &str, frame: u32) -> String {
    folder.path(&format!("{name}.{frame:04}.exr"))
}

/// All files in the folder that were not there at the beginning.
fn new_names(folder: &Folder) -> Vec<String> {
    folder.names().into_iter().filter(|name| !name.starts_with("shot.") && !name.starts_with("reference.")).collect()
}

#[test]
fn a_shot_in_pieces_is_the_shot_as_a_whole() {
    let folder = shot();
    let window = "--temporal-radius=1";
    let document = denoise(&folder, "whole", &[window, "--json"]).succeeded().json();
    let windows: Vec<_> = document["frames"].as_array().unwrap().iter().map(|frame| frame["window"].clone()).collect();
    assert_eq!(windows, [json!([0, 1]), json!([0, 1, 2]), json!([1, 2, 3]), json!([2, 3])]);
    assert_eq!(document["temporal_radius"], 1);
    assert_eq!(document["frames"][3]["report"]["input"]["frame"]["mode"], "variance and two seeds");
    assert!(document["frames"][3]["report"]["run"]["seconds"].is_f64());

    for (piece, frames) in [("a", "--frames=0-1"), ("b", "--frames=3"), ("c", "--frames=0-2x2")] {
        denoise(&folder, piece, &[window, frames]).succeeded();
    }
    for (piece, frame) in [("a", 0), ("a", 1), ("b", 3), ("c", 0), ("c", 2)] {
        assert_eq!(channels(&path(&folder, piece, frame)), channels(&path(&folder, "whole", frame)), "{piece} {frame}");
    }
    assert_eq!(new_names(&folder).iter().filter(|name| !name.starts_with("whole")).count(), 5);

    // A shot gives the same pixels as its frames one by one.
    denoise(&folder, "still", &["--frames=1"]).succeeded();
    stein(&["denoise", &path(&folder, "shot", 1), "-o", &folder.path("single.exr"), RADIUS]).succeeded();
    assert_eq!(channels(&path(&folder, "still", 1)), channels(&folder.path("single.exr")));
    assert_ne!(channels(&path(&folder, "still", 1)), channels(&path(&folder, "whole", 1)), "neighbours take part");
}

/// Cuts the file of a frame in half, and returns its whole content.
fn cut(file: &str) -> Vec<u8> {
    let whole = std::fs::read(file).unwrap();
    std::fs::write(file, &whole[..whole.len() / 2]).unwrap();
    whole
}

#[test]
fn a_broken_frame_is_named_the_others_are_written_and_no_clobber_goes_on() {
    let folder = shot();
    let broken = path(&folder, "shot", 2);
    let intact = cut(&broken);
    let said = ["1 of 4 frames cannot be denoised, the others are written", "frame 2: ", "shot.0002.exr", "remedy: "];
    let told = denoise(&folder, "clean", &[]);
    told.failed(3, &said);
    let places = ["clean.0001.exr: ", "frame 2: ", "clean.0003.exr: "].map(|text| told.stdout.find(text).unwrap());
    assert!(places.is_sorted() && told.stdout.contains("not denoised"), "{}", told.stdout);
    assert_eq!(
        new_names(&folder),
        ["clean.0000.exr", "clean.0001.exr", "clean.0003.exr"],
        "all others, and nothing half done"
    );
    // A neighbour that cannot be read is left out of the windows of the others.
    let told = denoise(&folder, "window", &["--temporal-radius=1"]);
    told.failed(3, &said);
    assert_eq!(told.stdout.matches("not filtered with frame 2: ").count(), 2, "{}", told.stdout);
    let document = denoise(&folder, "window", &["--temporal-radius=1", "--json"]);
    document.failed(3, &said);
    let frames = document.json()["frames"].clone();
    let windows: Vec<_> = [0, 1, 3].iter().map(|frame| frames[frame]["window"].clone()).collect();
    assert_eq!(windows, [json!([0, 1]), json!([0, 1]), json!([3])]);
    assert!(
        frames[2]["problem"].as_str().unwrap().contains("shot.0002.exr")
            && frames[2]["report"].is_null()
            && frames[1]["problem"].is_null()
    );
    assert!(frames[1]["left_out"][0].as_str().unwrap().contains("frame 2: "));
    // The frames around a broken one are the same as if it did not exist.
    let gone = folder.path("gone");
    std::fs::rename(&broken, &gone).unwrap();
    denoise(&folder, "without", &["--temporal-radius=1"])
        .succeeded()
        .said(&["missing between the frames that were found: 2"]);
    std::fs::rename(&gone, &broken).unwrap();
    for frame in [0, 1, 3] {
        assert_eq!(channels(&path(&folder, "window", frame)), channels(&path(&folder, "without", frame)), "{frame}");
    }

    std::fs::write(&broken, &intact).unwrap();
    let first = path(&folder, "window", 0);
    let (before, modified) = (std::fs::read(&first).unwrap(), std::fs::metadata(&first).unwrap().modified().unwrap());
    std::fs::remove_file(path(&folder, "window", 1)).unwrap();
    std::fs::remove_file(path(&folder, "window", 3)).unwrap();
    let document = denoise(&folder, "window", &["--temporal-radius=1", "--no-clobber", "--json"]).succeeded().json();
    let left_alone: Vec<_> =
        document["frames"].as_array().unwrap().iter().map(|frame| frame["is_left_alone"] == true).collect();
    assert_eq!(left_alone, [true, false, false, false]);
    assert_eq!(document["frames"][0]["report"], Value::Null);
    assert_eq!(document["frames"][1]["window"], json!([0, 1, 2]), "what is left alone still helps its neighbour");
    assert_eq!(
        (std::fs::read(&first).unwrap(), std::fs::metadata(&first).unwrap().modified().unwrap()),
        (before, modified)
    );

    denoise(&folder, "whole", &["--temporal-radius=1"]).succeeded();
    for frame in 0..4 {
        assert_eq!(channels(&path(&folder, "window", frame)), channels(&path(&folder, "whole", frame)), "{frame}");
    }
    let again = denoise(&folder, "whole", &["--no-clobber"]).succeeded();
    again.said(&["4 of 4 frames had an output"]);
}

#[test]
fn a_frame_of_whose_noise_nothing_is_known_is_left_out_where_noise_is_required() {
    let folder = shot();
    let alone = path(&folder, "shot", 2);
    std::fs::copy(path(&folder, "reference", 2), &alone).unwrap();
    let told = denoise(&folder, "clean", &["--require-noise", "--temporal-radius=1"]);
    told.failed(
        3,
        &[
            "1 of 4 frames cannot be denoised, the others are written",
            "frame 2: ",
            "nothing is known of the colour's noise",
            "--seed",
        ],
    );
    assert_eq!(told.stdout.matches("not filtered with frame 2: ").count(), 2, "{}", told.stdout);
    assert_eq!(new_names(&folder), ["clean.0000.exr", "clean.0001.exr", "clean.0003.exr"]);
    // A neighbour with other data is left out, and that is no failure.
    let beside = denoise(&folder, "beside", &["--frames=1", "--temporal-radius=1"]).succeeded();
    beside.said(&["not filtered with frame 2: halves or variance of its colour are not known as they are here"]);
}

#[test]
fn bad_frames_in_any_place_do_not_hold_up_the_others() {
    let folder = shot();
    // The first frame, the last frame, and a requested frame that does not exist.
    cut(&path(&folder, "shot", 0));
    std::fs::write(path(&folder, "shot", 3), "").unwrap();
    let told = denoise(&folder, "clean", &["--frames=0-5", "--temporal-radius=2"]);
    told.failed(
        3,
        &[
            "4 of 6 frames cannot be denoised, the others are written",
            "  frame 0: ",
            "  frame 3: ",
            "  frame 4: ",
            "does not exist",
            "  frame 5: ",
        ],
    );
    assert_eq!(new_names(&folder), ["clean.0001.exr", "clean.0002.exr"]);
    let dry = denoise(&folder, "dry", &["--frames=2-5", "--dry-run"]);
    dry.failed(3, &["2 of 4 frames cannot be denoised\n", "frame 4: ", "frame 5: "]);
    dry.said(&["shot.0004.exr -> ", "dry.0004.exr: cannot be denoised"]);
    // No frame is left, so no device is opened.
    denoise(&folder, "none", &["--frames=0,3,7", "--device=no such adapter"])
        .failed(3, &["3 of 3 frames cannot be denoised\n", "frame 7: "]);
    // A neighbour beyond the list is no failure.
    let beside = denoise(&folder, "beside", &["--frames=2", "--temporal-radius=1"]).succeeded();
    beside.said(&["not filtered with frame 3: ", "is empty"]);
    assert_eq!(new_names(&folder).len(), 3);
    // Thirty lines would hide what comes before them.
    let many = denoise(&folder, "many", &["--frames=1,100-199"]);
    many.failed(3, &["100 of 101 frames cannot be denoised", "frame 109: ", "  and 90 more"]);
    assert!(many.stderr.lines().count() < 15, "{}", many.stderr);
}

#[test]
fn features_that_end_half_way_and_other_sizes_are_told_once_and_are_no_failure() {
    let folder = shot();
    let shot = path(&folder, "shot", 0);
    for (frame, size) in [(10, "24x24"), (11, "24x24"), (12, "16x16"), (13, "16x16")] {
        stein(&["render", "dof", "--spp=4", "--size", size, "-o", &folder.path(&format!("walk.{frame:04}.exr"))])
            .succeeded();
    }
    // A frame without features, as if the passes of the renderer were turned off.
    let set = BufferSet::read(&BufferSetRequest { input: folder.path("walk.0013.exr").into(), ..Default::default() })
        .unwrap();
    let color = set.color();
    let layer = |name: &str, image: Image| NamedLayer {
        name: name.into(),
        channels: ["R", "G", "B"].map(String::from).to_vec(),
        image,
    };
    let layers = [("", Some(color.mean)), ("halfA", color.half_a), ("halfB", color.half_b)]
        .map(|(name, image)| layer(name, image.unwrap()));
    write_layers(Path::new(&folder.path("walk.0013.exr")), &layers, &[]).unwrap();
    let arguments = ["denoise", &folder.path("walk.####.exr"), "-o", &folder.path("clean.####.exr"), RADIUS];
    let told = stein(&arguments).succeeded();
    for (line, count) in [("24×24", 1), ("16×16", 2), ("feature albedo", 2)] {
        assert_eq!(told.stdout.matches(line).count(), count, "{line}: {}", told.stdout);
    }
    let told = stein(&[&arguments[..], &["--temporal-radius=1"]].concat()).succeeded();
    told.said(&[
        "not filtered with frame 12: its pixels are 16×16 at (0, 0), not 24×24 at (0, 0)",
        "not filtered with frame 11: ",
    ]);
    assert!(Path::new(&shot).exists());
    assert_eq!(new_names(&folder).iter().filter(|name| name.starts_with("clean.")).count(), 4);
}

#[test]
fn a_frame_that_cannot_be_written_ends_the_run_and_those_before_it_stay() {
    let folder = shot();
    // A folder has the name of an output.
    std::fs::create_dir_all(folder.path("clean.0001.exr/inside")).unwrap();
    let failed = denoise(&folder, "clean", &["--json"]);
    failed.failed(5, &["frame 1: ", "clean.0001.exr: cannot be written", "remedy: "]);
    assert_eq!(new_names(&folder), ["clean.0000.exr", "clean.0001.exr"], "nothing half done, and nothing after it");
    denoise(&folder, "alone", &["--frames=0"]).succeeded();
    assert_eq!(channels(&path(&folder, "clean", 0)), channels(&path(&folder, "alone", 0)));
    // The failure of the last frame is reported too, and no later failure hides it.
    denoise(&folder, "clean", &["--frames=0-1", "--quiet"]).failed(5, &["frame 1: ", "clean.0001.exr"]);
    std::fs::write(path(&folder, "shot", 0), "no picture").unwrap();
    denoise(&folder, "clean", &["--frames=0-2", "--progress=openjd"]).said(&[
        "openjd_fail: frame 1: ",
        "before that",
        "frame 0: ",
    ]);
}

#[test]
#[cfg(unix)]
fn an_interruption_leaves_whole_frames_and_no_others() {
    use std::process::{Command, Stdio};
    let folder = shot();
    let (input, output) = (folder.path("shot.####.exr"), folder.path("clean.####.exr"));
    let mut run =
        process::command(&["denoise", &input, "-o", &output, RADIUS, "--quiet"]).stderr(Stdio::null()).spawn().unwrap();
    while run.try_wait().unwrap().is_none() && !Path::new(&path(&folder, "clean", 0)).exists() {
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    // SIGINT is Ctrl-C. The run may have ended already.
    let _ = Command::new("kill").args(["-INT", &run.id().to_string()]).stderr(Stdio::null()).status().unwrap();
    run.wait().unwrap();
    denoise(&folder, "whole", &[]).succeeded();
    let written: Vec<_> = (0..4).filter(|frame| Path::new(&path(&folder, "clean", *frame)).exists()).collect();
    assert_eq!(written, (0..written.len() as u32).collect::<Vec<_>>());
    assert!(!written.is_empty());
    for frame in written {
        assert_eq!(channels(&path(&folder, "clean", frame)), channels(&path(&folder, "whole", frame)), "{frame}");
    }
}

#[test]
fn a_missing_frame_is_told_where_it_was_asked_for() {
    let folder = shot();
    std::fs::remove_file(path(&folder, "shot", 2)).unwrap();
    denoise(&folder, "listed", &["--frames=1-3"])
        .failed(3, &["frame 2: ", "shot.0002.exr", "does not exist", "remedy: "]);
    for frame in [1, 3] {
        std::fs::remove_file(path(&folder, "listed", frame)).unwrap();
    }
    let reference = folder.path("shot.####.exr");
    denoise(&folder, "clean", &["--frames=0", "--temporal-radius=1", "--ref", &folder.path("ref.####.exr")])
        .failed(3, &["frame 0: ", "ref.0000.exr"]);
    denoise(&folder, "clean", &["--half-a", &folder.path("a.####.exr"), "--half-b", &reference])
        .failed(3, &["frame 0: ", "a.0000.exr"]);
    assert_eq!(new_names(&folder), Vec::<String>::new());

    // Without a list, all frames that exist; no neighbour is taken across a gap.
    let dry = denoise(&folder, "clean", &["--temporal-radius=1", "--dry-run", "--json"]).succeeded().json();
    let windows: Vec<_> = dry["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|frame| (frame["frame"].clone(), frame["window"].clone()))
        .collect();
    assert_eq!(windows, [(json!(0), json!([0, 1])), (json!(1), json!([0, 1])), (json!(3), json!([3]))]);
    let dry = denoise(&folder, "clean", &["--temporal-radius=1", "--dry-run"]).succeeded();
    dry.said(&["nothing is written", "shot.0001.exr -> ", "clean.0001.exr, with 0\n"]);
    assert_eq!(new_names(&folder), Vec::<String>::new());
}

/// A window over several frames reduces error and flicker, with the default parameters.
#[test]
fn neighbouring_frames_lower_error_and_flicker() {
    let folder = shot();
    for method in ["dfc", "nlm"] {
        let errors = |window: &str| {
            let (input, output, reference) =
                (folder.path("shot.####.exr"), folder.path("clean.####.exr"), folder.path("reference.####.exr"));
            let told = stein(&[
                "denoise",
                &input,
                "--method",
                method,
                "--temporal-radius",
                window,
                "--ref",
                &reference,
                "-o",
                &output,
                "--json",
            ])
            .succeeded()
            .json();
            let of_result = &told["errors"]["images"][1];
            ["mean_relative_mse", "flicker"].map(|name| of_result[name].as_f64().unwrap())
        };
        let ([error_alone, flicker_alone], [error, flicker]) = (errors("0"), errors("1"));
        assert!(error < error_alone, "{method}: the error {error_alone} became {error}");
        assert!(flicker < 0.8 * flicker_alone, "{method}: the flicker {flicker_alone} became {flicker}");
    }
}

/// The same with two seeds only, or with one image only.
#[test]
fn neighbouring_frames_help_without_a_variance() {
    let folder = shot();
    let reference = folder.path("reference.####.exr");
    for parts in [&["variance"][..], &["variance", "halfA", "halfB"]] {
        for frame in 0..4 {
            write_without(parts, &test_image(&format!("anim/shot.{frame:04}.exr")), &path(&folder, "shot", frame));
        }
        let errors = |window: &str| {
            let (input, output) = (folder.path("shot.####.exr"), folder.path("clean.####.exr"));
            let told =
                stein(&["denoise", &input, "--temporal-radius", window, "--ref", &reference, "-o", &output, "--json"])
                    .succeeded()
                    .json();
            [0, 1].map(|index| {
                ["mean_relative_mse", "flicker"].map(|name| told["errors"]["images"][index][name].as_f64().unwrap())
            })
        };
        let ([[noisy, _], [alone, flicker_alone]], [_, [error, flicker]]) = (errors("0"), errors("1"));
        assert!(alone < 0.5 * noisy && error < alone, "without {parts:?}: {noisy}, alone {alone}, in a window {error}");
        assert!(flicker < flicker_alone, "without {parts:?}: the flicker {flicker_alone} became {flicker}");
    }
}

#[test]
fn flicker_and_mean_error_of_a_shot_are_told() {
    let folder = shot();
    let reference = folder.path("reference.####.exr");
    let document = denoise(&folder, "clean", &["--frames=0-1,3", "--ref", &reference, "--json"]).succeeded().json();
    let image = |name: &str, frame| read_reference(&PathBuf::from(path(&folder, name, frame)), None).unwrap();
    let references = [0, 1, 3].map(|frame| image("reference", frame));
    for (index, (key, file)) in [("noisy", "shot"), ("result", "clean")].into_iter().enumerate() {
        let images = [0, 1, 3].map(|frame| image(file, frame));
        let flicker = metric::flicker([&images[0], &images[1]], [&references[0], &references[1]]).unwrap();
        let error = images
            .iter()
            .zip(&references)
            .map(|(image, reference)| metric::relative_mse(image, reference).unwrap())
            .sum::<f64>()
            / 3.0;
        let told = &document["errors"]["images"][index];
        assert_eq!(told["image"], key);
        assert!((told["flicker"].as_f64().unwrap() / flicker - 1.0).abs() < 1e-6, "{told} {flicker}");
        assert!((told["mean_relative_mse"].as_f64().unwrap() / error - 1.0).abs() < 1e-6, "{told} {error}");
    }
    let errors = &document["errors"];
    assert_eq!((&errors["frames"], &errors["pairs"]), (&json!(3), &json!(1)), "frames 1 and 3 are not consecutive");
    assert!(errors["images"][1]["flicker"].as_f64() < errors["images"][0]["flicker"].as_f64());
    assert!(document["frames"][0]["report"]["errors"][0]["relative_mse"].is_f64());

    let text = denoise(&folder, "clean", &["--frames=0,1", "--ref", &reference]).succeeded();
    text.said(&["mean relative MSE", "flicker (1 pair)", "clean.0001.exr: ", ", relative MSE "]);
    assert_eq!(
        text.stdout.matches("feature normal").count(),
        1,
        "what holds for all frames is said once: {}",
        text.stdout
    );
}

#[test]
fn other_files_of_a_frame_may_be_patterns_too() {
    let folder = shot();
    let layer = |name: &str| format!("{}::{name}", folder.path("shot.%04d.exr"));
    let (a, b, normal) = (layer("halfA"), layer("halfB"), format!("n={}", layer("normal")));
    let arguments = ["--frames=2", "--half-a", &a, "--half-b", &b, "--no-features", "--feature", &normal];
    denoise(&folder, "pattern", &arguments).succeeded().said(&["feature n", "normal_halfA"]);
    let skip = ["--frames=2", "--skip-feature=depth"];
    denoise(&folder, "own", &skip).succeeded();
    assert_eq!(channels(&path(&folder, "pattern", 2)), channels(&path(&folder, "own", 2)));
}

#[test]
fn outputs_need_a_place_and_replace_nothing_that_is_read() {
    let folder = shot();
    let (input, first) = (folder.path("shot.####.exr"), path(&folder, "shot", 0));
    stein(&["denoise", &input, "-o", &folder.path("clean.exr")])
        .failed(2, &["clean.exr", "no place for the frame number", "remedy: "]);
    stein(&["denoise", &input, "-o", &input]).failed(5, &["shot.0000.exr", "is also read", "remedy: "]);
    stein(&["denoise", &input, "-o", &input, "--no-clobber"]).failed(5, &["is also read"]);
    stein(&["denoise", &input, "-o", &folder.path("missing/clean.#.exr")])
        .failed(5, &["missing/clean.0.exr", "remedy: "]);
    stein(&["denoise", &input, "-o", &folder.path("clean.#.jpg")]).failed(2, &[".exr"]);
    stein(&["denoise", &folder.path("shut.####.exr")]).failed(3, &["shut.####.exr", "there is no such frame"]);
    stein(&["denoise", &input, "--frames=5-1"]).failed(2, &["backwards"]);
    stein(&["denoise", &input, "--temporal-radius=17"]).failed(2, &["0..=16"]);
    stein(&["denoise", &input, "--frames=-5"]).failed(2, &["numbered from 0"]);
    for option in ["--frames=1", "--temporal-radius=1"] {
        stein(&["denoise", &first, option]).failed(2, &["is a single image", "remedy: "]);
    }
    stein(&["denoise", &first, "-o", &folder.path("clean.#.exr")]).failed(2, &["is a single image"]);
    assert_eq!(new_names(&folder), Vec::<String>::new());

    // The outputs go into a folder under their usual names.
    std::fs::create_dir(folder.path("out")).unwrap();
    stein(&["denoise", &input, "-o", &folder.path("out"), "--frames=1", "--radius=1", "--quiet"]).succeeded();
    assert!(Path::new(&folder.path("out/shot.0001.denoised.exr")).exists());
}

#[test]
fn a_render_farm_is_told_how_far_the_work_is() {
    let folder = shot();
    let done = denoise(&folder, "clean", &["--frames=1,2", "--progress=openjd"]).succeeded();
    let shares: Vec<f64> =
        done.stdout.lines().filter_map(|line| line.strip_prefix("openjd_progress: ")?.parse().ok()).collect();
    assert!(shares.is_sorted() && shares.len() >= 4 && shares.last() == Some(&100.0), "{shares:?}");
    // A frame counts as done when it is written, and frames are reported in their order.
    let place = |text: &str| done.stdout.find(text).unwrap_or_else(|| panic!("no '{text}' in: {}", done.stdout));
    let places = ["frame 1, 1 of 2", "clean.0001.exr: ", "clean.0002.exr: ", "openjd_progress: 100.0"].map(place);
    assert!(places.is_sorted() && place("frame 2, 2 of 2") < places[2], "{}", done.stdout);
    done.said(&["openjd_status: frame 1, 1 of 2\n", "openjd_status: frame 2, 2 of 2\n"]);
    let failed = denoise(&folder, "clean", &["--frames=3-4", "--progress=openjd"]);
    failed.said(&[
        "clean.0003.exr: ",
        "openjd_fail: 1 of 2 frames cannot be denoised, the others are written; frame 4: ",
        "openjd_progress: 100.0",
    ]);
    failed.failed(3, &["frame 4: "]);
    denoise(&folder, "clean", &["--progress=openjd", "--json"]).failed(2, &["--json"]);
}

#[test]
fn alpha_and_lights_of_a_shot_are_compared_with_those_of_the_references() {
    let folder = Folder::new();
    let extent = Extent { width: 24, height: 16 };
    let write = |name: &str, frame: u32, noise: f32| {
        let values = |base: f32| {
            let value = move |pixel: u32| base + noise * ((pixel * (frame + 3) * 7919 % 101) as f32 / 50.0 - 1.0);
            (0..extent.pixels() as u32).map(value).collect::<Vec<f32>>()
        };
        let layer = |name: &str, channels: &[&str]| NamedLayer {
            name: name.into(),
            channels: channels.iter().map(|&channel| channel.to_owned()).collect(),
            image: Image { extent, planes: channels.iter().map(|_| values(0.5)).collect() },
        };
        let layers = [layer("", &["R", "G", "B", "A"]), layer("diffuse", &["R", "G", "B"])];
        write_layers(Path::new(&path(&folder, name, frame)), &layers, &[]).unwrap();
    };
    for frame in 0..2 {
        write("shot", frame, 0.2);
        write("reference", frame, 0.0);
    }
    let reference = folder.path("reference.####.exr");
    let document = denoise(&folder, "clean", &["--ref", &reference, "--json"]).succeeded().json();
    let alpha = &document["errors"]["alpha"];
    assert_eq!((&alpha["frames"], &alpha["pairs"]), (&json!(2), &json!(1)));
    for image in [0, 1] {
        assert!(alpha["images"][image]["flicker"].as_f64().unwrap() > 0.0, "{alpha}");
    }
    let along = document["frames"][0]["report"]["errors_along"].as_array().unwrap();
    let names: Vec<_> = along.iter().map(|layer| (layer["layer"].clone(), layer["is_alpha"].clone())).collect();
    assert_eq!(names, [(json!("diffuse"), json!(false)), (json!("A"), json!(true))]);
    assert!(along[0]["noisy"]["relative_mse"].as_f64().unwrap() > 0.0, "{}", along[0]);

    denoise(&folder, "text", &["--ref", &reference]).succeeded().said(&["alpha, noisy ", "alpha, result "]);
    let single = [path(&folder, "shot", 0), folder.path("single.exr"), path(&folder, "reference", 0)];
    stein(&["denoise", &single[0], "-o", &single[1], RADIUS, "--ref", &single[2]]).succeeded().said(&[
        "along: 1 light layer, alpha",
        "\n  diffuse: relative MSE ",
        "\n  A: MSE ",
        " -> ",
    ]);
}
