//! `stein adapt`

mod folder;
mod renderer;
mod report;

use std::path::PathBuf;

use indicatif::ProgressFinish;
use stein::sampling::{Event, Resumed, SampleSchedule, Sampler, adapt, uniform};
use stein::text;
use stein::{Denoiser, Extent, Image};
use stein_exr::{LayerRef, read_reference};

use super::filter::Filter;
use super::options::Device;
use super::progress::bar;
use super::render::Picture;
use super::{Failure, Out, interrupt};
use folder::{Folder, Setup};
use renderer::{Renderer, Turn};
use report::{Document, Row};

const EXAMPLE: &str = "\
The first iteration samples evenly; the others sample where the estimated error of the denoised image is largest. All \
iterations have the same budget. For each iteration K, DIR gets map_K.exr (the samples drawn), samples_K.exr (all \
samples so far, in the layout that `stein denoise` reads) and denoised_K.exr.

--sampler-command runs any renderer in place of the built-in scenes, through the shell. In the command, {map} is \
replaced by the path of the map, {out} by the path of the file to write, and {iteration} by 1, 2, … The paths become \
quoted words of the shell: write no quotes around them. The map has the layers samples.V (even numbers of samples to \
draw), density.V (before rounding) and drawn.V (samples that the pixel has already). The renderer writes only the new \
samples: the colour and every feature, each with halves and variance, and a channel `samples`. If it draws other \
numbers, for example because it works in blocks, stein warns, and the numbers in its file count.

Before the last iteration, nlm filters with a radius of at most 7 pixels and an alpha of at most 0.5, and gem has \
fewer scales.

Examples:
  stein adapt dof --spp 64 -o loop
  stein adapt dof --spp 64 --size 128x128 --ref reference.exr -o loop
  stein adapt dof --spp 64 -o loop --resume                  goes on after an interruption
  stein adapt --sampler-command 'python3 render.py --map {map} --out {out} --seed {iteration}' \
--size 512x512 --spp 64 -o loop

Exit codes: 0 done, 2 wrong usage, 3 an input file or layer cannot be used, 4 no device or a device failed, 5 the \
output cannot be written, 1 anything else, such as a command that failed.";

/// Render adaptively: sample, denoise, and sample again where the error is
#[derive(Debug, clap::Args)]
#[command(
    after_help = EXAMPLE,
    override_usage = "stein adapt [OPTIONS] SCENE --spp N -o DIR\n       \
        stein adapt [OPTIONS] --sampler-command COMMAND --size WxH --spp N -o DIR"
)]
pub(crate) struct Args {
    /// A scene that `stein render --list` shows, such as dof
    #[arg(value_name = "SCENE", required_unless_present_any = ["list_devices", "sampler_command"])]
    scene: Option<String>,
    /// Command that draws the samples, in place of a built-in scene
    #[arg(long, value_name = "COMMAND", conflicts_with_all = ["scene", "seed", "sequence"], requires = "size")]
    sampler_command: Option<String>,
    /// Samples per pixel on average, over all iterations; an even number
    #[arg(long, value_name = "N", required_unless_present = "list_devices")]
    spp: Option<u32>,
    /// Number of iterations; the first samples evenly
    #[arg(long, value_name = "N", default_value_t = 4)]
    iterations: u32,
    /// Maximum of samples for one pixel in one iteration, so that outliers do not take them all [default: 8 times the
    /// samples per pixel of the first iteration]
    #[arg(long, value_name = "N")]
    cap: Option<u32>,
    /// Noise-free reference: print the errors of the noisy and the denoised images, also for even sampling
    #[arg(long = "ref", value_name = "FILE[::LAYER]")]
    reference: Option<LayerRef>,
    /// Take the path of --ref as it is, without a layer (`::`)
    #[arg(long)]
    literal: bool,
    /// Also draw the whole budget evenly, for comparison
    #[arg(long)]
    uniform: bool,
    /// Folder to write to; it is created if it does not exist
    #[arg(short, long, value_name = "DIR", required_unless_present = "list_devices")]
    output: Option<PathBuf>,
    /// Go on after the last complete iteration in DIR
    #[arg(long)]
    resume: bool,
    /// Delete the files of an earlier run in DIR
    #[arg(long, conflicts_with = "resume")]
    overwrite: bool,
    /// Print one JSON document in place of text
    #[arg(long)]
    pub(crate) json: bool,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    filter: Filter,
    #[command(flatten)]
    picture: Picture,
    #[command(flatten)]
    pub(crate) device: Device,
}

