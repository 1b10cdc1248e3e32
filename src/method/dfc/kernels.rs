//! The kernels of DFC at a pixel: the kernels of the candidates and of the second pass.

use std::sync::Arc;

use glam::{IVec2, UVec2};

use super::{
    ColorOnly, DfcPlan, Pass1, Pass2, Prepared, PreparedFrame, Wanted, Work, color_only_filter, planned_filters,
    shares_by_name,
};
use crate::error::Result;
use crate::gpu::{Recorder, Run};
use crate::method::FrameInput;
use crate::method::estimate::{Keeper, Lane, Share};
use crate::method::kernels::{Compared, KernelOnGpu, LimitOnGpu, WeightRule, WeightsOnGpu};
use crate::method::plan::PlannedStep;
use crate::stage::candidate_filter::{ByColor, ByFeatures, CandidateFilter};
use crate::stage::exact::Region;
use crate::stage::frames::Frames;
use crate::stage::nlm::{Guide, Schedule};
use crate::stage::variance::RESIDUAL_SMOOTHING;
use crate::stage::window::{NLM_DISTANCE, NLM_WEIGHT, WindowOfCandidate, candidate_window, nlm_window};

/// Returns the kernels of the computed candidates, and of the second pass if it runs.
pub(in crate::method) fn kernels(
    rec: &mut Recorder,
    frame: FrameInput,
    pixel: IVec2,
    plan: &DfcPlan,
    schedule: Schedule,
) -> Result<Vec<KernelOnGpu>> {
    let work = Work { params: &plan.params, plan, schedule, wanted: Wanted::default() };
    if rec.is_dry() {
        return Ok(kernels_within(rec, frame, pixel, work)?.kernels);
    }
    // A dry run finds how far the kernels depend on the features and on the candidates; only these regions are
    // computed.
    let run = Run::dry(None);
    let mut dry = rec.gpu().record_in(&run);
    let twin = frame.dry(&mut dry)?;
    let Found { kernels, reach_of_features, reach_of_candidates } = kernels_within(&mut dry, twin, pixel, work)?;
    let reach = kernels.iter().map(KernelOnGpu::reach).fold(UVec2::ZERO, UVec2::max);
    let around = |reach: UVec2| Some(Region::around(pixel, reach.max_element(), frame.extent));
    let wanted = Wanted {
        // Packing a feature reads its prefiltered neighbours.
        features: around(reach.saturating_sub(reach_of_features) + RESIDUAL_SMOOTHING.radius.max(1)),
        candidates: around(reach.saturating_sub(reach_of_candidates)),
        result: around(UVec2::ZERO),
    };
    Ok(kernels_within(rec, frame, pixel, Work { wanted, ..work })?.kernels)
}

/// Kernels, and in a dry run the reaches of the data that they are made of.
struct Found {
    kernels: Vec<KernelOnGpu>,
    /// Reach of the packed features.
    reach_of_features: UVec2,
    /// Reach of the candidates. It is the reach of the kernels where the plan makes no choice among the candidates.
    reach_of_candidates: UVec2,
}

