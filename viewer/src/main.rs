//! `stein-viewer`: the command line of the viewer.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Parser, ValueEnum};
use eframe::egui::{Theme, Vec2, ViewportBuilder};
use stein::gpu::DeviceChoice;
use stein::{Error, Gpu, Method, Preset, text};
use stein_exr::options::{choice, gpu_options};
use stein_exr::{BufferSetRequest, LayerRef};
use stein_viewer::adaptive::Setup;
use stein_viewer::document::Source;
use stein_viewer::files::is_reference;
use stein_viewer::panel::Panel;
use stein_viewer::screenshot::{self, Shot};
use stein_viewer::settings::Parameters;
use stein_viewer::view::Compare;
use stein_viewer::{Start, Viewer, app, device, sweep, words};

const AFTER_HELP: &str = "\
Paths: a path that exists is taken as that file, whatever its characters. In other paths `FILE::LAYER` is a layer of a \
file. --literal takes every path as it is. Write a name that begins with a dash as ./-name.

Exit codes: 0 done, 2 wrong usage, 3 an input file or layer cannot be used, 4 no device, or a device that cannot show \
a window, 5 the picture cannot be written, 1 anything else.

Environment:
  STEIN_CACHE  folder for compiled shaders, kept between runs if the driver hands them out; empty: keep none \
