//! The adaptive loop, in this process and by the command line: budgets, resuming, renderers in another process, and
//! where the samples go.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use stein_exr::MapFile;

use exr::prelude::{FlatSamples, read_all_flat_layers_from_file};
use glam::Vec3;
use serde_json::Value;
use stein::gpu::DeviceChoice;
use stein::sampling::{Event, SampleCounts, SampleSchedule, Samples, SamplingMap, adapt};
use stein::{Denoiser, DfcParams, Error, Extent, GemParams, Gpu, Image, Method};
use stein_exr::{BufferSet, BufferSetRequest, read_reference};
use stein_metric::relative_mse;
use stein_stub::{Camera, Environment, Material, Scene, Sequence, Shape, StubSampler, Texture};
use tempfile::TempDir;

/// A small radius and a small image, so that a software adapter is done in a second.
const SMALL: [&str; 2] = ["--radius=3", "--size=24x20"];
const PIXELS: u64 = 24 * 20;

fn dfc(radius: u32) -> Method {
    DfcParams { window_radius: radius, ..DfcParams::default() }.into()
}

fn denoiser(method: Method) -> Denoiser {
    Denoiser::new(&Gpu::open(&DeviceChoice::Auto).unwrap(), method).unwrap()
}

/// Exit code, standard output, standard error.
fn run(arguments: &[&str]) -> (i32, String, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stein"));
    // Mesa's device selection layer complains on stderr where there is no desktop. No file is left in the home of the
    // user.
    let output = command
        .args(arguments)
        .env("NODEVICE_SELECT", "1")
        .env("STEIN_CACHE", "")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    (
        output.status.code().unwrap(),
        String::from_utf8(output.stdout).unwrap(),
        String::from_utf8(output.stderr).unwrap(),
    )
}

#[track_caller]
fn stein(arguments: &[&str]) -> String {
    let (code, stdout, stderr) = run(arguments);
    assert_eq!(code, 0, "{arguments:?}: {stdout}{stderr}");
    stdout
}

