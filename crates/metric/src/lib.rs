//! Errors of an image against a reference. All sums are in f64; a NaN anywhere makes the result NaN, except in FLIP,
//! which sees it as black.

use stein::Extent;
#[cfg(feature = "flip")]
use stein::error::RequestCause;
pub use stein::frame::RELATIVE_EPSILON;
use stein::{Error, Image, Result};

/// Returns the mean over pixels and channels of (x − ref)²/(ref² + 0.01) (thesis 6.5). 0 is perfect.
///
/// # Errors
/// [`Error::Request`] for images of different extent or channel count, or without pixels.
pub fn relative_mse(image: &Image, reference: &Image) -> Result<f64> {
    mean_over_values(image, reference, |x, reference| (x - reference).powi(2) / (reference.powi(2) + RELATIVE_EPSILON))
}

/// Returns the mean over pixels and channels of (x − ref)². 0 is perfect.
///
/// # Errors
/// [`Error::Request`] for images of different extent or channel count, or without pixels.
pub fn mse(image: &Image, reference: &Image) -> Result<f64> {
    mean_over_values(image, reference, |x, reference| (x - reference).powi(2))
}

/// Returns the flicker of two consecutive frames, the mean squared change of their errors over pixels and channels:
///
/// ((x_t − ref_t) − (x_{t−1} − ref_{t−1}))² / ((ref_t² + ref_{t−1}²)/2 + 0.01)
///
/// for `images` x_{t−1}, x_t and `references` ref_{t−1}, ref_t. The result is 0 if the error does not change, however
/// large it is. For errors that are independent from frame to frame, the result is about the sum of both frames'
/// [`relative_mse`]. The divisor contains both frames: where a bright object enters or leaves a pixel, an error
/// relative to the dark frame alone would outweigh the rest of the picture. For a shot, take the mean over all pairs of
/// consecutive frames.
///
/// # Errors
/// [`Error::Request`] for images of different extent or channel count, or without pixels.
pub fn flicker(images: [&Image; 2], references: [&Image; 2]) -> Result<f64> {
    let ([before, image], [reference_before, reference]) = (images, references);
    check(before, reference_before)?;
    check(image, reference)?;
    check(before, image)?;
    let mut sum = 0.0;
    for channel in 0..image.channels() {
        let [before, image, reference_before, reference] = [before, image, reference_before, reference]
            .map(|image| image.planes[channel].iter().map(|&x| f64::from(x)));
        for ((x, reference), (x_before, reference_before)) in image.zip(reference).zip(before.zip(reference_before)) {
            sum += ((x - reference) - (x_before - reference_before)).powi(2)
                / ((reference.powi(2) + reference_before.powi(2)) / 2.0 + RELATIVE_EPSILON);
        }
    }
    Ok(sum / (image.extent.pixels() * image.channels()) as f64)
}

/// Returns the mean structural similarity of the images as displayed; 1 is perfect, and values near 0 or below share no
/// structure.
///
/// Both images are clamped to [0, 1], raised to 1/2.2 and averaged over their channels. Then, with means μ, variances
/// σ² and covariance σ_xy under a Gaussian window of 11×11 pixels and standard deviation 1.5, cut off and normalised
/// anew at the image border,
///
/// SSIM = (2 μ_x μ_y + C₁)(2 σ_xy + C₂) / ((μ_x² + μ_y² + C₁)(σ_x² + σ_y² + C₂)), C₁ = 0.01², C₂ = 0.03²,
///
/// averaged over all pixels.
///
/// # Errors
/// [`Error::Request`] for images of different extent or channel count, or without pixels.
pub fn ssim(image: &Image, reference: &Image) -> Result<f64> {
    check(image, reference)?;
    let (x, y) = (display_values(image), display_values(reference));
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>();
    let width = image.extent.width as usize;
    let blur = |plane: &[f64]| gaussian_window(plane, width);
    let (mean_x, mean_y) = (blur(&x), blur(&y));
    let (square_x, square_y, cross) = (blur(&product(&x, &x)), blur(&product(&y, &y)), blur(&product(&x, &y)));
    let (c1, c2) = (0.01_f64.powi(2), 0.03_f64.powi(2));
    let mut sum = 0.0;
    for pixel in 0..x.len() {
        let (mx, my) = (mean_x[pixel], mean_y[pixel]);
        let variance_x = square_x[pixel] - mx * mx;
        let variance_y = square_y[pixel] - my * my;
        let covariance = cross[pixel] - mx * my;
        sum += (2.0 * mx * my + c1) * (2.0 * covariance + c2)
            / ((mx * mx + my * my + c1) * (variance_x + variance_y + c2));
    }
    Ok(sum / x.len() as f64)
}

