//! How far a run is, for people or for a render farm.

use clap::ValueEnum;
use indicatif::ProgressBar;

use super::plan::PlannedFrame;
use crate::cli::Out;
use crate::cli::progress::{bar, is_watched};

/// A value of `--progress`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ProgressKind {
    /// A bar on standard error where that is a terminal
    Bar,
    /// Lines for Open Job Description on standard output, among the others: `openjd_progress: 42.0`, `openjd_status: …`, `openjd_fail: …`
    Openjd,
}

/// Over all frames that are denoised.
pub(super) enum Progress {
    /// Nobody wants to know. Telling makes the device wait, so it is not asked for.
    Silent,
    Bar {
        bar: ProgressBar,
        done: usize,
    },
    OpenJd {
        frames: usize,
        done: usize,
        last: String,
    },
}

impl Progress {
    pub(super) fn new(kind: Option<ProgressKind>, frames: usize) -> Self {
        match kind {
            Some(ProgressKind::Openjd) => Self::OpenJd { frames, done: 0, last: String::new() },
            Some(ProgressKind::Bar) if is_watched() => Self::Bar { bar: bar(true, 1000 * frames as u64), done: 0 },
            _ => Self::Silent,
        }
    }

    pub(super) fn is_wanted(&self) -> bool {
        !matches!(self, Self::Silent)
    }

    pub(super) fn begin(&self, frame: &PlannedFrame, out: &mut Out) {
        if let Self::OpenJd { frames, done, .. } = self {
            match frame.number {
                Some(number) => out.line(format_args!("openjd_status: frame {number}, {} of {frames}", done + 1)),
                None => out.line(format_args!("openjd_status: {}", frame.input.display())),
            }
        }
    }

    /// Of the frame that has begun.
    pub(super) fn share(&mut self, share: f32, out: &mut Out) {
        match self {
            Self::Silent => {}
            Self::Bar { bar, done } => bar.set_position(1000 * *done as u64 + (share * 1000.0) as u64),
            Self::OpenJd { frames, done, last } => {
                let line = format!("openjd_progress: {:.1}", 100.0 * (*done as f32 + share) / *frames as f32);
                if line != *last {
                    out.line(&line);
                    *last = line;
                }
            }
        }
    }

    /// Ends the frame.
    pub(super) fn end(&mut self, out: &mut Out) {
        self.share(1.0, out);
        match self {
            Self::Silent => {}
            Self::Bar { done, .. } | Self::OpenJd { done, .. } => *done += 1,
        }
    }

    /// Text for people, without the bar in its way.
    pub(super) fn say(&self, out: &mut Out, text: impl std::fmt::Display) {
        match self {
            Self::Bar { bar, .. } => bar.suspend(|| out.say(text)),
            _ => out.say(text),
        }
    }

    pub(super) fn finish(&self) {
        if let Self::Bar { bar, .. } = self {
            bar.finish_and_clear();
        }
    }
}
