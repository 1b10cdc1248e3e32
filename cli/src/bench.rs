//! `stein bench`: error against run time.

mod compare;
mod configuration;
mod csv_file;
mod external;
mod folder;
mod measure;
mod page;
mod plot;
mod results;
mod sets;
mod statistics;
mod text;
mod thumbnail;

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use clap::Parser;
use stein::frame::{NoiseKnowledge, SamplesPerPixel};
use stein::method::dfc::CandidateSet;
use stein::{Extent, Frame, Gpu, Image, Method, Preset};
use stein_exr::atomic_file::Aside;
use stein_exr::options::choice;
use stein_exr::{BufferSet, LayerRef};

use super::filter::{Tuning, candidates};
use super::inspect::settle;
use super::options::{self, Device, Source, size};
use super::progress::bar;
use super::quality;
use super::tile::{cover, cover_frame};
use super::{Failure, Out};
use compare::Comparison;
use configuration::{Configuration, How, NoiseAxis, Switch, configurations, distinct};
use external::External;
use folder::Folder;
use measure::{Case, Contestant, errors, measure, runs};
pub(super) use results::Adapter;
use results::{Document, Row, SCHEMA, Set, VERSION};
use sets::SetFile;
use thumbnail::Gallery;

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
    #[arg(long, value_enum, value_name = "given,halves,image", value_delimiter = ',')]
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

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    if args.json {
        out.silence();
    }
    let old = args.compare.as_deref().map(compare::read).transpose()?;
    let Job { axes, repeats, arguments } = Job::new(args, old.as_ref())?;
    let (configurations, mut notes) = configurations(&axes)?;
    let folder = args.output.as_deref().map(Folder::check).transpose()?;
    let references: Vec<LayerRef> = axes.references.iter().map(|reference| axes.source.reference(reference)).collect();
    let files = sets::find(&axes.inputs, &references)?;
    let source = source(&axes.source, &configurations)?;
    let gpu = args.device.open()?;
    let adapter = Adapter::from(gpu.summary());
    if let Some(old) = &old {
        compare::check_adapter(old, &adapter, args.fail_above)?;
    }
    let contestants = configurations
        .iter()
        .map(|configuration| Contestant::new(configuration, |method| args.device.denoiser(&gpu, method)));
    let contestants = contestants.collect::<Result<Vec<_>, Failure>>()?;
    out.say(format_args!("{adapter}, median of {repeats}"));
    if !axes.sizes.is_empty() && !axes.externals.is_empty() {
        notes.push("--size: other programs run only where a set has that size itself, for they read its file".into());
    }
    notes.iter().for_each(|note| out.say(format_args!("note: {note}")));

    let mut bench = Bench {
        gpu: &gpu,
        contestants: &contestants,
        repeats,
        scratch: Aside::make(tempfile::tempdir).map_err(|error| {
            Failure::output(format_args!(
                "no folder for temporary files: {error}\n  remedy: let TMPDIR name a folder that may be written to"
            ))
        })?,
        gallery: folder.is_some().then(Gallery::default),
        bar: bar(
            !args.json,
            files.len() as u64 * axes.sizes.len().max(1) as u64 * contestants.len() as u64 * runs(repeats),
        ),
        document: Document {
            schema: SCHEMA.into(),
            version: VERSION,
            stein: env!("CARGO_PKG_VERSION").into(),
            date: humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
            arguments,
            adapter,
            repeats,
            configurations: configurations.iter().map(|configuration| configuration.described.clone()).collect(),
            sets: Vec::new(),
            rows: Vec::new(),
            notes,
        },
    };
    for file in &files {
        let Some(read) = bench.read(file, &source, axes.sizes.len(), out)? else { continue };
        for (set, rows) in bench.set(file, read, &axes.sizes)? {
            bench.bar.suspend(|| out.say(text::text(&set, &rows.iter().collect::<Vec<_>>(), args.verbose)));
        }
    }
    bench.bar.finish_and_clear();
    let Bench { document, gallery, .. } = bench;
    if document.rows.is_empty() {
        return Err(Failure::input(
            "nothing was measured\n  remedy: name sets that can be denoised; `stein info` tells what is missing",
        ));
    }

    let comparison = old.as_ref().map(|old| compare::compare(old, &document, args.fail_above));
    if let (Some(folder), Some(gallery)) = (folder, gallery) {
        let json = serde_json::to_string_pretty(&document)
            .map_err(|error| Failure::output(format_args!("results.json: {error}")))?;
        folder.write([json.as_bytes(), &csv_file::csv(&document)?, page::page(&document, &gallery)?.as_bytes()])?;
        out.say(format_args!("{}: the report", stein::text::path(&folder.index())));
    }
    if let Some(comparison) = &comparison {
        out.say(comparison.text());
    }
    if args.json {
        out.json(&Printed { document: &document, comparison: comparison.as_ref() })?;
    }
    comparison.map_or(Ok(()), |comparison| comparison.verdict(args.fail_above))
}

