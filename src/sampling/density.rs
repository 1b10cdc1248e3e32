//! Densities of samples from an estimate: where the next samples pay most.

use std::borrow::Cow;

use crate::Estimate;
use crate::error::{Error, RequestCause, Result};
use crate::image::{Extent, Image};
use crate::method::Intermediate;
use crate::stage::gaussian::Gaussian;

/// Returns where the next samples pay most, from an estimate that kept [`Intermediate::Density`]: one plane, at least
/// 0, in any unit, for a [`SamplingMap`](super::SamplingMap) of `samples_per_pixel` samples on average.
///
/// For DFC and NLM it is the layer `density` (thesis 8.6, 7.1.2); the numbers have no influence. For GEM (thesis 6.3),
/// the pixels that gain most get `samples_per_filter` samples each, as far as `samples_per_pixel` samples per pixel
/// last; ties go to the upper and left pixels. The samples of a pixel are spread over the support of its filter by the
/// filter's weights. Where the frame does not know its samples, each pixel counts as having `samples_per_filter`.
///
/// # Errors
/// [`Error::Request`] where the estimate did not keep the density.
pub fn sampling_density(
    estimate: &Estimate,
    samples_per_pixel: f64,
    samples_per_filter: f64,
) -> Result<Cow<'_, Image>> {
    let layer = |name: &str| {
        estimate
            .layers
            .iter()
            .find(|layer| layer.intermediate == Intermediate::Density && layer.name == name)
            .map(|layer| &layer.image)
    };
    match (layer("density"), layer("reduction")) {
        (Some(density), _) => Ok(Cow::Borrowed(density)),
        (None, Some(reduction)) => Ok(Cow::Owned(filters_that_gain_most(
            reduction,
            &estimate.weight_sum,
            samples_per_pixel,
            samples_per_filter,
        ))),
        (None, None) => Err(Error::Request(RequestCause::Misuse {
            problem: "the estimate does not say where samples pay".into(),
            change: "denoise with `Intermediate::Density` in `Options::keep`",
        })),
    }
}

/// Returns the expected samples per pixel. `reduction` has three planes: relative MSE, samples in the support, and σ of
/// each pixel's filter. `pixels_taking_part` is the size of the support.
fn filters_that_gain_most(
    reduction: &Image,
    pixels_taking_part: &Image,
    samples_per_pixel: f64,
    samples_per_filter: f64,
) -> Image {
    let extent = reduction.extent;
    let [relative_mse, support, sigma] = [0, 1, 2].map(|plane| reduction.planes[plane].as_slice());
    let gain = |pixel: usize| {
        let there = match f64::from(support[pixel]) {
            0.0 => samples_per_filter * f64::from(pixels_taking_part.planes[0][pixel]),
            known => known,
        };
        f64::from(relative_mse[pixel]) * samples_per_filter / (samples_per_filter + there)
    };
    let mut ranked: Vec<(f64, usize)> =
        (0..extent.pixels()).map(|pixel| (gain(pixel), pixel)).filter(|(gain, _)| *gain > 0.0).collect();
    ranked.sort_unstable_by(|(a, p), (b, q)| b.total_cmp(a).then(p.cmp(q)));
    ranked.truncate((extent.pixels() as f64 * samples_per_pixel / samples_per_filter).round() as usize);

    // Sorted by scale, so that the filters of one scale can be spread along one axis after the other.
    ranked.sort_unstable_by(|(_, p), (_, q)| sigma[*p].total_cmp(&sigma[*q]).then(p.cmp(q)));
    let mut density = vec![0.0; extent.pixels()];
    for filters in ranked.chunk_by(|(_, p), (_, q)| sigma[*p] == sigma[*q]) {
        let pixels = filters.iter().map(|(_, pixel)| *pixel);
        spread(extent, pixels, sigma[filters[0].1], samples_per_filter, &mut density);
    }
    Image { extent, planes: vec![density.into_iter().map(|samples| samples as f32).collect()] }
}

