//! What of DFC a frame needs.

use super::{DfcParams, PREFILTER, reach_of_choice};
use crate::method::Intermediate;
use crate::method::plan::{Facts, Plan, Planner, Step, Wishes, impossible, needless};

/// The steps in the order of [`dfc`](super::dfc).
///
/// Steps that are left out because the frame does not need them change no bit of the result, except for input without
/// noise:
///
/// * A feature without noise is taken as it is, and so are tiles of a feature from which no pixel with noise is within
///   reach. Filtered, a value would become an average of values that differ by less than the distance that two pixels
///   without variance are told apart by, √(25·3·7²·10⁻¹⁰) = 6·10⁻⁴ of the unit range.
/// * A frame without noise is copied, and so are tiles from which no pixel with noise is within reach. FIRST and SECOND
///   would move their colours by no more than that distance, √(25·3·(2f+1)²·10⁻¹⁰) at the order of 1, and the guard
///   keeps THIRD out wherever it would move them further: without variance nothing happens by chance, so that only the
///   candidates with the least SURE, (F − u)², have a share. A second pass with a limit changes nothing where there is
///   no noise.
pub(in crate::method) fn plan(params: &DfcParams, facts: &Facts, wishes: &Wishes) -> Plan {
    let mut plan = Planner::new(wishes);
    for (name, why) in &facts.unused_features {
        plan.step(Step::Feature(name.clone()), "", &[impossible(true, why)]);
    }
    plan.noise(params.pooling(), facts);
    for feature in &facts.features {
        let unless = [
            impossible(!feature.noise_is_told, "nothing tells of noise in it"),
            needless(feature.is_noise_free(), "no pixel has noise in it"),
        ];
        plan.step(Step::Prefilter(feature.name.clone()), "it has noise", &unless);
        plan.but_for(facts.exact_feature(feature, PREFILTER.window_radius + PREFILTER.patch_radius).as_ref());
    }
    plan.step(Step::Features, "gradients and packing", &[impossible(facts.features.is_empty(), "there are none")]);

    params.spikes.plan(&mut plan, facts);
    plan.variance(params.pooling(), facts);

    // Beyond the reach of the candidates nothing has noise, and beyond that of the smoothing that follows nothing reads
    // what was not computed. The intermediates are others there.
    let filters = params.filters();
    let by_colour = filters.iter().any(|(filter, takes_part)| *takes_part && filter.color.is_some());
    let keeps_only = |allowed: &[Intermediate]| wishes.keep.iter().all(|kept| allowed.contains(kept));
    let may_copy = by_colour
        && params.guard.is_some()
        && keeps_only(&[Intermediate::Spikes, Intermediate::Variance, Intermediate::Features, Intermediate::Pass1]);
    let exact = if may_copy {
        facts.exact_color(params.window_radius + params.largest_patch_radius() + reach_of_choice())
    } else {
        None
    };

    let kept = [Intermediate::Candidates, Intermediate::Derivatives, Intermediate::Sure]
        .into_iter()
        .any(|kept| wishes.keeps(kept));
    let second_beats_first = params.first_cannot_win() && !kept;
    let mut candidates = 0;
    for (place, (filter, takes_part)) in filters.into_iter().enumerate() {
        let unless = [
            impossible(!takes_part, "the parameters leave it out"),
            needless(place == 0 && second_beats_first, "its patches are those of SECOND, so that it cannot win"),
        ];
        candidates += u32::from(plan.step(Step::Candidate(filter.name), "it may win", &unless));
    }
    plan.step(Step::Candidates, "the result is made of them", &[]);
    plan.but_for(exact.as_ref());
    let one_frame = impossible(facts.beside == 0, "there are no frames beside");
    let no_guard = impossible(params.guard.is_none(), "there is no guard");
    let judges_frames = plan.step(Step::Frames, "where they harm, frames beside are left out", &[one_frame, no_guard]);

    let one = candidates == 1 && !wishes.keeps(Intermediate::Selection);
    let unwanted = one && !wishes.keeps(Intermediate::Sure);
    // Without halves the density is made of it.
    let needs_error = wishes.error || (!facts.has_halves && wishes.keeps(Intermediate::Density));
    let reasons = [
        (!unwanted, "SURE needs them"),
        (needs_error, "the error is made of them"),
        (judges_frames, "frames beside are judged by them"),
        (wishes.keeps(Intermediate::Derivatives), "they are asked for"),
    ];
    let because = reasons.iter().find_map(|(holds, because)| holds.then_some(*because));
    plan.step(
        Step::Derivatives,
        because.unwrap_or_default(),
        &[needless(because.is_none(), "neither SURE nor the error is wanted")],
    );
    plan.step(
        Step::HalfSpread,
        "the halves are filtered along",
        &[impossible(!facts.has_halves, "there are no halves")],
    );
    plan.step(
        Step::Channels,
        "they differ",
        &[needless(facts.grey, "all are the same: the work of one stands for all")],
    );
    let nothing_to_judge = || [needless(unwanted, "there is one candidate")];
    plan.step(Step::Sure, "errors of the candidates", &nothing_to_judge());
    plan.step(Step::SureSmoothing, "the estimates are noisy", &nothing_to_judge());
    plan.but_for(exact.as_ref());
    let nothing_to_choose = || [needless(one, "there is one candidate")];
    plan.step(Step::Selection, "the least error wins", &nothing_to_choose());
    plan.step(Step::SelectionSmoothing, "decisions are noisy", &nothing_to_choose());
    plan.but_for(exact.as_ref());
    plan.step(Step::Blend, "by shares, under the guard if there is one", &nothing_to_choose());
    let unless = [
        impossible(!params.color_only, "the parameters leave it out"),
        impossible(!has_features_without_noise(facts), "no feature is without noise"),
        impossible(one, "there is one candidate"),
    ];
    plan.step(Step::ColorOnly, "features without noise may have edges that the colour lacks", &unless);

    let unless = [
        impossible(params.second_pass.is_none(), "the parameters leave it out"),
        impossible(!facts.has_halves, "without halves nothing tells what noise is left"),
    ];
    plan.step(Step::SecondPass, "the halves tell what noise is left", &unless);
    plan.but_for(exact.as_ref().filter(|_| params.second_pass.is_some_and(|pass| pass.most_sigmas.is_some())));
    plan.step(
        Step::Error,
        "what the halves, the candidates and the pixel's own weight show",
        &[needless(!needs_error, "it is not wanted")],
    );
    plan.step(
        Step::Density,
        "it is asked for",
        &[impossible(!wishes.keeps(Intermediate::Density), "it is not asked for")],
    );

    plan.keep_clean(params.keep_clean);

    if facts.is_noise_free() && may_copy && wishes.keep.is_empty() && !wishes.everything {
        return plan.leave_all_out("no pixel has noise: the frame is copied");
    }
    plan.finish()
}

/// Whether the edges of some feature are as sharp as its pixels: none of them has noise, or nothing tells.
pub(super) fn has_features_without_noise(facts: &Facts) -> bool {
    facts.features.iter().any(|feature| !feature.noise_is_told || feature.is_noise_free())
}
