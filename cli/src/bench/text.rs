//! The results for people, at a terminal.

use stein::text::{self, human_bytes, milliseconds, number};
use stein_bench::{Row, Set, stage_names};

use crate::out::table;

/// Formats a row for each configuration; with `verbose`, also more measures and, below, the stages.
pub(super) fn text(set: &Set, rows: &[Row], verbose: bool) -> String {
    let noisy = set
        .noisy
        .and_then(|errors| errors.relative_mse)
        .map_or_else(String::new, |error| format!(", noisy relative MSE {}", number(error)));
    let mut lines =
        vec![format!("{}: {}, {}×{}{noisy}", text::name(&set.name), text::path(&set.file), set.width, set.height)];
    if set.reference.is_none() {
        lines.push(
            "  no reference, so that there are no errors; see `stein bench --help` for where one is looked for".into(),
        );
    }
    lines.push(table(&summary(set, rows, verbose), 1));
    if verbose {
        lines.push(if rows.iter().any(|row| !row.stages.is_empty()) {
            table(&stages(rows), 1)
        } else {
            "  this adapter cannot time stages".into()
        });
    }
    lines.join("\n")
}

fn summary(set: &Set, rows: &[Row], verbose: bool) -> Vec<Vec<String>> {
    type Cell = fn(&Row) -> Option<String>;
    let mut columns: Vec<(&str, Cell)> = vec![
        ("wall ms", |row| Some(milliseconds(row.wall_ms))),
        ("ms/megapixel", |row| Some(milliseconds(row.wall_ms_per_megapixel))),
        ("CPU ms", |row| row.cpu_ms.map(milliseconds)),
        ("device ms", |row| row.device_ms.map(milliseconds)),
    ];
    if verbose {
        columns.push(("first ms", |row| Some(milliseconds(row.first_ms))));
    }
    columns.push(("memory", |row| row.peak_bytes.map(human_bytes)));
    if rows.iter().any(|row| row.strips.is_some_and(|strips| strips > 1)) {
        columns.push(("strips", |row| row.strips.map(|strips| strips.to_string())));
    }
    if set.reference.is_some() {
        columns.push(("relative MSE", |row| row.relative_mse().map(number)));
        columns.push(("front", |row| (row.on_front == Some(true)).then(|| "*".to_owned())));
        if verbose {
            columns.push(("SSIM", |row| row.errors.and_then(|errors| errors.ssim).map(|ssim| format!("{ssim:.4}"))));
            columns.push(("FLIP", |row| row.errors.and_then(|errors| errors.flip).map(number)));
        }
        columns.push(("MSE", |row| row.mse().map(number)));
    }
    columns.push(("predicted MSE", |row| row.predicted_mse.map(number)));
    let head = std::iter::once(String::new()).chain(columns.iter().map(|(name, _)| (*name).to_owned())).collect();
    let absent = |name: &str| if name == "front" { String::new() } else { "-".to_owned() };
    let cells = |row: &Row| {
        let cells = columns.iter().map(|(name, cell)| cell(row).unwrap_or_else(|| absent(name)));
        std::iter::once(row.configuration.clone()).chain(cells).collect()
    };
    std::iter::once(head).chain(rows.iter().map(cells)).collect()
}

/// Returns a row for each stage, with a column for each configuration.
fn stages(rows: &[Row]) -> Vec<Vec<String>> {
    let timed: Vec<&Row> = rows.iter().filter(|row| !row.stages.is_empty()).collect();
    let head =
        std::iter::once("stage, ms".to_owned()).chain(timed.iter().map(|row| row.configuration.clone())).collect();
    let line = |name: &str| {
        let of = |row: &&Row| {
            row.stages
                .iter()
                .find(|stage| stage.stage == name)
                .map_or_else(|| "-".to_owned(), |stage| milliseconds(stage.ms))
        };
        std::iter::once(name.to_owned()).chain(timed.iter().map(of)).collect()
    };
    std::iter::once(head).chain(stage_names(timed.iter().copied()).into_iter().map(line)).collect()
}
