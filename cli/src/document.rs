//! JSON documents that this program wrote, read by a later run.

use std::path::Path;

use serde::de::DeserializeOwned;
use stein::text;

use super::Failure;

/// Largest size of a document in bytes: far more than any of our reports takes.
const MOST_BYTES: u64 = 256 << 20;

/// Marks that identify a kind of document.
pub(crate) struct Kind {
    /// Value of the field `schema`.
    pub(crate) schema: &'static str,
    /// Value of the field `version`.
    pub(crate) version: u32,
    /// Origin of the document, such as "written by `stein bench`".
    pub(crate) made: &'static str,
    /// Advice for a file that is no such document.
    pub(crate) remedy: &'static str,
}

/// Reads a document.
pub(crate) fn read<D: DeserializeOwned>(path: &Path, kind: &Kind) -> Result<D, Failure> {
    let Kind { schema, version, made, remedy } = kind;
    let failed = |problem: String| Failure::input(format_args!("{}: {problem}\n  remedy: {remedy}", text::path(path)));
    let text = text::read_file(path, MOST_BYTES).map_err(|error| failed(format!("cannot be read: {error}")))?;
    let value: serde_json::Value =
        serde_json::from_str(&text).map_err(|error| failed(format!("is not JSON: {error}")))?;
    if value["schema"] != *schema {
        return Err(failed(format!("was not {made}")));
    }
    if value["version"] != *version {
        return Err(failed(format!("has version {} of the format, not {version}", value["version"])));
    }
    serde_json::from_value(value).map_err(|error| failed(format!("is damaged: {error}")))
}
