//! Faults around the program: files that are no images, full disks, signals, closed pipes, lost devices. The work ends
//! with a message or a signal, earlier files are unchanged, and no unfinished file is left.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "common/process.rs"]
mod process;

use std::ops::ControlFlow;
use std::time::Duration;

use process::{Folder, stein, test_image};
use stein::error::{DeviceCause, Error, Remedy, Result};
use stein::frame::{SamplesPerPixel, Signal};
use stein::gpu::DeviceChoice;
use stein::{Denoiser, Estimate, Extent, Frame, GemParams, Gpu, Image, Options};

const BEFORE: &str = "what was there before";

/// A folder with an output of an earlier run.
fn with_output() -> (Folder, String) {
    let folder = Folder::new();
    let output = folder.path("out.exr");
    std::fs::write(&output, BEFORE).unwrap();
    (folder, output)
}

/// Checks that the output is unchanged and the only file in its folder.
#[track_caller]
fn assert_untouched(folder: &Folder) {
    assert_eq!(folder.names(), ["out.exr"]);
    assert_eq!(std::fs::read_to_string(folder.path("out.exr")).unwrap(), BEFORE);
}

fn broken(name: &str) -> String {
    test_image(&format!("broken/{name}.exr"))
}

#[test]
fn every_broken_file_ends_with_code_3() {
    let (folder, output) = with_output();
    let mut files: Vec<_> =
        std::fs::read_dir(test_image("broken")).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(files.len() > 50);
    for file in files {
        let file = file.to_str().unwrap();
        let ended = stein(&["denoise", file, "-o", &output]);
        ended.failed(3, &[file, "remedy: "]);
        // The message has the words of the command line, not of the library.
        assert!(!ended.stderr.contains("BufferSetRequest"), "{}", ended.stderr);
    }
    for (name, option) in [("half_alone", "--half-b"), ("no_blue", "--layer"), ("parts_elsewhere", "--skip-feature")] {
        stein(&["denoise", &broken(name), "-o", &output]).failed(3, &[option]);
    }
    assert_untouched(&folder);
}

#[test]
fn an_image_alone_is_refused_where_that_is_asked_for() {
    let (folder, output) = with_output();
    let input = test_image("cornell_reference.exr");
    let said =
        [&*input, "nothing is known of the colour's noise", "render twice with different seeds", "--seed", "remedy: "];
    for more in [&[][..], &["--dry-run"], &["--json"]] {
        stein(&[&["denoise", &input, "-o", &output, "--require-noise"], more].concat()).failed(3, &said);
    }
    stein(&["sample-map", &input, "-o", &output, "--budget=8", "--require-noise"]).failed(3, &said);
    stein(&["kernel", &input, "--pixel=1,1", "--require-noise"]).failed(3, &said);
    stein(&["bench", &input, "--require-noise"]).failed(3, &said);
    assert_untouched(&folder);
}

#[test]
fn a_broken_file_beside_the_input_names_itself() {
    let (folder, output) = with_output();
    let input = test_image("cornell_8spp.exr");
    let (cut, small) = (broken("cut_in_channels"), broken("parts_of_other_sizes"));
    for option in ["--half-a", "--half-b", "--variance", "--ref"] {
        stein(&["denoise", &input, "-o", &output, option, &cut])
            .failed(3, &["cut_in_channels.exr", "ends in its header", "remedy: "]);
    }
    let feature = format!("albedo={small}::beauty");
    stein(&["denoise", &input, "-o", &output, "--feature", &feature])
        .failed(3, &["parts_of_other_sizes.exr", "beauty", "4×3", "96×96", "remedy: "]);
    stein(&["denoise", &input, "-o", &output, "--ref", &format!("{small}::beauty")])
        .failed(3, &["4×3", "96×96", "remedy: "]);
    assert_untouched(&folder);
}

