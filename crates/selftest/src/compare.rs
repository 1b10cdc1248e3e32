//! Compares two runs, result by result, to find where adapters differ.

use std::path::Path;

use serde::Serialize;
use stein::gpu::AdapterIdentity;
use stein_exr::json_document::{self, DocumentError, Kind};

use crate::checks::Summary;
use crate::{Document, SCHEMA, VERSION};

/// Comparison of this run with another one.
#[derive(Debug, Serialize)]
pub struct AdapterDifferences {
    /// Adapter of the other run.
    pub other_adapter: AdapterIdentity,
    /// Number of results that both runs have.
    pub compared: usize,
    /// Number of results that are the same to the bit.
    pub same: usize,
    /// Results that differ.
    pub different: Vec<Difference>,
    /// Results that one of the two lacks.
    pub missing: Vec<String>,
}

/// Relative differences; infinite, which JSON shows as null, if one of the two has no finite value.
#[derive(Debug, Serialize)]
pub struct Difference {
    /// Name of the case.
    pub case: String,
    /// Name of the method.
    pub method: String,
    /// Difference of the colour's mean, relative to its root mean square.
    pub mean: f64,
    /// Difference of the root mean square.
    pub root_mean_square: f64,
    /// Difference of the least or of the largest value, whichever is greater, relative to the largest magnitude.
    pub extremes: f64,
    /// Difference of the mean estimated error.
    pub error: f64,
    /// Difference of the mean number of pixels that took part.
    pub weight_sum: f64,
    /// Whether only one of the two is within bounds.
    pub verdicts_differ: bool,
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

/// Reads the document of another run.
///
/// # Errors
/// [`DocumentError`] for a file that is no such document.
pub fn read_document(path: &Path) -> Result<Document, DocumentError> {
    json_document::read(path, Kind { schema: SCHEMA, version: VERSION })
}

impl AdapterDifferences {
    /// Compares another run with this one.
    pub fn new(other: &Document, own: &Document) -> Self {
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
}
