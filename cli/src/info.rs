//! `stein info`

use std::path::PathBuf;

use serde::Serialize;

use super::inspect::{Input, settle};
use super::options::{self, Source};
use super::{Failure, Out};

const EXAMPLE: &str = "\
Example:
  stein info render.exr
  stein info a.exr --half-a a.exr --half-b b.exr --json";

/// Show the layers of a file, how each would be used, and where the noise is known from
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE)]
pub(crate) struct Args {
    /// OpenEXR files
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    source: Source,
}

#[derive(Serialize)]
struct Document {
    files: Vec<Input>,
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let mut document = Document { files: Vec::new() };
    let mut first_failure = None;
    for file in &args.files {
        match options::read(&args.source.request(file, &[])) {
            Ok(mut set) => {
                let (_, input) = settle(&mut set, args.source.require_noise);
                if !args.json {
                    out.say(input.text(true));
                    if let Some(problem) = input.problem() {
                        out.say(format_args!("  cannot be denoised: {}", problem.replace('\n', "\n  ")));
                    }
                }
                document.files.push(input);
            }
            // One bad file does not hide the others.
            Err(failure) => match &first_failure {
                None => first_failure = Some(failure),
                Some(_) => failure.tell(),
            },
        }
    }
    if args.json {
        out.json(&document)?;
    }
    first_failure.map_or(Ok(()), Err)
}
