//! Plan of DFC: the steps that a frame needs.

use super::{DfcParams, PREFILTER, reach_of_choice};
use crate::method::plan::{Facts, PlannedStep, Planner, Wishes, impossible, method_plan, needless};
use crate::method::{Intermediate, Method, MethodPlan};

method_plan! {
    /// Plan of DFC.
    pub struct DfcPlan of DfcParams {
        /// Features that are not used.
        unused_features: Vec<PlannedStep>,
        /// Estimates of variances that the frame lacks, and pooling of given ones. `None` if there are none to pool.
        noise: Option<PlannedStep>,
        /// Prefiltering of each feature that is used (Algorithm 1 lines 4 to 10).
        prefilters: Vec<PlannedStep>,
        /// Gradients of the features, and their packing.
        features: PlannedStep,
        /// Spikes taken out of the colour.
        spikes: PlannedStep,
        /// The variance of the colour's mean that the filters use (thesis 8.2).
        variance: PlannedStep,
        /// The candidates, in the order of [`DfcParams::filters`].
        filters: Vec<PlannedStep>,
        /// Filters that the result is chosen from, over all frames of the window.
        candidates: PlannedStep,
        /// Candidates over the own frame alone, too; frames beside are left out of pixels that they harm.
        frames: PlannedStep,
        /// Derivatives of the candidates.
        derivatives: PlannedStep,
        /// Half spreads of the candidates.
        half_spread: PlannedStep,
        /// All three channels of the colour; without it one channel stands for all.
        channels: PlannedStep,
        /// SURE of the candidates (eq. 8.5).
        sure: PlannedStep,
        /// Smoothing of SURE (lines 18 to 22).
        sure_smoothing: PlannedStep,
        /// Binary selection maps (lines 23 to 26).
        selection: PlannedStep,
        /// Smoothing of the selection maps (lines 27 to 31).
        selection_smoothing: PlannedStep,
        /// Averaging of the candidates (lines 32 and 33).
        blend: PlannedStep,
        /// A filter by the colour only, where features are without noise.
        color_only: PlannedStep,
        /// The filter of the noise that pass 1 leaves (lines 34 to 37).
        second_pass: PlannedStep,
        /// The estimated error of the result.
        error: PlannedStep,
        /// Sampling density: where the next samples reduce the error most (thesis 8.6).
        density: PlannedStep,
        /// Layers filtered along with the colour; `None` if the frame has none.
        payload: Option<PlannedStep>,
        /// Pixels without noise put back.
        keep_clean: PlannedStep,
    }
}

