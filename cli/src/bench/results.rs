//! The document of a report: everything that was measured.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use stein::gpu::AdapterSummary;

use super::statistics::front;

/// Schema name that identifies our documents.
pub(super) const SCHEMA: &str = "stein.bench";

/// Raised when a field changes its meaning or goes away; new fields alone do not raise it.
pub(super) const VERSION: u32 = 2;

/// `results.json`. Times are in milliseconds, memory in bytes, errors without a unit or in the squared unit of the
/// file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Document {
    /// [`SCHEMA`]
    pub(super) schema: String,
    /// [`VERSION`]
    pub(super) version: u32,
    /// Version of stein that measured.
    pub(super) stein: String,
    /// Start of the run, in UTC.
    pub(super) date: String,
    /// The arguments after `stein bench`.
    pub(super) arguments: Vec<String>,
    pub(super) adapter: Adapter,
    /// Number of measured runs of each row; times are the median of these runs.
    pub(super) repeats: u32,
    pub(super) configurations: Vec<Configuration>,
    pub(super) sets: Vec<Set>,
    pub(super) rows: Vec<Row>,
    /// Notes on what was left out, and why.
    pub(super) notes: Vec<String>,
}

/// Adapter of the measurements.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Adapter {
    pub(super) name: String,
    /// The interface: Vulkan, Metal or DX12.
    pub(super) backend: String,
    /// discrete, integrated, virtual, software or other.
    pub(super) kind: String,
    /// Driver and its version.
    pub(super) driver: String,
    /// Whether stages can be timed.
    pub(super) timestamps: bool,
}

impl From<&AdapterSummary> for Adapter {
    fn from(summary: &AdapterSummary) -> Self {
        let AdapterSummary { name, backend, kind, driver, timestamps, .. } = summary;
        Self {
            name: name.clone(),
            backend: backend.clone(),
            kind: kind.to_string(),
            driver: driver.clone(),
            timestamps: *timestamps,
        }
    }
}

impl std::fmt::Display for Adapter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} ({}, {}, {})", self.name, self.backend, self.kind, self.driver)
    }
}

/// A way to denoise.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Configuration {
    /// Name that rows refer to.
    pub(super) name: String,
    /// Name without the radius; configurations of a series share a line in plots.
    pub(super) series: String,
    /// Parameters; `None` for another program.
    pub(super) stein: Option<Parameters>,
    /// Command that was run; `None` for this program.
    pub(super) command: Option<String>,
}

impl Configuration {
    pub(super) fn window_radius(&self) -> Option<u32> {
        self.stein.as_ref().and_then(|parameters| parameters.window_radius)
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Parameters {
    pub(super) method: String,
    pub(super) preset: String,
    /// Radius of the window in pixels; `None` if the method has no single window.
    pub(super) window_radius: Option<u32>,
    /// Whether the second pass runs; `None` if the method has none.
    pub(super) second_pass: Option<bool>,
    /// Names of the candidates, joined by plus signs; `None` if the method has none.
    pub(super) candidates: Option<String>,
    /// Whether steps that a frame does not need ran as well.
    #[serde(default)]
    pub(super) everything: bool,
    /// Noise knowledge of the method: `given`, `halves` or `image`.
    #[serde(default = "given")]
    pub(super) noise: String,
    /// All parameters of the method.
    pub(super) all: Value,
}

/// Returns the noise knowledge of runs from before the option existed.
fn given() -> String {
    "given".into()
}

/// A buffer set at a size.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Set {
    /// Name that rows refer to.
    pub(super) name: String,
    /// Name of the scene. Sets with the same reference are one scene.
    pub(super) scene: String,
    #[serde(serialize_with = "stein::text::serialize_path")]
    pub(super) file: PathBuf,
    #[serde(serialize_with = "stein::text::serialize_path_or_none")]
    pub(super) reference: Option<PathBuf>,
    /// Samples per pixel; their mean if pixels differ.
    pub(super) samples_per_pixel: Option<f64>,
    pub(super) width: u32,
    pub(super) height: u32,
    /// Whether the input was mirrored to this size, or cut off.
    pub(super) is_resized: bool,
    /// Errors of the input as it is.
    pub(super) noisy: Option<Errors>,
}

impl Set {
    pub(super) fn megapixels(&self) -> f64 {
        f64::from(self.width) * f64::from(self.height) * 1e-6
    }
}

/// Errors of an image against the reference.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Errors {
    /// Relative MSE; `None` here and below if the image is not finite.
    pub(super) relative_mse: Option<f64>,
    pub(super) mse: Option<f64>,
    pub(super) ssim: Option<f64>,
    pub(super) flip: Option<f64>,
}

