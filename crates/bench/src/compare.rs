//! A run against an earlier one, row by row.

use std::path::Path;

use serde::Serialize;
use stein::gpu::AdapterIdentity;
use stein_exr::json_document::{self, DocumentError, Kind};

use crate::{Document, Row, SCHEMA, VERSION};

/// Smallest relative change of a stage's time that is reported.
const STAGE_CHANGE: f64 = 0.05;

/// Ratio above which a row is marked without `--fail-above`.
const MARK_ABOVE: f64 = 1.1;

/// Ratio above which an error is worse. Results are the same to the bit if nothing was changed.
const ERROR_ABOVE: f64 = 1.001;

/// RowRatios of a run to an earlier one.
#[derive(Debug, Serialize)]
pub struct RunRatios {
    /// Date of the old run.
    pub date: String,
    /// Adapter of the old run, if it differs.
    pub other_adapter: Option<AdapterIdentity>,
    /// Remarks on what makes the runs hard to compare.
    pub notes: Vec<String>,
    /// Ratios of the rows that both runs have.
    pub rows: Vec<RowRatios>,
    /// Rows whose time or error grew more than allowed, that have no error any more, or that are missing although both
    /// runs have the same arguments.
    pub failed: Vec<String>,
}

/// Ratios of a row to the row of the same set and configuration in an earlier run.
#[derive(Debug, Serialize)]
pub struct RowRatios {
    /// Name of the set.
    pub set: String,
    /// Name of the configuration.
    pub configuration: String,
    /// Ratio of the times on the clock.
    pub wall: f64,
    /// Ratio of the CPU times; `None` if one of the runs has none.
    pub cpu: Option<f64>,
    /// Ratio of the times on the device; `None` if one of the runs has none.
    pub device: Option<f64>,
    /// Name and time ratio of each stage that changed.
    pub stages: Vec<(String, f64)>,
    /// Ratio of the relative MSEs; `None` if one of the runs has none, or if the old one is 0.
    pub relative_mse: Option<f64>,
    /// Whether the old result had an error and the new one holds values that are not finite.
    pub lost_its_errors: bool,
    /// Whether the old result was the reference to the bit and the new one is not.
    pub was_exact: bool,
    /// Whether the time on the clock grew more than allowed.
    pub is_slower: bool,
    /// Whether the error grew.
    pub is_worse: bool,
}

/// Whether rows exceed the limit of their ratios.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// All rows that both runs have are within the limit.
    Within,
    /// The runs have no row in common.
    NothingInCommon,
    /// [`RunRatios::failed`] lists rows.
    Failed,
}

/// Reads the `results.json` of an earlier run. `path` is that file or the folder of the report.
///
/// # Errors
/// [`DocumentError`] for a file that is no such document.
pub fn read_document(path: &Path) -> Result<Document, DocumentError> {
    let file = if path.is_dir() { path.join("results.json") } else { path.to_owned() };
    json_document::read(&file, Kind { schema: SCHEMA, version: VERSION })
}

impl RunRatios {
    /// Compares two runs. `fail_above` is the largest ratio of times and errors that is allowed.
    pub fn new(old: &Document, new: &Document, fail_above: Option<f64>) -> Self {
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
        let rows: Vec<RowRatios> =
            pairs.iter().map(|(old, new)| RowRatios::new(old, new, fail_above.unwrap_or(MARK_ABOVE))).collect();
        let mut failed = Vec::new();
        if let Some(limit) = fail_above {
            let beyond = |row: &&RowRatios| {
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
        Self {
            date: old.date.clone(),
            other_adapter: (old.adapter != new.adapter).then(|| old.adapter.clone()),
            notes,
            failed,
            rows,
        }
    }

    /// Judges the rows by the limit that they were compared with.
    pub fn verdict(&self) -> Verdict {
        match (self.failed.is_empty(), self.rows.is_empty()) {
            (false, _) => Verdict::Failed,
            (true, true) => Verdict::NothingInCommon,
            (true, false) => Verdict::Within,
        }
    }
}

impl RowRatios {
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
        let compared = |old: Value, new: Value| RunRatios::new(&document(old), &document(new), Some(1e9));
        let lost = compared(json!(0.5), Value::Null);
        assert!(lost.rows[0].is_worse && !lost.rows[0].is_slower && lost.verdict() == Verdict::Failed, "{lost:?}");
        let inexact = compared(json!(0.0), json!(1e-9));
        assert!(inexact.rows[0].is_worse && inexact.verdict() == Verdict::Failed, "{inexact:?}");
        for (old, new) in
            [(json!(0.5), json!(0.5)), (json!(0.0), json!(0.0)), (Value::Null, Value::Null), (Value::Null, json!(0.5))]
        {
            let same = compared(old, new);
            assert!(!same.rows[0].is_worse && same.verdict() == Verdict::Within, "{same:?}");
        }
    }

    #[test]
    fn a_row_that_is_gone_fails_where_the_same_was_to_be_measured() {
        let (old, mut new) = (document(json!(0.5)), document(json!(0.5)));
        new.rows.clear();
        assert!(RunRatios::new(&old, &new, Some(1e9)).failed[0].contains("not measured any more"));
        new.arguments = vec!["another.exr".into()];
        assert!(RunRatios::new(&old, &new, Some(1e9)).failed.is_empty());
    }
}
