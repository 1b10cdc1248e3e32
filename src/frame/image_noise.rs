//! Variance of the pixel means, estimated from one image alone.

use rayon::prelude::*;

use crate::image::{Extent, Image};

/// Radius of the window in which the squared residuals of the pixels are averaged.
pub(super) const WINDOW_RADIUS: usize = 2;

/// Expectation of the smaller of both squared residuals of a pixel, 1 − (2/π)·√(1 − ρ²): each has the expectation 1,
/// and they have the correlation ρ = 2/3, because they share the pixel.
const SMALLER_SQUARE: f64 = 0.525_491_637_7;

/// Least width and height of an image from which noise can be estimated: a pixel and both of its neighbours.
const LEAST_SIDE: u32 = 3;

/// Returns an estimate of the variance of each pixel's mean, from the image alone, with one plane per channel. `None`
/// for images of fewer than 3 columns or rows.
///
/// The residual of a pixel is its difference from the average of its two neighbours along the axis, horizontal or
/// vertical, on which that difference is smaller. The estimate is the mean of the squared residuals of 5×5 pixels,
/// scaled so that its expectation is the variance of independent Gaussian noise on a constant or a ramp. Values that
/// are not finite are left out; the estimate is 0 where the window has no others.
///
/// Texture counts as noise, so that the estimate may be far too large. Noise that neighbours share, as under a wide
/// pixel filter, makes it too small.
pub fn variance_from_image(mean: &Image) -> Option<Image> {
    let extent = mean.extent;
    if extent.width.min(extent.height) < LEAST_SIDE {
        return None;
    }
    let estimate = |plane: &Vec<f32>| {
        let residuals = Residuals::new(plane, extent, 1);
        (0..extent.height as usize).into_par_iter().flat_map_iter(|y| residuals.variances_of_row(y)).collect()
    };
    Some(Image { extent, planes: mean.planes.iter().map(estimate).collect() })
}

/// Replaces unknown values of a variance of the mean by [`variance_from_image`], for renderers that write 0 or another
/// mark where they do not know the variance. Returns the number of values replaced: 0 where the image is too small for
/// an estimate or has another shape than the variance.
///
/// `is_unknown` decides from a value of the variance whether it is unknown. Replaced values are finite and at least 0.
pub fn fill_unknown_variance(variance: &mut Image, mean: &Image, is_unknown: impl Fn(f32) -> bool) -> usize {
    let has_shape_of_mean = variance.extent == mean.extent
        && variance.channels() == mean.channels()
        && variance.planes.iter().zip(&mean.planes).all(|(variance, mean)| variance.len() == mean.len());
    if !has_shape_of_mean || !variance.planes.iter().flatten().any(|value| is_unknown(*value)) {
        return 0;
    }
    let Some(estimate) = variance_from_image(mean) else { return 0 };
    let mut replaced = 0;
    for (variance, estimate) in variance.planes.iter_mut().zip(&estimate.planes) {
        for (value, estimate) in variance.iter_mut().zip(estimate).filter(|(value, _)| is_unknown(**value)) {
            *value = *estimate;
            replaced += 1;
        }
    }
    replaced
}

/// Residuals of one plane: differences of pixels from the average of two neighbours.
pub(super) struct Residuals<'a> {
    plane: &'a [f32],
    width: usize,
    height: usize,
    /// Distance of the neighbours in pixels.
    step: usize,
}

impl<'a> Residuals<'a> {
    /// `step` is the distance of the two neighbours in pixels; the plane must be larger than that in both directions.
    pub(super) fn new(plane: &'a [f32], extent: Extent, step: usize) -> Self {
        Self { plane, width: extent.width as usize, height: extent.height as usize, step }
    }

