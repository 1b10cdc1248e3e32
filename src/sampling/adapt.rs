//! The adaptive loop (thesis 7.1.3, 8.6): draw, denoise, estimate the error, draw the next samples where they pay most.

use std::ops::ControlFlow;

use super::{SampleCounts, Sampler, Samples, SamplingMap, sampling_density};
use crate::error::{Error, RequestCause, Result};
use crate::frame::RELATIVE_EPSILON;
use crate::gpu::Pace;
use crate::image::{Extent, Image};
use crate::method::{Intermediate, Method};
use crate::{Denoiser, Estimate, Options};

/// Number of samples to draw, and number of iterations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleSchedule {
    samples_per_pixel: u32,
    iterations: u32,
    cap: Option<u32>,
}

impl SampleSchedule {
    /// Makes a schedule of `samples_per_pixel` samples per pixel on average, over all `iterations`. An iteration gives
    /// no pixel more than `cap` samples.
    /// # Errors
    /// [`Error::Request`] where there is not at least one whole pair of samples per pixel for each iteration, or the
    /// cap does not hold what an iteration draws.
    pub fn new(samples_per_pixel: u32, iterations: u32, cap: Option<u32>) -> Result<Self> {
        if iterations == 0 {
            return Err(Error::Request(RequestCause::NoIterations));
        }
        if !samples_per_pixel.is_multiple_of(2) || samples_per_pixel / 2 < iterations {
            return Err(Error::Request(RequestCause::IterationShares { samples_per_pixel, iterations }));
        }
        let schedule = Self { samples_per_pixel, iterations, cap };
        if cap.is_some_and(|cap| cap < schedule.budget(1)) {
            return Err(Error::Request(RequestCause::IterationAboveCap { samples_per_pixel: schedule.budget(1) }));
        }
        Ok(schedule)
    }

    /// Returns the plan with a cap of [`SamplingMap::DEFAULT_CAP`] times the samples per pixel of the first iteration.
    #[must_use]
    pub fn with_default_cap(self) -> Self {
        Self { cap: Some(self.budget(1).saturating_mul(SamplingMap::DEFAULT_CAP)), ..self }
    }

    /// Returns the largest number of samples that an iteration gives a pixel.
    pub fn cap(&self) -> Option<u32> {
        self.cap
    }

    /// Returns the samples per pixel in all iterations together.
    pub fn samples_per_pixel(&self) -> u32 {
        self.samples_per_pixel
    }

    /// Returns the number of iterations.
    pub fn iterations(&self) -> u32 {
        self.iterations
    }

    /// Returns the samples per pixel, on average, that an iteration draws; the first iteration is 1. Iterations get
    /// equal numbers of whole pairs; the first iterations get what is left over.
    pub fn budget(&self, iteration: u32) -> u32 {
        let pairs = self.samples_per_pixel / 2;
        2 * (pairs / self.iterations + u32::from(iteration <= pairs % self.iterations))
    }
}

/// State of a loop that was interrupted after an iteration, to go on from.
#[derive(Clone, Debug)]
pub struct Resumed {
    /// Number of complete iterations.
    pub iterations: u32,
    /// All samples that these iterations drew.
    pub samples: Samples,
}

/// Events of the loop.
#[derive(Debug)]
pub enum Event<'a> {
    /// The samples of this map are about to be drawn.
    Planned {
        /// Number of the iteration; 1 is the first.
        iteration: u32,
        /// Samples to draw; the same number everywhere in the first iteration.
        map: &'a SamplingMap,
        /// Samples of earlier iterations.
        drawn: Option<&'a Samples>,
    },
    /// This share of an iteration's samples is drawn.
    Drawing {
        /// Number of the iteration; 1 is the first.
        iteration: u32,
        /// Share of the samples, 0 to 1.
        share: f32,
    },
    /// This share of the denoising that ends an iteration is done.
    Denoising {
        /// Number of the iteration; 1 is the first.
        iteration: u32,
        /// Share of the denoising, 0 to 1.
        share: f32,
    },
    /// An iteration is complete. A loop that goes on reports the last complete iteration once more.
    Finished {
        /// Number of the iteration; 1 is the first.
        iteration: u32,
        /// Samples that the iteration drew; `None` where it was complete before the interruption.
        map: Option<&'a SamplingMap>,
        /// All samples so far.
        samples: &'a Samples,
        /// Estimate of the image from all samples so far.
        estimate: &'a Estimate,
        /// Method and parameters that made the estimate.
        method: &'a Method,
    },
}

/// Result of the loop.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// All samples.
    pub samples: Samples,
    /// The denoised image.
    pub estimate: Estimate,
}

