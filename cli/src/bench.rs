//! `stein bench`: error against run time.

mod ratios;
mod text;
mod words;

use std::path::{Path, PathBuf};
use std::process::Child;

use clap::Parser;
use indicatif::ProgressBar;
use stein::gpu::AdapterIdentity;
use stein::method::dfc::CandidateSet;
use stein::{Extent, Method, Preset};
use stein_bench::{
    Bench, Document, External, Folder, NoiseAxis, Observer, PreparedConfiguration, Row, RunRatios, Set, Settings,
    distinct, find_sets, read_document,
};
use stein_exr::LayerRef;
use stein_exr::options::choice;

use super::filter::{Chosen, Tuning, candidates, not_theirs};
use super::interrupt::{self, Companion};
use super::options::{Device, Source, size};
use super::progress::bar;
use super::{Failure, Out, document, output};

const EXAMPLE: &str = "\
Every configuration runs once to warm up, then N times in turn with the others: the median time on the clock, from the frame in memory to the result in memory. Each of \
these runs is followed by one in which the device times its stages, which slows it a little. Times of different machines, or of different days, say less than the ratios \
within one run.

Sets are OpenEXR files, or folders that are searched for them. The reference of DIR/NAME_32spp.exr or DIR/NAME.exr is DIR/NAME_reference.exr, that of DIR/shot.0007.exr is \
DIR/reference.0007.exr, or else it is reference.exr in DIR or in the folder above; references are no sets. Sets with the same reference are one scene at several samples \
per pixel. A set without a reference is timed.

Examples:
  stein bench render.exr --ref converged.exr
  stein bench renders --methods dfc,nlm,gem --radii 5,10,20 --second-pass on,off -o report
  stein bench render.exr --size 512x512,1024x1024,2048x2048 --presets default --repeat 9 -v
  stein bench renders --candidates all,first+second,third --everything on,off
  stein bench renders --noise given,halves,image
  stein bench renders -o report --external 'other=/opt/other/denoise --hdr {in} -o {out}'
  stein bench renders --json > before.json
  stein bench --compare before.json --fail-above 1.1      measures the same again

Exit codes: 0 done, 1 slower or worse than --fail-above allows, 2 wrong usage, 3 an input file or layer cannot be used or another program fails, 4 no device or a device \
failed, 5 the output cannot be written.";

/// Measure speed, memory and error, and report them
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE, override_usage = "stein bench [OPTIONS] SETS…\n       stein bench [OPTIONS] --compare OLD.json")]
pub(crate) struct Args {
    /// Measured runs of each configuration [default: 5]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    repeat: Option<u32>,
    /// Write a report into this folder: index.html to look at, results.json and results.csv for programs; an earlier
    /// report there is replaced
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Print ratios to an earlier run: the results.json of a report, its folder, or what --json printed. Without SETS
    /// the same is measured again
    #[arg(long, value_name = "OLD.json")]
    compare: Option<PathBuf>,
    /// End with exit code 1 where a row's time or relative MSE is more than this many times that of the earlier run
    #[arg(long, value_name = "RATIO", requires = "compare", value_parser = ratio)]
    fail_above: Option<f64>,
    /// Print one JSON document, which is that of results.json
    #[arg(long)]
    pub(crate) json: bool,
    /// Also print the time of the warm-up, times per stage, and more measures of error
    #[arg(short, long)]
    verbose: bool,
    #[command(flatten)]
    axes: Axes,
    #[command(flatten)]
    pub(crate) device: Device,
}

