//! The two sources from which a signal's noise is known, its halves and its variance: which of them can be used, and
//! whether they agree.

use glam::IVec2;

use super::Signal;
use super::repairs::Layer;
use super::sanitise::{LARGEST, LARGEST_VARIANCE, is_damaged};
use crate::image::Image;
use crate::stage::variance::INPUT_SMOOTHING;

/// Largest squared half spread that counts as round-off, as a share of the squared mean.
const ROUND_OFF_OF_SPREAD: f64 = 1e-12;
/// Largest variance that counts as round-off, as a share of the squared mean: renderers compute it as the difference of
/// two squares.
const ROUND_OFF_OF_VARIANCE: f64 = 1e-7;
/// Dark pixels have round-off of their own: the limits are at least this share of the squared mean of the layer.
const DARK: f64 = 1e-4;
/// Least share of the pixels to which a variance gives noise for it to be trusted more than identical halves.
const CLAIMED: f64 = 0.001;
/// Side of the boxes in which both sources are compared, in pixels.
const BOX: usize = 16;
/// Least number of pixels with a variance in such a box.
const LEAST_IN_BOX: usize = 64;
/// Factor between both sources from which on a remark is made.
const CONTRADICTION: f64 = 4.0;
/// The same factor where the variance of a feature is too large: low-discrepancy samples hit features that much more
/// evenly.
const FEATURE_OVERSTATED: f64 = 100.0;

/// Leaves out halves and variance whose shape differs from the mean, or that have no usable value.
///
/// Where there are halves, a single unusable channel of the variance becomes 0, and [`settle`] fills it.
pub(super) fn leave_out_unusable(layer: Layer, signal: &mut Signal, notes: &mut Vec<String>) {
    let channels = signal.mean.channels();
    for (part, image) in [("halves", &mut signal.half_spread), ("variance", &mut signal.variance_of_mean)] {
        if let Some(other) = image.as_ref().map(Image::channels).filter(|other| *other != channels) {
            notes.push(format!("{layer}: {part} of {other} channels do not fit a mean of {channels} and are left out"));
            *image = None;
        }
    }
    let lacks = |mean: &Image, image: &Image, largest: f32| -> Vec<usize> {
        let has_value = |plane: &[f32], largest: f32| plane.iter().any(|value| !is_damaged(*value, largest));
        (0..channels)
            .filter(|&channel| has_value(&mean.planes[channel], LARGEST) && !has_value(&image.planes[channel], largest))
            .collect()
    };
    if let Some(spread) = &signal.half_spread {
        let lacking = lacks(&signal.mean, spread, LARGEST);
        if !lacking.is_empty() {
            notes.push(format!(
                "{layer}: the halves have no usable value{} and are left out",
                layer.in_channels(&lacking, channels)
            ));
            signal.half_spread = None;
        }
    }
    if let Some(variance) = &mut signal.variance_of_mean {
        let lacking = lacks(&signal.mean, variance, LARGEST_VARIANCE);
        if lacking.len() == channels || !lacking.is_empty() && signal.half_spread.is_none() {
            notes.push(format!(
                "{layer}: the variance has no usable value{} and is left out",
                layer.in_channels(&lacking, channels)
            ));
            signal.variance_of_mean = None;
        } else if !lacking.is_empty() {
            notes.push(format!("{layer}: the variance has no usable value{}", layer.in_channels(&lacking, channels)));
            lacking.iter().for_each(|&channel| variance.planes[channel].fill(0.0));
        }
    }
}