[default: `stein` among the user's caches]

Examples:
  stein-viewer testdata/dof_spheres_32spp.exr --reference testdata/dof_spheres_reference.exr
  stein-viewer seed1.exr seed2.exr
  stein-viewer color.pfm --feature albedo=albedo.pfm --feature normal=normal.pfm
  stein-viewer both.exr::beauty --half-a a.exr --half-b b.exr --reference all.exr::converged
  stein-viewer render.exr --screenshot selection.png --layer selection";

/// Looks inside a denoised frame: candidates, selection, estimated error, sampling density.
#[derive(Debug, Parser)]
#[command(name = "stein-viewer", version, after_help = AFTER_HELP)]
#[command(group = clap::ArgGroup::new("shown").args(["file", "adapt"]).multiple(false))]
struct Args {
    /// OpenEXR file with the noisy image, usually its halves or variance, and features; with the layer of the image if
    /// that has an unusual name, or if the file holds several images. Or a PFM or PNG file with the noisy image
    #[arg(value_name = "FILE[::LAYER]")]
    file: Option<LayerRef>,
    /// Other renders of the same frame with other seeds: all are merged, and their differences tell the noise
    #[arg(value_name = "SEED")]
    further: Vec<PathBuf>,
    /// The true image, to compare with
    #[arg(long, value_name = "FILE[::LAYER]", requires = "file")]
    reference: Option<LayerRef>,
    /// Takes every path as it is: `::` in a path separates no layer from its file
    #[arg(long, requires = "file")]
    literal: bool,
    /// Samples a built-in scene adaptively instead of opening a file: soft, dof, motion, caustic, texture or spikes
    #[arg(long, value_name = "SCENE", conflicts_with = "file")]
    adapt: Option<String>,
    /// Method [default: the method of --params; without any filter option, the method used last; else dfc]
    #[arg(long, value_parser = choice(&Method::all(), &Method::choices()))]
    method: Option<Method>,
    /// Preset of the parameters [default: the preset of --params; without any filter option, the preset used last; else
    /// default]
    #[arg(long, value_parser = choice(Preset::ALL, &Preset::choices()))]
    preset: Option<Preset>,
    /// TOML file with method, preset and parameters, such as `stein params` writes
    #[arg(long, value_name = "FILE")]
    params: Option<PathBuf>,
    /// Of dfc and nlm: radius of the window that is averaged over, in pixels [default: 10]
    #[arg(long, value_name = "PIXELS")]
    radius: Option<u32>,
    /// Adapter, by its index or a part of its name [default: the fastest kind]
    #[arg(long, value_name = "NAME|INDEX")]
    device: Option<DeviceChoice>,
    /// The layer to show, by its name, such as result, selection or albedo_prefiltered [default: result]
    #[arg(long, value_name = "NAME")]
    layer: Option<String>,
    /// A second layer, to compare with [default: the reference, or the noisy image]
    #[arg(long, value_name = "NAME")]
    other: Option<String>,
    /// How the two layers are shown
    #[arg(long, value_enum, default_value = "single")]
    compare: CompareName,
    /// The panel beside the image
    #[arg(long, value_enum, default_value = "display")]
    panel: PanelName,
    /// A pixel to keep chosen, from 0 at the upper left
    #[arg(long, value_name = "X,Y", value_parser = pixel)]
    pixel: Option<[u32; 2]>,
    /// Measures error against run time, over radii and presets: the plot's panel shows it
    #[arg(long, requires = "file")]
    sweep: bool,
    /// With --panel kernel: the neighbour of the pixel to explain, as an offset from it
    #[arg(long, value_name = "DX,DY", value_parser = offset, requires = "pixel", allow_hyphen_values = true)]
    neighbour: Option<[i32; 2]>,
    /// Writes a picture of the window as PNG, without opening one
    #[arg(long, value_name = "FILE", requires = "shown")]
    screenshot: Option<PathBuf>,
    /// Size of the window, in points
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1280x720", value_parser = size)]
    size: [f32; 2],
    /// Of a screenshot: pixels per point
    #[arg(long, value_name = "NUMBER", default_value_t = 1.0, requires = "screenshot", value_parser = scale)]
    scale: f32,
    /// Closes the window after so many frames without work, for tests
    #[arg(long, value_name = "NUMBER", hide = true, conflicts_with = "screenshot")]
    exit_after_frames: Option<u32>,
    /// Of a screenshot: dark or light
    #[arg(long, value_enum, default_value = "dark", requires = "screenshot")]
    theme: ThemeName,
    #[command(flatten)]
    others: BufferSetRequest,
}

/// As [`Compare`].
#[derive(Clone, Copy, Debug, ValueEnum)]
enum CompareName {
    /// The layer alone
    Single,
    /// Side by side
    SideBySide,
    /// Left and right of a line
    Wipe,
    /// One after the other
    Blink,
    /// The layer minus the other
    Difference,
    /// The layer minus the other, relative to the other
    Relative,
}

impl CompareName {
    fn compare(self) -> Compare {
        match self {
            Self::Single => Compare::Single,
            Self::SideBySide => Compare::SideBySide,
            Self::Wipe => Compare::Wipe,
            Self::Blink => Compare::Blink,
            Self::Difference => Compare::Difference,
            Self::Relative => Compare::Relative,
        }
    }
}

/// As [`Panel`].
#[derive(Clone, Copy, Debug, ValueEnum)]
enum PanelName {
    /// Exposure, ranges, histogram
    Display,
    /// Method and its parameters
    Parameters,
    /// All values of a pixel
    Pixel,
    /// Which neighbours made a pixel, and why
    Kernel,
    /// What ran and what was left out
    Report,
    /// Error against run time
    Plot,
    /// The adaptive loop on a built-in scene
    Sampling,
}

impl PanelName {
    fn panel(self) -> Panel {
        match self {
            Self::Display => Panel::Display,
            Self::Parameters => Panel::Parameters,
            Self::Pixel => Panel::Pixel,
            Self::Kernel => Panel::Kernel,
            Self::Report => Panel::Report,
            Self::Plot => Panel::Plot,
            Self::Sampling => Panel::Sampling,
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ThemeName {
    Dark,
    Light,
}

fn size(text: &str) -> Result<[f32; 2], String> {
    let sides = text
        .split_once(['x', '×'])
        .and_then(|(width, height)| Some((width.parse::<u16>().ok()?, height.parse::<u16>().ok()?)));
    match sides {
        Some((width @ 320..=8192, height @ 240..=8192)) => Ok([width.into(), height.into()]),
        _ => Err("it must look like 1280x720, from 320x240 to 8192x8192".into()),
    }
}

fn pixel(text: &str) -> Result<[u32; 2], String> {
    let place = text.split_once(',').and_then(|(x, y)| Some([x.trim().parse().ok()?, y.trim().parse().ok()?]));
    place.ok_or_else(|| "it must look like 40,30".into())
}

fn offset(text: &str) -> Result<[i32; 2], String> {
    let offset = text.split_once(',').and_then(|(x, y)| Some([x.trim().parse().ok()?, y.trim().parse().ok()?]));
    offset.ok_or_else(|| "it must look like -3,5".into())
}

fn scale(text: &str) -> Result<f32, String> {
    text.parse()
        .ok()
        .filter(|scale| (0.5..=4.0).contains(scale))
        .ok_or_else(|| "it must be a number from 0.5 to 4".into())
}

/// Error message with which the program ends, and its exit code.
struct Failure {
    code: u8,
    message: String,
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let code = match &error {
            Error::File { .. } | Error::Layer { .. } => 3,
            Error::Request { .. } => 2,
            Error::Device { .. } => 4,
            _ => 1,
        };
        Self { code, message: words::told(&error) }
    }
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure { code, message }) => {
            eprintln!("stein-viewer: error: {message}");
            code.into()
        }
    }
}

fn run(args: &Args) -> Result<(), Failure> {
    let start = start(args)?;
    let gpu = Gpu::open_with(args.device.as_ref().unwrap_or(&DeviceChoice::Auto), gpu_options())?;
    let done = match &args.screenshot {
        Some(path) => {
            let theme = match args.theme {
                ThemeName::Dark => Theme::Dark,
                ThemeName::Light => Theme::Light,
            };
            let picture = screenshot::take(&gpu, &Shot { start, size: args.size, scale: args.scale, theme }, |_| {})?;
            picture.write_png(path).map_err(|error| Failure { code: 5, message: words::told(&error) })
        }
        None => window(args, &gpu, start),
    };
    // The result stays valid even if the compiled shaders cannot be stored: only the next start takes longer.
    if let Err(error) = gpu.save_pipelines() {
        eprintln!("stein-viewer: {}", words::told(&error));
    }
    done
}

fn start(args: &Args) -> Result<Start, Failure> {
    if args.neighbour.is_some() && args.panel.panel() != Panel::Kernel {
        return Err(Failure {
            code: 2,
            message: "--neighbour is explained by the kernel's panel\n  remedy: add --panel kernel, or leave it out"
                .into(),
        });
    }
    if let Some(reference) = args.further.iter().find(|path| is_reference(path)) {
        let path = text::path(reference);
        return Err(Failure {
            code: 2,
            message: format!(
                "{path}: is it a reference? Further files are renders with other seeds\
                 \n  remedy: give a reference as --reference {path}, and a seed of such a name as --seed {path}"
            ),
        });
    }
    let parameters = parameters(args)?;
    let named = |layer: LayerRef| if args.literal { layer.literal() } else { layer };
    let request = |input: LayerRef| {
        let LayerRef { file, layer } = named(input);
        let others = if args.literal { args.others.literal() } else { args.others.clone() };
        let seeds = [args.further.clone(), others.seeds.clone()].concat();
        BufferSetRequest { input: file, layer, seeds, ..others }
    };
    let source =
        args.file.clone().map(|input| Source { request: request(input), reference: args.reference.clone().map(named) });
    if source.is_none() && args.others != BufferSetRequest::default() {
        let message = "halves, variance and features are those of a file, and none is given\
                       \n  remedy: name it: stein-viewer FILE"
            .into();
        return Err(Failure { code: 2, message });
    }
    Ok(Start {
        source,
        parameters,
        layer: args.layer.clone(),
        other: args.other.clone(),
        compare: args.compare.compare(),
        panel: args.panel.panel(),
        pixel: args.pixel,
        exit_after_frames: args.exit_after_frames,
        adapt: args.adapt.clone().map(|scene| Setup { scene, ..Setup::default() }),
        sweeps: args.sweep,
        neighbour: args.neighbour,
    })
}

/// Returns the parameters that the command line gives; `None` if it gives none.
fn parameters(args: &Args) -> Result<Option<Parameters>, Failure> {
    let usage = |message: String| Failure { code: 2, message };
    let file = args.params.as_deref().map(|path| Ok::<_, Failure>((path, Parameters::read(path)?))).transpose()?;
    let mut parameters = match file {
        Some((path, parameters)) => {
            let (method, preset) = (args.method.as_ref().map(Method::name), args.preset.map(Preset::name));
            let own = [("method", parameters.method.name(), method), ("preset", parameters.preset.name(), preset)];
            let contradicts =
                own.into_iter().find_map(|(key, own, given)| Some((key, own, given.filter(|given| *given != own)?)));
            if let Some((key, own, given)) = contradicts {
                let path = text::path(path);
                return Err(usage(format!(
                    "--{key} {given}: {path} is for {own}\
                     \n  remedy: leave the option out, or write `{key} = \"{given}\"` into the file"
                )));
            }
            parameters
        }
        None if args.method.is_none() && args.preset.is_none() && args.radius.is_none() => return Ok(None),
        None => Parameters { preset: args.preset.unwrap_or(Preset::Default), method: args.method.unwrap_or_default() }
            .reset(),
    };
    if let Some(radius) = args.radius {
        if sweep::radius(&parameters.method).is_none() {
            let name = parameters.method.name();
            return Err(usage(format!(
                "--radius is no option of the method {name}\n  remedy: leave it out, or choose another --method"
            )));
        }
        parameters.method = parameters.method.with_parameter("window_radius", radius)?;
    }
    Ok(Some(parameters))
}

fn window(args: &Args, gpu: &Gpu, start: Start) -> Result<(), Failure> {
    let title = app::title(start.source.as_ref().map(Source::name).as_deref());
    let viewport = ViewportBuilder::default()
        .with_title(&title)
        .with_inner_size(Vec2::from(args.size))
        .with_min_inner_size([640.0, 400.0]);
    let options = eframe::NativeOptions { viewport, wgpu_options: device::configuration(gpu)?, ..Default::default() };
    let in_window = |creation: &eframe::CreationContext| {
        Viewer::in_window(creation, gpu, start).map(|viewer| Box::new(viewer) as Box<dyn eframe::App>)
    };
    eframe::run_native("stein-viewer", options, Box::new(|creation| Ok(in_window(creation)?))).map_err(|error| {
        Failure {
            code: 4,
            message: format!(
                "no window can be shown on '{}': {error}\
                 \n  remedy: choose an adapter that the screen is connected to with --device (`stein devices` lists \
                 them), or take a picture without a window with --screenshot",
                gpu.summary().name
            ),
        }
    })
}
