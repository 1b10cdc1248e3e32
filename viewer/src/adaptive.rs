//! The adaptive loop on a built-in scene: its setup, its steps in the worker, and its state in the window.

use std::sync::Arc;
use std::time::Instant;

use stein::error::RequestCause;
use stein::gpu::Pace;
use stein::sampling::{Event, Iterations, SampleCounts, SampleSchedule, Sampler, Samples, SamplingMap};
use stein::{Denoiser, Error, Extent, Gpu, Image};
use stein_stub::{Sequence, StubSampler, scene, scenes};

use crate::document::{Denoised, Document, Opened, drawn_layer, input_layers, reference_layer};
use crate::settings::Parameters;

/// Settings of an adaptive loop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setup {
    /// Name of the scene, one of [`scenes`].
    pub scene: String,
    /// Width and height, in pixels.
    pub extent: Extent,
    /// Mean number of samples per pixel, over all iterations together; an even number.
    pub samples_per_pixel: u32,
    /// Number of iterations; the first one spreads its samples evenly over the image.
    pub iterations: u32,
    /// Seed of the random numbers: the same seed draws the same samples.
    pub seed: u32,
    /// Samples per pixel of a reference that is drawn after the last iteration: an even number, or 0 for no reference.
    pub reference_samples: u32,
}

impl Default for Setup {
    fn default() -> Self {
        let extent = Extent { width: 128, height: 128 };
        Self { scene: "dof".into(), extent, samples_per_pixel: 32, iterations: 4, seed: 1, reference_samples: 256 }
    }
}

impl Setup {
    fn schedule(&self) -> stein::Result<SampleSchedule> {
        Ok(SampleSchedule::new(self.samples_per_pixel, self.iterations, None)?.with_default_cap())
    }

    fn sampler(&self, seed: u64, sequence: Sequence) -> stein::Result<StubSampler> {
        let scene = scene(&self.scene).ok_or_else(|| {
            let known: Vec<_> = scenes().map(|(name, _)| name).collect();
            Error::Request(RequestCause::Other {
                problem: format!("there is no scene '{}'", self.scene),
                remedy: format!("choose one of {}", known.join(", ")),
            })
        })?;
        Ok(StubSampler::new(scene, self.extent, seed, sequence))
    }
}

/// State of a running loop, which the worker hands from one step to the next.
#[derive(Clone, Debug)]
pub struct Loop {
    setup: Setup,
    parameters: Parameters,
    /// Sampler and iterations; `None` before the first step.
    state: Option<(StubSampler, Iterations)>,
    /// Complete iterations, oldest first.
    complete: Vec<Iteration>,
}

/// Outcome of one step of the loop.
#[derive(Debug)]
pub struct Adapted {
    /// Result of the step.
    pub result: StepResult,
    /// Whether this was the last step of the loop.
    pub is_last: bool,
}

/// Result of a step; see [`Adapted`].
#[derive(Debug)]
pub enum StepResult {
    /// One more iteration is complete.
    Iteration(Box<Iteration>),
    /// All iterations were compared with a reference.
    Compared(Vec<Iteration>),
}

/// A complete iteration.
#[derive(Clone, Debug)]
pub struct Iteration {
    /// Number of the iteration, from 1.
    pub number: u32,
    /// Mean number of samples per pixel, over all iterations so far.
    pub samples_per_pixel: f64,
    /// Fewest and most samples that any pixel has so far.
    pub spread: [u64; 2],
    /// Frame that was made of all samples so far.
    pub opened: Opened,
    /// Result of denoising that frame.
    pub denoised: Denoised,
}

impl Loop {
    /// Creates a loop that has drawn nothing yet.
    pub fn new(setup: Setup, parameters: Parameters) -> Self {
        Self { setup, parameters, state: None, complete: Vec::new() }
    }

