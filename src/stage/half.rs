//! The two halves of the samples, each by itself (thesis 7.1.1).

use glam::IVec2;

use super::nlm::Filtered;
use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! { struct HalfParams { extent: IVec2 } }

bindings! {
    struct HalfSplit<'a> {
        uniform params: HalfParams, read signal, read variance_of_mean, write half_a, write half_b,
        write variance_of_half,
    }
    struct HalfJoin<'a> {
        uniform params: HalfParams, read half_a, read half_b, read weights_a, read weights_b, write signal,
        write weights,
    }
}

/// A signal as its halves, one plane each.
#[derive(Debug)]
pub struct Halves {
    /// Mean + half spread.
    pub a: Buffer,
    /// Mean − half spread.
    pub b: Buffer,
    /// Variance of the mean of one half: twice the variance of the mean of both.
    pub variance: Buffer,
}

/// Splits a signal into its halves, which have equal numbers of samples; both halves get the w of the mean.
/// `variance_of_mean` is the variance of the mean of both, one plane.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn half_split(rec: &mut Recorder, extent: IVec2, signal: &Buffer, variance_of_mean: &Buffer) -> Result<Halves> {
    let a = rec.take("half A", plane_bytes(extent, 1))?;
    let b = rec.take("half B", plane_bytes(extent, 1))?;
    let variance = rec.take("variance of a half", plane_bytes(extent, 1))?;
    let bound = HalfSplit {
        params: HalfParams { extent },
        signal,
        variance_of_mean,
        half_a: &a,
        half_b: &b,
        variance_of_half: &variance,
    };
    rec.dispatch("half_split", &[], &bound, per_pixel(extent))?;
    Ok(Halves { a, b, variance })
}

/// Joins two halves, of one plane each, into a signal. Their w is averaged like their colour; the weights are the mean
/// of their Σ w in one plane, x.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn half_join(rec: &mut Recorder, extent: IVec2, [a, b]: [&Filtered; 2]) -> Result<Filtered> {
    let signal = rec.take("joined halves", plane_bytes(extent, 2))?;
    let weights = rec.take("weight sums of both halves", plane_bytes(extent, 1))?;
    let params = HalfParams { extent };
    let bound = HalfJoin {
        params,
        half_a: &a.planes,
        half_b: &b.planes,
        weights_a: &a.weights,
        weights_b: &b.weights,
        signal: &signal,
        weights: &weights,
    };
    rec.dispatch("half_join", &[], &bound, per_pixel(extent))?;
    Ok(Filtered { planes: signal, weights, residual_variance: None })
}