/// Returns FLIP, the size of the differences that a person sees when flipping between the two images, from 0 (none) to
/// nearly 1 (black against white). FLIP is the mean over the pixels of LDR-FLIP (Andersson and others 2020), at 67
/// pixels per degree of visual angle: a display 3840 pixels and 0.7 m wide, seen from 0.7 m. The images are compared as
/// [`display_bytes`] shows them, so that differences between values above 1 do not count.
///
/// # Errors
/// [`Error::Request`] for images of different extent or channel count, without pixels, or with other than one or three
/// channels.
#[cfg(feature = "flip")]
pub fn flip(image: &Image, reference: &Image) -> Result<f64> {
    check(image, reference)?;
    let Extent { width, height } = image.extent;
    let shown = |image| Ok::<_, Error>(nv_flip::FlipImageRgb8::with_data(width, height, &display_bytes(image)?));
    let map = nv_flip::flip(shown(reference)?, shown(image)?, nv_flip::DEFAULT_PIXELS_PER_DEGREE).to_vec();
    Ok(map.iter().map(|&value| f64::from(value)).sum::<f64>() / map.len() as f64)
}

/// Returns the mean of a plane's values.
pub fn mean(plane: &[f32]) -> f64 {
    plane.iter().map(|&value| f64::from(value)).sum::<f64>() / plane.len() as f64
}

/// Converts scene-linear values to the bytes of a display: clamped to [0, 1], with the transfer curve of sRGB, 8 bits
/// for each of R, G and B, row by row. There is no exposure and no other curve, so that pictures and their figures can
/// be compared. A single channel is shown in grey; NaN is black.
///
/// # Errors
/// [`Error::Request`] for other than one or three channels.
pub fn display_bytes(image: &Image) -> Result<Vec<u8>> {
    let [r, g, b] = match image.planes.as_slice() {
        [grey] => [grey; 3],
        [r, g, b] => [r, g, b],
        planes => {
            return Err(Error::Request(RequestCause::Other {
                problem: format!("an image of {} channels cannot be shown", planes.len()),
                remedy: "give one channel, or red, green and blue".into(),
            }));
        }
    };
    let byte = |linear: f32| {
        let linear = linear.clamp(0.0, 1.0);
        let encoded = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
        (255.0 * encoded).round() as u8
    };
    Ok(r.iter().zip(g).zip(b).flat_map(|((&r, &g), &b)| [byte(r), byte(g), byte(b)]).collect())
}

fn check(image: &Image, reference: &Image) -> Result<()> {
    if image.extent == reference.extent
        && image.channels() == reference.channels()
        && image.extent.pixels() > 0
        && image.channels() > 0
    {
        return Ok(());
    }
    Err(Error::Request(RequestCause::Other {
        problem: format!(
            "an image of {} with {} channels cannot be compared to a reference of {} with {} channels",
            image.extent,
            image.channels(),
            reference.extent,
            reference.channels()
        ),
        remedy: "compare images of the same size and channels, with at least one pixel".into(),
    }))
}

fn mean_over_values(image: &Image, reference: &Image, error: impl Fn(f64, f64) -> f64) -> Result<f64> {
    check(image, reference)?;
    let mut sum = 0.0;
    for (plane, reference) in image.planes.iter().zip(&reference.planes) {
        sum += plane.iter().zip(reference).map(|(&x, &reference)| error(x.into(), reference.into())).sum::<f64>();
    }
    Ok(sum / (image.extent.pixels() * image.channels()) as f64)
}

fn display_values(image: &Image) -> Vec<f64> {
    let weight = 1.0 / image.channels() as f64;
    let mut values = vec![0.0; image.extent.pixels()];
    for plane in &image.planes {
        for (value, &linear) in values.iter_mut().zip(plane) {
            *value += weight * f64::from(linear).clamp(0.0, 1.0).powf(1.0 / 2.2);
        }
    }
    values
}

