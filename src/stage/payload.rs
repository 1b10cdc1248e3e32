//! The payload: layers that are filtered along with the colour, with the weights, shares and repairs of the colour.
//! Every stage here does to the payload what its model does to the colour, so that a layer that equals the colour comes
//! out equal to it.
//!
//! Planes of a payload come in groups of up to [`MOST_PLANES`], one buffer each: few enough for the registers of a
//! kernel, and no buffer grows with the number of layers. Channels in x, y and z of a plane belong to the channels of
//! the colour; w holds a number that belongs to all of them, such as alpha.

use std::sync::Arc;

use glam::{IVec2, IVec4};

use super::candidate::Candidates;
use super::candidate_filter::Pass;
use super::feature::Features;
use super::nlm::{Chunk, NlmParams, Payload, Schedule};
use super::spike::{Repaired, SpikeParams, SpikeRule, feature_groups};
use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Definition, Recorder, bindings, uniforms};

uniforms! {
    struct PayloadParams { places: IVec4 }
    struct PayloadBlendParams { extent: IVec2 }
    struct PayloadMixParams { extent: IVec2, planes: i32, share_plane: i32, share_component: i32, share: f32 }
    struct PayloadScaleParams { extent: IVec2, planes: i32, sigma: f32 }
    struct PayloadHalfParams { extent: IVec2, planes: i32, sign: f32 }
}

bindings! {
    struct PayloadAccumulate<'a> {
        uniform params: NlmParams, uniform payload_params: PayloadParams,
        read state, read payload, around neighbours, write sums,
    }
    struct PayloadAccumulateOwn<'a> {
        uniform params: NlmParams, uniform payload_params: PayloadParams,
        read state, read payload, around neighbours, write sums, write sums_alone,
    }
    struct PayloadBlend<'a> {
        uniform params: PayloadBlendParams, optional shares, read means, read payload, read sums, optional sums_alone,
        optional spreads, write blended,
    }
    struct PayloadMix<'a> { uniform params: PayloadMixParams, read first, read second, optional shares, write mixed }
    struct PayloadLevel<'a> {
        uniform params: SpikeParams, around signal, optional_around features, read spikes, read lights, around payload,
        write repaired,
    }
    struct PayloadLevelShares<'a> {
        uniform params: SpikeParams, around signal, optional_around features, read spikes, read lights, around payload,
        write repaired, write shares,
    }
    struct PayloadSpread<'a> {
        uniform params: SpikeParams, around spikes, optional_around features, around levels, around shares,
        write repaired,
    }
    struct PayloadScale<'a> { uniform params: PayloadScaleParams, read choice, read coarse, write selected }
    struct PayloadHalf<'a> {
        uniform params: PayloadHalfParams, read payload, read spreads, read signal, read signal_repaired, write half,
    }
}

/// Largest number of planes in a group.
pub const MOST_PLANES: u32 = 4;

/// Some planes of a payload.
#[derive(Clone, Debug)]
pub struct PayloadGroup {
    /// Buffer of `planes` planes.
    pub buffer: Arc<Buffer>,
    /// Number of planes, 1 to [`MOST_PLANES`].
    pub planes: u32,
}

impl PayloadGroup {
    /// Takes a buffer for a group like this one.
    fn like(&self, rec: &mut Recorder, label: &str, extent: IVec2) -> Result<Self> {
        Ok(self.with_planes(rec.take(label, plane_bytes(extent, self.planes))?))
    }

    /// Returns the group as the payload of a filter over one frame.
    pub(crate) fn payload(&self) -> Payload<'_> {
        Payload::new(&self.buffer, self.planes)
    }

    /// Returns a group of as many planes in another buffer.
    pub(crate) fn with_planes(&self, buffer: Buffer) -> Self {
        Self { buffer: Arc::new(buffer), planes: self.planes }
    }

    fn definition(&self) -> (&'static str, Definition) {
        ("PLANES", Definition::Int(self.planes as i32))
    }
}

/// Share of the second image in a mix of two.
#[derive(Clone, Copy, Debug)]
pub enum MixShare<'a> {
    /// Everywhere the same share, 0 to 1.
    Even(f32),
    /// Shares in the w of the half spread of this signal, 0 to 1.
    OfSignal(&'a Buffer),
    /// Shares in the x of this plane, 0 to 1.
    Plane(&'a Buffer),
}

/// Name of the step that filters the payload, in plans and times.
pub(crate) const PAYLOAD_STEP: &str = "layers along";

/// Sums of a payload over the window: for each group a buffer with a plane for each candidate and plane.
#[derive(Clone, Copy)]
pub(super) struct PayloadSums<'a> {
    pub(super) together: &'a [Arc<Buffer>],
    /// Buffers that get a copy of the sums, which are complete over the own frame; `None` otherwise.
    pub(super) alone: Option<&'a [Arc<Buffer>]>,
}

