//! What there is to say of a shot as a whole.

use std::path::PathBuf;

use serde::Serialize;
use stein::image::Window;
use stein::{Image, metric};

use super::plan::{Plan, PlannedFrame};
use crate::cli::Failure;
use crate::cli::out::{number, table};
use crate::cli::quality::Errors;
use crate::cli::report::{FrameReport, Settings};

/// The JSON document.
#[derive(Debug, Serialize)]
pub(super) struct ShotReport {
    /// The pattern.
    pub(super) input: PathBuf,
    pub(super) temporal_radius: u32,
    #[serde(flatten)]
    pub(super) settings: Settings,
    pub(super) frames: Vec<ShotFrame>,
    /// Where references were given.
    pub(super) errors: Option<ShotErrors>,
}

#[derive(Debug, Serialize)]
pub(super) struct ShotFrame {
    frame: Option<u32>,
    input_file: PathBuf,
    output_file: PathBuf,
    /// Because its output exists.
    is_left_alone: bool,
    /// The frames that it is denoised with, itself among them.
    window: Vec<u32>,
    /// Of a frame that was denoised.
    report: Option<FrameReport>,
}

/// Every frame of the plan with its report, where it has one.
pub(super) fn frames(plan: &Plan, reports: Vec<FrameReport>) -> Vec<ShotFrame> {
    let mut reports = reports.into_iter();
    let describe = |frame: &PlannedFrame| ShotFrame {
        frame: frame.number,
        input_file: frame.input.clone(),
        output_file: frame.output.clone(),
        is_left_alone: frame.is_left_alone(),
        window: plan.reads[frame.window.clone()].iter().filter_map(|read| read.number).collect(),
        report: if frame.is_left_alone() { None } else { reports.next() },
    };
    plan.frames.iter().map(describe).collect()
}

impl ShotReport {
    /// What follows the single frames.
    pub(super) fn text(&self, dry_run: bool) -> Option<String> {
        let left_alone = self.frames.iter().filter(|frame| frame.is_left_alone).count();
        let mut lines = Vec::new();
        if dry_run {
            lines.extend(self.frames.iter().map(ShotFrame::text));
        } else if left_alone > 0 {
            lines.push(format!("  {left_alone} of {} frames had an output and are as they were", self.frames.len()));
        }
        lines.extend(self.errors.as_ref().map(ShotErrors::text));
        (!lines.is_empty()).then(|| lines.join("\n"))
    }
}

impl ShotFrame {
    /// What would be done.
    fn text(&self) -> String {
        let Self { frame, input_file, output_file, window, .. } = self;
        let others: Vec<_> = window.iter().filter(|&&other| Some(other) != *frame).map(u32::to_string).collect();
        let what = match (self.is_left_alone, others.is_empty()) {
            (true, _) => " exists and is left alone".to_owned(),
            (false, true) => String::new(),
            (false, false) => format!(", with {}", others.join(", ")),
        };
        format!("  {} -> {}{what}", input_file.display(), output_file.display())
    }
}

/// Of all frames that were denoised and have a reference.
#[derive(Debug, Serialize)]
pub(super) struct ShotErrors {
    frames: usize,
    /// Pairs of frames with consecutive numbers, of which the flicker is the mean.
    pairs: usize,
    images: [Means; 2],
}

#[derive(Debug, Serialize)]
struct Means {
    image: &'static str,
    mean_relative_mse: f64,
    /// `None` without pairs.
    flicker: Option<f64>,
}

const IMAGES: [&str; 2] = ["noisy", "result"];

/// Gathers the errors of a shot, frame by frame.
#[derive(Default)]
pub(super) struct Comparison {
    frames: usize,
    pairs: usize,
    relative_mses: [f64; 2],
    flickers: [f64; 2],
    previous: Option<Compared>,
}

/// A frame with its reference.
pub(super) struct Compared {
    pub(super) number: u32,
    pub(super) data_window: Window,
    /// Noisy and result.
    pub(super) images: [Image; 2],
    pub(super) reference: Image,
}

impl Comparison {
    pub(super) fn add(&mut self, compared: Compared, errors: &[Errors]) -> Result<(), Failure> {
        self.frames += 1;
        for (sum, name) in self.relative_mses.iter_mut().zip(IMAGES) {
            *sum += errors.iter().filter(|errors| errors.image == name).map(|errors| errors.relative_mse).sum::<f64>();
        }
        // Frames that show different pixels cannot be subtracted.
        let is_pair = |previous: &&Compared| previous.number + 1 == compared.number && previous.data_window == compared.data_window;
        if let Some(previous) = self.previous.as_ref().filter(is_pair) {
            self.pairs += 1;
            for (sum, (before, image)) in self.flickers.iter_mut().zip(previous.images.iter().zip(&compared.images)) {
                *sum += metric::flicker([before, image], [&previous.reference, &compared.reference])?;
            }
        }
        self.previous = Some(compared);
        Ok(())
    }

    pub(super) fn finish(self) -> Option<ShotErrors> {
        let Self { frames, pairs, relative_mses, flickers, .. } = self;
        let means = |index: usize| Means {
            image: IMAGES[index],
            mean_relative_mse: relative_mses[index] / frames as f64,
            flicker: (pairs > 0).then(|| flickers[index] / pairs as f64),
        };
        (frames > 0).then(|| ShotErrors { frames, pairs, images: [means(0), means(1)] })
    }
}

impl ShotErrors {
    pub(super) fn text(&self) -> String {
        let frames = |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
        let head = vec![frames(self.frames, "frame"), "mean relative MSE".into(), format!("flicker ({})", frames(self.pairs, "pair"))];
        let row = |means: &Means| vec![means.image.to_owned(), number(means.mean_relative_mse), means.flicker.map_or_else(|| "-".to_owned(), number)];
        let rows: Vec<_> = std::iter::once(head).chain(self.images.iter().map(row)).collect();
        format!(
            "{}\n  (flicker: mean over consecutive frames of (error − error of the frame before)²/(mean reference² of both + {}))",
            table(&rows, 1),
            metric::RELATIVE_EPSILON
        )
    }
}

/// A frame's errors in few words.
pub(super) fn brief(errors: &[Errors]) -> String {
    let of = |name: &str| errors.iter().find(|errors| errors.image == name).map_or_else(|| "-".to_owned(), |errors| number(errors.relative_mse));
    format!("relative MSE {} -> {}", of(IMAGES[0]), of(IMAGES[1]))
}
