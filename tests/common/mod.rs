//! Shared by the tests of the GPU: the device, input images, and the comparison with the float64 reference.

use std::sync::{Arc, OnceLock};

use glam::IVec2;
use stein::error::Result;
use stein::gpu::{Buffer, DeviceChoice, Gpu, GpuOptions, Recorder};
use stein::stage::nlm::Schedule;

use crate::reference::compare::{self, Tolerance};
pub use crate::reference::compare::{flat, own_size};
use crate::reference::random::Random;
use crate::reference::{Grid, Planes, Point};

/// The device of all tests that do not measure its memory. Every buffer is poisoned, so that values that a kernel
/// forgets to write show.
pub fn gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| open(GpuOptions { poison: true, ..GpuOptions::default() }))
}

/// The same device with bounds checks in the kernels: a read outside of a buffer then gives another value than in an
/// unchecked kernel.
pub fn checked_gpu() -> &'static Gpu {
    static GPU: OnceLock<Gpu> = OnceLock::new();
    GPU.get_or_init(|| open(GpuOptions { poison: true, checked_shaders: true, ..GpuOptions::default() }))
}

/// A new device. Without an adapter the test fails with the remedy.
pub fn open(options: GpuOptions) -> Gpu {
    Gpu::open_with(&DeviceChoice::Auto, options).unwrap_or_else(|error| panic!("{error}"))
}

/// The same adapter with other limits than WebGPU's defaults.
pub fn limited_gpu(change: impl FnOnce(&mut wgpu::Limits)) -> Gpu {
    let description = wgpu::InstanceDescriptor {
        backends: wgpu::Backends::PRIMARY,
        ..wgpu::InstanceDescriptor::new_without_display_handle()
    };
    let adapters = pollster::block_on(wgpu::Instance::new(description).enumerate_adapters(wgpu::Backends::PRIMARY));
    let adapter = &adapters[gpu().summary().index];
    let mut required_limits = wgpu::Limits::default();
    change(&mut required_limits);
    let description = wgpu::DeviceDescriptor { required_limits, ..Default::default() };
    let (device, queue) =
        pollster::block_on(adapter.request_device(&description)).unwrap_or_else(|error| panic!("{error}"));
    Gpu::from_wgpu(device, queue, &adapter.get_info()).unwrap_or_else(|error| panic!("{error}"))
}

/// Schedules: from one row and one offset at a time to everything at once, for processors and for graphics cards. The
/// results must not depend on the schedule.
pub fn schedules() -> impl Iterator<Item = Schedule> {
    let blocks = [(1, 1, 1, 1 << 20, 0), (5, 2, 4, 9, 1 << 16), (16, 1, 1, 16, 200), (32, 3, 4, 1 << 20, 512)];
    let schedule = move |scratch_bytes| {
        blocks.map(|(block_rows, offset_rows, pixels, band_columns, region_pixels)| Schedule {
            scratch_bytes,
            block_rows,
            offset_rows,
            pixels,
            band_columns,
            region_pixels,
        })
    };
    [16, 1 << 12, 30_000, 1 << 18, 64 << 20].into_iter().flat_map(schedule)
}

/// Records and submits; returns the result of `record`.
pub fn run<T>(gpu: &Gpu, work: impl FnOnce(&mut Recorder) -> Result<T>) -> T {
    let mut rec = gpu.record();
    let result = work(&mut rec).unwrap_or_else(|error| panic!("{error}"));
    rec.submit().unwrap_or_else(|error| panic!("{error}"));
    result
}

pub fn extent_of(grid: &Grid) -> IVec2 {
    IVec2::new(grid.width as i32, grid.height as i32)
}

/// Packs planes into one plane of the GPU: a vec4 per pixel, unused channels 0.
pub fn packed(planes: &[Grid]) -> Vec<f32> {
    assert!(planes.len() <= 4);
    let pixels = planes[0].values.len();
    (0..pixels * 4).map(|i| planes.get(i % 4).map_or(0.0, |plane| plane.values[i / 4] as f32)).collect()
}

/// Packs a signal for the GPU: the mean, then the half spread.
pub fn packed_signal(mean: &[Grid], spread: &[Grid]) -> Vec<f32> {
    [packed(mean), packed(spread)].concat()
}

pub fn upload(rec: &mut Recorder, planes: &[Grid]) -> Result<Buffer> {
    rec.upload("input", &packed(planes))
}

/// The buffer. Panics if this case has none.
pub fn there(buffer: &Option<Arc<Buffer>>) -> &Buffer {
    buffer.as_deref().unwrap_or_else(|| panic!("it is left out"))
}

