//! The window: the layout of the panels, and the effects of keys, messages and files.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::task::Poll;
use std::time::Instant;

use eframe::egui::{
    self, Align, CentralPanel, Color32, Context, FontDefinitions, FontFamily, Frame as Margins, Layout,
    Panel as SidePanel, RichText, Ui, Vec2, ViewportCommand,
};
use eframe::wgpu;
use stein::error::{FileCause, RequestCause};
use stein::{Extent, Gpu};
use stein_exr::LayerRef;

use crate::adaptive::{Adapted, Adaptive, Setup, Step};
use crate::device::no_thread;
use crate::document::{Document, Source};
use crate::edit::Edits;
use crate::files::{Dialog, Purpose, is_reference, short_name};
use crate::inspector::{Inspector, Question};
use crate::layer::Layer;
use crate::panel::{self, Panel};
use crate::saving::{Content, Saving, Sight};
use crate::settings::{Earlier, Parameters, Settings};
use crate::shortcut::{self, Action};
use crate::sweep::Sweep;
use crate::view::{Compare, Display, View, canvas};
use crate::words;
use crate::worker::{Reply, Request, Task, Worker, rest_after};

/// Time for which the notice of a written file is shown, in seconds.
const NOTICE_SECONDS: f64 = 8.0;

/// State with which the window starts.
#[derive(Clone, Debug, Default)]
pub struct Start {
    /// Files and layers to open.
    pub source: Option<Source>,
    /// Method and parameters; `None` takes the remembered ones.
    pub parameters: Option<Parameters>,
    /// Layer A, by its name.
    pub layer: Option<String>,
    /// Layer B, by its name.
    pub other: Option<String>,
    /// Comparison of the two layers.
    pub compare: Compare,
    /// The panel at the right.
    pub panel: Panel,
    /// Pixel to keep chosen, [column, row].
    pub pixel: Option<[u32; 2]>,
    /// Number of frames after which the window closes, counted from when all work is done.
    pub exit_after_frames: Option<u32>,
    /// An adaptive loop to start, in place of a file to open.
    pub adapt: Option<Setup>,
    /// Whether to measure error against run time once the frame is open.
    pub sweeps: bool,
    /// Neighbour that the kernel panel explains, as an offset from the pixel.
    pub neighbour: Option<[i32; 2]>,
}

/// State of the window. Panels read and change it; slow work goes to the worker.
pub struct Viewer {
    /// Device of the denoiser and the window.
    pub gpu: Gpu,
    /// Thread that does the slow work.
    pub worker: Worker,
    /// The open frame with its runs and layers.
    pub document: Option<Document>,
    /// Layers that are shown, and how they are shown.
    pub view: View,
    /// Method and parameters.
    pub parameters: Parameters,
    /// The adaptive loop.
    pub adaptive: Adaptive,
    /// Earlier parameters of each method and preset, which return when these are chosen again.
    pub earlier: Earlier,
    /// Changes that wait because they contradict other parameters.
    pub edits: Edits,
    /// Error against run time.
    pub sweep: Sweep,
    /// Settings that are kept from one start to the next.
    pub settings: Settings,
    /// The panel at the right.
    pub panel: Panel,
    /// Which neighbours made a pixel.
    pub inspector: Inspector,
    /// Whether the help is shown.
    pub shows_help: bool,
    /// Task that failed and its error, until the user dismisses it.
    pub trouble: Option<(Task, stein::Error)>,
    /// Task of the worker, and the share of it that is done, 0 to 1.
    pub progress: Option<(Task, f32)>,
    /// Panel to return to from a panel that was shown by its own key.
    pub panel_before: Panel,
    /// Whether the strip has to scroll to layer A.
    pub scrolls_to_layer: bool,
    /// Newest message about files, or the reason why a file could not be read or written, and the time of it, in
    /// seconds.
    pub notice: Option<(stein::Result<String>, f64)>,
    /// Whether opening a file cancelled a run; the run starts again if opening fails or is cancelled.
    interrupted: bool,
    /// Reference for the file that is opened next.
    waiting_reference: Option<PathBuf>,
    /// Frames until the window closes by itself.
    frames_left: Option<u32>,
    /// Whether a sweep starts once the frame is open.
    sweeps: bool,
    /// Whether the layers, pixel and neighbour of the start still have to be checked, which is only possible after the
    /// first run.
    checks_names: bool,
    /// Time at which the newest frame was handed over to be drawn.
    drawn: Instant,
    dialog: Option<Dialog>,
    savings: Vec<Saving>,
    /// Parameters that a thread reads from a file.
    reading: Option<Receiver<stein::Result<Parameters>>>,
    /// Size of the canvas, in points.
    canvas: Vec2,
    format: wgpu::TextureFormat,
}

