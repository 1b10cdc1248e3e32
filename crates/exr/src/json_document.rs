//! JSON documents that a program of ours wrote, read by a later run.

use std::io;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde_json::Value;
use stein::text;

/// Largest size of a document in bytes: far more than any of our reports takes.
const MOST_BYTES: u64 = 256 << 20;

/// Marks that identify a kind of document.
#[derive(Clone, Copy, Debug)]
pub struct Kind {
    /// Value of the field `schema`.
    pub schema: &'static str,
    /// Value of the field `version`.
    pub version: u32,
}

/// The reason why a document cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{}: {cause}", text::path(path))]
pub struct DocumentError {
    /// File of the document.
    pub path: PathBuf,
    /// Cause of the failure.
    pub cause: DocumentCause,
}

/// What is wrong with a document.
#[derive(Debug, thiserror::Error)]
pub enum DocumentCause {
    /// The file cannot be read.
    #[error("cannot be read: {0}")]
    Unreadable(io::Error),
    /// The file holds no JSON.
    #[error("is not JSON: {0}")]
    NotJson(serde_json::Error),
    /// The document has another schema, or none.
    #[error("is a document of another kind")]
    OtherSchema,
    /// The document is of another version of the format.
    #[error("has version {found} of the format, not {known}")]
    OtherVersion {
        /// Value in the document.
        found: Value,
        /// Version that can be read.
        known: u32,
    },
    /// Fields are missing or have other types.
    #[error("is damaged: {0}")]
    Damaged(serde_json::Error),
}

/// Reads a document.
///
/// # Errors
/// [`DocumentError`] for a file that is no document of this kind.
pub fn read<D: DeserializeOwned>(path: &Path, kind: Kind) -> Result<D, DocumentError> {
    let failed = |cause| DocumentError { path: path.to_owned(), cause };
    let text = text::read_file(path, MOST_BYTES).map_err(|error| failed(DocumentCause::Unreadable(error)))?;
    let value: Value = serde_json::from_str(&text).map_err(|error| failed(DocumentCause::NotJson(error)))?;
    if value["schema"] != *kind.schema {
        return Err(failed(DocumentCause::OtherSchema));
    }
    if value["version"] != kind.version {
        return Err(failed(DocumentCause::OtherVersion { found: value["version"].clone(), known: kind.version }));
    }
    serde_json::from_value(value).map_err(|error| failed(DocumentCause::Damaged(error)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_documents_of_the_kind_are_read() {
        #[derive(Debug, serde::Deserialize)]
        struct Document {
            count: u32,
        }
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("document.json");
        let ours = Kind { schema: "ours", version: 2 };
        let cause = |text: &str| {
            std::fs::write(&path, text).expect("a file");
            read::<Document>(&path, ours).map(|document| document.count).map_err(|error| error.cause)
        };
        assert!(matches!(cause(r#"{ "schema": "ours", "version": 2, "count": 3, "more": true }"#), Ok(3)));
        assert!(matches!(cause("{"), Err(DocumentCause::NotJson(_))));
        assert!(matches!(cause(r#"{ "version": 2, "count": 3 }"#), Err(DocumentCause::OtherSchema)));
        let other = cause(r#"{ "schema": "ours", "version": 1, "count": 3 }"#);
        assert!(matches!(other, Err(DocumentCause::OtherVersion { known: 2, .. })), "{other:?}");
        assert!(matches!(cause(r#"{ "schema": "ours", "version": 2 }"#), Err(DocumentCause::Damaged(_))));
        std::fs::remove_file(&path).expect("it was there");
        let missing = read::<Document>(&path, ours);
        assert!(missing.is_err_and(|error| error.to_string().contains("document.json: cannot be read: ")));
    }
}
