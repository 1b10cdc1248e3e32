//! `stein kernel`

use std::path::PathBuf;

use serde::Serialize;
use stein::gpu::AdapterSummary;
use stein::image::Window;
use stein::kernels::WeightRule;
use stein::method::PlannedStep;
use stein::text::{self, number};
use stein::{Error, Extent, FilterKernel, Image, Kernels, Options};
use stein_exr::picture_file::Format;
use stein_exr::{NamedLayer, Windows, write_layers_in};

use super::filter::Filter;
use super::inspect::{Input, settle_first};
use super::options::{self, Device, Source};
use super::out::table;
use super::{Failure, Out, output};

const EXAMPLE: &str = "\
The output is one window with the pixel in its middle. For each filter of the method it has these layers: \
`FILTER.weight.V`, the weights; `FILTER.colour`, the pixels that are averaged; and for the colour and each feature \
NAME `FILTER.distance.NAME.V`, the distances, and `FILTER.alone.NAME.V`, the weights from this distance alone. \
Outside of the image, and outside of a smaller window, weights are 0 and distances infinite.

For dfc, `second_pass` averages pass 1, the blend of the candidates, and yields the result.

Examples:
  stein kernel render.exr --pixel 120,64
  stein kernel render.exr --pixel 120,64 -o window.exr
  stein kernel render.exr --pixel 120,64 --method nlm

Exit codes: 0 done, 2 wrong usage, 3 an input file or layer cannot be used, 4 no device or a device failed, 5 the \
output cannot be written, 1 anything else.";

/// Show which neighbours make a pixel, and why
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE, override_usage = "stein kernel [OPTIONS] IN --pixel X,Y")]
pub(crate) struct Args {
    /// OpenEXR file, as for `stein denoise`
    #[arg(value_name = "IN", required_unless_present = "list_devices")]
    input: Option<PathBuf>,
    /// Other renders of the same frame with other seeds, which are merged with IN
    #[arg(value_name = "SEED")]
    further: Vec<PathBuf>,
    /// Column and row of the pixel, such as 120,64; 0,0 is the upper left of the data window
    #[arg(long, value_name = "X,Y", value_parser = pixel, required_unless_present = "list_devices")]
    pixel: Option<(u32, u32)>,
    /// OpenEXR file to write the windows to [default: only print a summary]
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Print one JSON document in place of text
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    filter: Filter,
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    pub(crate) device: Device,
}

/// Parses a column and a row, as in 120,64.
fn pixel(text: &str) -> Result<(u32, u32), String> {
    text.split_once(',')
        .and_then(|(x, y)| Some((x.trim().parse().ok()?, y.trim().parse().ok()?)))
        .ok_or_else(|| "it must look like 120,64".into())
}

#[derive(Serialize)]
struct Document {
    input: Input,
    device: AdapterSummary,
    x: u32,
    y: u32,
    filters: Vec<Summary>,
    left_out: Vec<PlannedStep>,
    #[serde(serialize_with = "text::serialize_path_or_none")]
    output: Option<PathBuf>,
}

/// One filter, without its images.
#[derive(Serialize)]
struct Summary {
    filter: &'static str,
    window_radius: u32,
    value: [f32; 3],
    /// Share of a candidate in pass 1.
    share: Option<f32>,
    weight_sum: f32,
    /// Weight of the pixel itself.
    own_weight: f32,
    #[serde(flatten)]
    rule: WeightRule,
    /// Number of neighbours that each distance decided about, in the order of the distances.
    decided: Vec<Decided>,
}

#[derive(Serialize)]
struct Decided {
    by: String,
    neighbours: usize,
}

impl Summary {
    fn new(kernel: &FilterKernel) -> Self {
        let cells = 0..kernel.weights.extent.pixels();
        let decided = kernel.distances.iter().map(|distance| {
            let is_this = |cell: &usize| kernel.decided_by(*cell).is_some_and(|by| by.of == distance.of);
            Decided { by: distance.of.name().to_owned(), neighbours: cells.clone().filter(is_this).count() }
        });
        Self {
            filter: kernel.name,
            window_radius: kernel.window_radius,
            value: kernel.value,
            share: kernel.share,
            weight_sum: kernel.weight_sum,
            own_weight: kernel.weights.planes[0][cells.end / 2],
            rule: kernel.rule,
            decided: decided.collect(),
        }
    }

    fn row(&self) -> Vec<String> {
        let decided: Vec<_> =
            self.decided.iter().map(|Decided { by, neighbours }| format!("{by} {neighbours}")).collect();
        let how = match self.rule {
            WeightRule::Gaussian { sigma } => format!("σ {} pixels", number(sigma.into())),
            WeightRule::Exact => "no noise within reach: left as it is".into(),
            WeightRule::Refused { sigmas } => format!("refused, beyond {} σ: pass 1 stays", number(sigmas.into())),
            WeightRule::Least | WeightRule::Cut { .. } | WeightRule::PatchMean { .. } => decided.join(", "),
        };
        let value = self.value.map(|value| number(value.into())).join(" ");
        vec![self.filter.to_owned(), how, value, number(self.weight_sum.into()), number(self.own_weight.into())]
    }
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let input = args.input.as_deref().ok_or_else(|| Failure::usage("no input is given"))?;
    let (x, y) = args.pixel.ok_or_else(|| Failure::usage("no pixel is given"))?;
    if args.json {
        out.silence();
    }
    let method = args.filter.chosen()?.method;
    args.source.check(&method)?;
    let request = args.source.for_method(&method).request(input, &args.further);
    if let Some(file) = &args.output {
        output::check(file, &[Format::OpenExr], request.files(), false, false)?;
    }