/// Draws the samples of a schedule: evenly in the first iteration, then where the estimated relative error of the
/// denoised image, seen through the filters' weights, is largest. `observe` receives the events, and ends the loop by
/// an error.
///
/// Until the last iteration, the method works with its parameters for sampling ([`Denoiser::while_sampling`]).
///
/// The same sampler, schedule and device give the same result, even if the loop was interrupted and resumed.
///
/// # Errors
/// The error of the sampler, of the denoiser, or of `observe`: [`Error::Cancelled`] if one of them was cancelled.
pub fn adapt<S: Sampler, E: From<Error> + Send>(
    sampler: &mut S,
    denoiser: &Denoiser,
    schedule: &SampleSchedule,
    resumed: Option<Resumed>,
    mut observe: impl FnMut(Event<'_>) -> std::result::Result<(), E> + Send,
) -> std::result::Result<Outcome, E> {
    let mut iterations = Iterations::new(denoiser, schedule);
    if let Some(resumed) = resumed {
        iterations.resume(resumed, &mut observe)?;
    }
    while iterations.step(sampler, &mut observe)? {}
    // A schedule has at least one iteration.
    iterations.state.ok_or_else(|| Error::Cancelled.into())
}

/// The loop of [`adapt`], one iteration at a time: for a program that does other work between iterations or needs more
/// than the result.
#[derive(Clone, Debug)]
pub struct Iterations {
    denoiser: Denoiser,
    while_sampling: Denoiser,
    schedule: SampleSchedule,
    keep: Vec<Intermediate>,
    pace: Option<Pace>,
    done: u32,
    state: Option<Outcome>,
}

impl Iterations {
    /// Makes a loop that has drawn nothing yet.
    pub fn new(denoiser: &Denoiser, schedule: &SampleSchedule) -> Self {
        let while_sampling = denoiser.while_sampling();
        Self {
            denoiser: denoiser.clone(),
            while_sampling,
            schedule: *schedule,
            keep: vec![Intermediate::Density],
            pace: None,
            done: 0,
            state: None,
        }
    }

    /// Also keeps these intermediates of each iteration in [`Estimate::layers`], except those that the method does not
    /// have.
    #[must_use]
    pub fn with_kept(mut self, keep: &[Intermediate]) -> Self {
        self.keep.extend(keep.iter().filter(|kept| **kept != Intermediate::Density));
        self
    }

    /// Shares the device with other users, such as a window. `None` keeps the device as busy as possible.
    pub fn set_pace(&mut self, pace: Option<Pace>) {
        self.pace = pace;
    }

    /// Returns the numbers of samples and iterations of the loop.
    pub fn schedule(&self) -> &SampleSchedule {
        &self.schedule
    }

    /// Returns the number of complete iterations.
    pub fn done(&self) -> u32 {
        self.done
    }

    fn denoiser(&self, iteration: u32) -> &Denoiser {
        if iteration < self.schedule.iterations { &self.while_sampling } else { &self.denoiser }
    }

    /// Goes on after an interruption. The last complete iteration is denoised and reported once more.
    ///
    /// # Errors
    /// As [`adapt`].
    pub fn resume<E: From<Error> + Send>(
        &mut self,
        resumed: Resumed,
        observe: &mut (impl FnMut(Event<'_>) -> std::result::Result<(), E> + Send),
    ) -> std::result::Result<(), E> {
        let Resumed { iterations: iteration, samples } = resumed;
        let estimate = self.denoise(iteration, &samples, observe)?;
        observe(Event::Finished {
            iteration,
            map: None,
            samples: &samples,
            estimate: &estimate,
            method: self.denoiser(iteration).method(),
        })?;
        (self.done, self.state) = (iteration, Some(Outcome { samples, estimate }));
        Ok(())
    }

    /// Draws and denoises the next iteration, and returns whether there is one more; draws nothing after the last.
    /// After an error, the loop is in the state before the call, but the sampler may have drawn.
    ///
    /// # Errors
    /// As [`adapt`].
    pub fn step<S: Sampler, E: From<Error> + Send>(
        &mut self,
        sampler: &mut S,
        observe: &mut (impl FnMut(Event<'_>) -> std::result::Result<(), E> + Send),
    ) -> std::result::Result<bool, E> {
        if self.done >= self.schedule.iterations {
            return Ok(false);
        }
        let iteration = self.done + 1;
        let budget = self.schedule.budget(iteration);
        let map = match &self.state {
            None => SamplingMap::uniform(sampler.extent(), budget)?,
            Some(Outcome { estimate, .. }) => {
                let density = sampling_density(estimate, budget.into(), self.schedule.samples_per_pixel.into())?;
                SamplingMap::new(&density, budget.into(), self.schedule.cap)?
            }
        };
        observe(Event::Planned { iteration, map: &map, drawn: self.state.as_ref().map(|state| &state.samples) })?;
        let mut samples = draw(sampler, &map.counts, |share| observe(Event::Drawing { iteration, share }))?;
        if let Some(Outcome { samples: before, .. }) = &self.state {
            let new = std::mem::replace(&mut samples, before.clone());
            samples.merge(&new)?;
        }
        let estimate = self.denoise(iteration, &samples, observe)?;
        observe(Event::Finished {
            iteration,
            map: Some(&map),
            samples: &samples,
            estimate: &estimate,
            method: self.denoiser(iteration).method(),
        })?;
        (self.done, self.state) = (iteration, Some(Outcome { samples, estimate }));
        Ok(iteration < self.schedule.iterations)
    }

    fn denoise<E: From<Error>>(
        &self,
        iteration: u32,
        samples: &Samples,
        observe: &mut impl FnMut(Event<'_>) -> std::result::Result<(), E>,
    ) -> std::result::Result<Estimate, E> {
        let (frame, _repairs) = samples.to_frame()?;
        let mut failed = None;
        let mut tell = |share| observe(Event::Denoising { iteration, share });
        let estimate = self.denoiser(iteration).denoise_with(
            &frame,
            Options {
                keep: &self.keep,
                progress: Some(&mut progress(&mut failed, &mut tell)),
                pace: self.pace.clone(),
                ..Options::default()
            },
        );
        estimate.map_err(|error| failed.unwrap_or_else(|| error.into()))
    }
}

/// Draws all samples of a schedule at once and evenly, for comparison with the loop.
///
/// # Errors
/// As [`adapt`].
pub fn uniform<S: Sampler, E: From<Error> + Send>(
    sampler: &mut S,
    denoiser: &Denoiser,
    schedule: &SampleSchedule,
    observe: impl FnMut(Event<'_>) -> std::result::Result<(), E> + Send,
) -> std::result::Result<Outcome, E> {
    adapt(sampler, denoiser, &SampleSchedule { iterations: 1, cap: None, ..*schedule }, None, observe)
}

/// Returns the relative MSE that the denoised image would have, without a reference: the estimated squared error
/// divided by the square of the denoised colour. For DFC it is the error of pass 1, and may be below 0 where little is
/// left to estimate. `None` for an estimate without error.
pub fn estimated_relative_mse(estimate: &Estimate) -> Option<f64> {
    let error = &estimate.error.as_ref()?.planes[0];
    let square = |pixel: usize| {
        estimate.color.planes.iter().map(|plane| f64::from(plane[pixel]).powi(2) + RELATIVE_EPSILON).sum::<f64>()
    };
    Some(
        error.iter().enumerate().map(|(pixel, &error)| f64::from(error) / square(pixel)).sum::<f64>()
            / error.len() as f64,
    )
}

impl SamplingMap {
    /// Makes a map with one even number of samples for all pixels.
    ///
    /// # Errors
    /// [`Error::Request`] for an odd number.
    pub fn uniform(extent: Extent, samples: u32) -> Result<Self> {
        Ok(Self { density: Image::filled(extent, 1, samples as f32), counts: SampleCounts::uniform(extent, samples)? })
    }
}

/// Turns a callback that may fail into one that may break off, and keeps its error.
fn progress<E>(
    failed: &mut Option<E>,
    mut tell: impl FnMut(f32) -> std::result::Result<(), E>,
) -> impl FnMut(f32) -> ControlFlow<()> {
    move |share| match tell(share) {
        Ok(()) => ControlFlow::Continue(()),
        Err(error) => {
            *failed = Some(error);
            ControlFlow::Break(())
        }
    }
}

fn draw<S: Sampler, E: From<Error> + Send>(
    sampler: &mut S,
    counts: &SampleCounts,
    tell: impl FnMut(f32) -> std::result::Result<(), E> + Send,
) -> std::result::Result<Samples, E> {
    let mut failed = None;
    let drawn = sampler.sample(counts, Some(&mut progress(&mut failed, tell)));
    drawn.map_err(|error| failed.unwrap_or_else(|| error.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budgets_are_whole_pairs_that_sum_to_the_plan() {
        for (samples, iterations) in [(8, 4), (10, 4), (22, 4), (64, 3), (2, 1), (14, 7)] {
            let schedule = SampleSchedule::new(samples, iterations, None).expect("enough for all");
            let budgets: Vec<u32> = (1..=iterations).map(|iteration| schedule.budget(iteration)).collect();
            assert_eq!(budgets.iter().sum::<u32>(), samples);
            assert!(budgets.iter().all(|budget| *budget > 0 && budget % 2 == 0), "{budgets:?}");
            assert!(budgets[0] - budgets[budgets.len() - 1] <= 2, "{budgets:?}");
        }
    }

    #[test]
    fn plans_that_cannot_be_met_are_refused() {
        for (samples, iterations, cap) in [(6, 4, None), (9, 4, None), (8, 0, None), (0, 1, None), (32, 4, Some(6))] {
            assert!(
                matches!(SampleSchedule::new(samples, iterations, cap), Err(Error::Request { .. })),
                "{samples} {iterations} {cap:?}"
            );
        }
    }
}
