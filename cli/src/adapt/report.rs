//! The report of `stein adapt`, as text and JSON.

use serde::Serialize;
use serde_json::Value;
use stein::gpu::AdapterSummary;
use stein::sampling::{Samples, estimated_relative_mse};
use stein::text::number;
use stein::{Estimate, Image};
use stein_metric as metric;

use super::super::Failure;
use super::super::sample_map::Spread;
use super::folder::Setup;

/// The JSON document.
#[derive(Debug, Serialize)]
pub(crate) struct Document {
    setup: Value,
    device: AdapterSummary,
    /// Number of the last iteration that was complete before this run; that iteration is the first of `iterations`.
    resumed_after: Option<u32>,
    pub(crate) iterations: Vec<Row>,
    /// Result of drawing all samples evenly.
    pub(crate) uniform: Option<Row>,
}

/// Result after an iteration.
#[derive(Debug, Serialize)]
pub(crate) struct Row {
    iteration: String,
    /// Distribution of all samples so far.
    samples: Spread,
    /// Relative MSE, estimated without a reference.
    estimated_relative_mse: Option<f64>,
    /// Errors against the reference; `None` without one.
    errors: Option<Errors>,
}

#[derive(Debug, Serialize)]
struct Errors {
    noisy_relative_mse: f64,
    denoised_relative_mse: f64,
}

impl Document {
    pub(crate) fn new(setup: &Setup<'_>, device: &AdapterSummary, resumed_after: Option<u32>) -> Result<Self, Failure> {
        let setup =
            serde_json::to_value(setup).map_err(|error| Failure::output(format_args!("the JSON document: {error}")))?;
        Ok(Self { setup, device: device.clone(), resumed_after, iterations: Vec::new(), uniform: None })
    }

    /// Formats a note on the errors, with the ratio of the last iteration to even sampling if both errors are known.
    pub(crate) fn comparison(&self) -> String {
        let errors = self
            .iterations
            .last()
            .zip(self.uniform.as_ref())
            .and_then(|(adaptive, uniform)| adaptive.errors.as_ref().zip(uniform.errors.as_ref()));
        let ratio = errors.map(|(adaptive, uniform)| adaptive.denoised_relative_mse / uniform.denoised_relative_mse);
        let ratio =
            ratio.map(|ratio| format!("; adaptive sampling leaves {} times the error of even sampling", number(ratio)));
        format!("(relative MSE; estimated: without the reference{})", ratio.unwrap_or_default())
    }
}

impl Row {
    pub(crate) fn new(
        iteration: String,
        samples: &Samples,
        estimate: &Estimate,
        reference: Option<&Image>,
    ) -> Result<Self, Failure> {
        let compare = |reference| {
            Ok::<_, Failure>(Errors {
                noisy_relative_mse: metric::relative_mse(&samples.color().mean, reference)?,
                denoised_relative_mse: metric::relative_mse(&estimate.color, reference)?,
            })
        };
        Ok(Self {
            iteration,
            samples: Spread::of(&samples.counts()),
            estimated_relative_mse: estimated_relative_mse(estimate),
            errors: reference.map(compare).transpose()?,
        })
    }

    pub(crate) fn head(reference: bool) -> String {
        let errors =
            if reference { ["noisy", "denoised"].map(|name| format!("{name:>12}")).concat() } else { String::new() };
        format!("  {:<9}{:>9}{:>16}{:>12}{errors}", "iteration", "spp", "per pixel", "estimated")
    }

    /// Formats the row under the columns of [`Self::head`].
    pub(crate) fn text(&self) -> String {
        let errors = self.errors.as_ref().map(|errors| {
            [errors.noisy_relative_mse, errors.denoised_relative_mse]
                .map(|error| format!("{:>12}", number(error)))
                .concat()
        });
        let range = self.samples.range();
        let (spp, estimated) = (
            number(self.samples.samples_per_pixel),
            self.estimated_relative_mse.map_or_else(|| "-".to_owned(), number),
        );
        format!("  {:<9}{spp:>9}{range:>16}{estimated:>12}{}", self.iteration, errors.unwrap_or_default())
    }
}
