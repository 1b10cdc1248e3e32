//! The candidate filters with their derivatives (thesis 8.2 to 8.4): any number of them, as few passes over the window
//! as they need.

use std::sync::Arc;

use glam::IVec2;

use super::candidate_filter::{CandidateFilter, CandidateParams, Pass, passes};
use super::exact::{ExactTiles, Region};
use super::feature::Features;
use super::frames::Frames;
use super::nlm::{Beside, ChunkNeeds, Guide, NlmParams, Schedule, Weighting, for_each_chunk};
use super::payload::{PAYLOAD_STEP, PayloadGroup, PayloadSums, payload_accumulate};
use super::plane_bytes;
use crate::error::{Error, Result};
use crate::gpu::{Buffer, Definition, Recorder, bindings, uniforms};

uniforms! {
    struct ResolveParams { sums: i32, candidate: i32 }
}

bindings! {
    struct CandidateAccumulate<'a> {
        uniform params: NlmParams, uniform candidate: CandidateParams,
        optional_around columns, around payload, around variance_of_mean, write state, optional_around features,
        optional_around neighbours_payload, optional_around neighbours_variance, optional_around neighbours_features,
    }
    struct CandidateResolve<'a> {
        uniform params: NlmParams, uniform resolve: ResolveParams, read payload, read variance_of_mean, read state,
        write means, write spreads, write derivatives,
    }
    struct CandidateResolveValue<'a> {
        uniform params: NlmParams, uniform resolve: ResolveParams, read payload, read variance_of_mean, read state,
        write means, write spreads,
    }
}

/// Planes of running sums that `candidate_accumulate` keeps per pixel of a strip in one pass: five for each of two
/// filters with patches of the colour, two for a filter without patches.
const SUM_PLANES: u32 = 12;

/// A frame of a window in time, as the candidates see it.
#[derive(Clone, Copy, Debug)]
pub struct CandidateFrame<'a> {
    /// Signal to average.
    pub payload: &'a Buffer,
    /// Another image whose patches are compared, in its first plane; `None` compares the mean of the payload.
    pub guide: Option<&'a Buffer>,
    /// Variance of the mean of the compared image, one plane.
    pub variance_of_mean: &'a Buffer,
    /// Prefiltered features, the same ones in the same units in all frames of a window. `None` gives all feature
    /// weights the value 1.
    pub features: Option<&'a Features>,
    /// Layers to average with the same weights, in the same groups in all frames of a window; mostly none.
    pub layers: &'a [PayloadGroup],
}

impl<'a> CandidateFrame<'a> {
    fn compared(&self) -> Beside<'a> {
        Beside { signal: self.guide.unwrap_or(self.payload), variance_of_mean: self.variance_of_mean }
    }

    /// Returns the guide by which a pass compares the colour.
    pub(super) fn guide(&self, pass: &Pass, grey: bool) -> Guide<'a> {
        let Beside { signal, variance_of_mean } = self.compared();
        Guide {
            small_patch_radius: pass.small_patch_radius(),
            grey,
            ..Guide::new(signal, variance_of_mean, 3, pass.color_k(), pass.patch_radius())
        }
    }
}

/// The window of the candidates, and how distances become weights.
#[derive(Clone, Copy, Debug)]
pub struct CandidateWindow {
    /// R: the window is 2R+1 pixels wide.
    pub radius: u32,
    /// Weighting of filters that compare the colour. Filters by the features alone take the symmetric distances where
    /// the others do, but never blend pairs: they are the widest filters already, and without a colour term nothing
    /// would limit the blend.
    pub weighting: Weighting,
}

