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
}

/// A dialog that is open.
#[derive(Debug)]
pub struct Dialog {
    purpose: Purpose,
    answer: Receiver<Option<PathBuf>>,
}

impl Dialog {
    /// Opens a dialog in the folder of `beside`. `None` where the system gives no thread.
    pub fn open(purpose: Purpose, beside: Option<&Path>, context: &Context) -> Option<Self> {
        let (sender, answer) = channel();
        let title = match purpose {
            Purpose::Input => "Open a buffer set",
            Purpose::Reference => "Open a reference",
        };
        let dialog = rfd::FileDialog::new().set_title(title).add_filter("OpenEXR", &["exr"]);
        let dialog = match beside.and_then(Path::parent) {
            Some(folder) => dialog.set_directory(folder),
            None => dialog,
        };
        let context = context.clone();
        let ask = move || {
            // Where nobody waits for the answer any more, the window is closed.
            let _ = sender.send(dialog.pick_file());
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
