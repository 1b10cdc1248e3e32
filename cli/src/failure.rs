//! How a command ends when it does not end well.

use std::fmt::Display;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use stein::Error;
use stein::text;
use stein_exr::BufferSetRequest;

/// Exit code if an input file or layer cannot be used.
const INPUT: u8 = 3;

/// A message for stderr and the exit code that goes with it.
#[derive(Clone, Debug)]
pub(crate) struct Failure {
    code: u8,
    message: String,
}

impl Failure {
    /// Contradicting or impossible arguments; clap uses the same code.
    pub(crate) fn usage(message: impl Display) -> Self {
        Self { code: 2, message: with_options(message) }
    }

    /// An input file or layer cannot be used.
    pub(crate) fn input(message: impl Display) -> Self {
        Self { code: INPUT, message: with_options(message) }
    }

    /// The output cannot be written.
    pub(crate) fn output(message: impl Display) -> Self {
        Self { code: 5, message: with_options(message) }
    }

    /// The self test found results out of their bounds.
    pub(crate) fn out_of_bounds(message: impl Display) -> Self {
        Self { code: 6, message: message.to_string() }
    }

    /// Any other failure.
    pub(crate) fn other(message: impl Display) -> Self {
        Self { code: 1, message: with_options(message) }
    }

    /// Converts a library error about a file whose path the library does not know.
    pub(crate) fn in_file(path: &Path, error: Error) -> Self {
        match error {
            Error::Request { .. } => Self::input(format_args!("{}: {error}", text::path(path))),
            error => error.into(),
        }
    }

    /// Puts the number of the frame in front of the message, if there is one.
    pub(crate) fn in_frame(self, number: Option<u32>) -> Self {
        match number {
            Some(number) => Self { message: format!("frame {number}: {}", self.message), ..self },
            None => self,
        }
    }

    pub(crate) fn message(&self) -> &str {
        &self.message
    }

    /// Whether an input file or layer cannot be used. In a shot, such a failure concerns one frame alone.
    pub(crate) fn is_of_input(&self) -> bool {
        self.code == INPUT
    }

    /// Returns the cause in one line: the message without its remedy.
    pub(crate) fn cause(&self) -> &str {
        self.message.lines().next().unwrap_or_default()
    }

    /// Appends lines to the message.
    pub(crate) fn and(mut self, lines: &str) -> Self {
        self.message = format!("{}\n{lines}", self.message);
        self
    }

    /// Prints the message to standard error.
    pub(crate) fn tell(&self) {
        // Ignores errors: nobody reads a closed standard error.
        let _ = writeln!(std::io::stderr(), "stein: error: {}", text::message(&self.message));
    }

    pub(crate) fn exit_code(&self) -> ExitCode {
        self.code.into()
    }
}

/// Terms in the library's remedies, each with its replacement on the command line, besides the options of
/// [`BufferSetRequest`].
const WORDS: [(&str, &str); 8] = [
    (
        "name the layer to take (`BufferSetRequest::layer`, `LayerRef::layer`)",
        "name the layer to take: --layer NAME for the input, FILE::NAME for other files",
    ),
    ("the memory limit (`Denoiser::with_max_memory`)", "--max-memory"),
    ("the memory limit", "--max-memory"),
    ("a smaller window", "a smaller --radius (dfc, nlm)"),
    ("fewer frames beside", "a smaller --temporal-radius"),
    ("choose another adapter", "choose another adapter with --device"),
    ("`Gpu::adapters`", "`stein devices`"),
    ("`GpuOptions::pipeline_folder`", stein_exr::options::CACHE_VARIABLE),
];

/// Replaces the library's terms in a remedy by those of the command line.
fn with_options(text: impl Display) -> String {
    Error::in_words(&text.to_string(), BufferSetRequest::OPTIONS.iter().chain(&WORDS))
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let code = match &error {
            Error::File { .. } | Error::Layer { .. } | Error::Request { .. } => INPUT,
            Error::Device { .. } => 4,
            _ => 1,
        };
        Self { code, message: with_options(error) }
    }
}

#[cfg(test)]
#[path = "../../tests/common/remedies.rs"]
mod remedies;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remedies_name_nothing_that_only_programmers_know() {
        remedies::name_no_items(|remedy| with_options(format_args!("remedy: {remedy}")));
    }
}