#[test]
fn what_is_no_file_is_told_and_not_waited_for() {
    let (folder, output) = with_output();
    let read = |input: &str, said: &[&str]| {
        stein(&["denoise", input, "-o", &output]).failed(3, &[&[input, "remedy: "], said].concat());
    };
    read(&folder.path(""), &["it is a folder"]);
    read(&folder.path("missing.exr"), &[]);
    #[cfg(unix)]
    {
        let other = Folder::new();
        let pipe = other.path("pipe.exr");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        read(&pipe, &["it is a pipe or a device"]);
        read("/dev/zero", &["it is a pipe or a device"]);
    }
    assert_untouched(&folder);
}

/// A square frame of noise around grey, with halves and variance.
fn frame(side: u32) -> Frame {
    let extent = Extent { width: side, height: side };
    let plane =
        |scale: f32| (0..extent.pixels()).map(|i| 0.5 + scale * (((i * 7919) % 101) as f32 / 101.0 - 0.5)).collect();
    let image = |scale: f32| Image { extent, planes: vec![plane(scale), plane(0.5 * scale), plane(-scale)] };
    let color = Signal {
        mean: image(0.4),
        half_spread: Some(image(0.2)),
        variance_of_mean: Some(Image::filled(extent, 3, 0.01)),
    };
    Frame::new(color, Vec::new(), SamplesPerPixel::Unknown).unwrap().0
}

fn gpu() -> Gpu {
    Gpu::open(&DeviceChoice::Auto).unwrap_or_else(|error| panic!("{error}"))
}

#[track_caller]
fn assert_lost(denoised: Result<Estimate>) {
    match denoised {
        Err(error @ Error::Device(DeviceCause::Lost { .. })) => {
            assert_eq!(error.remedies().first(), Some(&Remedy::RunAgain));
        }
        Err(other) => panic!("{other}"),
        Ok(_) => panic!("a lost device has denoised"),
    }
}

#[test]
fn a_device_lost_at_any_step_is_told_and_another_one_goes_on() {
    let frame = frame(24);
    // The method that compiles fastest.
    let method = GemParams::default();
    let (survivor, lost_early) = (gpu(), gpu());
    let surviving = Denoiser::new(&survivor, method).unwrap();
    let mut steps = 0;
    let mut count = |_: f32| {
        steps += 1;
        ControlFlow::Continue(())
    };
    let expected =
        surviving.denoise_with(&frame, Options { progress: Some(&mut count), ..Options::default() }).unwrap();

    lost_early.wgpu_device().destroy();
    assert_lost(Denoiser::new(&lost_early, method).unwrap().denoise(&frame));
    // The device is lost while work is recorded, and before results are read back.
    for lost_at in 1..=steps {
        let gpu = gpu();
        let mut step = 0;
        let mut lose = |_: f32| {
            step += 1;
            if step == lost_at {
                gpu.wgpu_device().destroy();
            }
            ControlFlow::Continue(())
        };
        let denoiser = Denoiser::new(&gpu, method).unwrap();
        assert_lost(denoiser.denoise_with(&frame, Options { progress: Some(&mut lose), ..Options::default() }));
        assert_lost(denoiser.denoise(&frame));
    }
    // The device is lost during a wait: every such call returns an error or a result.
    let gpu = gpu();
    let denoiser = Denoiser::new(&gpu, method).unwrap();
    denoiser.denoise(&frame).unwrap();
    let device = gpu.wgpu_device().clone();
    let loser = std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(30));
        device.destroy();
    });
    let end = loop {
        match denoiser.denoise(&frame) {
            Ok(estimate) => assert_eq!(estimate.color, expected.color),
            lost => break lost,
        }
    };
    assert_lost(end);
    loser.join().unwrap();

    assert_eq!(surviving.denoise(&frame).unwrap().color, expected.color);
}

