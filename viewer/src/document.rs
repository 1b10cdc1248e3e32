//! The open document: a frame, perhaps its reference, and the results of the newest run.

mod along;
mod inputs;
mod outputs;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use stein::frame::{Contradiction, Repairs};
use stein::method::Plan;
use stein::sampling::estimated_relative_mse;
use stein::{Denoiser, Error, Estimate, Frame, Image, Options, Preset, text};
use stein_exr::picture_file::PngEncoding;
use stein_exr::{AlphaEncoding, Aovs, BufferSet, BufferSetRequest, LayerRef, LayoutUse};
use stein_metric as metric;

use crate::files::short_name;
use crate::layer::{Description, Group, Kind, Layer};
use crate::settings::Parameters;

pub use along::counterpart;
pub use inputs::{drawn_layer, input_layers, reference_layer};
pub use outputs::output_layers;

use outputs::true_error_layer;

/// Files and layers to open.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Source {
    /// Buffer set to read.
    pub request: BufferSetRequest,
    /// File and layer of the true image; `None` if no true image is known.
    pub reference: Option<LayerRef>,
}

impl Source {
    /// Creates a source from an input file and perhaps the file of a reference, without names of layers.
    pub fn whole(input: PathBuf, reference: Option<PathBuf>) -> Self {
        Self { request: BufferSetRequest { input, ..Default::default() }, reference: reference.map(LayerRef::whole) }
    }

    /// Returns all files that are read.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.request.files().chain(self.reference.as_ref().map(|reference| reference.file.as_path()))
    }

    /// Returns the title for people: the name of the input file, with its layer if one is named.
    pub fn name(&self) -> String {
        let BufferSetRequest { input, layer, .. } = &self.request;
        layer
            .as_ref()
            .map_or_else(|| short_name(input), |layer| format!("{}::{}", short_name(input), text::name(layer)))
    }

    /// Returns whether both sources read the same files in the same way, perhaps for another picture of the input.
    fn is_of_same_files(&self, other: &Self) -> bool {
        let whole = |source: &Self| BufferSetRequest { layer: None, ..source.request.clone() };
        whole(self) == whole(other)
    }

    /// Returns the source with absolute paths, which do not depend on the working folder.
    #[must_use]
    pub fn absolute(&self) -> Self {
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        Self {
            request: self.request.map_files(absolute),
            reference: self.reference.as_ref().map(|reference| reference.map_file(absolute)),
        }
    }

    /// Describes for people what is read and what is left out, one line each; the input comes first.
    pub fn lines(&self) -> Vec<String> {
        let BufferSetRequest {
            input,
            layer,
            half_a,
            half_b,
            variance,
            features,
            skip_features,
            no_features,
            feature_half_a,
            feature_half_b,
            feature_variance,
            aovs,
            no_alpha,
            alpha,
            payload_halves: _,
            seeds,
            samples,
            layout,
            no_siblings,
            png_encoding,
        } = &self.request;
        let input = LayerRef { file: input.clone(), layer: layer.clone() };
        let named = [("half A", half_a), ("half B", half_b), ("variance", variance), ("reference", &self.reference)];
        let named = named.into_iter().filter_map(|(what, layer)| Some(format!("{what}: {}", layer.as_ref()?)));
        let seeds = seeds.iter().map(|seed| format!("another seed: {}", text::path(seed)));
        let of_features = [("", features), ("half A of ", feature_half_a), ("half B of ", feature_half_b)];
        let of_features = of_features.into_iter().chain([("variance of ", feature_variance)]);
        let features = of_features.flat_map(|(part, layers)| {
            layers.iter().map(move |(name, layer)| format!("{part}feature {}: {layer}", text::name(name)))
        });
        let samples = samples.map(|count| format!("{count} samples per pixel"));
        let layout = layout.as_ref().map(|layout| format!("read as {}", text::name(layout)));
        let linear = (*png_encoding == PngEncoding::Linear).then(|| "linear values in PNG files".to_owned());
        let alone = no_siblings.then(|| "without files beside the input".to_owned());
        let skipped = skip_features.iter().map(|name| format!("without the feature {}", text::name(name)));
        let none = no_features.then(|| "without other features of the input".to_owned());
        let along =
            (*aovs != Aovs::default()).then(|| format!("layers denoised along: {}", text::name(&aovs.to_string())));
        let kept_alpha = no_alpha.then(|| "alpha left as it is".to_owned());
        let encoding = alpha.map(|alpha| {
            let is_multiplied = match alpha {
                AlphaEncoding::Premultiplied => "multiplied",
                AlphaEncoding::Straight => "not multiplied",
            };
            format!("colours {is_multiplied} by their alpha in the file")
        });
        std::iter::once(input.to_string())
            .chain(seeds)
            .chain(named)
            .chain(features)
            .chain(skipped)
            .chain(none)
            .chain(along)
            .chain(kept_alpha)
            .chain(encoding)
            .chain(samples)
            .chain(layout)
            .chain(linear)
            .chain(alone)
            .collect()
    }
}

