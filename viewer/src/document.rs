//! What is open: a frame, perhaps its reference, and what the newest run made of them.

mod inputs;
mod outputs;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use stein::frame::Repairs;
use stein::method::Plan;
use stein::sampling::estimated_relative_mse;
use stein::{Denoiser, Estimate, Frame, Image, Options, Preset, text};
use stein_exr::{BufferSetRequest, LayerRef};
use stein_metric as metric;

use crate::files::short_name;
use crate::layer::{Description, Group, Kind, Layer};
use crate::settings::Parameters;

pub use inputs::{drawn_layer, input_layers, reference_layer};
pub use outputs::output_layers;

use outputs::true_error_layer;

/// What to open.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Source {
    /// The buffer set.
    pub request: BufferSetRequest,
    /// The true image, where one is known.
    pub reference: Option<LayerRef>,
}

impl Source {
    /// A file with what is in it, and perhaps a reference.
    pub fn whole(input: PathBuf, reference: Option<PathBuf>) -> Self {
        Self { request: BufferSetRequest { input, ..Default::default() }, reference: reference.map(LayerRef::whole) }
    }

    /// All files that are read.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        self.request.files().chain(self.reference.as_ref().map(|reference| reference.file.as_path()))
    }

    /// What people call it: the name of the input, and its layer where one is named.
    pub fn name(&self) -> String {
        let BufferSetRequest { input, layer, .. } = &self.request;
        layer
            .as_ref()
            .map_or_else(|| short_name(input), |layer| format!("{}::{}", short_name(input), text::name(layer)))
    }

    /// The same from whichever folder.
    #[must_use]
    pub fn absolute(&self) -> Self {
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        Self {
            request: self.request.map_files(absolute),
            reference: self.reference.as_ref().map(|reference| reference.map_file(absolute)),
        }
    }

    /// What is read, and what is not, for people: the input first.
    pub fn lines(&self) -> Vec<String> {
        let BufferSetRequest { input, layer, half_a, half_b, variance, features, skip_features, no_features } =
            &self.request;
        let input = LayerRef { file: input.clone(), layer: layer.clone() };
        let named = [("half A", half_a), ("half B", half_b), ("variance", variance), ("reference", &self.reference)];
        let named = named.into_iter().filter_map(|(what, layer)| Some(format!("{what}: {}", layer.as_ref()?)));
        let features = features.iter().map(|(name, layer)| format!("feature {}: {layer}", text::name(name)));
        let skipped = skip_features.iter().map(|name| format!("without the feature {}", text::name(name)));
        let none = no_features.then(|| "without other features of the input".to_owned());
        std::iter::once(input.to_string()).chain(named).chain(features).chain(skipped).chain(none).collect()
    }
}

/// What was read or rendered, before any run.
#[derive(Clone, Debug)]
pub struct Opened {
    /// The file that it comes from; `None` of what was rendered here.
    pub source: Option<Source>,
    /// What people call it.
    pub name: String,
    /// What is denoised.
    pub frame: Arc<Frame>,
    /// What had to be changed to make the frame.
    pub repairs: Repairs,
    /// The true image.
    pub reference: Option<Arc<Image>>,
    /// Relative MSE of the noisy colour against the reference.
    pub noisy_error: Option<f64>,
    /// Layers that no run changes.
    pub layers: Vec<Arc<Layer>>,
}

/// What a run has made.
#[derive(Clone, Debug)]
pub struct Denoised {
    /// With which parameters.
    pub parameters: Parameters,
    /// What is known of the true image. Its layers have become [`Denoised::layers`].
    pub estimate: Arc<Estimate>,
    /// What would be done where only the result and its error are wanted.
    pub lean_plan: Plan,
    /// What denoising took, on the clock, while the window drew as well.
    pub seconds: f64,
    /// Relative MSE against the reference.
    pub error: Option<f64>,
    /// The same as the error estimate has it.
    pub estimated_error: Option<f64>,
    /// What it made, to be looked at.
    pub layers: Vec<Arc<Layer>>,
}

/// One run, to be listed and plotted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// With which parameters.
    pub parameters: Parameters,
    /// On the clock.
    pub seconds: f64,
    /// Relative MSE against the reference.
    pub error: Option<f64>,
    /// The same as the error estimate has it.
    pub estimated_error: Option<f64>,
}