#[test]
fn a_device_of_small_limits_says_what_is_too_large() {
    let own = gpu();
    let adapter = own.summary().name.clone();
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
        backends: wgpu::Backends::PRIMARY,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    });
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    let adapter = adapters.into_iter().find(|found| found.get_info().name == adapter).unwrap();
    let denoise = |bytes: u64| {
        let required_limits = wgpu::Limits {
            max_storage_buffers_per_shader_stage: adapter.limits().max_storage_buffers_per_shader_stage.min(16),
            max_storage_buffer_binding_size: bytes,
            max_buffer_size: bytes,
            ..wgpu::Limits::default().or_worse_values_from(&adapter.limits())
        };
        let description = wgpu::DeviceDescriptor { required_limits, ..Default::default() };
        let (device, queue) = pollster::block_on(adapter.request_device(&description)).unwrap();
        let gpu = Gpu::from_wgpu(device, queue, &adapter.get_info()).unwrap();
        Denoiser::new(&gpu, GemParams::default()).unwrap().denoise(&frame(24))
    };
    // A plane of 24 by 24 pixels takes 9 KiB.
    let refused = denoise(2048).map(drop);
    assert!(matches!(refused, Err(Error::Device(DeviceCause::StripExceedsAdapter { .. }))), "{refused:?}");
    let expected = Denoiser::new(&own, GemParams::default()).unwrap().denoise(&frame(24)).unwrap();
    assert_eq!(denoise(1 << 20).unwrap().color, expected.color);
}

#[test]
fn no_device_and_no_memory_end_with_code_4() {
    let (folder, output) = with_output();
    let input = test_image("cornell_8spp.exr");
    let denoise = ["denoise", &input, "-o", &output, "--method=gem"];
    stein(&[&denoise[..], &["--device=no such adapter"]].concat()).failed(4, &["no such adapter", "remedy: "]);
    stein(&[&denoise[..], &["--max-memory=1K"]].concat()).failed(4, &["--max-memory", "remedy: "]);
    assert_untouched(&folder);
}

#[cfg(unix)]
mod unix {
    use std::io::{BufRead, BufReader, Read};
    use std::os::unix::fs::MetadataExt;
    use std::os::unix::process::{CommandExt, ExitStatusExt};
    use std::process::{Child, Command, ExitStatus, Stdio};
    use std::time::{Duration, Instant};

    use exr::prelude::{
        AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, Text, WritableImage, f16,
    };

    use super::process::{Folder, Outcome, command, test_image};
    use super::*;

    /// Runs the program in a shell after `setup`; the program and its arguments are `"$0" "$@"`.
    fn in_shell(setup: &str, arguments: &[&str]) -> Command {
        let mut shell = Command::new("sh");
        shell.args(["-c", &format!("{setup} exec \"$0\" \"$@\"")]).arg(env!("CARGO_BIN_EXE_stein")).args(arguments);
        shell.env("NODEVICE_SELECT", "1").env("STEIN_CACHE", "").stdin(Stdio::null());
        shell
    }

    fn outcome(mut command: Command) -> Outcome {
        let output = command.output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Outcome { code: output.status.code().unwrap_or(-1), stdout: text(output.stdout), stderr: text(output.stderr) }
    }

    /// Runs the command as another user if the user is root, whom permissions do not bind.
    fn as_nobody(command: &mut Command) {
        let folder = Folder::new();
        if std::fs::metadata(folder.path("")).unwrap().uid() == 0 {
            command.uid(65534).gid(65534);
        }
    }

    fn set_mode(path: &str, mode: u32) {
        std::fs::set_permissions(path, std::os::unix::fs::PermissionsExt::from_mode(mode)).unwrap();
    }

    #[test]
    fn what_a_header_claims_is_not_allocated() {
        let (folder, output) = with_output();
        let limited = |input: &str| {
            // Address space for the program itself; the files claim gigabytes to exabytes.
            let mut command = in_shell("ulimit -v 400000;", &["denoise", input, "-o", &output]);
            // Each thread takes address space.
            command.env("RAYON_NUM_THREADS", "2");
            outcome(command)
        };
        for name in [
            "window_of_2_31",
            "window_100k",
            "window_100k_in_one_block",
            "window_wide",
            "window_huge_dwab",
            "block_huge",
            "dwaa_claims",
            "attribute_huge",
        ] {
            let input = broken(name);
            limited(&input).failed(3, &[&input, "remedy: "]);
        }
        assert_untouched(&folder);
    }

