//! The candidate filters FIRST, SECOND and THIRD with their derivatives, in one pass over the window (thesis 8.2 to
//! 8.4).

use std::sync::Arc;

use glam::{IVec2, Vec4};

use super::candidate_set::CandidateSet;
use super::exact::{ExactTiles, Region};
use super::feature::{Features, MAX_GROUPS};
use super::nlm::{Beside, ChunkNeeds, Guide, NlmParams, Schedule, Weighting, for_each_chunk};
use super::plane_bytes;
use crate::error::Result;
use crate::gpu::{Buffer, Definition, Recorder, bindings, uniforms};

uniforms! {
    struct ResolveParams { candidate: i32 }
    pub(super) struct CandidateParams {
        inverse_feature_k_squared: f32,
        feature_tau: f32,
        feature_tau_third: f32,
        triple_weights: [Vec4; MAX_GROUPS],
    }
}

bindings! {
    struct CandidateAccumulate<'a> {
        uniform params: NlmParams, uniform candidate: CandidateParams,
        optional_around columns, around signal, around variance_of_mean, write state, optional_around features,
        optional_around neighbours_signal, optional_around neighbours_variance, optional_around neighbours_features,
    }
    struct CandidateResolve<'a> {
        uniform params: NlmParams, uniform resolve: ResolveParams, read signal, read variance_of_mean, read state,
        write filtered, write derivatives,
    }
    struct CandidateResolveValue<'a> {
        uniform params: NlmParams, uniform resolve: ResolveParams, read signal, read variance_of_mean, read state,
        write filtered,
    }
}

/// Planes of running sums that `candidate_accumulate` keeps per pixel of a strip.
const STATE_PLANES: u32 = 12;

/// Parameters of the candidate filters.
#[derive(Clone, Copy, Debug)]
pub struct CandidateFilter {
    /// R: the window is 2R+1 pixels wide.
    pub window_radius: u32,
    /// k_c of FIRST and SECOND.
    pub color_k: f32,
    /// f of FIRST, at most that of SECOND.
    pub first_patch_radius: u32,
    /// f of SECOND.
    pub second_patch_radius: u32,
    /// k_f of all three.
    pub feature_k: f32,
    /// τ of FIRST and SECOND.
    pub feature_tau: f32,
    /// τ of THIRD.
    pub feature_tau_third: f32,
    /// Weighting of FIRST and SECOND. THIRD takes the symmetric distances where the others do, but never blends pairs:
    /// it is the widest filter already, and without a colour term nothing would limit the blend.
    pub weighting: Weighting,
}

impl CandidateFilter {
    /// Returns the guide by which the candidates that look at the colour compare it.
    pub(super) fn guide<'a>(
        &self,
        signal: &'a Buffer,
        variance_of_mean: &'a Buffer,
        candidates: CandidateSet,
        grey: bool,
    ) -> Guide<'a> {
        let CandidateSet { first: with_first, second: with_second, .. } = candidates;
        let patch_radius = if with_second { self.second_patch_radius } else { self.first_patch_radius };
        Guide {
            small_patch_radius: (with_first && with_second).then_some(self.first_patch_radius),
            grey,
            ..Guide::new(signal, variance_of_mean, 3, self.color_k, patch_radius)
        }
    }

    /// Returns the parameters by which the features are compared.
    pub(super) fn params(&self, features: Option<&Features>) -> CandidateParams {
        CandidateParams {
            inverse_feature_k_squared: 1.0 / (self.feature_k * self.feature_k),
            feature_tau: self.feature_tau,
            feature_tau_third: self.feature_tau_third,
            triple_weights: features.map_or([Vec4::ZERO; MAX_GROUPS], |features| features.packing.triple_weights()),
        }
    }
}

/// A frame beside the one that is filtered, whose pixels take part as neighbours (thesis 8.6).
#[derive(Clone, Copy, Debug)]
pub struct CandidateBeside<'a> {
    /// Colour signal of the frame.
    pub signal: &'a Buffer,
    /// Scaled variance of the frame's colour, one plane.
    pub variance_of_mean: &'a Buffer,
    /// Prefiltered features of the frame: the same features as in the filtered frame, in the same units.
    pub features: Option<&'a Features>,
}

