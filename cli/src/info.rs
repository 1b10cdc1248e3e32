//! `stein info`

use std::path::{Path, PathBuf};

use serde::Serialize;
use stein::Error;
use stein_exr::{BufferSet, BufferSetRequest};

use super::inspect::{Input, needs_samples, settle};
use super::options::Source;
use super::verdict::Verdict;
use super::{Failure, Out};

const EXAMPLE: &str = "\
Example:
  stein info render.exr
  stein info render.exr -v                 lists every layer
  stein info render.exr --seed other_seed.exr
  stein info a.exr --half-a a.exr --half-b b.exr --json";

/// Stands for the number of samples where it is missing, so that the rest can be described.
const SOME_SAMPLES: u32 = 2;

/// Show whether files can be denoised: their renderer, the use of their layers, what is known of their noise, and the
/// command
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE)]
pub(crate) struct Args {
    /// OpenEXR, PFM or PNG files
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// List every layer
    #[arg(short, long)]
    verbose: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    source: Source,
}

#[derive(Serialize)]
struct Document {
    files: Vec<Described>,
}

#[derive(Serialize)]
struct Described {
    #[serde(flatten)]
    input: Input,
    verdict: Verdict,
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let mut document = Document { files: Vec::new() };
    let mut failures = Vec::new();
    for file in &args.files {
        // One bad file does not hide the others.
        let described = describe(args, file, &mut failures);
        if let Some(Described { input, verdict }) = &described
            && !args.json
        {
            if !document.files.is_empty() {
                out.say("");
            }
            out.say(verdict.text(input));
            if args.verbose {
                out.say(input.details());
            }
        }
        document.files.extend(described);
    }
    if args.json {
        out.json(&document)?;
    }
    let mut failures = failures.into_iter();
    let first = failures.next();
    failures.for_each(|failure| failure.tell());
    first.map_or(Ok(()), Err)
}

/// Describes a file as far as it can be read.
fn describe(args: &Args, file: &Path, failures: &mut Vec<Failure>) -> Option<Described> {
    let mut fail = |error: Error| failures.push(Failure::in_file(file, error).of_input());
    let request = args.source.request(file, &[]);
    let described = |input: Input| {
        let verdict = Verdict::new(&input, &request, args.source.literal);
        Some(Described { input, verdict })
    };
    match BufferSet::read(&request) {
        Ok(mut set) => {
            let (settled, input) = settle(&mut set, args.source.demands);
            // Other problems are told with the verdict.
            if let Err(error) = settled
                && input.problem().is_none()
            {
                fail(error);
            }
            described(input)
        }
        Err(error) => {
            let with_samples = BufferSetRequest { samples: Some(SOME_SAMPLES), ..request.clone() };
            let set = needs_samples(&error).then(|| BufferSet::read(&with_samples).ok()).flatten();
            let input = set.map(|set| Input::new(&set, Err(&error)));
            fail(error);
            input.and_then(described)
        }
    }
}
