//! What was measured: the document of a report.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use stein::gpu::AdapterSummary;

use super::statistics::front;

/// What tells a document of ours from others.
pub(super) const SCHEMA: &str = "stein.bench";

/// Raised when a field changes its meaning or goes away; new fields alone do not raise it.
pub(super) const VERSION: u32 = 2;

/// `results.json`. Times are in milliseconds, memory in bytes, errors without a unit or in squares of the file's.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Document {
    /// [`SCHEMA`]
    pub(super) schema: String,
    /// [`VERSION`]
    pub(super) version: u32,
    /// The version of stein that measured.
    pub(super) stein: String,
    /// When it began, in UTC.
    pub(super) date: String,
    /// The arguments after `stein bench`.
    pub(super) arguments: Vec<String>,
    pub(super) adapter: Adapter,
    /// Measured runs of each row, of which times are the median.
    pub(super) repeats: u32,
    pub(super) configurations: Vec<Configuration>,
    pub(super) sets: Vec<Set>,
    pub(super) rows: Vec<Row>,
    /// What was left out, and why.
    pub(super) notes: Vec<String>,
}

/// What it was measured on.
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
    /// What rows refer to.
    pub(super) name: String,
    /// The name without the radius: what is one line in a plot.
    pub(super) series: String,
    /// Of this program.
    pub(super) stein: Option<Parameters>,
    /// Of another one: what was run.
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
    /// In pixels, where the method has one window.
    pub(super) window_radius: Option<u32>,
    /// Where the method has one.
    pub(super) second_pass: Option<bool>,
    /// Names joined by plus signs, where the method has them.
    pub(super) candidates: Option<String>,
    /// Whether what a frame does not need ran as well.
    #[serde(default)]
    pub(super) everything: bool,
    /// What the method was told of the noise: `given`, `halves` or `image`.
    #[serde(default = "given")]
    pub(super) noise: String,
    /// All of them.
    pub(super) all: Value,
}

/// What runs were told of the noise before there was a choice.
fn given() -> String {
    "given".into()
}

/// A buffer set at a size.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Set {
    /// What rows refer to.
    pub(super) name: String,
    /// Sets with the same reference are one scene.
    pub(super) scene: String,
    #[serde(serialize_with = "stein::text::serialize_path")]
    pub(super) file: PathBuf,
    #[serde(serialize_with = "stein::text::serialize_path_or_none")]
    pub(super) reference: Option<PathBuf>,
    /// The mean, where they differ from pixel to pixel.
    pub(super) samples_per_pixel: Option<f64>,
    pub(super) width: u32,
    pub(super) height: u32,
    /// Mirrored to this size, or cut off.
    pub(super) is_resized: bool,
    /// Of the input as it is.
    pub(super) noisy: Option<Errors>,
}

impl Set {
    pub(super) fn megapixels(&self) -> f64 {
        f64::from(self.width) * f64::from(self.height) * 1e-6
    }
}

/// Against the reference.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Errors {
    /// `None` here and below where the image is not finite.
    pub(super) relative_mse: Option<f64>,
    pub(super) mse: Option<f64>,
    pub(super) ssim: Option<f64>,
    pub(super) flip: Option<f64>,
}

/// A set denoised in one way.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Row {
    /// A set's name.
    pub(super) set: String,
    /// A configuration's name.
    pub(super) configuration: String,
    /// Of the warm-up run, which compiles what no row before it has compiled and no cache holds.
    pub(super) first_ms: f64,
    /// From the frame in memory to the result in memory; of another program from its start to its end.
    pub(super) wall_ms: f64,
    pub(super) wall_ms_per_megapixel: f64,
    /// Of all cores together, in the same runs. On a software adapter it is the measure that other work on the machine
    /// disturbs least; of another program it is not known.
    pub(super) cpu_ms: Option<f64>,
    /// Sum of the stages, where the adapter can time them.
    pub(super) device_ms: Option<f64>,
    pub(super) stages: Vec<Stage>,
    /// The most that buffers took on the device.
    pub(super) peak_bytes: Option<u64>,
    /// Parts that the image was worked on in.
    pub(super) strips: Option<usize>,
    pub(super) errors: Option<Errors>,
    /// The mean squared error as estimated without the reference; of nlm the variance alone.
    pub(super) predicted_mse: Option<f64>,
    /// No other row of the set is both as fast and as good.
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

/// Marks the rows of a set of which no other is both as fast and as good.
pub(super) fn mark_front(rows: &mut [Row]) {
    let points: Vec<_> = rows.iter().map(|row| row.relative_mse().map(|error| (row.wall_ms, error))).collect();
    let known: Vec<_> = points.iter().flatten().copied().collect();
    let mut on_front = front(&known).into_iter();
    for (row, point) in rows.iter_mut().zip(points) {
        row.on_front = point.and_then(|_| on_front.next());
    }
}

/// The names of all stages of these rows, in the order of first use.
pub(super) fn stage_names<'a>(rows: impl Iterator<Item = &'a Row>) -> Vec<&'a str> {
    let mut names: Vec<&str> = Vec::new();
    for stage in rows.flat_map(|row| &row.stages) {
        if !names.contains(&stage.stage.as_str()) {
            names.push(&stage.stage);
        }
    }
    names
}
