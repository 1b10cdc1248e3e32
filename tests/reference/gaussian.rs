//! Gaussian averages over the existing pixels of a square window (sections 6.2 to 6.4, and 8.3).

use super::{Grid, Point};

/// Weights exp(−|o|²/2σ²), which are products of one factor for each axis.
struct Window {
    radius: isize,
    /// exp(−d²/2σ²) of each distance along an axis.
    of_distance: Vec<f64>,
}

impl Window {
    fn new(sigma: f64, radius: usize) -> Window {
        let of_distance =
            (0..=radius).map(|distance| (-((distance * distance) as f64) / (2.0 * sigma * sigma)).exp()).collect();
        Window { radius: radius as isize, of_distance }
    }

    /// The existing pixels around a pixel, and their weights.
    fn around(&self, plane: &Grid, p: Point) -> Vec<(Point, f64)> {
        let axis = |at: isize, length: usize| (at - self.radius).max(0)..=(at + self.radius).min(length as isize - 1);
        let weight = |q: Point| self.of_distance[q.x.abs_diff(p.x)] * self.of_distance[q.y.abs_diff(p.y)];
        axis(p.y, plane.height)
            .flat_map(|y| axis(p.x, plane.width).map(move |x| Point { x, y }))
            .map(|q| (q, weight(q)))
            .collect()
    }
}

/// Σ w·v / Σ w.
pub fn gaussian(plane: &Grid, sigma: f64, radius: usize) -> Grid {
    let window = Window::new(sigma, radius);
    plane.like(|p| {
        let window = window.around(plane, p);
        window.iter().map(|(q, w)| w * plane.at(*q)).sum::<f64>() / window.iter().map(|(_, w)| w).sum::<f64>()
    })
}

/// Equation 6.2: Σ w²·v / (Σ w)².
pub fn gaussian_variance(variance: &Grid, sigma: f64, radius: usize) -> Grid {
    let window = Window::new(sigma, radius);
    variance.like(|p| {
        let window = window.around(variance, p);
        window.iter().map(|(q, w)| w * w * variance.at(*q)).sum::<f64>()
            / window.iter().map(|(_, w)| w).sum::<f64>().powi(2)
    })
}

/// The average of all but the centre (section 6.2.4); a single pixel keeps its value.
pub fn gaussian_neighbours(plane: &Grid, sigma: f64, radius: usize) -> Grid {
    let window = Window::new(sigma, radius);
    plane.like(|p| {
        let mut window = window.around(plane, p);
        window.retain(|(q, _)| *q != p);
        if window.is_empty() {
            return plane.at(p);
        }
        window.iter().map(|(q, w)| w * plane.at(*q)).sum::<f64>() / window.iter().map(|(_, w)| w).sum::<f64>()
    })
}
