//! Errors of the library, in the words of this program.

use stein::error::Remedy;
use stein::{Error, text};
use stein_exr::options;

/// Returns the text of an error for people, with its remedies.
pub fn told(error: &Error) -> String {
    text::message(&error.message(|remedy| words(&remedy))).into_owned()
}

/// Returns a remedy in the words of this program; `None` for an action that it does not offer.
fn words(remedy: &Remedy) -> Option<String> {
    Some(match remedy {
        // The viewer has no memory limit, and denoises one frame at a time.
        Remedy::RaiseMemoryLimit | Remedy::FewerFramesBeside => return None,
        Remedy::LowerMemoryLimit => "denoise it with `stein denoise` and a lower --max-memory".into(),
        Remedy::SmallerWindow => "choose a smaller `window_radius` (dfc, nlm)".into(),
        Remedy::NameLayer => "name the layer to take behind its file, on the command line: FILE::NAME".into(),
        remedy => options::remedy(remedy),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remedies_name_nothing_that_only_programmers_know() {
        for remedy in Remedy::all() {
            let told = words(&remedy).unwrap_or_default();
            assert!(!names_item(&told), "{remedy:?}: {told}");
        }
    }

    /// Whether a text names an item of Rust: `Type`, or `module::item`.
    fn names_item(text: &str) -> bool {
        let starts = |marker: &str, is_first: fn(&char) -> bool| {
            text.split(marker).skip(1).any(|rest| rest.chars().next().as_ref().is_some_and(is_first))
        };
        starts("`", char::is_ascii_uppercase) || starts("::", char::is_ascii_lowercase)
    }
}
