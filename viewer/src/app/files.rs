//! Files of the window: chosen in a dialog or dropped, and then opened, read or written.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{TryRecvError, channel};
use std::task::Poll;

use eframe::egui::Context;
use stein::error::{FileCause, RequestCause};
use stein_exr::{LayerRef, same_file};

use super::Viewer;
use super::notices::NOTICE_SECONDS;
use crate::device::no_thread;
use crate::document::Source;
use crate::files::{Dialog, ENDINGS, Purpose, is_reference, short_name};
use crate::saving::{Content, Saving, Sight};
use crate::settings::Parameters;
use crate::view::View;
use crate::worker::Task;

impl Viewer {
    /// Opens the dialog for a file, unless another dialog is open.
    pub(super) fn ask(&mut self, purpose: Purpose, context: &Context) {
        if self.dialog.is_none() {
            let source = self.document.as_ref().and_then(|document| document.opened.source.as_ref());
            let beside = source.map(|source| source.request.input.as_path());
            match Dialog::open(purpose, beside, &self.name_for(purpose), context) {
                Ok(dialog) => self.dialog = Some(dialog),
                Err(error) => self.tell(Err(error), context),
            }
        }
    }

    /// Returns the suggested name of a file to write, without an ending.
    fn name_for(&self, purpose: Purpose) -> String {
        let input = self.document.as_ref().map_or("stein", |document| &document.opened.name);
        // The name of a layer follows the name of its file.
        let input = input.replacen(".exr::", ".", 1);
        let input = ENDINGS.iter().find_map(|ending| input.strip_suffix(ending)?.strip_suffix('.')).unwrap_or(&input);
        match purpose {
            Purpose::SaveResult => format!("{input}.denoised"),
            Purpose::SaveParameters => self.parameters.method.name().to_owned(),
            Purpose::SaveLayer => format!("{input}.{}", self.layer().map_or("layer", |layer| layer.name())),
            _ => format!("{input}.view"),
        }
    }

    /// Opens, reads or writes a file, as `purpose` says.
    pub fn take_file(&mut self, purpose: Purpose, path: PathBuf, context: &Context) {
        match (purpose, &self.document) {
            (Purpose::Input, _) => self.open(Source::whole(path, None)),
            // While another file is being read, the reference belongs to that file.
            (Purpose::Reference, _) if matches!(self.progress, Some((Task::Open, _))) => {
                self.waiting_reference = Some(path);
            }
            (Purpose::Reference, document) => match document.as_ref().map(|document| &document.opened.source) {
                Some(Some(source)) => self.open(Source { reference: Some(LayerRef::whole(path)), ..source.clone() }),
                Some(None) => self.refuse(
                    "a frame that was rendered here is compared with a reference of the same scene",
                    "let one be drawn (panel Sampling)",
                ),
                None => self.waiting_reference = Some(path),
            },
            (Purpose::Parameters, _) => self.read_parameters(path, context),
            (Purpose::SaveView | Purpose::SaveLayer | Purpose::SaveResult | Purpose::SaveParameters, _) => {
                let saving = self
                    .content(purpose, &path, context)
                    .and_then(|content| Saving::start(&self.gpu, content, path, context));
                match saving {
                    Ok(saving) => self.savings.push(saving),
                    Err(error) => self.tell(Err(error), context),
                }
            }
        }
    }

    /// Reads parameters in a thread of their own, so that a run does not delay them.
    fn read_parameters(&mut self, path: PathBuf, context: &Context) {
        let (sender, answer) = channel();
        let window = context.clone();
        let read = move || {
            // Nobody waits for the answer if another file was chosen meanwhile, or if the window is closed.
            let _ = sender.send(Parameters::read(&path));
            window.request_repaint();
        };
        match std::thread::Builder::new().name("stein-reading".into()).spawn(read).map_err(no_thread) {
            Ok(_) => self.reading = Some(answer),
            Err(error) => self.tell(Err(error), context),
        }
    }

    /// Takes parameters that were read from a file.
    pub(super) fn take_read(&mut self, context: &Context) {
        let Some(answer) = self.reading.take() else { return };
        match answer.try_recv() {
            Ok(Ok(parameters)) => self.take_parameters(parameters),
            Ok(Err(error)) => self.tell(Err(error), context),
            Err(TryRecvError::Empty) => self.reading = Some(answer),
            // The thread ended with a panic, which was already reported.
            Err(TryRecvError::Disconnected) => {}
        }
    }

