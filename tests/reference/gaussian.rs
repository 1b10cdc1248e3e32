//! Gaussian averages over the existing pixels of a square window (sections 6.2 to 6.4, and 8.3).

use super::{Grid, Point, square};

/// The existing pixels of the window and their weights exp(−|o|²/2σ²).
fn window(plane: &Grid, p: Point, sigma: f64, radius: usize) -> Vec<(Point, f64)> {
    let weight = |o: Point| (-((o.x * o.x + o.y * o.y) as f64) / (2.0 * sigma * sigma)).exp();
    square(radius).map(|o| (p + o, weight(o))).filter(|(q, _)| plane.contains(*q)).collect()
}

/// Σ w·v / Σ w.
pub fn gaussian(plane: &Grid, sigma: f64, radius: usize) -> Grid {
    plane.like(|p| {
        let window = window(plane, p, sigma, radius);
        window.iter().map(|(q, w)| w * plane.at(*q)).sum::<f64>() / window.iter().map(|(_, w)| w).sum::<f64>()
    })
}

/// Equation 6.2: Σ w²·v / (Σ w)².
pub fn gaussian_variance(variance: &Grid, sigma: f64, radius: usize) -> Grid {
    variance.like(|p| {
        let window = window(variance, p, sigma, radius);
        window.iter().map(|(q, w)| w * w * variance.at(*q)).sum::<f64>() / window.iter().map(|(_, w)| w).sum::<f64>().powi(2)
    })
}

/// The average of all but the centre (section 6.2.4); a pixel that is alone keeps its value.
pub fn gaussian_neighbours(plane: &Grid, sigma: f64, radius: usize) -> Grid {
    plane.like(|p| {
        let mut window = window(plane, p, sigma, radius);
        window.retain(|(q, _)| *q != p);
        if window.is_empty() {
            return plane.at(p);
        }
        window.iter().map(|(q, w)| w * plane.at(*q)).sum::<f64>() / window.iter().map(|(_, w)| w).sum::<f64>()
    })
}