/// Uses one source where the other is silent, which means 0 everywhere, and adds a remark where both contradict each
/// other. The signal is sanitised.
pub(super) fn settle(layer: Layer, signal: &mut Signal, notes: &mut Vec<String>) {
    let Signal { mean, half_spread, variance_of_mean } = signal;
    let (Some(spread), Some(variance)) = (&*half_spread, &mut *variance_of_mean) else { return };
    let channels = mean.channels();
    let is_silent = |image: &Image, channel: usize| image.planes[channel].iter().all(|value| *value == 0.0);
    let noise = Noise::new(mean);
    let only_halves: Vec<_> = (0..channels)
        .filter(|&channel| is_silent(variance, channel) && noise.in_spread(mean, &spread.planes[channel]))
        .collect();
    let only_variance: Vec<_> = (0..channels)
        .filter(|&channel| is_silent(spread, channel) && noise.in_variance(mean, &variance.planes[channel]))
        .collect();

    if !only_halves.is_empty() && (0..channels).all(|channel| is_silent(variance, channel)) {
        notes.push(format!("{layer}: the variance is 0 everywhere although the halves differ; it is left out"));
        *variance_of_mean = None;
        return;
    }
    if !only_halves.is_empty() {
        let place = layer.in_channels(&only_halves, channels);
        notes.push(format!(
            "{layer}: the variance is 0 everywhere{place} although the halves differ; theirs, smoothed, takes its place"
        ));
        only_halves.iter().for_each(|&channel| variance.planes[channel] = two_buffer_variance(spread, channel));
    }
    if !only_variance.is_empty() {
        let place = layer.in_channels(&only_variance, channels);
        notes.push(format!(
            "{layer}: the two halves are identical{place} (rendered with the same seed?) although the variance tells \
             of noise; they are left out"
        ));
        *half_spread = None;
        return;
    }
    if let Some(ratio) = spread_over_variance(mean, spread, variance, &noise, 1) {
        let overstated = if layer.is_color { CONTRADICTION } else { FEATURE_OVERSTATED };
        if ratio >= CONTRADICTION || ratio * overstated <= 1.0 {
            notes.push(format!(
                "{layer}: (A − B)²/4 of the halves is {} times the variance that is given, typically; the halves are \
                 believed",
                two_digits(ratio),
            ));
        }
    }
}

/// Returns whether neither halves nor variance of a signal show any noise.
pub(super) fn is_silent(signal: &Signal) -> bool {
    let images = [&signal.half_spread, &signal.variance_of_mean].into_iter().flatten();
    images.flat_map(|image| &image.planes).flatten().all(|value| *value == 0.0)
}

/// Limit between noise and round-off in a layer.
struct Noise {
    /// Squared mean magnitude of all values.
    level: f64,
}

impl Noise {
    fn new(mean: &Image) -> Self {
        let sum: f64 = mean.planes.iter().flatten().map(|value| f64::from(value.abs())).sum();
        Self { level: (sum / (mean.channels() * mean.extent.pixels()) as f64).powi(2) }
    }

    /// Returns the largest squared value that is round-off in a pixel.
    fn round_off(&self, mean: &Image, pixel: usize, share: f64) -> f64 {
        let square = mean.planes.iter().map(|plane| f64::from(plane[pixel]).powi(2)).fold(0.0, f64::max);
        share * square.max(DARK * self.level)
    }

    fn in_spread(&self, mean: &Image, spread: &[f32]) -> bool {
        spread
            .iter()
            .enumerate()
            .any(|(pixel, value)| f64::from(*value).powi(2) > self.round_off(mean, pixel, ROUND_OFF_OF_SPREAD))
    }

    fn in_variance(&self, mean: &Image, variance: &[f32]) -> bool {
        let noisy = variance
            .iter()
            .enumerate()
            .filter(|(pixel, value)| f64::from(**value) > self.round_off(mean, *pixel, ROUND_OFF_OF_VARIANCE));
        let least = (CLAIMED * variance.len() as f64).ceil() as usize;
        noisy.take(least).count() == least
    }
}

/// Returns the squared half spread of one channel, smoothed as the methods smooth it where there are halves alone.
fn two_buffer_variance(spread: &Image, channel: usize) -> Vec<f32> {
    let (width, height) = (spread.extent.width as usize, spread.extent.height as usize);
    let radius = INPUT_SMOOTHING.radius as usize;
    let weight = |distance: usize| f64::from(INPUT_SMOOTHING.weight(IVec2::new(distance as i32, 0)));
    let near = |at: usize, count: usize| at.saturating_sub(radius)..(at + radius + 1).min(count);
    let average = |at: usize, count: usize, value: &dyn Fn(usize) -> f64| {
        let (sum, weights) = near(at, count).fold((0.0, 0.0), |(sum, weights), other| {
            let weight = weight(other.abs_diff(at));
            (sum + weight * value(other), weights + weight)
        });
        (sum / weights) as f32
    };
    let plane = &spread.planes[channel];
    let across: Vec<f32> = (0..plane.len())
        .map(|pixel| average(pixel % width, width, &|x| f64::from(plane[pixel - pixel % width + x]).powi(2)))
        .collect();
    (0..plane.len())
        .map(|pixel| average(pixel / width, height, &|y| f64::from(across[y * width + pixel % width])))
        .collect()
}

