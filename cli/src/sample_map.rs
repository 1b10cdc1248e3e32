//! `stein sample-map`

use std::ops::ControlFlow;
use std::path::PathBuf;
use stein_exr::MapFile;
use stein_exr::picture_file::Format;

use serde::Serialize;
use stein::Options;
use stein::frame::SamplesPerPixel;
use stein::gpu::AdapterSummary;
use stein::method::Intermediate;
use stein::sampling::{SampleCounts, SamplingMap, sampling_density};
use stein::text::{self, number};

use super::filter::Filter;
use super::inspect::{Input, settle_first};
use super::options::{self, Device, Source};
use super::{Failure, Out, interrupt, output};

const EXAMPLE: &str = "\
The map has a layer `density.V` (samples per pixel, real numbers) and a layer `samples.V` (even whole numbers with the \
same sum). If the input states the samples of its pixels, a layer `drawn.V` holds them. Samples go where the estimated \
relative error is largest, weighted by how many pixels profit (thesis 7.1.2, 8.6).

For the map, nlm filters with a radius of at most 7 pixels and an alpha of at most 0.5, gem has fewer scales, and \
spikes stay, even if --params says otherwise.

Examples:
  stein sample-map render.exr --budget 16             writes render.map.exr
  stein sample-map render.exr --budget 16 --cap 128 -o map.exr

Exit codes: 0 done, 2 wrong usage, 3 an input file or layer cannot be used, 4 no device or a device failed, 5 the \
output cannot be written, 1 anything else.";

/// Make a map of where a renderer's next samples pay most
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE, override_usage = "stein sample-map [OPTIONS] IN --budget SPP")]
pub(crate) struct Args {
    /// OpenEXR file, as for `stein denoise`
    #[arg(value_name = "IN", required_unless_present = "list_devices")]
    input: Option<PathBuf>,
    /// Other renders of the same frame with other seeds, which are merged with IN
    #[arg(value_name = "SEED")]
    further: Vec<PathBuf>,
    /// Samples to distribute, per pixel on average, such as 16
    #[arg(long, value_name = "SPP", required_unless_present = "list_devices")]
    budget: Option<f64>,
    /// Maximum of samples for one pixel, so that outliers do not take them all [default: 8 times the budget]
    #[arg(long, value_name = "N")]
    cap: Option<u32>,
    /// File to write [default: IN with the extension `.map.exr`]
    #[arg(short, long, value_name = "MAP")]
    output: Option<PathBuf>,
    /// Print one JSON document in place of text
    #[arg(long)]
    pub(crate) json: bool,
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

#[derive(Serialize)]
struct Document {
    input: Input,
    device: AdapterSummary,
    #[serde(serialize_with = "text::serialize_path")]
    output: PathBuf,
    map: Spread,
}

/// Distribution of samples over the pixels.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Spread {
    pub(crate) samples_per_pixel: f64,
    total_samples: u64,
    least: u64,
    most: u64,
    /// Share of the pixels without samples, 0 to 1.
    none: f64,
}

impl Spread {
    pub(crate) fn of(counts: &SampleCounts) -> Self {
        let (pairs, pixels) = (counts.pairs(), counts.pairs().len() as f64);
        let samples = || pairs.iter().map(|&pairs| 2 * u64::from(pairs));
        Self {
            samples_per_pixel: counts.total_samples() as f64 / pixels,
            total_samples: counts.total_samples(),
            least: samples().min().unwrap_or(0),
            most: samples().max().unwrap_or(0),
            none: samples().filter(|&samples| samples == 0).count() as f64 / pixels,
        }
    }

    /// Formats the range from the smallest to the largest number of samples of a pixel.
    pub(crate) fn range(&self) -> String {
        if self.least == self.most { self.least.to_string() } else { format!("{}–{}", self.least, self.most) }
    }
}

impl std::fmt::Display for Spread {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { samples_per_pixel, total_samples, least, most, none } = self;
        let average = number(*samples_per_pixel);
        write!(
            f,
            "{total_samples} samples, {average} per pixel, from {least} to {most}; {:.1} % of the pixels get none",
            100.0 * none
        )
    }
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let input = args.input.as_deref().ok_or_else(|| Failure::usage("no input is given"))?;
    let budget = args.budget.ok_or_else(|| Failure::usage("no budget is given"))?;
    if args.quiet || args.json {
        out.silence();
    }
    let method = args.filter.chosen()?.method;
    if args.filter.sets_spikes() {
        return Err(Failure::usage(
            "--spikes: where more samples are to be drawn, spikes stay\n  remedy: leave it out",
        ));
    }
    args.source.check(&method)?;
    let request = args.source.for_method(&method).request(input, &args.further);
    let file = args.output.clone().unwrap_or_else(|| input.with_extension("map.exr"));
    output::check(&file, &[Format::OpenExr], request.files(), false, false)?;

    let mut set = options::read(&request)?;
    output::check_not_read(&file, &set)?;
    let (frame, described) = settle_first(&mut set, args.source.demands);
    out.say(described.text(false));
    let frame = frame.map_err(|error| Failure::in_file(input, error))?;
    let gpu = args.device.open()?;
    let denoiser = args.device.denoiser(&gpu, method)?.while_sampling();
    let mut progress = |_: f32| if interrupt::is_asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let estimate = denoiser.denoise_with(
        &frame,
        Options { keep: &[Intermediate::Density], error: false, progress: Some(&mut progress), ..Default::default() },
    )?;
    // At least one pair of samples, even for a small budget.
    let cap = args.cap.unwrap_or_else(|| (budget * f64::from(SamplingMap::DEFAULT_CAP)).max(2.0) as u32);
    let density = sampling_density(&estimate, budget, budget * f64::from(SamplingMap::DEFAULT_CAP))?;
    let map = SamplingMap::new(&density, budget, Some(cap)).map_err(Failure::usage)?;
    let spread = Spread::of(&map.counts);
    let drawn = drawn(&set.samples_per_pixel(), frame.extent());
    MapFile { map, drawn, windows: Some(set.windows()) }.write(&file, &[]).map_err(Failure::output)?;
    out.say(format_args!("{}: {spread}", text::path(&file)));
    if args.json {
        out.json(&Document { input: described, device: gpu.summary().clone(), output: file, map: spread })
    } else {
        Ok(())
    }
}

/// Returns the samples that the pixels have, if the input states them in whole pairs.
fn drawn(samples: &SamplesPerPixel, extent: stein::Extent) -> Option<SampleCounts> {
    let pairs = |samples: f32| {
        (samples >= 0.0 && samples % 2.0 == 0.0 && samples < u32::MAX as f32).then_some((samples / 2.0) as u32)
    };
    let pairs = match samples {
        SamplesPerPixel::Unknown => return None,
        SamplesPerPixel::Uniform(samples) => vec![pairs(*samples)?; extent.pixels()],
        SamplesPerPixel::PerPixel(image) => {
            image.planes[0].iter().map(|&samples| pairs(samples)).collect::<Option<_>>()?
        }
    };
    SampleCounts::from_pairs(extent, pairs).ok()
}