impl Viewer {
    /// Creates the window on a device; `format` is the format of its render target.
    ///
    /// # Errors
    /// As [`Worker::start`].
    pub fn new(
        context: &Context,
        gpu: &Gpu,
        format: wgpu::TextureFormat,
        settings: Settings,
        start: Start,
    ) -> stein::Result<Self> {
        set_style(context);
        let remembered = settings.parameters.as_deref().and_then(|text| Parameters::from_toml(text).ok());
        let mut earlier = Earlier::from_toml(&settings.earlier);
        remembered.into_iter().for_each(|remembered| earlier.keep(remembered));
        let mut viewer = Self {
            gpu: gpu.clone(),
            worker: Worker::start(gpu, context)?,
            document: None,
            view: View::new(settings.display.clone()),
            adaptive: Adaptive::default(),
            parameters: start.parameters.or(remembered).unwrap_or_default(),
            earlier,
            edits: Edits::default(),
            sweep: Sweep::default(),
            settings,
            panel: start.panel,
            inspector: Inspector::default(),
            shows_help: false,
            trouble: None,
            progress: None,
            panel_before: Panel::Display,
            scrolls_to_layer: true,
            notice: None,
            interrupted: false,
            waiting_reference: None,
            frames_left: start.exit_after_frames,
            sweeps: start.sweeps,
            checks_names: true,
            drawn: Instant::now(),
            dialog: None,
            savings: Vec::new(),
            reading: None,
            canvas: Vec2::ZERO,
            format,
        };
        if let Some(layer) = start.layer {
            viewer.view.layer = layer;
        }
        viewer.inspector.kept = start.neighbour;
        (viewer.view.other, viewer.view.compare, viewer.view.pinned) = (start.other, start.compare, start.pixel);
        if let Some(source) = start.source {
            viewer.open(source);
        } else if let Some(setup) = start.adapt {
            viewer.adaptive.setup = setup;
            viewer.adapt();
        }
        Ok(viewer)
    }

    /// Creates the window for eframe, with the settings that eframe has stored.
    ///
    /// # Errors
    /// As [`Viewer::new`].
    pub fn in_window(creation: &eframe::CreationContext, gpu: &Gpu, start: Start) -> stein::Result<Self> {
        let format =
            creation.wgpu_render_state.as_ref().map_or(wgpu::TextureFormat::Rgba8Unorm, |state| state.target_format);
        let settings =
            creation.storage.and_then(|storage| eframe::get_value(storage, Settings::KEY)).unwrap_or_default();
        Self::new(&creation.egui_ctx, gpu, format, settings, start)
    }