/// A set denoised in one way.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Row {
    /// Name of the set.
    pub(super) set: String,
    /// Name of the configuration.
    pub(super) configuration: String,
    /// Time of the warm-up run, which compiles everything that no row before it has compiled and no cache holds.
    pub(super) first_ms: f64,
    /// Time from the frame in memory to the result in memory; of another program, the time from its start to its end.
    pub(super) wall_ms: f64,
    pub(super) wall_ms_per_megapixel: f64,
    /// CPU time of all cores together, in the same runs. On a software adapter, other work on the machine disturbs this
    /// measure least. Unknown for another program.
    pub(super) cpu_ms: Option<f64>,
    /// Sum of the stages' times; `None` if the adapter cannot time them.
    pub(super) device_ms: Option<f64>,
    pub(super) stages: Vec<Stage>,
    /// Largest size of all buffers together on the device.
    pub(super) peak_bytes: Option<u64>,
    /// Number of strips in which the image was processed.
    pub(super) strips: Option<usize>,
    pub(super) errors: Option<Errors>,
    /// Mean squared error, estimated without the reference; for nlm, the variance alone.
    pub(super) predicted_mse: Option<f64>,
    /// Whether no other row of the set is both as fast and as good.
    pub(super) on_front: Option<bool>,
}

impl Row {
    pub(super) fn relative_mse(&self) -> Option<f64> {
        self.errors.and_then(|errors| errors.relative_mse)
    }

    pub(super) fn mse(&self) -> Option<f64> {
        self.errors.and_then(|errors| errors.mse)
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Stage {
    pub(super) stage: String,
    pub(super) ms: f64,
    pub(super) dispatches: usize,
}

impl Document {
    pub(super) fn rows_of<'a>(&'a self, set: &'a Set) -> impl Iterator<Item = &'a Row> {
        self.rows.iter().filter(move |row| row.set == set.name)
    }

    pub(super) fn configuration(&self, row: &Row) -> Option<&Configuration> {
        self.configurations.iter().find(|configuration| configuration.name == row.configuration)
    }

    pub(super) fn set(&self, row: &Row) -> Option<&Set> {
        self.sets.iter().find(|set| set.name == row.set)
    }
}

/// Marks the rows of a set for which no other row is both as fast and as good.
pub(super) fn mark_front(rows: &mut [Row]) {
    let points: Vec<_> = rows.iter().map(|row| row.relative_mse().map(|error| (row.wall_ms, error))).collect();
    let known: Vec<_> = points.iter().flatten().copied().collect();
    let mut on_front = front(&known).into_iter();
    for (row, point) in rows.iter_mut().zip(points) {
        row.on_front = point.and_then(|_| on_front.next());
    }
}

/// Returns the names of all stages of these rows, in the order of first use.
pub(super) fn stage_names<'a>(rows: impl Iterator<Item = &'a Row>) -> Vec<&'a str> {
    let mut names: Vec<&str> = Vec::new();
    for stage in rows.flat_map(|row| &row.stages) {
        if !names.contains(&stage.stage.as_str()) {
            names.push(&stage.stage);
        }
    }
    names
}