/// What is measured.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(next_help_heading = "What is measured")]
struct Axes {
    /// OpenEXR files, as for `stein denoise`, or folders with such files
    #[arg(value_name = "SETS", help_heading = None::<&str>, required_unless_present_any = ["list_devices", "compare"])]
    inputs: Vec<PathBuf>,
    /// Noise-free reference, one for each file in their order [default: found by its name]
    #[arg(long = "ref", value_name = "FILE[::LAYER]")]
    references: Vec<LayerRef>,
    /// Methods to measure [default: dfc, or that of --params]
    #[arg(long, alias = "method", value_name = "NAME,…", value_delimiter = ',', value_parser = choice(&Method::all(), &Method::choices()))]
    methods: Vec<Method>,
    /// Presets to measure [default: all, or that of --params]
    #[arg(long, alias = "preset", value_name = "NAME,…", value_delimiter = ',', value_parser = choice(Preset::ALL, &Preset::choices()))]
    presets: Vec<Preset>,
    /// Of dfc and nlm: radii of the window, in pixels [default: 10]
    #[arg(long, alias = "radius", value_name = "PIXELS,…", value_delimiter = ',')]
    radii: Vec<u32>,
    /// Of dfc: with the second pass, without, or both [default: on]
    #[arg(long, value_enum, value_name = "on,off", value_delimiter = ',')]
    second_pass: Vec<Switch>,
    /// Of dfc: which candidates take part, such as first+second,third for two configurations [default: all]
    #[arg(long, value_name = "NAME+NAME,…", value_delimiter = ',', value_parser = candidates)]
    candidates: Vec<CandidateSet>,
    /// Also running what a scene does not need, without, or both: what leaving it out saves [default: off]
    #[arg(long, value_enum, value_name = "on,off", value_delimiter = ',')]
    everything: Vec<Switch>,
    /// What the methods are told of the noise: what a set has, its halves alone, or nothing but the image [default:
    /// given]
    #[arg(long, value_name = "given,halves,image", value_delimiter = ',', value_parser = choice(&NoiseAxis::ALL, &NoiseAxis::choices()))]
    noise: Vec<NoiseAxis>,
    /// Sizes to measure at: the input is repeated, mirrored at the seams, or cut off [default: its own]
    #[arg(long = "size", value_name = "WxH,…", value_delimiter = ',', value_parser = size)]
    sizes: Vec<Extent>,
    /// Another denoiser, to run on the set's file, time by the clock and compare: `NAME=command {in} {out}`, split into
    /// words as a shell would, but run without one; may be repeated
    #[arg(long = "external", value_name = "NAME=COMMAND")]
    externals: Vec<External>,
    #[command(flatten)]
    tuning: Tuning,
    #[command(flatten)]
    source: Source,
}

fn ratio(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(ratio) if ratio > 0.0 && f64::is_finite(ratio) => Ok(ratio),
        _ => Err("it must be a positive number, as in 1.1".into()),
    }
}

/// Arguments out of an earlier run's document.
#[derive(Parser)]
#[command(name = "stein bench")]
struct Again {
    #[command(flatten)]
    args: Args,
}

impl Again {
    fn parse(arguments: &[String]) -> Option<Args> {
        Self::try_parse_from(std::iter::once("stein bench").chain(arguments.iter().map(String::as_str)))
            .ok()
            .map(|again| again.args)
    }
}

/// On or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Switch {
    On,
    Off,
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    if args.json {
        out.silence();
    }
    let old = args.compare.as_deref().map(read_old).transpose()?;
    let BenchRequest { axes, repeats, arguments } = BenchRequest::new(args, old.as_ref())?;
    let (configurations, mut notes) = axes.configurations()?;
    let folder = args.output.as_deref().map(Folder::check).transpose()?;
    let references: Vec<LayerRef> = axes.references.iter().map(|reference| axes.source.reference(reference)).collect();
    let sets = find_sets(&axes.inputs, &references)?;
    let source = source(&axes.source, &configurations)?;
    let gpu = args.device.open()?;
    let adapter = AdapterIdentity::from(gpu.summary());
    if let Some(old) = &old {
        check_adapter(old, &adapter, args.fail_above)?;
    }
    if !axes.sizes.is_empty() && !axes.externals.is_empty() {
        notes.push("--size: other programs run only where a set has that size itself, for they read its file".into());
    }
    let settings = Settings {
        sets: &sets,
        sizes: &axes.sizes,
        configurations: &configurations,
        repeats,
        request: source.request(Path::new(""), &[]),
        requires_noise: source.demands.require_noise,
        requires_agreement: source.demands.strict,
        max_memory: args.device.max_memory,
        keeps_pictures: folder.is_some(),
        arguments,
        notes,
    };
    let bench = Bench::new(&gpu, &settings)?;
    out.say(format_args!("{adapter}, median of {repeats}"));
    settings.notes.iter().for_each(|note| out.say(format_args!("note: {note}")));
    let scratch = output::scratch()?;
    let bar = bar(!args.json, bench.runs());
    let mut terminal = Terminal { bar, verbose: args.verbose, out, program: None };
    let measured = bench.run(scratch.path(), &mut terminal);
    terminal.bar.finish_and_clear();
    let measured = measured?;

    let ratios = old.as_ref().map(|old| RunRatios::new(old, &measured.document, args.fail_above));
    if let Some(folder) = folder {
        folder.write(&measured)?;
        out.say(format_args!("{}: the report", stein::text::path(&folder.index())));
    }
    if let Some(ratios) = &ratios {
        out.say(ratios::text(ratios));
    }
    if args.json {
        out.json(&Printed { document: &measured.document, comparison: ratios.as_ref() })?;
    }
    match (&ratios, args.fail_above) {
        (Some(ratios), Some(limit)) => ratios::verdict(ratios, limit),
        _ => Ok(()),
    }
}

