//! A run against an earlier one, row by row.

use std::path::Path;

use serde::Serialize;

use super::super::Failure;
use super::super::document::{self, Kind};
use super::super::out::{number, table};
use super::results::{Adapter, Document, Row, SCHEMA, VERSION};

/// Smallest relative change of a stage's time that is reported.
const STAGE_CHANGE: f64 = 0.05;

/// Ratio above which a row is marked without `--fail-above`.
const MARK_ABOVE: f64 = 1.1;

/// Ratio above which an error is worse. Results are the same to the bit if nothing was changed.
const ERROR_ABOVE: f64 = 1.001;

/// Ratios of a run to an earlier one.
#[derive(Debug, Serialize)]
pub(super) struct Comparison {
    /// Date of the old run.
    date: String,
    /// Adapter of the old run, if it differs.
    other_adapter: Option<Adapter>,
    /// Remarks on what makes the runs hard to compare.
    notes: Vec<String>,
    rows: Vec<Ratios>,
    /// Rows whose time or error grew more than allowed, that have no error any more, or that are missing although both
    /// runs have the same arguments.
    failed: Vec<String>,
}

#[derive(Debug, Serialize)]
struct Ratios {
    set: String,
    configuration: String,
    wall: f64,
    cpu: Option<f64>,
    device: Option<f64>,
    /// Name and time ratio of each stage that changed.
    stages: Vec<(String, f64)>,
    relative_mse: Option<f64>,
    /// Whether the old result had an error and the new one holds values that are not finite.
    lost_its_errors: bool,
    /// Whether the old result was the reference to the bit and the new one is not.
    was_exact: bool,
    is_slower: bool,
    is_worse: bool,
}

/// Reads the `results.json` of an earlier run. `path` is that file or the folder of the report.
pub(super) fn read(path: &Path) -> Result<Document, Failure> {
    let file = if path.is_dir() { path.join("results.json") } else { path.to_owned() };
    document::read(
        &file,
        &Kind {
            schema: SCHEMA,
            version: VERSION,
            made: "written by `stein bench`",
            remedy: "give the results.json of a report",
        },
    )
}

/// Refuses `--fail-above` if the adapters differ: times of different adapters do not show whether the program became
/// slower, so they must not decide the exit code.
pub(super) fn check_adapter(old: &Document, adapter: &Adapter, fail_above: Option<f64>) -> Result<(), Failure> {
    if fail_above.is_none() || old.adapter == *adapter {
        return Ok(());
    }
    Err(Failure::usage(format_args!(
        "--fail-above: the old run was on {}, this one would be on {adapter}\n  remedy: leave --fail-above out, or compare with a run on this adapter",
        old.adapter
    )))
}

pub(super) fn compare(old: &Document, new: &Document, fail_above: Option<f64>) -> Comparison {
    let mut notes = Vec::new();
    if old.arguments != new.arguments {
        notes.push(format!("the old run was of: stein bench {}", shell_words::join(&old.arguments)));
    }
    let find = |row: &Row| {
        let before =
            old.rows.iter().find(|other| (&other.set, &other.configuration) == (&row.set, &row.configuration))?;
        let size = |document: &Document, row: &Row| document.set(row).map(|set| (set.width, set.height));
        (size(old, before) == size(new, row)).then_some(before)
    };
    let pairs: Vec<(&Row, &Row)> = new.rows.iter().filter_map(|row| Some((find(row)?, row))).collect();
    if new.rows.len() > pairs.len() {
        notes.push(format!("{} rows have no partner in the old run", new.rows.len() - pairs.len()));
    }
    let vanished: Vec<&Row> =
        old.rows.iter().filter(|row| !pairs.iter().any(|(before, _)| std::ptr::eq(*before, *row))).collect();
    if !vanished.is_empty() {
        notes.push(format!("{} rows have no partner in the new run", vanished.len()));
    }
    let changed_parameters = |name: &str| {
        let parameters = |document: &Document| {
            let found = document.configurations.iter().find(|configuration| configuration.name == name)?;
            found.stein.as_ref().map(|stein| stein.all.clone())
        };
        parameters(old) != parameters(new)
    };
    for configuration in &new.configurations {
        if pairs.iter().any(|(_, row)| row.configuration == configuration.name)
            && changed_parameters(&configuration.name)
        {
            notes.push(format!("{} had other parameters then", configuration.name));
        }
    }
    let rows: Vec<Ratios> =
        pairs.iter().map(|(old, new)| Ratios::new(old, new, fail_above.unwrap_or(MARK_ABOVE))).collect();
    let mut failed = Vec::new();
    if let Some(limit) = fail_above {
        let beyond = |row: &&Ratios| {
            row.lost_its_errors
                || row.was_exact
                || row.wall > limit
                || row.relative_mse.is_some_and(|ratio| ratio > limit)
        };
        failed.extend(rows.iter().filter(beyond).map(|row| {
            let why = if row.lost_its_errors { ": not finite any more" } else { "" };
            format!("{}, {}{why}", row.set, row.configuration)
        }));
        // Missing rows count only if the arguments are the same: other arguments may measure other rows.
        let are_missed = old.arguments == new.arguments;
        failed.extend(
            vanished
                .iter()
                .filter(|_| are_missed)
                .map(|row| format!("{}, {}: not measured any more", row.set, row.configuration)),
        );
    }
    Comparison {
        date: old.date.clone(),
        other_adapter: (old.adapter != new.adapter).then(|| old.adapter.clone()),
        notes,
        failed,
        rows,
    }
}

