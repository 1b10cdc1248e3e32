//! The report of a shot as a whole.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;
use stein::image::Window;
use stein::text::number;
use stein::{Image, text};
use stein_metric as metric;

use super::plan::{Gap, PlannedFrame, ShotPlan, State};
use crate::Failure;
use crate::out::table;
use crate::quality::Errors;
use crate::report::{FrameReport, Settings};

/// The JSON document.
#[derive(Debug, Serialize)]
pub(super) struct ShotReport {
    /// Pattern of the input.
    #[serde(serialize_with = "text::serialize_path")]
    pub(super) input: PathBuf,
    pub(super) temporal_radius: u32,
    #[serde(flatten)]
    pub(super) settings: Settings,
    pub(super) frames: Vec<ShotFrame>,
    /// Missing frames between the frames that were found.
    pub(super) gaps: Vec<Gap>,
    /// Errors over the shot; `None` without references.
    pub(super) errors: Option<ShotErrors>,
}

#[derive(Debug, Serialize)]
pub(super) struct ShotFrame {
    frame: Option<u32>,
    #[serde(serialize_with = "text::serialize_path")]
    input_file: PathBuf,
    #[serde(serialize_with = "text::serialize_path")]
    output_file: PathBuf,
    /// Whether the frame is left alone because its output exists.
    is_left_alone: bool,
    /// Reason why the frame cannot be denoised.
    problem: Option<String>,
    #[serde(flatten)]
    beside: Beside,
    /// Report of a frame that was denoised, or would be.
    report: Option<FrameReport>,
}

/// The frames around one that is denoised.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct Beside {
    /// Numbers of the frames that it is denoised with, its own number among them.
    pub(super) window: Vec<u32>,
    /// Reasons why other frames, which exist, are not in `window`.
    pub(super) left_out: Vec<String>,
}

/// A frame that was denoised, or would be.
pub(super) struct Reported {
    pub(super) number: Option<u32>,
    pub(super) beside: Beside,
    pub(super) report: FrameReport,
}

/// Describes every frame of the plan, with its report or its problem if it has one.
pub(super) fn frames(plan: &ShotPlan, reports: Vec<Reported>, bad: &BadFrames) -> Vec<ShotFrame> {
    let mut reports: BTreeMap<Option<u32>, Reported> =
        reports.into_iter().map(|reported| (reported.number, reported)).collect();
    let planned = |frame: &PlannedFrame| {
        let window = plan.reads[frame.window.clone()].iter().filter_map(|read| read.number).collect();
        Beside { window, left_out: Vec::new() }
    };
    let describe = |frame: &PlannedFrame| {
        let reported = reports.remove(&frame.number);
        let (beside, report) =
            reported.map_or_else(|| (planned(frame), None), |reported| (reported.beside, Some(reported.report)));
        ShotFrame {
            frame: frame.number,
            input_file: frame.input.clone(),
            output_file: frame.output.clone(),
            is_left_alone: matches!(frame.state, State::LeftAlone),
            problem: bad.problem(frame.number),
            beside,
            report,
        }
    };
    plan.frames.iter().map(describe).collect()
}

/// Frames that cannot be denoised, by number.
pub(super) struct BadFrames {
    bad: BTreeMap<u32, Failure>,
    all: usize,
}

impl BadFrames {
    /// Returns the frames of which a file is missing.
    pub(super) fn missing(plan: &ShotPlan) -> Self {
        let missing = plan.frames.iter().filter_map(|frame| match &frame.state {
            State::Missing(failure) => Some((frame.number?, failure.clone())),
            State::ToDo | State::LeftAlone => None,
        });
        Self { bad: missing.collect(), all: plan.frames.len() }
    }

    pub(super) fn add(&mut self, number: u32, failure: Failure) {
        self.bad.insert(number, failure);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.bad.is_empty()
    }

    fn problem(&self, number: Option<u32>) -> Option<String> {
        self.bad.get(&number?).map(|failure| failure.message().to_owned())
    }