/// Plans [`dfc`](super::dfc).
///
/// A step that is left out because the frame does not need it changes no bit of the result, except for input without
/// noise:
///
/// * A feature without noise is used as it is, and so are exact tiles of a feature, from which no pixel with noise is
///   within reach. The filter would average values that differ by less than the distance at which two pixels without
///   variance are told apart, √(25·3·7²·10⁻¹⁰) = 6·10⁻⁴ of the unit range.
/// * A frame without noise is copied, and so are exact tiles. FIRST and SECOND would move their colours by no more than
///   √(25·3·(2f+1)²·10⁻¹⁰) at the order of 1. The guard keeps THIRD out wherever it would move them further: without
///   variance nothing happens by chance, so that only the candidates with the least SURE, (F − u)², have a share. A
///   second pass with a limit changes nothing where there is no noise.
pub(in crate::method) fn plan(params: &DfcParams, facts: &Facts, wishes: &Wishes) -> MethodPlan {
    let planner = Planner::new(wishes);
    let pooling = Method::from(*params).pooling();
    let unused = facts.unused_features.iter();
    let unused_features =
        unused.map(|(name, why)| planner.step(format!("feature {name}"), "", &[impossible(true, why)])).collect();
    let prefilters = facts.features.iter().map(|feature| {
        let unless = [
            impossible(!feature.noise_is_told, "nothing tells of noise in it"),
            needless(feature.is_noise_free(), "no pixel has noise in it"),
        ];
        let reach = PREFILTER.window_radius + PREFILTER.patch_radius;
        planner
            .step(format!("prefilter {}", feature.name), "it has noise", &unless)
            .but_for(planner.skipping(facts.exact_feature(feature, reach)).as_ref())
    });
    let prefilters = prefilters.collect();
    let no_features = [impossible(facts.features.is_empty(), "there are none")];

    // Around an exact tile, nothing within the reach of the candidates has noise. The reach also covers the smoothing
    // that follows, so that no pixel near noise reads values that were not computed. Intermediates differ there.
    let by_colour = params.filters().iter().any(|(filter, takes_part)| *takes_part && filter.color.is_some());
    let keeps_only = |allowed: &[Intermediate]| wishes.keep.iter().all(|kept| allowed.contains(kept));
    let may_copy = by_colour
        && params.guard.is_some()
        && keeps_only(&[Intermediate::Spikes, Intermediate::Variance, Intermediate::Features, Intermediate::Pass1]);
    let reach = params.window_radius + params.largest_patch_radius() + reach_of_choice();
    let exact = planner.skipping(if may_copy { facts.exact_color(reach) } else { None });

    let kept = [Intermediate::Candidates, Intermediate::Derivatives, Intermediate::Sure]
        .into_iter()
        .any(|kept| wishes.keeps(kept));
    let second_beats_first = params.first_cannot_win() && !kept;
    let filters = params.filters().into_iter().enumerate().map(|(place, (filter, takes_part))| {
        let unless = [
            impossible(!takes_part, "the parameters leave it out"),
            needless(place == 0 && second_beats_first, "its patches are those of SECOND, so that it cannot win"),
        ];
        planner.step(filter.name, "it may win", &unless)
    });
    let filters: Vec<_> = filters.collect();
    let candidates = filters.iter().filter(|filter| filter.runs).count();
    let guard = [
        impossible(facts.beside == 0, "there are no frames beside"),
        impossible(params.guard.is_none(), "there is no guard"),
    ];
    let frames = planner.step("frames that harm", "where they harm, frames beside are left out", &guard);

    let one = candidates == 1 && !wishes.keeps(Intermediate::Selection);
    let unwanted = one && !wishes.keeps(Intermediate::Sure);
    // Without halves, the density is made of the error.
    let needs_error = wishes.error || (!facts.has_halves && wishes.keeps(Intermediate::Density));
    let reasons = [
        (!unwanted, "SURE needs them"),
        (needs_error, "the error is made of them"),
        (frames.runs, "frames beside are judged by them"),
        (wishes.keeps(Intermediate::Derivatives), "they are asked for"),
    ];
    let because = reasons.iter().find_map(|(holds, because)| holds.then_some(*because));
    let nobody = [needless(because.is_none(), "neither SURE nor the error is wanted")];
    let no_halves = [impossible(!facts.has_halves, "there are no halves")];
    let grey = [needless(facts.grey, "all are the same: the work of one stands for all")];
    let nothing_to_judge = [needless(unwanted, "there is one candidate")];
    let nothing_to_choose = [needless(one, "there is one candidate")];
    let no_edges = [
        impossible(!params.color_only, "the parameters leave it out"),
        impossible(!has_features_without_noise(facts), "no feature is without noise"),
        impossible(one, "there is one candidate"),
    ];
    let no_second_pass = [
        impossible(params.second_pass.is_none(), "the parameters leave it out"),
        impossible(!facts.has_halves, "without halves nothing tells what noise is left"),
    ];
    let limited = params.second_pass.is_some_and(|pass| pass.most_sigmas.is_some());
    let error = "what the halves, the candidates and the pixel's own weight show";
    let unasked = [impossible(!wishes.keeps(Intermediate::Density), "it is not asked for")];
    let by_shares = "by shares, under the guard if there is one";
    let own_edges = "features without noise may have edges that the colour lacks";

    let plan = DfcPlan {
        params: *params,
        keep: wishes.keep.to_vec(),
        unused_features,
        noise: planner.noise(pooling, facts),
        prefilters,
        features: planner.step("features", "gradients and packing", &no_features),
        spikes: planner.spikes(params.spikes, facts),
        variance: planner.variance(pooling, facts),
        filters,
        candidates: planner.step("candidates", "the result is made of them", &[]).but_for(exact.as_ref()),
        frames: frames.beside_kernels(),
        derivatives: planner.step("derivatives", because.unwrap_or_default(), &nobody).beside_kernels(),
        half_spread: planner.step("half spread", "the halves are filtered along", &no_halves).beside_kernels(),
        channels: planner.step("three channels", "they differ", &grey).beside_kernels(),
        sure: planner.step("SURE", "errors of the candidates", &nothing_to_judge).beside_kernels(),
        sure_smoothing: planner
            .step("SURE smoothing", "the estimates are noisy", &nothing_to_judge)
            .but_for(exact.as_ref())
            .beside_kernels(),
        selection: planner.step("selection", "the least error wins", &nothing_to_choose).beside_kernels(),
        selection_smoothing: planner
            .step("selection smoothing", "decisions are noisy", &nothing_to_choose)
            .but_for(exact.as_ref())
            .beside_kernels(),
        blend: planner.step("blend", by_shares, &nothing_to_choose).beside_kernels(),
        color_only: planner.step("colour only", own_edges, &no_edges),
        second_pass: planner
            .step("second pass", "the halves tell what noise is left", &no_second_pass)
            .but_for(exact.as_ref().filter(|_| limited)),
        error: planner.step("error", error, &[needless(!needs_error, "it is not wanted")]).beside_kernels(),
        density: planner.step("sampling density", "it is asked for", &unasked).beside_kernels(),
        payload: planner.payload(facts),
        keep_clean: planner.keep_clean(params.keep_clean),
    };
    let plan = MethodPlan::Dfc(Box::new(plan));
    if facts.is_noise_free() && may_copy && wishes.keep.is_empty() && !wishes.everything {
        return plan.leave_all_out("no pixel has noise: the frame is copied");
    }
    plan
}

/// Returns whether some feature has edges as sharp as its pixels: none of its pixels has noise, or its noise is
/// unknown.
pub(super) fn has_features_without_noise(facts: &Facts) -> bool {
    facts.features.iter().any(|feature| !feature.noise_is_told || feature.is_noise_free())
}