/// Returns the weighted means under the window of [`ssim`], rows first, then columns.
fn gaussian_window(plane: &[f64], width: usize) -> Vec<f64> {
    let height = plane.len() / width;
    let weights: [f64; 6] = std::array::from_fn(|offset| (-(offset as f64).powi(2) / (2.0 * 1.5 * 1.5)).exp());
    let along = |source: &[f64], stride: usize, length: usize, position: usize, pixel: usize| {
        let (mut sum, mut total) = (0.0, 0.0);
        for other in position.saturating_sub(5)..(position + 6).min(length) {
            let weight = weights[other.abs_diff(position)];
            sum += weight * source[pixel + other * stride - position * stride];
            total += weight;
        }
        sum / total
    };
    let rows: Vec<f64> = (0..plane.len()).map(|pixel| along(plane, 1, width, pixel % width, pixel)).collect();
    (0..plane.len()).map(|pixel| along(&rows, width, height, pixel / width, pixel)).collect()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod tests {
    use super::*;

    fn image(width: u32, height: u32, planes: Vec<Vec<f32>>) -> Image {
        Image { extent: Extent { width, height }, planes }
    }

    #[test]
    fn relative_mse_weighs_dark_pixels_more() {
        // (0.5 − 0)²/(0 + 0.01) = 25; (3 − 2)²/(4 + 0.01) = 1/4.01
        let error = relative_mse(&image(2, 1, vec![vec![0.5, 3.0]]), &image(2, 1, vec![vec![0.0, 2.0]])).unwrap();
        assert!((error - (25.0 + 1.0 / 4.01) / 2.0).abs() < 1e-12, "{error}");
    }

    #[test]
    fn mse_is_the_mean_over_pixels_and_channels() {
        let error = mse(
            &image(2, 1, vec![vec![1.0, 0.0], vec![0.0, 3.0]]),
            &Image::filled(Extent { width: 2, height: 1 }, 2, 0.0),
        )
        .unwrap();
        assert!((error - 10.0 / 4.0).abs() < 1e-12, "{error}");
    }

    #[test]
    fn flicker_is_the_change_of_the_error() {
        let row = |values: &[f32]| image(2, 1, vec![values.to_vec()]);
        let (references, images) = ([row(&[1.0, 0.0]), row(&[2.0, 0.5])], [row(&[1.5, 0.0]), row(&[1.0, 0.75])]);
        // Errors 0.5, 0 and then −1, 0.25: (−1.5)²/((4 + 1)/2 + 0.01) and 0.25²/(0.25/2 + 0.01).
        let found = flicker([&images[0], &images[1]], [&references[0], &references[1]]).unwrap();
        let expected = (2.25 / 2.51 + 0.0625 / 0.135) / 2.0;
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");

        // A constant error does not flicker, however the picture moves.
        let shifted = [row(&[1.5, 0.5]), row(&[2.5, 1.0])];
        assert_eq!(flicker([&shifted[0], &shifted[1]], [&references[0], &references[1]]).unwrap(), 0.0);
    }

    #[test]
    fn flicker_averages_over_channels() {
        let flat = |values: [f32; 2]| image(1, 1, values.map(|value| vec![value]).to_vec());
        let (black, changed) = (flat([0.0, 0.0]), flat([0.1, 0.3]));
        // 0.1²/0.01 and 0.3²/0.01, of f32s.
        let found = flicker([&black, &changed], [&black, &black]).unwrap();
        assert!((found - 5.0).abs() < 1e-6, "{found}");
    }

    #[test]
    fn ssim_of_two_flat_images_is_its_luminance_term() {
        let extent = Extent { width: 20, height: 13 };
        // 0.5^(1/2.2) and 1: no structure, so SSIM = (2ab + C1)/(a² + b² + C1).
        let (a, b) = (0.5_f64.powf(1.0 / 2.2), 1.0);
        let expected = (2.0 * a * b + 1e-4) / (a * a + b * b + 1e-4);
        let found = ssim(&Image::filled(extent, 3, 0.5), &Image::filled(extent, 3, 7.0)).unwrap();
        assert!((found - expected).abs() < 1e-9, "{found} {expected}");
    }

    #[test]
    fn ssim_of_an_image_with_itself_is_one_and_of_its_negative_is_below_zero() {
        let pattern: Vec<f32> = (0..400).map(|i| f32::from((i % 20 / 2 + i / 40) % 2 == 0)).collect();
        let negative = pattern.iter().map(|value| 1.0 - value).collect();
        let (pattern, negative) = (image(20, 20, vec![pattern]), image(20, 20, vec![negative]));
        assert!((ssim(&pattern, &pattern).unwrap() - 1.0).abs() < 1e-12);
        assert!(ssim(&pattern, &negative).unwrap() < -0.5);
    }

    #[test]
    fn a_display_shows_srgb_from_black_to_white() {
        // 0.5 is shown as 188, 0.002 on the linear foot of the curve as 12.92 · 0.002 · 255 = 6.6.
        let shown = display_bytes(&image(3, 2, vec![vec![-1.0, 0.0, 0.002, 0.5, 1.0, 9.0]])).unwrap();
        assert_eq!(shown.iter().step_by(3).copied().collect::<Vec<_>>(), [0, 0, 7, 188, 255, 255]);
        let shown = display_bytes(&image(1, 1, vec![vec![1.0], vec![0.5], vec![f32::NAN]])).unwrap();
        assert_eq!(shown, [255, 188, 0]);
        assert!(display_bytes(&image(1, 1, vec![vec![1.0], vec![0.5]])).is_err());
    }

    /// FLIP of two flat greys of linear values a and b, by the formulas of the paper: filters do not change flat images
    /// and find neither edges nor points in them, so only the difference in lightness is left, to the power 0.7, mapped
    /// to [0, 1] so that 0.4 of the greatest difference (that of green and blue) is at 0.95.
    fn flip_of_greys(a: f64, b: f64) -> f64 {
        let f = |t: f64| {
            if t > (6.0_f64 / 29.0).powi(3) { t.cbrt() } else { t / (3.0 * (6.0_f64 / 29.0).powi(2)) + 4.0 / 29.0 }
        };
        // Hunt-adjusted L*a*b* of a primary: its column of the sRGB matrix, against the white.
        let hunt = |[x, y, z]: [f64; 3]| {
            let [x, y, z] = [f(x / 0.950_428_545), f(y), f(z / 1.088_900_371)];
            let lightness = 116.0 * y - 16.0;
            [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
        };
        let green = hunt([0.357_584, 0.715_169, 0.119_195]);
        let blue = hunt([0.180_437, 0.072_175, 0.950_304]);
        let greatest = ((green[0] - blue[0]).abs() + (green[1] - blue[1]).hypot(green[2] - blue[2])).powf(0.7);
        let difference = (116.0 * (f(a) - f(b)).abs()).powf(0.7);
        let knee = 0.4 * greatest;
        if difference < knee { 0.95 * difference / knee } else { 0.95 + (difference - knee) / (greatest - knee) * 0.05 }
    }

    #[test]
    fn flip_of_flat_greys_is_what_the_paper_makes_of_their_lightness() {
        let flat = |byte: u8| {
            let encoded = f64::from(byte) / 255.0;
            let linear = if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) };
            (linear, Image::filled(Extent { width: 33, height: 21 }, 3, linear as f32))
        };
        for (a, b) in [(0, 255), (100, 110), (188, 60), (7, 7)] {
            let ((a, image), (b, reference)) = (flat(a), flat(b));
            let (found, expected) = (flip(&image, &reference).unwrap(), flip_of_greys(a, b));
            assert!((found - expected).abs() < 2e-4, "{a} {b}: {found} {expected}");
        }
        let (black, white) = (flat(0).1, flat(255).1);
        assert!((0.95..1.0).contains(&flip(&black, &white).unwrap()));
    }

    #[test]
    fn flip_sees_noise_and_nothing_where_there_is_nothing() {
        let pattern = |contrast: f32| {
            image(40, 30, vec![(0..1200).map(|i| 0.5 + contrast * ((i * 7919 % 13) as f32 / 13.0 - 0.5)).collect(); 3])
        };
        let (clean, little, much) = (pattern(0.0), pattern(0.1), pattern(0.8));
        assert_eq!(flip(&much, &much).unwrap(), 0.0);
        let (little, much) = (flip(&little, &clean).unwrap(), flip(&much, &clean).unwrap());
        assert!(0.0 < little && little < much && much < 1.0, "{little} {much}");
        assert!(flip(&clean, &Image::filled(Extent { width: 30, height: 40 }, 3, 0.0)).is_err());
    }

    #[test]
    fn images_of_different_size_are_not_compared() {
        let (a, b) = (image(1, 2, vec![vec![0.0; 2]]), image(2, 1, vec![vec![0.0; 2]]));
        assert!(mse(&a, &b).is_err() && relative_mse(&a, &b).is_err() && ssim(&a, &b).is_err());
        assert!(
            flicker([&a, &b], [&a, &b]).is_err()
                && flicker([&a, &a], [&b, &a]).is_err()
                && flicker([&a, &a], [&a, &b]).is_err()
        );
    }
}
