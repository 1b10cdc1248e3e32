//! The GPU layer on this machine's adapter. Without an adapter these tests fail with the remedy.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on says where")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use stein::error::{DeviceCause, Error, Result};
use stein::gpu::{
    Buffer, DeviceChoice, Gpu, GpuOptions, Kernel, MemoryUse, Recorder, Run, SavedPipelines, bindings, uniforms,
};

uniforms! {
    struct ScaleParams { extent: glam::UVec2, factor: f32 }
}

bindings! {
    struct Scale<'a> { uniform params: ScaleParams, read source, write scaled }
}

const SCALE: &str = "
struct Params { factor: f32, extent: vec2<u32> }
@group(0) @binding(7) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> source: array<f32>;
@group(0) @binding(4) var<storage, read_write> scaled: array<f32>;

@compute @workgroup_size(8, 4)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let extent = vec2<u32>(params.extent);
    if (any(id.xy >= extent)) { return; }
    let i = id.y * extent.x + id.x;
    scaled[i] = source[i] * params.factor;
}
";

const EXTENT: glam::UVec2 = glam::UVec2::new(257, 89);
const PIXELS: usize = 257 * 89;

fn gpu() -> Gpu {
    gpu_with(GpuOptions::default())
}

fn gpu_with(options: GpuOptions) -> Gpu {
    Gpu::open_with(&DeviceChoice::Auto, options).unwrap_or_else(|error| panic!("{error}"))
}

fn scale_kernel(gpu: &Gpu) -> Arc<Kernel> {
    gpu.kernel_from_source::<Scale>("scale", SCALE, &[]).unwrap_or_else(|error| panic!("{error}"))
}

/// The function that a consumer writes for a stage.
fn scale(rec: &mut Recorder, kernel: &Arc<Kernel>, source: &Buffer, factor: f32) -> Result<Buffer> {
    let scaled = rec.take("scaled", source.bytes())?;
    let params = ScaleParams { extent: EXTENT, factor };
    rec.dispatch_kernel(kernel, &Scale { params, source, scaled: &scaled }, [EXTENT.x, EXTENT.y, 1])?;
    Ok(scaled)
}

fn ramp() -> Vec<f32> {
    (0..PIXELS).map(|i| i as f32 * 0.5).collect()
}

#[test]
fn a_dispatch_computes() {
    for checked_shaders in [false, true] {
        let gpu = gpu_with(GpuOptions { checked_shaders, ..GpuOptions::default() });
        let kernel = scale_kernel(&gpu);
        assert_eq!(kernel.workgroup_size(), [8, 4, 1]);
        let mut rec = gpu.record();
        let source = rec.upload("source", &ramp()).unwrap();
        let twice = scale(&mut rec, &kernel, &source, 2.0).unwrap();
        let six_times = scale(&mut rec, &kernel, &twice, 3.0).unwrap();
        rec.submit().unwrap();
        let expected: Vec<f32> = ramp().iter().map(|value| value * 6.0).collect();
        assert_eq!(gpu.read(&six_times).unwrap(), expected);
        let mut two = [0.0; 2];
        gpu.read_into(&six_times, 40, &mut two).unwrap();
        assert_eq!(two, [30.0, 33.0]);
    }
}

fn problem<T>(result: Result<T>) -> String {
    match result {
        Ok(_) => panic!("this should have been refused"),
        Err(Error::Shader { stage, problem }) => format!("{stage}: {problem}"),
        Err(other) => other.to_string(),
    }
}

