//! Errors: the place, the cause with its data, and remedies.
//!
//! A cause knows its remedies. [`Error`] displays both in the words of this library; a program with words of its own,
//! such as options, renders the remedies by [`Error::message`].

mod device;
mod file;
mod remedy;
mod request;

use std::fmt;
use std::path::{Path, PathBuf};

pub use device::DeviceCause;
pub use file::{FileCause, LayerCause};
pub use remedy::Remedy;
use remedy::alternatives;
pub use request::RequestCause;

use crate::text;

/// The result of everything in this library that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure: its place and its cause. [`Error::remedies`] returns what helps, so that the user knows what to do next.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Error {
    /// A file cannot be read or written.
    File {
        /// The file.
        path: PathBuf,
        /// Cause of the failure.
        cause: FileCause,
    },
    /// A layer inside a file is missing or cannot be used.
    Layer {
        /// The file.
        path: PathBuf,
        /// The layer, named as in the file.
        layer: String,
        /// Cause of the failure.
        cause: LayerCause,
    },
    /// A request is impossible: parameters contradict each other or the input.
    Request(RequestCause),
    /// No adapter, a lost device, not enough memory.
    Device(DeviceCause),
    /// A shader does not compile or does not fit its host struct: a defect of this program, not of its input.
    Shader {
        /// The stage, named as its file in `shaders/`.
        stage: String,
        /// Message of naga or of the driver.
        problem: String,
    },
    /// A renderer from outside failed.
    Renderer {
        /// Command that ran, and how it ended.
        problem: String,
        /// Action that helps the user, in the words of the program that ran the command.
        remedy: String,
    },
    /// The caller ended the work.
    Cancelled,
}

impl Error {
    /// Returns the place and the cause, in the words of this library.
    pub fn problem(&self) -> String {
        match self {
            Self::File { path, cause } => format!("{}: {cause}", text::path(path)),
            Self::Layer { path, layer, cause } => {
                format!("{}, layer '{}': {cause}", text::path(path), text::name(layer))
            }
            Self::Request(cause) => cause.to_string(),
            Self::Device(cause) => cause.to_string(),
            Self::Shader { stage, problem } => format!("stage '{stage}': {problem}"),
            Self::Renderer { problem, .. } => problem.clone(),
            Self::Cancelled => "cancelled".into(),
        }
    }

    /// Returns actions that help the user, the best one first. Each helps alone. Empty for [`Error::Cancelled`].
    pub fn remedies(&self) -> Vec<Remedy> {
        match self {
            Self::File { cause, .. } => cause.remedies(),
            Self::Layer { cause, .. } => cause.remedies(),
            Self::Request(cause) => cause.remedies(),
            Self::Device(cause) => cause.remedies(),
            Self::Shader { .. } => vec![Remedy::ReportDefect { with: "the output of `stein devices`" }],
            Self::Renderer { remedy, .. } => vec![Remedy::Other(remedy.clone())],
            Self::Cancelled => Vec::new(),
        }
    }

    /// Returns the message for people: the problem, and the remedies in the words of a program. `words` returns `None`
    /// for an action that the program does not offer.
    pub fn message(&self, words: impl FnMut(Remedy) -> Option<String>) -> String {
        let remedies: Vec<String> = self.remedies().into_iter().filter_map(words).collect();
        if remedies.is_empty() {
            return self.problem();
        }
        format!("{}\n  remedy: {}", self.problem(), alternatives(&remedies))
    }

    /// Adds the file to the error of a request that concerns its content.
    #[must_use]
    pub fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Request(cause) => Self::File { path: path.to_owned(), cause: FileCause::Request(Box::new(cause)) },
            error => error,
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message(|remedy| Some(remedy.to_string())))
    }
}

impl std::error::Error for Error {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remedies_are_alternatives_and_a_program_may_lack_some() {
        let error = Error::Device(DeviceCause::StripTooLarge { halo: 20, needed: 3 << 20, allowed: 1 << 20 });
        assert!(error.to_string().contains("needs 3 MiB of 1 MiB\n  remedy: raise the memory limit (`Denoiser::"));
        let message = error.message(|remedy| match remedy {
            Remedy::SmallerWindow => Some("choose a smaller --radius".into()),
            Remedy::LeaveFeaturesOut => Some(remedy.to_string()),
            _ => None,
        });
        assert!(message.ends_with("\n  remedy: choose a smaller --radius, or leave features out"), "{message}");
        assert_eq!(Error::Cancelled.to_string(), "cancelled");
    }

    #[test]
    fn a_request_that_concerns_a_file_names_it() {
        let error = Error::Request(RequestCause::NoSuchFrame { centre: 3, frames: 2 }).in_file(Path::new("a.exr"));
        assert!(error.to_string().starts_with("a.exr: frame 3 of a window of 2 frames"), "{error}");
    }
}