/// Files to open.
#[derive(Clone, Debug, PartialEq)]
pub enum Opening {
    /// A frame, and its reference if one is named.
    Frame(Box<Source>),
    /// Several files that came together: a frame with files that belong to it, or seeds of one frame.
    Together {
        /// The files, at least one; the first is opened if they do not belong together.
        files: Vec<PathBuf>,
        /// File of the true image.
        reference: Option<PathBuf>,
        /// Samples per pixel of each file, if they are not as the file says.
        samples: Option<u32>,
    },
}

impl Opening {
    /// Returns the opening with the number of samples per pixel.
    #[must_use]
    pub fn with_samples(self, samples: u32) -> Self {
        let samples = Some(samples);
        match self {
            Self::Frame(source) => {
                Self::Frame(Box::new(Source { request: BufferSetRequest { samples, ..source.request }, ..*source }))
            }
            Self::Together { files, reference, .. } => Self::Together { files, reference, samples },
        }
    }
}

/// The files of a frame: the renderer that wrote them, and everything that was found in them and beside them.
#[derive(Clone, Debug)]
pub struct InputFiles {
    /// Layout by which the input was read.
    pub layout: LayoutUse,
    /// Renders with other seeds that were merged with the input: those of the request, and those found beside it.
    pub seeds: Vec<PathBuf>,
    /// Other files that were found beside the input and belong to it.
    pub siblings: Vec<PathBuf>,
    /// Names of the pictures in the input: the layers of their colours. A name is empty for plain `R G B`.
    pub pictures: Vec<String>,
    /// Index of the picture that is open.
    pub picture: usize,
}

impl InputFiles {
    /// Describes the files of a set. The first picture is the open one.
    pub fn new(set: &BufferSet) -> Self {
        Self {
            layout: set.layout().clone(),
            seeds: set.seeds().to_vec(),
            siblings: set.siblings().to_vec(),
            pictures: set.pictures().map(str::to_owned).collect(),
            picture: 0,
        }
    }

    /// Returns the files that were found beside the input, without being requested.
    pub fn found<'a>(&'a self, request: &'a BufferSetRequest) -> impl Iterator<Item = &'a Path> {
        let seeds = self.seeds.iter().filter(|seed| !request.seeds.contains(seed));
        self.siblings.iter().chain(seeds).map(PathBuf::as_path)
    }

    /// Describes the files for people, without those that the request names, one line each.
    pub fn lines(&self, request: &BufferSetRequest) -> Vec<String> {
        let LayoutUse { title, recognised_by, .. } = &self.layout;
        let found = |what: &str, files: &mut dyn Iterator<Item = &PathBuf>| {
            let names: Vec<_> = files.map(|file| short_name(file)).collect();
            (!names.is_empty()).then(|| format!("{what}: {}", names.join(", ")))
        };
        let seeds = &mut self.seeds.iter().filter(|seed| !request.seeds.contains(seed));
        let picture = self.pictures.get(self.picture).filter(|_| self.pictures.len() > 1).map(|name| {
            format!("picture {} of {} in the file: {}", self.picture + 1, self.pictures.len(), picture_title(name))
        });
        let lines =
            [found("other seeds beside it", seeds), found("found beside it", &mut self.siblings.iter()), picture];
        std::iter::once(format!("layout: {title} ({recognised_by})")).chain(lines.into_iter().flatten()).collect()
    }
}

/// Returns the name of a picture for people.
pub fn picture_title(name: &str) -> String {
    text::name(stein_exr::picture_name(name)).into_owned()
}

