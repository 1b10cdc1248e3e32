//! The report of `stein denoise`, as text and JSON.

use serde::Serialize;
use stein::gpu::{AdapterSummary, SavedPipelines, StageTime};
use stein::method::{Intermediate, SpikeReport};
use stein::text::{self, human_bytes, number};
use stein::{Estimate, Method};
use stein_exr::Written;

use super::Failure;
use super::explain::Explained;
use super::inspect::Input;
use super::out::{seconds, table};
use super::quality::{Errors, LayerErrors};

/// The JSON document of a single image.
#[derive(Debug, Serialize)]
pub(crate) struct Report<'a> {
    #[serde(flatten)]
    pub(crate) settings: &'a Settings,
    #[serde(flatten)]
    pub(crate) frame: &'a FrameReport,
}

/// Settings that all frames share.
#[derive(Debug, Serialize)]
pub(crate) struct Settings {
    pub(crate) preset: stein::Preset,
    pub(crate) parameters: Method,
    pub(crate) device: AdapterSummary,
    pub(crate) max_memory_bytes: Option<u64>,
    pub(crate) kept: Vec<&'static str>,
}

/// Report of one frame.
#[derive(Debug, Serialize)]
pub(crate) struct FrameReport {
    pub(crate) input: Input,
    /// The first picture of the frame.
    #[serde(flatten)]
    pub(crate) first: PictureReport,
    /// Other pictures, such as other view layers.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) further_pictures: Vec<PictureReport>,
    pub(crate) output: Option<Written>,
}

/// Report of one picture of a frame.
#[derive(Debug, Serialize)]
pub(crate) struct PictureReport {
    /// Layer of the colour, if the frame has several pictures.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) layer: Option<String>,
    /// Number of strips in which the image was (or, in a dry run, would be) processed.
    pub(crate) strips: usize,
    /// Plan, if `--explain` asks for it.
    pub(crate) plan: Option<Explained>,
    /// Figures of the run; `None` in a dry run.
    pub(crate) run: Option<Run>,
    /// Errors; `None` without a reference.
    pub(crate) errors: Option<Vec<Errors>>,
    /// Errors of the layers that are denoised along and that the reference has; `None` without a reference.
    pub(crate) errors_along: Option<Vec<LayerErrors>>,
}

/// Time, memory and other figures of the denoising.
#[derive(Debug, Serialize)]
pub(crate) struct Run {
    /// Wall-clock time in seconds, with the compilation of the shaders.
    pub(crate) seconds: f64,
    /// Report on spikes; `None` if the method did not look for any.
    pub(crate) spikes: Option<SpikeReport>,
    pub(crate) stage_times: Option<Vec<StageTime>>,
    pub(crate) peak_bytes: u64,
    /// Mean over the pixels of the estimated squared error, summed over the channels; `None` if it was not computed.
    pub(crate) mean_estimated_squared_error: Option<f64>,
    /// Mean over the pixels of the number of pixels that took part in the average.
    pub(crate) mean_weight_sum: f64,
}

impl Run {
    pub(crate) fn new(estimate: &Estimate, seconds: f64) -> Self {
        let mean = |image: &stein::Image| image.planes.first().map_or(f64::NAN, |plane| stein_metric::mean(plane));
        Self {
            seconds,
            spikes: estimate.spikes,
            stage_times: estimate.stage_times.clone(),
            peak_bytes: estimate.peak_bytes,
            mean_estimated_squared_error: estimate.error.as_ref().map(mean),
            mean_weight_sum: mean(&estimate.weight_sum),
        }
    }
}

pub(crate) fn names(keep: &[Intermediate]) -> Vec<&'static str> {
    keep.iter().map(|intermediate| intermediate.name()).collect()
}

impl FrameReport {
    /// Makes the report of a frame with these pictures, of which there is at least one.
    pub(crate) fn new(input: Input, pictures: Vec<PictureReport>, output: Option<Written>) -> Self {
        let mut pictures = pictures.into_iter();
        let Some(first) = pictures.next() else { unreachable!("a frame has a picture") };
        Self { input, first, further_pictures: pictures.collect(), output }
    }

