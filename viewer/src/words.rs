//! Errors of the library, in the words of this program.

use stein::{Error, text};
use stein_exr::BufferSetRequest;

/// Phrases of the library's remedies with their replacements here, besides the options of [`BufferSetRequest`].
const WORDS: [(&str, &str); 8] = [
    (
        "name the layer to take (`BufferSetRequest::layer`, `LayerRef::layer`)",
        "name the layer to take behind its file, on the command line: FILE::NAME",
    ),
    // The viewer has no memory limit.
    ("raise the memory limit (`Denoiser::with_max_memory`), ", ""),
    ("the memory limit", "the memory limit of `stein denoise` (--max-memory)"),
    ("a smaller window", "a smaller `window_radius` (dfc, nlm)"),
    (" or fewer frames beside", ""),
    ("choose another adapter", "choose another adapter with --device"),
    ("`Gpu::adapters`", "`stein devices`"),
    ("`GpuOptions::pipeline_folder`", stein_exr::options::CACHE_VARIABLE),
];

/// Returns the text of an error for people, with its remedy.
pub fn told(error: &Error) -> String {
    let told = Error::in_words(&error.to_string(), BufferSetRequest::OPTIONS.iter().chain(&WORDS));
    text::message(&told).into_owned()
}

#[cfg(test)]
#[path = "../../tests/common/remedies.rs"]
mod remedies;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remedies_name_nothing_that_only_programmers_know() {
        remedies::name_no_items(|remedy| told(&Error::Request { problem: String::new(), remedy }));
    }
}
