//! `stein denoise`

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::time::Instant;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use stein::buffers::LayerRef;
use stein::method::Intermediate;
use stein::{Denoiser, Estimate, Frame, Method, Options};

use super::inspect::settle;
use super::options::{Device, Filter, Source};
use super::progress::{bar, is_watched};
use super::quality;
use super::report::{Report, Run};
use super::{Failure, Out, output};

const EXAMPLE: &str = "\
The output keeps the input's header and layers. The colour is replaced, and so are its halves; its variance is left out, for it is not that of the denoised \
colour. `stein.error.V` is added: the estimated squared error, summed over the channels; of dfc before the second pass.

Examples:
  stein denoise render.exr
  stein denoise render.exr -o clean.exr --ref converged.exr
  stein denoise both.exr --half-a seed1.exr --half-b seed2.exr --feature albedo=aux.exr::albedo
  stein denoise render.exr --keep candidates,sure --json
  stein denoise render.exr --method nlm --keep halves

Exit codes: 0 done, 2 wrong usage, 3 an input file or layer cannot be used, 4 no device or a device failed, 5 the output cannot be written, 1 anything else.";

/// Denoise a rendering
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE, override_usage = "stein denoise [OPTIONS] IN")]
pub(crate) struct Args {
    /// OpenEXR file with the noisy colour and, usually, its halves, variance and features
    #[arg(value_name = "IN", required_unless_present = "list_devices")]
    input: Option<PathBuf>,
    /// Where to write [default: IN with `.denoised.exr` for its extension]; a folder takes that name, and only this option can replace the input
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Leave an existing output alone
    #[arg(long)]
    no_clobber: bool,
    /// Tell what would be done, and write nothing
    #[arg(short = 'n', long)]
    dry_run: bool,
    /// Noise-free reference: print the error before and after
    #[arg(long = "ref", value_name = "FILE[::LAYER]")]
    reference: Option<LayerRef>,
    /// Intermediates to write as layers `stein.*`
    #[arg(long, value_name = "NAME", value_delimiter = ',', value_parser = keepable())]
    keep: Vec<Keep>,
    /// Print one JSON document in place of text
    #[arg(long)]
    pub(crate) json: bool,
    /// Also print times per stage and memory
    #[arg(short, long, conflicts_with = "quiet")]
    verbose: bool,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    filter: Filter,
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    pub(crate) device: Device,
}

/// A value of `--keep`.
#[derive(Clone, Copy, Debug)]
enum Keep {
    All,
    One(Intermediate),
}

fn keepable() -> impl TypedValueParser<Value = Keep> {
    let names = std::iter::once("all").chain(Intermediate::ALL.map(Intermediate::name));
    let find = |name: String| Intermediate::ALL.into_iter().find(|intermediate| intermediate.name() == name).map_or(Keep::All, Keep::One);
    PossibleValuesParser::new(names).map(find)
}

impl Args {
    /// Intermediates that go into the output.
    fn keep(&self, method: &Method) -> Result<Vec<Intermediate>, Failure> {
        let has = method.intermediates();
        for keep in &self.keep {
            if let Keep::One(one) = keep
                && !has.contains(one)
            {
                let (name, all) = (method.name(), Report::names(has).join(", "));
                return Err(Failure::usage(format_args!("--keep {}: {name} has no such intermediate\n  remedy: choose from {all}", one.name())));
            }
        }
        let wanted = |intermediate: &Intermediate| {
            self.keep.iter().any(|keep| match keep {
                Keep::All => true,
                Keep::One(one) => one == intermediate,
            })
        };
        Ok(has.iter().copied().filter(wanted).collect())
    }

    fn show_progress(&self) -> bool {
        !self.quiet && !self.json && is_watched()
    }
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let input = args.input.as_deref().ok_or_else(|| Failure::usage("no input is given"))?;
    if args.quiet || args.json {
        out.silence();
    }
    let method = args.filter.method()?;
    let output = output::choose(input, args.output.as_deref());
    let read_too = args.source.files().chain(args.reference.as_ref().map(|reference| reference.file.as_path()));
    // Half A may be the input itself, one layer of it: that the user may replace.
    let read_too = read_too.filter(|file| *file != input);
    output::check(&output, read_too, args.no_clobber, args.dry_run)?;

    let set = args.source.read(input)?;
    let (frame, described) = settle(&set);
    out.say(described.text(args.verbose));
    let frame = frame.map_err(|error| Failure::in_file(input, error))?;
    let reference = args.reference.as_ref().map(|reference| quality::read(reference, &frame, input)).transpose()?;

    let gpu = args.device.open()?;
    let denoiser = args.device.denoiser(&gpu, method)?;
    let keep = args.keep(&method)?;
    let mut needed = keep.clone();
    if reference.is_some() {
        needed.extend(quality::NEEDED.iter().filter(|one| method.intermediates().contains(one) && !keep.contains(one)));
    }
    let mut report = Report {
        input: described,
        preset: args.filter.preset(),
        parameters: method,
        device: gpu.summary().clone(),
        max_memory_bytes: args.device.max_memory,
        strips: denoiser.strip_count(&frame, &needed)?,
        kept: Report::names(&keep),
        run: None,
        output: None,
        errors: None,
    };
    if !args.dry_run {
        gpu.set_timing(args.verbose || args.json);
        let start = Instant::now();
        let estimate = denoise(&denoiser, &frame, &needed, args.show_progress())?;
        report.run = Some(Run::new(&estimate, start.elapsed().as_secs_f64()));
        report.output = Some(output::write(&set, &output, &estimate, &keep, &method)?);
        report.errors = reference.map(|reference| quality::compare(&frame, &estimate, &reference)).transpose()?;
    }
    out.say(report.text(args.verbose));
    if args.json { out.json(&report) } else { Ok(()) }
}

/// Denoises, with a progress bar where somebody is watching. Reporting progress makes the device wait, so it is not asked for where nobody is.
fn denoise(denoiser: &Denoiser, frame: &Frame, keep: &[Intermediate], watched: bool) -> Result<Estimate, Failure> {
    if !watched {
        return Ok(denoiser.denoise_with(frame, Options { keep, progress: None })?);
    }
    let bar = bar(true, 1000);
    let mut progress = |share: f32| {
        bar.set_position((share * 1000.0) as u64);
        ControlFlow::Continue(())
    };
    let estimate = denoiser.denoise_with(frame, Options { keep, progress: Some(&mut progress) });
    bar.finish_and_clear();
    Ok(estimate?)
}
