//! Error against run time: denoises the open frame with one set of parameters after the other, whenever the worker has
//! nothing else to do.

use std::sync::Arc;

use stein::{Method, Preset};

use crate::document::MeasuredRun;
use crate::settings::Parameters;

/// Range of a sweep: all combinations of these radii, presets and methods, besides the parameters in use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SweepRange {
    /// Radii of the window in pixels, for methods that have a window radius.
    pub radii: Vec<u32>,
    /// Presets that supply the other parameters.
    pub presets: Vec<Preset>,
    /// Names of the methods.
    pub methods: Vec<&'static str>,
}

impl Default for SweepRange {
    fn default() -> Self {
        Self { radii: vec![3, 5, 7, 10], presets: vec![Preset::Default, Preset::Thesis], methods: vec!["dfc"] }
    }
}

impl SweepRange {
    /// Radii that the panel offers, in pixels.
    pub const RADII: [u32; 7] = [2, 3, 5, 7, 10, 15, 20];

    /// Lists the parameters to measure, each once: `in_use` first, then methods without a window radius, then the
    /// others in the order of their radii, so that the work grows.
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

/// Returns the radius of the window in pixels; `None` if the method has no such parameter.
pub fn radius(method: &Method) -> Option<u32> {
    method.has_parameter("window_radius").then(|| method.window_radius())
}

/// Range, progress and results of a sweep.
#[derive(Clone, Debug, Default)]
pub struct Sweep {
    /// Range of the next sweep.
    pub range: SweepRange,
    /// Runs that were measured on the open frame, in the order of measuring. They made only the result and its
    /// estimated error, and their time is the shorter of two runs, so that compiling shaders does not count.
    pub points: Vec<MeasuredRun>,
    /// Parameters of all runs of the sweep; empty before the first sweep.
    pub planned: Arc<[Parameters]>,
    /// Whether a sweep is running.
    pub is_running: bool,
}

impl Sweep {
    /// Adds a measured run, and removes an earlier run with equal parameters. The last planned run ends the sweep.
    pub fn add(&mut self, point: MeasuredRun) {
        self.points.retain(|other| other.parameters.method != point.parameters.method);
        self.points.push(point);
        self.is_running &= self.planned.last().is_some_and(|last| last.method != point.parameters.method);
    }

    /// Starts a sweep and forgets the results of an earlier one. Returns the parameters to measure.
    pub fn start(&mut self, in_use: Parameters) -> Arc<[Parameters]> {
        self.points.clear();
        self.planned = self.range.parameters(in_use).into();
        self.is_running = true;
        self.planned.clone()
    }

    /// Forgets everything except the range, for another frame.
    pub fn clear(&mut self) {
        *self = Self { range: std::mem::take(&mut self.range), ..Self::default() };
    }
}
