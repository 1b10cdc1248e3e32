//! File dialogs, each in a thread of its own so that the window goes on.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::task::Poll;

use eframe::egui::Context;

/// What a file is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// To be denoised.
    Input,
    /// To compare with.
    Reference,
    /// Parameters to denoise with.
    Parameters,
    /// For what the canvas shows.
    SaveView,
    /// For the layer A at its own size.
    SaveLayer,
    /// For the denoised frame.
    SaveResult,
    /// For the parameters in use.
    SaveParameters,
}

impl Purpose {
    /// What the dialog is called.
    fn title(self) -> &'static str {
        match self {
            Self::Input => "Open a buffer set",
            Self::Reference => "Open a reference",
            Self::Parameters => "Load parameters",
            Self::SaveView => "Save the view",
            Self::SaveLayer => "Save the layer",
            Self::SaveResult => "Save the result",
            Self::SaveParameters => "Save the parameters",
        }
    }

    /// The format, and the ending of its files.
    fn format(self) -> (&'static str, &'static str) {
        match self {
            Self::Input | Self::Reference | Self::SaveResult => ("OpenEXR", "exr"),
            Self::SaveView | Self::SaveLayer => ("PNG", "png"),
            Self::Parameters | Self::SaveParameters => ("TOML", "toml"),
        }
    }

    /// Whether a file is written.
    fn saves(self) -> bool {
        matches!(self, Self::SaveView | Self::SaveLayer | Self::SaveResult | Self::SaveParameters)
    }

    /// A path with the ending of the format, where it has none; but for one that exists, which nobody was asked about.
    #[must_use]
    pub fn with_ending(self, path: PathBuf) -> PathBuf {
        let complete = path.with_extension(self.format().1);
        if path.extension().is_none() && !complete.exists() { complete } else { path }
    }
}

/// A dialog that is open.
#[derive(Debug)]
pub struct Dialog {
    purpose: Purpose,
    answer: Receiver<Option<PathBuf>>,
}

impl Dialog {
    /// Opens a dialog in the folder of `beside`, where a file to write is to be called `name`. `None` where the system gives no thread.
    pub fn open(purpose: Purpose, beside: Option<&Path>, name: &str, context: &Context) -> Option<Self> {
        let (sender, answer) = channel();
        let (format, ending) = purpose.format();
        let dialog = rfd::FileDialog::new().set_title(purpose.title()).add_filter(format, &[ending]);
        let dialog = if purpose.saves() { dialog.set_file_name(format!("{name}.{ending}")) } else { dialog };
        let dialog = match beside.and_then(Path::parent) {
            Some(folder) => dialog.set_directory(folder),
            None => dialog,
        };
        let context = context.clone();
        let ask = move || {
            // Where nobody waits for the answer any more, the window is closed.
            let _ = sender.send(if purpose.saves() { dialog.save_file().map(|path| purpose.with_ending(path)) } else { dialog.pick_file() });
            context.request_repaint();
        };
        std::thread::Builder::new().name("stein-dialog".into()).spawn(ask).ok().map(|_| Self { purpose, answer })
    }

    /// What was chosen, if anything was; pending while the dialog is open.
    pub fn answer(&self) -> Poll<Option<(Purpose, PathBuf)>> {
        match self.answer.try_recv() {
            Ok(path) => Poll::Ready(path.map(|path| (self.purpose, path))),
            Err(TryRecvError::Disconnected) => Poll::Ready(None),
            Err(TryRecvError::Empty) => Poll::Pending,
        }
    }
}

/// Whether a dropped file is meant as a reference, by its name.
pub fn is_reference(path: &Path) -> bool {
    let name = path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    name.contains("reference") || name.contains("ground_truth") || name.ends_with("_ref")
}

/// A file's name for people, without its folder.
pub fn short_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}