/// Outputs of the candidates to compute.
#[derive(Clone, Copy, Debug)]
pub struct Needed<'a> {
    /// Candidates to compute.
    pub candidates: CandidateSet,
    /// Whether to compute their derivatives.
    pub derivatives: bool,
    /// Whether to compute their half spreads, which are 0 otherwise.
    pub half_spread: bool,
    /// Whether to compute them over the own frame alone as well, where there are frames beside.
    pub alone: bool,
    /// Whether the three channels of the colour differ in at least one frame.
    pub channels: bool,
    /// Tiles in which no pixel within reach has noise: there every candidate is the signal itself, with derivatives of
    /// 1.
    pub exact: Option<&'a ExactTiles>,
    /// Pixels to compute; the values of other pixels are arbitrary. `None` computes all pixels.
    pub wanted: Option<Region>,
}

impl Needed<'_> {
    /// All outputs, for all pixels.
    pub const EVERYTHING: Self = Self {
        candidates: CandidateSet::ALL,
        derivatives: true,
        half_spread: true,
        alone: true,
        channels: true,
        exact: None,
        wanted: None,
    };
}

/// The filtered candidates.
#[derive(Debug)]
pub struct Candidates {
    /// Signals of FIRST, SECOND and THIRD, as far as they take part; Σ w in the w of the mean.
    pub signals: [Option<Arc<Buffer>>; 3],
    /// Three planes: dF_i/du_i per channel, of FIRST, SECOND and THIRD.
    pub derivatives: Option<Arc<Buffer>>,
}

impl Candidates {
    fn take(rec: &mut Recorder, extent: IVec2, needed: &Needed) -> Result<Self> {
        let mut signals = [None, None, None];
        for (signal, (name, takes_part)) in
            signals.iter_mut().zip(["FIRST", "SECOND", "THIRD"].into_iter().zip(needed.candidates.flags()))
        {
            *signal = if takes_part { Some(Arc::new(rec.take(name, plane_bytes(extent, 2))?)) } else { None };
        }
        let derivatives =
            if needed.derivatives { Some(Arc::new(rec.take("derivatives", plane_bytes(extent, 3))?)) } else { None };
        Ok(Self { signals, derivatives })
    }

    /// Returns which candidates take part.
    pub fn set(&self) -> CandidateSet {
        let [first, second, third] = self.signals.each_ref().map(Option::is_some);
        CandidateSet { first, second, third }
    }

    /// Returns the index of the first candidate that takes part, from 0, and its signal.
    pub(crate) fn first_of_all(&self) -> Option<(usize, &Arc<Buffer>)> {
        self.signals.iter().enumerate().find_map(|(place, signal)| Some((place, signal.as_ref()?)))
    }

    /// Returns the signals of the candidates that take part.
    pub(super) fn buffers(&self) -> [Option<&Buffer>; 3] {
        self.signals.each_ref().map(Option::as_deref)
    }
}

/// The candidates of a window in time.
#[derive(Debug)]
pub struct CandidatesInTime {
    /// Over all frames.
    pub together: Candidates,
    /// Over the own frame alone, if there are frames beside and it was requested.
    pub alone: Option<Candidates>,
}