    /// Draws and denoises the next iteration; after the last iteration, draws the reference and compares all iterations
    /// with it. Passes the share of the whole loop that is done, 0 to 1, to `check`; an error of `check` ends the loop.
    ///
    /// # Errors
    /// [`Error::Request`] for a setup that is not valid; otherwise as [`Iterations::step`].
    pub fn step(
        &mut self,
        gpu: &Gpu,
        pace: Pace,
        check: &(impl Fn(f32) -> stein::Result<()> + Sync),
    ) -> stein::Result<Adapted> {
        if self.state.is_none() {
            gpu.set_timing(true);
            let method = self.parameters.method;
            let iterations = Iterations::new(&Denoiser::new(gpu, method)?, &self.setup.schedule()?)
                .with_kept(method.intermediates());
            self.state = Some((self.setup.sampler(self.setup.seed.into(), Sequence::Random)?, iterations));
        }
        let Self { setup, parameters, state: Some((sampler, iterations)), complete } = self else {
            return Err(Error::Cancelled);
        };
        let has_reference = setup.reference_samples > 0;
        let parts = (iterations.schedule().iterations() + u32::from(has_reference)) as f32;
        if iterations.done() == iterations.schedule().iterations() {
            let reference = Arc::new(draw_reference(setup, |share| check((parts - 1.0 + share) / parts))?);
            let layer = reference_layer(&reference);
            for iteration in complete.iter_mut() {
                iteration.opened.compare(&layer);
                iteration.denoised.compare(&reference);
            }
            return Ok(Adapted { result: StepResult::Compared(std::mem::take(complete)), is_last: true });
        }
        iterations.set_pace(Some(pace));
        let (mut drawn_at, mut finished) = (Instant::now(), None);
        let goes_on = iterations.step(sampler, &mut |event: Event<'_>| match event {
            Event::Planned { iteration, .. } => check((iteration - 1) as f32 / parts),
            // Drawing and denoising count as half of an iteration each: nobody knows which takes longer.
            Event::Drawing { iteration, share } => {
                drawn_at = Instant::now();
                check(((iteration - 1) as f32 + 0.5 * share) / parts)
            }
            Event::Denoising { iteration, share } => check(((iteration - 1) as f32 + 0.5 + 0.5 * share) / parts),
            Event::Finished { iteration, map, samples, estimate, method } => {
                let seconds = drawn_at.elapsed().as_secs_f64();
                let (denoiser, opened) = (Denoiser::new(gpu, *method)?, opened_of(setup, iteration, map, samples)?);
                let denoised =
                    Denoised::new(&denoiser, parameters.preset, &opened.frame, estimate.clone(), None, seconds)?;
                finished = Some(iteration_of(iteration, &samples.counts(), opened, denoised));
                Ok(())
            }
        })?;
        let iteration = finished.ok_or(Error::Cancelled)?;
        complete.push(iteration.clone());
        Ok(Adapted { result: StepResult::Iteration(Box::new(iteration)), is_last: !goes_on && !has_reference })
    }
}

/// Makes a frame of the samples so far, with its layers.
fn opened_of(setup: &Setup, number: u32, map: Option<&SamplingMap>, samples: &Samples) -> stein::Result<Opened> {
    let (frame, repairs) = samples.to_frame()?;
    let mut layers = input_layers(&frame, None);
    layers.extend(map.map(|map| drawn_layer(&map.counts)));
    let name = format!("{}, iteration {number} of {}", setup.scene, setup.iterations);
    Ok(Opened {
        source: None,
        input: None,
        name,
        frame: Arc::new(frame),
        repairs,
        contradiction: None,
        left_out: None,
        reference: None,
        noisy_error: None,
        layers,
    })
}

fn iteration_of(number: u32, counts: &SampleCounts, opened: Opened, denoised: Denoised) -> Iteration {
    let of_pixels = || counts.pairs().iter().map(|pairs| 2 * u64::from(*pairs));
    Iteration {
        number,
        samples_per_pixel: counts.total_samples() as f64 / counts.extent().pixels() as f64,
        spread: [of_pixels().min().unwrap_or(0), of_pixels().max().unwrap_or(0)],
        opened,
        denoised,
    }
}

/// Draws the reference with a low-discrepancy sequence. Its seed is the seed of the loop, inverted in 64 bits: no loop
/// has that seed, because seeds of loops have 32 bits.
fn draw_reference(setup: &Setup, check: impl Fn(f32) -> stein::Result<()> + Sync) -> stein::Result<Image> {
    let mut sampler = setup.sampler(!u64::from(setup.seed), Sequence::LowDiscrepancy)?;
    let counts = SampleCounts::uniform(setup.extent, setup.reference_samples)?;
    let mut progress = |share: f32| {
        if check(share).is_ok() { std::ops::ControlFlow::Continue(()) } else { std::ops::ControlFlow::Break(()) }
    };
    let samples = sampler.sample(&counts, Some(&mut progress))?;
    Ok(samples.color().mean)
}

/// State of the adaptive loop in the window.
#[derive(Debug, Default)]
pub struct Adaptive {
    /// Setup of the next loop.
    pub setup: Setup,
    /// Setup of the loop that is running, or of the last one.
    pub started: Option<Setup>,
    /// Complete iterations, oldest first.
    pub iterations: Vec<Iteration>,
    /// Number of the iteration that is shown; `None` if the open document is not an iteration.
    pub shown: Option<u32>,
    /// Whether each new iteration is shown as it arrives.
    pub follows: bool,
    /// Whether the loop is running.
    pub is_running: bool,
}

impl Adaptive {
    /// Starts a new loop, and forgets the iterations of the previous one.
    pub fn start(&mut self, parameters: Parameters) -> Loop {
        self.iterations.clear();
        (self.started, self.shown, self.follows, self.is_running) = (Some(self.setup.clone()), None, true, true);
        Loop::new(self.setup.clone(), parameters)
    }

    /// Forgets everything except the setup, because something else is open.
    pub fn clear(&mut self) {
        *self = Self { setup: std::mem::take(&mut self.setup), ..Self::default() };
    }

    /// Returns an iteration as a document, with the result of the previous iteration as a layer to compare with.
    pub fn document(&self, number: u32) -> Option<Document> {
        let place = self.iterations.iter().position(|iteration| iteration.number == number)?;
        let mut document = Document::new(self.iterations[place].opened.clone());
        if let Some(before) = place.checked_sub(1) {
            document.add(self.iterations[before].denoised.clone());
            document.history.clear();
        }
        document.add(self.iterations[place].denoised.clone());
        Some(document)
    }
}