#[test]
fn names_kinds_and_types_that_do_not_match_are_refused() {
    let gpu = gpu();
    let build = |from: &str, to: &str| {
        assert!(SCALE.contains(from), "{from}");
        problem(gpu.kernel_from_source::<Scale>("scale", &SCALE.replace(from, to), &[]))
    };
    assert_eq!(
        build("factor", "faktor"),
        "scale: the shader's 'params.faktor: f32' is not in the host struct ScaleParams"
    );
    assert_eq!(
        build("factor: f32, extent: vec2<u32>", "factor: f32, extent: vec2<f32>"),
        "scale: 'params.extent' is vec2<f32> in the shader and vec2<u32> in the host struct ScaleParams"
    );
    assert_eq!(
        build("{ factor: f32, ", "{ pad: u32, factor: f32, "),
        "scale: the shader's 'params.pad: u32' is not in the host struct ScaleParams"
    );
    assert_eq!(
        build("source", "origin"),
        "scale: the shader declares 'var<storage, read> origin', which the host does not bind \
         (it binds 'params', 'source', 'scaled')"
    );
    assert_eq!(
        build("<storage, read> source", "<storage, read_write> source"),
        "scale: the shader declares 'var<storage, read_write> source', but the host binds it as 'var<storage, read>'"
    );
    assert_eq!(
        build("@group(0) @binding(1)", "@group(1) @binding(1)"),
        "scale: 'source' is in @group(1); all bindings belong to @group(0)"
    );
    assert_eq!(
        build("fn main", "fn start"),
        "scale: its entry point is 'start' (Compute) instead of the compute shader 'main'"
    );
    assert!(build("source[i] * params.factor", "source[i] * params.extent").contains("shaders/scale.wgsl"));

    let missing =
        SCALE.replace("@group(0) @binding(1) var<storage, read> source: array<f32>;", "").replace("source[i]", "1.0");
    assert_eq!(
        problem(gpu.kernel_from_source::<Scale>("scale", &missing, &[])),
        "scale: the host binds 'source', but the shader has no 'var<storage, read> source'"
    );
    assert_eq!(
        problem(gpu.kernel_from_source::<Scale>("scale", SCALE, &[("FACTR", true.into())])),
        "scale: no shader mentions the definition 'FACTR'"
    );
    assert_eq!(problem(gpu.kernel::<Scale>("no_such_stage", &[])), "no_such_stage: there is no shader of this name");
    assert_eq!(gpu.kernel_count(), 0);
}

uniforms! {
    struct Window { radius: u32, weights: [glam::Vec4; 2] }
    struct NestedParams { window: Window, shift: glam::IVec2 }
}

bindings! {
    struct Specialised<'a> { uniform params: NestedParams, optional mask, write result }
}

const SPECIALISED: &str = "
struct Window { weights: array<vec4<f32>, 2>, radius: u32 }
struct Params { shift: vec2<i32>, window: Window }
@group(0) @binding(0) var<uniform> params: Params;
#ifdef MASKED
@group(0) @binding(1) var<storage, read> mask: array<f32>;
#endif
@group(0) @binding(2) var<storage, read_write> result: array<f32>;

@compute @workgroup_size(#{WIDTH})
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x > 0u) { return; }
    result[0] = f32(params.shift.x) + f32(params.shift.y);
    result[1] = f32(params.window.radius);
    result[2] = params.window.weights[1].w;
#ifdef MASKED
    result[3] = mask[0];
#else
    result[3] = 0.0;
#endif
}
";