/// Reads the document of an earlier run.
fn read_old(path: &Path) -> Result<Document, Failure> {
    read_document(path)
        .map_err(|error| document::unusable(&error, "written by `stein bench`", "give the results.json of a report"))
}

/// Refuses `--fail-above` if the adapters differ: times of different adapters do not show whether the program became
/// slower, so they must not decide the exit code.
fn check_adapter(old: &Document, adapter: &AdapterIdentity, fail_above: Option<f64>) -> Result<(), Failure> {
    if fail_above.is_none() || old.adapter == *adapter {
        return Ok(());
    }
    Err(Failure::usage(format_args!(
        "--fail-above: the old run was on {}, this one would be on {adapter}\n  remedy: leave --fail-above out, or compare with a run on this adapter",
        old.adapter
    )))
}

/// Shows the progress of a run on the terminal.
struct Terminal<'a> {
    bar: ProgressBar,
    verbose: bool,
    out: &'a mut Out,
    /// Another denoiser that is running.
    program: Option<Companion>,
}

impl Observer for Terminal<'_> {
    fn ran(&mut self, runs: u64) {
        self.bar.inc(runs);
    }

    fn skipped(&mut self, runs: u64) {
        self.bar.dec_length(runs);
    }

    fn left_out(&mut self, problem: stein_bench::Error) -> String {
        let note = format!("left out: {}", Failure::from(problem).cause());
        self.bar.suspend(|| self.out.say(format_args!("note: {note}")));
        note
    }

    fn measured(&mut self, set: &Set, rows: &[Row]) {
        self.bar.suspend(|| self.out.say(text::text(set, rows, self.verbose)));
    }

    fn program_started(&mut self, program: &Child) {
        self.program = Some(Companion::of(program));
    }

    fn program_ended(&mut self) {
        self.program = None;
    }

    fn is_cancelled(&self) -> bool {
        interrupt::is_asked()
    }
}

/// JSON document that `--json` prints.
#[derive(serde::Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    document: &'a Document,
    #[serde(skip_serializing_if = "Option::is_none")]
    comparison: Option<&'a RunRatios>,
}

/// Measurements to make, from the arguments or from those of an earlier run.
struct BenchRequest {
    axes: Axes,
    repeats: u32,
    arguments: Vec<String>,
}

impl BenchRequest {
    const REPEATS: u32 = 5;

