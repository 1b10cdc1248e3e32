//! The worst figure of each check.

use serde::{Deserialize, Serialize};

use crate::checks::{Check, Row};

/// The figure of a check that is nearest to its bound, or farthest beyond it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Worst {
    /// Check that found the figure.
    pub check: Check,
    /// Name of the case.
    pub case: String,
    /// Name of the method.
    pub method: String,
    /// Value of the figure; `None` if it is not finite.
    pub value: Option<f64>,
    /// Largest value within bounds.
    pub bound: f64,
}

/// Returns the worst figure of each check.
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
