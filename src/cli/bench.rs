//! `stein bench`: how fast the presets are, as ratios within one run.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::ValueEnum;
use serde::Serialize;
use stein::buffers::LayerRef;
use stein::gpu::{AdapterSummary, Gpu};
use stein::{Denoiser, Extent, Frame, Image, Preset, metric};

use super::inspect::settle;
use super::options::{Choice, Device, PresetName, Source, size};
use super::out::{bytes, milliseconds, number, table};
use super::progress::bar;
use super::quality;
use super::tile::{cover, cover_frame};
use super::{Failure, Out};

const EXAMPLE: &str = "\
Every preset runs once to warm up, then N times in turn with the others: the median time on the clock, from the frame in memory to the result in memory. Each of \
these runs is followed by one in which the device times its stages, which slows it a little. Times of different machines, or of different days, say less than the ratios \
within one run.

Examples:
  stein bench render.exr --ref converged.exr
  stein bench render.exr --size 1024x1024,2048x2048 --repeat 9 --json";

/// Measure the speed, memory and error of the presets
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE, override_usage = "stein bench [OPTIONS] IN…")]
pub(crate) struct Args {
    /// OpenEXR files, as for `stein denoise`
    #[arg(value_name = "IN", required_unless_present = "list_devices")]
    inputs: Vec<PathBuf>,
    /// Noise-free reference, one for each input in their order
    #[arg(long = "ref", value_name = "FILE[::LAYER]")]
    references: Vec<LayerRef>,
    /// Measured runs of each preset
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
    /// Sizes to measure at: the input is repeated, mirrored at the seams, or cut off [default: its own]
    #[arg(long = "size", value_name = "WxH", value_delimiter = ',', value_parser = size)]
    sizes: Vec<Extent>,
    /// Presets to measure [default: all]
    #[arg(long = "preset", value_enum, value_delimiter = ',')]
    presets: Vec<PresetName>,
    /// Print one JSON document
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    choice: Choice,
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    pub(crate) device: Device,
}

#[derive(Serialize)]
struct Document {
    device: AdapterSummary,
    repeats: u32,
    cases: Vec<Case>,
}

/// One input at one size.
#[derive(Serialize)]
struct Case {
    input: PathBuf,
    width: u32,
    height: u32,
    window_radius: u32,
    noisy_relative_mse: Option<f64>,
    presets: Vec<Measured>,
    /// Where both were measured.
    default_to_thesis: Option<Ratios>,
}

#[derive(Serialize)]
struct Measured {
    preset: Preset,
    total_ms: f64,
    total_ms_per_megapixel: f64,
    /// Sum of the stages; `None` where the adapter cannot time them.
    device_ms: Option<f64>,
    stages: Vec<Stage>,
    strips: usize,
    peak_bytes: u64,
    relative_mse: Option<f64>,
}

#[derive(Serialize)]
struct Stage {
    stage: String,
    ms: f64,
    dispatches: usize,
}

#[derive(Serialize)]
struct Ratios {
    total: f64,
    device: Option<f64>,
    relative_mse: Option<f64>,
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    if args.json {
        out.silence();
    }
    if !args.references.is_empty() && args.references.len() != args.inputs.len() {
        let (references, inputs) = (args.references.len(), args.inputs.len());
        return Err(Failure::usage(format_args!(
            "{references} references are given for {inputs} inputs\n  remedy: give --ref once for each input, or not at all"
        )));
    }
    let names = if args.presets.is_empty() { PresetName::value_variants() } else { &args.presets };
    let methods = names.iter().map(|name| Ok((name.preset(), args.choice.method(*name)?))).collect::<Result<Vec<_>, Failure>>()?;
    methods.iter().try_for_each(|(_, method)| args.source.check(method))?;
    // The presets are of one method.
    let source = methods.first().map_or_else(|| args.source.clone(), |(_, method)| args.source.for_method(method));
    let gpu = args.device.open()?;
    let denoisers = methods.into_iter().map(|(preset, method)| Ok((preset, args.device.denoiser(&gpu, method)?))).collect::<Result<Vec<_>, Failure>>()?;
    out.say(format_args!("{}, median of {}", gpu.summary(), args.repeat));

    let mut document = Document { device: gpu.summary().clone(), repeats: args.repeat, cases: Vec::new() };
    for (index, input) in args.inputs.iter().enumerate() {
        let frame = settle(&source.read(input)?).0.map_err(|error| Failure::in_file(input, error))?;
        let reference = args.references.get(index).map(|reference| quality::read(reference, &frame, input)).transpose()?;
        let sizes = if args.sizes.is_empty() { vec![frame.extent()] } else { args.sizes.clone() };
        for extent in sizes {
            let covered;
            let frame = if extent == frame.extent() {
                &frame
            } else {
                covered = cover_frame(&frame, extent)?;
                &covered
            };
            let reference = reference.as_ref().map(|reference| cover(reference, extent));
            let case = measure(&gpu, &denoisers, input, frame, reference.as_ref(), args)?;
            out.say(case.text());
            document.cases.push(case);
        }
    }
    if args.json { out.json(&document) } else { Ok(()) }
}