    /// A render of this many pixels per side whose halves differ, as half floats: 18 bytes per pixel in memory and next
    /// to nothing in the file.
    fn write_large(path: &str, side: usize) {
        let channel = |(half, value): (&str, f32), name: &str| {
            let samples = FlatSamples::F16(vec![f16::from_f32(value); side * side]);
            AnyChannel::new(Text::new_or_panic(format!("{half}{name}")), samples)
        };
        let halves = [("", 0.5), ("halfA.", 0.25), ("halfB.", 0.75)];
        let channels = halves.into_iter().flat_map(|half| ["R", "G", "B"].map(|name| channel(half, name))).collect();
        let part =
            Layer::new((side, side), LayerAttributes::default(), Encoding::FAST_LOSSLESS, AnyChannels::sort(channels));
        Image::from_layer(part).write().to_file(path).unwrap();
    }

    #[test]
    fn where_memory_ends_a_message_tells_how_much_is_needed() {
        let (folder, _) = with_output();
        let large = folder.path("large.exr");
        write_large(&large, 2048);
        let mut refused = 0;
        // From a limit below the program's own need to a limit that is enough for all of the work.
        for megabytes in (40..=400).step_by(24) {
            let mut command = in_shell(&format!("ulimit -v {};", megabytes * 1000), &["info", &large]);
            command.env("RAYON_NUM_THREADS", "2");
            let ended = outcome(command);
            match ended.code {
                0 => {}
                3 => {
                    ended.failed(3, &["large.exr", "MiB of memory, but", "MiB are free", "remedy: "]);
                    refused += 1;
                }
                code => {
                    assert_eq!(code, 4, "{megabytes} MB: {}", ended.stderr);
                    ended.failed(4, &["remedy: "]);
                }
            }
        }
        assert!(refused > 3, "{refused}");
        std::fs::remove_file(&large).unwrap();
        assert_untouched(&folder);
    }

    #[test]
    fn the_memory_of_a_software_device_counts_as_the_computers() {
        let (folder, output) = with_output();
        let large = folder.path("large.exr");
        write_large(&large, 1024);
        for megabytes in [250, 350, 450, 550] {
            let mut command = in_shell(
                &format!("ulimit -v {};", megabytes * 1000),
                &["denoise", "--method=gem", &large, "-o", &output],
            );
            command.env("RAYON_NUM_THREADS", "2");
            let ended = outcome(command);
            if ended.code != 0 {
                assert!([3, 4].contains(&ended.code), "{megabytes} MB: {} {}", ended.code, ended.stderr);
                ended.failed(ended.code, &["remedy: "]);
                assert_eq!(std::fs::read_to_string(&output).unwrap(), BEFORE);
            }
        }
        assert_eq!(folder.names(), ["large.exr", "out.exr"]);
    }

    #[test]
    fn what_may_not_be_read_or_written_is_told() {
        let (folder, input) = Folder::with("cornell_8spp.exr");
        set_mode(&folder.path(""), 0o755);
        let denoise = |input: &str, output: &str| {
            let mut command = command(&["denoise", input, "-o", output, "--method=gem"]);
            as_nobody(&mut command);
            outcome(command)
        };
        // The folder belongs to another user.
        set_mode(&input, 0o644);
        set_mode(&folder.path(""), 0o555);
        denoise(&input, &folder.path("out.exr")).failed(5, &["out.exr", "cannot be written", "remedy: "]);
        set_mode(&folder.path(""), 0o755);
        set_mode(&input, 0o000);
        let other = Folder::new();
        set_mode(&other.path(""), 0o777);
        denoise(&input, &other.path("out.exr")).failed(3, &["render.exr", "Permission denied", "remedy: "]);
        assert!(other.names().is_empty());
        assert_eq!(folder.names(), ["render.exr"]);
    }

