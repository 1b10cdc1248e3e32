//! What is open: a frame, perhaps its reference, and what the newest run made of them.

mod inputs;
mod outputs;

use std::path::PathBuf;
use std::sync::Arc;

use stein::frame::Repairs;
use stein::method::Plan;
use stein::{Estimate, Frame, Image, Method, metric};

use crate::layer::{Description, Group, Kind, Layer};

pub use inputs::{drawn_layer, input_layers};
pub use outputs::output_layers;

use inputs::reference_layer;
use outputs::true_error_layer;

/// What to open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Source {
    /// The buffer set.
    pub input: PathBuf,
    /// The true image, where one is known.
    pub reference: Option<PathBuf>,
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
    pub method: Method,
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
    pub method: Method,
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
    layers: Vec<Arc<Layer>>,
}

impl Opened {
    /// Takes over a reference that was not there before.
    pub fn compare(&mut self, reference: &Arc<Image>) {
        self.noisy_error = relative_mse(&self.frame.color().mean, Some(reference));
        self.layers.push(reference_layer(reference));
        self.reference = Some(reference.clone());
    }
}

impl Denoised {
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
        let layers = opened.layers.clone();
        let mut document = Self { opened, denoised: None, history: Vec::new(), layers };
        document.sort();
        document
    }

    /// Takes over what a run has made. The result before stays as a layer to compare with.
    pub fn add(&mut self, mut denoised: Denoised) {
        // It may have come while the run was at work.
        if let (Some(reference), None) = (&self.opened.reference, denoised.error) {
            denoised.compare(reference);
        }
        let Denoised { method, seconds, error, estimated_error, .. } = denoised;
        self.history.push(Run { method, seconds, error, estimated_error });
        self.layers = self.opened.layers.iter().chain(&denoised.layers).cloned().collect();
        let before = self.denoised.as_ref().and_then(|denoised| denoised.layers.iter().find(|layer| layer.name() == "result"));
        if let Some(before) = before {
            let about = "The result of the run before, to see what a change of the parameters does.".into();
            let description = Description { name: "before".into(), title: "run before".into(), about, ..before.description.clone() };
            self.layers.push(Arc::new(before.renamed(description)));
        }
        self.denoised = Some(denoised);
        self.sort();
    }

    /// Takes over a reference that was not there before.
    pub fn compare(&mut self, reference: &Arc<Image>) {
        let before = self.layer("before").cloned();
        self.opened.compare(reference);
        if let Some(denoised) = &mut self.denoised {
            denoised.compare(reference);
            if let Some(newest) = self.history.last_mut() {
                newest.error = denoised.error;
            }
        }
        let made = self.denoised.iter().flat_map(|denoised| &denoised.layers);
        self.layers = self.opened.layers.iter().chain(made).cloned().chain(before).collect();
        self.sort();
    }

    /// By group. In it the result goes before what it is compared with, what belongs to one feature stays together, and all else keeps the order in which it was made.
    fn sort(&mut self) {
        let features = self.opened.frame.features();
        let place = |layer: &Layer| match layer.description.group {
            Group::Result => ["result", "pass1", "before", "reference"].iter().position(|name| *name == layer.name()),
            Group::Features => features.iter().position(|feature| layer.name() == feature.name || layer.name().starts_with(&format!("{}_", feature.name))),
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
fn describe(name: impl Into<String>, title: impl Into<String>, about: impl Into<String>, group: Group, kind: Kind, unit: &'static str) -> Description {
    Description { name: name.into(), title: title.into(), about: about.into(), group, kind, unit }
}

/// The unit of the colour, for the legend.
const RADIANCE: &str = "radiance";
/// The unit of its variance and squared errors.
const RADIANCE_SQUARED: &str = "radiance²";
