//! What a run tells while it measures.

use std::process::Child;

use crate::{Error, Row, Set};

/// Receives the progress of a run, and may end it. All methods do nothing unless they are implemented.
pub trait Observer {
    /// Counts runs that have ended.
    fn ran(&mut self, runs: u64) {
        let _ = runs;
    }

    /// Counts runs that will not be made.
    fn skipped(&mut self, runs: u64) {
        let _ = runs;
    }

    /// Takes the problem of a set that was found in a folder and cannot be used. Returns the note for the document.
    fn left_out(&mut self, problem: Error) -> String {
        format!("left out: {problem}")
    }

    /// Takes a measured set, with a row for each configuration.
    fn measured(&mut self, set: &Set, rows: &[Row]) {
        let _ = (set, rows);
    }

    /// Takes another denoiser that was started; it should end if this program ends.
    fn program_started(&mut self, program: &Child) {
        let _ = program;
    }

    /// Takes note that the program has ended.
    fn program_ended(&mut self) {}

    /// Whether the run must end.
    fn is_cancelled(&self) -> bool {
        false
    }
}

/// Observes nothing.
impl Observer for () {}
