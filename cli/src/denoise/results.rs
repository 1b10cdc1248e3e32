//! Results of the frames, reported in their order as the writer finishes them.

use std::collections::VecDeque;
use std::ops::ControlFlow;

use stein::Error;
use stein::gpu::AdapterSummary;

use super::progress::Progress;
use super::shot::{self, Reported, ShotErrors};
use super::writer::{Denoised, Done, Writer};
use crate::report::picture_name;
use crate::{Failure, Out, quality};

pub(super) struct Results<'a> {
    pub(super) progress: Progress,
    writer: Writer<'a>,
    reports: Vec<Reported>,
    /// Number of frames that the writer was given.
    handed_over: usize,
    /// Messages about frames that cannot be denoised, each with the number of frames that the writer was given before.
    left_out: VecDeque<(usize, String)>,
    /// The first failure to write a frame.
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

    /// Hands a frame to the writer, which takes it once the frame before is written. Fails if a frame could not be
    /// written; [`Self::finish`] returns the reason.
    pub(super) fn hand_over(&mut self, denoised: Denoised, out: &mut Out) -> Result<(), Failure> {
        self.handed_over += 1;
        let is_taken = self.writer.hand_over(denoised);
        self.progress.denoised(out);
        if self.collect(out).is_break() || !is_taken { Err(Error::Cancelled.into()) } else { Ok(()) }
    }

    /// Reports the frames that were written meanwhile. Breaks after a failure, because further work would be useless.
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
        let mut text = text;
        for picture in report.pictures() {
            let Some(errors) = &picture.errors else { continue };
            let name = picture.layer.as_ref().map(|layer| picture_name(layer));
            text += &match (self.is_shot && !self.verbose, name) {
                (true, None) => format!(", {}", shot::brief(errors)),
                (true, Some(name)) => format!(", {name}: {}", shot::brief(errors)),
                (false, None) => format!("\n{}", quality::text(errors)),
                (false, Some(name)) => format!("\n  {name}:\n{}", quality::text(errors)),
            };
            let along = picture.errors_along.as_deref().filter(|along| !along.is_empty());
            if let Some(along) = along.filter(|_| !self.is_shot || self.verbose) {
                text += &format!("\n{}", quality::text_along(along));
            }
        }
        self.progress.say(out, text);
        self.progress.written(out);
        self.reports.push(reported);
        self.tell_left_out(self.reports.len(), out);
    }

    /// Reports a frame that cannot be denoised, after the frames before it.
    pub(super) fn leave_out(&mut self, failure: &Failure, out: &mut Out) {
        self.left_out.push_back((self.handed_over, format!("{}: not denoised", failure.cause())));
        self.tell_left_out(self.reports.len(), out);
        self.progress.left_out(out);
    }

    /// Prints the messages about frames that cannot be denoised and that come after at most `written` written frames.
    fn tell_left_out(&mut self, written: usize, out: &mut Out) {
        while let Some((_, text)) = self.left_out.pop_front_if(|(after, _)| *after <= written) {
            self.progress.say(out, text);
        }
    }

    /// Waits for the writer and returns all reports. A failure of the writer takes precedence over `ended`, the result
    /// of the work on the device, because the writer failed first.
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
