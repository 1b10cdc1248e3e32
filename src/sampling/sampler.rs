//! The interface between the sampling loop and a renderer.

use std::ops::ControlFlow;

use super::Samples;
use crate::error::{Error, RequestCause, Result};
use crate::image::Extent;

/// Callback with the share of the work that is done, 0 to 1. Any thread may call it; `Break` ends the work with
/// [`Error::Cancelled`].
pub type Progress<'a> = Option<&'a mut (dyn FnMut(f32) -> ControlFlow<()> + Send)>;

/// A renderer that draws given numbers of samples in each pixel.
pub trait Sampler {
    /// Returns width and height of the image.
    fn extent(&self) -> Extent;

    /// Draws this many new samples in each pixel, half of them for each half buffer, and returns the statistics of
    /// these samples alone.
    ///
    /// New means independent of all samples drawn before (or, for low-discrepancy sampling, the continuation of the
    /// pixel's sequence).
    ///
    /// # Errors
    /// [`Error::Request`] for counts of another extent than the sampler's; [`Error::Renderer`] if a renderer from
    /// outside fails; [`Error::Cancelled`], after which the sampler is in the state before the call.
    fn sample(&mut self, counts: &SampleCounts, progress: Progress<'_>) -> Result<Samples>;
}

/// Number of samples that each pixel gets in one pass: whole pairs, one sample of each pair for either half buffer, so
/// that the halves always have equal numbers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SampleCounts {
    extent: Extent,
    pairs: Vec<u32>,
}

impl SampleCounts {
    /// Makes counts of `pairs[y * width + x]` pairs of samples; 0 leaves a pixel as it is.
    ///
    /// # Errors
    /// [`Error::Request`] if there is not one number for each pixel.
    pub fn from_pairs(extent: Extent, pairs: Vec<u32>) -> Result<Self> {
        if pairs.len() != extent.pixels() {
            return Err(Error::Request(RequestCause::CountsLength { counts: pairs.len(), extent }));
        }
        Ok(Self { extent, pairs })
    }

    /// Makes counts of `samples[y * width + x]` samples, each number even.
    ///
    /// # Errors
    /// [`Error::Request`] if there is not one number for each pixel, or for an odd number.
    pub fn from_samples(extent: Extent, samples: &[u32]) -> Result<Self> {
        if let Some(pixel) = samples.iter().position(|count| count % 2 != 0) {
            return Err(Error::Request(RequestCause::OddCount { samples: samples[pixel], pixel }));
        }
        Self::from_pairs(extent, samples.iter().map(|count| count / 2).collect())
    }

    /// Makes counts of one even number of samples for all pixels.
    ///
    /// # Errors
    /// [`Error::Request`] for an odd number.
    pub fn uniform(extent: Extent, samples: u32) -> Result<Self> {
        Self::from_samples(extent, &vec![samples; extent.pixels()])
    }

    /// Returns width and height of the image.
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// Returns the pairs of samples, row by row from the top.
    pub fn pairs(&self) -> &[u32] {
        &self.pairs
    }

    /// Returns the number of samples in the whole image.
    pub fn total_samples(&self) -> u64 {
        self.pairs.iter().map(|&pairs| 2 * u64::from(pairs)).sum()
    }
}