    #[test]
    fn a_disk_that_fills_up_leaves_the_old_output() {
        let (folder, output) = with_output();
        let input = test_image("cornell_8spp.exr");
        // Files up to 64 KiB; the output is ten times that.
        let full = |arguments: &[&str], code: i32, said: &[&str]| {
            outcome(in_shell("ulimit -f 128;", arguments)).failed(code, said);
        };
        full(
            &["denoise", &input, "-o", &output, "--method=gem"],
            5,
            &["out.exr", "cannot be written", "space left", "remedy: "],
        );
        assert_untouched(&folder);
        full(&["render", "dof", "--spp=2", "--size=64x64", "-o", &output], 5, &["out.exr", "space left"]);
        assert_untouched(&folder);
        let report = folder.path("report");
        let bench =
            ["bench", &input, "--methods=gem", "--presets=default", "--repeat=1", "--size=32x32", "-o", &report];
        outcome(in_shell("ulimit -f 8;", &bench)).failed(5, &["report", "cannot be written", "remedy: "]);
        assert_untouched(&folder);
    }

    /// Starts a run and waits until it has printed this text.
    fn running(arguments: &[&str], until: &str) -> Child {
        let mut child = command(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.as_mut().unwrap());
        let mut line = String::new();
        while !line.starts_with(until) {
            line.clear();
            assert!(lines.read_line(&mut line).unwrap() > 0, "it ended before it worked");
        }
        child
    }

    fn send(signal: &str, child: &Child) {
        let sent = Command::new("sh").args(["-c", &format!("kill -{signal} {}", child.id())]).status().unwrap();
        assert!(sent.success());
    }

    /// Returns how the run ended, and its standard error. Fails if the run goes on.
    #[track_caller]
    fn end(mut child: Child) -> (ExitStatus, String) {
        let start = Instant::now();
        let status = loop {
            match child.try_wait().unwrap() {
                Some(status) => break status,
                None if start.elapsed() > Duration::from_secs(60) => {
                    child.kill().unwrap();
                    panic!("it goes on");
                }
                None => std::thread::sleep(Duration::from_millis(5)),
            }
        };
        let mut said = String::new();
        child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        (status, said)
    }

    /// Whether the parent process had this signal set to be ignored, as a shell does for background jobs.
    fn is_ignored(number: u32) -> bool {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let mask = status
            .lines()
            .find_map(|line| line.strip_prefix("SigIgn:"))
            .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
        mask.is_some_and(|mask| mask & (1 << (number - 1)) != 0)
    }

    #[test]
    fn a_signal_ends_the_work_and_leaves_nothing_half_done() {
        // The signal comes while shaders are compiled, and while the device works.
        for (name, number, method, until) in [
            ("INT", 2, "dfc", "openjd_progress"),
            ("TERM", 15, "dfc", "openjd_status"),
            ("HUP", 1, "nlm", "openjd_progress"),
        ] {
            if is_ignored(number) {
                continue;
            }
            let (folder, output) = with_output();
            let input = test_image("dof_spheres_32spp.exr");
            let child = running(
                &["denoise", &input, "-o", &output, "--method", method, "--radius=20", "--progress=openjd"],
                until,
            );
            send(name, &child);
            let (status, said) = end(child);
            assert_eq!((status.signal(), said.as_str()), (Some(number as i32), ""), "{name}: {status}");
            assert_untouched(&folder);
        }
    }