    /// Formats a line for each of the first bad frames.
    fn lines(&self) -> String {
        text::lines(self.bad.values().map(|failure| format!("  {}", failure.cause()))).join("\n")
    }

    /// Returns how the run ends after all other frames.
    pub(super) fn verdict(&self, dry_run: bool) -> Result<(), Failure> {
        let Some(only) = self.bad.values().next() else { return Ok(()) };
        let count = self.bad.len();
        let others = if dry_run || count == self.all { "" } else { ", the others are written" };
        let what = match (count, self.all) {
            (1, 1) => return Err(only.clone()),
            (1, all) => format!("1 of {all} frames cannot be denoised{others}\n  {}", only.message()),
            (count, all) => {
                let remedy = "put these frames right, then denoise them with --frames, or all that have no output with \
                              --no-clobber";
                format!("{count} of {all} frames cannot be denoised{others}\n{}\n  remedy: {remedy}", self.lines())
            }
        };
        Err(Failure::input(what))
    }

    /// Returns the failure that ended the run, followed by the bad frames before it.
    pub(super) fn before(&self, end: Failure) -> Failure {
        if self.is_empty() {
            end
        } else {
            end.and(&format!("  before that, frames could not be denoised:\n{}", self.lines()))
        }
    }
}

impl ShotReport {
    /// Formats the text after the single frames; `None` if there is none.
    pub(super) fn text(&self, dry_run: bool) -> Option<String> {
        let left_alone = self.frames.iter().filter(|frame| frame.is_left_alone).count();
        let mut lines = Vec::new();
        if dry_run {
            lines.extend(self.frames.iter().map(ShotFrame::text));
        } else if left_alone > 0 {
            lines.push(format!("  {left_alone} of {} frames had an output and are as they were", self.frames.len()));
        }
        if !self.gaps.is_empty() {
            lines.push(format!(
                "  missing between the frames that were found: {}",
                text::list(self.gaps.iter().map(Gap::to_string))
            ));
        }
        lines.extend(self.errors.as_ref().map(ShotErrors::text));
        (!lines.is_empty()).then(|| lines.join("\n"))
    }
}

impl ShotFrame {
    /// Formats what would be done with the frame.
    fn text(&self) -> String {
        let Self { frame, input_file, output_file, problem, .. } = self;
        let others: Vec<_> =
            self.beside.window.iter().filter(|&&other| Some(other) != *frame).map(u32::to_string).collect();
        let what = match (self.is_left_alone, others.is_empty()) {
            _ if problem.is_some() => ": cannot be denoised".to_owned(),
            (true, _) => " exists and is left alone".to_owned(),
            (false, true) => String::new(),
            (false, false) => format!(", with {}", text::list(others)),
        };
        format!("  {} -> {}{what}", text::path(input_file), text::path(output_file))
    }
}

/// Errors over all frames that were denoised and have a reference.
#[derive(Debug, Serialize)]
pub(super) struct ShotErrors {
    #[serde(flatten)]
    color: ErrorMeans,
    /// Errors of alpha; `None` without an alpha in frames and references.
    alpha: Option<ErrorMeans>,
}

/// Errors of one kind of image over the frames of a shot.
#[derive(Debug, Serialize)]
struct ErrorMeans {
    frames: usize,
    /// Number of pairs of frames with consecutive numbers. The flicker is the mean over these pairs.
    pairs: usize,
    images: [Means; 2],
}

#[derive(Debug, Serialize)]
struct Means {
    image: &'static str,
    mean_relative_mse: f64,
    /// Mean flicker; `None` without pairs.
    flicker: Option<f64>,
}

const IMAGES: [&str; 2] = ["noisy", "result"];

/// Gathers the errors of a shot, frame by frame.
#[derive(Default)]
pub(super) struct ShotErrorSums {
    color: ErrorSums,
    alpha: ErrorSums,
}