#[test]
fn definitions_specialise_and_members_are_found_by_name() {
    let gpu = gpu();
    let with_mask = gpu
        .kernel_from_source::<Specialised>(
            "specialised",
            SPECIALISED,
            &[("MASKED", true.into()), ("WIDTH", 64u32.into())],
        )
        .unwrap();
    let plain = gpu.kernel_from_source::<Specialised>("specialised", SPECIALISED, &[("WIDTH", 32u32.into())]).unwrap();
    assert_eq!((with_mask.workgroup_size(), plain.workgroup_size()), ([64, 1, 1], [32, 1, 1]));

    let window = Window { radius: 7, weights: [glam::Vec4::ZERO, glam::vec4(1.0, 2.0, 3.0, 4.5)] };
    let params = NestedParams { window, shift: glam::ivec2(-3, 1) };
    let mut rec = gpu.record();
    let mask = rec.upload("mask", &[9.0]).unwrap();
    let (a, b) = (rec.take("a", 16).unwrap(), rec.take("b", 16).unwrap());
    rec.dispatch_kernel(&with_mask, &Specialised { params, mask: Some(&mask), result: &a }, [1, 1, 1]).unwrap();
    rec.dispatch_kernel(&plain, &Specialised { params, mask: None, result: &b }, [1, 1, 1]).unwrap();

    let unbound = rec.dispatch_kernel(&with_mask, &Specialised { params, mask: None, result: &a }, [1, 1, 1]);
    assert_eq!(problem(unbound), "specialised: the shader reads 'mask', but nothing is bound to it");
    let superfluous = rec.dispatch_kernel(&plain, &Specialised { params, mask: Some(&mask), result: &a }, [1, 1, 1]);
    assert_eq!(problem(superfluous), "specialised: 'mask' is bound, but these definitions remove it from the shader");
    let twice = rec.dispatch_kernel(&with_mask, &Specialised { params, mask: Some(&a), result: &a }, [1, 1, 1]);
    assert_eq!(problem(twice), "specialised: the same buffer is bound to 'result', which is written, and to 'mask'");
    let foreign = rec.dispatch_kernel(
        &plain,
        &Scale { params: ScaleParams { extent: EXTENT, factor: 1.0 }, source: &a, scaled: &b },
        [1, 1, 1],
    );
    assert_eq!(problem(foreign), "specialised: it is dispatched with bindings of another stage");
    assert!(
        problem(rec.dispatch_kernel(&plain, &Specialised { params, mask: None, result: &a }, [u32::MAX, 1, 1]))
            .contains("workgroups in x")
    );

    rec.submit().unwrap();
    assert_eq!(gpu.read(&a).unwrap(), [-2.0, 7.0, 4.5, 9.0]);
    assert_eq!(gpu.read(&b).unwrap(), [-2.0, 7.0, 4.5, 0.0]);
}

#[test]
fn poison_shows_what_was_not_written_also_in_reused_memory() {
    let gpu = gpu_with(GpuOptions { poison: true, ..GpuOptions::default() });
    let kernel = scale_kernel(&gpu);
    let mut rec = gpu.record();
    // More than one copy of the poison buffer, and not a whole number of copies.
    let large = rec.take("large", (2 << 20) + 12).unwrap();
    let source = rec.upload("source", &ramp()).unwrap();
    drop(scale(&mut rec, &kernel, &source, 2.0).unwrap());
    let reused = rec.take("reused", source.bytes()).unwrap();
    let params = ScaleParams { extent: glam::uvec2(EXTENT.x, 1), factor: 2.0 };
    rec.dispatch_kernel(&kernel, &Scale { params, source: &source, scaled: &reused }, [EXTENT.x, 1, 1]).unwrap();
    rec.submit().unwrap();
    let values = gpu.read(&reused).unwrap();
    let (written, rest) = values.split_at(EXTENT.x as usize);
    assert_eq!(written, ramp()[..EXTENT.x as usize].iter().map(|value| value * 2.0).collect::<Vec<_>>());
    assert!(rest.iter().all(|value| value.to_bits() == Gpu::POISON));
    assert!(gpu.read(&large).unwrap().iter().all(|value| value.to_bits() == Gpu::POISON));
}

#[test]
fn a_dropped_buffer_is_used_again_and_nothing_grows() {
    let gpu = gpu();
    let bytes = (PIXELS * 4) as u64;
    let rounded = bytes.next_multiple_of(256);
    let run = Run::default();
    let frame = || {
        let kernel = scale_kernel(&gpu);
        let mut rec = gpu.record_in(&run);
        let source = rec.upload("source", &ramp()).unwrap();
        let mut last = scale(&mut rec, &kernel, &source, 1.0).unwrap();
        // A chain of any length needs the source and two more buffers, although nothing was submitted when they are
        // handed out again.
        for _ in 0..10 {
            last = scale(&mut rec, &kernel, &last, 2.0).unwrap();
        }
        rec.submit().unwrap();
        gpu.read(&last).unwrap()
    };
    let first = frame();
    assert_eq!(first[1], 512.0);
    assert_eq!((gpu.memory().bytes_in_use, gpu.memory().bytes_idle, run.peak_bytes()), (0, 3 * rounded, 3 * rounded));
    for _ in 0..100 {
        assert!(frame() == first, "the same commands gave another result");
    }
    assert_eq!(run.peak_bytes(), 3 * rounded);
    assert_eq!(gpu.kernel_count(), 1);

    let mut rec = gpu.record();
    let smaller = rec.take("not worth a buffer of that size", bytes / 2).unwrap();
    assert_eq!(gpu.memory().bytes_idle, 3 * rounded);
    let slightly_smaller = rec.take("worth it", bytes - bytes / 5).unwrap();
    assert_eq!(gpu.memory().bytes_idle, 2 * rounded);
    assert_eq!(slightly_smaller.bytes(), (bytes - bytes / 5).next_multiple_of(4));
    drop((smaller, slightly_smaller));
    gpu.trim();
    assert_eq!((gpu.memory(), Run::default().peak_bytes()), (MemoryUse::default(), 0));
}

