//! Error against run time: the open frame denoised with one set of parameters after the other, whenever there is
//! nothing else to do.

use std::sync::Arc;

use stein::{Method, Preset};

use crate::document::Run;
use crate::settings::Parameters;

/// Over what is swept: all radii and presets of all methods, and besides them the parameters in use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Extent {
    /// Radii of the window, of methods that have one, in pixels.
    pub radii: Vec<u32>,
    /// The presets from which the other parameters are.
    pub presets: Vec<Preset>,
    /// The methods, by their names.
    pub methods: Vec<&'static str>,
}

impl Default for Extent {
    fn default() -> Self {
        Self { radii: vec![3, 5, 7, 10], presets: vec![Preset::Default, Preset::Thesis], methods: vec!["dfc"] }
    }
}

impl Extent {
    /// Radii that can be chosen, in pixels.
    pub const RADII: [u32; 7] = [2, 3, 5, 7, 10, 15, 20];

    /// All parameters to measure, each once: those in use first, then from the least work to the most.
    pub fn parameters(&self, in_use: Parameters) -> Vec<Parameters> {
        let presets = || {
            self.presets
                .iter()
                .flat_map(|preset| self.methods.iter().filter_map(|method| Parameters::of(method, *preset)))
        };
        let (with_radius, without): (Vec<_>, Vec<_>) =
            presets().partition(|parameters| radius(&parameters.method).is_some());
        let mut radii = self.radii.clone();
        radii.sort_unstable();
        let swept = radii.into_iter().flat_map(|radius| {
            let with = move |parameters: &Parameters| {
                let method = parameters.method.with_parameter("window_radius", radius).ok()?;
                Some(Parameters { method, ..*parameters })
            };
            with_radius.iter().filter_map(with).collect::<Vec<_>>()
        });
        let mut all = vec![in_use];
        for parameters in without.iter().copied().chain(swept) {
            if !all.iter().any(|other| other.method == parameters.method) {
                all.push(parameters);
            }
        }
        all
    }
}

/// The radius of the window, in pixels, where it is a parameter.
pub fn radius(method: &Method) -> Option<u32> {
    method.has_parameter("window_radius").then(|| method.window_radius())
}

/// What is swept, and what has come of it.
#[derive(Clone, Debug, Default)]
pub struct Sweep {
    /// Over what the next one goes.
    pub extent: Extent,
    /// What was measured on the open frame, in the order of measuring: the result and its estimated error alone, by the
    /// shorter of two runs, so that compiling shaders does not count.
    pub points: Vec<Run>,
    /// All that is measured; empty before the first sweep.
    pub planned: Arc<[Parameters]>,
    /// Whether it goes on.
    pub is_running: bool,
}

impl Sweep {
    /// Takes in what was measured; the last point ends it.
    pub fn add(&mut self, point: Run) {
        self.points.retain(|other| other.parameters.method != point.parameters.method);
        self.points.push(point);
        self.is_running &= self.planned.last().is_some_and(|last| last.method != point.parameters.method);
    }

    /// Starts one, which forgets what an earlier one measured. What is to be measured.
    pub fn start(&mut self, in_use: Parameters) -> Arc<[Parameters]> {
        self.points.clear();
        self.planned = self.extent.parameters(in_use).into();
        self.is_running = true;
        self.planned.clone()
    }

    /// Forgets everything but over what it goes: for another frame.
    pub fn clear(&mut self) {
        *self = Self { extent: std::mem::take(&mut self.extent), ..Self::default() };
    }
}
