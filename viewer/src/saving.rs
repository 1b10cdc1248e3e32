//! Files that the window writes. Each file has a thread of its own, so that no run and no other file delays it.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::task::Poll;
use std::thread::JoinHandle;

use eframe::egui::{CentralPanel, Context, Frame as Margins, Pos2, Rect, Theme, Vec2};
use stein::error::{DeviceCause, FileCause};
use stein::{Error, Estimate, Gpu, Image, Method, Result, text};
use stein_exr::picture_file::{self, Format, PngEncoding};
use stein_exr::{BufferSet, BufferSetRequest, NamedLayer, atomic_file, write_estimate, write_layers};

use crate::device::no_thread;
use crate::files::short_name;
use crate::layer::Layer;
use crate::screenshot::{Offscreen, Picture};
use crate::settings::Parameters;
use crate::style;
use crate::view::{Camera, Compare, Display, Marked, View, canvas};

/// Content of a file to write.
#[derive(Debug)]
pub enum Content {
    /// View of the canvas, as PNG.
    View(Box<Sight>),
    /// One layer, with one pixel of the picture for each pixel of the layer, as PNG.
    Layer(Arc<Layer>, Display),
    /// Denoised frame as OpenEXR: the contents of its file, with the colour and the layers that are denoised along
    /// replaced by the denoised ones. Or the denoised colour and its alpha as PFM or PNG, if the path has such an
    /// ending.
    Result {
        /// Buffer set that the frame was read from; `None` for a frame that was rendered here.
        request: Option<Box<BufferSetRequest>>,
        /// Estimate to write.
        estimate: Arc<Estimate>,
        /// Method that made the estimate.
        method: Method,
    },
    /// Parameters for `--params`, as TOML.
    Parameters(Parameters),
}

/// Everything that determines what the canvas shows.
#[derive(Debug)]
pub struct Sight {
    /// Layer A.
    pub layer: Arc<Layer>,
    /// Layer B.
    pub other: Option<Arc<Layer>>,
    /// Comparison of the two layers; [`Compare::Blink`] shows A.
    pub compare: Compare,
    /// Position of the line of a wipe, as a share of the width of the canvas.
    pub wipe: f32,
    /// Pan and zoom.
    pub camera: Camera,
    /// Settings that turn values into colours.
    pub display: Display,
    /// Pinned pixel, [column, row], which is framed.
    pub pinned: Option<[u32; 2]>,
    /// Window of pixels that the kernel panel explains.
    pub marked: Option<Marked>,
    /// Size of the canvas, in points.
    pub size: Vec2,
    /// Pixels per point.
    pub scale: f32,
    /// Dark or light.
    pub theme: Theme,
}

/// A file that is being written. Dropping this value waits until the file is complete.
#[derive(Debug)]
pub struct Saving {
    path: PathBuf,
    answer: Receiver<Result<String>>,
    thread: Option<JoinHandle<()>>,
}

impl Saving {
    /// Starts to write a file; an existing file is replaced.
    ///
    /// # Errors
    /// [`Error::Device`] if the system cannot start a thread.
    pub fn start(gpu: &Gpu, content: Content, path: PathBuf, context: &Context) -> Result<Self> {
        let (sender, answer) = channel();
        let (gpu, context, to) = (gpu.clone(), context.clone(), path.clone());
        let write = move || {
            // Nobody waits for the answer once the window is closed.
            let _ = sender.send(content.write(&gpu, &to));
            context.request_repaint();
        };
        let thread = std::thread::Builder::new().name("stein-saving".into()).spawn(write).map_err(no_thread)?;
        Ok(Self { path, answer, thread: Some(thread) })
    }

    /// Returns the message for the user; pending while the file is being written.
    pub fn answer(&self) -> Poll<Result<String>> {
        match self.answer.try_recv() {
            Ok(answer) => Poll::Ready(answer),
            Err(TryRecvError::Empty) => Poll::Pending,
            Err(TryRecvError::Disconnected) => Poll::Ready(Err(Error::File {
                path: self.path.clone(),
                cause: FileCause::Defect {
                    problem: "writing it ended with a panic".into(),
                    with: "the file that was open",
                },
            })),
        }
    }
}

impl Drop for Saving {
    fn drop(&mut self) {
        if let Some(thread) = self.thread.take() {
            // A panic in the thread was already reported.
            let _ = thread.join();
        }
    }
}

impl Content {
    /// Writes the file. Returns the message for the user.
    fn write(self, gpu: &Gpu, path: &Path) -> Result<String> {
        let mut notes = Vec::new();
        let format = Format::from_extension(path).filter(|format| *format != Format::OpenExr);
        match self {
            Self::Result { request: None, estimate, .. } if let Some(format) = format => {
                notes = write_color(path, &estimate.color, format)?;
            }
            Self::View(sight) => sight.picture(gpu)?.write_png(path)?,
            Self::Layer(layer, display) => picture_of(gpu, &layer, display)?.write_png(path)?,
            Self::Parameters(parameters) => {
                atomic_file::write(path, parameters.to_toml().as_bytes()).map_err(|error| Error::File {
                    path: path.to_owned(),
                    cause: FileCause::Unwritable { reason: error.to_string() },
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
                let written = write_estimate(&estimate, BufferSet::read(&request)?, path, &[], &method)?;
                notes.extend(format.map(|_| "without other layers".to_owned()));
                notes.extend(written.notes);
                let along = written.along.iter().map(|name| text::name(name));
                notes.extend((!written.along.is_empty()).then(|| format!("along: {}", text::list(along))));
            }
        }
        notes.insert(0, format!("Wrote {}", short_name(path)));
        Ok(notes.join("; "))
    }
}

/// Writes a colour as PFM or PNG. Returns remarks for the user.
fn write_color(path: &Path, color: &Image, format: Format) -> Result<Vec<String>> {
    let counts = picture_file::write(path, color, format, PngEncoding::Srgb)?;
    Ok(std::iter::once("the colour alone".to_owned()).chain(counts.notes()).collect())
}

impl Sight {
    fn picture(&self, gpu: &Gpu) -> Result<Picture> {
        let mut window = Offscreen::new(gpu, self.size.x, self.size.y, self.scale)?;
        window.context().set_theme(self.theme);
        style::apply(window.context());
        let mut view = View::new(self.display.clone())?;
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
        // The fonts are ready from the second frame on.
        draw()?;
        draw()
    }
}

/// Draws a layer at its own size, with nothing over it.
fn picture_of(gpu: &Gpu, layer: &Layer, display: Display) -> Result<Picture> {
    let extent = layer.image().extent;
    let most = gpu.wgpu_device().limits().max_texture_dimension_2d;
    if extent.width.max(extent.height) > most {
        return Err(Error::Device(DeviceCause::Other {
            problem: format!(
                "a picture of {extent} pixels is too large for '{}', which draws {most} along each side",
                gpu.summary().name
            ),
            remedy: "save the view, or the result as OpenEXR".into(),
        }));
    }
    let size = Vec2::new(extent.width as f32, extent.height as f32);
    let mut window = Offscreen::new(gpu, size.x, size.y, 1.0)?;
    let mut view = View::new(display)?;
    view.begin_frame(window.format());
    window.frame(|ui| view.paint_whole(ui.painter(), Rect::from_min_size(Pos2::ZERO, size), layer, layer.shown.clone()))
}