/// Returns the median over boxes of the mean squared half spread divided by the mean variance: 1 if both agree. `None`
/// if no box has enough pixels with a variance. Looks at every n-th row of boxes.
pub(super) fn halves_over_variance(mean: &Image, spread: &Image, variance: &Image, every: usize) -> Option<f64> {
    spread_over_variance(mean, spread, variance, &Noise::new(mean), every)
}

/// Returns the median over boxes of the mean squared half spread divided by the mean variance: 1 if both agree. `None`
/// if no box has enough pixels with a variance.
///
/// In single pixels the ratio spreads like χ² with one degree of freedom, and the variance alone is too low where a
/// rare bright path was missed. Means over boxes have neither fault, and the median ignores the boxes with spikes.
fn spread_over_variance(mean: &Image, spread: &Image, variance: &Image, noise: &Noise, every: usize) -> Option<f64> {
    let width = spread.extent.width as usize;
    let mut ratios = Vec::new();
    for (spread, variance) in spread.planes.iter().zip(&variance.planes) {
        let rows = spread.chunks(width * BOX).zip(variance.chunks(width * BOX));
        for (first, (spread, variance)) in (0..).step_by(width * BOX).zip(rows).step_by(every) {
            let mut boxes = vec![(0.0, 0.0, 0usize); width.div_ceil(BOX)];
            for (at, (spread, variance)) in spread.iter().zip(variance).enumerate() {
                let (squares, variances, noisy) = &mut boxes[at % width / BOX];
                *squares += f64::from(*spread).powi(2);
                *variances += f64::from(*variance);
                *noisy += usize::from(f64::from(*variance) > noise.round_off(mean, first + at, ROUND_OFF_OF_VARIANCE));
            }
            let enough = boxes.into_iter().filter(|(_, _, noisy)| *noisy >= LEAST_IN_BOX);
            ratios.extend(enough.map(|(squares, variances, _)| squares / variances));
        }
    }
    let middle = ratios.len() / 2;
    (!ratios.is_empty()).then(|| *ratios.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Formats a number of 0 or more with two digits.
pub(super) fn two_digits(value: f64) -> String {
    let digits = (1.0 - value.max(1e-9).log10().floor()).clamp(0.0, 10.0) as usize;
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Extent;

    #[test]
    fn the_two_buffer_variance_is_a_gaussian_average_of_squares() {
        let extent = Extent { width: 9, height: 7 };
        let value = |pixel: usize| ((pixel * 37) % 11) as f32 - 5.0;
        let spread = Image { extent, planes: vec![(0..extent.pixels()).map(value).collect()] };
        let smoothed = two_buffer_variance(&spread, 0);
        for (pixel, smoothed) in smoothed.iter().enumerate() {
            let (mut sum, mut weights) = (0.0, 0.0);
            for other in 0..extent.pixels() {
                let offset =
                    IVec2::new((other % 9) as i32 - (pixel % 9) as i32, (other / 9) as i32 - (pixel / 9) as i32);
                let weight = f64::from(INPUT_SMOOTHING.weight(offset));
                sum += weight * f64::from(value(other)).powi(2);
                weights += weight;
            }
            assert!((f64::from(*smoothed) - sum / weights).abs() < 1e-5 * sum / weights, "{pixel}");
        }
    }

    #[test]
    fn numbers_are_told_with_two_digits() {
        for (value, text) in [(16.04, "16"), (4.2, "4.2"), (0.0612, "0.061"), (123.4, "123")] {
            assert_eq!(two_digits(value), text);
        }
    }
}
