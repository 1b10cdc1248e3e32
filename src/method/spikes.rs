//! Treatment of spikes before a method filters.

use std::fmt;
use std::sync::Arc;

use glam::IVec2;
use serde::Serialize;

use super::GpuSignal;
use super::payload::Payload;
use crate::error::Result;
use crate::gpu::{Buffer, Recorder};
use crate::parameters::choices;
use crate::stage::feature::Features;
use crate::stage::payload::{PAYLOAD_STEP, payload_repair};
use crate::stage::spike::{SpikeRule, spike_find, spike_spread};

choices! {
    /// Treatment of spikes: pixels far above the pixels of their kind around them, by an excess that rests on very few
    /// samples. The more samples there are, the fewer pixels are spikes. A pixel without noise is no spike.
    ///
    /// | on the command line | a spike | its energy |
    /// | --- | --- | --- |
    /// | `keep` | stays | stays |
    /// | `spread`, the default | becomes the mean of its neighbours | goes to similar pixels around it |
    /// | `clamp` | becomes the mean of its neighbours | is lost |
    ///
    /// Similar pixels are noisy, of the same kind and about as bright. They get only so much energy that none becomes
    /// brighter by much more than a tenth; the rest is lost.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Spikes {
        /// Spikes are filtered like everything else.
        Keep => "keep",
        /// The excess goes to similar pixels around, except for what would brighten them too much.
        Spread => "spread",
        /// The excess is cut off.
        Clamp => "clamp",
    }
}

/// Number of spikes that were found, and their energy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SpikeReport {
    /// Number of spikes.
    pub pixels: usize,
    /// Energy taken from spikes, as a share of the energy of the whole image: the sum of the colour over pixels and
    /// channels.
    pub taken: f64,
    /// Energy that the pixels around got from spikes, as the same kind of share.
    pub spread: f64,
}

impl fmt::Display for SpikeReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { pixels, taken, spread } = self;
        let percent = |share: f64| format!("{:.2} %", 100.0 * share);
        match pixels {
            0 => f.write_str("colour: no spikes"),
            _ => write!(
                f,
                "colour: {pixels} spikes taken out with {} of the energy, of which the pixels around got {}",
                percent(*taken),
                percent(*spread)
            ),
        }
    }
}

/// Spikes and lights that were found in a colour.
#[derive(Clone, Debug)]
pub(super) struct Found {
    /// Amount taken from each pixel, as [`Repaired::spikes`](crate::stage::spike::Repaired::spikes).
    pub(super) spikes: Arc<Buffer>,
    /// Lights of few pixels, set aside.
    pub(super) lights: Arc<Buffer>,
}

impl Spikes {
    /// Returns a colour without spikes and lights of few pixels, and the spikes and lights that were found. Features
    /// tell which pixels are of one kind. The payload is repaired in the same pixels.
    pub(super) fn repair(
        self,
        rec: &mut Recorder,
        extent: IVec2,
        color: GpuSignal,
        features: Option<&Features>,
        payload: &mut Payload,
    ) -> Result<(GpuSignal, Option<Found>)> {
        if self == Self::Keep {
            return Ok((color, None));
        }
        let rule = SpikeRule::DEFAULT;
        let mut repaired = spike_find(rec, extent, &color.signal, color.variance_of_mean.as_deref(), features, &rule)?;
        let mut levels = None;
        if self == Self::Spread {
            levels = Some(spike_spread(rec, extent, features, &rule, &mut repaired)?);
        }
        payload.repaired = rec.in_step(PAYLOAD_STEP, |rec| {
            let (signal, levels, means) = (&color.signal, levels.as_ref(), payload.means());
            payload_repair(rec, extent, signal, features, &rule, &repaired, levels, &means)
        })?;
        let color = GpuSignal {
            signal: Arc::new(repaired.signal),
            variance_of_mean: repaired.variance_of_mean.map(Arc::new),
            has_halves: color.has_halves,
        };
        Ok((color, Some(Found { spikes: Arc::new(repaired.spikes), lights: Arc::new(repaired.lights) })))
    }
}
