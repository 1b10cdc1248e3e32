//! `stein selftest`: stiff and extreme frames on the user's own adapter.

mod cases;
mod checks;
mod compare;
mod picture;
mod table;
mod twin;

use std::path::PathBuf;
use std::time::Instant;

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use stein_exr::atomic_file::Aside;

use super::bench::Adapter;
use super::options::Device;
use super::progress::bar;
use super::{Failure, Out, interrupt};
use cases::{Case, cases};
use checks::{Bench, Row, Subject};
use compare::Comparison;
use table::Worst;

const EXAMPLE: &str = "\
Small generated frames with known truth and crops of renders, each a situation that a production render may be in: damaged pixels, wrong variances, radiance over sixteen decades, odd sizes, spikes, features that mislead.

Each result is checked for:
  door    the frame is taken, or refused in words that help
  finite  values that are not finite, in everything that a caller gets
  energy  change of the mean colour, relative to the input's
  dark    what the mean colour lacks to that of the truth or of the input, whichever is darker
  error   squared error over that of the noisy input
  reach   values that a damaged pixel changes though it is farther away than the method reaches
  twin    distance to the same method in float64 on the processor, in tolerances
  limit   correction of the input when the noise is a sixteenth, over that before: as noise vanishes, the output becomes the input
  bits    values that differ from run to run, or when the image is worked on in strips

Examples:
  stein selftest
  stein selftest --device 1 --methods dfc,nlm --case spike -v
  stein selftest --json > here.json        and on the other machine:
  stein selftest --compare here.json

Exit codes: 0 all within bounds, 6 something is out of bounds, 2 wrong usage, 3 the file to compare with cannot be used, 4 no device or a device failed, 5 no place for temporary files.";

/// Check this machine's device with stiff and extreme frames
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE)]
pub(crate) struct Args {
    /// Methods to check [default: all]
    #[arg(long, alias = "method", value_enum, value_name = "NAME,…", value_delimiter = ',')]
    methods: Vec<Subject>,
    /// Only cases whose names hold this; may be repeated
    #[arg(long = "case", value_name = "SUBSTRING")]
    cases: Vec<String>,
    /// Also tell where results differ from those of another run, which is what --json printed there
    #[arg(long, value_name = "OTHER.json")]
    compare: Option<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    pub(crate) json: bool,
    /// Also tell why bounds are other than usual, and where the worst of each figure is
    #[arg(short, long)]
    verbose: bool,
    #[command(flatten)]
    pub(crate) device: Device,
}

/// Schema name that identifies our documents.
const SCHEMA: &str = "stein.selftest";

/// Raised when a field changes its meaning or goes away; new fields alone do not raise it.
const VERSION: u32 = 1;

/// JSON document of a run.
#[derive(Serialize, Deserialize)]
struct Document {
    schema: String,
    version: u32,
    /// Version of stein that ran.
    stein: String,
    adapter: Adapter,
    passed: bool,
    seconds: f64,
    rows: Vec<Row>,
    /// Figure of each check that is nearest to its bound, or farthest beyond it.
    worst: Vec<Worst>,
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    if args.json {
        out.silence();
    }
    let other = args.compare.as_deref().map(compare::read).transpose()?;
    let subjects = if args.methods.is_empty() { Subject::value_variants() } else { &args.methods };
    let chosen = |case: &Case| args.cases.is_empty() || args.cases.iter().any(|part| case.name.contains(part.as_str()));
    let of_methods = |case: &Case| case.methods.iter().any(|subject| subjects.contains(subject));
    let cases: Vec<Case> = cases().into_iter().filter(|case| chosen(case) && of_methods(case)).collect();
    if cases.is_empty() {
        return Err(Failure::usage("there is no such case\n  remedy: leave --case out; the table then shows them all"));
    }
    let folder = Aside::make(tempfile::tempdir).map_err(|error| {
        Failure::output(format_args!(
            "no folder for temporary files: {error}\n  remedy: let TMPDIR name a folder that may be written to"
        ))
    })?;
    let gpu = args.device.open()?;
    let adapter = Adapter::from(gpu.summary());
    out.say(format_args!("{adapter}"));

    let start = Instant::now();
    let bench = Bench { gpu: &gpu, max_memory: args.device.max_memory, folder: folder.path() };
    let progress = bar(!args.json, cases.len() as u64);
    let mut rows = Vec::new();
    for case in &cases {
        interrupt::check()?;
        rows.extend(bench.run(case, subjects)?);
        progress.inc(1);
    }
    progress.finish_and_clear();

    let passed = rows.iter().all(|row| row.passed);
    let seconds = start.elapsed().as_secs_f64();
    let worst = table::worst(&rows);
    let document = Document {
        schema: SCHEMA.into(),
        version: VERSION,
        stein: env!("CARGO_PKG_VERSION").into(),
        adapter,
        passed,
        seconds,
        rows,
        worst,
    };
    let comparison = other.as_ref().map(|other| Comparison::new(other, &document));
    out.say(table::text(&document, &cases, args.verbose));
    if let Some(comparison) = &comparison {
        out.say(comparison.text());
    }
    if args.json {
        out.json(&Printed { document: &document, comparison: comparison.as_ref() })?;
    }
    let failed = document.rows.iter().filter(|row| !row.passed).count();
    if failed == 0 {
        return Ok(());
    }
    Err(Failure::out_of_bounds(format_args!(
        "{failed} of {} results are out of bounds on {}\n  remedy: update the driver, or choose another adapter with --device; if that does not help, please report it with what --json prints",
        document.rows.len(),
        document.adapter
    )))
}

#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    document: &'a Document,
    #[serde(skip_serializing_if = "Option::is_none")]
    comparison: Option<&'a Comparison>,
}
