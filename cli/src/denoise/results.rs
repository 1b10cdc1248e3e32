//! What becomes of the frames, told in their order as the writer is done with them.

use std::collections::VecDeque;
use std::ops::ControlFlow;

use stein::Error;
use stein::gpu::AdapterSummary;

use super::progress::Progress;
use super::shot::{self, Reported, ShotErrors};
use super::writer::{Denoised, Done, Writer};
use crate::{Failure, Out, quality};

pub(super) struct Results<'a> {
    pub(super) progress: Progress,
    writer: Writer<'a>,
    reports: Vec<Reported>,
    /// Frames that the writer was given.
    handed_over: usize,
    /// What to say of frames that cannot be denoised, each after so many of those that the writer was given.
    left_out: VecDeque<(usize, String)>,
    /// Why a frame could not be written.
    failure: Option<Failure>,
    device: &'a AdapterSummary,
    verbose: bool,
    is_shot: bool,
}

impl<'a> Results<'a> {
    pub(super) fn new(
        writer: Writer<'a>,
        progress: Progress,
        device: &'a AdapterSummary,
        verbose: bool,
        is_shot: bool,
    ) -> Self {
        let (reports, left_out) = (Vec::new(), VecDeque::new());
        Self { progress, writer, reports, handed_over: 0, left_out, failure: None, device, verbose, is_shot }
    }

    /// Waits until the frame before is written. Fails where that could not be, of which [`Self::finish`] tells.
    pub(super) fn hand_over(&mut self, denoised: Denoised, out: &mut Out) -> Result<(), Failure> {
        self.handed_over += 1;
        let is_taken = self.writer.hand_over(denoised);
        self.progress.denoised(out);
        if self.collect(out).is_break() || !is_taken { Err(Error::Cancelled.into()) } else { Ok(()) }
    }

    /// Tells of what was written meanwhile. Nothing is worth going on with after a failure.
    pub(super) fn collect(&mut self, out: &mut Out) -> ControlFlow<()> {
        while let Some(done) = self.writer.done() {
            self.add(done, out);
        }
        if self.failure.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    pub(super) fn add(&mut self, done: Result<Done, Failure>, out: &mut Out) {
        let Done { introduction, reported } = match done {
            Ok(done) => done,
            Err(failure) => {
                self.failure.get_or_insert(failure);
                return;
            }
        };
        if let Some(introduction) = introduction {
            self.progress.say(out, introduction);
        }
        let report = &reported.report;
        for left_out in &reported.beside.left_out {
            self.progress.say(out, format_args!("  {left_out}"));
        }
        let text = report.text(self.device, self.verbose);
        let text = match &report.errors {
            None => text,
            Some(errors) if self.is_shot && !self.verbose => format!("{text}, {}", shot::brief(errors)),
            Some(errors) => format!("{text}\n{}", quality::text(errors)),
        };
        self.progress.say(out, text);
        self.progress.written(out);
        self.reports.push(reported);
        self.tell_left_out(self.reports.len(), out);
    }

    /// Tells of a frame that cannot be denoised, after those before it.
    pub(super) fn leave_out(&mut self, failure: &Failure, out: &mut Out) {
        self.left_out.push_back((self.handed_over, format!("{}: not denoised", failure.cause())));
        self.tell_left_out(self.reports.len(), out);
        self.progress.left_out(out);
    }

    /// Tells of the frames that come next after so many that are written.
    fn tell_left_out(&mut self, written: usize, out: &mut Out) {
        while let Some((_, text)) = self.left_out.pop_front_if(|(after, _)| *after <= written) {
            self.progress.say(out, text);
        }
    }

    /// Waits for the writer. What it failed in came before what `ended` the work on the device.
    pub(super) fn finish(
        mut self,
        ended: Result<(), Failure>,
        out: &mut Out,
    ) -> Result<(Vec<Reported>, Option<ShotErrors>), Failure> {
        while let Some(done) = self.writer.rest() {
            self.add(done, out);
        }
        self.tell_left_out(usize::MAX, out);
        self.progress.finish();
        let Self { writer, reports, failure, .. } = self;
        failure.map_or(ended, Err)?;
        Ok((reports, writer.comparison().finish()))
    }
}
