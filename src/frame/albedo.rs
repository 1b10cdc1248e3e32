//! Albedo beyond 1: some renderers write lamps and reflected suns of up to several hundred into their albedo layers.

use super::Signal;

/// Least value of a half that counts as beyond 1: mean and halves of a white surface are rounded, at worst to half
/// floats.
const LARGEST_HALF: f64 = 1.001;

/// Clamps an albedo to 1 in every channel and returns a remark where that changed something.
///
/// The half spread becomes the spread of the clamped halves, and the variance that of the clamped mean. A value and its
/// noise stay the same to the bit unless the value or one of its halves is beyond 1; without halves, unless the value
/// or the value one deviation above it is.
pub(super) fn clamp_to_one(name: &str, signal: &mut Signal) -> Option<String> {
    let Signal { mean, half_spread, variance_of_mean } = signal;
    let (mut beyond, mut noise_beyond, mut largest) = (0usize, 0usize, 1.0f32);
    for (channel, means) in mean.planes.iter_mut().enumerate() {
        let mut spreads = half_spread.as_mut().map(|image| &mut image.planes[channel]);
        let mut variances = variance_of_mean.as_mut().map(|image| &mut image.planes[channel]);
        for (pixel, mean) in means.iter_mut().enumerate() {
            let value = f64::from(*mean);
            let spread = spreads.as_deref_mut().map(|plane| &mut plane[pixel]);
            let variance = variances.as_deref_mut().map(|plane| &mut plane[pixel]);
            let deviation = variance.as_deref().map_or(0.0, |variance| f64::from(*variance).sqrt());
            let above = spread.as_deref().map_or(deviation, |spread| f64::from(*spread).abs());
            if value > 1.0 {
                beyond += 1;
                largest = largest.max(*mean);
                *mean = 1.0;
            } else if value + above > LARGEST_HALF {
                noise_beyond += 1;
            } else {
                continue;
            }
            let clamped = |deviation: f64| ((value + deviation).min(1.0) - (value - deviation).min(1.0)) / 2.0;
            if let Some(spread) = spread {
                *spread = clamped(f64::from(*spread)) as f32;
            }
            if let Some(variance) = variance {
                *variance = clamped(deviation).powi(2) as f32;
            }
        }
    }
    let means = format!(
        "{beyond} values are beyond 1, up to {largest}, as of lamps and reflected suns, and are taken as 1, with their \
         noise"
    );
    let noise = format!(
        "{noise_beyond} values are within 1, but a half or the deviation is not: their noise is that of the clamped \
         values"
    );
    match (beyond, noise_beyond) {
        (0, 0) => None,
        (_, 0) => Some(format!("feature {name}: {means}")),
        (0, _) => Some(format!("feature {name}: {noise}")),
        _ => Some(format!("feature {name}: {means}; {noise}")),
    }
}
