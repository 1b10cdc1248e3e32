//! The kernels of DFC at a pixel: of the candidates, and of the second pass.

use std::sync::Arc;

use glam::{IVec2, UVec2};

use super::{BY_CANDIDATE, ColorOnly, DfcParams, Pass1, Pass2, Prepared, SECOND_ONLY, Wanted, Work, candidate_filter};
use crate::error::Result;
use crate::gpu::{Recorder, Run};
use crate::method::FrameInput;
use crate::method::estimate::{Keeper, Lane, Shares};
use crate::method::kernels::{Compared, KernelOnGpu, LimitOnGpu, ShareOnGpu, WeightRule, WeightsOnGpu};
use crate::method::plan::{Plan, Step};
use crate::stage::candidate_set::CandidateSet;
use crate::stage::exact::Region;
use crate::stage::feature::Features;
use crate::stage::nlm::{Guide, Schedule};
use crate::stage::variance::RESIDUAL_SMOOTHING;
use crate::stage::window::{NLM_DISTANCE, NLM_WEIGHT, WindowOfCandidates, candidate_window, nlm_window};

/// Kernels of the computed candidates, and of the second pass if it runs.
pub(in crate::method) fn kernels(
    rec: &mut Recorder,
    frame: FrameInput,
    pixel: IVec2,
    params: &DfcParams,
    plan: &Plan,
    schedule: Schedule,
) -> Result<Vec<KernelOnGpu>> {
    let work = Work { params, plan, schedule, wanted: Wanted::default() };
    if rec.is_dry() {
        return Ok(kernels_within(rec, frame, pixel, work)?.kernels);
    }
    // A dry run finds how far the kernels depend on what is made before them: no more of that is computed.
    let run = Run::dry(None);
    let mut dry = rec.gpu().record_in(&run);
    let twin = frame.dry(&mut dry)?;
    let Found { kernels, reach_of_features, reach_of_candidates } = kernels_within(&mut dry, twin, pixel, work)?;
    let reach = kernels.iter().map(KernelOnGpu::reach).fold(UVec2::ZERO, UVec2::max);
    let around = |reach: UVec2| Some(Region::around(pixel, reach.max_element(), frame.extent));
    let wanted = Wanted {
        // Packed features look at prefiltered ones around them.
        features: around(reach.saturating_sub(reach_of_features) + RESIDUAL_SMOOTHING.radius.max(1)),
        candidates: around(reach.saturating_sub(reach_of_candidates)),
        result: around(UVec2::ZERO),
    };
    Ok(kernels_within(rec, frame, pixel, Work { wanted, ..work })?.kernels)
}

/// The kernels, and how far what they are made of depends on the frame, if the run is dry.
struct Found {
    kernels: Vec<KernelOnGpu>,
    /// Of the packed features.
    reach_of_features: UVec2,
    /// Of the candidates; that of the kernels where no choice among them follows.
    reach_of_candidates: UVec2,
}

fn kernels_within(rec: &mut Recorder, frame: FrameInput, pixel: IVec2, work: Work) -> Result<Found> {
    let Work { params, plan, schedule, .. } = work;
    let extent = frame.extent;
    let names: Vec<String> = frame.features.iter().map(|feature| feature.name.clone()).collect();
    let mut keeper = Keeper::new(&[]);
    let mut prepared = Prepared::new(rec, frame, Vec::new(), work, &mut keeper)?;
    let reach_of_features = prepared.features.first().map_or(UVec2::ZERO, |features| features.buffer.reach());
    plan.begins(rec, Step::Candidates);
    let taking_part = plan.candidates();
    let mut kernels =
        kernels_of_candidates(rec, &prepared, prepared.features.first(), &names, taking_part, pixel, work)?;
    if !plan.runs(&Step::Selection) && !plan.runs(&Step::SecondPass) {
        // One candidate is the result.
        kernels.iter_mut().for_each(|kernel| kernel.share = Some(ShareOnGpu::Whole));
        let reach_of_candidates = kernels.iter().map(KernelOnGpu::reach).fold(UVec2::ZERO, UVec2::max);
        return Ok(Found { kernels, reach_of_features, reach_of_candidates });
    }

    let pass1 = Pass1::new(rec, &mut prepared, work, &mut keeper, |_, _| Ok(()))?;
    for (kernel, (candidate, _)) in kernels.iter_mut().zip(numbered(taking_part)) {
        kernel.share = Some(match &pass1.selection {
            Shares::Maps(maps) => ShareOnGpu::Lane(Lane { buffer: maps.clone(), plane: 0, component: candidate }),
            Shares::Only(_) => ShareOnGpu::Whole,
        });
    }
    let reach_of_candidates = pass1.candidates.first_of_all().map_or(UVec2::ZERO, |(_, first)| first.reach());
    if let Some(ColorOnly { shares, .. }) = &pass1.color_only {
        let share = || Some(ShareOnGpu::Lane(Lane { buffer: shares.clone(), plane: 0, component: 1 }));
        let second = kernels_of_candidates(rec, &prepared, None, &[], SECOND_ONLY, pixel, work)?;
        kernels.extend(second.into_iter().map(|kernel| KernelOnGpu { name: "color_only", share: share(), ..kernel }));
    }
    if let Some(pass2) = Pass2::new(rec, extent, &pass1.blend, &prepared.variance, work)? {
        let Pass2 { filter, left_variance, filtered, result } = pass2;
        let window_radius = filter.window_radius;
        let weights = if is_exact_at(pixel, plan, &Step::SecondPass) {
            WeightsOnGpu::Exact { window_radius }
        } else {
            let guide = Guide { grey: work.is_grey(), ..filter.guide(&pass1.blend, &left_variance, 3) };
            let cells = nlm_window(rec, extent, pixel, &guide, window_radius, params.weighting, schedule)?;
            WeightsOnGpu::Cells {
                cells: Arc::new(cells),
                window_radius,
                weight: NLM_WEIGHT,
                distances: vec![(Compared::Color { patch_radius: filter.patch_radius, k: filter.k }, NLM_DISTANCE)],
                rule: WeightRule::Least,
                centre: params.weighting.centre,
                limit: params.second_pass.and_then(|pass| pass.most_sigmas).map(|sigmas| LimitOnGpu {
                    filtered,
                    result,
                    sigmas,
                }),
            }
        };
        kernels.push(KernelOnGpu { name: "second_pass", averaged: pass1.blend, weights, share: None });
    }
    Ok(Found { kernels, reach_of_features, reach_of_candidates })
}

