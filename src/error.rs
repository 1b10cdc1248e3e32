//! Errors: the cause, the file and layer, and a remedy.

use std::path::PathBuf;

use crate::text;

/// The result of everything in this library that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure. Each message names the place, the problem and a remedy, so that the user knows what to do next.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file cannot be read or written.
    #[error("{}: {problem}\n  remedy: {remedy}", text::path(path))]
    File {
        /// The file.
        path: PathBuf,
        /// Cause of the failure.
        problem: String,
        /// Action that helps the user.
        remedy: String,
    },
    /// A layer inside a file is missing or cannot be used.
    #[error("{}, layer '{}': {problem}\n  remedy: {remedy}", text::path(path), text::name(layer))]
    Layer {
        /// The file.
        path: PathBuf,
        /// The layer, named as in the file.
        layer: String,
        /// Cause of the failure.
        problem: String,
        /// Action that helps the user.
        remedy: String,
    },
    /// A request is impossible: parameters contradict each other or the input.
    #[error("{problem}\n  remedy: {remedy}")]
    Request {
        /// Impossible request, and the reason.
        problem: String,
        /// Action that helps the user.
        remedy: String,
    },
    /// No adapter, a lost device, not enough memory.
    #[error("{problem}\n  remedy: {remedy}")]
    Device {
        /// Report of the device or its driver.
        problem: String,
        /// Action that helps the user.
        remedy: String,
    },
    /// A shader does not compile or does not fit its host struct: a defect of this program, not of its input.
    #[error(
        "stage '{stage}': {problem}\n  remedy: this is a defect of stein: please report it with the output of `stein devices`"
    )]
    Shader {
        /// The stage, named as its file in `shaders/`.
        stage: String,
        /// Message of naga or of the driver.
        problem: String,
    },
    /// A renderer from outside failed.
    #[error("{problem}\n  remedy: {remedy}")]
    Renderer {
        /// Command that ran, and how it ended.
        problem: String,
        /// Action that helps the user.
        remedy: String,
    },
    /// The caller ended the work.
    #[error("cancelled")]
    Cancelled,
}

impl Error {
    /// A message of this library in the words of a program, which has options where the remedies name fields and
    /// functions. Each pair is what a remedy says and what takes its place, the first before the second. What is no
    /// remedy stays as it is.
    pub fn in_words<'a>(message: &str, words: impl IntoIterator<Item = &'a (&'a str, &'a str)>) -> String {
        let Some((problem, remedy)) = message.split_once("remedy: ") else { return message.to_owned() };
        let remedy = words.into_iter().fold(remedy.to_owned(), |remedy, (said, instead)| remedy.replace(said, instead));
        format!("{problem}remedy: {remedy}")
    }
}