/// Adds the pairs of a chunk to the sums of the payload. `state` holds the weights that `candidate_accumulate` left,
/// `groups` the payload of the own frame, and `neighbours` the payload of the frame that the pairs lie in.
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub(super) fn payload_accumulate(
    rec: &mut Recorder,
    chunk: &Chunk,
    pass: &Pass,
    state: &Buffer,
    [groups, neighbours]: [&[PayloadGroup]; 2],
    sums: PayloadSums,
    window_radius: u32,
    schedule: Schedule,
) -> Result<()> {
    let params = chunk.params;
    let place = |place: Option<usize>| place.map_or(-1, |place| place as i32);
    let places = IVec4::new(place(pass.small), place(pass.large), place(pass.alone), 0);
    let payload_params = PayloadParams { places };
    for (index, (group, neighbours)) in groups.iter().zip(neighbours).enumerate() {
        let own = [
            group.definition(),
            schedule.pixels_definition(),
            ("SMALL", pass.small.is_some().into()),
            ("LARGE", pass.large.is_some().into()),
            ("FEATURES_ALONE", pass.alone.is_some().into()),
            ("ENDS_OWN_FRAME", sums.alone.is_some().into()),
        ];
        let (payload, alone, sums) = (&*group.buffer, sums.alone, &*sums.together[index]);
        let neighbours = neighbours.buffer.within(window_radius);
        let invocations = schedule.per_row_of_pixels(&params);
        match alone {
            None => {
                let bound = PayloadAccumulate { params, payload_params, state, payload, neighbours, sums };
                rec.dispatch("payload_accumulate", &own, &bound, invocations)?;
            }
            Some(alone) => {
                let sums_alone = &*alone[index];
                let bound =
                    PayloadAccumulateOwn { params, payload_params, state, payload, neighbours, sums, sums_alone };
                rec.dispatch("payload_accumulate", &own, &bound, invocations)?;
            }
        }
    }
    Ok(())
}

/// Averages the payload of the candidates by `shares` (see [`select_share`](super::select::select_share)); without
/// shares, the only candidate is the average. `payload` is what the candidates averaged, `sums` their
/// [`Candidates::payload`]. `sums_alone` holds the sums over the own frame alone, if
/// [`select_frames`](super::select::select_frames) has compared the candidates with them. Gives the buffers of the sums
/// back group by group.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn payload_blend(
    rec: &mut Recorder,
    extent: IVec2,
    shares: Option<&Buffer>,
    candidates: &Candidates,
    payload: &[PayloadGroup],
    sums: Vec<Arc<Buffer>>,
    sums_alone: Option<Vec<Arc<Buffer>>>,
) -> Result<Vec<PayloadGroup>> {
    let mut sums_alone = sums_alone.map(Vec::into_iter);
    let blend = |(group, sums): (&PayloadGroup, Arc<Buffer>)| {
        let alone = sums_alone.as_mut().and_then(Iterator::next);
        let blended = group.like(rec, "blend of the payload", extent)?;
        let definitions = [
            candidates.definition(),
            group.definition(),
            ("SHARED", shares.is_some().into()),
            ("FRAMES", alone.is_some().into()),
        ];
        let bound = PayloadBlend {
            params: PayloadBlendParams { extent },
            shares,
            means: &candidates.means,
            payload: &group.buffer,
            sums: &sums,
            sums_alone: alone.as_deref(),
            spreads: alone.as_ref().map(|_| &*candidates.spreads),
            blended: &blended.buffer,
        };
        rec.dispatch("payload_blend", &definitions, &bound, per_pixel(extent))?;
        Ok(blended)
    };
    payload.iter().zip(sums).map(blend).collect()
}

/// Mixes two versions of a payload by the share that the second one has in each pixel. Gives their buffers back group
/// by group.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn payload_mix(
    rec: &mut Recorder,
    extent: IVec2,
    first: Vec<PayloadGroup>,
    second: Vec<PayloadGroup>,
    share: MixShare,
) -> Result<Vec<PayloadGroup>> {
    let (shares, share_plane, share_component, share) = match share {
        MixShare::Even(share) => (None, 0, 0, share),
        MixShare::OfSignal(signal) => (Some(signal), 1, 3, 0.0),
        MixShare::Plane(plane) => (Some(plane), 0, 0, 0.0),
    };
    let mix = |(first, second): (PayloadGroup, PayloadGroup)| {
        let mixed = first.like(rec, "mixed payload", extent)?;
        let params = PayloadMixParams { extent, planes: first.planes as i32, share_plane, share_component, share };
        let bound = PayloadMix { params, first: &first.buffer, second: &second.buffer, shares, mixed: &mixed.buffer };
        rec.dispatch("payload_mix", &[("SHARED", shares.is_some().into())], &bound, per_pixel(extent))?;
        Ok(mixed)
    };
    first.into_iter().zip(second).map(mix).collect()
}

