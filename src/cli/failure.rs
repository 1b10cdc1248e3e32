//! How a command ends when it does not end well.

use std::fmt::Display;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use stein::Error;

/// A message for stderr and the exit code that goes with it.
#[derive(Debug)]
pub(crate) struct Failure {
    code: u8,
    message: String,
}

impl Failure {
    /// Contradicting or impossible arguments; clap uses the same code.
    pub(crate) fn usage(message: impl Display) -> Self {
        Self { code: 2, message: message.to_string() }
    }

    /// An input file or layer cannot be used.
    pub(crate) fn input(message: impl Display) -> Self {
        Self { code: 3, message: message.to_string() }
    }

    /// The output cannot be written.
    pub(crate) fn output(message: impl Display) -> Self {
        Self { code: 5, message: message.to_string() }
    }

    /// What is none of these.
    pub(crate) fn other(message: impl Display) -> Self {
        Self { code: 1, message: message.to_string() }
    }

    /// What the library says about a file without knowing which one it was.
    pub(crate) fn in_file(path: &Path, error: Error) -> Self {
        match error {
            Error::Request { .. } => Self::input(format_args!("{}: {error}", path.display())),
            error => error.into(),
        }
    }

    /// With the number of the frame in front, where there is one.
    pub(crate) fn in_frame(self, number: Option<u32>) -> Self {
        match number {
            Some(number) => Self { message: format!("frame {number}: {}", self.message), ..self },
            None => self,
        }
    }

    pub(crate) fn message(&self) -> &str {
        &self.message
    }

    /// Prints it.
    pub(crate) fn tell(&self) {
        // Where stderr is closed there is nobody to tell.
        let _ = writeln!(std::io::stderr(), "stein: error: {}", self.message);
    }

    pub(crate) fn exit_code(&self) -> ExitCode {
        self.code.into()
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let code = match &error {
            Error::File { .. } | Error::Layer { .. } | Error::Request { .. } => 3,
            Error::Device { .. } => 4,
            _ => 1,
        };
        Self { code, message: error.to_string() }
    }
}