#[test]
fn a_buffer_of_unsubmitted_commands_is_neither_read_nor_given_to_another_recorder() {
    let gpu = gpu();
    let kernel = scale_kernel(&gpu);
    let mut first = gpu.record();
    let source = first.upload("source", &ramp()).unwrap();
    let scaled = scale(&mut first, &kernel, &source, 3.0).unwrap();
    assert!(problem(gpu.read(&scaled)).contains("recorded but not submitted"));
    let memory = scaled.wgpu().clone();
    drop(scaled);
    let mut second = gpu.record();
    assert!(*second.take("elsewhere", source.bytes()).unwrap().wgpu() != memory);
    assert!(*first.take("same recorder", source.bytes()).unwrap().wgpu() == memory);
    first.submit().unwrap();
    second.submit().unwrap();
    assert!(problem(gpu.read_into(&source, 4, &mut vec![0.0; PIXELS])).contains("cannot be read: it has"));
    assert_eq!(gpu.read(&source).unwrap(), ramp());
}

#[test]
fn thousands_of_dispatches_are_cut_into_submissions_and_timed() {
    let gpu = gpu();
    assert!(gpu.summary().timestamps, "this adapter has no timestamps");
    assert!(gpu.set_timing(true));
    let kernel = scale_kernel(&gpu);
    let run = Run::default();
    let mut rec = gpu.record_in(&run);
    let mut last = rec.upload("source", &ramp()).unwrap();
    for _ in 0..2000 {
        last = scale(&mut rec, &kernel, &last, 1.0).unwrap();
    }
    rec.submit().unwrap();
    assert_eq!(gpu.read(&last).unwrap(), ramp());
    let times = gpu.timings(&run).unwrap().expect("there are timestamps");
    assert_eq!((times.len(), times[0].stage.as_str(), times[0].dispatches), (1, "scale", 2000));
    assert!(times[0].seconds > 0.0 && times[0].seconds < 60.0, "{times:?}");

    gpu.set_timing(false);
    let later = Run::default();
    let mut rec = gpu.record_in(&later);
    last = scale(&mut rec, &kernel, &last, 1.0).unwrap();
    rec.submit().unwrap();
    drop(last);
    assert_eq!(gpu.timings(&later).unwrap().map(|times| times.len()), Some(0));
}

