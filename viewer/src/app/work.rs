//! Work that the window sends to its worker, and that it cancels.

use std::path::PathBuf;

use eframe::egui::{Context, ViewportCommand};
use stein::Extent;

use super::{Viewer, title};
use crate::document::{Opening, Source};
use crate::inspector::Question;
use crate::panel::Panel;
use crate::settings::Parameters;
use crate::view::View;
use crate::worker::{Request, Task};

impl Viewer {
    /// Reads a frame; what is open stays until that is done.
    pub fn open(&mut self, source: Source) {
        self.read(Opening::Frame(Box::new(source)));
    }

    /// Reads files that came together; what is open stays until that is done.
    pub fn open_together(&mut self, files: Vec<PathBuf>, reference: Option<PathBuf>) {
        match <[PathBuf; 1]>::try_from(files) {
            Ok([input]) => self.open(Source::whole(input, reference)),
            Err(files) if files.is_empty() => {}
            Err(files) => self.read(Opening::Together { files, reference, samples: None }),
        }
    }

    /// Opens the files again that could not be opened without the number of samples per pixel.
    pub(super) fn open_with_samples(&mut self, samples: u32) {
        if let Some(opening) = self.opening.take() {
            self.trouble.take_if(|(task, _)| *task == Task::Open);
            self.read(opening.with_samples(samples));
        }
    }

    /// Opens another picture of the input, by its index.
    pub(super) fn show_picture(&mut self, index: usize) {
        let opened = self.document.as_ref().map(|document| &document.opened);
        let is_open = opened.and_then(|opened| opened.input.as_ref()).is_some_and(|input| input.picture == index);
        if let Some(source) = opened.and_then(|opened| opened.picture(index)).filter(|_| !is_open) {
            self.open(source);
        }
    }

    /// Opens the picture that is `step` places further in the input, from the last one on to the first.
    pub(super) fn step_picture(&mut self, step: isize) {
        let opened = self.document.as_ref().map(|document| &document.opened);
        let Some(input) = opened.and_then(|opened| opened.input.as_ref()) else { return };
        let index = input.picture as isize + step;
        self.show_picture(index.rem_euclid(input.pictures.len() as isize) as usize);
    }

    fn read(&mut self, opening: Opening) {
        self.interrupted |= matches!(self.progress, Some((Task::Denoise, _)));
        self.adaptive.is_running = false;
        self.progress = Some((Task::Open, 0.0));
        self.sweep.is_running = false;
        self.inspector.forget_question();
        self.opening = Some(opening.clone());
        self.worker.send(Request::Open(Box::new(opening)));
    }

    /// Denoises the open frame with the current parameters.
    pub fn run(&mut self) {
        let Some(document) = &self.document else { return };
        // Showing the next iteration would replace this run.
        self.adaptive.follows &= self.adaptive.shown.is_none();
        self.progress = Some((Task::Denoise, 0.0));
        let (frame, reference) = (document.opened.frame.clone(), document.opened.reference.clone());
        self.worker.send(Request::Denoise { frame, reference, parameters: self.parameters });
    }

    /// Replaces the parameters, and denoises again if they differ.
    pub fn take_parameters(&mut self, parameters: Parameters) {
        self.edits.clear();
        if self.parameters != parameters {
            self.earlier.keep(std::mem::replace(&mut self.parameters, parameters));
            self.run();
        }
    }

    /// Starts a sweep, or ends the one that is running.
    pub(super) fn toggle_sweep(&mut self) {
        let Some(document) = &self.document else { return };
        if self.sweep.is_running {
            self.worker.cancel(Task::Sweep);
            self.sweep.is_running = false;
            self.progress.take_if(|(task, _)| *task == Task::Sweep);
            return;
        }
        let (frame, reference) = (document.opened.frame.clone(), document.opened.reference.clone());
        self.worker.send(Request::Sweep { frame, reference, runs: self.sweep.start(self.parameters), next: 0 });
    }

    /// Ends the sweep and forgets its results, for another frame.
    pub(super) fn forget_sweep(&mut self) {
        self.worker.cancel(Task::Sweep);
        self.progress.take_if(|(task, _)| *task == Task::Sweep);
        self.sweep.clear();
    }

    /// Starts the adaptive loop on a built-in scene.
    pub fn adapt(&mut self) {
        (self.progress, self.interrupted, self.waiting_reference) = (Some((Task::Adapt, 0.0)), false, None);
        self.forget_sweep();
        self.inspector.forget_question();
        self.trouble.take_if(|(task, _)| *task == Task::Adapt);
        let adaptive = self.adaptive.start(self.parameters);
        self.worker.send(Request::Adapt(Box::new(adaptive)));
    }

    /// Ends the adaptive loop; its iterations stay.
    pub fn stop_adapting(&mut self) {
        self.adaptive.is_running = false;
        self.progress.take_if(|(task, _)| *task == Task::Adapt);
        self.worker.cancel(Task::Adapt);
    }

    /// Opens an iteration of the adaptive loop. New iterations are shown by themselves only if this one is the newest.
    pub fn show_iteration(&mut self, number: u32, context: &Context) {
        let Some(document) = self.adaptive.document(number) else { return };
        // A run that is still at work on the previous frame would be taken for a run on this one.
        self.worker.cancel(Task::Denoise);
        self.progress.take_if(|(task, _)| *task == Task::Denoise);
        self.forget_sweep();
        self.adaptive.shown = Some(number);
        self.adaptive.follows = self.adaptive.iterations.last().is_some_and(|last| last.number == number);
        context.send_viewport_cmd(ViewportCommand::Title(title(Some(&document.opened.name))));
        self.inspector.clear();
        self.document = Some(document);
    }

    /// Requests the kernels of the pixel to explain, unless they are there already.
    pub(super) fn inspect(&mut self, context: &Context) {
        let run = self.document.as_ref().and_then(|document| Some((document, document.denoised.as_ref()?)));
        let Some((document, denoised)) = run.filter(|_| self.panel == Panel::Kernel) else { return };
        let is_followed = self.inspector.follows || context.input(|input| input.modifiers.command);
        let View { pinned, hovered, .. } = self.view;
        let pixel = if is_followed { hovered.or(pinned) } else { pinned };
        let Extent { width, height } = document.opened.frame.extent();
        let Some(pixel) = pixel.filter(|[x, y]| *x < width && *y < height) else { return };
        let question = Question { frame: document.opened.frame.clone(), method: denoised.parameters.method, pixel };
        // While the pointer moves, each pixel would cancel the request for the previous one.
        if self.inspector.asks(&question) && (pinned == Some(pixel) || !self.inspector.waits()) {
            self.inspector.asked(question.clone());
            self.worker.send(Request::Inspect(question));
        }
    }
}
