//! Statistics of measured values.

/// Returns the middle value, or the mean of the two in the middle.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values.as_slice() {
        [] => f64::NAN,
        values if values.len() % 2 == 1 => values[values.len() / 2],
        values => (values[values.len() / 2 - 1] + values[values.len() / 2]) / 2.0,
    }
}

/// Returns for each point (cost, error) whether it is on the Pareto front, that is, whether no other point beats it. A
/// point beats another if it is at least as good in both values and better in one.
pub(super) fn front(points: &[(f64, f64)]) -> Vec<bool> {
    let beats = |a: &(f64, f64), b: &(f64, f64)| a.0 <= b.0 && a.1 <= b.1 && (a.0 < b.0 || a.1 < b.1);
    points.iter().map(|point| !points.iter().any(|other| beats(other, point))).collect()
}

/// Returns the exponent e of the best fit y = c·xᵉ: least squares of the logarithms. Returns `None` if x varies by less
/// than a factor of 2, because noise would decide.
pub(super) fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<_> = points.iter().filter(|(x, y)| *x > 0.0 && *y > 0.0).map(|(x, y)| (x.ln(), y.ln())).collect();
    let (least, most) =
        logs.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), (x, _)| (least.min(*x), most.max(*x)));
    if most - least < 2.0_f64.ln() || logs.is_empty() {
        return None;
    }
    let count = logs.len() as f64;
    let (mean_x, mean_y) =
        (logs.iter().map(|(x, _)| x).sum::<f64>() / count, logs.iter().map(|(_, y)| y).sum::<f64>() / count);
    let (cross, square) = logs.iter().fold((0.0, 0.0), |(cross, square), (x, y)| {
        (cross + (x - mean_x) * (y - mean_y), square + (x - mean_x).powi(2))
    });
    Some(cross / square)
}

/// Returns the geometric mean of the positive values; `None` without any.
pub(super) fn geometric_mean(values: &[f64]) -> Option<f64> {
    let logs: Vec<f64> = values.iter().filter(|value| **value > 0.0).map(|value| value.ln()).collect();
    (!logs.is_empty()).then(|| (logs.iter().sum::<f64>() / logs.len() as f64).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_is_what_nothing_beats() {
        let points = [(1.0, 9.0), (2.0, 5.0), (2.0, 6.0), (3.0, 5.0), (4.0, 1.0), (5.0, 1.0), (0.5, 20.0), (4.0, 1.0)];
        assert_eq!(front(&points), [true, true, false, false, true, false, true, true]);
        assert_eq!(front(&[]), [] as [bool; 0]);
    }

    #[test]
    fn an_exponent_is_found_and_not_made_up() {
        let cubes: Vec<_> = [1.0, 2.0, 5.0].map(|x: f64| (x, 7.0 * x.powi(3))).to_vec();
        assert!(exponent(&cubes).is_some_and(|exponent| (exponent - 3.0).abs() < 1e-12));
        assert_eq!(exponent(&[(1.0, 1.0), (1.9, 3.0)]), None);
        assert_eq!(exponent(&[]), None);
        assert_eq!(exponent(&[(1.0, 0.0), (9.0, 1.0)]), None);
    }

    #[test]
    fn medians_and_means() {
        assert_eq!((median(vec![3.0, 1.0, 2.0]), median(vec![4.0, 1.0])), (2.0, 2.5));
        assert!(geometric_mean(&[1.0, 100.0]).is_some_and(|mean| (mean - 10.0).abs() < 1e-12));
        assert_eq!(geometric_mean(&[0.0]), None);
    }
}
