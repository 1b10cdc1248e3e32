//! The graphics layer on whatever adapter this machine has; without one these tests fail and say how to get one.

use std::sync::Arc;

use stein::error::{Error, Result};
use stein::gpu::{Buffer, DeviceChoice, Gpu, GpuOptions, Kernel, Recorder, bindings, uniforms};

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
    if (any(id.xy >= params.extent)) { return; }
    let i = id.y * params.extent.x + id.x;
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

/// The one function per stage that a consumer writes.
fn scale(rec: &mut Recorder, kernel: &Arc<Kernel>, source: &Buffer, factor: f32) -> Result<Buffer> {
    let scaled = rec.take("scaled", source.bytes())?;
    let params = ScaleParams { extent: EXTENT, factor };
    rec.dispatch(kernel, &Scale { params, source, scaled: &scaled }, [EXTENT.x, EXTENT.y, 1])?;
    Ok(scaled)
}

fn ramp() -> Vec<f32> {
    (0..PIXELS).map(|i| i as f32 * 0.5).collect()
}

#[test]
fn a_dispatch_computes() {
    for checked_shaders in [false, true] {
        let gpu = gpu_with(GpuOptions { checked_shaders, poison: false });
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