/// What is open.
#[derive(Debug)]
pub struct Document {
    /// What was read.
    pub opened: Opened,
    /// The newest run that came to its end.
    pub denoised: Option<Denoised>,
    /// All runs that came to their ends, oldest first.
    pub history: Vec<Run>,
    /// The result of the run before.
    before: Option<Arc<Layer>>,
    layers: Vec<Arc<Layer>>,
}

impl Opened {
    /// Takes over the layer of a reference that was not there before.
    pub fn compare(&mut self, reference: &Arc<Layer>) {
        let image = &reference.shown.image;
        self.noisy_error = relative_mse(&self.frame.color().mean, Some(image));
        self.reference = Some(image.clone());
        self.layers.push(reference.clone());
    }
}

impl Denoised {
    /// What `denoiser` has made of a frame in `seconds`, with all its layers.
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
        let layers = output_layers(&mut estimate, reference);
        Ok(Self { parameters, estimate: Arc::new(estimate), lean_plan, seconds, error, estimated_error, layers })
    }

    /// Takes over a reference that was not there before.
    pub fn compare(&mut self, reference: &Arc<Image>) {
        self.error = relative_mse(&self.estimate.color, Some(reference));
        let scale = self.layers.iter().find(|layer| layer.name() == "error").map(|layer| layer.range);
        self.layers.push(true_error_layer(&self.estimate, reference, scale));
    }
}

impl Document {
    /// What was read, without a run.
    pub fn new(opened: Opened) -> Self {
        let mut document = Self { opened, denoised: None, history: Vec::new(), before: None, layers: Vec::new() };
        document.arrange();
        document
    }

    /// Takes over what a run has made. The result before stays as a layer to compare with.
    pub fn add(&mut self, denoised: Denoised) {
        let Denoised { parameters, seconds, error, estimated_error, .. } = denoised;
        self.history.push(Run { parameters, seconds, error, estimated_error });
        self.before = self.layer("result").map(|before| {
            let about = "The result of the run before, to see what a change of the parameters does.".into();
            let description =
                Description { name: "before".into(), title: "run before".into(), about, ..before.description.clone() };
            Arc::new(before.renamed(description))
        });
        self.denoised = Some(denoised);
        self.arrange();
    }

    /// Whether there is a reference by now that a run knew nothing of.
    pub fn has_more_to_compare(&self, denoised: &Denoised) -> bool {
        self.opened.reference.is_some() && !denoised.layers.iter().any(|layer| layer.name() == "true_error")
    }

    /// Takes over the same frame with its reference. What was made before stays as it is.
    pub fn reopen(&mut self, opened: Opened) {
        self.opened = opened;
        self.arrange();
    }

    /// Puts the layers in order, by group. In it the result goes before what it is compared with, what belongs to one
    /// feature stays together, and all else keeps the order in which it was made.
    fn arrange(&mut self) {
        let made = self.denoised.iter().flat_map(|denoised| &denoised.layers);
        self.layers = self.opened.layers.iter().chain(made).chain(&self.before).cloned().collect();
        let features = self.opened.frame.features();
        let place = |layer: &Layer| match layer.description.group {
            Group::Result => ["result", "pass1", "before", "reference"].iter().position(|name| *name == layer.name()),
            Group::Features => features.iter().position(|feature| {
                layer.name() == feature.name || layer.name().starts_with(&format!("{}_", feature.name))
            }),
            _ => None,
        };
        self.layers.sort_by_key(|layer| (layer.description.group, place(layer)));
    }

    /// Everything that can be looked at, in the order of the strip.
    pub fn layers(&self) -> &[Arc<Layer>] {
        &self.layers
    }

    /// The layer of this name.
    pub fn layer(&self, name: &str) -> Option<&Arc<Layer>> {
        self.layers.iter().find(|layer| layer.name() == name)
    }
}

/// Relative MSE; `None` without a reference, or where it cannot be told.
pub fn relative_mse(image: &Image, reference: Option<&Arc<Image>>) -> Option<f64> {
    reference.and_then(|reference| metric::relative_mse(image, reference).ok())
}

/// A description, for the tables of layers.
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

/// The unit of the colour, for the legend.
const RADIANCE: &str = "radiance";
/// The unit of its variance and squared errors.
const RADIANCE_SQUARED: &str = "radiance²";