/// A frame that was read or rendered, before any run.
#[derive(Clone, Debug)]
pub struct Opened {
    /// Source of the frame; `None` for a frame that was rendered here.
    pub source: Option<Source>,
    /// Files of the frame; `None` for a frame that was rendered here.
    pub input: Option<InputFiles>,
    /// Title of the frame for people.
    pub name: String,
    /// Frame to denoise.
    pub frame: Arc<Frame>,
    /// Repairs without which the frame could not be made.
    pub repairs: Repairs,
    /// Contradiction between the sources from which the noise is known.
    pub contradiction: Option<Contradiction>,
    /// Reason why some of the files that came together are not open, until the user dismisses it.
    pub left_out: Option<Error>,
    /// True image; `None` if it is not known.
    pub reference: Option<Arc<Image>>,
    /// Relative MSE of the noisy colour against the reference.
    pub noisy_error: Option<f64>,
    /// Layers that no run changes.
    pub layers: Vec<Arc<Layer>>,
}

/// Results of a run.
#[derive(Clone, Debug)]
pub struct Denoised {
    /// Parameters of the run.
    pub parameters: Parameters,
    /// Estimate of the true image. Its layers were moved to [`Denoised::layers`].
    pub estimate: Arc<Estimate>,
    /// Plan of a run with these parameters that makes only the result and its error.
    pub lean_plan: Plan,
    /// Time of denoising on the clock, in seconds; the window drew meanwhile.
    pub seconds: f64,
    /// Relative MSE of the result against the reference.
    pub error: Option<f64>,
    /// Relative MSE of the result according to the error estimate.
    pub estimated_error: Option<f64>,
    /// Layers that the run made.
    pub layers: Vec<Arc<Layer>>,
}

/// Parameters, time and errors of a run, for lists and plots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredRun {
    /// Parameters of the run.
    pub parameters: Parameters,
    /// Time on the clock, in seconds.
    pub seconds: f64,
    /// Relative MSE of the result against the reference.
    pub error: Option<f64>,
    /// Relative MSE of the result according to the error estimate.
    pub estimated_error: Option<f64>,
}

/// The open frame, its runs and all layers.
#[derive(Debug)]
pub struct Document {
    /// Frame and reference, before any run.
    pub opened: Opened,
    /// Newest run that was completed.
    pub denoised: Option<Denoised>,
    /// All completed runs, oldest first.
    pub history: Vec<MeasuredRun>,
    /// Result of the previous run.
    before: Option<Arc<Layer>>,
    layers: Vec<Arc<Layer>>,
}

impl Opened {
    /// Returns the source of a picture in the input, by its index; `None` for a frame that was rendered here, or if the
    /// input has no such picture.
    pub fn picture(&self, index: usize) -> Option<Source> {
        let (source, input) = (self.source.as_ref()?, self.input.as_ref()?);
        let name = input.pictures.get(index)?;
        // The first picture is the one that is open if none is named.
        let layer = (index > 0).then(|| name.clone());
        Some(Source { request: BufferSetRequest { layer, ..source.request.clone() }, ..source.clone() })
    }

    /// Takes over the list of pictures from the document that was open before, if this is another picture of its input:
    /// a set that was read for one picture does not know the others.
    pub fn keep_pictures(&mut self, before: &Self) {
        let (Some(source), Some(input)) = (&self.source, &mut self.input) else { return };
        let (Some(source_before), Some(input_before)) = (&before.source, &before.input) else { return };
        let place = |layer: &String| input_before.pictures.iter().position(|picture| picture == layer);
        if let Some(picture) = source.request.layer.as_ref().and_then(place)
            && source.is_of_same_files(source_before)
        {
            (input.pictures, input.picture) = (input_before.pictures.clone(), picture);
        }
    }

    /// Takes over the layer of a reference that was not known before.
    pub fn compare(&mut self, reference: &Arc<Layer>) {
        let image = &reference.shown.image;
        self.noisy_error = relative_mse(&self.frame.color().mean, Some(image));
        self.reference = Some(image.clone());
        self.layers.push(reference.clone());
    }
}

