//! Text and JSON on standard output.

use std::fmt::Display;
use std::io::{ErrorKind, Write};

use serde::Serialize;
use stein::text;

use super::Failure;

/// Standard output. If its reader stops reading (`stein info … | head -1`), the text ends, but not the work.
pub(crate) struct Out {
    quiet: bool,
    failed: Option<std::io::Error>,
}

impl Out {
    pub(crate) fn new() -> Self {
        Self { quiet: false, failed: None }
    }

    /// Suppresses all text for people.
    pub(crate) fn silence(&mut self) {
        self.quiet = true;
    }

    /// Prints a line for people, or several.
    pub(crate) fn say(&mut self, text: impl Display) {
        if !self.quiet {
            self.write(&text::message(&text.to_string()));
        }
    }

    /// Prints a line for the program that started this one, even if text for people is suppressed.
    pub(crate) fn line(&mut self, text: impl Display) {
        self.write(&text::message(&text.to_string()));
    }

    /// Prints the document for programs.
    pub(crate) fn json(&mut self, document: &impl Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string_pretty(document)
            .map_err(|error| Failure::output(format_args!("the JSON document: {error}")))?;
        self.write(&text);
        Ok(())
    }

    fn write(&mut self, text: &str) {
        if self.failed.is_some() {
            return;
        }
        let mut stdout = std::io::stdout().lock();
        let newline = if text.ends_with('\n') { "" } else { "\n" };
        self.failed = write!(stdout, "{text}{newline}").and_then(|()| stdout.flush()).err();
    }

    /// Fails if standard output could not take everything, as on a full disk.
    pub(crate) fn finish(self) -> Result<(), Failure> {
        match self.failed {
            Some(error) if error.kind() != ErrorKind::BrokenPipe => {
                Err(Failure::output(format_args!("standard output: {error}")))
            }
            _ => Ok(()),
        }
    }
}

/// Formats columns, two spaces apart and indented by two: the first `left` columns are aligned left, the others right.
pub(crate) fn table(rows: &[Vec<String>], left: usize) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells = row.iter().enumerate().map(|(column, cell)| {
            let width = widths[column];
            if column < left { format!("  {cell:width$}") } else { format!("  {cell:>width$}") }
        });
        cells.collect::<String>().trim_end().to_owned()
    };
    rows.iter().map(line).collect::<Vec<_>>().join("\n")
}

/// Indents every line by two spaces.
pub(crate) fn indent(text: &str) -> String {
    text.lines().map(|line| format!("  {line}")).collect::<Vec<_>>().join("\n")
}

/// Formats a duration in the unit that suits it.
pub(crate) fn seconds(seconds: f64) -> String {
    match seconds {
        seconds if seconds < 0.1 => format!("{:.1} ms", seconds * 1e3),
        seconds if seconds < 1.0 => format!("{:.0} ms", seconds * 1e3),
        seconds => format!("{seconds:.1} s"),
    }
}
