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

/// Endings of the files that hold pictures.
pub const ENDINGS: [&str; 3] = ["exr", "pfm", "png"];

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

    /// Returns the choices of the dialog: names of formats, each with the endings of its files. The first ending is the
    /// one that a file to write gets.
    fn formats(self) -> &'static [(&'static str, &'static [&'static str])] {
        match self {
            Self::Input | Self::Reference => &[("OpenEXR, PFM, PNG", &ENDINGS)],
            Self::SaveResult => {
                &[("OpenEXR", &["exr"]), ("PFM (colour and alpha)", &["pfm"]), ("PNG (colour and alpha)", &["png"])]
            }
            Self::SaveView | Self::SaveLayer => &[("PNG", &["png"])],
            Self::Parameters | Self::SaveParameters => &[("TOML", &["toml"])],
        }
    }

    /// Returns all endings of the formats.
    fn endings(self) -> impl Iterator<Item = &'static str> {
        self.formats().iter().flat_map(|(_, endings)| endings.iter().copied())
    }

    /// Returns whether a file is written.
    fn saves(self) -> bool {
        matches!(self, Self::SaveView | Self::SaveLayer | Self::SaveResult | Self::SaveParameters)
    }

    /// Returns the path with the ending of the first format, if the path has no ending or another one than those of the
    /// formats, such as the number of a frame. Keeps the path if the complete path exists, because the user was not
    /// asked about replacing that file.
    #[must_use]
    pub fn with_ending(self, path: PathBuf) -> PathBuf {
        let has_ending =
            path.extension().is_some_and(|own| self.endings().any(|ending| own.eq_ignore_ascii_case(ending)));
        let complete = self.endings().next().map_or_else(|| path.clone(), |ending| path.with_added_extension(ending));
        if has_ending || complete.exists() { path } else { complete }
    }
}

/// A dialog that is open.
#[derive(Debug)]
pub struct Dialog {
    purpose: Purpose,
    answer: Receiver<Result<Vec<PathBuf>>>,
}

impl Dialog {
    /// Opens a dialog in the folder of `beside`. A file to write is called `name` unless the user changes that.
    ///
    /// # Errors
    /// [`Error::Device`] if the system cannot start a thread.
    pub fn open(purpose: Purpose, beside: Option<&Path>, name: &str, context: &Context) -> Result<Self> {
        let (sender, answer) = channel();
        let dialog = rfd::FileDialog::new().set_title(purpose.title());
        let formats = purpose.formats().iter();
        let dialog = formats.fold(dialog, |dialog, (format, endings)| dialog.add_filter(*format, endings));
        let dialog = match purpose.endings().next().filter(|_| purpose.saves()) {
            Some(ending) => dialog.set_file_name(format!("{name}.{ending}")),
            None => dialog,
        };
        let dialog = match beside.and_then(Path::parent) {
            Some(folder) => dialog.set_directory(folder),
            None => dialog,
        };
        let context = context.clone();
        let ask = move || {
            let asked = Instant::now();
            let paths = if purpose.saves() {
                dialog.save_file().map(|path| purpose.with_ending(path)).into_iter().collect()
            } else if purpose == Purpose::Input {
                whole_paths(dialog.pick_files().unwrap_or_default())
            } else {
                dialog.pick_file().into_iter().collect()
            };
            // Nobody waits for the answer once the window is closed.
            let _ = sender.send(answered(paths, asked.elapsed()));
            context.request_repaint();
        };
        std::thread::Builder::new().name("stein-dialog".into()).spawn(ask).map_err(no_thread)?;
        Ok(Self { purpose, answer })
    }

    /// Returns the chosen files, of which there may be none and, for an input, several; pending while the dialog is
    /// open.
    pub fn answer(&self) -> Poll<Result<(Purpose, Vec<PathBuf>)>> {
        match self.answer.try_recv() {
            Ok(answer) => Poll::Ready(answer.map(|paths| (self.purpose, paths))),
            Err(TryRecvError::Disconnected) => Poll::Ready(Ok((self.purpose, Vec::new()))),
            Err(TryRecvError::Empty) => Poll::Pending,
        }
    }
}

/// Mends paths that a dialog of `zenity` gives: it separates them by `|`, which a path may hold as well.
fn whole_paths(mut paths: Vec<PathBuf>) -> Vec<PathBuf> {
    paths.retain(|path| !path.as_os_str().is_empty());
    if paths.iter().all(|path| path.exists()) {
        return paths;
    }
    let whole = PathBuf::from(paths.iter().map(|path| path.as_os_str()).collect::<Vec<_>>().join("|".as_ref()));
    if whole.exists() { vec![whole] } else { paths }
}

/// Returns the answer of a dialog, or an error if the system cannot show dialogs: such a dialog ends without an answer
/// as if the user had closed it, but at once.
fn answered(paths: Vec<PathBuf>, after: Duration) -> Result<Vec<PathBuf>> {
    if !paths.is_empty() || after >= SOONEST {
        return Ok(paths);
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
            ("a.pfm", "a.pfm"),
            ("a.PNG", "a.PNG"),
        ] {
            assert_eq!(named(name), folder.path().join(file), "{name}");
        }
    }

    #[test]
    fn a_dialog_that_was_never_shown_is_told_from_one_that_was_closed() {
        let (at_once, later) = (Duration::from_millis(3), Duration::from_secs(2));
        assert_eq!(answered(vec!["a.exr".into()], at_once).ok(), Some(vec!["a.exr".into()]));
        assert_eq!(answered(Vec::new(), later).ok(), Some(Vec::new()));
        assert!(matches!(answered(Vec::new(), at_once), Err(Error::Request { .. })));
    }

    #[test]
    fn a_path_with_the_separator_of_a_dialog_stays_whole() {
        let folder = tempfile::tempdir().expect("a folder");
        let [odd, other] = ["a|b.exr", "c.exr"].map(|name| folder.path().join(name));
        std::fs::write(&other, "").expect("a file");
        assert_eq!(whole_paths(vec![other.clone(), "".into()]), std::slice::from_ref(&other));
        let parts = || vec![folder.path().join("a"), "b.exr".into()];
        assert_eq!(whole_paths(parts()), parts());
        if std::fs::write(&odd, "").is_ok() {
            assert_eq!(whole_paths(parts()), [odd]);
        }
    }
}