/// Takes spikes and lights of few pixels out of a payload where [`spike_find`](super::spike::spike_find) has found them
/// in `signal`, the colour. If `levels` are given, which are those of [`spike_spread`](super::spike::spike_spread), the
/// pixels around get their parts.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn payload_repair(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    features: Option<&Features>,
    rule: &SpikeRule,
    found: &Repaired,
    levels: Option<&Buffer>,
    payload: &[PayloadGroup],
) -> Result<Vec<PayloadGroup>> {
    let params = rule.params(extent, features);
    let Repaired { spikes, lights, .. } = found;
    let repair = |group: &PayloadGroup| {
        let repaired = group.like(rec, "payload without spikes", extent)?;
        let definitions = [feature_groups(features), group.definition(), ("SPREAD", levels.is_some().into())];
        let features_within = |radius| features.map(|features| features.buffer.within(radius));
        let (signal, payload) = (signal.within(rule.window_radius).front(), group.buffer.within(rule.window_radius));
        let features = features_within(rule.window_radius);
        let Some(levels) = levels else {
            let bound = PayloadLevel { params, signal, features, spikes, lights, payload, repaired: &repaired.buffer };
            rec.dispatch("payload_level", &definitions, &bound, per_pixel(extent))?;
            return Ok(repaired);
        };
        let shares = group.like(rec, "shares of the payload in spikes", extent)?;
        let bound = PayloadLevelShares {
            params,
            signal,
            features,
            spikes,
            lights,
            payload,
            repaired: &repaired.buffer,
            shares: &shares.buffer,
        };
        rec.dispatch("payload_level", &definitions, &bound, per_pixel(extent))?;
        let bound = PayloadSpread {
            params,
            spikes: spikes.within(rule.spread_radius).back(),
            features: features_within(rule.spread_radius),
            levels: levels.within(rule.spread_radius),
            shares: shares.buffer.within(rule.spread_radius),
            repaired: &repaired.buffer,
        };
        rec.dispatch("payload_spread", &definitions[..2], &bound, per_pixel(extent))?;
        Ok(repaired)
    };
    payload.iter().map(repair).collect()
}

/// Copies a payload.
///
/// # Errors
/// As [`payload_mix`].
pub fn payload_copy(rec: &mut Recorder, extent: IVec2, payload: &[PayloadGroup]) -> Result<Vec<PayloadGroup>> {
    payload_mix(rec, extent, payload.to_vec(), payload.to_vec(), MixShare::Even(0.0))
}

/// Replaces pixels of a payload by their values at the scale `sigma`, in pixels, wherever `choice` says that the colour
/// has reached that scale: see [`Selected::choice`](super::scale::Selected::choice).
///
/// # Errors
/// As [`Recorder::dispatch`].
pub fn payload_scale(
    rec: &mut Recorder,
    extent: IVec2,
    choice: &Buffer,
    sigma: f32,
    coarse: &Buffer,
    selected: &PayloadGroup,
) -> Result<()> {
    let params = PayloadScaleParams { extent, planes: selected.planes as i32, sigma };
    let bound = PayloadScale { params, choice, coarse, selected: &selected.buffer };
    rec.dispatch("payload_scale", &[], &bound, per_pixel(extent))
}

/// Half of the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// Mean + half spread.
    A,
    /// Mean − half spread.
    B,
}

/// Returns one half of a payload, from its mean without spikes and its half spread. `signal` and `signal_repaired` are
/// the colour before and after the repair of spikes, two planes each: where the repair narrowed the colour's spread,
/// the payload's is narrowed in the same proportion.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn payload_half(
    rec: &mut Recorder,
    extent: IVec2,
    half: Half,
    payload: &PayloadGroup,
    spreads: &Buffer,
    [signal, signal_repaired]: [&Buffer; 2],
) -> Result<PayloadGroup> {
    let made = payload.like(rec, "half of the payload", extent)?;
    let sign = if half == Half::A { 1.0 } else { -1.0 };
    let params = PayloadHalfParams { extent, planes: payload.planes as i32, sign };
    let bound = PayloadHalf { params, payload: &payload.buffer, spreads, signal, signal_repaired, half: &made.buffer };
    rec.dispatch("payload_half", &[], &bound, per_pixel(extent))?;
    Ok(made)
}
