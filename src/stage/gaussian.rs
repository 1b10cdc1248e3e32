//! Gaussian averages (thesis 6.4): scales of an image, their variances, stopping maps.

use glam::IVec2;

use super::plane_bytes;
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! { struct GaussianParams { extent: IVec2, axis: IVec2, radius: i32, exponent: f32 } }
bindings! {
    struct GaussianAxis<'a> { uniform params: GaussianParams, around source, write smoothed, optional centres }
}

/// A Gaussian over a square of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian {
    /// Standard deviation in pixels, above 0.
    pub sigma: f32,
    /// The square is 2·radius+1 pixels wide.
    pub radius: u32,
}

impl Gaussian {
    /// Makes a Gaussian that is cut off at 3σ, rounded up.
    pub fn new(sigma: f32) -> Self {
        Self { sigma, radius: (3.0 * sigma).ceil() as u32 }
    }

    /// Returns the weight of a pixel at this offset along both axes: 1 for the pixel itself, 0 beyond the square.
    pub(crate) fn weight(&self, offset: IVec2) -> f32 {
        match offset.abs().max_element() {
            // With σ = 0, this is the only weight.
            0 => 1.0,
            reach if reach > self.radius as i32 => 0.0,
            _ => (self.exponent() * offset.length_squared() as f32).exp(),
        }
    }

    /// Returns −1/(2σ²): the weight of a pixel at distance d is exp(d² times this).
    pub(super) fn exponent(&self) -> f32 {
        -0.5 / (self.sigma * self.sigma)
    }
}

/// Quantities to sum. The sums run over the existing pixels of the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Averaging {
    /// Σ w·v / Σ w.
    Mean,
    /// Σ w²·v / (Σ w)²: the variance of the mean, where v are the variances of independent pixels (eq. 6.2).
    Variance,
    /// The mean over all but the pixel itself, of x, y and z; w becomes 0. A pixel without neighbours keeps its value.
    Neighbours,
}

/// Smooths `planes` planes with a Gaussian.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn gaussian(
    rec: &mut Recorder,
    extent: IVec2,
    source: &Buffer,
    planes: u32,
    gaussian: Gaussian,
    averaging: Averaging,
) -> Result<Buffer> {
    let along =
        |axis: IVec2| GaussianParams { extent, axis, radius: gaussian.radius as i32, exponent: gaussian.exponent() };
    // An invocation makes four pixels along the axis.
    let invocations = |axis: IVec2| {
        [(extent.x as u32).div_ceil(1 + 3 * axis.x as u32), (extent.y as u32).div_ceil(1 + 3 * axis.y as u32), planes]
    };
    let squared = ("SQUARED", (averaging == Averaging::Variance).into());
    let without_centre = averaging == Averaging::Neighbours;
    let smoothed = rec.take("Gaussian average", plane_bytes(extent, planes))?;
    let rows = &rec.take("Gaussian average of the rows", plane_bytes(extent, planes))?;

    let source_of_rows = source.within_columns_and_rows(gaussian.radius, 0);
    let bound = GaussianAxis { params: along(IVec2::X), source: source_of_rows, smoothed: rows, centres: None };
    rec.dispatch("gaussian", &[squared, ("KEEP_WEIGHT_SUM", without_centre.into())], &bound, invocations(IVec2::X))?;
    let bound = GaussianAxis {
        params: along(IVec2::Y),
        source: rows.within_columns_and_rows(0, gaussian.radius),
        smoothed: &smoothed,
        centres: without_centre.then_some(source),
    };
    rec.dispatch("gaussian", &[squared, ("WITHOUT_CENTRE", without_centre.into())], &bound, invocations(IVec2::Y))?;
    Ok(smoothed)
}
