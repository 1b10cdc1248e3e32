//! Errors, with their data. A program adds remedies in its own words.

use std::io;
use std::path::PathBuf;

use stein::text;

use crate::external::ExternalCause;
use crate::folder::FolderCause;

/// The result of everything here that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// The reason why nothing is measured or reported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The library fails, or a file cannot be read.
    #[error("{}", .0.problem())]
    Stein(#[from] stein::Error),
    /// The parameters of a configuration are impossible.
    #[error("{}", .0.problem())]
    Method(stein::Error),
    /// Two configurations have the same name.
    #[error("there are two configurations of the name {name}")]
    SameName {
        /// The name.
        name: String,
    },
    /// There is neither one reference for each input nor none.
    #[error("{references} references are given for {inputs} inputs")]
    ReferenceCount {
        /// Number of references.
        references: usize,
        /// Number of inputs.
        inputs: usize,
    },
    /// A reference is given for a folder, which may hold many sets.
    #[error("{}: is a folder, which has no reference of its own", text::path(folder))]
    ReferenceOfFolder {
        /// The folder.
        folder: PathBuf,
    },
    /// A folder holds no sets.
    #[error("{}: holds no OpenEXR file but references", text::path(folder))]
    NoSets {
        /// The folder.
        folder: PathBuf,
    },
    /// A file cannot be opened.
    #[error("{}: cannot be read: {error}", text::path(path))]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        error: io::Error,
    },
    /// A folder cannot be listed.
    #[error("{}: {error}", text::path(folder))]
    UnreadableFolder {
        /// The folder.
        folder: PathBuf,
        /// Error of the system.
        error: io::Error,
    },
    /// A path cannot be made absolute.
    #[error("{}: {error}", text::path(path))]
    Path {
        /// The path.
        path: PathBuf,
        /// Error of the system.
        error: io::Error,
    },
    /// A set is an output of stein.
    #[error("{}: was written by stein", text::path(file))]
    WrittenByStein {
        /// File of the set.
        file: PathBuf,
    },
    /// A configuration needs halves, and the set has none.
    #[error("{}: it has no halves that can be used", text::path(file))]
    NoHalves {
        /// File of the set.
        file: PathBuf,
    },
    /// No set could be measured.
    #[error("nothing was measured")]
    NothingMeasured,
    /// Another denoiser fails.
    #[error("{name}: {cause}")]
    External {
        /// Name of the denoiser.
        name: String,
        /// Cause of the failure.
        cause: Box<ExternalCause>,
    },
    /// The messages of another denoiser cannot be kept in a file.
    #[error("{}: {error}", text::path(path))]
    Log {
        /// File of the messages, in the folder for temporary files.
        path: PathBuf,
        /// Error of the system.
        error: io::Error,
    },
    /// The folder of a report cannot be used.
    #[error("{}: {cause}", text::path(folder))]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// Cause of the failure.
        cause: FolderCause,
    },
    /// A part of a report cannot be made.
    #[error("{part}: {reason}")]
    Part {
        /// The part: `results.csv`.
        part: &'static str,
        /// Message of its format.
        reason: String,
    },
    /// The observer ended the run.
    #[error("cancelled")]
    Cancelled,
}
