//! What of DFC a frame needs.

use super::{BY_CANDIDATE, DfcParams};
use crate::method::Intermediate;
use crate::method::plan::{Facts, Plan, Planner, Step, Wishes, impossible, needless};

/// The steps in the order of [`dfc`](super::dfc).
///
/// What is left out because the frame does not need it changes no bit of the result, but for two. A feature without noise is taken as it is: filtered, it would be an
/// average of values that differ by less than the distance that two pixels without variance are told apart by, √(25·3·7²·10⁻¹⁰) = 6·10⁻⁴ of the unit range. A frame
/// without noise is copied: FIRST and SECOND would move its colours by no more than that distance, √(25·3·(2f+1)²·10⁻¹⁰) at the order of 1, and the guard
/// keeps THIRD out wherever it would move them further.
pub(in crate::method) fn plan(params: &DfcParams, facts: &Facts, wishes: &Wishes) -> Plan {
    let mut plan = Planner::new(wishes);
    plan.variance(facts);

    for (name, why) in &facts.unused_features {
        plan.step(Step::Feature(name.clone()), "", &[impossible(true, why)]);
    }
    for feature in &facts.features {
        let unless = [impossible(!feature.noise_is_told, "nothing tells of noise in it"), needless(feature.noise_free, "no pixel has noise in it")];
        plan.step(Step::Prefilter(feature.name.clone()), "it has noise", &unless);
    }
    plan.step(Step::Features, "gradients and packing", &[impossible(facts.features.is_empty(), "there are none")]);

    // With the patches of SECOND it has the derivative of SECOND, below which its own must be.
    let kept = [Intermediate::Candidates, Intermediate::Derivatives, Intermediate::Sure].into_iter().any(|kept| wishes.keeps(kept));
    let second_beats_first = params.candidates.second && params.first_patch_radius == params.second_patch_radius && !kept;
    let mut candidates = 0;
    for (place, (name, takes_part)) in BY_CANDIDATE.into_iter().zip(params.candidates.flags()).enumerate() {
        let unless = [
            impossible(!takes_part, "the parameters leave it out"),
            needless(place == 0 && second_beats_first, "its patches are those of SECOND, so that it cannot win"),
        ];
        candidates += u32::from(plan.step(Step::Candidate(name), "it may win", &unless));
    }
    plan.step(Step::Candidates, "the result is made of them", &[]);
    let one_frame = impossible(facts.beside == 0, "there are no frames beside");
    plan.step(Step::Frames, "where they harm, frames beside are left out", &[one_frame, impossible(params.guard.is_none(), "there is no guard")]);

    // Without halves the density is made of what SURE says of the blend.
    let one = candidates == 1 && !wishes.keeps(Intermediate::Selection) && (facts.has_halves || !wishes.keeps(Intermediate::Density));
    let unwanted = one && !wishes.error && !wishes.keeps(Intermediate::Sure);
    let nothing_to_judge = || [needless(unwanted, "there is one candidate, and its error is not wanted")];
    plan.step(Step::Sure, "errors of the candidates", &nothing_to_judge());
    plan.step(Step::SureSmoothing, "the estimates are noisy", &nothing_to_judge());
    let nothing_to_choose = || [needless(one, "there is one candidate")];
    plan.step(Step::Selection, "the least error wins", &nothing_to_choose());
    plan.step(Step::SelectionSmoothing, "decisions are noisy", &nothing_to_choose());
    plan.step(Step::Blend, "by shares, under the guard if there is one", &nothing_to_choose());

    plan.step(Step::Density, "it is asked for", &[impossible(!wishes.keeps(Intermediate::Density), "it is not asked for")]);
    let unless = [
        impossible(params.second_pass.is_none(), "the parameters leave it out"),
        impossible(!facts.has_halves, "without halves nothing tells what noise is left"),
    ];
    plan.step(Step::SecondPass, "the halves tell what noise is left", &unless);

    let by_colour = params.candidates.first || params.candidates.second;
    if facts.noise_free && by_colour && params.guard.is_some() && wishes.keep.is_empty() && !wishes.everything {
        return plan.leave_all_out("no pixel has noise: the frame is copied");
    }
    plan.finish()
}
