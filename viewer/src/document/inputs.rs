//! Layers of the input: of the frame and of its reference.

use std::sync::Arc;

use stein::frame::{Feature, SamplesPerPixel, Signal};
use stein::sampling::SampleCounts;
use stein::{Frame, Image};

use super::along::rendered_layers;
use super::{RADIANCE, RADIANCE_SQUARED, describe};
use crate::layer::{Description, Group, Kind, Layer, Scale};

/// Makes the layers of a frame and its reference.
pub fn input_layers(frame: &Frame, reference: Option<&Arc<Image>>) -> Vec<Arc<Layer>> {
    let mut layers = Vec::new();
    let mut add =
        |description: Description, image: Arc<Image>| layers.push(Arc::new(Layer::new(description, image, None)));
    let color = frame.color();
    let input = |name, title, about, kind, unit| describe(name, title, about, Group::Input, kind, unit);
    add(
        input("noisy", "noisy", "The mean of each pixel's samples: what is denoised.", Kind::Color, RADIANCE),
        Arc::new(color.mean.clone()),
    );
    if let Some([a, b]) = halves(color) {
        add(
            input("noisy_half_a", "half A", "The mean of one half of the samples.", Kind::Color, RADIANCE),
            Arc::new(a),
        );
        add(
            input("noisy_half_b", "half B", "The mean of the other half of the samples.", Kind::Color, RADIANCE),
            Arc::new(b),
        );
    }
    if let Some(spread) = &color.half_spread {
        let about = "(A − B)/2 of the halves: 0 on average, and its square the two-buffer estimate of the variance \
                     of the mean.";
        add(
            input("half_spread", "half spread", about, Kind::Scalar(Scale::Diverging), RADIANCE),
            Arc::new(spread.clone()),
        );
    }
    if let Some(variance) = &color.variance_of_mean {
        let about = "Sample variance of the mean, as the renderer wrote it.";
        add(
            input("sample_variance", "sample variance", about, Kind::Scalar(Scale::Log), RADIANCE_SQUARED),
            Arc::new(variance.clone()),
        );
    }
    if let SamplesPerPixel::PerPixel(samples) = frame.samples_per_pixel() {
        let about = "How many samples each pixel's mean was made of.";
        add(
            input("samples", "samples per pixel", about, Kind::Scalar(Scale::Linear), "samples"),
            Arc::new(samples.clone()),
        );
    }
    for feature in frame.features() {
        let image = |image: &Image, factor: f32, offset: f32| {
            let restored = |plane: &Vec<f32>| plane.iter().map(|value| value * factor + offset).collect();
            Arc::new(Image { extent: image.extent, planes: image.planes.iter().map(restored).collect() })
        };
        let mean = image(&feature.signal.mean, feature.unit_scale, feature.unit_offset);
        let about = format!("The feature {} as it was rendered.", feature.name);
        add(describe(&feature.name, &feature.name, about, Group::Features, feature_kind(&mean), ""), mean);
        if let Some((variance, about)) = variance(feature) {
            let about = format!("{about} of the feature {}.", feature.name);
            let (name, title) = (format!("{}_variance", feature.name), format!("{}: variance", feature.name));
            add(
                describe(name, title, about, Group::Features, Kind::Scalar(Scale::Log), ""),
                image(&variance, feature.unit_scale.powi(2), 0.0),
            );
        }
    }
    layers.extend(rendered_layers(frame));
    layers.extend(reference.map(reference_layer));
    layers
}

/// Makes the layer of a reference.
pub fn reference_layer(reference: &Arc<Image>) -> Arc<Layer> {
    let about = "The true image, as far as it was rendered.";
    Arc::new(Layer::new(
        describe("reference", "reference", about, Group::Result, Kind::Color, RADIANCE),
        reference.clone(),
        None,
    ))
}

/// Makes the layer of the samples that an iteration of the adaptive loop drew.
pub fn drawn_layer(counts: &SampleCounts) -> Arc<Layer> {
    let samples = counts.pairs().iter().map(|pairs| (2 * pairs) as f32).collect();
    let about =
        "How many samples this iteration drew in each pixel: the density of the iteration before, in whole pairs.";
    let description = describe("drawn", "sampling map", about, Group::Error, Kind::Scalar(Scale::Linear), "samples");
    Arc::new(Layer::new(description, Arc::new(Image { extent: counts.extent(), planes: vec![samples] }), None))
}

/// Returns the variance of a feature's mean, in unit range, and the words that describe it; `None` if it is unknown.
fn variance(feature: &Feature) -> Option<(Image, &'static str)> {
    let Signal { half_spread, variance_of_mean, .. } = &feature.signal;
    match (variance_of_mean, half_spread) {
        (Some(variance), _) => Some((variance.clone(), "Sample variance of the mean")),
        (None, Some(spread)) => {
            let squared = |plane: &Vec<f32>| plane.iter().map(|value| value * value).collect();
            Some((
                Image { extent: spread.extent, planes: spread.planes.iter().map(squared).collect() },
                "Two-buffer variance of the mean",
            ))
        }
        (None, None) => None,
    }
}

/// Returns the means of the two equal halves of the samples; `None` without a half spread.
fn halves(signal: &Signal) -> Option<[Image; 2]> {
    let spread = signal.half_spread.as_ref()?;
    let half = |sign: f32| {
        let planes = signal.mean.planes.iter().zip(&spread.planes);
        Image {
            extent: spread.extent,
            planes: planes.map(|(mean, spread)| mean.iter().zip(spread).map(|(m, s)| m + sign * s).collect()).collect(),
        }
    };
    Some([half(1.0), half(-1.0)])
}

/// Returns the kind of a feature: one channel is a number, three channels with negative values are a direction, and
/// everything else is shown as a colour.
pub(super) fn feature_kind(image: &Image) -> Kind {
    match image.channels() {
        1 => Kind::Scalar(Scale::Linear),
        3 if image.planes.iter().flatten().any(|value| *value < -0.01) => Kind::Direction,
        _ => Kind::Color,
    }
}