    let mut set = options::read(&request)?;
    if let Some(file) = &args.output {
        output::check_not_read(file, &set)?;
    }
    let (frame, described) = settle_first(&mut set, args.source.demands);
    out.say(described.text(false));
    let frame = frame.map_err(|error| Failure::in_file(input, error))?;
    let gpu = args.device.open()?;
    let kernels = args.device.denoiser(&gpu, method)?.kernels(&frame, x, y, &Options::default());
    let kernels = kernels.map_err(|error| match error {
        Error::Request(_) => Failure::usage(error).at("--pixel"),
        error => error.into(),
    })?;
    if let Some(file) = &args.output {
        if kernels.filters.is_empty() {
            return Err(Failure::usage(
                "no pixel of this frame is filtered, so that there is no window to write\n  remedy: leave -o out",
            ));
        }
        let texts = [("pixel".to_owned(), format!("{x},{y}")), ("method".to_owned(), method.name().to_owned())];
        let layers = layers(&kernels);
        let windows = around((x, y), &layers, set.windows());
        write_layers_in(Some(windows), file, &layers, &texts).map_err(Failure::output)?;
    }

    let filters: Vec<_> = kernels.filters.iter().map(Summary::new).collect();
    let left_out: Vec<_> =
        kernels.plan.steps().into_iter().filter(|planned| !planned.runs && planned.makes_kernels).cloned().collect();
    let head = ["filter", "decided by", "value", "Σ w", "own w"].map(String::from).to_vec();
    out.say(format_args!(
        "  pixel {x},{y}\n{}",
        table(&std::iter::once(head).chain(filters.iter().map(Summary::row)).collect::<Vec<_>>(), 3)
    ));
    let mut shares: Vec<_> =
        filters.iter().filter_map(|filter| Some((filter.share.filter(|share| *share > 0.0)?, filter.filter))).collect();
    shares.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    if !shares.is_empty() {
        let shares: Vec<_> =
            shares.into_iter().map(|(share, name)| format!("{:.1} % {}", 100.0 * share, name.to_uppercase())).collect();
        out.say(format_args!("  pass 1: {}", shares.join(", ")));
    }
    for planned in &left_out {
        out.say(format_args!("  left out: {}: {}", planned.name, planned.why));
    }
    if let Some(file) = &args.output {
        out.say(text::path(file));
    }
    if !args.json {
        return Ok(());
    }
    out.json(&Document {
        input: described,
        device: gpu.summary().clone(),
        x,
        y,
        filters,
        left_out,
        output: args.output.clone(),
    })
}

/// Returns the windows of a file whose layers show the surroundings of a pixel of the input.
fn around((x, y): (u32, u32), layers: &[NamedLayer], input: Windows) -> Windows {
    let extent = layers.first().map_or(input.data.extent, |layer| layer.image.extent);
    let start = |first: i32, at: u32, side: u32| first.saturating_add_unsigned(at).saturating_sub_unsigned(side / 2);
    let (left, top) = (start(input.data.x, x, extent.width), start(input.data.y, y, extent.height));
    Windows { data: Window { x: left, y: top, extent }, ..input }
}

/// Returns all windows as layers, each centred and as large as the largest.
fn layers(kernels: &Kernels) -> Vec<NamedLayer> {
    let side = kernels.filters.iter().map(FilterKernel::side).max().unwrap_or(1);
    let layer = |name: String, channels: &[&str], image: &Image, outside: f32| NamedLayer {
        name,
        channels: channels.iter().map(ToString::to_string).collect(),
        image: in_the_middle(image, side, outside),
    };
    let of_kernel = |kernel: &FilterKernel| {
        let named = |part: &str| format!("{}.{part}", kernel.name);
        let mut layers = vec![
            layer(named("weight"), &["V"], &kernel.weights, 0.0),
            layer(named("colour"), &["R", "G", "B"], &kernel.colors, 0.0),
        ];
        for distance in &kernel.distances {
            let of = distance.of.name();
            layers.push(layer(named(&format!("distance.{of}")), &["V"], &distance.distances, f32::INFINITY));
            layers.push(layer(named(&format!("alone.{of}")), &["V"], &distance.weights, 0.0));
        }
        layers
    };
    kernels.filters.iter().flat_map(of_kernel).collect()
}

/// Puts a square window into the middle of a larger one; both have an odd side.
fn in_the_middle(window: &Image, side: usize, outside: f32) -> Image {
    let (width, extent) = (window.extent.width as usize, Extent { width: side as u32, height: side as u32 });
    let first = (side - width) / 2;
    let mut larger = Image::filled(extent, window.channels(), outside);
    for (to, from) in larger.planes.iter_mut().zip(&window.planes) {
        for (row, values) in from.chunks_exact(width).enumerate() {
            to[(first + row) * side + first..][..width].copy_from_slice(values);
        }
    }
    larger
}
