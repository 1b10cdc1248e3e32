//! Results as text.

use serde::{Deserialize, Serialize};

use super::super::out::{number, seconds, table};
use super::Document;
use super::cases::Case;
use super::checks::{Check, Row};

/// The figure of a check that is nearest to its bound, or farthest beyond it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Worst {
    check: Check,
    case: String,
    method: String,
    /// Value of the figure; `None` if it is not finite.
    value: Option<f64>,
    bound: f64,
}

pub(super) fn worst(rows: &[Row]) -> Vec<Worst> {
    let of = |check: Check| {
        let figures = rows.iter().filter_map(|row| Some((row, row.figure(check)?)));
        let share = |value: Option<f64>, bound: f64| match value {
            Some(value) if bound > 0.0 => value / bound,
            Some(value) if value > 0.0 => f64::INFINITY,
            Some(_) => 0.0,
            None => f64::INFINITY,
        };
        let worst = figures.max_by(|(_, a), (_, b)| share(a.value, a.bound).total_cmp(&share(b.value, b.bound)));
        worst.map(|(row, figure)| Worst {
            check,
            case: row.case.clone(),
            method: row.method.clone(),
            value: figure.value,
            bound: figure.bound,
        })
    };
    Check::ALL.into_iter().filter_map(of).collect()
}

/// Formats a line for each result, the faults of results that are out of bounds, and the worst figure of each check.
pub(super) fn text(document: &Document, cases: &[Case], verbose: bool) -> String {
    let head: Vec<String> = ["case", "method", ""]
        .into_iter()
        .chain(Check::ALL.iter().skip(1).map(|check| check.name()))
        .map(String::from)
        .collect();
    let cell = |row: &Row, check: Check| match row.figure(check) {
        None => "-".to_owned(),
        Some(figure) => {
            format!("{}{}", figure.value.map_or_else(|| "∞".to_owned(), number), if figure.passed { "" } else { "!" })
        }
    };
    let line = |row: &Row| {
        let status = match (row.passed, row.figure(Check::Door)) {
            (false, _) => "FAILED",
            (true, Some(_)) => "refused, as it should be",
            (true, None) => "passed",
        };
        let cells = Check::ALL.into_iter().skip(1).map(|check| cell(row, check));
        [row.case.clone(), row.method.clone(), status.to_owned()].into_iter().chain(cells).collect::<Vec<_>>()
    };
    let rows: Vec<_> = std::iter::once(head).chain(document.rows.iter().map(line)).collect();
    let mut parts = vec![table(&rows, 3)];

    let failed: Vec<String> = document.rows.iter().filter(|row| !row.passed).flat_map(wrong).collect();
    if !failed.is_empty() {
        parts.push(format!("Out of bounds:\n{}", failed.join("\n")));
    }
    if verbose {
        let reasons =
            cases.iter().flat_map(|case| case.reasons().into_iter().map(|reason| format!("  {}: {reason}", case.name)));
        let reasons: Vec<String> = reasons.collect();
        if !reasons.is_empty() {
            parts.push(format!("Bounds other than usual:\n{}", reasons.join("\n")));
        }
        let details = document.rows.iter().flat_map(|row| {
            let detailed = row.figures.iter().filter(|figure| !figure.detail.is_empty());
            detailed.map(|figure| format!("  {}, {}, {}: {}", row.case, row.method, figure.check.name(), figure.detail))
        });
        parts.push(format!("Where the worst of each figure is:\n{}", details.collect::<Vec<_>>().join("\n")));
    }

    let head = ["", "worst", "bound", "case", "method"].map(String::from).to_vec();
    let worst = document.worst.iter().map(|worst| {
        let value = worst.value.map_or_else(|| "∞".to_owned(), number);
        vec![worst.check.name().to_owned(), value, number(worst.bound), worst.case.clone(), worst.method.clone()]
    });
    parts.push(table(&std::iter::once(head).chain(worst).collect::<Vec<_>>(), 5));
    let passed = document.rows.iter().filter(|row| row.passed).count();
    parts.push(format!(
        "{passed} of {} within bounds, {} cases, {} on {}",
        document.rows.len(),
        cases.len(),
        seconds(document.seconds),
        document.adapter
    ));
    parts.join("\n\n")
}

/// Formats a line for each figure that is out of bounds.
fn wrong(row: &Row) -> Vec<String> {
    let figures = row.figures.iter().filter(|figure| !figure.passed);
    figures
        .map(|figure| {
            let value = figure.value.map_or_else(|| "∞".to_owned(), number);
            format!(
                "  {}, {}: {} is {value}, at most {} is allowed; {}",
                row.case,
                row.method,
                figure.check.name(),
                number(figure.bound),
                figure.detail
            )
        })
        .collect()
}
