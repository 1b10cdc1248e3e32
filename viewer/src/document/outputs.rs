//! Layers of the results of a run.

use std::sync::Arc;

use stein::method::Intermediate;
use stein::{Estimate, Frame, Image};

use super::along::denoised_layers;
use super::inputs::feature_kind;
use super::{RADIANCE, RADIANCE_SQUARED, describe};
use crate::layer::{Description, Group, Kind, Layer, Range, Scale, single_plane};

const CANDIDATES: [(&str, &str, &str); 3] = [
    ("first", "FIRST", "small patches of colour and features: sharp"),
    ("second", "SECOND", "large patches of colour and features: smooth"),
    ("third", "THIRD", "features alone: bold"),
];

/// A candidate's name as a title.
fn title_of(candidate: &str) -> String {
    let known = CANDIDATES.into_iter().find(|(name, ..)| *name == candidate);
    known.map_or_else(|| candidate.to_owned(), |(_, title, _)| title.to_owned())
}

const SHARE: Range = Range { low: 0.0, high: 1.0 };

/// Makes the layers of an estimate of `frame`; `estimate.layers` is empty afterwards.
pub fn output_layers(frame: &Frame, estimate: &mut Estimate, reference: Option<&Arc<Image>>) -> Vec<Arc<Layer>> {
    let mut layers = Layers(Vec::new());
    let result = Arc::new(estimate.color.clone());
    let about = "The denoised colour: the candidates blended by their shares, and filtered once more where the \
                 halves tell what noise is left.";
    layers.add(describe("result", "result", about, Group::Result, Kind::Color, RADIANCE), result, None);
    for layer in std::mem::take(&mut estimate.layers) {
        layers.add_kept(layer);
    }
    layers.0.extend(denoised_layers(frame, &estimate.payload));
    if let Some(selection) = &estimate.selection
        && !layers.0.iter().any(|layer| layer.name() == "selection")
    {
        let about = "Shares that entered the blend";
        layers.add_shares("selection", "selection", about, selection, &estimate.candidates);
    }
    let about = "How many pixels took part in a pixel's average: the sum of the weights.";
    layers.add(
        describe("weight_sum", "pixels averaged", about, Group::Error, Kind::Scalar(Scale::Log), "pixels"),
        Arc::new(estimate.weight_sum.clone()),
        None,
    );
    let estimated = estimate.error.as_ref().map(|error| {
        let about = "Estimated squared error of the result, summed over the channels, without a reference.";
        let description =
            describe("error", "estimated error", about, Group::Error, Kind::Scalar(Scale::Log), RADIANCE_SQUARED);
        layers.add(description, Arc::new(error.clone()), None)
    });
    layers.0.extend(
        reference.map(|reference| true_error_layer(estimate, reference, estimated.map(|estimated| estimated.range))),
    );
    layers.0
}

/// Makes the layer of the true error, on the scale of the estimated error.
pub(super) fn true_error_layer(estimate: &Estimate, reference: &Image, scale: Option<Range>) -> Arc<Layer> {
    let about = "Squared error of the result against the reference, summed over the channels. On the scale of the \
                 estimated error.";
    let description =
        describe("true_error", "true error", about, Group::Error, Kind::Scalar(Scale::Log), RADIANCE_SQUARED);
    Arc::new(Layer::new(description, Arc::new(squared_error(&estimate.color, reference)), scale))
}

struct Layers(Vec<Arc<Layer>>);

impl Layers {
    fn add(&mut self, description: Description, image: Arc<Image>, range: Option<Range>) -> Arc<Layer> {
        let layer = Arc::new(Layer::new(description, image, range));
        self.0.push(layer.clone());
        layer
    }

    /// Adds a map of shares in three colours, and each share as a layer of its own. `names` are the candidates of the
    /// planes.
    fn add_shares<N: AsRef<str>>(&mut self, name: &str, title: &str, about: &str, image: &Image, names: &[N]) {
        let explained = format!("{about}: red FIRST, green SECOND, blue THIRD.");
        let share_of = |candidate: &str| {
            let plane = names.iter().position(|name| name.as_ref() == candidate);
            plane.map_or_else(|| vec![0.0; image.extent.pixels()], |plane| image.planes[plane].clone())
        };
        let planes = CANDIDATES.map(|(candidate, ..)| share_of(candidate)).to_vec();
        let in_colors = Arc::new(Image { extent: image.extent, planes });
        self.add(describe(name, title, explained, Group::Selection, Kind::Shares, ""), in_colors, Some(SHARE));
        for (plane, candidate) in names.iter().map(AsRef::as_ref).enumerate() {
            let candidate_title = title_of(candidate);
            let explained = format!("{about}: {candidate_title} alone.");
            let description = describe(
                format!("{name}.{candidate}"),
                format!("{title}: {candidate_title}"),
                explained,
                Group::Selection,
                Kind::Scalar(Scale::Linear),
                "share",
            );
            self.add(description, Arc::new(single_plane(image, plane)), Some(SHARE));
        }
    }

    /// Adds SURE of each candidate, all on one scale so that they can be compared.
    fn add_sure(&mut self, name: &str, title: &str, about: &str, image: &Image, names: &[String]) {
        let mut range = None;
        for (plane, candidate) in names.iter().enumerate() {
            let candidate_title = title_of(candidate);
            let explained = format!(
                "{about} of {candidate_title}: the less, the better. Negative values are noise of the estimate."
            );
            let description = describe(
                format!("{name}.{candidate}"),
                format!("{title}: {candidate_title}"),
                explained,
                Group::Candidates,
                Kind::Scalar(Scale::Diverging),
                RADIANCE_SQUARED,
            );
            let layer = self.add(description, Arc::new(single_plane(image, plane)), range);
            range = Some(layer.range);
        }
    }