fn measure(gpu: &Gpu, denoisers: &[(Preset, Denoiser)], input: &Path, frame: &Frame, reference: Option<&Image>, args: &Args) -> Result<Case, Failure> {
    let Extent { width, height } = frame.extent();
    let megapixels = frame.extent().pixels() as f64 * 1e-6;
    let error = |image: &Image| reference.map(|reference| metric::relative_mse(image, reference)).transpose();
    let bar = bar(!args.json, denoisers.len() as u64 * (1 + 2 * u64::from(args.repeat)));
    let run = |denoiser: &Denoiser, timing: bool| {
        gpu.set_timing(timing);
        let estimate = denoiser.denoise(frame);
        bar.inc(1);
        estimate
    };

    // The first dispatch of a kernel compiles it.
    let first = denoisers.iter().map(|(_, denoiser)| run(denoiser, false)).collect::<Result<Vec<_>, _>>()?;
    let mut totals = vec![Vec::new(); denoisers.len()];
    let mut stages: Vec<Vec<(String, usize, Vec<f64>)>> = vec![Vec::new(); denoisers.len()];
    for _ in 0..args.repeat {
        // In turn, so that a machine that slows down meanwhile slows down for all.
        for (index, (_, denoiser)) in denoisers.iter().enumerate() {
            let start = Instant::now();
            run(denoiser, false)?;
            totals[index].push(start.elapsed().as_secs_f64() * 1e3);
            for time in run(denoiser, true)?.stage_times.unwrap_or_default() {
                let known = stages[index].iter().position(|(stage, ..)| *stage == time.stage);
                let known = known.unwrap_or_else(|| {
                    stages[index].push((time.stage, time.dispatches, Vec::new()));
                    stages[index].len() - 1
                });
                stages[index][known].2.push(time.seconds * 1e3);
            }
        }
    }
    bar.finish_and_clear();

    let mut presets = Vec::new();
    for (((preset, _), estimate), (total, stages)) in denoisers.iter().zip(first).zip(totals.into_iter().zip(stages)) {
        let total_ms = median(total);
        let stages: Vec<_> = stages.into_iter().map(|(stage, dispatches, times)| Stage { stage, ms: median(times), dispatches }).collect();
        presets.push(Measured {
            preset: *preset,
            total_ms,
            total_ms_per_megapixel: total_ms / megapixels,
            device_ms: (!stages.is_empty()).then(|| stages.iter().map(|stage| stage.ms).sum()),
            stages,
            strips: estimate.strips,
            peak_bytes: estimate.peak_bytes,
            relative_mse: error(&estimate.color)?,
        });
    }
    let window_radius = denoisers.first().map_or(0, |(_, denoiser)| denoiser.method().window_radius());
    let noisy_relative_mse = error(&frame.color().mean)?;
    let default_to_thesis = Ratios::of(&presets);
    Ok(Case { input: input.to_owned(), width, height, window_radius, noisy_relative_mse, presets, default_to_thesis })
}

impl Ratios {
    fn of(presets: &[Measured]) -> Option<Self> {
        let find = |preset| presets.iter().find(|measured| measured.preset == preset);
        let (default, thesis) = (find(Preset::Default)?, find(Preset::Thesis)?);
        Some(Self {
            total: default.total_ms / thesis.total_ms,
            device: default.device_ms.zip(thesis.device_ms).map(|(default, thesis)| default / thesis),
            relative_mse: default.relative_mse.zip(thesis.relative_mse).map(|(default, thesis)| default / thesis),
        })
    }
}

impl Case {
    /// A column for each preset.
    fn text(&self) -> String {
        let ratios = self.default_to_thesis.as_ref();
        let mut head = vec![String::new()];
        head.extend(self.presets.iter().map(|measured| match measured.preset {
            Preset::Default => "default".to_owned(),
            Preset::Thesis => "thesis".to_owned(),
        }));
        head.extend(ratios.map(|_| "default/thesis".to_owned()));
        let mut rows = vec![head];
        let mut add = |name: &str, values: &dyn Fn(&Measured) -> Option<String>, ratio: Option<f64>| {
            let mut row = vec![name.to_owned()];
            row.extend(self.presets.iter().map(|measured| values(measured).unwrap_or_else(|| "-".to_owned())));
            row.extend(ratio.map(number));
            rows.push(row);
        };
        add("total, ms", &|measured| Some(milliseconds(measured.total_ms)), ratios.map(|ratios| ratios.total));
        add("total, ms per megapixel", &|measured| Some(milliseconds(measured.total_ms_per_megapixel)), None);
        add("stages, ms", &|measured| measured.device_ms.map(milliseconds), ratios.and_then(|ratios| ratios.device));
        let mut names: Vec<&str> = Vec::new();
        for stage in self.presets.iter().flat_map(|measured| &measured.stages) {
            if !names.contains(&stage.stage.as_str()) {
                names.push(&stage.stage);
            }
        }
        for name in names {
            add(&format!("  {name}"), &|measured| measured.stages.iter().find(|stage| stage.stage == name).map(|stage| milliseconds(stage.ms)), None);
        }
        add("peak memory", &|measured| Some(bytes(measured.peak_bytes)), None);
        if self.presets.iter().any(|measured| measured.strips > 1) {
            add("strips", &|measured| Some(measured.strips.to_string()), None);
        }
        if let Some(noisy) = self.noisy_relative_mse {
            let name = format!("relative MSE, of {} when noisy", number(noisy));
            add(&name, &|measured| measured.relative_mse.map(number), ratios.and_then(|ratios| ratios.relative_mse));
        }
        format!("{}, {}×{}, radius {}\n{}", self.input.display(), self.width, self.height, self.window_radius, table(&rows, 1))
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values.as_slice() {
        [] => f64::NAN,
        values if values.len() % 2 == 1 => values[values.len() / 2],
        values => (values[values.len() / 2 - 1] + values[values.len() / 2]) / 2.0,
    }
}
