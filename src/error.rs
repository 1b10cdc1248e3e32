//! What went wrong, in which file and layer, and what to do about it.

use std::path::PathBuf;

use crate::text;

/// The result of everything in this library that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// A failure, told so that the person who meets it knows what to do next: each message names the place, the problem and
/// the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file cannot be read or written.
    #[error("{}: {problem}\n  remedy: {remedy}", text::path(path))]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A layer inside a file is missing or cannot be used.
    #[error("{}, layer '{}': {problem}\n  remedy: {remedy}", text::path(path), text::name(layer))]
    Layer {
        /// The file.
        path: PathBuf,
        /// The layer, named as in the file.
        layer: String,
        /// What is wrong with it.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// What was asked for cannot be done: parameters that contradict each other or the input.
    #[error("{problem}\n  remedy: {remedy}")]
    Request {
        /// What cannot be done, and why.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// No adapter, a lost device, not enough memory.
    #[error("{problem}\n  remedy: {remedy}")]
    Device {
        /// What the device or its driver reported.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// A shader does not compile or does not fit its host struct: a defect of this program, not of its input.
    #[error(
        "stage '{stage}': {problem}\n  remedy: this is a defect of stein: please report it with the output of `stein devices`"
    )]
    Shader {
        /// The stage, named as its file in `shaders/`.
        stage: String,
        /// What naga or the driver said.
        problem: String,
    },
    /// A renderer from outside failed.
    #[error("{problem}\n  remedy: {remedy}")]
    Renderer {
        /// What was run and how it ended.
        problem: String,
        /// What the user can do.
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