    pub(crate) fn pictures(&self) -> impl Iterator<Item = &PictureReport> {
        std::iter::once(&self.first).chain(&self.further_pictures)
    }

    /// Formats the text after the description of the input, without the errors.
    pub(crate) fn text(&self, device: &AdapterSummary, verbose: bool) -> String {
        let mut lines = Vec::new();
        let most_strips = self.pictures().map(|picture| picture.strips).max().unwrap_or(1);
        let strips = if most_strips > 1 { format!(", in {most_strips} strips") } else { String::new() };
        let runs = || self.pictures().filter_map(|picture| picture.run.as_ref());
        if runs().next().is_none() {
            lines.push(format!("would work on {}{strips}; nothing is written", device.name));
        }
        if let Some(written) = &self.output {
            lines.extend(written.notes.iter().map(|note| format!("  {note}")));
            let time = runs().map(|run| run.seconds).sum();
            lines.push(format!("{}: {} on {}{strips}", text::path(&written.file), seconds(time), device.name));
            if !written.along.is_empty() {
                let along = written.along.iter().map(|name| text::name(name));
                lines.push(format!("  along: {}", text::list(along)));
            }
        }
        for picture in self.pictures() {
            lines.extend(picture.lines(verbose));
        }
        lines.join("\n")
    }
}

impl PictureReport {
    fn lines(&self, verbose: bool) -> Vec<String> {
        let mut lines = Vec::new();
        if let Some(run) = &self.run {
            // Without spikes there is no line, as for other repairs.
            lines.extend(run.spikes.filter(|spikes| verbose || spikes.pixels > 0).map(|spikes| format!("  {spikes}")));
            if verbose {
                let error = run.mean_estimated_squared_error;
                lines.push(format!(
                    "  {} on the device, {} pixels averaged per pixel{}",
                    human_bytes(run.peak_bytes),
                    number(run.mean_weight_sum),
                    error.map_or_else(String::new, |error| format!(
                        ", mean squared error estimated at {}",
                        number(error)
                    ))
                ));
                let times = run.stage_times.as_deref();
                lines.push(times.map_or_else(|| "  this adapter cannot time stages".into(), stage_table));
            }
        }
        lines.extend(self.plan.as_ref().map(Explained::text));
        if let Some(layer) = self.layer.as_ref().filter(|_| !lines.is_empty()) {
            lines.insert(0, format!("  {}:", picture_name(layer)));
        }
        lines
    }
}

/// Formats the name of a picture's layer.
pub(crate) fn picture_name(layer: &str) -> String {
    text::name(stein_exr::picture_name(layer)).into_owned()
}

/// Formats the location of the compiled shaders; `None` if they are not kept.
pub(crate) fn pipelines(saved: stein::Result<SavedPipelines>) -> Option<String> {
    match saved {
        Ok(SavedPipelines::Nowhere) => None,
        Ok(SavedPipelines::Unchanged { file, bytes: size }) => {
            Some(format!("  compiled shaders: {} in {}, as before", human_bytes(size), text::path(&file)))
        }
        Ok(SavedPipelines::Written { file, bytes: size }) => {
            Some(format!("  compiled shaders: {} written to {}", human_bytes(size), text::path(&file)))
        }
        Err(error) => Some(format!("  {}", Failure::from(error).message())),
    }
}

fn stage_table(times: &[StageTime]) -> String {
    let total: f64 = times.iter().map(|time| time.seconds).sum();
    let row = |name: &str, seconds: f64, dispatches: usize| {
        let share = 100.0 * seconds / total.max(f64::MIN_POSITIVE);
        vec![name.to_owned(), format!("{:.3}", seconds * 1e3), format!("{share:.0} %"), dispatches.to_string()]
    };
    let head = ["stage", "ms", "share", "dispatches"].map(String::from).to_vec();
    let sum = row("all", total, times.iter().map(|time| time.dispatches).sum());
    let rows: Vec<_> = std::iter::once(head)
        .chain(times.iter().map(|time| row(&time.stage, time.seconds, time.dispatches)))
        .chain(std::iter::once(sum))
        .collect();
    table(&rows, 1)
}