    fn add_kept(&mut self, layer: stein::Layer) {
        let stein::Layer { intermediate, name, channels, image } = layer;
        let image = Arc::new(image);
        let candidate = CANDIDATES.into_iter().find(|(candidate, ..)| name.starts_with(candidate));
        let log = Kind::Scalar(Scale::Log);
        let linear = Kind::Scalar(Scale::Linear);
        let description = match intermediate {
            Intermediate::Spikes => describe(
                name,
                "spikes",
                "What was taken from spikes before filtering.",
                Group::Input,
                Kind::Color,
                RADIANCE,
            ),
            Intermediate::Variance => {
                let about =
                    "Variance of the mean as the filters take it: brought to the magnitude that the halves tell.";
                describe(name, "scaled variance", about, Group::Input, log, RADIANCE_SQUARED)
            }
            Intermediate::Features => {
                let (kind, title, about) =
                    match (name.strip_suffix("_prefiltered"), name.strip_suffix("_residual_variance")) {
                        (Some(feature), _) => (
                            feature_kind(&image),
                            format!("{feature}, prefiltered"),
                            format!("The feature {feature} as the candidates see it."),
                        ),
                        (_, Some(feature)) => (
                            log,
                            format!("{feature}: residual variance"),
                            format!("What noise prefiltering has left in the feature {feature}, as a variance."),
                        ),
                        (None, None) => (feature_kind(&image), name.clone(), format!("The feature {name}.")),
                    };
                describe(name, title, about, Group::Features, kind, "")
            }
            Intermediate::Candidates => {
                let own = (name.as_str(), name.as_str(), "the colour and the features as its parameters say");
                let (_, title, character) = candidate.unwrap_or(own);
                let title = title.to_owned();
                let about = format!("The candidate {title}, weighted by {character}.");
                describe(name, title, about, Group::Candidates, Kind::Color, RADIANCE)
            }
            Intermediate::Derivatives => {
                let (_, title, _) = candidate.unwrap_or(("", "the candidate", ""));
                let about = format!("How much a pixel of {title} follows its own noise: dF/du, which SURE needs.");
                describe(name, format!("{title}: derivative"), about, Group::Candidates, linear, "")
            }
            Intermediate::Sure => {
                let (title, about) = if name.ends_with("smoothed") {
                    ("SURE, smoothed", "Smoothed estimate of the squared error")
                } else {
                    ("SURE", "Unbiased estimate of the squared error")
                };
                return self.add_sure(&name, title, about, &image, &channels);
            }
            Intermediate::Selection => {
                let (title, about) = if name == "selected" {
                    ("least error", "Which candidate has the least smoothed SURE")
                } else {
                    ("selection", "Shares that entered the blend")
                };
                if image.channels() == 1 {
                    let about = "Share of the filter by the colour only in the blend.";
                    let kind = Kind::Scalar(Scale::Linear);
                    let description = describe(name, "colour only: share", about, Group::Selection, kind, "share");
                    self.add(description, image, Some(SHARE));
                    return;
                }
                return self.add_shares(&name, title, about, &image, &channels);
            }
            Intermediate::Pass1 => describe(
                name,
                "pass 1",
                "The candidates blended by their shares, before the second pass.",
                Group::Result,
                Kind::Color,
                RADIANCE,
            ),
            Intermediate::Stopping => {
                let title = name.replace('_', " ");
                describe(name, title, "Whether a pixel stops at the finer of two scales.", Group::Selection, linear, "")
            }
            Intermediate::Scale => describe(
                name,
                "chosen scale",
                "σ of the scale that was chosen; 0 for the pixel filter.",
                Group::Selection,
                linear,
                "pixels",
            ),
            Intermediate::Halves => {
                let title = if name.ends_with('a') { "half A, filtered" } else { "half B, filtered" };
                describe(
                    name,
                    title,
                    "One half of the samples, filtered with the weights of the other.",
                    Group::Candidates,
                    Kind::Color,
                    RADIANCE,
                )
            }
            Intermediate::Density if image.channels() == 1 => {
                describe(name, "sampling density", "Where the next samples pay most.", Group::Error, log, "")
            }
            Intermediate::Density => {
                for (plane, channel) in channels.iter().enumerate() {
                    let title = channel.replace('_', " ");
                    let about = "What tells where the next samples pay most: relative error, samples in the support \
                                 of the filter, its σ.";
                    self.add(
                        describe(format!("{name}.{channel}"), title, about, Group::Error, log, ""),
                        Arc::new(single_plane(&image, plane)),
                        None,
                    );
                }
                return;
            }
        };
        self.add(description, image, None);
    }
}

/// Returns the squared error of each pixel, summed over the channels.
fn squared_error(image: &Image, reference: &Image) -> Image {
    let mut sum = vec![0.0; image.extent.pixels()];
    for (plane, reference) in image.planes.iter().zip(&reference.planes) {
        for (sum, (value, reference)) in sum.iter_mut().zip(plane.iter().zip(reference)) {
            *sum += (value - reference).powi(2);
        }
    }
    Image { extent: image.extent, planes: vec![sum] }
}
