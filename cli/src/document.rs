//! Words for JSON documents of earlier runs that cannot be used.

use stein::text;
use stein_exr::json_document::{DocumentCause, DocumentError};

use super::Failure;

/// Returns the failure for a document. `origin` says where such a document comes from, as in "was not written by …".
pub(crate) fn unusable(DocumentError { path, cause }: &DocumentError, origin: &str, remedy: &str) -> Failure {
    let problem = match cause {
        DocumentCause::OtherSchema => format!("was not {origin}"),
        cause => cause.to_string(),
    };
    Failure::input(format_args!("{}: {problem}\n  remedy: {remedy}", text::path(path)))
}