    /// Returns the estimated variances of the pixels of a row.
    pub(super) fn variances_of_row(&self, y: usize) -> Vec<f32> {
        let rows: Vec<Vec<f64>> = around(y, WINDOW_RADIUS, self.height).map(|row| self.squares_of_row(row)).collect();
        let mut columns = vec![(0.0, 0u32); self.width];
        for row in &rows {
            for ((sum, count), square) in columns.iter_mut().zip(row).filter(|(_, square)| square.is_finite()) {
                *sum += square;
                *count += 1;
            }
        }
        let average = |x: usize| {
            let (sum, count) = columns[around(x, WINDOW_RADIUS, self.width)]
                .iter()
                .fold((0.0, 0), |(sum, count), (s, c)| (sum + s, count + c));
            if count == 0 { 0.0 } else { (sum / f64::from(count)).min(f32::MAX.into()) as f32 }
        };
        (0..self.width).map(average).collect()
    }

    /// Returns the smaller squared residual of each pixel of a row, scaled to the variance of one pixel. Not finite
    /// where one of the values is not.
    pub(super) fn squares_of_row(&self, y: usize) -> Vec<f64> {
        let at = |x: usize, y: usize| f64::from(self.plane[y * self.width + x]);
        let [above, below] = self.beside(y, self.height);
        let square = |x: usize| {
            let [left, right] = self.beside(x, self.width);
            let across = square_of_residual(at(x, y), [at(left, y), at(right, y)], left == right);
            let down = square_of_residual(at(x, y), [at(x, above), at(x, below)], above == below);
            // The sum is not finite if one of both is not.
            if (across + down).is_finite() { across.min(down) / SMALLER_SQUARE } else { f64::NAN }
        };
        (0..self.width).map(square).collect()
    }

    /// Returns the two neighbours along an axis; at the border, one pixel stands for both.
    fn beside(&self, at: usize, count: usize) -> [usize; 2] {
        let (before, after) = (at.checked_sub(self.step), Some(at + self.step).filter(|after| *after < count));
        let only = before.or(after).unwrap_or(at);
        [before.unwrap_or(only), after.unwrap_or(only)]
    }
}

/// Returns the squared residual in units of the variance of one pixel.
fn square_of_residual(value: f64, [before, after]: [f64; 2], one_neighbour: bool) -> f64 {
    let variance = if one_neighbour { 2.0 } else { 1.5 };
    (value - (before + after) / 2.0).powi(2) / variance
}

