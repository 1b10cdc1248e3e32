//! Files that the window writes, each in a thread of its own: none is held up by a run, and none replaces another that
//! waits.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::task::Poll;
use std::thread::JoinHandle;
use stein_exr::write_estimate;

use eframe::egui::{CentralPanel, Context, Frame as Margins, Pos2, Rect, Theme, Vec2};
use stein::{Error, Estimate, Gpu, Image, Method, Result};
use stein_exr::atomic_file;
use stein_exr::{BufferSet, BufferSetRequest, NamedLayer, write_layers};

use crate::app;
use crate::device::no_thread;
use crate::files::short_name;
use crate::layer::Layer;
use crate::screenshot::{Offscreen, Picture};
use crate::settings::Parameters;
use crate::view::{Camera, Compare, Display, Marked, View, canvas};

/// What is written.
#[derive(Debug)]
pub enum Content {
    /// What the canvas shows, as PNG.
    View(Box<Sight>),
    /// A layer by itself, a pixel of the picture for each of its own, as PNG.
    Layer(Arc<Layer>, Display),
    /// The denoised frame in the clothes of its file, as OpenEXR.
    Result {
        /// What the frame was read from; `None` of one that was rendered here.
        request: Option<Box<BufferSetRequest>>,
        /// What to write.
        estimate: Arc<Estimate>,
        /// With which parameters it was made.
        method: Method,
    },
    /// Parameters for `--params`, as TOML.
    Parameters(Parameters),
}

/// All that decides what the canvas shows.
#[derive(Debug)]
pub struct Sight {
    /// Layer A.
    pub layer: Arc<Layer>,
    /// Layer B.
    pub other: Option<Arc<Layer>>,
    /// How the two are shown; of [`Compare::Blink`] A.
    pub compare: Compare,
    /// Where the line of a wipe is.
    pub wipe: f32,
    /// From where.
    pub camera: Camera,
    /// How values become colours.
    pub display: Display,
    /// The pixel that is framed.
    pub pinned: Option<[u32; 2]>,
    /// The pixels that the kernel's panel is about.
    pub marked: Option<Marked>,
    /// Of the canvas, in points.
    pub size: Vec2,
    /// Pixels per point.
    pub scale: f32,
    /// Dark or light.
    pub theme: Theme,
}

/// A file on its way. Dropping it waits for its end.
#[derive(Debug)]
pub struct Saving {
    path: PathBuf,
    answer: Receiver<Result<String>>,
    thread: Option<JoinHandle<()>>,
}

impl Saving {
    /// Writes a file, which replaces another.
    ///
    /// # Errors
    /// [`Error::Device`] where the system gives no thread.
    pub fn start(gpu: &Gpu, content: Content, path: PathBuf, context: &Context) -> Result<Self> {
        let (sender, answer) = channel();
        let (gpu, context, to) = (gpu.clone(), context.clone(), path.clone());
        let write = move || {
            // Where nobody waits for the answer any more, the window is closed.
            let _ = sender.send(content.write(&gpu, &to));
            context.request_repaint();
        };
        let thread = std::thread::Builder::new().name("stein-saving".into()).spawn(write).map_err(no_thread)?;
        Ok(Self { path, answer, thread: Some(thread) })
    }

    /// What to tell of it; pending while it is written.
    pub fn answer(&self) -> Poll<Result<String>> {
        match self.answer.try_recv() {
            Ok(answer) => Poll::Ready(answer),
            Err(TryRecvError::Empty) => Poll::Pending,
            Err(TryRecvError::Disconnected) => Poll::Ready(Err(Error::File {
                path: self.path.clone(),
                problem: "writing it ended with a panic".into(),
                remedy: "this is a defect of stein-viewer: please report it with the file that was open".into(),
            })),
        }
    }
}

impl Drop for Saving {
    fn drop(&mut self) {
        if let Some(thread) = self.thread.take() {
            // A panic in the thread has been told where it happened.
            let _ = thread.join();
        }
    }
}

impl Content {
    /// Writes it. What there is to tell.
    fn write(self, gpu: &Gpu, path: &Path) -> Result<String> {
        let mut notes = Vec::new();
        match self {
            Self::View(sight) => sight.picture(gpu)?.write_png(path)?,
            Self::Layer(layer, display) => picture_of(gpu, &layer, display)?.write_png(path)?,
            Self::Parameters(parameters) => {
                atomic_file::write(path, parameters.to_toml().as_bytes()).map_err(|error| Error::File {
                    path: path.to_owned(),
                    problem: format!("cannot be written: {error}"),
                    remedy: "check that the folder exists, may be written to and has space left".into(),
                })?;
            }
            Self::Result { request: None, estimate, .. } => {
                let layer = |name: &str, channels: &[&str], image: &Image| NamedLayer {
                    name: name.into(),
                    channels: channels.iter().map(|channel| (*channel).to_owned()).collect(),
                    image: image.clone(),
                };
                let error = estimate.error.iter().map(|error| layer("stein.error", &["V"], error));
                let layers: Vec<_> = [layer("", &["R", "G", "B"], &estimate.color)].into_iter().chain(error).collect();
                write_layers(path, &layers, &[])?;
            }
            Self::Result { request: Some(request), estimate, method } => {
                notes = write_estimate(&estimate, BufferSet::read(&request)?, path, &[], &method)?.notes;
            }
        }
        notes.insert(0, format!("Wrote {}", short_name(path)));
        Ok(notes.join("; "))
    }
}

impl Sight {
    fn picture(&self, gpu: &Gpu) -> Result<Picture> {
        let mut window = Offscreen::new(gpu, self.size.x, self.size.y, self.scale)?;
        window.context().set_theme(self.theme);
        app::set_style(window.context());
        let mut view = View::new(self.display.clone());
        (view.compare, view.wipe, view.camera) = (self.compare, self.wipe, self.camera);
        (view.pinned, view.marked) = (self.pinned, self.marked);
        let format = window.format();
        let mut draw = || {
            window.frame(|ui| {
                view.begin_frame(format);
                let margins = Margins::NONE.fill(ui.visuals().panel_fill);
                CentralPanel::default()
                    .frame(margins)
                    .show(ui, |ui| canvas::show(ui, &mut view, &self.layer, self.other.as_deref()));
            })
        };
        // Fonts are there from the second frame on.
        draw()?;
        draw()
    }
}

/// A layer at its own size, with nothing over it.
fn picture_of(gpu: &Gpu, layer: &Layer, display: Display) -> Result<Picture> {
    let extent = layer.image().extent;
    let most = gpu.wgpu_device().limits().max_texture_dimension_2d;
    if extent.width.max(extent.height) > most {
        return Err(Error::Device {
            problem: format!(
                "a picture of {extent} pixels is too large for '{}', which draws {most} along each side",
                gpu.summary().name
            ),
            remedy: "save the view, or the result as OpenEXR".into(),
        });
    }
    let size = Vec2::new(extent.width as f32, extent.height as f32);
    let mut window = Offscreen::new(gpu, size.x, size.y, 1.0)?;
    let mut view = View::new(display);
    view.begin_frame(window.format());
    window.frame(|ui| view.paint_whole(ui.painter(), Rect::from_min_size(Pos2::ZERO, size), layer, layer.shown.clone()))
}
