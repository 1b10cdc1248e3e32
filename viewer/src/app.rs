//! The window: its state, how it starts, and what it keeps from one start to the next.
//!
//! | file | holds |
//! | --- | --- |
//! | `layout` | which panel is where, and which part of the state it reads |
//! | `apply` | effects of actions |
//! | `work` | work that goes to the worker |
//! | `replies` | what the replies of the worker change |
//! | `files` | files that are opened, read and written |
//! | `notices` | messages to the user |

mod apply;
mod files;
mod layout;
mod notices;
mod replies;
mod work;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::Instant;

use eframe::egui::{Context, Ui, Vec2, ViewportCommand};
use eframe::wgpu;
use stein::Gpu;

use crate::adaptive::{Adaptive, Setup};
use crate::document::{Document, Opening, Source};
use crate::edit::Edits;
use crate::files::Dialog;
use crate::inspector::Inspector;
use crate::layer::Layer;
use crate::panel::Panel;
use crate::saving::Saving;
use crate::settings::{Earlier, Parameters, Settings};
use crate::style;
use crate::sweep::Sweep;
use crate::view::{Compare, Display, View};
use crate::worker::{Task, Worker, rest_after};

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
    /// Number of frames after which the window closes; frames count once all work is done.
    pub exit_after_frames: Option<u32>,
    /// An adaptive loop to start, in place of a file to open.
    pub adapt: Option<Setup>,
    /// Whether to measure error against run time once the frame is open.
    pub sweeps: bool,
    /// Neighbour that the kernel panel explains, as an offset from the pixel.
    pub neighbour: Option<[i32; 2]>,
}

/// State of the window. Panels read parts of it and return actions; slow work goes to the worker.
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
    /// Files that are being opened, or that were opened last.
    opening: Option<Opening>,
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
        style::apply(context);
        let remembered = settings.parameters.as_deref().and_then(|text| Parameters::from_toml(text).ok());
        let mut earlier = Earlier::from_toml(&settings.earlier);
        remembered.into_iter().for_each(|remembered| earlier.keep(remembered));
        let mut viewer = Self {
            gpu: gpu.clone(),
            worker: Worker::start(gpu, context)?,
            document: None,
            view: View::new(settings.display.clone())?,
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
            opening: None,
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

    /// Returns whether the open frame was denoised.
    fn is_denoised(&self) -> bool {
        self.document.as_ref().is_some_and(|document| document.denoised.is_some())
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

/// Returns the title of the window.
pub fn title(name: Option<&str>) -> String {
    name.map_or_else(|| "Stein".into(), |name| format!("{name} - Stein"))
}