/// Outputs of the candidates to compute.
#[derive(Clone, Copy, Debug)]
pub struct Needed<'a> {
    /// Whether to compute their derivatives. Weights that do not depend on the payload give 1/Σ w times the weight of
    /// the centre; other weights are differentiated by finite differences.
    pub derivatives: bool,
    /// Whether to compute their half spreads; without, half spreads are 0.
    pub half_spread: bool,
    /// Whether to compute them over the own frame alone, too, where there are frames beside.
    pub alone: bool,
    /// Whether the three channels of the colour differ in at least one frame.
    pub channels: bool,
    /// Tiles in which no pixel within reach has noise: there every candidate is the payload itself, with derivatives of
    /// 1.
    pub exact: Option<&'a ExactTiles>,
    /// Pixels to compute; the values of other pixels are arbitrary. `None` computes all pixels.
    pub wanted: Option<Region>,
}

impl Needed<'_> {
    /// All outputs, for all pixels.
    pub const EVERYTHING: Self =
        Self { derivatives: true, half_spread: true, alone: true, channels: true, exact: None, wanted: None };
}

/// The filtered candidates: a plane for each of them, in their order, in each of these buffers.
#[derive(Clone, Debug)]
pub struct Candidates {
    /// The filters.
    pub filters: Vec<CandidateFilter>,
    /// Means, with Σ w in w.
    pub means: Arc<Buffer>,
    /// Half spreads.
    pub spreads: Arc<Buffer>,
    /// dF_i/du_i per channel.
    pub derivatives: Option<Arc<Buffer>>,
    /// Σ w·(l_q − l_p) of each layer plane: for each group of layers a plane for each candidate and plane.
    pub payload: Vec<Arc<Buffer>>,
}

impl Candidates {
    fn take(
        rec: &mut Recorder,
        extent: IVec2,
        filters: &[CandidateFilter],
        has_derivatives: bool,
        layers: &[PayloadGroup],
    ) -> Result<Self> {
        let count = filters.len() as u32;
        let payload = layers.iter().map(|group| {
            let buffer = rec.take("sums of the payload", plane_bytes(extent, count * group.planes))?;
            Ok(Arc::new(buffer))
        });
        let payload = payload.collect::<Result<_>>()?;
        let bytes = plane_bytes(extent, count);
        let mut take = |label| Ok::<_, Error>(Arc::new(rec.take(label, bytes)?));
        Ok(Self {
            filters: filters.to_vec(),
            means: take("means of the candidates")?,
            spreads: take("half spreads of the candidates")?,
            derivatives: has_derivatives.then(|| take("derivatives")).transpose()?,
            payload,
        })
    }

    /// Returns the number of candidates.
    pub fn count(&self) -> usize {
        self.filters.len()
    }

    /// The definition of how many candidates there are.
    pub(super) fn definition(&self) -> (&'static str, Definition) {
        ("CANDIDATES", Definition::Int(self.count() as i32))
    }

    /// The derivatives, for a stage that needs them.
    ///
    /// # Errors
    /// [`Error::Shader`] where there are none.
    pub(super) fn derivatives_for(&self, stage: &str) -> Result<&Buffer> {
        self.derivatives.as_deref().ok_or_else(|| Error::Shader {
            stage: stage.into(),
            problem: "the candidates come without derivatives".into(),
        })
    }
}

/// Returns the number of planes that hold one number for each of this many candidates: four candidates share a plane,
/// one component for each.
pub const fn planes_of_numbers(candidates: usize) -> u32 {
    candidates.div_ceil(4) as u32
}

/// The candidates of a window in time.
#[derive(Debug)]
pub struct CandidatesInTime {
    /// Candidates over all frames.
    pub together: Candidates,
    /// Candidates over the own frame alone; `None` without frames beside, or if they were not requested.
    pub alone: Option<Candidates>,
}

