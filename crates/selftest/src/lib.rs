//! Stiff and extreme frames, and the checks of what a device makes of them: against known truth, against the same method
//! in float64, and against itself.
//!
//! [`cases`] lists the frames, [`run`] checks them, and [`AdapterDifferences`] compares the [`Document`]s of two runs.

mod cases;
mod checks;
mod compare;
mod picture;
mod twin;
mod worst;

use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use serde::{Deserialize, Serialize};
use stein::Gpu;
use stein::gpu::AdapterIdentity;

pub use cases::{Case, cases};
use checks::DeviceUnderTest;
pub use checks::{Check, Figure, Row, Subject, Summary};
pub use compare::{AdapterDifferences, Difference, read_document};
pub use worst::Worst;

/// Schema name that identifies our documents.
pub const SCHEMA: &str = "stein.selftest";

/// Raised when a field changes its meaning or goes away; new fields alone do not raise it.
pub const VERSION: u32 = 1;

/// JSON document of a run.
#[derive(Debug, Serialize, Deserialize)]
pub struct Document {
    /// [`SCHEMA`]
    pub schema: String,
    /// [`VERSION`]
    pub version: u32,
    /// Version of stein that ran.
    pub stein: String,
    /// Adapter under test.
    pub adapter: AdapterIdentity,
    /// Whether all results are within bounds.
    pub passed: bool,
    /// Time of the run in seconds.
    pub seconds: f64,
    /// Results, one for each case and method.
    pub rows: Vec<Row>,
    /// Figure of each check that is nearest to its bound, or farthest beyond it.
    pub worst: Vec<Worst>,
}

/// Settings of a run.
#[derive(Clone, Copy, Debug)]
pub struct Settings<'a> {
    /// Methods to check.
    pub subjects: &'a [Subject],
    /// Memory limit on the device, in bytes.
    pub max_memory: Option<u64>,
    /// Folder for temporary files.
    pub scratch: &'a Path,
}

/// The reason why a run ends early.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The device fails: what it does from then on says nothing about it.
    #[error("{case}, {method}: {}", error.problem())]
    Device {
        /// Name of the case.
        case: String,
        /// Name of the method.
        method: &'static str,
        /// Error of the library.
        error: Box<stein::Error>,
    },
    /// The caller ended the run.
    #[error("cancelled")]
    Cancelled,
}

/// Checks all cases. Calls `go_on` before each case with the number of cases that are done.
///
/// # Errors
/// [`Error::Device`] for a device that fails, and [`Error::Cancelled`] after `go_on` returned
/// [`ControlFlow::Break`].
pub fn run(
    gpu: &Gpu,
    cases: &[Case],
    settings: Settings<'_>,
    mut go_on: impl FnMut(usize) -> ControlFlow<()>,
) -> Result<Document, Error> {
    let start = Instant::now();
    let device = DeviceUnderTest { gpu, max_memory: settings.max_memory, folder: settings.scratch };
    let mut rows = Vec::new();
    for (done, case) in cases.iter().enumerate() {
        if go_on(done).is_break() {
            return Err(Error::Cancelled);
        }
        rows.extend(device.run(case, settings.subjects)?);
    }
    Ok(Document {
        schema: SCHEMA.into(),
        version: VERSION,
        stein: env!("CARGO_PKG_VERSION").into(),
        adapter: AdapterIdentity::from(gpu.summary()),
        passed: rows.iter().all(|row| row.passed),
        seconds: start.elapsed().as_secs_f64(),
        worst: worst::worst(&rows),
        rows,
    })
}
