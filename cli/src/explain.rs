//! `--explain`: the steps of a method that run for a frame, the steps that are left out, with reasons, and the time of
//! each.

use serde::Serialize;
use stein::gpu::{StageTime, StepTime};
use stein::method::{Plan, PlannedStep};
use stein::text::milliseconds;

use super::out::{seconds, table};

/// A plan with the times of its steps.
#[derive(Debug, Serialize)]
pub(crate) struct Explained {
    /// Time that the host took to analyse the frames, in seconds.
    analysis_seconds: f64,
    strips: usize,
    rounds: usize,
    steps: Vec<ExplainedStep>,
}

#[derive(Debug, Serialize)]
struct ExplainedStep {
    #[serde(flatten)]
    planned: PlannedStep,
    /// Time on the device over all stages of the step, in seconds. `None` in a dry run, if the adapter cannot time
    /// stages, and for a step that is a part of other steps.
    seconds: Option<f64>,
    /// Share of the time of all steps, 0 to 1.
    share: Option<f64>,
    stages: Vec<StageTime>,
}

impl Explained {
    /// Explains a plan. `times` is `None` before the work.
    pub(crate) fn new(plan: &Plan, times: Option<&[StepTime]>) -> Self {
        let times = times.unwrap_or_default();
        let total: f64 = times.iter().map(|time| time.time.seconds).sum();
        let explain = |planned: &PlannedStep| {
            let name = &planned.name;
            let stages: Vec<StageTime> =
                times.iter().filter(|time| time.step == *name).map(|time| time.time.clone()).collect();
            let seconds = (!stages.is_empty()).then(|| stages.iter().map(|stage| stage.seconds).sum::<f64>());
            ExplainedStep {
                planned: planned.clone(),
                seconds,
                share: seconds.map(|seconds| seconds / total.max(f64::MIN_POSITIVE)),
                stages,
            }
        };
        Self {
            analysis_seconds: plan.analysis_seconds,
            strips: plan.strips,
            rounds: plan.rounds,
            steps: plan.steps().into_iter().map(explain).collect(),
        }
    }

    /// Formats a line for each step and, below it, a line for each stage if there are several.
    pub(crate) fn text(&self) -> String {
        let head = ["step", "", "why", "ms", "share", "skipped"].map(String::from).to_vec();
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let or_dash = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
        let mut rows = vec![head];
        for ExplainedStep { planned, seconds, share, stages } in &self.steps {
            let what = if planned.runs { "runs" } else { "left out" };
            rows.push(vec![
                planned.name.clone(),
                what.to_owned(),
                planned.why.clone(),
                or_dash(seconds.map(|seconds| milliseconds(seconds * 1e3))),
                or_dash(share.map(percent)),
                if planned.skipped > 0.0 { percent(planned.skipped) } else { String::new() },
            ]);
            if stages.len() > 1 {
                rows.extend(stages.iter().map(|stage| {
                    vec![format!("  {}", stage.stage), String::new(), String::new(), milliseconds(stage.seconds * 1e3)]
                }));
            }
        }
        let strips = if self.strips > 1 {
            format!("in {} strips", self.strips)
        } else {
            "in one piece, because it fits".to_owned()
        };
        let rounds = if self.rounds > 1 {
            format!(", in {} rounds, because the layers along do not fit together", self.rounds)
        } else {
            String::new()
        };
        format!("  looked at in {}; {strips}{rounds}\n{}", seconds(self.analysis_seconds), table(&rows, 3))
    }
}
