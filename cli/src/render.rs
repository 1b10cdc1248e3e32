//! `stein render`

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::Instant;
use stein_exr::{MapFile, write_samples};

use clap::ValueEnum;
use serde::Serialize;
use stein::sampling::{SampleCounts, Sampler};
use stein::text;
use stein::{Extent, Image};
use stein_exr::picture_file::Format;
use stein_exr::{NamedLayer, write_layers};
use stein_stub::{Sequence, StubSampler, scene, scenes};

use super::options::size;
use super::out::{seconds, table};
use super::progress::bar;
use super::{Failure, Out, interrupt, output};

const EXAMPLE: &str = "\
The file holds the colour and the features albedo, normal, depth, visibility and caustic, each with both halves and \
the sample variance of the mean.

Examples:
  stein render --list
  stein render dof --spp 32 -o noisy.exr
  stein render dof --reference --spp 8192 -o reference.exr
  stein sample-map noisy.exr --budget 16 -o map.exr && stein render dof --map map.exr -o more.exr
  stein adapt --sampler-command 'stein render dof --map {map} -o {out}' --size 256x256 --spp 64 -o loop

Exit codes: 0 done, 2 wrong usage, 3 an input file or layer cannot be used, 5 the output cannot be written, 1 anything \
else.";

/// Number of samples per pixel of a reference, if `--spp` is not given.
const REFERENCE_SAMPLES: u32 = 4096;

/// Render a small built-in scene, to try the denoiser and adaptive sampling
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE, override_usage = "stein render [OPTIONS] SCENE")]
pub(crate) struct Args {
    /// A scene that --list shows, such as dof
    #[arg(value_name = "SCENE", required_unless_present = "list")]
    scene: Option<String>,
    /// List the scenes, and do nothing else
    #[arg(long)]
    list: bool,
    /// Samples per pixel, an even number: half of them for each half
    #[arg(long, value_name = "N", required_unless_present_any = ["list", "map", "reference"], conflicts_with = "map")]
    spp: Option<u32>,
    /// Sampling map: draw the numbers of samples in its layer `samples`, after those in its layer `drawn`; the image
    /// has the size of the map
    #[arg(long, value_name = "MAP.exr", conflicts_with_all = ["reference", "size"])]
    map: Option<PathBuf>,
    /// Write only the colour, from samples that no other render with this seed draws [default --spp: 4096]
    #[arg(long)]
    reference: bool,
    /// File to write [default: SCENE.exr, or SCENE_reference.exr]
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
    #[command(flatten)]
    picture: Picture,
}

/// Settings that, with the scene, decide the samples.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Picture")]
pub(crate) struct Picture {
    /// Width and height in pixels [default: 256x256]
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub(crate) size: Option<Extent>,
    /// Seed of the random numbers: the same seed gives the same samples
    #[arg(long, value_name = "S", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Distribution of the samples
    #[arg(long, value_enum, default_value = "random")]
    pub(crate) sequence: SequenceName,
}

/// As [`Sequence`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum SequenceName {
    /// Independent random numbers
    Random,
    /// Scrambled Sobol points: less noise
    LowDiscrepancy,
}

impl Picture {
    pub(crate) fn extent(&self) -> Extent {
        self.size.unwrap_or(Extent { width: 256, height: 256 })
    }

    /// Returns a sampler of a scene; the sampler has drawn nothing yet.
    pub(crate) fn sampler(&self, name: &str, extent: Extent, seed: u64) -> Result<StubSampler, Failure> {
        let sequence = match self.sequence {
            SequenceName::Random => Sequence::Random,
            SequenceName::LowDiscrepancy => Sequence::LowDiscrepancy,
        };
        let scene = scene(name).ok_or_else(|| {
            let known: Vec<_> = scenes().map(|(name, _)| name).collect();
            Failure::usage(format_args!("there is no scene '{name}'\n  remedy: choose one of {}", known.join(", ")))
        })?;
        Ok(StubSampler::new(scene, extent, seed, sequence))
    }
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    if args.list {
        out.say(table(
            &scenes().map(|(name, description)| vec![name.to_owned(), description.to_owned()]).collect::<Vec<_>>(),
            2,
        ));
        return Ok(());
    }
    if args.quiet {
        out.silence();
    }
    let name = args.scene.as_deref().ok_or_else(|| Failure::usage("no scene is given"))?;
    let file = args.output.clone().unwrap_or_else(|| {
        PathBuf::from(if args.reference { format!("{name}_reference.exr") } else { format!("{name}.exr") })
    });
    output::check(&file, &[Format::OpenExr], args.map.as_deref().into_iter(), false, false)?;

    let map = args.map.as_deref().map(MapFile::read).transpose()?;
    let extent = map.as_ref().map_or(args.picture.extent(), |map| map.map.counts.extent());
    // Nobody is likely to choose this seed for another render.
    let seed = if args.reference { !args.picture.seed } else { args.picture.seed };
    let mut sampler = args.picture.sampler(name, extent, seed)?;
    let counts = match (map, args.spp) {
        (Some(MapFile { map, drawn, .. }), _) => {
            if let Some(drawn) = drawn {
                sampler = sampler.continue_after(&drawn)?;
            }
            map.counts
        }
        (None, spp) => SampleCounts::uniform(extent, spp.unwrap_or(REFERENCE_SAMPLES)).map_err(Failure::usage)?,
    };
    if counts.total_samples() == 0 {
        return Err(Failure::usage("there are no samples to draw\n  remedy: ask for at least 2 per pixel"));
    }

    let start = Instant::now();
    let bar = bar(!args.quiet, 1000);
    let mut progress = |share: f32| {
        bar.set_position((share * 1000.0) as u64);
        if interrupt::is_asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let samples = sampler.sample(&counts, Some(&mut progress));
    bar.finish_and_clear();
    let samples = samples?;
    let average = counts.total_samples() as f64 / extent.pixels() as f64;
    let texts = [("scene".to_owned(), name.to_owned()), ("seed".to_owned(), seed.to_string())];
    if args.reference {
        write_color(&file, samples.color().mean, average, &texts)?;
    } else {
        write_samples(&samples, &file, &texts).map_err(Failure::output)?;
    }
    out.say(format_args!(
        "{}: {extent}, {average} samples per pixel, {}",
        text::path(&file),
        seconds(start.elapsed().as_secs_f64())
    ));
    Ok(())
}

fn write_color(file: &Path, color: Image, samples: f64, texts: &[(String, String)]) -> Result<(), Failure> {
    let layer = NamedLayer { name: String::new(), channels: ["R", "G", "B"].map(str::to_owned).to_vec(), image: color };
    let texts: Vec<_> = texts.iter().cloned().chain([("samples".to_owned(), samples.to_string())]).collect();
    write_layers(file, &[layer], &texts).map_err(Failure::output)
}