    #[test]
    fn a_file_that_is_being_written_is_taken_away() {
        let writing = |signals: &[&str]| {
            let (folder, output) = with_output();
            // So large that writing it takes far longer than sending two signals.
            let arguments = ["render", "dof", "--spp=2", "--size=700x700", "-q", "-o", &output];
            let child = command(&arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
            let start = Instant::now();
            while folder.names().len() == 1 {
                assert!(start.elapsed() < Duration::from_secs(60), "nothing was written");
                std::thread::sleep(Duration::from_millis(1));
            }
            signals.iter().for_each(|signal| send(signal, &child));
            (folder, end(child).0.signal())
        };
        // The first signal lets the work end, the second ends the process.
        let (folder, signal) = writing(&["TERM", "TERM"]);
        assert_eq!(signal, Some(15));
        assert_untouched(&folder);
        // SIGKILL cannot be handled, but the old output is unchanged.
        let (folder, signal) = writing(&["KILL"]);
        assert_eq!((signal, std::fs::read_to_string(folder.path("out.exr")).unwrap().as_str()), (Some(9), BEFORE));
    }

    #[test]
    fn a_renderer_ends_with_the_loop_that_started_it() {
        let folder = Folder::new();
        let (loops, number) = (folder.path("loop"), folder.path("number"));
        let renderer = format!("echo $$ > '{number}'; exec sleep 600 # {{map}} {{out}}");
        let arguments = [
            "adapt",
            "--sampler-command",
            &renderer,
            "--size=16x16",
            "--spp=4",
            "--iterations=1",
            "--method=gem",
            "-o",
            &loops,
        ];
        let child = command(&arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let start = Instant::now();
        let number = loop {
            match std::fs::read_to_string(&number).ok().and_then(|number| number.trim().parse::<u32>().ok()) {
                Some(number) => break number,
                None => assert!(start.elapsed() < Duration::from_secs(60), "the renderer did not start"),
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        send("TERM", &child);
        assert_eq!(end(child).0.signal(), Some(15));
        let start = Instant::now();
        // The process is gone, or a zombie.
        let lives = || std::fs::read_to_string(format!("/proc/{number}/stat")).is_ok_and(|stat| !stat.contains(") Z "));
        while lives() {
            assert!(start.elapsed() < Duration::from_secs(20), "the renderer goes on");
            std::thread::sleep(Duration::from_millis(5));
        }
        assert_eq!(Folder::names_in(&loops), ["map_1.exr"]);
    }

    #[test]
    fn a_benchmark_can_be_ended() {
        let folder = Folder::new();
        let report = folder.path("report");
        let input = test_image("cornell_8spp.exr");
        let arguments = ["bench", &input, "--methods=gem", "--repeat=100000", "--size=32x32", "-o", &report];
        let mut child = command(&arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        // The program prints its adapter when it begins to work.
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut String::new()).unwrap();
        send("TERM", &child);
        assert_eq!(end(child).0.signal(), Some(15));
        assert!(folder.names().is_empty());
    }

    #[test]
    fn what_was_told_to_ignore_a_hangup_goes_on() {
        let (folder, output) = with_output();
        let arguments = ["denoise", &test_image("cornell_8spp.exr"), "-o", &output, "--radius=2", "--progress=openjd"];
        let mut child =
            in_shell("trap '' HUP;", &arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut String::new()).unwrap();
        send("HUP", &child);
        drop(child.stdout.take());
        let (status, said) = end(child);
        assert!(status.success(), "{status}: {said}");
        assert!(std::fs::metadata(&output).unwrap().len() > 10_000);
        assert_eq!(folder.names(), ["out.exr"]);
    }

    #[test]
    fn pipes_that_close_do_not_end_the_work() {
        let input = test_image("cornell_8spp.exr");
        for closed in [">&- 2>&-", "2>/dev/full", "| head -n 1"] {
            let (folder, output) = with_output();
            let script = format!("\"$0\" denoise '{input}' -o '{output}' --method=gem --json {closed}");
            let status = Command::new("sh")
                .args(["-c", &script, env!("CARGO_BIN_EXE_stein")])
                .env("STEIN_CACHE", "")
                .stdout(Stdio::null())
                .status()
                .unwrap();
            assert!(status.success(), "{closed}: {status}");
            assert!(std::fs::metadata(&output).unwrap().len() > 10_000, "{closed}");
            assert_eq!(folder.names(), ["out.exr"]);
        }
    }
}
