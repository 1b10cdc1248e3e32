//! Progress of a run, for people or for a render farm.

use clap::ValueEnum;
use indicatif::ProgressBar;
use stein::text;

use super::plan::PlannedFrame;
use crate::Out;
use crate::progress::{bar, is_watched};

/// A value of `--progress`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ProgressKind {
    /// A bar on standard error where that is a terminal
    Bar,
    /// Lines for Open Job Description on standard output, among the others: `openjd_progress: 42.0`,
    /// `openjd_status: …`, `openjd_fail: …`
    Openjd,
}

/// Share of a frame's progress that is reported for writing its output: a frame that is denoised is not done yet.
const WRITING: f64 = 0.1;

/// Progress over all frames that are denoised.
pub(super) struct Progress {
    told: Told,
    frames: usize,
    /// Number of frames that the device is done with.
    denoised: usize,
    /// Finished share of the frame on the device, 0 to 1.
    share: f32,
    /// Number of frames whose outputs are complete.
    written: usize,
}

enum Told {
    /// Nobody watches. Reporting makes the device wait, so no progress is requested.
    Silent,
    Bar(ProgressBar),
    OpenJd {
        last: String,
    },
}

impl Progress {
    pub(super) fn new(kind: Option<ProgressKind>, frames: usize) -> Self {
        let told = match kind {
            Some(ProgressKind::Openjd) => Told::OpenJd { last: String::new() },
            Some(ProgressKind::Bar) if is_watched() => Told::Bar(bar(true, 1000 * frames as u64)),
            _ => Told::Silent,
        };
        Self { told, frames, denoised: 0, share: 0.0, written: 0 }
    }

    pub(super) fn is_wanted(&self) -> bool {
        !matches!(self.told, Told::Silent)
    }

    pub(super) fn begin(&self, frame: &PlannedFrame, out: &mut Out) {
        if let Told::OpenJd { .. } = self.told {
            match frame.number {
                Some(number) => {
                    out.line(format_args!("openjd_status: frame {number}, {} of {}", self.denoised + 1, self.frames));
                }
                None => out.line(format_args!("openjd_status: {}", text::path(&frame.input))),
            }
        }
    }

    /// Reports the finished share of the frame on the device.
    pub(super) fn share(&mut self, share: f32, out: &mut Out) {
        self.share = share;
        self.tell(out);
    }

    /// Counts the frame on the device as denoised.
    pub(super) fn denoised(&mut self, out: &mut Out) {
        self.denoised += 1;
        self.share = 0.0;
        self.tell(out);
    }

    /// Counts a frame that cannot be denoised as done.
    pub(super) fn left_out(&mut self, out: &mut Out) {
        self.denoised += 1;
        self.written(out);
    }

    /// Counts a frame as written.
    pub(super) fn written(&mut self, out: &mut Out) {
        self.written += 1;
        self.tell(out);
    }

    fn tell(&mut self, out: &mut Out) {
        let done = (1.0 - WRITING) * (self.denoised as f64 + f64::from(self.share)) + WRITING * self.written as f64;
        match &mut self.told {
            Told::Silent => {}
            Told::Bar(bar) => bar.set_position((1000.0 * done) as u64),
            Told::OpenJd { last } => {
                let line = format!("openjd_progress: {:.1}", 100.0 * done / self.frames as f64);
                if line != *last {
                    out.line(&line);
                    *last = line;
                }
            }
        }
    }

    /// Prints text for people, with the bar out of its way.
    pub(super) fn say(&self, out: &mut Out, text: impl std::fmt::Display) {
        match &self.told {
            Told::Bar(bar) => bar.suspend(|| out.say(text)),
            _ => out.say(text),
        }
    }

    pub(super) fn finish(&self) {
        if let Told::Bar(bar) = &self.told {
            bar.finish_and_clear();
        }
    }
}
