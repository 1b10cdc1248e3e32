//! Numbers of samples, and where the next samples pay most (thesis 7.1.2, 8.6).

use glam::IVec2;

use super::{per_pixel, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Recorder, bindings, uniforms};

uniforms! {
    struct SampleAttachParams { extent: IVec2, samples_per_pixel: f32 }
    struct SampleDensityParams { extent: IVec2, samples_per_pixel: f32, relative_floor: f32 }
}

bindings! {
    struct SampleAttach<'a> { uniform params: SampleAttachParams, read signal, write with_samples, optional samples }
    struct SampleDensity<'a> {
        uniform params: SampleDensityParams, read blended, write density, optional errors, optional samples,
    }
}

/// Added to the squared value in relative errors (thesis 7.1.2: 10⁻³), for colour at the order of 1.
pub(super) const RELATIVE_FLOOR: f32 = 1e-3;

/// Number of samples that each pixel's mean was computed from, on the GPU.
#[derive(Debug)]
pub enum GpuSamples {
    /// One number for all pixels; 0 if it is unknown.
    Uniform(f32),
    /// One plane, x: the number of samples.
    PerPixel(Buffer),
}

impl GpuSamples {
    /// Returns the number that holds for all pixels, and the plane of numbers if there is one.
    pub(super) fn parts(&self) -> (f32, Option<&Buffer>) {
        match self {
            Self::Uniform(count) => (*count, None),
            Self::PerPixel(counts) => (0.0, Some(counts)),
        }
    }
}

/// Returns the signal with the number of samples of each pixel, at least 1, in the w of the mean. Filtered along with
/// the colour, this number becomes the samples that contribute to the filtered value.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn sample_attach(rec: &mut Recorder, extent: IVec2, signal: &Buffer, samples: &GpuSamples) -> Result<Buffer> {
    let with_samples = rec.take("signal with samples", plane_bytes(extent, 2))?;
    let (samples_per_pixel, samples) = samples.parts();
    let params = SampleAttachParams { extent, samples_per_pixel };
    rec.dispatch(
        "sample_attach",
        &[("SAMPLES_VARY", samples.is_some().into())],
        &SampleAttach { params, signal, with_samples: &with_samples, samples },
        per_pixel(extent),
    )?;
    Ok(with_samples)
}

/// Returns the gain to be expected from a sample in each pixel: the estimated squared error of the blend relative to
/// its squared value, times W(p) = Σ w / (1 + n_p), n_p the samples of the pixel. Not smoothed, in no unit. One plane,
/// x.
///
/// `blended` is the signal of pass 1 with Σ w in its w. Its error is taken from its half spread (thesis 7.1.2); without
/// halves, pass its `errors` ([`error_blend`](super::error::error_blend)).
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
pub fn sample_density(
    rec: &mut Recorder,
    extent: IVec2,
    blended: &Buffer,
    errors: Option<&Buffer>,
    samples: &GpuSamples,
) -> Result<Buffer> {
    let density = rec.take("sample density", plane_bytes(extent, 1))?;
    let (samples_per_pixel, samples) = samples.parts();
    let params = SampleDensityParams { extent, samples_per_pixel, relative_floor: RELATIVE_FLOOR };
    rec.dispatch(
        "sample_density",
        &[("SAMPLES_VARY", samples.is_some().into()), ("HALVES", errors.is_none().into())],
        &SampleDensity { params, blended, errors, density: &density, samples },
        per_pixel(extent),
    )?;
    Ok(density)
}