/// The candidates that take part, numbered from FIRST on.
fn numbered(taking_part: CandidateSet) -> impl Iterator<Item = (u32, &'static str)> {
    (0..)
        .zip(BY_CANDIDATE)
        .zip(taking_part.flags())
        .filter_map(|(candidate, takes_part)| takes_part.then_some(candidate))
}

/// Whether a step leaves this pixel as it is.
fn is_exact_at(pixel: IVec2, plan: &Plan, step: &Step) -> bool {
    plan.exact(step).is_some_and(|exact| exact.is_exact(&Region { first: pixel, size: IVec2::ONE }))
}

/// The kernels of the candidates in `taking_part`, whose weights depend on these features, called `names`.
fn kernels_of_candidates(
    rec: &mut Recorder,
    prepared: &Prepared,
    features: Option<&Features>,
    names: &[String],
    taking_part: CandidateSet,
    pixel: IVec2,
    work: Work,
) -> Result<Vec<KernelOnGpu>> {
    let Prepared { extent, color, variance, .. } = prepared;
    let Work { params, plan, schedule, .. } = work;
    let window_radius = params.window_radius;
    if is_exact_at(pixel, plan, &Step::Candidates) {
        let left = |(_, name)| KernelOnGpu {
            name,
            averaged: color.signal.clone(),
            weights: WeightsOnGpu::Exact { window_radius },
            share: None,
        };
        return Ok(numbered(taking_part).map(left).collect());
    }
    let filter = candidate_filter(params);
    let window = candidate_window(
        rec,
        *extent,
        pixel,
        &color.signal,
        variance,
        features,
        &filter,
        taking_part,
        work.is_grey(),
        schedule,
    )?;
    let cells = Arc::new(window.cells);
    let kernel = |(candidate, name): (u32, &'static str)| {
        let patch_radius =
            [Some(params.first_patch_radius), Some(params.second_patch_radius), None][candidate as usize];
        let of_color = patch_radius.map(|patch_radius| {
            (Compared::Color { patch_radius, k: params.color_k }, WindowOfCandidates::color(candidate))
        });
        let tau = if candidate == 2 { params.feature_tau_third } else { params.feature_tau };
        let slots = features.iter().flat_map(|features| &features.packing.slots);
        let of_features = names.iter().zip(slots).map(|(name, slot)| {
            (
                Compared::Feature { name: name.clone(), k: params.feature_k, tau },
                WindowOfCandidates::feature(candidate, *slot),
            )
        });
        let weights = WeightsOnGpu::Cells {
            cells: cells.clone(),
            window_radius,
            weight: WindowOfCandidates::weight(candidate),
            distances: of_color.into_iter().chain(of_features).collect(),
            rule: WeightRule::Least,
            centre: params.weighting.centre,
            limit: None,
        };
        KernelOnGpu { name, averaged: color.signal.clone(), weights, share: None }
    };
    Ok(numbered(taking_part).map(kernel).collect())
}
