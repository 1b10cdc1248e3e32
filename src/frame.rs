//! The frame: a buffer set whose meaning has been settled. Everything finite, one extent, variances of the pixel mean, halves as one spread, features in unit range.

use crate::image::{Extent, Image};

/// A noisy mean with what is known of its noise. All images have the same extent and number of channels.
#[derive(Clone, Debug)]
pub struct Signal {
    /// The mean of all samples of each pixel.
    pub mean: Image,
    /// `(A − B)·√(n_A·n_B)/n` of the two half-buffer means A and B: a signal with zero expectation, the variance of the mean's noise, and uncorrelated with it.
    /// With equal halves it is `(A − B)/2`, and the halves are `mean ± half_spread`. Its square is the two-buffer estimate of the variance of the mean
    /// (`algorithms.md`, shared ground 2). `None` without halves.
    pub half_spread: Option<Image>,
    /// Sample variance of the mean, s²/n. `None` where the renderer gave none.
    pub variance_of_mean: Option<Image>,
}

/// A feature buffer, brought to unit range by one affine map for all its channels.
#[derive(Clone, Debug)]
pub struct Feature {
    /// The layer's name, such as `albedo`.
    pub name: String,
    /// 1 to 3 channels in unit range; variances scaled with the square of the map's factor.
    pub signal: Signal,
    /// `value in the file = unit value · unit_scale + unit_offset`.
    pub unit_scale: f32,
    /// See `unit_scale`.
    pub unit_offset: f32,
}

/// Samples that each pixel's mean was computed from.
#[derive(Clone, Debug, PartialEq)]
pub enum SamplesPerPixel {
    /// Nothing in the file tells.
    Unknown,
    /// The same number everywhere.
    Uniform(f32),
    /// One number per pixel (one plane).
    PerPixel(Image),
}

/// What the denoisers work on. Only `Frame::from_buffer_set` and `Frame::new` make one, so a frame is always finite and consistent.
#[derive(Clone, Debug)]
pub struct Frame {
    extent: Extent,
    color: Signal,
    features: Vec<Feature>,
    samples_per_pixel: SamplesPerPixel,
}
