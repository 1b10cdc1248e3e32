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
use super::quality::Errors;

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

/// Report of one image.
#[derive(Debug, Serialize)]
pub(crate) struct FrameReport {
    pub(crate) input: Input,
    /// Number of strips in which the image was (or, in a dry run, would be) processed.
    pub(crate) strips: usize,
    /// Plan, if `--explain` asks for it.
    pub(crate) plan: Option<Explained>,
    /// Figures of the run; `None` in a dry run.
    pub(crate) run: Option<Run>,
    pub(crate) output: Option<Written>,
    /// Errors; `None` without a reference.
    pub(crate) errors: Option<Vec<Errors>>,
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
    /// Formats the text after the description of the input, without the errors.
    pub(crate) fn text(&self, device: &AdapterSummary, verbose: bool) -> String {
        let mut lines = Vec::new();
        let strips = if self.strips > 1 { format!(", in {} strips", self.strips) } else { String::new() };
        match &self.run {
            None => lines.push(format!("would work on {}{strips}; nothing is written", device.name)),
            Some(run) => {
                if let Some(written) = &self.output {
                    lines.extend(written.notes.iter().map(|note| format!("  {note}")));
                    lines.push(format!(
                        "{}: {} on {}{strips}",
                        text::path(&written.file),
                        seconds(run.seconds),
                        device.name
                    ));
                }
                // Without spikes there is no line, as for other repairs.
                lines.extend(
                    run.spikes.filter(|spikes| verbose || spikes.pixels > 0).map(|spikes| format!("  {spikes}")),
                );
                if verbose {
                    lines.push(format!(
                        "  {} on the device, {} pixels averaged per pixel{}",
                        human_bytes(run.peak_bytes),
                        number(run.mean_weight_sum),
                        run.mean_estimated_squared_error.map_or_else(String::new, |error| format!(
                            ", mean squared error estimated at {}",
                            number(error)
                        ))
                    ));
                    lines.push(
                        run.stage_times
                            .as_deref()
                            .map_or_else(|| "  this adapter cannot time stages".into(), stage_table),
                    );
                }
            }
        }
        lines.extend(self.plan.as_ref().map(Explained::text));
        lines.join("\n")
    }
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
