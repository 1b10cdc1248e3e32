//! Results as text.

use stein::text::number;
use stein_selftest::{AdapterDifferences, Case, Check, Difference, Document, Row};

use crate::out::{seconds, table};

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

/// Formats a line for each result that differs, and the results that one of the runs lacks.
pub(super) fn differences(differences: &AdapterDifferences) -> String {
    let mut text = format!(
        "Against {}: {} of {} results are the same to the bit",
        differences.other_adapter, differences.same, differences.compared
    );
    if !differences.different.is_empty() {
        let head = ["case", "method", "", "mean", "RMS", "extremes", "error", "Σ w"].map(String::from).to_vec();
        let line = |row: &Difference| {
            let verdict = if row.verdicts_differ { "another verdict" } else { "" };
            let figures = [row.mean, row.root_mean_square, row.extremes, row.error, row.weight_sum].map(number);
            [row.case.clone(), row.method.clone(), verdict.to_owned()].into_iter().chain(figures).collect::<Vec<_>>()
        };
        let rows: Vec<_> = std::iter::once(head).chain(differences.different.iter().map(line)).collect();
        text += &format!("; relative differences of the others:\n{}", table(&rows, 3));
    }
    if !differences.missing.is_empty() {
        text += &format!("\nMissing: {}", differences.missing.join("; "));
    }
    text
}