fn kernels_within(rec: &mut Recorder, frame: FrameInput, pixel: IVec2, work: Work) -> Result<Found> {
    let Work { params, plan, schedule, .. } = work;
    let extent = frame.extent;
    let names: Vec<String> = frame.features.iter().map(|feature| feature.name.clone()).collect();
    let mut keeper = Keeper::new(&[]);
    let mut prepared = Prepared::new(rec, Frames::one(frame), work, &mut keeper)?;
    let reach_of_features = prepared.own.features.as_ref().map_or(UVec2::ZERO, |features| features.buffer.reach());
    plan.candidates.begin(rec);
    let filters = planned_filters(plan);
    let mut kernels = kernels_of_candidates(rec, extent, &prepared.own, &names, &filters, pixel, work)?;
    if !plan.selection.runs && !plan.second_pass.runs {
        // The only candidate is the result.
        kernels.iter_mut().for_each(|kernel| kernel.share = Some(Share::Whole));
        let reach_of_candidates = kernels.iter().map(KernelOnGpu::reach).fold(UVec2::ZERO, UVec2::max);
        return Ok(Found { kernels, reach_of_features, reach_of_candidates });
    }

    let pass1 = Pass1::new(rec, &mut prepared, work, &mut keeper, |_, _| Ok(()))?;
    for (name, share) in shares_by_name(params, &pass1.candidates, pass1.selection.as_ref()) {
        kernels.iter_mut().filter(|kernel| kernel.name == name).for_each(|kernel| kernel.share = Some(share.clone()));
    }
    let reach_of_candidates = pass1.candidates.means.reach().max(pass1.candidates.spreads.reach());
    if let Some(ColorOnly { shares, .. }) = &pass1.color_only {
        let share = Share::Lane(Lane { buffer: shares.clone(), plane: 0, component: 0 });
        let filters = [color_only_filter(params)];
        let kernel = kernels_of_candidates(rec, extent, &prepared.own, &[], &filters, pixel, work)?;
        kernels.extend(kernel.into_iter().map(|kernel| KernelOnGpu { share: Some(share.clone()), ..kernel }));
    }
    if let Some(pass2) = Pass2::new(rec, extent, &pass1.blend, &mut Vec::new(), &prepared.own.variance, work)? {
        let Pass2 { filter, left_variance, filtered, result, .. } = pass2;
        let window_radius = filter.window_radius;
        let weights = if is_exact_at(pixel, &plan.second_pass) {
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

/// Returns whether a step leaves this pixel as it is.
fn is_exact_at(pixel: IVec2, step: &PlannedStep) -> bool {
    step.exact.as_ref().is_some_and(|exact| exact.is_exact(&Region { first: pixel, size: IVec2::ONE }))
}

/// Returns the kernels of these filters; `names` are the names of the features.
fn kernels_of_candidates(
    rec: &mut Recorder,
    extent: IVec2,
    frame: &PreparedFrame,
    names: &[String],
    filters: &[CandidateFilter],
    pixel: IVec2,
    work: Work,
) -> Result<Vec<KernelOnGpu>> {
    let Work { params, plan, schedule, .. } = work;
    let (window_radius, averaged) = (params.window_radius, &frame.color.signal);
    if is_exact_at(pixel, &plan.candidates) {
        let left = |filter: &CandidateFilter| KernelOnGpu {
            name: filter.name,
            averaged: averaged.clone(),
            weights: WeightsOnGpu::Exact { window_radius },
            share: None,
        };
        return Ok(filters.iter().map(left).collect());
    }
    let (of_frame, window, grey) = (frame.candidate_frame(), params.window(), work.is_grey());
    let windows = candidate_window(rec, extent, pixel, &of_frame, filters, window, grey, schedule)?;
    let kernel = |(filter, window): (&CandidateFilter, WindowOfCandidate)| {
        let of_color = filter
            .color
            .zip(window.color())
            .map(|(ByColor { k, patch_radius }, lanes)| (Compared::Color { patch_radius, k }, lanes));
        let slots = frame.features.iter().flat_map(|features| &features.packing.slots);
        let of_features = filter.features.iter().flat_map(|ByFeatures { k, tau }| {
            names
                .iter()
                .zip(slots.clone())
                .map(|(name, slot)| (Compared::Feature { name: name.clone(), k: *k, tau: *tau }, window.feature(*slot)))
        });
        let weights = WeightsOnGpu::Cells {
            cells: window.cells.clone(),
            window_radius,
            weight: window.weight(),
            distances: of_color.into_iter().chain(of_features).collect(),
            rule: WeightRule::Least,
            centre: params.weighting.centre,
            limit: None,
        };
        KernelOnGpu { name: filter.name, averaged: averaged.clone(), weights, share: None }
    };
    Ok(filters.iter().zip(windows).map(kernel).collect())
}
