//! How far a run is, for people or for a render farm.

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

/// How much of a frame's work it is to write it, as far as it is told of: a frame that is denoised is not done.
const WRITING: f64 = 0.1;

/// Over all frames that are denoised.
pub(super) struct Progress {
    told: Told,
    frames: usize,
    /// Frames that the device is done with.
    denoised: usize,
    /// Of the frame on the device.
    share: f32,
    /// Frames whose outputs lie in their places.
    written: usize,
}

enum Told {
    /// Nobody wants to know. Telling makes the device wait, so it is not asked for.
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

    /// Of the frame that has begun.
    pub(super) fn share(&mut self, share: f32, out: &mut Out) {
        self.share = share;
        self.tell(out);
    }

    /// Ends the frame on the device.
    pub(super) fn denoised(&mut self, out: &mut Out) {
        self.denoised += 1;
        self.share = 0.0;
        self.tell(out);
    }

    /// Ends a frame that cannot be denoised.
    pub(super) fn left_out(&mut self, out: &mut Out) {
        self.denoised += 1;
        self.written(out);
    }

    /// Ends the frame.
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

    /// Text for people, without the bar in its way.
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
