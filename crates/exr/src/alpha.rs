//! Alpha as a feature, and pixels in which no ray hit anything.

use std::borrow::Cow;

use stein::frame::{FeatureKind, RawSignal, SamplesPerPixel};
use stein::image::Image;

/// Name of the feature that alpha is.
pub(crate) const ALPHA: &str = "alpha";

/// Brings the values of an alpha to 0 to 1. Values that are not finite are damage, which a frame repairs and counts.
pub(crate) fn clamp(alpha: &mut Image) {
    let finite = alpha.planes.iter_mut().flatten().filter(|alpha| alpha.is_finite());
    finite.for_each(|alpha| *alpha = alpha.clamp(0.0, 1.0));
}

/// Returns alpha as a feature, which separates what a ray may hit from what it may miss; `None` if it is the same
/// everywhere, or if nothing tells its noise. Its halves do; so does the number of samples: the variance of the mean of
/// n numbers from 0 to 1 is at most α(1 − α)/n.
pub(crate) fn feature(alpha: &RawSignal, samples: &SamplesPerPixel) -> Option<RawSignal> {
    let mut alpha = alpha.clone();
    [Some(&mut alpha.mean), alpha.half_a.as_mut(), alpha.half_b.as_mut()].into_iter().flatten().for_each(clamp);
    let plane = alpha.mean.planes.first()?;
    if plane.iter().all(|alpha| *alpha == plane[0]) {
        return None;
    }
    if alpha.half_a.is_none() || alpha.half_b.is_none() {
        let count = |pixel: usize| match samples {
            SamplesPerPixel::Unknown => None,
            SamplesPerPixel::Uniform(count) => Some(*count),
            SamplesPerPixel::PerPixel(counts) => Some(counts.planes[0][pixel]),
        };
        let variance_of = |alpha: f32, count: f32| alpha * (1.0 - alpha) / count;
        let variance = plane.iter().enumerate().map(|(pixel, alpha)| Some(variance_of(*alpha, count(pixel)?)));
        let planes = vec![variance.collect::<Option<_>>()?];
        alpha.variance_of_mean = Some(Image { extent: alpha.mean.extent, planes });
    }
    Some(alpha)
}

/// Returns the pixels without hits: alpha and the colour, multiplied by it, are 0 in the mean and in both halves.
pub(crate) fn empty_pixels(color: &RawSignal, alpha: &[f32]) -> Vec<bool> {
    let mut empty: Vec<bool> = alpha.iter().map(|alpha| *alpha <= 0.0).collect();
    let images = [Some(&color.mean), color.half_a.as_ref(), color.half_b.as_ref()].into_iter().flatten();
    for plane in images.flat_map(|image| &image.planes) {
        empty.iter_mut().zip(plane).for_each(|(empty, value)| *empty &= *value == 0.0);
    }
    empty
}

/// Replaces the values of a feature in the pixels without hits: a distance or position becomes infinite, everything
/// else 0, without noise.
pub(crate) fn leave_without_hits(name: &str, feature: &mut RawSignal, empty: &[bool]) {
    let is_distance = FeatureKind::from_name(name) == FeatureKind::Distance;
    let fill = |image: &mut Image, with: f32| {
        for plane in &mut image.planes {
            plane.iter_mut().zip(empty).filter(|(_, empty)| **empty).for_each(|(value, _)| *value = with);
        }
    };
    fill(&mut feature.mean, if is_distance { f32::INFINITY } else { 0.0 });
    // Equal halves have no noise, also where the mean is a miss.
    let noise = [&mut feature.half_a, &mut feature.half_b, &mut feature.variance_of_mean];
    noise.into_iter().flatten().for_each(|image| fill(image, 0.0));
}

/// Returns a colour that is 0 in the pixels without hits whose alpha is 0 in the output, too.
pub(crate) fn without_fringe<'a>(mut image: Cow<'a, Image>, alpha: &[f32], empty: &[bool]) -> Cow<'a, Image> {
    for (pixel, _) in empty.iter().zip(alpha).enumerate().filter(|(_, (empty, alpha))| **empty && **alpha == 0.0) {
        if image.planes.iter().any(|plane| plane[pixel] != 0.0) {
            image.to_mut().planes.iter_mut().for_each(|plane| plane[pixel] = 0.0);
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use stein::image::Extent;

    use super::*;

    fn image(values: &[f32]) -> Image {
        Image { extent: Extent { width: values.len() as u32, height: 1 }, planes: vec![values.to_vec()] }
    }

    #[test]
    fn alpha_is_a_feature_if_its_noise_is_known() {
        let alpha = RawSignal { mean: image(&[0.5, 2.0, 0.0]), half_a: None, half_b: None, variance_of_mean: None };
        assert_eq!(feature(&alpha, &SamplesPerPixel::Unknown), None);
        let known = feature(&alpha, &SamplesPerPixel::Uniform(4.0)).expect("the number of samples tells its noise");
        assert_eq!(known.mean.planes[0], [0.5, 1.0, 0.0]);
        assert_eq!(known.variance_of_mean.map(|image| image.planes[0].clone()), Some(vec![0.0625, 0.0, 0.0]));
        let halves = RawSignal { half_a: Some(image(&[0.0; 3])), half_b: Some(image(&[1.0; 3])), ..alpha.clone() };
        let known = feature(&halves, &SamplesPerPixel::Unknown).expect("its halves tell its noise");
        assert!(known.half_a.is_some() && known.variance_of_mean.is_none());
        let opaque = RawSignal { mean: image(&[1.0; 3]), ..alpha };
        assert_eq!(feature(&opaque, &SamplesPerPixel::Uniform(4.0)), None);
    }

    #[test]
    fn pixels_without_hits_are_misses_and_have_no_noise() {
        let color = RawSignal {
            mean: image(&[0.0, 0.0, 1.0]),
            half_a: Some(image(&[0.0, 1.0, 1.0])),
            half_b: None,
            variance_of_mean: None,
        };
        let empty = empty_pixels(&color, &[0.0; 3]);
        assert_eq!(empty, [true, false, false]);
        let feature = RawSignal {
            mean: image(&[5.0; 3]),
            half_a: Some(image(&[4.0; 3])),
            half_b: Some(image(&[6.0; 3])),
            variance_of_mean: Some(image(&[1.0; 3])),
        };
        for (name, miss) in [("depth", f32::INFINITY), ("albedo", 0.0)] {
            let mut feature = feature.clone();
            leave_without_hits(name, &mut feature, &empty);
            assert_eq!(feature.mean.planes[0], [miss, 5.0, 5.0]);
            assert_eq!(feature.variance_of_mean.map(|image| image.planes[0].clone()), Some(vec![0.0, 1.0, 1.0]));
            assert_eq!(feature.half_a.map(|image| image.planes[0][0]), feature.half_b.map(|image| image.planes[0][0]));
        }
    }
}