/// Sums of errors of one kind of image.
#[derive(Default)]
struct ErrorSums {
    frames: usize,
    pairs: usize,
    relative_mses: [f64; 2],
    flickers: [f64; 2],
    /// The frame before, for each picture.
    previous: BTreeMap<usize, (Place, Compared)>,
}

/// The place of a picture in a shot.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) number: u32,
    /// Index of the picture in its frame.
    pub(super) picture: usize,
    pub(super) data_window: Window,
}

/// Images with their reference.
pub(super) struct Compared {
    /// The noisy image and the result.
    pub(super) images: [Image; 2],
    pub(super) reference: Image,
}

impl ShotErrorSums {
    /// Adds the colour of a frame, and its alpha if there is one.
    pub(super) fn add(&mut self, place: Place, color: Compared, alpha: Option<Compared>) -> Result<(), Failure> {
        self.color.add(place, color)?;
        alpha.map_or(Ok(()), |alpha| self.alpha.add(place, alpha))
    }

    pub(super) fn finish(self) -> Option<ShotErrors> {
        Some(ShotErrors { color: self.color.finish()?, alpha: self.alpha.finish() })
    }
}

impl ErrorSums {
    fn add(&mut self, place: Place, compared: Compared) -> Result<(), Failure> {
        self.frames += 1;
        for (sum, image) in self.relative_mses.iter_mut().zip(&compared.images) {
            *sum += metric::relative_mse(image, &compared.reference)?;
        }
        // Frames that show different pixels cannot be subtracted.
        let is_pair = |(previous, _): &&(Place, Compared)| {
            previous.number + 1 == place.number && previous.data_window == place.data_window
        };
        if let Some((_, previous)) = self.previous.get(&place.picture).filter(is_pair) {
            self.pairs += 1;
            for (sum, (before, image)) in self.flickers.iter_mut().zip(previous.images.iter().zip(&compared.images)) {
                *sum += metric::flicker([before, image], [&previous.reference, &compared.reference])?;
            }
        }
        self.previous.insert(place.picture, (place, compared));
        Ok(())
    }

    /// Returns the means; `None` without frames.
    fn finish(self) -> Option<ErrorMeans> {
        let Self { frames, pairs, relative_mses, flickers, .. } = self;
        let means = |index: usize| Means {
            image: IMAGES[index],
            mean_relative_mse: relative_mses[index] / frames as f64,
            flicker: (pairs > 0).then(|| flickers[index] / pairs as f64),
        };
        (frames > 0).then(|| ErrorMeans { frames, pairs, images: [means(0), means(1)] })
    }
}

impl ShotErrors {
    pub(super) fn text(&self) -> String {
        let frames = |count: usize, what: &str| format!("{count} {what}{}", if count == 1 { "" } else { "s" });
        let head = vec![
            frames(self.color.frames, "frame"),
            "mean relative MSE".into(),
            format!("flicker ({})", frames(self.color.pairs, "pair")),
        ];
        let row = |of: &str, means: &Means| {
            vec![
                format!("{of}{}", means.image),
                number(means.mean_relative_mse),
                means.flicker.map_or_else(|| "-".to_owned(), number),
            ]
        };
        let color = self.color.images.iter().map(|means| row("", means));
        let alpha = self.alpha.iter().flat_map(|alpha| &alpha.images).map(|means| row("alpha, ", means));
        let rows: Vec<_> = std::iter::once(head).chain(color).chain(alpha).collect();
        format!(
            "{}\n  (flicker: mean over consecutive frames of (error − error of the frame before)²/(mean reference² of \
             both + {}))",
            table(&rows, 1),
            metric::RELATIVE_EPSILON
        )
    }
}

/// Formats a frame's errors in few words.
pub(super) fn brief(errors: &[Errors]) -> String {
    let of = |name: &str| {
        errors
            .iter()
            .find(|errors| errors.image == name)
            .map_or_else(|| "-".to_owned(), |errors| number(errors.relative_mse))
    };
    format!("relative MSE {} -> {}", of(IMAGES[0]), of(IMAGES[1]))
}