impl Denoised {
    /// Collects the results of a run: `denoiser` made `estimate` of `frame` in `seconds`.
    ///
    /// # Errors
    /// As [`Denoiser::plan`].
    pub fn new(
        denoiser: &Denoiser,
        preset: Preset,
        frame: &Frame,
        mut estimate: Estimate,
        reference: Option<&Arc<Image>>,
        seconds: f64,
    ) -> stein::Result<Self> {
        let parameters = Parameters { preset, method: *denoiser.method() };
        let lean_plan = denoiser.plan(&[frame], 0, &Options::default())?;
        let (error, estimated_error) = (relative_mse(&estimate.color, reference), estimated_relative_mse(&estimate));
        let layers = output_layers(frame, &mut estimate, reference);
        Ok(Self { parameters, estimate: Arc::new(estimate), lean_plan, seconds, error, estimated_error, layers })
    }

    /// Takes over a reference that was not known before.
    pub fn compare(&mut self, reference: &Arc<Image>) {
        self.error = relative_mse(&self.estimate.color, Some(reference));
        let scale = self.layers.iter().find(|layer| layer.name() == "error").map(|layer| layer.range);
        self.layers.push(true_error_layer(&self.estimate, reference, scale));
    }
}

impl Document {
    /// Creates a document without a run.
    pub fn new(opened: Opened) -> Self {
        let mut document = Self { opened, denoised: None, history: Vec::new(), before: None, layers: Vec::new() };
        document.arrange();
        document
    }

    /// Takes over the results of a run. Keeps the previous result as a layer to compare with.
    pub fn add(&mut self, denoised: Denoised) {
        let Denoised { parameters, seconds, error, estimated_error, .. } = denoised;
        self.history.push(MeasuredRun { parameters, seconds, error, estimated_error });
        self.before = self.layer("result").map(|before| {
            let about = "The result of the run before, to see what a change of the parameters does.".into();
            let description =
                Description { name: "before".into(), title: "run before".into(), about, ..before.description.clone() };
            Arc::new(before.renamed(description))
        });
        self.denoised = Some(denoised);
        self.arrange();
    }

    /// Returns whether the document has a reference by now, but `denoised` was not compared with it.
    pub fn has_more_to_compare(&self, denoised: &Denoised) -> bool {
        self.opened.reference.is_some() && !denoised.layers.iter().any(|layer| layer.name() == "true_error")
    }

    /// Replaces the frame by the same frame with a reference. Keeps the runs as they are.
    pub fn reopen(&mut self, opened: Opened) {
        self.opened = opened;
        self.arrange();
    }

    /// Sorts the layers by group. Within the results, the result comes before the layers that it is compared with;
    /// within the features and the layers that are denoised along, the layers of one name stay together. All other layers
    /// keep the order in which they were made.
    fn arrange(&mut self) {
        let made = self.denoised.iter().flat_map(|denoised| &denoised.layers);
        self.layers = self.opened.layers.iter().chain(made).chain(&self.before).cloned().collect();
        let (features, payload) = (self.opened.frame.features(), self.opened.frame.payload());
        let place = |layer: &Layer| match layer.description.group {
            Group::Result => ["result", "pass1", "before", "reference"].iter().position(|name| *name == layer.name()),
            Group::Features => features.iter().position(|feature| {
                layer.name() == feature.name || layer.name().starts_with(&format!("{}_", feature.name))
            }),
            Group::Along => {
                along::name_in_file(layer.name()).and_then(|name| payload.iter().position(|it| it.name == name))
            }
            _ => None,
        };
        self.layers.sort_by_key(|layer| (layer.description.group, place(layer)));
    }

    /// Returns all layers, in the order of the strip.
    pub fn layers(&self) -> &[Arc<Layer>] {
        &self.layers
    }

    /// Returns the layer with this name.
    pub fn layer(&self, name: &str) -> Option<&Arc<Layer>> {
        self.layers.iter().find(|layer| layer.name() == name)
    }
}

/// Returns the relative MSE; `None` without a reference, or if it cannot be computed.
pub fn relative_mse(image: &Image, reference: Option<&Arc<Image>>) -> Option<f64> {
    reference.and_then(|reference| metric::relative_mse(image, reference).ok())
}

/// Creates the description of a layer, for the tables of layers.
fn describe(
    name: impl Into<String>,
    title: impl Into<String>,
    about: impl Into<String>,
    group: Group,
    kind: Kind,
    unit: &'static str,
) -> Description {
    Description { name: name.into(), title: title.into(), about: about.into(), group, kind, unit }
}

/// Unit of the colour, for the legend.
const RADIANCE: &str = "radiance";
/// Unit of the variance of the colour and of squared errors.
const RADIANCE_SQUARED: &str = "radiance²";