/// Filters a colour signal with the three candidates, over a window in its frame and in the frames `beside`.
/// `variance_of_mean` is its scaled variance; without features the feature weights are 1.
///
/// `progress` is called with the share of rows whose commands are recorded.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`], and the errors that `progress` returns.
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn candidates(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    variance_of_mean: &Buffer,
    features: Option<&Features>,
    beside: &[CandidateBeside],
    filter: &CandidateFilter,
    needed: Needed,
    schedule: Schedule,
    mut progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
) -> Result<CandidatesInTime> {
    let together = Candidates::take(rec, extent, &needed)?;
    let alone = (!beside.is_empty() && needed.alone).then(|| Candidates::take(rec, extent, &needed)).transpose()?;
    let neighbours: Vec<_> =
        beside.iter().map(|frame| Beside { signal: frame.signal, variance_of_mean: frame.variance_of_mean }).collect();
    let Needed { exact, wanted, .. } = needed;
    let guide = Guide {
        beside: &neighbours,
        exact,
        wanted,
        ..filter.guide(signal, variance_of_mean, needed.candidates, !needed.channels)
    };
    let patch_radius = guide.patch_radius;
    let by_color = needed.candidates.by_color();
    let groups = features.map_or(0, |features| features.packing.groups);
    let [symmetric, hard] = filter.weighting.symmetric.definitions();
    let [takes_part_first, takes_part_second, takes_part_third] = needed.candidates.definitions();
    // The kernel for the nearest rows is the larger one. With as many pixels as the other kernel, a driver takes 3.6 s
    // to compile it; with half of them, 1.2 s, and the kernel is 16 % slower for a third of the offsets.
    let blocking = |near: bool| Schedule {
        pixels: if near && schedule.pixels.is_multiple_of(2) { schedule.pixels / 2 } else { schedule.pixels },
        ..schedule
    };
    let definitions = |other_frame: bool, near: bool| {
        [
            ("OTHER_FRAME", Definition::from(other_frame)),
            ("NEAR", near.into()),
            blocking(near).pixels_definition(),
            ("PATCH_RADIUS", Definition::Int(patch_radius as i32)),
            ("SMALL_PATCH_RADIUS", Definition::Int(filter.first_patch_radius as i32)),
            ("COLOR", by_color.into()),
            takes_part_first,
            takes_part_second,
            takes_part_third,
            ("DERIVATIVES", needed.derivatives.into()),
            ("HALVES", needed.half_spread.into()),
            ("GREY", guide.grey.into()),
            ("FEATURE_GROUPS", Definition::Int(groups as i32)),
            symmetric,
            hard,
        ]
    };
    let candidate = filter.params(features);
    let mut state: Option<Buffer> = None;
    let needs = ChunkNeeds { distances: by_color, sum_planes: STATE_PLANES };
    for_each_chunk(rec, extent, &guide, needs, filter.window_radius, filter.weighting, schedule, |rec, chunk| {
        let params = chunk.params;
        if params.starts != 0 {
            // Gives this buffer back before the next one is taken.
            state = None;
        }
        let state = match &mut state {
            Some(state) => state,
            None => state
                .insert(rec.take("candidate sums", plane_bytes(IVec2::new(params.width, params.rows), STATE_PLANES))?),
        };
        let beside = chunk.beside.map(|index| beside[index]);
        // Patches hold pixels of their own pair only in the nearest rows, and never in a frame beside.
        let near = beside.is_none() && params.first_offset.y <= patch_radius as i32;
        let bound = CandidateAccumulate {
            params,
            candidate,
            columns: by_color.then(|| chunk.columns.within_columns_and_rows(patch_radius, 0)),
            signal: signal.within(filter.window_radius),
            variance_of_mean: variance_of_mean.within(filter.window_radius),
            state,
            features: features.map(|features| features.buffer.within(filter.window_radius)),
            neighbours_signal: beside.map(|frame| frame.signal.within(filter.window_radius)),
            neighbours_variance: beside.map(|frame| frame.variance_of_mean.within(filter.window_radius)),
            neighbours_features: beside
                .and_then(|frame| frame.features)
                .map(|features| features.buffer.within(filter.window_radius)),
        };
        rec.dispatch(
            "candidate_accumulate",
            &definitions(beside.is_some(), near),
            &bound,
            blocking(near).per_row_of_pixels(&params),
        )?;
        // The sums over the own frame are complete before the sums over the other frames begin.
        let complete =
            if chunk.last { Some(&together) } else { alone.as_ref().filter(|_| beside.is_none() && chunk.ends_frame) };
        for (candidate, filtered) in (0..).zip(complete.iter().flat_map(|complete| complete.buffers())) {
            let Some(filtered) = filtered else { continue };
            let definitions = [("THIRD", (candidate == 2).into()), ("DERIVATIVES", needed.derivatives.into())];
            let (resolve, invocations) = (ResolveParams { candidate }, [params.width as u32, params.rows as u32, 1]);
            match complete.and_then(|complete| complete.derivatives.as_deref()) {
                Some(derivatives) => {
                    rec.dispatch(
                        "candidate_resolve",
                        &definitions,
                        &CandidateResolve { params, resolve, signal, variance_of_mean, state, filtered, derivatives },
                        invocations,
                    )?;
                }
                None => {
                    rec.dispatch(
                        "candidate_resolve",
                        &definitions,
                        &CandidateResolveValue { params, resolve, signal, variance_of_mean, state, filtered },
                        invocations,
                    )?;
                }
            }
        }
        if chunk.last {
            progress(rec, chunk.done)?;
        }
        Ok(())
    })?;
    if let Some(exact) = needed.exact {
        let tiles = exact.upload(rec, extent)?;
        for candidates in std::iter::once(&together).chain(&alone) {
            candidates.signals.iter().flatten().try_for_each(|candidate| tiles.copy_signal(rec, signal, candidate))?;
            candidates.derivatives.iter().try_for_each(|derivatives| tiles.fill(rec, derivatives, 3, true))?;
        }
    }
    Ok(CandidatesInTime { together, alone })
}