    fn new(args: &Args, old: Option<&Document>) -> Result<Self, Failure> {
        match old {
            Some(old) if args.axes.inputs.is_empty() => {
                let Some(then) = Again::parse(&old.arguments) else {
                    return Err(Failure::input(
                        "--compare: the old run's arguments are none of this version\n  remedy: name the sets",
                    ));
                };
                // Refuses options that would have no effect.
                let nothing = Axes {
                    inputs: Vec::new(),
                    ..Again::parse(&["-".to_owned()]).map_or_else(|| args.axes.clone(), |args| args.axes)
                };
                if args.axes != nothing {
                    return Err(Failure::usage(
                        "without SETS, --compare measures what the old run did\n  remedy: name the sets, or leave out the options that say what is measured",
                    ));
                }
                Ok(Self {
                    axes: then.axes,
                    repeats: args.repeat.or(then.repeat).unwrap_or(Self::REPEATS),
                    arguments: old.arguments.clone(),
                })
            }
            _ => {
                let arguments = std::env::args_os().skip_while(|argument| argument != "bench").skip(1);
                let arguments = arguments.map(|argument| argument.to_string_lossy().into_owned()).collect();
                Ok(Self { axes: args.axes.clone(), repeats: args.repeat.unwrap_or(Self::REPEATS), arguments })
            }
        }
    }
}

impl Axes {
    /// Returns all configurations, and notes on options that some of the methods do not have.
    fn configurations(&self) -> Result<(Vec<PreparedConfiguration>, Vec<String>), Failure> {
        let file = self.tuning.file()?;
        if let Some(file) = &file {
            file.agrees("--methods", self.methods.iter().map(Method::name), file.chosen.method.name())?;
            file.agrees("--presets", self.presets.iter().map(|preset| preset.name()), file.chosen.preset.name())?;
        }
        let file = file.map(|file| file.chosen);
        let methods = distinct(&self.methods, &[file.map(|file| file.method).unwrap_or_default()]);
        let presets = distinct(&self.presets, &file.map_or_else(|| Preset::ALL.to_vec(), |file| vec![file.preset]));
        self.tuning.check(&methods)?;
        let notes = self.notes(&methods)?;
        let chosen = |method, preset| {
            let Chosen { method, preset } = file.unwrap_or(Chosen::of(method, preset));
            (method, preset)
        };
        let are_on = |switches: &[Switch]| switches.iter().map(|switch| *switch == Switch::On).collect();
        let axes = stein_bench::Axes {
            methods: methods
                .iter()
                .flat_map(|method| presets.iter().map(move |preset| (*method, *preset)))
                .map(|(method, preset)| chosen(method, preset))
                .collect(),
            radii: self.radii.clone(),
            candidates: self.candidates.clone(),
            second_passes: are_on(&self.second_pass),
            everything: are_on(&self.everything),
            noise: self.noise.clone(),
            externals: self.externals.clone(),
        };
        Ok((axes.configurations(|method| self.tuning.applied_to(method))?, notes))
    }

    /// Returns a note for each option that some of the methods do not have. Refuses options that none of them has.
    fn notes(&self, methods: &[Method]) -> Result<Vec<String>, Failure> {
        let given = [
            ("--radii", !self.radii.is_empty(), Method::WINDOW_RADIUS),
            ("--candidates", !self.candidates.is_empty(), Method::CANDIDATES),
            ("--second-pass", !self.second_pass.is_empty(), Method::SECOND_PASS),
        ];
        let mut notes = Vec::new();
        for (option, _, parameter) in given.into_iter().filter(|(_, is_given, _)| *is_given) {
            let without: Vec<_> =
                methods.iter().filter(|method| !method.has_parameter(parameter)).map(Method::name).collect();
            if without.len() == methods.len() {
                return Err(not_theirs(option, methods));
            }
            // A method without the option is measured once, whatever the values of the option.
            if !without.is_empty() {
                notes.push(format!("{option} is no option of {}, measured once", without.join(" and ")));
            }
        }
        Ok(notes)
    }
}

/// Returns the source without the layers that no method uses. Refuses options about layers that no method can use.
fn source(source: &Source, configurations: &[PreparedConfiguration]) -> Result<Source, Failure> {
    let methods = configurations.iter().filter_map(PreparedConfiguration::method);
    // A method that uses features decides, if there is one.
    match methods.max_by_key(|method| method.uses_features()) {
        Some(method) => {
            source.check(method)?;
            Ok(source.for_method(method))
        }
        None => Ok(source.clone()),
    }
}
