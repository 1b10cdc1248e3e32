//! Errors of the denoised image, and of the images that it was made from, against a reference.

use serde::Serialize;
use stein::frame::PayloadKind;
use stein::method::Intermediate;
use stein::text::{self, number};
use stein::{Estimate, Frame, Image};
use stein_metric as metric;

use super::Failure;
use super::out::table;

/// Intermediates that the comparison needs.
pub(crate) const NEEDED: [Intermediate; 4] =
    [Intermediate::Candidates, Intermediate::Sure, Intermediate::Pass1, Intermediate::Halves];

/// Errors of one image against the reference.
#[derive(Debug, Serialize)]
pub(crate) struct Errors {
    pub(crate) image: &'static str,
    pub(crate) relative_mse: f64,
    mse: f64,
    ssim: f64,
    /// Mean over the pixels of the squared error summed over the channels.
    squared_error: f64,
    /// Estimate of `squared_error` without the reference.
    estimated_squared_error: Option<f64>,
}

impl Errors {
    fn new(name: &'static str, image: &Image, reference: &Image, estimated: Option<f64>) -> Result<Self, Failure> {
        let mse = metric::mse(image, reference)?;
        Ok(Self {
            image: name,
            relative_mse: metric::relative_mse(image, reference)?,
            mse,
            ssim: metric::ssim(image, reference)?,
            squared_error: mse * image.channels() as f64,
            estimated_squared_error: estimated,
        })
    }
}

/// Compares the images with the reference, from the noisy colour to the result, in the order in which they are made.
pub(crate) fn compare(frame: &Frame, estimate: &Estimate, reference: &Image) -> Result<Vec<Errors>, Failure> {
    let kept = |name: &str| estimate.layers.iter().find(|layer| layer.name == name).map(|layer| &layer.image);
    let mut errors = vec![Errors::new("noisy", &frame.color().mean, reference, None)?];
    for (index, name) in ["first", "second", "third"].into_iter().enumerate() {
        if let Some(image) = kept(name) {
            let estimated = kept("sure").and_then(|sure| sure.planes.get(index)).map(|plane| metric::mean(plane));
            errors.push(Errors::new(name, image, reference, estimated)?);
        }
    }
    let estimated = estimate.error.as_ref().and_then(|error| error.planes.first()).map(|plane| metric::mean(plane));
    for name in ["pass1", "half_a", "half_b"] {
        if let Some(image) = kept(name) {
            // The estimated error belongs to the result.
            errors.push(Errors::new(name, image, reference, None)?);
        }
    }
    errors.push(Errors::new("result", &estimate.color, reference, estimated)?);
    Ok(errors)
}

/// Errors of a layer that is denoised along with the colour.
#[derive(Debug, Serialize)]
pub(crate) struct LayerErrors {
    layer: String,
    is_alpha: bool,
    noisy: Measures,
    result: Measures,
}

#[derive(Debug, Serialize)]
struct Measures {
    relative_mse: f64,
    mse: f64,
}

impl Measures {
    fn new(image: &Image, reference: &Image) -> Result<Self, Failure> {
        Ok(Self { relative_mse: metric::relative_mse(image, reference)?, mse: metric::mse(image, reference)? })
    }
}

/// Compares the layers that were denoised along with those of the references that have their names.
pub(crate) fn compare_along(
    frame: &Frame,
    estimate: &Estimate,
    references: &[(String, Image)],
) -> Result<Vec<LayerErrors>, Failure> {
    let mut errors = Vec::new();
    for (name, reference) in references {
        let noisy = frame.payload().iter().find(|layer| layer.name == *name);
        let result = estimate.payload.iter().find(|layer| layer.name == *name);
        let Some((noisy, result)) = noisy.zip(result) else { continue };
        errors.push(LayerErrors {
            layer: name.clone(),
            is_alpha: noisy.kind == PayloadKind::Alpha,
            noisy: Measures::new(&noisy.mean, reference)?,
            result: Measures::new(&result.image, reference)?,
        });
    }
    Ok(errors)
}

/// Formats the errors of layers, one line each.
pub(crate) fn text_along(errors: &[LayerErrors]) -> String {
    let line = |errors: &LayerErrors| {
        let LayerErrors { layer, is_alpha, noisy, result } = errors;
        let (what, noisy, result) = match is_alpha {
            true => ("MSE", noisy.mse, result.mse),
            false => ("relative MSE", noisy.relative_mse, result.relative_mse),
        };
        format!("  {}: {what} {} -> {}", text::name(layer), number(noisy), number(result))
    };
    text::lines(errors.iter().map(line)).join("\n")
}

/// Formats the errors as a table.
pub(crate) fn text(errors: &[Errors]) -> String {
    let head = ["", "relative MSE", "MSE", "SSIM", "squared error", "estimated"].map(String::from).to_vec();
    let row = |errors: &Errors| {
        let estimated = errors.estimated_squared_error.map_or_else(|| "-".to_owned(), number);
        vec![
            errors.image.to_owned(),
            number(errors.relative_mse),
            number(errors.mse),
            format!("{:.4}", errors.ssim),
            number(errors.squared_error),
            estimated,
        ]
    };
    let rows: Vec<_> = std::iter::once(head).chain(errors.iter().map(row)).collect();
    format!(
        "{}\n  (squared error: mean over the pixels, summed over the channels; \
         estimated: without the reference; for candidates by SURE)",
        table(&rows, 1)
    )
}
