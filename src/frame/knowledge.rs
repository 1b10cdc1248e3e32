//! Sources from which the noise of a signal is known.

use std::fmt;

use serde::Serialize;

use super::{Feature, Frame, PayloadLayer, RELATIVE_EPSILON, Repairs, Signal};
use crate::error::{Error, RequestCause, Result};

/// The remark on a colour without halves and variance, see [`NoiseKnowledge::ImageOnly`].
pub const IMAGE_ONLY: &str = "colour: its noise is estimated from the image itself; two renders with different \
                                     seeds are better: give both";

/// Sources from which the noise of a signal is known. Displays as a phrase such as `two seeds`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum NoiseKnowledge {
    /// Halves and sample variance: everything works.
    HalvesAndVariance,
    /// Halves only: the variance is pooled from the halves of similar pixels.
    HalvesOnly,
    /// Sample variance only: it is taken as it is, and there is no second pass, which needs halves.
    VarianceOnly,
    /// Neither halves nor variance, for a colour: its noise is estimated from the image itself.
    ImageOnly,
}

impl NoiseKnowledge {
    /// Returns the knowledge for halves and variance that exist or not.
    pub(super) fn from_parts(has_halves: bool, has_variance: bool) -> Self {
        match (has_halves, has_variance) {
            (true, true) => Self::HalvesAndVariance,
            (true, false) => Self::HalvesOnly,
            (false, true) => Self::VarianceOnly,
            (false, false) => Self::ImageOnly,
        }
    }

    /// Returns whether there are halves.
    pub fn has_halves(self) -> bool {
        matches!(self, Self::HalvesAndVariance | Self::HalvesOnly)
    }

    /// Returns whether there is a sample variance.
    pub fn has_variance(self) -> bool {
        matches!(self, Self::HalvesAndVariance | Self::VarianceOnly)
    }
}

impl fmt::Display for NoiseKnowledge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::HalvesAndVariance => "variance and two seeds",
            Self::HalvesOnly => "two seeds",
            Self::VarianceOnly => "variance",
            Self::ImageOnly => "the image itself",
        })
    }
}

impl Signal {
    /// Returns the sources of the noise; `None` without any source: a feature then counts as free of noise.
    pub fn noise_knowledge(&self) -> Option<NoiseKnowledge> {
        Some(self.known_from()).filter(|knowledge| *knowledge != NoiseKnowledge::ImageOnly)
    }

    /// Returns the sources of the noise of a colour.
    pub(super) fn known_from(&self) -> NoiseKnowledge {
        NoiseKnowledge::from_parts(self.half_spread.is_some(), self.variance_of_mean.is_some())
    }
}

impl Frame {
    /// Returns the sources of the colour's noise.
    pub fn noise_knowledge(&self) -> NoiseKnowledge {
        self.color.known_from()
    }

    /// Refuses a frame whose colour has no known noise, for callers to whom an estimate from the image itself is not
    /// good enough. `repairs` belong to the frame: they say why given halves or a given variance are not used.
    ///
    /// # Errors
    /// [`Error::Request`] with the ways out, where the knowledge is [`NoiseKnowledge::ImageOnly`].
    pub fn require_noise(&self, repairs: &Repairs) -> Result<()> {
        if self.noise_knowledge() != NoiseKnowledge::ImageOnly {
            return Ok(());
        }
        let notes = repairs.notes.iter().filter(|note| *note != IMAGE_ONLY);
        let reasons = notes.filter_map(|note| note.strip_prefix("colour: ")).map(str::to_owned).collect();
        Err(Error::Request(RequestCause::UnknownNoise { reasons }))
    }

    /// Returns the frame with fewer sources of its noise, to measure what they are worth: halves and variances that
    /// `knowledge` does not name are removed from the colour and from all features. `None` where the colour lacks a
    /// source that `knowledge` names.
    pub fn with_noise_known_from(&self, knowledge: NoiseKnowledge) -> Option<Self> {
        let (halves, variance) = (knowledge.has_halves(), knowledge.has_variance());
        let given = self.noise_knowledge();
        if halves && !given.has_halves() || variance && !given.has_variance() {
            return None;
        }
        let reduced = |signal: &Signal| Signal {
            mean: signal.mean.clone(),
            half_spread: signal.half_spread.as_ref().filter(|_| halves).cloned(),
            variance_of_mean: signal.variance_of_mean.as_ref().filter(|_| variance).cloned(),
        };
        let feature = |feature: &Feature| Feature {
            signal: reduced(&feature.signal),
            name: feature.name.clone(),
            misses: feature.misses.clone(),
            ..*feature
        };
        let payload = |layer: &PayloadLayer| PayloadLayer {
            half_spread: layer.half_spread.as_ref().filter(|_| halves).cloned(),
            mean: layer.mean.clone(),
            name: layer.name.clone(),
            ..*layer
        };
        Some(Self {
            color: reduced(&self.color),
            features: self.features.iter().map(feature).collect(),
            constant_features: self.constant_features.clone(),
            samples_per_pixel: self.samples_per_pixel.clone(),
            payload: self.payload.iter().map(payload).collect(),
            ..*self
        })
    }

    /// Returns an estimate of the relative MSE of the unfiltered colour, without a reference: the mean over pixels and
    /// channels of variance/(mean² + 0.01). It is too low where samples are few, because a spike raises its own mean
    /// along with its variance, and a spike that no pixel caught is missing. `None` where the noise is unknown.
    pub fn noise_level(&self) -> Option<f64> {
        let mut sum = 0.0;
        for (channel, mean) in self.color.mean.planes.iter().enumerate() {
            let relative = |variance: f64, mean: f32| variance / (f64::from(mean).powi(2) + RELATIVE_EPSILON);
            sum += match (&self.color.variance_of_mean, &self.color.half_spread) {
                (Some(variance), _) => {
                    variance.planes[channel].iter().zip(mean).map(|(&v, &m)| relative(v.into(), m)).sum::<f64>()
                }
                (None, Some(spread)) => {
                    spread.planes[channel].iter().zip(mean).map(|(&s, &m)| relative(f64::from(s).powi(2), m)).sum()
                }
                (None, None) => return None,
            };
        }
        Some(sum / (self.color.mean.channels() * self.extent.pixels()) as f64)
    }
}