/// Returns the indices within a distance, from 0 to `count` − 1.
pub(super) fn around(at: usize, distance: usize, count: usize) -> std::ops::Range<usize> {
    at.saturating_sub(distance)..(at + distance + 1).min(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gaussian noise of variance 1 (the sum of twelve uniform values, less 6).
    fn noise(count: usize) -> Vec<f64> {
        let mut state = 0x9e37_79b9_7f4a_7c15u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f64 / (1u64 << 24) as f64
        };
        (0..count).map(|_| (0..12).map(|_| uniform()).sum::<f64>() - 6.0).collect()
    }

    fn single(extent: Extent, values: impl Fn(usize) -> f64) -> Image {
        Image { extent, planes: vec![(0..extent.pixels()).map(|pixel| values(pixel) as f32).collect()] }
    }

    fn estimate(mean: &Image) -> Image {
        variance_from_image(mean).unwrap_or_else(|| panic!("there is no estimate"))
    }

    #[test]
    fn noise_on_a_ramp_has_its_variance_and_the_ramp_has_none() {
        let extent = Extent { width: 200, height: 150 };
        let noise = noise(extent.pixels());
        let ramp = |pixel: usize| (pixel % 200) as f64 + 2.0 * (pixel / 200) as f64;
        let noisy = estimate(&single(extent, |pixel| 100.0 + 0.25 * ramp(pixel) + 3.0 * noise[pixel]));
        let average = noisy.planes[0].iter().map(|value| f64::from(*value)).sum::<f64>() / extent.pixels() as f64;
        assert!((average / 9.0 - 1.0).abs() < 0.05, "{average}");
        let clean = estimate(&single(extent, ramp));
        assert_eq!(clean.planes[0][75 * 200 + 100], 0.0);
    }

    #[test]
    fn a_single_pixel_counts_once() {
        // Beside the pixel, one of both axes does not meet it.
        let inside = estimate(&single(Extent { width: 9, height: 9 }, |pixel| f64::from(pixel == 40)));
        let expected = 1.0 / 1.5 / SMALLER_SQUARE / 25.0;
        for (pixel, value) in inside.planes[0].iter().enumerate() {
            let is_near = (pixel % 9).abs_diff(4) <= 2 && (pixel / 9).abs_diff(4) <= 2;
            let expected = if is_near { expected } else { 0.0 };
            assert!((f64::from(*value) - expected).abs() < 1e-6, "{pixel}: {value}, not {expected}");
        }
        // In a corner one neighbour stands for both, and the window has 3×3 pixels.
        let corner = estimate(&single(Extent { width: 5, height: 5 }, |pixel| f64::from(pixel == 0)));
        assert!((f64::from(corner.planes[0][0]) - 0.5 / SMALLER_SQUARE / 9.0).abs() < 1e-6);
    }

    #[test]
    fn damaged_values_are_left_out() {
        let extent = Extent { width: 40, height: 30 };
        let noise = noise(extent.pixels());
        let damaged = |pixel: usize| match pixel % 97 {
            0 => f64::NAN,
            1 => f64::INFINITY,
            _ => noise[pixel],
        };
        let values = &estimate(&single(extent, damaged)).planes[0];
        assert!(values.iter().all(|value| *value > 0.0 && *value < 10.0));
        assert_eq!(estimate(&Image::filled(extent, 2, f32::NAN)), Image::filled(extent, 2, 0.0));
        let largest = estimate(&single(extent, |pixel| if pixel % 7 == 0 { f64::from(f32::MAX) } else { 0.0 }));
        assert!(largest.planes[0].iter().all(|value| value.is_finite()));
    }

    #[test]
    fn small_images_tell_nothing() {
        for (width, height) in [(0, 0), (1, 1), (1, 50), (50, 1), (2, 50), (50, 2)] {
            assert_eq!(variance_from_image(&Image::filled(Extent { width, height }, 3, 1.0)), None);
        }
        let extent = Extent { width: 3, height: 3 };
        assert_eq!(estimate(&Image::filled(extent, 3, 1.0)), Image::filled(extent, 3, 0.0));
    }

    #[test]
    fn unknown_variances_are_filled_and_known_ones_stay() {
        let extent = Extent { width: 20, height: 16 };
        let noise = noise(extent.pixels());
        let mean = single(extent, |pixel| 5.0 + noise[pixel]);
        let given = single(extent, |pixel| if pixel % 3 == 0 { 0.0 } else { 1.5 });
        let mut variance = given.clone();
        let replaced = fill_unknown_variance(&mut variance, &mean, |value| value == 0.0);
        assert_eq!(replaced, extent.pixels().div_ceil(3));
        let estimate = estimate(&mean);
        for (pixel, value) in variance.planes[0].iter().enumerate() {
            assert_eq!(*value, if pixel % 3 == 0 { estimate.planes[0][pixel] } else { 1.5 });
        }

        let mut marked = single(extent, |pixel| if pixel == 7 { f64::NAN } else { 1.5 });
        assert_eq!(fill_unknown_variance(&mut marked, &mean, f32::is_nan), 1);
        assert!(marked.planes[0][7] > 0.0);
    }

    #[test]
    fn nothing_is_filled_without_an_estimate() {
        let row = Extent { width: 9, height: 1 };
        let mut variance = Image::filled(row, 3, 0.0);
        assert_eq!(fill_unknown_variance(&mut variance, &Image::filled(row, 3, 1.0), |value| value == 0.0), 0);
        // Another shape than the mean.
        let (grey, color) = (Image::filled(Extent { width: 9, height: 9 }, 1, 0.0), Image::filled(row, 3, 1.0));
        assert_eq!(fill_unknown_variance(&mut grey.clone(), &color, |value| value == 0.0), 0);
    }
}