/// Checks that the command fails with this exit code and says all of `said`.
#[track_caller]
fn fails(arguments: &[&str], code: i32, said: &[&str]) {
    let (found, stdout, stderr) = run(arguments);
    assert_eq!(found, code, "{arguments:?}: {stdout}{stderr}");
    for words in said {
        assert!(stderr.contains(words), "no '{words}' in: {stderr}");
    }
    assert!(!stderr.contains("panicked"), "{stderr}");
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

fn samples(path: &Path) -> Samples {
    BufferSet::read(&BufferSetRequest { input: path.to_owned(), ..Default::default() }).unwrap().to_samples().unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// All channels as stored, and the header.
fn content(file: &Path) -> (Vec<(String, FlatSamples)>, BTreeMap<String, String>) {
    let part = read_all_flat_layers_from_file(file).unwrap().layer_data.remove(0);
    let channels = part.channel_data.list.into_iter().map(|channel| (channel.name.to_string(), channel.sample_data));
    (
        channels.collect(),
        part.attributes.other.iter().map(|(name, value)| (name.to_string(), format!("{value:?}"))).collect(),
    )
}

#[track_caller]
fn assert_same_files(a: &Path, b: &Path) {
    assert_eq!(names(a), names(b));
    for name in names(a) {
        assert!(content(&a.join(&name)) == content(&b.join(&name)), "{name} differs");
    }
}

#[test]
fn a_run_keeps_its_budgets_and_can_be_resumed_to_the_same_bits() {
    let folder = Folder::new();
    let (whole, parts) = (folder.path("whole"), folder.path("parts"));
    let arguments = |output: &Path, more: &[&str]| -> Vec<String> {
        let fixed = ["adapt", "dof", "--spp=14", "--iterations=3", "--cap=20", "-o", text(output), "--json"];
        fixed.iter().chain(&SMALL).chain(more).map(|&argument| argument.to_owned()).collect()
    };
    let call =
        |output: &Path, more: &[&str]| stein(&arguments(output, more).iter().map(String::as_str).collect::<Vec<_>>());
    let document: Value = serde_json::from_str(&call(&whole, &[])).unwrap();

    // 7 pairs in 3 shares.
    let mut before = vec![0; PIXELS as usize];
    for (iteration, (budget, total)) in [(6, 6), (4, 10), (4, 14)].into_iter().enumerate() {
        let name = |kind: &str| whole.join(format!("{kind}_{}.exr", iteration + 1));
        let file = MapFile::read(&name("map")).unwrap();
        assert_eq!(file.map.counts.total_samples(), budget * PIXELS);
        let real: f64 = file.map.density.planes[0].iter().map(|&density| f64::from(density)).sum();
        assert!((real - (budget * PIXELS) as f64).abs() < 0.01, "{real}");
        assert!(file.map.counts.pairs().iter().all(|&pairs| pairs <= 10));
        assert_eq!(file.drawn.map(|drawn| drawn.pairs().to_vec()), (iteration > 0).then_some(before.clone()));
        before.iter_mut().zip(file.map.counts.pairs()).for_each(|(before, pairs)| *before += pairs);
        let merged = samples(&name("samples"));
        assert_eq!(merged.counts().pairs(), before);
        assert_eq!(merged.counts().total_samples(), total * PIXELS);
        assert_eq!(document["iterations"][iteration]["samples"]["total_samples"], total * PIXELS);
        assert!(document["iterations"][iteration]["estimated_relative_mse"].is_f64());
    }

    // As if interrupted while iteration 3 is drawn, and while iteration 2 is denoised.
    for kept in [
        &["map_1", "samples_1", "denoised_1", "map_2", "samples_2", "denoised_2", "map_3"][..],
        &["map_1", "samples_1", "denoised_1", "map_2", "samples_2"],
    ] {
        std::fs::create_dir_all(&parts).unwrap();
        for name in kept {
            let name = format!("{name}.exr");
            std::fs::copy(whole.join(&name), parts.join(&name)).unwrap();
        }
        let resumed: Value = serde_json::from_str(&call(&parts, &["--resume"])).unwrap();
        assert_eq!(resumed["resumed_after"], 2);
        assert_eq!(resumed["iterations"].as_array().unwrap().len(), 2);
        assert_same_files(&whole, &parts);
        std::fs::remove_dir_all(&parts).unwrap();
    }
    // No iteration is left to do, or none was done.
    call(&whole, &["--resume"]);
    call(&parts, &["--resume"]);
    assert_same_files(&whole, &parts);

    let refused = |more: &[&str], code: i32, said: &[&str]| {
        fails(&arguments(&whole, more).iter().map(String::as_str).collect::<Vec<_>>(), code, said);
    };
    refused(&[], 5, &["denoised_1.exr", "earlier run", "--resume", "--overwrite"]);
    refused(&["--resume", "--seed=7"], 2, &["samples_3.exr", "seed was 0, now 7", "remedy: "]);
    std::fs::write(whole.join("notes.txt"), "of the user").unwrap();
    call(&whole, &["--overwrite", "--seed=7"]);
    assert!(whole.join("notes.txt").exists());
}

#[test]
fn a_sampler_command_gives_what_the_loop_in_the_process_gives() {
    let folder = Folder::new();
    // A name that a shell would split, with placeholders that must not be replaced.
    let (inside, outside) = (folder.path("inside"), folder.path("it's {out} {map} side"));
    let reference = folder.path("reference.exr");
    stein(&["render", "dof", "--reference", "--spp=64", SMALL[1], "-o", text(&reference)]);
    let fixed = ["--spp=8", "--iterations=2", "--ref", text(&reference), SMALL[0], SMALL[1], "--json", "-o"];
    let own = stein(&[&["adapt", "dof"], &fixed[..], &[text(&inside)]].concat());
    let command = format!("\"{}\" render dof --map {{map}} -o {{out}}", env!("CARGO_BIN_EXE_stein"));
    let other = stein(&[&["adapt", "--sampler-command", &command], &fixed[..], &[text(&outside)]].concat());

    let rows = |document: &str| {
        let document: Value = serde_json::from_str(document).unwrap();
        (document["iterations"].clone(), document["uniform"].clone())
    };
    assert_eq!(rows(&own), rows(&other));
    let errors = |row: &Value| {
        (
            row["errors"]["noisy_relative_mse"].as_f64().unwrap(),
            row["errors"]["denoised_relative_mse"].as_f64().unwrap(),
        )
    };
    let (iterations, uniform) = rows(&own);
    let (noisy, denoised) = errors(&iterations[1]);
    assert!(denoised < noisy && noisy < errors(&iterations[0]).0, "{iterations}");
    assert!(errors(&uniform).1 > 0.0);
    // The pixels are the same; only the sampler differs in the headers.
    for label in ["1", "2", "uniform"] {
        let file = |folder: &Path| samples(&folder.join(format!("samples_{label}.exr")));
        let (a, b) = (file(&inside), file(&outside));
        assert_eq!((a.color(), a.counts()), (b.color(), b.counts()), "{label}");
        assert!(a.features().eq(b.features()), "{label}");
    }
    let expected =
        ["denoised", "map", "samples"].map(|kind| ["1", "2", "uniform"].map(|label| format!("{kind}_{label}.exr")));
    assert_eq!(names(&outside), expected.concat(), "new samples are not kept once they are merged");
}

#[test]
#[cfg(unix)]
fn a_recorded_run_of_mitsuba_is_merged_mapped_and_denoised_again() {
    // Share of the budget. If the density changes by 1e-4, less than half of this share moves between pixels; on the
    // adapter of the recorded run, none moves.
    const MOVED: f64 = 0.02;
    const PIXELS: u64 = 32 * 32;
    let folder = Folder::new();
    let output = folder.path("loop");
    let recorded = concat!(env!("CARGO_MANIFEST_DIR"), "/../testdata/mitsuba");
    let command = format!("test -s {{map}} && cp '{recorded}/iteration_{{iteration}}.exr' {{out}}");
    stein(&[
        "adapt",
        "--sampler-command",
        &command,
        "--size=32x32",
        "--spp=32",
        "--iterations=4",
        "-o",
        text(&output),
        "--quiet",
    ]);

    let reference = read_reference(&Path::new(recorded).join("reference.exr"), None).unwrap();
    let mut before = vec![0; PIXELS as usize];
    let mut errors = Vec::new();
    for iteration in 1..=4 {
        let name = |kind: &str| output.join(format!("{kind}_{iteration}.exr"));
        let drawn = samples(&Path::new(recorded).join(format!("iteration_{iteration}.exr"))).counts();
        let file = MapFile::read(&name("map")).unwrap();
        assert_eq!(file.drawn.map(|drawn| drawn.pairs().to_vec()), (iteration > 1).then_some(before.clone()));
        assert_eq!((file.map.counts.total_samples(), drawn.total_samples()), (8 * PIXELS, 8 * PIXELS));
        let asked = file.map.counts.pairs();
        let moved: u64 =
            asked.iter().zip(drawn.pairs()).map(|(asked, drawn)| 2 * u64::from(asked.abs_diff(*drawn))).sum();
        assert!(
            moved as f64 <= MOVED * (8 * PIXELS) as f64,
            "iteration {iteration}: {moved} samples are not where they were recorded"
        );
        assert_eq!(asked.iter().any(|&pairs| pairs != 4), iteration > 1, "only the first map is even");

        before.iter_mut().zip(drawn.pairs()).for_each(|(before, pairs)| *before += pairs);
        let merged = samples(&name("samples"));
        assert_eq!(merged.counts().pairs(), before);
        assert_eq!(merged.features().map(|(name, _)| name).collect::<Vec<_>>(), ["albedo", "depth", "normal"]);
        let denoised = relative_mse(&read_reference(&name("denoised"), None).unwrap(), &reference).unwrap();
        let noisy = relative_mse(&merged.color().mean, &reference).unwrap();
        assert!(denoised < noisy, "iteration {iteration}: {noisy} became {denoised}");
        errors.push(denoised);
    }
    assert!(errors[3] < errors[0], "{errors:?}");
}

#[test]
#[cfg(unix)]
fn a_renderer_that_draws_other_numbers_is_warned_about_and_believed() {
    let folder = Folder::new();
    let output = folder.path("loop");
    let command = format!("'{}' render dof --spp=6 --size=24x20 -o {{out}}; : {{map}}", env!("CARGO_BIN_EXE_stein"));
    let run = |more: &[&str]| {
        let arguments = [
            "adapt",
            "--sampler-command",
            &command,
            "--spp=4",
            "--iterations=1",
            SMALL[0],
            SMALL[1],
            "--overwrite",
            "-o",
            text(&output),
        ];
        let run = Command::new(env!("CARGO_BIN_EXE_stein"))
            .args(arguments)
            .args(more)
            .env("STEIN_CACHE", "")
            .output()
            .unwrap();
        assert!(run.status.success());
        assert_eq!(samples(&output.join("samples_1.exr")).counts().total_samples(), 6 * 24 * 20);
        String::from_utf8(run.stderr).unwrap()
    };
    let said = run(&[]);
    assert!(["warning", "new_1.exr", "2880 samples", "asks for 1920"].iter().all(|part| said.contains(part)), "{said}");
    assert!(!run(&["--quiet"]).contains("warning"));
}

#[test]
#[cfg(unix)]
fn a_command_that_fails_is_told_with_what_it_said() {
    let folder = Folder::new();
    let call = |command: &str, code: i32, said: &[&str]| {
        let output = folder.path("run");
        fails(
            &[
                "adapt",
                "--sampler-command",
                command,
                "--spp=8",
                "--iterations=2",
                SMALL[0],
                SMALL[1],
                "--overwrite",
                "-o",
                text(&output),
            ],
            code,
            said,
        );
    };
    call(
        "echo the lamp is broken >&2; exit 3; cat {map} {out}",
        1,
        &["exit status: 3", "echo the lamp is broken", "    the lamp is broken", "map_1.exr", "remedy: "],
    );
    call("echo nothing to do; : {map} {out}", 1, &["did not write", "new_1.exr", "    nothing to do", "remedy: "]);
    call("no-such-renderer {map} {out}", 1, &["exit status: 127", "no-such-renderer"]);
    call("echo text > {out}; : {map}", 3, &["new_1.exr", "is not an OpenEXR file"]);
    call("render --map {map}", 2, &["{out}", "remedy: "]);
    let render = env!("CARGO_BIN_EXE_stein");
    call(&format!("'{render}' render dof --spp=2 --size=8x8 -o {{out}}; : {{map}}"), 3, &["new_1.exr", "8×8", "24×20"]);
    call(
        &format!("'{render}' render dof --spp=2 --size=24x20 --reference -o {{out}}; : {{map}}"),
        3,
        &["new_1.exr", "half A"],
    );
}

#[test]
fn wrong_arguments_are_told_with_the_right_ones() {
    let folder = Folder::new();
    let output = folder.path("out.exr");
    let output = text(&output);
    fails(&["render", "teapot", "--spp=2", "-o", output], 2, &["teapot", "dof", "spikes"]);
    fails(&["render", "dof", "--spp=3", "-o", output], 2, &["3 samples", "even"]);
    fails(&["render", "dof", "--spp=0", "-o", output], 2, &["no samples"]);
    fails(&["render", "dof", "-o", output], 2, &["--spp"]);
    fails(&["adapt", "dof", "--spp=6", "-o", output], 2, &["4 iterations", "at least 8"]);
    fails(&["adapt", "dof", "--spp=16", "--cap=2", "-o", output], 2, &["cap"]);
    fails(&["adapt", "--sampler-command", "x {map} {out}", "--spp=16", "-o", output], 2, &["--size"]);
    fails(&["adapt", "--spp=16", "-o", output], 2, &["SCENE"]);
    fails(&["render", "dof", "--map=missing.exr", "-o", output], 3, &["missing.exr", "remedy: "]);
    assert!(names(folder.0.path()).is_empty());
    let listed = stein(&["render", "--list"]);
    assert!(
        ["soft", "dof", "motion", "caustic", "texture", "spikes"].iter().all(|scene| listed.contains(scene)),
        "{listed}"
    );
    for subcommand in ["render", "sample-map", "adapt"] {
        assert!(stein(&[subcommand, "--help"]).contains("Example"));
    }
    for subcommand in ["sample-map", "adapt"] {
        assert!(!stein(&[subcommand, "--list-devices"]).is_empty());
    }
}

#[test]
fn a_map_for_any_renderer_is_written_and_drawn() {
    let folder = Folder::new();
    let (noisy, map, more) = (folder.path("noisy.exr"), folder.path("noisy.map.exr"), folder.path("more.exr"));
    stein(&["render", "motion", "--spp=4", SMALL[1], "--sequence=low-discrepancy", "-o", text(&noisy)]);
    let document: Value =
        serde_json::from_str(&stein(&["sample-map", text(&noisy), "--budget=7.5", "--cap=30", SMALL[0], "--json"]))
            .unwrap();
    let file = MapFile::read(&map).unwrap();
    let total = (7.5 * PIXELS as f64) as u64;
    assert_eq!(document["map"]["total_samples"], total);
    assert_eq!(file.map.counts.total_samples(), total);
    assert_eq!(file.drawn, Some(SampleCounts::uniform(Extent { width: 24, height: 20 }, 4).unwrap()));
    let said = stein(&["sample-map", text(&noisy), "--budget=7.5", "--cap=30", SMALL[0]]);
    assert!(said.contains("per pixel") && said.contains("get none"), "{said}");
    fails(&["sample-map", text(&noisy), "--budget=8", "--cap=6", SMALL[0]], 2, &["cap of 6", "remedy: "]);
    fails(&["sample-map", text(&noisy), "--budget=8", "-o", text(&noisy), SMALL[0]], 5, &["is also read"]);

    stein(&["render", "motion", "--map", text(&map), "--sequence=low-discrepancy", "-o", text(&more)]);
    assert_eq!(samples(&more).counts(), file.map.counts);
    fails(&["render", "motion", "--map", text(&folder.path("reference.exr"))], 3, &["reference.exr"]);
    stein(&["render", "motion", "--reference", "--spp=2", SMALL[1], "-o", text(&folder.path("reference.exr"))]);
    fails(
        &["render", "motion", "--map", text(&folder.path("reference.exr")), "-o", text(&more)],
        3,
        &["no layer 'samples'", "sample-map"],
    );
}

#[test]
fn a_map_survives_its_file() {
    let folder = Folder::new();
    let extent = Extent { width: 3, height: 2 };
    let density = Image { extent, planes: vec![vec![0.0, 1.0, 2.5, 1e-3, 7.0, 0.1]] };
    let map = SamplingMap::new(&density, 6.0, None).unwrap();
    let drawn = SampleCounts::from_samples(extent, &[0, 2, 4, 6, 8, 1 << 20]).unwrap();
    let path = folder.path("map.exr");
    MapFile { map: map.clone(), drawn: Some(drawn.clone()), windows: None }.write(&path, &[]).unwrap();
    let read = MapFile::read(&path).unwrap();
    assert_eq!((read.map.density, read.map.counts, read.drawn), (map.density, map.counts, Some(drawn)));
}

/// A scene of two walls under an even light; the right wall is striped and out of focus.
fn two_walls() -> Scene {
    let camera =
        Camera { eye: Vec3::new(0.0, 0.0, 4.0), target: Vec3::ZERO, field_of_view: 0.6, lens_radius: 0.25, focus: 1.0 };
    let stripes =
        |place: Vec3| if (place.x * 1.5).floor() as i32 % 2 == 0 { Vec3::splat(0.05) } else { Vec3::splat(0.9) };
    let wall = |x: f32| Shape::quad(Vec3::new(x, -5.0, 0.0), Vec3::X * 5.0, Vec3::Y * 10.0);
    Scene::new(camera, Environment::constant(Vec3::ONE))
        .with(wall(-5.0), Material::Diffuse(Texture::Plain(Vec3::splat(0.5))))
        .with(wall(0.0), Material::Diffuse(Texture::Pattern(stripes)))
}

fn samples_go_to_what_is_noisy(method: Method) {
    let extent = Extent { width: 40, height: 24 };
    let mut sampler = StubSampler::new(two_walls(), extent, 3, Sequence::Random);
    let schedule = SampleSchedule::new(12, 2, None).unwrap();
    let mut last = None;
    let observe = |event: Event<'_>| -> Result<(), Error> {
        if let Event::Finished { map, .. } = event {
            last = map.map(|map| map.counts.clone());
        }
        Ok(())
    };
    let outcome = adapt(&mut sampler, &denoiser(method), &schedule, None, observe).unwrap();
    assert_eq!(outcome.samples.counts().total_samples(), 12 * extent.pixels() as u64);
    let counts = last.unwrap();
    let mean = |columns: std::ops::Range<usize>| {
        let pixels = counts.pairs().iter().enumerate().filter(|(pixel, _)| columns.contains(&(pixel % 40)));
        pixels.clone().map(|(_, &pairs)| 2.0 * f64::from(pairs)).sum::<f64>() / pixels.count() as f64
    };
    // The blur of the stripes reaches over the middle.
    let (flat, striped) = (mean(0..14), mean(24..40));
    assert!(striped > 4.0 * flat, "{flat} on the flat wall, {striped} on the striped one");
}

#[test]
fn samples_of_dfc_go_to_what_is_noisy() {
    samples_go_to_what_is_noisy(dfc(4));
}

#[test]
fn samples_of_gem_go_to_what_is_noisy() {
    samples_go_to_what_is_noisy(GemParams::default().into());
}

#[test]
fn gem_works_in_the_loop_and_makes_maps() {
    let folder = Folder::new();
    let (whole, parts) = (folder.path("whole"), folder.path("parts"));
    let call = |output: &Path, more: &[&str]| {
        stein(
            &[
                &["adapt", "dof", "--spp=12", "--iterations=3", "--method=gem", SMALL[1], "-o", text(output), "--json"],
                more,
            ]
            .concat(),
        )
    };
    let document: Value = serde_json::from_str(&call(&whole, &[])).unwrap();
    assert_eq!(document["iterations"][2]["samples"]["total_samples"], 12 * PIXELS);
    assert!(
        document["iterations"][2]["samples"]["most"].as_u64() > document["iterations"][2]["samples"]["least"].as_u64()
    );
    let phase =
        |iteration: u32| content(&whole.join(format!("denoised_{iteration}.exr"))).1["stein.parameters"].clone();
    assert!(
        phase(1).contains("sampling") && phase(2).contains("sampling") && phase(3).contains("final"),
        "{} {} {}",
        phase(1),
        phase(2),
        phase(3)
    );
    let budgets: Vec<u64> = (1..=3)
        .map(|iteration| MapFile::read(&whole.join(format!("map_{iteration}.exr"))).unwrap().map.counts.total_samples())
        .collect();
    assert_eq!(budgets, [4 * PIXELS; 3]);
    // The last iteration is lost.
    call(&parts, &[]);
    for kind in ["map", "samples", "denoised"] {
        std::fs::remove_file(parts.join(format!("{kind}_3.exr"))).unwrap();
    }
    call(&parts, &["--resume"]);
    assert_same_files(&whole, &parts);

    let map = folder.path("map.exr");
    stein(&["sample-map", text(&whole.join("samples_1.exr")), "--method=gem", "--budget=8", "-o", text(&map)]);
    assert_eq!(MapFile::read(&map).unwrap().map.counts.total_samples(), 8 * PIXELS);
}

#[test]
fn an_observer_ends_the_loop_by_its_error() {
    #[derive(Debug)]
    enum Ended {
        Enough,
        Other(Error),
    }
    impl From<Error> for Ended {
        fn from(error: Error) -> Self {
            Self::Other(error)
        }
    }
    let extent = Extent { width: 16, height: 16 };
    let (denoiser, schedule) = (denoiser(dfc(2)), SampleSchedule::new(8, 2, None).unwrap());
    let stops: [fn(&Event<'_>) -> bool; 4] = [
        |event| matches!(event, Event::Planned { iteration: 2, .. }),
        |event| matches!(event, Event::Drawing { .. }),
        |event| matches!(event, Event::Denoising { .. }),
        |event| matches!(event, Event::Finished { iteration: 1, .. }),
    ];
    for stop in stops {
        let mut sampler = StubSampler::new(two_walls(), extent, 3, Sequence::LowDiscrepancy);
        let ended =
            adapt(
                &mut sampler,
                &denoiser,
                &schedule,
                None,
                |event| if stop(&event) { Err(Ended::Enough) } else { Ok(()) },
            );
        match ended {
            Err(Ended::Enough) => {}
            Err(Ended::Other(error)) => panic!("{error}"),
            Ok(_) => panic!("it went on"),
        }
    }
}