impl Ratios {
    fn new(old: &Row, new: &Row, mark_above: f64) -> Self {
        let ratio =
            |old: Option<f64>, new: Option<f64>| old.zip(new).filter(|(old, _)| *old > 0.0).map(|(old, new)| new / old);
        let time = |row: &Row, name: &str| row.stages.iter().find(|stage| stage.stage == name).map(|stage| stage.ms);
        let stage = |name: &str| ratio(time(old, name), time(new, name)).map(|ratio| (name.to_owned(), ratio));
        let stages =
            new.stages.iter().filter_map(|of| stage(&of.stage)).filter(|(_, ratio)| (ratio - 1.0).abs() > STAGE_CHANGE);
        let (wall, relative_mse) = (new.wall_ms / old.wall_ms, ratio(old.relative_mse(), new.relative_mse()));
        // Only if the new run has a reference as well.
        let lost_its_errors = old.relative_mse().is_some() && new.errors.is_some() && new.relative_mse().is_none();
        // An old error of 0 has no ratio.
        let was_exact = old.relative_mse() == Some(0.0) && new.relative_mse().is_some_and(|error| error > 0.0);
        Self {
            set: new.set.clone(),
            configuration: new.configuration.clone(),
            wall,
            cpu: ratio(old.cpu_ms, new.cpu_ms),
            device: ratio(old.device_ms, new.device_ms),
            stages: stages.collect(),
            relative_mse,
            lost_its_errors,
            was_exact,
            is_slower: wall > mark_above,
            is_worse: lost_its_errors || was_exact || relative_mse.is_some_and(|ratio| ratio > ERROR_ABOVE),
        }
    }
}

impl Comparison {
    pub(super) fn text(&self) -> String {
        let mut lines = vec![format!("new / old, the old run being of {}", self.date)];
        if let Some(adapter) = &self.other_adapter {
            lines.push(format!(
                "  ANOTHER ADAPTER: the old run was on {adapter}; the ratios of times compare the adapters"
            ));
        }
        lines.extend(self.notes.iter().map(|note| format!("  {note}")));
        let mut rows = vec![
            ["", "", "wall", "CPU", "device", "relative MSE", "", "  stages that changed"].map(String::from).to_vec(),
        ];
        let ratio = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
        for row in &self.rows {
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
        if self.rows.is_empty() {
            lines.push("  no row is in both runs".into());
        } else {
            lines.push(left_last(&rows));
        }
        lines.join("\n")
    }

    /// Fails if rows exceed the limit of `--fail-above`.
    pub(super) fn verdict(&self, fail_above: Option<f64>) -> Result<(), Failure> {
        let Some(limit) = fail_above else { return Ok(()) };
        if self.rows.is_empty() && self.failed.is_empty() {
            return Err(Failure::input(
                "--fail-above: no row is in both runs\n  remedy: measure the same sets and configurations",
            ));
        }
        if self.failed.is_empty() {
            return Ok(());
        }
        let rows = self.failed.join("\n  ");
        let limit = number(limit);
        Err(Failure::other(format_args!(
            "time or relative MSE of these rows is more than {limit} times that of the old run, or there is none any more:\n  {rows}"
        )))
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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    /// Returns a document with one row of 100 ms and the given relative MSE.
    fn document(relative_mse: Value) -> Document {
        let errors = json!({ "relative_mse": relative_mse, "mse": null, "ssim": null, "flip": null });
        let row = json!({ "set": "box", "configuration": "gem", "first_ms": 1.0, "wall_ms": 100.0, "wall_ms_per_megapixel": 1.0, "stages": [], "errors": errors });
        let adapter = json!({ "name": "", "backend": "", "kind": "", "driver": "", "timestamps": true });
        let document = json!({
            "schema": SCHEMA, "version": VERSION, "stein": "0", "date": "then", "arguments": [], "adapter": adapter, "repeats": 1,
            "configurations": [], "sets": [], "rows": [row], "notes": [],
        });
        serde_json::from_value(document).unwrap()
    }

    #[test]
    fn a_result_that_is_not_finite_any_more_is_worse_than_any_other() {
        let compared = |old: Value, new: Value| compare(&document(old), &document(new), Some(1e9));
        let lost = compared(json!(0.5), Value::Null);
        assert!(lost.rows[0].is_worse && !lost.rows[0].is_slower && lost.verdict(Some(1e9)).is_err(), "{lost:?}");
        let inexact = compared(json!(0.0), json!(1e-9));
        assert!(inexact.rows[0].is_worse && inexact.verdict(Some(1e9)).is_err(), "{inexact:?}");
        for (old, new) in
            [(json!(0.5), json!(0.5)), (json!(0.0), json!(0.0)), (Value::Null, Value::Null), (Value::Null, json!(0.5))]
        {
            let same = compared(old, new);
            assert!(!same.rows[0].is_worse && same.verdict(Some(1e9)).is_ok(), "{same:?}");
        }
    }

    #[test]
    fn a_row_that_is_gone_fails_where_the_same_was_to_be_measured() {
        let (old, mut new) = (document(json!(0.5)), document(json!(0.5)));
        new.rows.clear();
        assert!(compare(&old, &new, Some(1e9)).failed[0].contains("not measured any more"));
        new.arguments = vec!["another.exr".into()];
        assert!(compare(&old, &new, Some(1e9)).failed.is_empty());
    }
}