/// JSON document that `--json` prints.
#[derive(serde::Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    document: &'a Document,
    #[serde(skip_serializing_if = "Option::is_none")]
    comparison: Option<&'a Comparison>,
}

/// Measurements to make, from the arguments or from those of an earlier run.
struct Job {
    axes: Axes,
    repeats: u32,
    arguments: Vec<String>,
}

impl Job {
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

/// Returns the source without the layers that no method uses. Refuses options about layers that no method can use.
fn source(source: &Source, configurations: &[Configuration]) -> Result<Source, Failure> {
    let methods = configurations.iter().filter_map(|configuration| match &configuration.how {
        How::Stein { method, .. } => Some(method),
        How::External(_) => None,
    });
    // A method that uses features decides, if there is one.
    match methods.max_by_key(|method| method.uses_features()) {
        Some(method) => {
            source.check(method)?;
            Ok(source.for_method(method))
        }
        None => Ok(source.clone()),
    }
}

struct Bench<'a> {
    gpu: &'a Gpu,
    contestants: &'a [Contestant<'a>],
    repeats: u32,
    /// Folder for the files of other programs.
    scratch: Aside<tempfile::TempDir>,
    /// Pictures for the page; `None` without a page.
    gallery: Option<Gallery>,
    bar: indicatif::ProgressBar,
    document: Document,
}

/// A set in memory.
struct ReadSet {
    frame: Frame,
    reference: Option<Image>,
}