/// Filters the payload of a frame with all `filters`, at least one, over a window in the frame and in the frames beside
/// it.
///
/// `progress` is called with the share of the work whose commands are recorded.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`], and the errors that `progress` returns.
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn candidates(
    rec: &mut Recorder,
    extent: IVec2,
    frames: &Frames<CandidateFrame>,
    filters: &[CandidateFilter],
    window: CandidateWindow,
    needed: Needed,
    schedule: Schedule,
    mut progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
) -> Result<CandidatesInTime> {
    let layers = frames.own.layers;
    let together = Candidates::take(rec, extent, filters, needed.derivatives, layers)?;
    let alone = !frames.beside.is_empty() && needed.alone;
    let alone = alone.then(|| Candidates::take(rec, extent, filters, needed.derivatives, layers)).transpose()?;
    let found = CandidatesInTime { together, alone };
    let passes = passes(filters);
    for (index, pass) in passes.iter().enumerate() {
        run_pass(rec, extent, frames, pass, window, needed, schedule, &found, |rec, done| {
            progress(rec, (index as f32 + done) / passes.len() as f32)
        })?;
    }
    if let Some(exact) = needed.exact {
        let tiles = exact.upload(rec, extent)?;
        for candidates in std::iter::once(&found.together).chain(&found.alone) {
            let count = candidates.count() as u32;
            for candidate in 0..count {
                tiles.copy_mean(rec, frames.own.payload, &candidates.means, candidate)?;
                tiles.copy_spread(rec, frames.own.payload, &candidates.spreads, candidate)?;
            }
            if let Some(derivatives) = &candidates.derivatives {
                tiles.fill(rec, derivatives, count, true)?;
            }
            for (group, sums) in layers.iter().zip(&candidates.payload) {
                tiles.fill(rec, sums, count * group.planes, false)?;
            }
        }
    }
    Ok(found)
}

