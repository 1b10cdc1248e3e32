//! Compares two runs, result by result, to find where adapters differ.

use std::path::Path;

use serde::Serialize;

use super::super::Failure;
use super::super::bench::Adapter;
use super::super::document::{self, Kind};
use super::super::out::{number, table};
use super::checks::Summary;
use super::{Document, SCHEMA, VERSION};

/// Comparison of this run with another one.
#[derive(Debug, Serialize)]
pub(super) struct Comparison {
    other_adapter: Adapter,
    /// Number of results that both runs have; `same` of them are the same to the bit.
    compared: usize,
    same: usize,
    /// Results that differ.
    different: Vec<Difference>,
    /// Results that one of the two lacks.
    missing: Vec<String>,
}

/// Relative differences; infinite, which JSON shows as null, if one of the two has no finite value.
#[derive(Debug, Serialize)]
struct Difference {
    case: String,
    method: String,
    /// Difference of the colour's mean, relative to its root mean square.
    mean: f64,
    /// Difference of the root mean square.
    root_mean_square: f64,
    /// Difference of the least or of the largest value, whichever is greater, relative to the largest magnitude.
    extremes: f64,
    /// Difference of the mean estimated error.
    error: f64,
    /// Difference of the mean number of pixels that took part.
    weight_sum: f64,
    /// Whether only one of the two is within bounds.
    verdicts_differ: bool,
}

impl Difference {
    fn new(case: &str, method: &str, here: &Summary, there: &Summary, verdicts_differ: bool) -> Self {
        let relative = |a: Option<f64>, b: Option<f64>, size: Option<f64>| match (a, b, size) {
            _ if a == b => 0.0,
            (Some(a), Some(b), Some(size)) => (a - b).abs() / size,
            _ => f64::INFINITY,
        };
        let larger = |a: Option<f64>, b: Option<f64>| Some(a?.abs().max(b?.abs()));
        let own = |a, b| relative(a, b, larger(a, b));
        let magnitude = larger(here.least, here.most);
        Self {
            case: case.to_owned(),
            method: method.to_owned(),
            mean: relative(here.mean, there.mean, here.root_mean_square),
            root_mean_square: own(here.root_mean_square, there.root_mean_square),
            extremes: relative(here.least, there.least, magnitude).max(relative(here.most, there.most, magnitude)),
            error: own(here.error, there.error),
            weight_sum: own(here.weight_sum, there.weight_sum),
            verdicts_differ,
        }
    }
}

/// Reads the document that `--json` printed in another run.
pub(super) fn read(path: &Path) -> Result<Document, Failure> {
    document::read(
        path,
        &Kind {
            schema: SCHEMA,
            version: VERSION,
            made: "printed by `stein selftest --json`",
            remedy: "give what `stein selftest --json` printed",
        },
    )
}

impl Comparison {
    pub(super) fn new(other: &Document, own: &Document) -> Self {
        // Beside equal colours, other values may be finite in only one of the runs.
        let is_told = |result: &Summary| [result.error, result.weight_sum].map(|value| value.is_some());
        let mut comparison = Self {
            other_adapter: other.adapter.clone(),
            compared: 0,
            same: 0,
            different: Vec::new(),
            missing: Vec::new(),
        };
        for row in &own.rows {
            let name = || format!("{}, {}", row.case, row.method);
            let Some(there) = other.rows.iter().find(|there| there.case == row.case && there.method == row.method)
            else {
                comparison.missing.push(format!("{} (there)", name()));
                continue;
            };
            match (&row.result, &there.result) {
                (Some(here), Some(of_other)) => {
                    comparison.compared += 1;
                    if here.checksum == of_other.checksum
                        && is_told(here) == is_told(of_other)
                        && row.passed == there.passed
                    {
                        comparison.same += 1;
                    } else {
                        comparison.different.push(Difference::new(
                            &row.case,
                            &row.method,
                            here,
                            of_other,
                            row.passed != there.passed,
                        ));
                    }
                }
                (Some(_), None) => comparison.missing.push(format!("{} (there)", name())),
                (None, Some(_)) => comparison.missing.push(format!("{} (here)", name())),
                (None, None) => {}
            }
        }
        let lacks = |case: &str, method: &str| !own.rows.iter().any(|row| row.case == case && row.method == method);
        comparison.missing.extend(
            other
                .rows
                .iter()
                .filter(|row| lacks(&row.case, &row.method))
                .map(|row| format!("{}, {} (here)", row.case, row.method)),
        );
        comparison
    }

    pub(super) fn text(&self) -> String {
        let mut text = format!(
            "Against {}: {} of {} results are the same to the bit",
            self.other_adapter, self.same, self.compared
        );
        if !self.different.is_empty() {
            let head = ["case", "method", "", "mean", "RMS", "extremes", "error", "Σ w"].map(String::from).to_vec();
            let line = |row: &Difference| {
                let verdict = if row.verdicts_differ { "another verdict" } else { "" };
                let figures = [row.mean, row.root_mean_square, row.extremes, row.error, row.weight_sum].map(number);
                [row.case.clone(), row.method.clone(), verdict.to_owned()]
                    .into_iter()
                    .chain(figures)
                    .collect::<Vec<_>>()
            };
            let rows: Vec<_> = std::iter::once(head).chain(self.different.iter().map(line)).collect();
            text += &format!("; relative differences of the others:\n{}", table(&rows, 3));
        }
        if !self.missing.is_empty() {
            text += &format!("\nMissing: {}", self.missing.join("; "));
        }
        text
    }
}