impl Bench<'_> {
    /// Reads a set. Returns `None`, with a note, for a file that was found in a folder and cannot be used as a set.
    fn read(
        &mut self,
        file: &SetFile,
        source: &Source,
        sizes: usize,
        out: &mut Out,
    ) -> Result<Option<ReadSet>, Failure> {
        let name = stein::text::path(&file.file);
        let read = options::read(&source.request(&file.file)).and_then(|mut set| {
            if file.was_found && is_ours(&set) {
                return Err(Failure::input(format_args!("{name}: was written by stein")));
            }
            let frame =
                settle(&mut set, source.require_noise).0.map_err(|error| Failure::in_file(&file.file, error))?;
            self.check_halves(&frame, &file.file)?;
            let reference =
                file.reference.as_ref().map(|reference| quality::read(reference, &frame, &file.file)).transpose()?;
            Ok(ReadSet { frame, reference })
        });
        match read {
            Ok(read) => Ok(Some(read)),
            Err(failure) if file.was_found => {
                let note = format!("left out: {}", failure.message().lines().next().unwrap_or_default());
                self.bar.suspend(|| out.say(format_args!("note: {note}")));
                self.document.notes.push(note);
                self.bar.dec_length(sizes.max(1) as u64 * self.contestants.len() as u64 * runs(self.repeats));
                Ok(None)
            }
            Err(failure) => Err(failure),
        }
    }

    /// Lists the reduced noise knowledge of the contestants. Contestants that keep all knowledge are not in the list.
    fn noise_knowledges(&self) -> Vec<NoiseKnowledge> {
        let all: Vec<_> = self.contestants.iter().filter_map(Contestant::noise_knowledge).collect();
        distinct(&all, &[])
    }

    fn check_halves(&self, frame: &Frame, file: &Path) -> Result<(), Failure> {
        if frame.noise_knowledge().has_halves() || !self.noise_knowledges().into_iter().any(NoiseKnowledge::has_halves)
        {
            return Ok(());
        }
        let (name, remedy) = (stein::text::path(file), "leave halves out of --noise, or give the set's two halves");
        Err(Failure::input(format_args!(
            "{name}: --noise halves: it has no halves that can be used\n  remedy: {remedy}"
        )))
    }

    /// Measures a set at all sizes.
    fn set(&mut self, file: &SetFile, read: ReadSet, sizes: &[Extent]) -> Result<Vec<(Set, Vec<Row>)>, Failure> {
        let ReadSet { frame, reference } = read;
        let samples_per_pixel = mean_samples(&frame);
        let sizes = if sizes.is_empty() { vec![frame.extent()] } else { sizes.to_vec() };
        let are_given = sizes != [frame.extent()];
        let mut measured = Vec::new();
        for extent in sizes {
            let is_resized = extent != frame.extent();
            let covered;
            let frame = if is_resized {
                covered = cover_frame(&frame, extent)?;
                &covered
            } else {
                &frame
            };
            let reference = reference.as_ref().map(|reference| cover(reference, extent));
            let mut name = file.scene.clone();
            if let Some(samples) = samples_per_pixel {
                name +=
                    &if samples.fract() == 0.0 { format!(", {samples} spp") } else { format!(", {samples:.1} spp") };
            }
            if are_given {
                name += &format!(", {extent}");
            }
            if self.document.sets.iter().any(|other| other.name == name) {
                name += &format!(" ({})", stein::text::path(&file.file));
            }
            let set = Set {
                name,
                scene: file.scene.clone(),
                file: file.file.clone(),
                reference: file.reference.as_ref().map(|reference| reference.file.clone()),
                samples_per_pixel,
                width: extent.width,
                height: extent.height,
                is_resized,
                noisy: reference.as_ref().map(|reference| errors(&frame.color().mean, reference)).transpose()?,
            };
            self.check_halves(frame, &file.file)?;
            let less_known = |knowledge| Some((knowledge, frame.with_noise_known_from(knowledge)?));
            let less_known: Vec<_> = self.noise_knowledges().into_iter().filter_map(less_known).collect();
            let case = Case { set: &set, frame, less_known: &less_known, reference: reference.as_ref() };
            let outcomes = measure(self.gpu, self.contestants, &case, self.repeats, self.scratch.path(), &self.bar)?;
            if let Some(gallery) = &mut self.gallery {
                gallery.add(&case, &outcomes)?;
            }
            let rows: Vec<Row> = outcomes.into_iter().map(|outcome| outcome.row).collect();
            for row in rows.iter().filter(|row| row.errors.is_some_and(|errors| errors.relative_mse.is_none())) {
                self.document.notes.push(format!(
                    "{}, {}: the result holds values that are not finite, so that it has no errors",
                    row.set, row.configuration
                ));
            }
            self.document.sets.push(set.clone());
            self.document.rows.extend(rows.iter().cloned());
            measured.push((set, rows));
        }
        Ok(measured)
    }
}

/// Whether the file is an output of stein, which may lie beside its input.
fn is_ours(set: &BufferSet) -> bool {
    set.text_attribute("stein.version").is_some()
}

fn mean_samples(frame: &Frame) -> Option<f64> {
    match frame.samples_per_pixel() {
        SamplesPerPixel::Unknown => None,
        SamplesPerPixel::Uniform(count) => Some(f64::from(*count)),
        SamplesPerPixel::PerPixel(counts) => counts.planes.first().map(|plane| quality::mean(plane)),
    }
}