/// Adds `samples` for each of the pixels, spread over the existing pixels of the window by a Gaussian's weights.
fn spread(extent: Extent, pixels: impl Iterator<Item = usize>, sigma: f32, samples: f64, density: &mut [f64]) {
    if sigma == 0.0 {
        pixels.for_each(|pixel| density[pixel] += samples);
        return;
    }
    let Gaussian { sigma, radius } = Gaussian::new(sigma);
    let weights: Vec<f64> =
        (0..=radius).map(|distance| (-0.5 * (f64::from(distance) / f64::from(sigma)).powi(2)).exp()).collect();
    let (width, height) = (extent.width as usize, extent.height as usize);
    let window = |at: usize, size: usize| at.saturating_sub(radius as usize)..(at + radius as usize + 1).min(size);
    // Sums of the weights around each column and around each row.
    let sums = |size: usize| -> Vec<f64> {
        (0..size).map(|at| window(at, size).map(|other| weights[at.abs_diff(other)]).sum()).collect()
    };
    let (in_row, in_column) = (sums(width), sums(height));

    let mut along_rows = vec![0.0; density.len()];
    for pixel in pixels {
        let (x, y) = (pixel % width, pixel / width);
        let share = samples / (in_row[x] * in_column[y]);
        for to in window(x, width) {
            along_rows[y * width + to] += share * weights[x.abs_diff(to)];
        }
    }
    for y in 0..height {
        for from in window(y, height) {
            let weight = weights[y.abs_diff(from)];
            for x in 0..width {
                density[y * width + x] += weight * along_rows[from * width + x];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXTENT: Extent = Extent { width: 40, height: 30 };

    fn image(planes: &[&dyn Fn(usize, usize) -> f32]) -> Image {
        let plane = |value: &&dyn Fn(usize, usize) -> f32| {
            (0..EXTENT.pixels()).map(|pixel| value(pixel % 40, pixel / 40)).collect()
        };
        Image { extent: EXTENT, planes: planes.iter().map(plane).collect() }
    }

    #[test]
    fn samples_are_spread_over_the_support_by_its_weights() {
        let sigma = 2.0;
        // In the middle, at a border, in a corner.
        for (at_x, at_y) in [(20, 14), (1, 12), (39, 29)] {
            let reduction = image(&[&|x, y| f32::from((x, y) == (at_x, at_y)), &|_, _| 8.0, &|_, _| sigma]);
            let density = filters_that_gain_most(&reduction, &image(&[&|_, _| 50.0]), 32.0 / 1200.0, 32.0);
            let weight = |x: usize, y: usize| {
                let (dx, dy) = (x.abs_diff(at_x), y.abs_diff(at_y));
                if dx.max(dy) > 6 { 0.0 } else { (-0.5 * (dx * dx + dy * dy) as f64 / 4.0).exp() }
            };
            let total: f64 = (0..EXTENT.pixels()).map(|pixel| weight(pixel % 40, pixel / 40)).sum();
            for (pixel, density) in density.planes[0].iter().enumerate() {
                let expected = 32.0 * weight(pixel % 40, pixel / 40) / total;
                assert!((f64::from(*density) - expected).abs() < 1e-5, "{pixel}: {density} instead of {expected}");
            }
        }
    }

    #[test]
    fn pixels_with_few_samples_gain_more() {
        // The same error everywhere, half of the image with four times the samples in its support; room for a quarter
        // of the pixels.
        let reduction = image(&[&|_, _| 0.5, &|x, _| if x < 20 { 8.0 } else { 32.0 }, &|_, _| 0.0]);
        let density = filters_that_gain_most(&reduction, &image(&[&|_, _| 1.0]), 4.0, 16.0);
        let chosen: Vec<usize> = (0..EXTENT.pixels()).filter(|pixel| density.planes[0][*pixel] > 0.0).collect();
        // Ties go to the upper ones.
        let expected: Vec<usize> = (0..EXTENT.pixels()).filter(|pixel| pixel % 40 < 20).take(300).collect();
        assert_eq!(chosen, expected);
        assert!(chosen.iter().all(|pixel| density.planes[0][*pixel] == 16.0));
    }

    #[test]
    fn without_error_nobody_gains() {
        let reduction = image(&[&|_, _| 0.0, &|_, _| 8.0, &|_, _| 4.0]);
        assert!(
            filters_that_gain_most(&reduction, &image(&[&|_, _| 1.0]), 4.0, 16.0).planes[0]
                .iter()
                .all(|samples| *samples == 0.0)
        );
    }
}
