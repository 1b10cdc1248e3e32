//! How a command ends when it does not end well.

use std::fmt::{Arguments, Display};
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use stein::Error;
use stein::error::Remedy;
use stein::text;
use stein_exr::options;

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
    pub(crate) fn usage(message: impl Message) -> Self {
        Self { code: 2, message: message.in_words() }
    }

    /// An input file or layer cannot be used.
    pub(crate) fn input(message: impl Message) -> Self {
        Self { code: INPUT, message: message.in_words() }
    }

    /// The output cannot be written.
    pub(crate) fn output(message: impl Message) -> Self {
        Self { code: 5, message: message.in_words() }
    }

    /// The self test found results out of their bounds.
    pub(crate) fn out_of_bounds(message: impl Message) -> Self {
        Self { code: 6, message: message.in_words() }
    }

    /// Any other failure.
    pub(crate) fn other(message: impl Message) -> Self {
        Self { code: 1, message: message.in_words() }
    }

    /// Converts a library error about a file whose path the library does not know.
    pub(crate) fn in_file(path: &Path, error: Error) -> Self {
        error.in_file(path).into()
    }

    /// Takes the failure for one of an input.
    pub(crate) fn of_input(self) -> Self {
        Self { code: INPUT, ..self }
    }

    /// Puts the number of the frame in front of the message, if there is one.
    pub(crate) fn in_frame(self, number: Option<u32>) -> Self {
        match number {
            Some(number) => self.at(format_args!("frame {number}")),
            None => self,
        }
    }

    /// Puts a place in front of the message, such as an option.
    pub(crate) fn at(self, place: impl Display) -> Self {
        Self { message: format!("{place}: {}", self.message), ..self }
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

/// What a failure says: words of this program, or an error of the library.
pub(crate) trait Message {
    /// Returns the message for people.
    fn in_words(self) -> String;
}

impl Message for &str {
    fn in_words(self) -> String {
        self.into()
    }
}

impl Message for String {
    fn in_words(self) -> String {
        self
    }
}

impl Message for Arguments<'_> {
    fn in_words(self) -> String {
        self.to_string()
    }
}

impl Message for Error {
    fn in_words(self) -> String {
        (&self).in_words()
    }
}

impl Message for &Error {
    fn in_words(self) -> String {
        self.message(|remedy| Some(with_options(&remedy)))
    }
}

/// Returns a remedy in the words of the command line.
fn with_options(remedy: &Remedy) -> String {
    match remedy {
        Remedy::NameLayer => "name the layer to take: --layer NAME for the input, FILE::NAME for other files".into(),
        Remedy::RaiseMemoryLimit => "raise --max-memory".into(),
        Remedy::LowerMemoryLimit => "lower --max-memory".into(),
        Remedy::SmallerWindow => "choose a smaller --radius (dfc, nlm)".into(),
        Remedy::FewerFramesBeside => "choose a smaller --temporal-radius".into(),
        Remedy::AnotherMethod => "choose another --method".into(),
        remedy => options::remedy(remedy),
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let code = match &error {
            Error::File { .. } | Error::Layer { .. } | Error::Request { .. } => INPUT,
            Error::Device { .. } => 4,
            _ => 1,
        };
        Self { code, message: error.in_words() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remedies_name_nothing_that_only_programmers_know() {
        for remedy in Remedy::all() {
            let told = with_options(&remedy);
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
