//! Layers that are filtered along with the colour, with the colour's own weights: light groups, AOVs and alpha.

use super::repairs::Layer;
use super::sanitise::{Sanitised, sanitise};
use super::{Frame, Repairs, Signal};
use crate::error::{Error, RequestCause, Result};
use crate::image::Image;

/// Quantity of a payload layer. It decides the range of the result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PayloadKind {
    /// A part of the light, such as a light group: any finite value.
    Light,
    /// Opacity. The result lies within 0 to 1.
    Alpha,
}

/// A layer that is filtered along with the colour: every filter averages its pixels with the weights that the colour
/// has. So the sum of denoised layers is the denoised sum.
#[derive(Clone, Debug, PartialEq)]
pub struct PayloadLayer {
    /// Name of the layer, for messages.
    pub name: String,
    /// Quantity of the layer.
    pub kind: PayloadKind,
    /// Mean of all samples, 1 to 4 planes. A colour is multiplied by its alpha.
    pub mean: Image,
    /// Half spread of the mean, as [`Signal::half_spread`]. Only NLM uses it, which filters each half with the weights
    /// of the other: without it, both halves count as equal to the mean.
    pub half_spread: Option<Image>,
}

/// Largest number of planes of a payload layer.
const MOST_PLANES: usize = 4;

impl Frame {
    /// Returns the frame with these payload layers, in the place of the layers that it had. Damaged values become the
    /// average of their neighbours; half spreads stay only if the colour has one. A layer with a channel that has no
    /// usable value is left out. All changes are reported.
    ///
    /// # Errors
    /// [`Error::Request`] for a layer of another extent, of no planes or more than four, or with incomplete planes.
    pub fn with_payload(mut self, layers: Vec<PayloadLayer>) -> Result<(Self, Repairs)> {
        let mut repairs = Repairs::default();
        let has_halves = self.color.half_spread.is_some();
        self.payload.clear();
        for PayloadLayer { name, kind, mean, half_spread } in layers {
            let channels = mean.channels();
            if !(1..=MOST_PLANES).contains(&channels) {
                return Err(Error::Request(RequestCause::PayloadChannels { layer: name, channels }));
            }
            let half_spread = half_spread.filter(|spread| has_halves && spread.channels() == channels);
            let mut signal = Signal { mean, half_spread, variance_of_mean: None };
            super::check_shape(&name, &signal, self.extent)?;
            let layer = Layer::payload(&name);
            let Sanitised { found, unusable, .. } = sanitise(layer, &mut signal, false);
            if !unusable.is_empty() {
                let channels = layer.in_channels(&unusable, channels);
                repairs.notes.push(format!("{layer}: not one pixel has a usable value{channels}, not filtered"));
                continue;
            }
            repairs.add(found);
            let Signal { mean, half_spread, .. } = signal;
            self.payload.push(PayloadLayer { name, kind, mean, half_spread });
        }
        Ok((self, repairs))
    }

    /// Returns the layers that are filtered along with the colour.
    pub fn payload(&self) -> &[PayloadLayer] {
        &self.payload
    }
}
