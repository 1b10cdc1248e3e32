//! The progress bar.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};

/// Whether standard error is a terminal, which somebody may watch.
pub(crate) fn is_watched() -> bool {
    std::io::stderr().is_terminal()
}

/// Returns a bar on standard error. The bar is hidden if `wanted` is false or nobody watches.
pub(crate) fn bar(wanted: bool, length: u64) -> ProgressBar {
    if !wanted || !is_watched() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(length);
    if let Ok(style) = ProgressStyle::with_template("{wide_bar} {percent:>3} %  {eta}") {
        bar.set_style(style);
    }
    bar
}