#[test]
fn a_renderer_submits_everything_through_its_own_encoder() {
    let own = gpu();
    let (device, queue) = (own.wgpu_device().clone(), own.wgpu_queue().clone());
    let info = device.adapter_info();
    let gpu = Gpu::from_wgpu(device.clone(), queue.clone(), &info).unwrap();
    gpu.set_timing(true);
    let kernel = scale_kernel(&gpu);

    let bytes = (PIXELS * 4) as u64;
    let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
    let rendered =
        device.create_buffer(&wgpu::BufferDescriptor { label: None, size: bytes, usage, mapped_at_creation: false });
    let run = Run::default();
    let mut rec = gpu.record_whole_in(&run);
    let mut last = rec.upload("uploaded", &ramp()).unwrap();
    for _ in 0..100 {
        last = scale(&mut rec, &kernel, &last, 1.0).unwrap();
        rec.flush().unwrap();
    }
    let target = gpu.import("rendered", rendered.clone()).unwrap();
    let params = ScaleParams { extent: EXTENT, factor: 4.0 };
    rec.dispatch_kernel(&kernel, &Scale { params, source: &last, scaled: &target }, [EXTENT.x, EXTENT.y, 1]).unwrap();
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    rec.encode_into(&mut encoder).unwrap();
    assert_eq!(gpu.timings(&run).unwrap().expect("there are timestamps")[0].dispatches, 0, "nothing was submitted yet");
    queue.submit([encoder.finish()]);
    assert_eq!(gpu.read(&target).unwrap(), ramp().iter().map(|value| value * 4.0).collect::<Vec<_>>());
    assert_eq!(gpu.timings(&run).unwrap().expect("there are timestamps")[0].dispatches, 101);

    let usage = wgpu::BufferUsages::COPY_DST;
    let unbindable =
        device.create_buffer(&wgpu::BufferDescriptor { label: None, size: bytes, usage, mapped_at_creation: false });
    assert!(problem(gpu.import("framebuffer", unbindable)).contains("'framebuffer' was created without STORAGE usage"));
    let mut late = gpu.record();
    late.upload("a", &[1.0]).unwrap();
    late.flush().unwrap();
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    assert!(problem(late.encode_into(&mut encoder)).contains("submitted already"));
}

#[test]
fn an_absurd_request_names_the_limit_and_the_device_lives_on() {
    let gpu = gpu();
    let limit = gpu.max_binding_bytes();
    let mut rec = gpu.record();
    for bytes in [1 << 50, u64::MAX, limit + 1] {
        let Err(Error::Device(DeviceCause::BufferTooLarge { label, bytes: refused, limit: most, .. })) =
            rec.take("offsets", bytes)
        else {
            panic!("{bytes} bytes are no error of their own")
        };
        assert_eq!((label.as_str(), refused, most), ("offsets", bytes, limit));
    }
    let small = rec.upload("small", &[1.0, 2.0]).unwrap();
    let nothing = rec.upload("nothing", &[]).unwrap();
    rec.submit().unwrap();
    assert_eq!(gpu.read(&small).unwrap(), [1.0, 2.0]);
    assert_eq!(nothing.bytes(), 4);
}