    /// Reads a file; what is open stays until that is done.
    pub fn open(&mut self, source: Source) {
        self.interrupted |= matches!(self.progress, Some((Task::Denoise, _)));
        self.adaptive.is_running = false;
        self.progress = Some((Task::Open, 0.0));
        self.sweep.is_running = false;
        self.inspector.forget_question();
        self.worker.send(Request::Open(source));
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

    /// Ends the sweep and forgets its results, for another frame.
    fn forget_sweep(&mut self) {
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

    fn take_adapted(&mut self, Adapted { step, is_last }: Adapted, context: &Context) {
        self.adaptive.is_running = !is_last;
        if is_last {
            self.progress = None;
        }
        match step {
            Step::Iteration(iteration) => {
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
            Step::Compared(iterations) => {
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

    /// Replaces the parameters, and denoises again if they differ.
    pub fn take_parameters(&mut self, parameters: Parameters) {
        self.edits.clear();
        if self.parameters != parameters {
            self.earlier.keep(std::mem::replace(&mut self.parameters, parameters));
            self.run();
        }
    }

    /// Starts a sweep, or ends the one that is running.
    fn toggle_sweep(&mut self) {
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

    /// Returns whether nothing is at work, and no answer, file or reply is still to come.
    pub fn is_idle(&self) -> bool {
        let nothing_to_come = self.progress.is_none()
            && !self.sweep.is_running
            && !self.inspector.waits()
            && self.worker.busy().is_none();
        nothing_to_come && self.savings.is_empty() && self.reading.is_none()
    }

    /// Returns layer A; the noisy image if no layer has that name.
    pub fn layer(&self) -> Option<&Arc<Layer>> {
        let document = self.document.as_ref()?;
        document.layer(&self.view.layer).or_else(|| document.layer("noisy"))
    }

    /// Returns layer B, if there is one.
    pub fn other(&self) -> Option<&Arc<Layer>> {
        self.document.as_ref()?.layer(self.view.other.as_deref()?)
    }

    /// Compares in this way. Chooses the likeliest layer B if none is marked.
    pub fn compare(&mut self, compare: Compare) {
        self.view.compare = compare;
        let is_there = |name: &str| self.document.as_ref().is_some_and(|document| document.layer(name).is_some());
        if compare != Compare::Single && self.other().is_none() {
            let likeliest =
                ["reference", "noisy", "result"].into_iter().find(|name| *name != self.view.layer && is_there(name));
            self.view.other = likeliest.map(ToOwned::to_owned);
        }
    }

    /// Performs the action of a key or of a menu.
    pub fn perform(&mut self, action: Action, context: &Context) {
        match action {
            Action::Open => self.ask(Purpose::Input, context),
            Action::OpenReference => self.ask(Purpose::Reference, context),
            Action::OpenParameters => self.ask(Purpose::Parameters, context),
            Action::SaveView => self.ask(Purpose::SaveView, context),
            Action::SaveLayer => self.ask(Purpose::SaveLayer, context),
            Action::SaveResult => self.ask(Purpose::SaveResult, context),
            Action::SaveParameters => self.ask(Purpose::SaveParameters, context),
            Action::ResetParameters => self.take_parameters(self.parameters.reset()),
            Action::Sweep => self.toggle_sweep(),
            Action::Run => self.run(),
            Action::Cancel => self.cancel(),
            Action::StepLayer(step) => self.step_layer(step),
            Action::ShowLayer(name) => {
                if self.document.as_ref().is_some_and(|document| document.layer(name).is_some()) {
                    self.view.layer = name.to_owned();
                    self.scrolls_to_layer = true;
                }
            }
            Action::MarkOther => self.view.other = self.layer().map(|layer| layer.name().to_owned()),
            Action::Swap => {
                if let Some(other) = self.view.other.take() {
                    self.view.other = Some(std::mem::replace(&mut self.view.layer, other));
                }
            }
            Action::Compare(compare) => self.compare(compare),
            Action::Expose(stops) => self.view.display.exposure += stops,
            Action::Offset(by) => self.view.display.offset += by,
            Action::ResetDisplay => {
                let Display { tone, colormap, .. } = self.view.display;
                self.view.display = Display { tone, colormap, ..Display::default() };
            }
            Action::Fit => self.view.camera.fits = true,
            Action::ActualSize => {
                self.view.camera.fits = false;
                self.view.camera.zoom = 1.0 / context.pixels_per_point();
            }
            Action::Zoom(factor) => self.view.camera.magnify(factor),
            Action::Panel(panel) => self.panel = panel,
            Action::StepIteration(step) => {
                let number = self.adaptive.shown.and_then(|shown| shown.checked_add_signed(step));
                number.into_iter().for_each(|number| self.show_iteration(number, context));
            }
            Action::TogglePanel(panel) if self.panel == panel => self.panel = self.panel_before,
            Action::TogglePanel(panel) => self.panel_before = std::mem::replace(&mut self.panel, panel),
            Action::ToggleFollow => self.inspector.follows = !self.inspector.follows,
            Action::MovePixel(by) => self.move_pixel(by),
            Action::ToggleSharedScale => self.view.display.shares_scale = !self.view.display.shares_scale,
            Action::ToggleTheme => context.set_theme(if context.theme() == egui::Theme::Dark {
                egui::Theme::Light
            } else {
                egui::Theme::Dark
            }),
            Action::Help => self.shows_help = !self.shows_help,
        }
    }

    fn cancel(&mut self) {
        if self.trouble.take().is_some() || self.notice.take_if(|(notice, _)| notice.is_err()).is_some() {
            return;
        }
        if std::mem::take(&mut self.shows_help) {
            return;
        }
        match self.progress.take() {
            Some((Task::Adapt, _)) => self.stop_adapting(),
            Some((Task::Sweep, _)) => self.toggle_sweep(),
            Some((task, _)) => {
                self.worker.cancel(task);
                if task == Task::Open && std::mem::take(&mut self.interrupted) {
                    self.run();
                }
            }
            None if self.waiting_reference.take().is_some() => {}
            None => self.view.pinned = None,
        }
    }

    fn step_layer(&mut self, step: isize) {
        let Some(document) = &self.document else { return };
        let layers = document.layers();
        let place = layers.iter().position(|layer| layer.name() == self.view.layer).unwrap_or(0);
        if let Some(layer) = layers.get(place.saturating_add_signed(step).min(layers.len() - 1)) {
            self.view.layer = layer.name().to_owned();
            self.scrolls_to_layer = true;
        }
    }

    /// Pins the pixel at the offset `by` from the chosen one, or from the middle of the image if no pixel is chosen.
    fn move_pixel(&mut self, by: [i32; 2]) {
        let Some(document) = &self.document else { return };
        let Extent { width, height } = document.opened.frame.extent();
        let [x, y] = self.view.chosen().unwrap_or([width / 2, height / 2]);
        self.view.pinned =
            Some([x.saturating_add_signed(by[0]).min(width - 1), y.saturating_add_signed(by[1]).min(height - 1)]);
        self.view.reveals_pinned = true;
    }

    fn ask(&mut self, purpose: Purpose, context: &Context) {
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
        let input = input.strip_suffix(".exr").unwrap_or(&input);
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

    fn take_read(&mut self, context: &Context) {
        let Some(answer) = self.reading.take() else { return };
        match answer.try_recv() {
            Ok(Ok(parameters)) => self.take_parameters(parameters),
            Ok(Err(error)) => self.tell(Err(error), context),
            Err(TryRecvError::Empty) => self.reading = Some(answer),
            // The thread ended with a panic, which was already reported.
            Err(TryRecvError::Disconnected) => {}
        }
    }

    fn refuse(&mut self, problem: &str, remedy: &str) {
        self.trouble = Some((
            Task::Open,
            stein::Error::Request(RequestCause::Other { problem: problem.into(), remedy: remedy.into() }),
        ));
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
        let same =
            |other: &Path| path.canonicalize().is_ok_and(|path| other.canonicalize().is_ok_and(|other| path == other));
        if source.is_some_and(|source| source.files().any(same)) {
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

    fn tell(&mut self, notice: stein::Result<String>, context: &Context) {
        self.notice = Some((notice, context.input(|input| input.time)));
        context.request_repaint_after_secs(NOTICE_SECONDS as f32);
    }

    /// Shows notices of files that were written, and removes old notices.
    fn take_savings(&mut self, context: &Context) {
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

    /// Opens files that were dropped on the window. A file with the name of a reference belongs to the other dropped
    /// file, or else to the open frame, or else to the file that is opened next.
    fn take_dropped(&mut self, context: &Context) {
        let dropped: Vec<PathBuf> =
            context.input(|input| input.raw.dropped_files.iter().map(|file| file.path().to_owned()).collect());
        let (references, inputs): (Vec<_>, Vec<_>) = dropped.into_iter().partition(|path| is_reference(path));
        let left_out: Vec<_> =
            inputs.iter().skip(1).chain(references.iter().skip(1)).map(|path| short_name(path)).collect();
        if !left_out.is_empty() {
            self.tell(Ok(format!("One file is open at a time, left out: {}", left_out.join(", "))), context);
        }
        match (inputs.into_iter().next(), references.into_iter().next()) {
            (Some(input), reference) => self.open(Source::whole(input, reference)),
            (None, Some(reference)) => self.take_file(Purpose::Reference, reference, context),
            (None, None) => {}
        }
    }

    fn take_replies(&mut self, context: &Context) {
        while let Some(reply) = self.worker.next_reply() {
            match reply {
                Reply::Progress(task, share) => self.progress = Some((task, share)),
                Reply::Opened(opened) => {
                    opened.source.iter().for_each(|source| self.settings.remember(source));
                    let reference = self.waiting_reference.take().filter(|_| opened.reference.is_none());
                    self.adaptive.clear();
                    context.send_viewport_cmd(ViewportCommand::Title(title(Some(&opened.name))));
                    if self.document.is_some() {
                        self.inspector.kept = None;
                    }
                    self.inspector.clear();
                    self.view.camera.fits = true;
                    if self.document.is_some() {
                        self.view.pinned = None;
                    }
                    self.view.display.scales.clear();
                    self.document = Some(Document::new(*opened));
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
                Reply::Swept(point) => {
                    self.sweep.add(*point);
                    self.progress.take_if(|(task, _)| *task == Task::Sweep && !self.sweep.is_running);
                }
                Reply::Inspected(inspected) => self.inspector.take(*inspected),
                Reply::Failed(Task::Inspect, error) => {
                    self.inspector.give_up();
                    self.trouble = Some((Task::Inspect, error));
                }
                // The run was requested before there was a reference.
                Reply::Denoised(denoised)
                    if self.document.as_ref().is_some_and(|document| document.has_more_to_compare(&denoised)) =>
                {
                    self.run();
                }
                Reply::Denoised(denoised) => {
                    self.progress = None;
                    self.adaptive.follows = false;
                    self.trouble.take_if(|(task, _)| *task == Task::Denoise);
                    if let Some(document) = &mut self.document {
                        document.add(*denoised);
                    }
                }
                Reply::Adapted(adapted) => self.take_adapted(*adapted, context),
                Reply::Failed(task, error) => {
                    self.progress = None;
                    self.adaptive.is_running &= task != Task::Adapt;
                    self.trouble = Some((task, error));
                    self.sweep.is_running &= task != Task::Sweep;
                    if task == Task::Open && std::mem::take(&mut self.interrupted) {
                        self.run();
                        // The frame stays open, although its reference cannot be read.
                        if std::mem::take(&mut self.sweeps) {
                            self.toggle_sweep();
                        }
                    }
                }
            }
        }
    }

    fn take_dialog(&mut self, context: &Context) {
        let Some(Poll::Ready(answer)) = self.dialog.as_ref().map(Dialog::answer) else { return };
        self.dialog = None;
        match answer {
            Ok(Some((purpose, path))) => self.take_file(purpose, path, context),
            Ok(None) => {}
            Err(error) => self.tell(Err(error), context),
        }
    }

    /// Processes replies of the worker, and files that were chosen, read, written or dropped.
    pub fn poll(&mut self, context: &Context) {
        self.take_replies(context);
        self.take_dialog(context);
        self.take_savings(context);
        self.take_read(context);
        self.take_dropped(context);
        self.inspect(context);
        self.check_names();
    }

    /// Reports, once the first run is done, which layers, pixel or neighbour of the start do not exist. Shows the
    /// defaults in their stead.
    fn check_names(&mut self) {
        let Some(document) = self.document.as_ref().filter(|document| document.denoised.is_some()) else { return };
        // The last iteration still adds layers, and an earlier failure must stay visible.
        if !self.checks_names || self.adaptive.is_running || self.inspector.waits() || self.trouble.is_some() {
            return;
        }
        self.checks_names = false;
        let mut missing: Vec<(String, String)> = Vec::new();
        let is_unknown = |name: &&String| document.layer(name).is_none();
        let mut unknown: Vec<_> = [Some(&self.view.layer), self.view.other.as_ref()]
            .into_iter()
            .flatten()
            .filter(is_unknown)
            .cloned()
            .collect();
        unknown.dedup();
        if !unknown.is_empty() {
            let names: Vec<_> = document.layers().iter().map(|layer| layer.name()).collect();
            missing.push((
                format!("there is no layer '{}'", unknown.join("' or '")),
                format!("choose one of {}", names.join(", ")),
            ));
        }
        let extent = document.opened.frame.extent();
        let outside = self.view.pinned.filter(|[x, y]| *x >= extent.width || *y >= extent.height);
        if let Some([x, y]) = outside {
            missing.push((
                format!("there is no pixel ({x}, {y})"),
                format!("the image has {extent} pixels, counted from 0"),
            ));
        }
        let lost = self.inspector.kept.filter(|offset| self.inspector.lacks(*offset));
        if let Some([dx, dy]) = lost {
            missing.push((
                format!("the window has no neighbour ({dx}, {dy}) in the image"),
                "choose an offset within the radius of the window".into(),
            ));
        }
        if missing.is_empty() {
            return;
        }
        if unknown.contains(&self.view.layer) {
            self.view.layer = "result".into();
            self.scrolls_to_layer = true;
        }
        if self.view.other.take_if(|other| unknown.contains(other)).is_some() {
            self.compare(self.view.compare);
        }
        self.view.pinned.take_if(|_| outside.is_some());
        self.inspector.kept.take_if(|_| lost.is_some());
        let (problems, remedies): (Vec<_>, Vec<_>) = missing.into_iter().unzip();
        self.refuse(&problems.join("; "), &remedies.join("; "));
    }

    /// Requests the kernels of the pixel to explain, unless they are there already.
    fn inspect(&mut self, context: &Context) {
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

    /// Shows the whole window.
    pub fn show(&mut self, ui: &mut Ui) {
        let context = ui.ctx().clone();
        self.view.begin_frame(self.format);
        self.poll(&context);
        for action in shortcut::pressed(&context) {
            self.perform(action, &context);
        }
        SidePanel::top("toolbar").show(ui, |ui| panel::toolbar::show(ui, self));
        SidePanel::bottom("status").show(ui, |ui| panel::status::show(ui, self));
        SidePanel::left("layers")
            .resizable(true)
            .default_size(216.0)
            .size_range(150.0..=420.0)
            .show(ui, |ui| panel::layers::show(ui, self));
        SidePanel::right("panel")
            .resizable(true)
            .default_size(336.0)
            .size_range(240.0..=620.0)
            .show(ui, |ui| panel::show(ui, self));
        CentralPanel::default().frame(Margins::NONE.fill(ui.visuals().panel_fill)).show(ui, |ui| self.show_canvas(ui));
        panel::help::show(&context, self);
    }

    fn show_canvas(&mut self, ui: &mut Ui) {
        let failures = [
            self.trouble.as_ref().map(|(_, error)| error),
            self.notice.as_ref().and_then(|(notice, _)| notice.as_ref().err()),
        ];
        let failures: Vec<_> = failures.into_iter().flatten().map(words::told).collect();
        failures.iter().for_each(|failure| self.show_trouble(ui, failure));
        self.view.marked = if self.panel == Panel::Kernel { self.inspector.marked() } else { None };
        let (layer, other) = (self.layer().cloned(), self.other().cloned());
        match layer {
            Some(layer) => {
                self.canvas = canvas::show(ui, &mut self.view, &layer, other.as_deref()).rect.size();
            }
            None => self.show_welcome(ui),
        }
    }

    fn show_trouble(&mut self, ui: &mut Ui, trouble: &str) {
        let (problem, remedy) = trouble.split_once("\n  remedy: ").unwrap_or((trouble, ""));
        Margins::new().fill(ui.visuals().extreme_bg_color).inner_margin(8.0).show(ui, |ui| {
            ui.horizontal_top(|ui| {
                ui.with_layout(Layout::right_to_left(Align::TOP), |ui| {
                    if ui.button("Dismiss").clicked() {
                        (self.trouble, self.notice) = (None, None);
                    }
                    ui.with_layout(Layout::top_down(Align::LEFT), |ui| {
                        ui.label(RichText::new(problem).color(ui.visuals().error_fg_color));
                        if !remedy.is_empty() {
                            ui.label(format!("Remedy: {remedy}"));
                        }
                    });
                });
            });
        });
    }

    fn show_welcome(&mut self, ui: &mut Ui) {
        let context = ui.ctx().clone();
        ui.vertical_centered(|ui| {
            ui.add_space(ui.available_height() * 0.28);
            if matches!(self.progress, Some((Task::Open, _))) {
                ui.spinner();
                return;
            }
            ui.heading("Drop an OpenEXR buffer set here");
            ui.label(
                "the noisy image with its halves or variance, and features; with it, if there is one, the reference",
            );
            ui.add_space(10.0);
            if ui.button("Open…").clicked() {
                self.perform(Action::Open, &context);
            }
            if let Some(reference) = &self.waiting_reference {
                ui.add_space(10.0);
                ui.label(format!("The reference {} waits for its frame.", short_name(reference)));
            }
            if !self.settings.recent.is_empty() {
                ui.add_space(16.0);
                ui.label(RichText::new("Recent").strong());
                panel::toolbar::recent(ui, self);
            }
        });
    }
}

impl eframe::App for Viewer {
    fn ui(&mut self, ui: &mut Ui, _frame: &mut eframe::Frame) {
        let begun = Instant::now();
        self.show(ui);
        if self.gpu.is_software() {
            // Requests of this frame are already sent, and clicks that happen meanwhile are handled in the next frame.
            self.worker.make_room(rest_after(begun.saturating_duration_since(self.drawn)));
            self.drawn = Instant::now();
        }
        let is_idle = self.is_idle();
        if let Some(frames_left) = &mut self.frames_left {
            // Frames that nothing needs would only delay the work.
            if is_idle {
                *frames_left = frames_left.saturating_sub(1);
                ui.ctx().request_repaint();
            }
            if *frames_left == 0 {
                ui.ctx().send_viewport_cmd(ViewportCommand::Close);
            }
        }
    }

    fn save(&mut self, storage: &mut dyn eframe::Storage) {
        let display = Display { scales: Default::default(), ..self.view.display.clone() };
        self.settings.display = display;
        self.settings.parameters = Some(self.parameters.to_toml());
        self.settings.earlier = self.earlier.to_toml();
        eframe::set_value(storage, Settings::KEY, &self.settings);
    }
}

/// Sets fonts and colours of the window, for the dark and the light theme.
pub fn set_style(context: &Context) {
    let mut fonts = FontDefinitions::default();
    // The monospace font has mathematical signs that the proportional font lacks.
    let [proportional, monospace] = [FontFamily::Proportional, FontFamily::Monospace]
        .map(|family| fonts.families.get(&family).cloned().unwrap_or_default());
    fonts.families.insert(FontFamily::Proportional, proportional.into_iter().chain(monospace).collect());
    context.set_fonts(fonts);
    context.all_styles_mut(|style| {
        // Text on panels is read, not only glanced at.
        let visuals = &mut style.visuals;
        visuals.widgets.noninteractive.fg_stroke.color =
            if visuals.dark_mode { Color32::from_gray(205) } else { Color32::from_gray(50) };
        visuals.error_fg_color =
            if visuals.dark_mode { Color32::from_rgb(255, 120, 110) } else { Color32::from_rgb(170, 0, 0) };
        visuals.weak_text_alpha = 0.75;
    });
}

/// Returns the title of the window.
pub fn title(name: Option<&str>) -> String {
    name.map_or_else(|| "Stein".into(), |name| format!("{name} - Stein"))
}
