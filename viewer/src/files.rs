//! File dialogs, each in a thread of its own so that the window continues.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::task::Poll;
use std::time::{Duration, Instant};

use eframe::egui::Context;
use stein::error::RequestCause;
use stein::{Error, Result, text};

use crate::device::no_thread;

/// A dialog that ends within this time without an answer never appeared: nobody closes one that fast.
const SOONEST: Duration = Duration::from_millis(400);

/// Purpose of a file that the user is to choose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Buffer set to denoise.
    Input,
    /// Reference to compare with.
    Reference,
    /// Parameters to denoise with.
    Parameters,
    /// File for the view of the canvas.
    SaveView,
    /// File for layer A at its own size.
    SaveLayer,
    /// File for the denoised frame.
    SaveResult,
    /// File for the parameters in use.
    SaveParameters,
}

impl Purpose {
    /// Returns the title of the dialog.
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

    /// Returns the name of the format, and the ending of its files.
    fn format(self) -> (&'static str, &'static str) {
        match self {
            Self::Input | Self::Reference | Self::SaveResult => ("OpenEXR", "exr"),
            Self::SaveView | Self::SaveLayer => ("PNG", "png"),
            Self::Parameters | Self::SaveParameters => ("TOML", "toml"),
        }
    }

    /// Returns whether a file is written.
    fn saves(self) -> bool {
        matches!(self, Self::SaveView | Self::SaveLayer | Self::SaveResult | Self::SaveParameters)
    }

    /// Returns the path with the ending of the format, if the path has no ending or another one, such as the number of
    /// a frame. Keeps the path if the complete path exists, because the user was not asked about replacing that file.
    #[must_use]
    pub fn with_ending(self, path: PathBuf) -> PathBuf {
        let ending = self.format().1;
        let has_ending = path.extension().is_some_and(|own| own.eq_ignore_ascii_case(ending));
        let complete = path.with_added_extension(ending);
        if has_ending || complete.exists() { path } else { complete }
    }
}

/// A dialog that is open.
#[derive(Debug)]
pub struct Dialog {
    purpose: Purpose,
    answer: Receiver<Result<Option<PathBuf>>>,
}

impl Dialog {
    /// Opens a dialog in the folder of `beside`. A file to write is called `name` unless the user changes that.
    ///
    /// # Errors
    /// [`Error::Device`] if the system cannot start a thread.
    pub fn open(purpose: Purpose, beside: Option<&Path>, name: &str, context: &Context) -> Result<Self> {
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
            let asked = Instant::now();
            let path = if purpose.saves() {
                dialog.save_file().map(|path| purpose.with_ending(path))
            } else {
                dialog.pick_file()
            };
            // Nobody waits for the answer once the window is closed.
            let _ = sender.send(answered(path, asked.elapsed()));
            context.request_repaint();
        };
        std::thread::Builder::new().name("stein-dialog".into()).spawn(ask).map_err(no_thread)?;
        Ok(Self { purpose, answer })
    }

    /// Returns the chosen file, if the user chose one; pending while the dialog is open.
    pub fn answer(&self) -> Poll<Result<Option<(Purpose, PathBuf)>>> {
        match self.answer.try_recv() {
            Ok(answer) => Poll::Ready(answer.map(|path| path.map(|path| (self.purpose, path)))),
            Err(TryRecvError::Disconnected) => Poll::Ready(Ok(None)),
            Err(TryRecvError::Empty) => Poll::Pending,
        }
    }
}

/// Returns the answer of a dialog, or an error if the system cannot show dialogs: such a dialog ends without an answer
/// as if the user had closed it, but at once.
fn answered(path: Option<PathBuf>, after: Duration) -> Result<Option<PathBuf>> {
    if path.is_some() || after >= SOONEST {
        return Ok(path);
    }
    Err(Error::Request(RequestCause::Other {
        problem: "no file dialog can be shown".into(),
        remedy: "install zenity, or the xdg-desktop-portal of your desktop; files to open can also be dropped on the \
                 window, or named on the command line"
            .into(),
    }))
}

/// Returns whether the name of a dropped file marks it as a reference.
pub fn is_reference(path: &Path) -> bool {
    let name = path.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    name.contains("reference") || name.contains("ground_truth") || name.ends_with("_ref")
}

/// Returns the name of a file for people, without its folder.
pub fn short_name(path: &Path) -> String {
    text::path(path.file_name().map_or(path, Path::new))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_have_the_ending_of_their_format() {
        let folder = tempfile::tempdir().expect("a folder");
        let taken = folder.path().join("taken.exr");
        std::fs::write(&taken, "").expect("a file");
        let named = |name: &str| Purpose::SaveResult.with_ending(folder.path().join(name));
        for (name, file) in [
            ("a", "a.exr"),
            ("a.EXR", "a.EXR"),
            ("shot.0001", "shot.0001.exr"),
            ("taken", "taken"),
            ("taken.exr", "taken.exr"),
        ] {
            assert_eq!(named(name), folder.path().join(file), "{name}");
        }
    }

    #[test]
    fn a_dialog_that_was_never_shown_is_told_from_one_that_was_closed() {
        let (at_once, later) = (Duration::from_millis(3), Duration::from_secs(2));
        assert_eq!(answered(Some("a.exr".into()), at_once).ok(), Some(Some("a.exr".into())));
        assert!(
            matches!(answered(None, later), Ok(None)) && matches!(answered(None, at_once), Err(Error::Request { .. }))
        );
    }
}