/// All planes of a buffer, four channels each.
pub fn read(gpu: &Gpu, buffer: &Buffer, extent: IVec2) -> Vec<Planes> {
    let values = gpu.read(buffer).unwrap_or_else(|error| panic!("{error}"));
    let (width, height) = (extent.x as usize, extent.y as usize);
    let channel = |plane: &[f32], c: usize| Grid {
        width,
        height,
        values: plane.iter().skip(c).step_by(4).map(|&v| f64::from(v)).collect(),
    };
    values.chunks_exact(4 * width * height).map(|plane| (0..4).map(|c| channel(plane, c)).collect()).collect()
}

/// The bits of a buffer, for exact comparisons.
pub fn bits(gpu: &Gpu, buffer: &Buffer) -> Vec<u32> {
    gpu.read(buffer).unwrap_or_else(|error| panic!("{error}")).into_iter().map(f32::to_bits).collect()
}

/// Rounds to float32, so that both sides get the same numbers.
pub fn rounded(grid: Grid) -> Grid {
    Grid { values: grid.values.into_iter().map(|v| f64::from(v as f32)).collect(), ..grid }
}

/// A signal with halves and variance.
pub struct Scene {
    pub mean: Planes,
    pub spread: Planes,
    pub variance: Planes,
}

/// Blocks, ramps and noise in three channels; here and there a spike of 10⁴ that may or may not admit to its variance,
/// negative radiance, and a band without variance, half of it constant.
pub fn scene(width: usize, height: usize, seed: u64) -> Scene {
    let mut random = Random(seed);
    let spikes = random.uniform_grid(width, height, 0.0, 150.0);
    let is_exact = |p: Point| p.x as usize * 5 / width == 3;
    let is_spike = |p: Point| spikes.at(p) < 1.0 && !is_exact(p);
    let (mut mean, mut spread, mut variance) = (Planes::new(), Planes::new(), Planes::new());
    for channel in 0..3 {
        let gain = [1.0, 0.4, 2.5][channel];
        let level = |p: Point| gain * ([0.8, -0.1, 0.3, 1.6][((p.x / 5 + p.y / 4) % 4) as usize] + 0.02 * p.y as f64);
        let deviation = random.uniform_grid(width, height, 0.05, 0.3);
        let sigma = Grid::from_fn(width, height, |p| if is_exact(p) { 0.0 } else { gain * deviation.at(p) });
        let (noise, half_noise) =
            (random.gaussian_grid(width, height, 0.0, 1.0), random.gaussian_grid(width, height, 0.0, 1.0));
        mean.push(Grid::from_fn(width, height, |p| match (is_spike(p), is_exact(p)) {
            (true, _) => 1e4 * gain,
            (_, true) if p.y < height as isize / 2 => gain,
            _ => level(p) + sigma.at(p) * noise.at(p),
        }));
        let admits = |p: Point| is_spike(p) && spikes.at(p) < 0.5;
        spread.push(Grid::from_fn(width, height, |p| if admits(p) { 3e3 } else { sigma.at(p) } * half_noise.at(p)));
        variance.push(Grid::from_fn(width, height, |p| {
            if admits(p) { 3e7 } else { sigma.at(p).powi(2) * (0.5 + deviation.at(p)) }
        }));
    }
    let round = |planes: Planes| planes.into_iter().map(rounded).collect();
    Scene { mean: round(mean), spread: round(spread), variance: round(variance) }
}

/// Noise on a ramp, with noisy variances: patches of any size find similar ones, and there are no spikes and no exact
/// values, so that weights are smooth functions of every pixel.
pub fn calm_scene(width: usize, height: usize, seed: u64) -> Scene {
    let mut random = Random(seed);
    let mut planes = |low: f64, high: f64| -> Planes {
        (0..3).map(|_| rounded(random.uniform_grid(width, height, low, high))).collect()
    };
    let (noise, spread, variance) = (planes(-0.3, 0.3), planes(-0.2, 0.2), planes(0.02, 0.06));
    let mean = noise.iter().map(|grid| rounded(grid.like(|p| 1.0 + 0.05 * (p.x % 24) as f64 + grid.at(p)))).collect();
    Scene { mean, spread, variance }
}

/// Compares value by value; the message names the worst one.
///
/// `scale` holds for each value the size of a relative error of 1. A share of `allowed_share` of the values may be
/// further off, because rounding may change a decision.
pub fn assert_near(what: &str, actual: &[Grid], expected: &[Grid], scale: &[Grid], relative: f64, allowed_share: f64) {
    assert!(actual.len() >= expected.len() && expected.len() == scale.len(), "{what}: {} channels", actual.len());
    let is_number = |grid: &Grid| !grid.values.iter().any(|value| value.is_nan());
    assert!(expected.iter().all(is_number), "{what}: the reference is not a number");
    let worst = compare::worst(actual, expected, scale, Tolerance { relative, least: 0.0, share: allowed_share });
    if let Some(worst) = worst.filter(|worst| worst.off > 1.0) {
        panic!("{what}: {worst}, {:.1} tolerances off", worst.off);
    }
}
