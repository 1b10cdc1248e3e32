//! What the replies of the worker change in the window.

use eframe::egui::{Context, ViewportCommand};
use stein::Error;

use super::{Viewer, title};
use crate::adaptive::{Adapted, StepResult};
use crate::document::{Denoised, Document, Opened};
use crate::files::Purpose;
use crate::worker::{Reply, Task};

impl Viewer {
    /// Takes all replies that have arrived.
    pub(super) fn take_replies(&mut self, context: &Context) {
        while let Some(reply) = self.worker.next_reply() {
            match reply {
                Reply::Progress(task, share) => self.progress = Some((task, share)),
                Reply::Opened(opened) => self.take_opened(*opened, context),
                Reply::Swept(point) => {
                    self.sweep.add(*point);
                    self.progress.take_if(|(task, _)| *task == Task::Sweep && !self.sweep.is_running);
                }
                Reply::Inspected(inspected) => self.inspector.take(*inspected),
                Reply::Denoised(denoised) => self.take_denoised(*denoised),
                Reply::Adapted(adapted) => self.take_adapted(*adapted, context),
                Reply::Failed(task, error) => self.take_failed(task, error),
            }
        }
    }

    /// Shows a frame that was read, and denoises it.
    fn take_opened(&mut self, mut opened: Opened, context: &Context) {
        if let Some(document) = &self.document {
            opened.keep_pictures(&document.opened);
        }
        opened.source.iter().for_each(|source| self.settings.remember(source));
        let reference = self.waiting_reference.take().filter(|_| opened.reference.is_none());
        self.adaptive.clear();
        context.send_viewport_cmd(ViewportCommand::Title(title(Some(&opened.name))));
        // The first frame keeps the pixel and the neighbour that the start has set.
        if self.document.is_some() {
            (self.inspector.kept, self.view.pinned) = (None, None);
        }
        self.inspector.clear();
        self.view.camera.fits = true;
        self.view.display.scales.clear();
        self.document = Some(Document::new(opened));
        (self.trouble, self.interrupted, self.scrolls_to_layer) = (None, false, true);
        if self.view.other.is_none() {
            self.compare(self.view.compare);
        }
        self.forget_sweep();
        self.run();
        if let Some(reference) = reference {
            self.take_file(Purpose::Reference, reference, context);
        } else if std::mem::take(&mut self.sweeps) {
            self.toggle_sweep();
        }
    }

    fn take_denoised(&mut self, denoised: Denoised) {
        // The run was requested before there was a reference: a new run is compared with it.
        if self.document.as_ref().is_some_and(|document| document.has_more_to_compare(&denoised)) {
            self.run();
            return;
        }
        self.progress = None;
        self.adaptive.follows = false;
        self.trouble.take_if(|(task, _)| *task == Task::Denoise);
        if let Some(document) = &mut self.document {
            document.add(denoised);
        }
    }

    fn take_failed(&mut self, task: Task, error: Error) {
        self.trouble = Some((task, error));
        if task == Task::Inspect {
            self.inspector.give_up();
            return;
        }
        self.progress = None;
        self.adaptive.is_running &= task != Task::Adapt;
        self.sweep.is_running &= task != Task::Sweep;
        if task == Task::Open && std::mem::take(&mut self.interrupted) {
            self.run();
            // The frame stays open, although its reference cannot be read.
            if std::mem::take(&mut self.sweeps) {
                self.toggle_sweep();
            }
        }
    }

    /// Takes an iteration of the adaptive loop, or all iterations after they were compared with the reference.
    fn take_adapted(&mut self, Adapted { result, is_last }: Adapted, context: &Context) {
        self.adaptive.is_running = !is_last;
        if is_last {
            self.progress = None;
        }
        match result {
            StepResult::Iteration(iteration) => {
                let number = iteration.number;
                self.adaptive.iterations.push(*iteration);
                if number == 1 {
                    (self.view.camera.fits, self.scrolls_to_layer, self.trouble) = (true, true, None);
                    self.view.display.scales.clear();
                }
                if self.adaptive.follows {
                    self.show_iteration(number, context);
                }
            }
            StepResult::Compared(iterations) => {
                self.adaptive.iterations = iterations;
                let shown = self.adaptive.shown.and_then(|number| self.adaptive.document(number));
                if let (Some(document), Some(compared)) = (&mut self.document, shown) {
                    // The points of the sweep, and runs that the user started, were not compared with the reference.
                    let is_own = document.history.len() > 1 || self.worker.has(Task::Denoise);
                    if is_own {
                        document.reopen(compared.opened);
                    } else {
                        *document = compared;
                    }
                    self.forget_sweep();
                    if is_own {
                        self.run();
                    }
                }
            }
        }
        if self.view.other.is_none() {
            self.compare(self.view.compare);
        }
    }
}
