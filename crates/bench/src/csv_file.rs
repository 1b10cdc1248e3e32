//! `results.csv`: a line for each row of the document, with the data of its set and configuration.

use crate::{Document, Error, Errors, Result, stage_names};

/// Formats the document as CSV. Numbers are in the units of the document; a missing number is an empty cell. Each stage
/// has a column `<stage>_ms`.
pub(super) fn csv(document: &Document) -> Result<Vec<u8>> {
    let because = |reason: String| Error::Part { part: "results.csv", reason };
    let failed = |error: csv::Error| because(error.to_string());
    let stages = stage_names(document.rows.iter());
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut head: Vec<String> = COLUMNS.map(str::to_owned).to_vec();
    head.extend(stages.iter().map(|stage| format!("{stage}_ms")));
    writer.write_record(&head).map_err(failed)?;
    for row in &document.rows {
        let (Some(set), Some(configuration)) = (document.set(row), document.configuration(row)) else { continue };
        let stein = configuration.stein.as_ref();
        let errors = |errors: Option<Errors>| {
            let get = |value: fn(&Errors) -> Option<f64>| {
                errors.as_ref().and_then(value).map_or_else(String::new, |value| value.to_string())
            };
            [
                get(|errors| errors.relative_mse),
                get(|errors| errors.mse),
                get(|errors| errors.ssim),
                get(|errors| errors.flip),
            ]
        };
        let mut record = vec![
            document.date.clone(),
            document.stein.clone(),
            document.adapter.name.clone(),
            document.adapter.driver.clone(),
            set.scene.clone(),
            set.name.clone(),
            stein::text::path(&set.file),
            cell(set.reference.as_ref().map(|reference| stein::text::path(reference))),
            cell(set.samples_per_pixel),
            set.width.to_string(),
            set.height.to_string(),
            row.configuration.clone(),
            cell(stein.map(|stein| &stein.method)),
            cell(stein.map(|stein| &stein.preset)),
            cell(stein.and_then(|stein| stein.window_radius)),
            cell(stein.and_then(|stein| stein.second_pass)),
            cell(stein.and_then(|stein| stein.candidates.as_ref())),
            cell(stein.map(|stein| stein.everything)),
            cell(stein.map(|stein| &stein.noise)),
            cell(configuration.command.as_ref()),
            row.first_ms.to_string(),
            row.wall_ms.to_string(),
            row.wall_ms_per_megapixel.to_string(),
            cell(row.cpu_ms),
            cell(row.device_ms),
            cell(row.peak_bytes),
            cell(row.strips),
        ];
        record.extend(errors(row.errors));
        record.extend([cell(row.predicted_mse), cell(row.on_front)]);
        record.extend(errors(set.noisy));
        record.extend(
            stages.iter().map(|name| cell(row.stages.iter().find(|stage| stage.stage == *name).map(|stage| stage.ms))),
        );
        writer.write_record(&record).map_err(failed)?;
    }
    writer.into_inner().map_err(|error| because(error.to_string()))
}

/// Columns before the stages.
const COLUMNS: [&str; 37] = [
    "date",
    "stein",
    "adapter",
    "driver",
    "scene",
    "set",
    "file",
    "reference",
    "samples_per_pixel",
    "width",
    "height",
    "configuration",
    "method",
    "preset",
    "window_radius",
    "second_pass",
    "candidates",
    "everything",
    "noise",
    "command",
    "first_ms",
    "wall_ms",
    "wall_ms_per_megapixel",
    "cpu_ms",
    "device_ms",
    "peak_bytes",
    "strips",
    "relative_mse",
    "mse",
    "ssim",
    "flip",
    "predicted_mse",
    "on_front",
    "noisy_relative_mse",
    "noisy_mse",
    "noisy_ssim",
    "noisy_flip",
];

fn cell(value: Option<impl ToString>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}