/// Computes the filters of one pass.
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
fn run_pass(
    rec: &mut Recorder,
    extent: IVec2,
    frames: &Frames<CandidateFrame>,
    pass: &Pass,
    CandidateWindow { radius, weighting }: CandidateWindow,
    needed: Needed,
    schedule: Schedule,
    CandidatesInTime { together, alone }: &CandidatesInTime,
    mut progress: impl FnMut(&mut Recorder, f32) -> Result<()>,
) -> Result<()> {
    let own = &frames.own;
    let neighbours: Vec<_> = frames.beside.iter().map(CandidateFrame::compared).collect();
    let Needed { exact, wanted, .. } = needed;
    let guide = Guide { beside: &neighbours, exact, wanted, ..own.guide(pass, !needed.channels) };
    let patch_radius = guide.patch_radius;
    let features = own.features.filter(|_| pass.by_features());
    let groups = features.map_or(0, |features| features.packing.groups);
    // Weights that come from another image do not change with the payload.
    let other_guide = own.guide.is_some();
    let differences = needed.derivatives && !other_guide;
    let has_layers = !own.layers.is_empty();
    // The kernel for the nearest rows is the larger one. With as many pixels as the other kernel, a driver takes 3.6 s
    // to compile it; with half of them, 1.2 s, and the kernel is 16 % slower for a third of the offsets.
    let blocking = |near: bool| Schedule {
        pixels: if near && schedule.pixels.is_multiple_of(2) { schedule.pixels / 2 } else { schedule.pixels },
        ..schedule
    };
    let [symmetric, hard] = weighting.symmetric.definitions();
    let definitions = |other_frame: bool, near: bool| {
        let of_all = [
            ("OTHER_FRAME", Definition::from(other_frame)),
            ("NEAR", near.into()),
            blocking(near).pixels_definition(),
            ("DERIVATIVES", differences.into()),
            ("HALVES", needed.half_spread.into()),
            ("GREY", guide.grey.into()),
            ("WEIGHTS", has_layers.into()),
            ("FEATURE_GROUPS", Definition::Int(groups as i32)),
            symmetric,
            hard,
        ];
        [&of_all[..], &pass.definitions()].concat()
    };
    let candidate = pass.params(features);
    let mut state: Option<Buffer> = None;
    let weight_values = if has_layers { pass.weight_values() } else { 0 };
    let needs = ChunkNeeds { distances: pass.by_color(), sum_planes: SUM_PLANES, pair_values: weight_values };
    for_each_chunk(rec, extent, &guide, needs, radius, weighting, schedule, |rec, chunk| {
        let params = chunk.params;
        if params.starts != 0 {
            // Gives this buffer back before the next one is taken.
            state = None;
        }
        let state = match &mut state {
            Some(state) => state,
            None => {
                let of_weights = u64::from(weight_values) * chunk.most_pair_bytes;
                let bytes = plane_bytes(IVec2::new(params.width, params.rows), SUM_PLANES) + of_weights;
                state.insert(rec.take("candidate sums", bytes)?)
            }
        };
        let beside = chunk.beside.map(|index| frames.beside[index]);
        // Patches hold pixels of their own pair only in the nearest rows, and never in a frame beside.
        let near = beside.is_none() && params.first_offset.y <= patch_radius as i32;
        let (payload, variance_of_mean) = (own.payload, own.variance_of_mean);
        let bound = CandidateAccumulate {
            params,
            candidate,
            columns: pass.by_color().then(|| chunk.columns.within_columns_and_rows(patch_radius, 0)),
            payload: payload.within(radius),
            variance_of_mean: variance_of_mean.within(radius),
            state,
            features: features.map(|features| features.buffer.within(radius)),
            neighbours_payload: beside.map(|frame| frame.payload.within(radius)),
            neighbours_variance: beside.map(|frame| frame.variance_of_mean.within(radius)),
            neighbours_features: beside
                .and_then(|frame| frame.features.filter(|_| pass.by_features()))
                .map(|features| features.buffer.within(radius)),
        };
        rec.dispatch(
            "candidate_accumulate",
            &definitions(beside.is_some(), near),
            &bound,
            blocking(near).per_row_of_pixels(&params),
        )?;
        // The sums over the own frame are complete before the sums over the other frames begin.
        let ends_own_frame = beside.is_none() && chunk.ends_frame;
        if has_layers {
            let layers = own.layers;
            let sums_alone = alone.as_ref().filter(|_| ends_own_frame).map(|alone| &alone.payload[..]);
            let neighbours = beside.map_or(layers, |frame| frame.layers);
            let sums = PayloadSums { together: &together.payload, alone: sums_alone };
            rec.in_step(PAYLOAD_STEP, |rec| {
                payload_accumulate(rec, chunk, pass, state, [layers, neighbours], sums, radius, schedule)
            })?;
        }
        let complete = if chunk.last { Some(together) } else { alone.as_ref().filter(|_| ends_own_frame) };
        if let Some(complete) = complete {
            for (sums, place) in [pass.small, pass.large, pass.alone].into_iter().enumerate() {
                let Some(place) = place else { continue };
                let resolve = ResolveParams { sums: sums as i32, candidate: place as i32 };
                let definitions = [
                    ("FEATURES_ALONE", (pass.alone == Some(place)).into()),
                    ("DERIVATIVES", needed.derivatives.into()),
                    ("OTHER_GUIDE", (needed.derivatives && other_guide).into()),
                ];
                let invocations = [params.width as u32, params.rows as u32, 1];
                let Candidates { means, spreads, derivatives, .. } = complete;
                match derivatives {
                    Some(derivatives) => {
                        let bound = CandidateResolve {
                            params,
                            resolve,
                            payload,
                            variance_of_mean,
                            state,
                            means,
                            spreads,
                            derivatives,
                        };
                        rec.dispatch("candidate_resolve", &definitions, &bound, invocations)?;
                    }
                    None => {
                        let bound =
                            CandidateResolveValue { params, resolve, payload, variance_of_mean, state, means, spreads };
                        rec.dispatch("candidate_resolve", &definitions, &bound, invocations)?;
                    }
                }
            }
        }
        if chunk.last {
            progress(rec, chunk.done)?;
        }
        Ok(())
    })
}
