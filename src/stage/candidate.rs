//! The candidate filters FIRST, SECOND and THIRD with their derivatives, in one pass over the window (thesis 8.2 to 8.4).

use std::sync::Arc;

use glam::{IVec2, Vec4};

use super::feature::{Features, MAX_GROUPS};
use super::nlm::{Beside, Guide, NlmParams, Schedule, Weighting, for_each_chunk};
use super::plane_bytes;
use crate::error::Result;
use crate::gpu::{Buffer, Definition, Recorder, bindings, uniforms};

uniforms! {
    struct CandidateParams { inverse_feature_k_squared: f32, feature_tau: f32, feature_tau_third: f32, triple_weights: [Vec4; MAX_GROUPS] }
}

bindings! {
    struct CandidateAccumulate<'a> {
        uniform params: NlmParams, uniform candidate: CandidateParams,
        read columns, read signal, read variance_of_mean, write state, optional features,
        optional neighbours_signal, optional neighbours_variance, optional neighbours_features,
    }
    struct CandidateResolve<'a> {
        uniform params: NlmParams, read signal, read variance_of_mean, read state, write first, write second, write third, write derivatives,
    }
}

/// Planes of running sums that `candidate_accumulate` keeps per pixel of a strip.
pub(crate) const STATE_PLANES: u32 = 12;

/// What tells the candidates apart from any other filter.
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
    /// For FIRST and SECOND. THIRD takes the symmetric distances where the others do, but never blends pairs: it is the widest filter as it is, and without a colour
    /// term nothing would hold the blend back.
    pub weighting: Weighting,
}

/// A frame beside the one that is filtered, whose pixels take part as neighbours (thesis 8.6).
#[derive(Clone, Copy, Debug)]
pub struct CandidateBeside<'a> {
    /// Its colour signal.
    pub signal: &'a Buffer,
    /// The scaled variance of its colour.
    pub variance_of_mean: &'a Buffer,
    /// Its prefiltered features, the same ones in the same units.
    pub features: Option<&'a Features>,
}

/// The filtered candidates.
#[derive(Debug)]
pub struct Candidates {
    /// Signals of FIRST, SECOND and THIRD; Σ w in the w of the mean.
    pub signals: [Arc<Buffer>; 3],
    /// Three planes: dF_i/du_i per channel, of FIRST, SECOND and THIRD.
    pub derivatives: Arc<Buffer>,
}

impl Candidates {
    fn take(rec: &mut Recorder, extent: IVec2) -> Result<Self> {
        let signals = [
            Arc::new(rec.take("FIRST", plane_bytes(extent, 2))?),
            Arc::new(rec.take("SECOND", plane_bytes(extent, 2))?),
            Arc::new(rec.take("THIRD", plane_bytes(extent, 2))?),
        ];
        Ok(Self { signals, derivatives: Arc::new(rec.take("derivatives", plane_bytes(extent, 3))?) })
    }
}

/// Planes that candidates take.
pub(crate) const CANDIDATE_PLANES: u64 = 9;

/// The candidates of a window in time.
#[derive(Debug)]
pub struct CandidatesInTime {
    /// Over all frames.
    pub together: Candidates,
    /// Over the own frame, where there are others.
    pub alone: Option<Candidates>,
}

/// Filters a colour signal with the three candidates, over a window in its frame and in the frames `beside`. `variance_of_mean` is its scaled variance; without features
/// the feature weights are 1.
///
/// `progress` is called with the share of rows whose commands are recorded.
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn candidates(
    rec: &mut Recorder,
    extent: IVec2,
    signal: &Buffer,
    variance_of_mean: &Buffer,
    features: Option<&Features>,
    beside: &[CandidateBeside],
    filter: &CandidateFilter,
    schedule: Schedule,
    mut progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
) -> Result<CandidatesInTime> {
    let together = Candidates::take(rec, extent)?;
    let alone = (!beside.is_empty()).then(|| Candidates::take(rec, extent)).transpose()?;
    let neighbours: Vec<_> = beside.iter().map(|frame| Beside { signal: frame.signal, variance_of_mean: frame.variance_of_mean }).collect();
    let guide = Guide {
        small_patch_radius: Some(filter.first_patch_radius),
        beside: &neighbours,
        ..Guide::new(signal, variance_of_mean, 3, filter.color_k, filter.second_patch_radius)
    };
    let groups = features.map_or(0, |features| features.packing.groups);
    let [symmetric, hard] = filter.weighting.symmetric.definitions();
    let (first, second) = (filter.first_patch_radius as i32, filter.second_patch_radius as i32);
    let definitions = |other_frame: bool, near: bool| {
        [
            ("OTHER_FRAME", Definition::from(other_frame)),
            ("NEAR", near.into()),
            schedule.pixels_definition(),
            ("PATCH_RADIUS", Definition::Int(second)),
            ("SMALL_PATCH_RADIUS", Definition::Int(first)),
            ("FEATURE_GROUPS", Definition::Int(groups as i32)),
            symmetric,
            hard,
        ]
    };
    let candidate = CandidateParams {
        inverse_feature_k_squared: 1.0 / (filter.feature_k * filter.feature_k),
        feature_tau: filter.feature_tau,
        feature_tau_third: filter.feature_tau_third,
        triple_weights: features.map_or([Vec4::ZERO; MAX_GROUPS], |features| features.packing.triple_weights()),
    };
    let mut state = None;
    for_each_chunk(rec, extent, &guide, filter.window_radius, filter.weighting, schedule, |rec, chunk| {
        let params = chunk.params;
        // The first strip is the highest.
        let state = match &mut state {
            Some(state) => state,
            None => state.insert(rec.take("candidate sums", plane_bytes(IVec2::new(extent.x, params.rows), STATE_PLANES))?),
        };
        let beside = chunk.beside.map(|index| beside[index]);
        // Only in the nearest rows do patches hold pixels of their own pair; in a frame beside none does.
        let near = beside.is_none() && params.first_offset.y <= first.max(second);
        let accumulate = rec.gpu().kernel::<CandidateAccumulate>("candidate_accumulate", &definitions(beside.is_some(), near))?;
        let bound = CandidateAccumulate {
            params,
            candidate,
            columns: chunk.columns,
            signal,
            variance_of_mean,
            state,
            features: features.map(|features| &features.buffer),
            neighbours_signal: beside.map(|frame| frame.signal),
            neighbours_variance: beside.map(|frame| frame.variance_of_mean),
            neighbours_features: beside.and_then(|frame| frame.features).map(|features| &features.buffer),
        };
        rec.dispatch(&accumulate, &bound, schedule.per_row_of_pixels(extent, params.rows))?;
        // The sums over the own frame are whole before those over the others begin.
        let complete = if chunk.last { Some(&together) } else { alone.as_ref().filter(|_| beside.is_none() && chunk.ends_frame) };
        if let Some(Candidates { signals: [first, second, third], derivatives }) = complete {
            let resolve = rec.gpu().kernel::<CandidateResolve>("candidate_resolve", &[])?;
            let bound = CandidateResolve { params, signal, variance_of_mean, state, first, second, third, derivatives };
            rec.dispatch(&resolve, &bound, [extent.x as u32, params.rows as u32, 1])?;
        }
        if chunk.last {
            progress(rec, (params.first_row + params.rows) as f32 / extent.y as f32)?;
        }
        Ok(())
    })?;
    Ok(CandidatesInTime { together, alone })
}