/// Inputs of the sampling loop besides the sampler.
struct LoopInputs<'a> {
    args: &'a Args,
    schedule: SampleSchedule,
    denoiser: Denoiser,
    folder: Folder,
    reference: Option<Image>,
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let spp = args.spp.ok_or_else(|| Failure::usage("no number of samples is given"))?;
    let output = args.output.as_deref().ok_or_else(|| Failure::usage("no output folder is given"))?;
    if args.quiet || args.json {
        out.silence();
    }
    let schedule = SampleSchedule::new(spp, args.iterations, args.cap).map_err(Failure::usage)?;
    let schedule = if args.cap.is_none() { schedule.with_default_cap() } else { schedule };
    let method = args.filter.chosen()?.method;
    let extent = args.picture.extent();
    let setup = Setup {
        scene: args.scene.as_deref(),
        sampler_command: args.sampler_command.as_deref(),
        size: [extent.width, extent.height],
        spp,
        iterations: args.iterations,
        cap: schedule.cap(),
        seed: args.picture.seed,
        sequence: args.picture.sequence,
        parameters: method,
    };
    // Reports wrong names before anything is written.
    let scene = args.scene.as_deref().map(|name| args.picture.sampler(name, extent, args.picture.seed)).transpose()?;
    if let Some(command) = &args.sampler_command {
        Renderer::check(command)?;
    }
    let reference = args.reference.clone().map(|reference| if args.literal { reference.literal() } else { reference });
    let reference = reference.map(|reference| read(&reference, extent)).transpose()?;
    let folder = Folder::open(output, &setup, args.resume, args.overwrite)?;
    let resumed = if args.resume { folder.resume(args.iterations)? } else { None };

    let gpu = args.device.open()?;
    let denoiser = args.device.denoiser(&gpu, method)?;
    let mut document = Document::new(&setup, gpu.summary(), resumed.as_ref().map(|resumed| resumed.iterations))?;
    let job = LoopInputs { args, schedule, denoiser, folder, reference };
    match (scene, &args.sampler_command) {
        (Some(fresh), _) => {
            let sampler = match &resumed {
                Some(resumed) => fresh.clone().continue_after(&resumed.samples.counts())?,
                None => fresh.clone(),
            };
            job.run(sampler, fresh, resumed, &mut document, out)?;
        }
        (None, Some(command)) => {
            let first = resumed.as_ref().map_or(1, |resumed| resumed.iterations + 1);
            let renderer = |turn| Renderer::new(command, extent, job.folder.path(), turn, args.quiet);
            job.run(
                renderer(Turn::Iteration(first)),
                renderer(Turn::Uniform(args.iterations + 1)),
                resumed,
                &mut document,
                out,
            )?;
        }
        (None, None) => return Err(Failure::usage("neither a scene nor a sampler command is given")),
    }
    if args.json { out.json(&document) } else { Ok(()) }
}

fn read(reference: &LayerRef, extent: Extent) -> Result<Image, Failure> {
    let image = read_reference(&reference.file, reference.layer.as_deref())?;
    if image.extent == extent {
        return Ok(image);
    }
    let (name, found) = (text::path(&reference.file), image.extent);
    Err(Failure::input(format_args!(
        "{name}: is of {found}, but the picture is of {extent}\n  remedy: render both with the same --size"
    )))
}

impl LoopInputs<'_> {
    /// Runs the adaptive loop with `sampler`. Then runs even sampling with `fresh`, a sampler that has drawn nothing
    /// yet, if `--uniform` or a reference asks for the comparison.
    fn run<S: Sampler>(
        &self,
        mut sampler: S,
        mut fresh: S,
        resumed: Option<Resumed>,
        document: &mut Document,
        out: &mut Out,
    ) -> Result<(), Failure> {
        out.say(Row::head(self.reference.is_some()));
        adapt(
            &mut sampler,
            &self.denoiser,
            &self.schedule,
            resumed,
            self.observer(None, &mut document.iterations, out),
        )?;
        if self.args.uniform || self.reference.is_some() {
            let mut rows = Vec::new();
            uniform(&mut fresh, &self.denoiser, &self.schedule, self.observer(Some("uniform"), &mut rows, out))?;
            document.uniform = rows.pop();
        }
        out.say(document.comparison());
        out.say(text::path(self.folder.path()));
        Ok(())
    }

    /// Returns the callback of a run. The callback writes the files, compares with the reference and prints a row; the
    /// label of files and rows is `name`, or the number of the iteration if `name` is `None`.
    fn observer<'a>(
        &'a self,
        name: Option<&'a str>,
        rows: &'a mut Vec<Row>,
        out: &'a mut Out,
    ) -> impl FnMut(Event<'_>) -> Result<(), Failure> + Send + use<'a> {
        let iterations = if name.is_some() { 1 } else { self.schedule.iterations() };
        // An external renderer shows its own progress.
        let bar = bar(!self.args.quiet && !self.args.json && self.args.sampler_command.is_none(), 1000)
            .with_finish(ProgressFinish::AndClear);
        let label = move |iteration: u32| name.map_or_else(|| iteration.to_string(), str::to_owned);
        move |event| {
            interrupt::check()?;
            let advance = |iteration: u32, share: f32| {
                bar.set_position((1000.0 * (iteration as f32 - 1.0 + share) / iterations as f32) as u64);
            };
            match event {
                // Nobody knows whether drawing or denoising takes longer, so each counts as half of the iteration.
                Event::Drawing { iteration, share } => advance(iteration, share / 2.0),
                Event::Denoising { iteration, share } => advance(iteration, (1.0 + share) / 2.0),
                Event::Planned { iteration, map, drawn } => self.folder.write_map(&label(iteration), map, drawn)?,
                Event::Finished { iteration, map: _, samples, estimate, method } => {
                    self.folder.write(&label(iteration), samples, estimate, method)?;
                    let row = Row::new(label(iteration), samples, estimate, self.reference.as_ref())?;
                    bar.suspend(|| out.say(row.text()));
                    rows.push(row);
                }
            }
            Ok(())
        }
    }
}
