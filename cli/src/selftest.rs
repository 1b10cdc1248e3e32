//! `stein selftest`: stiff and extreme frames on the user's own adapter.

mod table;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use serde::Serialize;
use stein::gpu::AdapterIdentity;
use stein_exr::options::choice;
use stein_selftest::{AdapterDifferences, Case, Document, Error, Settings, Subject, cases, read_document};

use super::options::Device;
use super::progress::bar;
use super::{Failure, Out, document, interrupt, output};

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
    #[arg(long, alias = "method", value_name = "NAME,…", value_delimiter = ',', value_parser = choice(&Subject::ALL, &Subject::choices()))]
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

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    if args.json {
        out.silence();
    }
    let other = args.compare.as_deref().map(read_other).transpose()?;
    let subjects = if args.methods.is_empty() { &Subject::ALL[..] } else { &args.methods };
    let chosen = |case: &Case| args.cases.is_empty() || args.cases.iter().any(|part| case.name.contains(part.as_str()));
    let of_methods = |case: &Case| case.methods.iter().any(|subject| subjects.contains(subject));
    let cases: Vec<Case> = cases().into_iter().filter(|case| chosen(case) && of_methods(case)).collect();
    if cases.is_empty() {
        return Err(Failure::usage("there is no such case\n  remedy: leave --case out; the table then shows them all"));
    }
    let scratch = output::scratch()?;
    let gpu = args.device.open()?;
    out.say(AdapterIdentity::from(gpu.summary()));

    let progress = bar(!args.json, cases.len() as u64);
    let settings = Settings { subjects, max_memory: args.device.max_memory, scratch: scratch.path() };
    let document = stein_selftest::run(&gpu, &cases, settings, |done| {
        progress.set_position(done as u64);
        if interrupt::is_asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    progress.finish_and_clear();
    let document = document?;

    let differences = other.as_ref().map(|other| AdapterDifferences::new(other, &document));
    out.say(table::text(&document, &cases, args.verbose));
    if let Some(differences) = &differences {
        out.say(table::differences(differences));
    }
    if args.json {
        out.json(&Printed { document: &document, comparison: differences.as_ref() })?;
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

/// Reads the document of another run.
fn read_other(path: &Path) -> Result<Document, Failure> {
    read_document(path).map_err(|error| {
        let origin = "printed by `stein selftest --json`";
        document::unusable(&error, origin, "give what `stein selftest --json` printed")
    })
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::Device { case, method, error } => Self::from(*error).at(format_args!("{case}, {method}")),
            Error::Cancelled => Self::other("interrupted"),
        }
    }
}

/// JSON document that `--json` prints.
#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    document: &'a Document,
    #[serde(skip_serializing_if = "Option::is_none")]
    comparison: Option<&'a AdapterDifferences>,
}
