//! The progress bar.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};

/// Whether somebody watches standard error.
pub(crate) fn is_watched() -> bool {
    std::io::stderr().is_terminal()
}

/// A bar on standard error, hidden where it is not wanted or nobody watches.
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
