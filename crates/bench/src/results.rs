//! The document of a report: everything that was measured.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use stein::gpu::AdapterIdentity;

use super::statistics::front;

/// Schema name that identifies our documents.
pub const SCHEMA: &str = "stein.bench";

/// Raised when a field changes its meaning or goes away; new fields alone do not raise it.
pub const VERSION: u32 = 2;

/// `results.json`. Times are in milliseconds, memory in bytes, errors without a unit or in the squared unit of the
/// file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Document {
    /// [`SCHEMA`]
    pub schema: String,
    /// [`VERSION`]
    pub version: u32,
    /// Version of stein that measured.
    pub stein: String,
    /// Start of the run, in UTC.
    pub date: String,
    /// The arguments after `stein bench`.
    pub arguments: Vec<String>,
    /// Adapter of the measurements.
    pub adapter: AdapterIdentity,
    /// Number of measured runs of each row; times are the median of these runs.
    pub repeats: u32,
    /// Ways to denoise that were measured.
    pub configurations: Vec<Configuration>,
    /// Sets that were measured, one for each size.
    pub sets: Vec<Set>,
    /// Measurements, one for each set and configuration.
    pub rows: Vec<Row>,
    /// Notes on what was left out, and why.
    pub notes: Vec<String>,
}

/// A way to denoise.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Configuration {
    /// Name that rows refer to.
    pub name: String,
    /// Name without the radius; configurations of a series share a line in plots.
    pub series: String,
    /// Parameters; `None` for another program.
    pub stein: Option<Parameters>,
    /// Command that was run; `None` for this program.
    pub command: Option<String>,
}

impl Configuration {
    /// Returns the radius of the window in pixels; `None` if there is no single window.
    pub fn window_radius(&self) -> Option<u32> {
        self.stein.as_ref().and_then(|parameters| parameters.window_radius)
    }
}

/// Parameters of a configuration.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Parameters {
    /// Name of the method.
    pub method: String,
    /// Name of the preset that the parameters are based on.
    pub preset: String,
    /// Radius of the window in pixels; `None` if the method has no single window.
    pub window_radius: Option<u32>,
    /// Whether the second pass runs; `None` if the method has none.
    pub second_pass: Option<bool>,
    /// Names of the candidates, joined by plus signs; `None` if the method has none.
    pub candidates: Option<String>,
    /// Whether steps that a frame does not need ran as well.
    #[serde(default)]
    pub everything: bool,
    /// Noise knowledge of the method: `given`, `halves` or `image`.
    #[serde(default = "given")]
    pub noise: String,
    /// All parameters of the method.
    pub all: Value,
}

/// Returns the noise knowledge of runs from before the option existed.
fn given() -> String {
    "given".into()
}

/// A buffer set at a size.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Set {
    /// Name that rows refer to.
    pub name: String,
    /// Name of the scene. Sets with the same reference are one scene.
    pub scene: String,
    /// File of the set.
    #[serde(serialize_with = "stein::text::serialize_path")]
    pub file: PathBuf,
    /// File of the reference; `None` without one.
    #[serde(serialize_with = "stein::text::serialize_path_or_none")]
    pub reference: Option<PathBuf>,
    /// Samples per pixel; their mean if pixels differ.
    pub samples_per_pixel: Option<f64>,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Whether the input was mirrored to this size, or cut off.
    pub is_resized: bool,
    /// Errors of the input as it is.
    pub noisy: Option<Errors>,
}

impl Set {
    /// Returns the number of pixels in millions.
    pub fn megapixels(&self) -> f64 {
        f64::from(self.width) * f64::from(self.height) * 1e-6
    }
}

/// Errors of an image against the reference.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Errors {
    /// Relative MSE; `None` here and below if the image is not finite.
    pub relative_mse: Option<f64>,
    /// Mean squared error, in the squared unit of the file.
    pub mse: Option<f64>,
    /// Structural similarity as displayed, at most 1.
    pub ssim: Option<f64>,
    /// Mean LDR-FLIP as displayed, from 0 to 1.
    pub flip: Option<f64>,
}

/// A set denoised in one way.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Name of the set.
    pub set: String,
    /// Name of the configuration.
    pub configuration: String,
    /// Time of the warm-up run, which compiles everything that no row before it has compiled and no cache holds.
    pub first_ms: f64,
    /// Time from the frame in memory to the result in memory; of another program, the time from its start to its end.
    pub wall_ms: f64,
    /// `wall_ms` for a million pixels.
    pub wall_ms_per_megapixel: f64,
    /// CPU time of all cores together, in the same runs. On a software adapter, other work on the machine disturbs this
    /// measure least. Unknown for another program.
    pub cpu_ms: Option<f64>,
    /// Sum of the stages' times; `None` if the adapter cannot time them.
    pub device_ms: Option<f64>,
    /// Times on the device; empty if the adapter cannot time stages.
    pub stages: Vec<Stage>,
    /// Largest size of all buffers together on the device.
    pub peak_bytes: Option<u64>,
    /// Number of strips in which the image was processed.
    pub strips: Option<usize>,
    /// Errors against the reference; `None` without one.
    pub errors: Option<Errors>,
    /// Mean squared error, estimated without the reference; for nlm, the variance alone.
    pub predicted_mse: Option<f64>,
    /// Whether no other row of the set is both as fast and as good.
    pub on_front: Option<bool>,
}

impl Row {
    /// Returns the relative MSE; `None` without a reference, or if the result is not finite.
    pub fn relative_mse(&self) -> Option<f64> {
        self.errors.and_then(|errors| errors.relative_mse)
    }

    /// Returns the MSE; `None` without a reference, or if the result is not finite.
    pub fn mse(&self) -> Option<f64> {
        self.errors.and_then(|errors| errors.mse)
    }
}

/// Time of a stage.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Stage {
    /// Name of the stage.
    pub stage: String,
    /// Median time in milliseconds.
    pub ms: f64,
    /// Number of dispatches in a run.
    pub dispatches: usize,
}

impl Document {
    /// Returns the rows of a set.
    pub fn rows_of<'a>(&'a self, set: &'a Set) -> impl Iterator<Item = &'a Row> {
        self.rows.iter().filter(move |row| row.set == set.name)
    }

    /// Returns the configuration of a row.
    pub fn configuration(&self, row: &Row) -> Option<&Configuration> {
        self.configurations.iter().find(|configuration| configuration.name == row.configuration)
    }

    /// Returns the set of a row.
    pub fn set(&self, row: &Row) -> Option<&Set> {
        self.sets.iter().find(|set| set.name == row.set)
    }
}

/// Marks the rows of a set for which no other row is both as fast and as good.
pub(crate) fn mark_front(rows: &mut [Row]) {
    let points: Vec<_> = rows.iter().map(|row| row.relative_mse().map(|error| (row.wall_ms, error))).collect();
    let known: Vec<_> = points.iter().flatten().copied().collect();
    let mut on_front = front(&known).into_iter();
    for (row, point) in rows.iter_mut().zip(points) {
        row.on_front = point.and_then(|_| on_front.next());
    }
}

/// Returns the names of all stages of these rows, in the order of first use.
pub fn stage_names<'a>(rows: impl Iterator<Item = &'a Row>) -> Vec<&'a str> {
    let mut names: Vec<&str> = Vec::new();
    for stage in rows.flat_map(|row| &row.stages) {
        if !names.contains(&stage.stage.as_str()) {
            names.push(&stage.stage);
        }
    }
    names
}