/// Runs in a process of its own with little address space, because a software adapter takes its memory from there.
#[test]
#[ignore = "started by `a_full_device_frees_what_it_can_and_lives_on` with limited memory"]
fn with_little_memory() {
    let gpu = gpu();
    let kernel = scale_kernel(&gpu);
    let mut rec = gpu.record();
    let source = rec.upload("source", &ramp()).unwrap();
    let bytes = gpu.max_binding_bytes();
    let mut held = Vec::new();
    let text = loop {
        match rec.take("candidates", bytes) {
            Ok(buffer) => held.push(buffer),
            refused => break problem(refused),
        }
        assert!(held.len() < 1000, "the memory limit has no effect");
    };
    for part in ["has no memory left for the buffer 'candidates'", &bytes.to_string(), "memory limit", "smaller window"]
    {
        assert!(text.contains(part), "{part} is missing in: {text}");
    }
    // Idle buffers of another size are freed when memory is short, even while commands that use them are still
    // recorded.
    drop(held);
    let sizes = (1..=10).map(|n| n * bytes / 32);
    for size in sizes.clone().chain(sizes.rev()) {
        let odd = rec.take("odd", size).unwrap();
        rec.dispatch_kernel(
            &kernel,
            &Scale { params: ScaleParams { extent: EXTENT, factor: 2.0 }, source: &source, scaled: &odd },
            [EXTENT.x, EXTENT.y, 1],
        )
        .unwrap();
    }
    let last = scale(&mut rec, &kernel, &source, 2.0).unwrap();
    rec.submit().unwrap();
    assert_eq!(gpu.read(&last).unwrap()[3], 3.0);
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_device_frees_what_it_can_and_lives_on() {
    if !gpu().is_software() {
        return;
    }
    let run = "ulimit -v 12000000 && exec \"$0\" --ignored --exact with_little_memory";
    let child =
        std::process::Command::new("sh").args(["-c", run]).arg(std::env::current_exe().unwrap()).output().unwrap();
    assert!(
        child.status.success(),
        "{}{}",
        String::from_utf8_lossy(&child.stdout),
        String::from_utf8_lossy(&child.stderr)
    );
    assert!(String::from_utf8_lossy(&child.stdout).contains("1 passed"));
}

#[test]
fn a_lost_device_is_an_error_everywhere() {
    let gpu = gpu();
    let kernel = scale_kernel(&gpu);
    let mut rec = gpu.record();
    let source = rec.upload("source", &ramp()).unwrap();
    gpu.wgpu_device().destroy();
    let submitted = scale(&mut rec, &kernel, &source, 2.0).and_then(|_| rec.submit());
    let mut rec = gpu.record();
    let again = rec.take("again", 16);
    for text in [
        problem(submitted),
        problem(again),
        problem(gpu.read(&source)),
        problem(gpu.wait()),
        problem(gpu.timings(&Run::default())),
        problem(rec.upload("more", &[1.0])),
        problem(gpu.kernel_from_source::<Scale>("scale", SCALE, &[])),
        problem(rec.submit()),
    ] {
        assert!(text.starts_with("the device was lost: ") && text.contains("remedy: "), "{text}");
    }
}

#[test]
fn a_lost_device_of_a_renderer_is_an_error_too() {
    let own = gpu();
    let gpu =
        Gpu::from_wgpu(own.wgpu_device().clone(), own.wgpu_queue().clone(), &own.wgpu_device().adapter_info()).unwrap();
    let mut rec = gpu.record();
    let source = rec.upload("source", &ramp()).unwrap();
    rec.submit().unwrap();
    own.wgpu_device().destroy();
    assert!(problem(gpu.read(&source)).contains("remedy: "));
    assert!(problem(gpu.record().upload("more", &[1.0])).contains("remedy: "));
}

/// The file in which the adapter's pipelines are kept, if it hands any out.
fn pipeline_file(saved: &SavedPipelines) -> Option<&Path> {
    match saved {
        SavedPipelines::Nowhere => None,
        SavedPipelines::Unchanged { file, bytes } | SavedPipelines::Written { file, bytes } => {
            assert_eq!(std::fs::metadata(file).unwrap().len(), *bytes);
            Some(file)
        }
    }
}

#[test]
fn compiled_pipelines_are_kept_and_found_again() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("made/on the way");
    let files = || {
        std::fs::read_dir(&folder)
            .map_or_else(|_| Vec::new(), |entries| entries.map(|entry| entry.unwrap().path()).collect())
    };
    let open = || gpu_with(GpuOptions { pipeline_folder: Some(folder.clone()), ..GpuOptions::default() });
    // A kernel that no other test compiles, so that no cache of the driver holds it.
    let computed = |gpu: &Gpu| {
        let kernel = gpu
            .kernel_from_source::<Scale>("scale", &SCALE.replace("params.factor", "params.factor + 0.03125"), &[])
            .unwrap();
        let mut rec = gpu.record();
        let source = rec.upload("source", &ramp()).unwrap();
        let scaled = scale(&mut rec, &kernel, &source, 2.0).unwrap();
        rec.submit().unwrap();
        gpu.read(&scaled).unwrap()[1]
    };
    let first = open();
    assert_eq!((computed(&first), files().len()), (1.03125, 0));
    let saved = first.save_pipelines().unwrap();
    let Some(file) = pipeline_file(&saved) else { return assert_eq!(files(), Vec::<PathBuf>::new()) };
    assert!(matches!(saved, SavedPipelines::Written { .. }), "{saved:?}");
    assert_eq!(files(), [file]);
    let intact = std::fs::read(file).unwrap();
    assert!(matches!(first.save_pipelines(), Ok(SavedPipelines::Unchanged { .. })));

    // The file is read again, also by a device that is open at the same time. If nothing changed, it is not written
    // again.
    let old = std::time::SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(1_000_000_000);
    std::fs::File::options().write(true).open(file).unwrap().set_modified(old).unwrap();
    let second = open();
    assert_eq!(computed(&second), 1.03125);
    assert!(matches!(second.save_pipelines(), Ok(SavedPipelines::Unchanged { .. })));
    drop((first, second));
    assert_eq!(std::fs::metadata(file).unwrap().modified().unwrap(), old);

    // A file that is truncated, damaged or foreign: pipelines are compiled again, and the file is replaced when the
    // device is closed.
    let mut spoiled = intact.clone();
    *spoiled.last_mut().unwrap() ^= 1;
    for damaged in [&intact[..intact.len() / 2], &spoiled, b"", b"a picture"] {
        std::fs::write(file, damaged).unwrap();
        assert_eq!(computed(&open()), 1.03125);
        assert_ne!(std::fs::read(file).unwrap(), damaged);
        assert!(matches!(open().save_pipelines(), Ok(SavedPipelines::Unchanged { .. })));
    }
    assert_eq!(files(), [file], "nothing else is left behind");
}

