//! A comparison with an earlier run, as text and as an exit code.

use stein::text::number;
use stein_bench::{RunRatios, Verdict};

use crate::Failure;
use crate::out::table;

/// Formats the notes and a line for each row.
pub(super) fn text(ratios: &RunRatios) -> String {
    let mut lines = vec![format!("new / old, the old run being of {}", ratios.date)];
    if let Some(adapter) = &ratios.other_adapter {
        lines
            .push(format!("  ANOTHER ADAPTER: the old run was on {adapter}; the ratios of times compare the adapters"));
    }
    lines.extend(ratios.notes.iter().map(|note| format!("  {note}")));
    let mut rows =
        vec![["", "", "wall", "CPU", "device", "relative MSE", "", "  stages that changed"].map(String::from).to_vec()];
    let ratio = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
    for row in &ratios.rows {
        let marks = [(row.is_slower, "slower"), (row.is_worse, "worse")]
            .into_iter()
            .filter(|(is_so, _)| *is_so)
            .map(|(_, mark)| mark);
        let stages =
            row.stages.iter().map(|(stage, ratio)| format!("{stage} {ratio:.2}")).collect::<Vec<_>>().join(", ");
        rows.push(vec![
            row.set.clone(),
            row.configuration.clone(),
            ratio(Some(row.wall)),
            ratio(row.cpu),
            ratio(row.device),
            ratio(row.relative_mse),
            marks.collect::<Vec<_>>().join(", "),
            format!("  {stages}"),
        ]);
    }
    if ratios.rows.is_empty() {
        lines.push("  no row is in both runs".into());
    } else {
        lines.push(left_last(&rows));
    }
    lines.join("\n")
}

/// Fails if rows exceed the limit of `--fail-above`.
pub(super) fn verdict(ratios: &RunRatios, limit: f64) -> Result<(), Failure> {
    match ratios.verdict() {
        Verdict::Within => Ok(()),
        Verdict::NothingInCommon => Err(Failure::input(
            "--fail-above: no row is in both runs\n  remedy: measure the same sets and configurations",
        )),
        Verdict::Failed => {
            let rows = ratios.failed.join("\n  ");
            let limit = number(limit);
            Err(Failure::other(format_args!(
                "time or relative MSE of these rows is more than {limit} times that of the old run, or there is none any more:\n  {rows}"
            )))
        }
    }
}

/// Formats a table whose last column is text.
fn left_last(rows: &[Vec<String>]) -> String {
    let width = rows.iter().filter_map(|row| row.last()).map(|cell| cell.chars().count()).max().unwrap_or(0);
    let padded: Vec<Vec<String>> = rows
        .iter()
        .map(|row| {
            let mut row = row.clone();
            if let Some(last) = row.last_mut() {
                *last = format!("{last:width$}");
            }
            row
        })
        .collect();
    table(&padded, 2)
}