    /// Returns the content of the file to save.
    fn content(&self, purpose: Purpose, path: &Path, context: &Context) -> stein::Result<Content> {
        let missing = |what: &str| {
            stein::Error::Request(RequestCause::Other {
                problem: format!("there is no {what} to save"),
                remedy: "open a file and wait for the run".into(),
            })
        };
        let layer = || self.layer().cloned().ok_or_else(|| missing("image"));
        let source = self.document.as_ref().and_then(|document| document.opened.source.as_ref());
        let input = self.document.as_ref().and_then(|document| document.opened.input.as_ref());
        let beside = source.zip(input).into_iter().flat_map(|(source, input)| input.found(&source.request));
        if source.into_iter().flat_map(Source::files).chain(beside).any(|other| same_file(path, other)) {
            return Err(stein::Error::File {
                path: path.to_owned(),
                cause: FileCause::Other {
                    problem: "is open here, and would be replaced".into(),
                    remedy: "choose another name".into(),
                },
            });
        }
        match purpose {
            Purpose::SaveParameters => Ok(Content::Parameters(self.parameters)),
            Purpose::SaveLayer => Ok(Content::Layer(layer()?, self.view.display.clone())),
            Purpose::SaveResult => {
                let document = self.document.as_ref().ok_or_else(|| missing("result"))?;
                let denoised = document.denoised.as_ref().ok_or_else(|| missing("result"))?;
                Ok(Content::Result {
                    request: source.map(|source| Box::new(source.request.clone())),
                    estimate: denoised.estimate.clone(),
                    method: denoised.parameters.method,
                })
            }
            _ => {
                let View { compare, wipe, camera, display, pinned, marked, .. } = &self.view;
                Ok(Content::View(Box::new(Sight {
                    layer: layer()?,
                    other: self.other().cloned(),
                    compare: *compare,
                    wipe: *wipe,
                    camera: *camera,
                    display: display.clone(),
                    pinned: *pinned,
                    marked: *marked,
                    size: self.canvas,
                    scale: context.pixels_per_point(),
                    theme: context.theme(),
                })))
            }
        }
    }

    /// Takes the file that was chosen in a dialog.
    pub(super) fn take_dialog(&mut self, context: &Context) {
        let Some(Poll::Ready(answer)) = self.dialog.as_ref().map(Dialog::answer) else { return };
        self.dialog = None;
        match answer {
            Ok((Purpose::Input, paths)) => self.open_together(paths, None),
            Ok((purpose, paths)) => paths.into_iter().for_each(|path| self.take_file(purpose, path, context)),
            Err(error) => self.tell(Err(error), context),
        }
    }

    /// Opens files that were dropped on the window. A file with the name of a reference belongs to the other dropped
    /// files, or else to the open frame, or else to the file that is opened next.
    pub(super) fn take_dropped(&mut self, context: &Context) {
        let dropped: Vec<PathBuf> =
            context.input(|input| input.raw.dropped_files.iter().map(|file| file.path().to_owned()).collect());
        let (references, inputs): (Vec<_>, Vec<_>) = dropped.into_iter().partition(|path| is_reference(path));
        let left_out: Vec<_> = references.iter().skip(1).map(|path| short_name(path)).collect();
        if !left_out.is_empty() {
            self.tell(Ok(format!("A frame has one reference, left out: {}", left_out.join(", "))), context);
        }
        match references.into_iter().next() {
            Some(reference) if inputs.is_empty() => self.take_file(Purpose::Reference, reference, context),
            reference => self.open_together(inputs, reference),
        }
    }

    /// Shows notices of files that were written, and removes old notices.
    pub(super) fn take_savings(&mut self, context: &Context) {
        let answers: Vec<_> = self.savings.iter().map(Saving::answer).collect();
        let mut answers = answers.into_iter();
        let mut done = Vec::new();
        self.savings.retain(|_| match answers.next() {
            Some(Poll::Ready(answer)) => {
                done.push(answer);
                false
            }
            _ => true,
        });
        done.into_iter().for_each(|answer| self.tell(answer, context));
        let now = context.input(|input| input.time);
        self.notice.take_if(|(notice, told)| notice.is_ok() && now > *told + NOTICE_SECONDS);
    }
}
