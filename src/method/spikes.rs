//! What the methods do about spikes before they filter.

use std::fmt;
use std::sync::Arc;

use glam::IVec2;
use serde::Serialize;

use super::GpuSignal;
use crate::error::Result;
use crate::gpu::{Buffer, Recorder};
use crate::parameters::choices;
use crate::stage::feature::Features;
use crate::stage::spike::{SpikeRule, spike_find, spike_spread};

choices! {
    /// What becomes of spikes: pixels far above those of their kind around them, that rest on very few samples for it.
    /// The more samples there are, the fewer pixels are spikes, and where a pixel has no noise it is none.
    ///
    /// | on the command line | a spike | its energy |
    /// | --- | --- | --- |
    /// | `keep` | stays | stays |
    /// | `spread`, the default | becomes the mean of its neighbours | goes to all noisy pixels of its kind around it that are about as bright, as far as they would not become brighter by much more than a tenth |
    /// | `clamp` | becomes the mean of its neighbours | is lost |
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Spikes {
        /// They are filtered like everything else.
        Keep => "keep",
        /// What stands out goes to the pixels around, as far as that is likely.
        Spread => "spread",
        /// What stands out is cut off.
        Clamp => "clamp",
    }
}

/// What was found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct SpikeReport {
    /// Number of spikes.
    pub pixels: usize,
    /// What was taken from them, as a share of the whole image's energy: the sum of the colour over pixels and
    /// channels.
    pub taken: f64,
    /// What the pixels around got of it, as the same share.
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

/// What was found in a colour.
#[derive(Clone, Debug)]
pub(super) struct Found {
    /// What was taken from each pixel: as [`Repaired::spikes`](crate::stage::spike::Repaired::spikes).
    pub(super) spikes: Arc<Buffer>,
    /// Lights of few pixels, kept aside.
    pub(super) lights: Arc<Buffer>,
}

impl Spikes {
    /// A colour without spikes and lights of few pixels, and what was found. Features tell which pixels are
    /// of one kind.
    pub(super) fn repair(
        self,
        rec: &mut Recorder,
        extent: IVec2,
        color: GpuSignal,
        features: Option<&Features>,
    ) -> Result<(GpuSignal, Option<Found>)> {
        if self == Self::Keep {
            return Ok((color, None));
        }
        let rule = SpikeRule::DEFAULT;
        let mut repaired = spike_find(rec, extent, &color.signal, color.variance_of_mean.as_deref(), features, &rule)?;
        if self == Self::Spread {
            spike_spread(rec, extent, features, &rule, &mut repaired)?;
        }
        let color = GpuSignal {
            signal: Arc::new(repaired.signal),
            variance_of_mean: repaired.variance_of_mean.map(Arc::new),
            has_halves: color.has_halves,
        };
        Ok((color, Some(Found { spikes: Arc::new(repaired.spikes), lights: Arc::new(repaired.lights) })))
    }
}