#[test]
fn a_folder_that_cannot_be_written_to_costs_only_time() {
    let home = tempfile::tempdir().unwrap();
    let occupied = home.path().join("a file");
    std::fs::write(&occupied, "").unwrap();
    let gpu = gpu_with(GpuOptions { pipeline_folder: Some(occupied.join("folder")), ..GpuOptions::default() });
    scale_kernel(&gpu);
    match gpu.save_pipelines() {
        Ok(saved) => assert_eq!(saved, SavedPipelines::Nowhere),
        Err(error) => assert!(error.to_string().contains("remedy: "), "{error}"),
    }
    drop(gpu);
    assert_eq!(std::fs::read(&occupied).unwrap(), b"");
}

#[test]
fn pipelines_are_kept_nowhere_unless_asked() {
    let gpu = gpu();
    scale_kernel(&gpu);
    assert_eq!(gpu.save_pipelines().unwrap(), SavedPipelines::Nowhere);
}

#[test]
fn threads_share_a_device_and_its_kernels() {
    let gpu = gpu();
    let results: Vec<Vec<f32>> = std::thread::scope(|scope| {
        let work = |factor: f32| {
            let gpu = gpu.clone();
            move || {
                let kernel = scale_kernel(&gpu);
                let mut rec = gpu.record();
                let source = rec.upload("source", &ramp()).unwrap();
                let mut last = scale(&mut rec, &kernel, &source, factor).unwrap();
                for _ in 0..100 {
                    last = scale(&mut rec, &kernel, &last, 1.0).unwrap();
                }
                rec.submit().unwrap();
                gpu.read(&last).unwrap()
            }
        };
        let threads: Vec<_> = (0..4).map(|i| scope.spawn(work(i as f32))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    for (i, result) in results.iter().enumerate() {
        assert_eq!(*result, ramp().iter().map(|value| value * i as f32).collect::<Vec<_>>());
    }
    assert_eq!(gpu.kernel_count(), 1);
}

#[test]
fn every_adapter_can_be_named() {
    let adapters = Gpu::adapters();
    assert!(!adapters.is_empty());
    for adapter in adapters {
        let gpu = Gpu::open(&DeviceChoice::Index(adapter.index)).unwrap();
        assert_eq!(*gpu.summary(), adapter);
        assert!(adapter.to_string().contains(&adapter.name));
    }
    assert!(problem(Gpu::open(&DeviceChoice::Name("no such card".into()))).contains("choose one of these"));
}

#[test]
fn every_shader_file_is_listed() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("shaders");
    for (folder, mut listed) in
        [(root.clone(), stein::gpu::stages()), (root.join("shared"), stein::gpu::shared_modules())]
    {
        let entries = folder.read_dir().into_iter().flatten().map(|entry| entry.unwrap().path());
        let mut found: Vec<_> = entries.filter(|path| path.extension().is_some_and(|ext| ext == "wgsl")).collect();
        found.sort();
        listed.sort_unstable();
        let found: Vec<_> = found.iter().map(|path| path.file_stem().unwrap().to_str().unwrap()).collect();
        assert_eq!(found, listed, "src/gpu/catalogue.rs and {} differ", folder.display());
    }
}
