//! The adaptive loop on a built-in scene: what is asked for, its steps in the worker, and what the window has of it.

use std::sync::Arc;
use std::time::Instant;

use stein::gpu::Pace;
use stein::sampling::{Event, Iterations, Plan, SampleCounts, Sampler, Samples, SamplingMap};
use stein::{Denoiser, Error, Extent, Gpu, Image};
use stein_stub::{Sequence, StubSampler, scene, scenes};

use crate::document::{Denoised, Document, Opened, drawn_layer, input_layers, reference_layer};
use crate::settings::Parameters;

/// What is sampled, and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setup {
    /// One of [`scenes`].
    pub scene: String,
    /// Width and height, in pixels.
    pub extent: Extent,
    /// On average, of all iterations together; an even number.
    pub samples_per_pixel: u32,
    /// Of which the first samples evenly.
    pub iterations: u32,
    /// Same seed, same samples.
    pub seed: u32,
    /// Samples per pixel of a reference that is drawn after the last iteration; an even number, 0 for none.
    pub reference_samples: u32,
}

impl Default for Setup {
    fn default() -> Self {
        let extent = Extent { width: 128, height: 128 };
        Self { scene: "dof".into(), extent, samples_per_pixel: 32, iterations: 4, seed: 1, reference_samples: 256 }
    }
}

impl Setup {
    fn plan(&self) -> stein::Result<Plan> {
        Ok(Plan::new(self.samples_per_pixel, self.iterations, None)?.with_default_cap())
    }

    fn sampler(&self, seed: u64, sequence: Sequence) -> stein::Result<StubSampler> {
        let scene = scene(&self.scene).ok_or_else(|| {
            let known: Vec<_> = scenes().map(|(name, _)| name).collect();
            Error::Request {
                problem: format!("there is no scene '{}'", self.scene),
                remedy: format!("choose one of {}", known.join(", ")),
            }
        })?;
        Ok(StubSampler::new(scene, self.extent, seed, sequence))
    }
}

/// A loop on its way, which the worker hands on from one step to the next.
#[derive(Clone, Debug)]
pub struct Loop {
    setup: Setup,
    parameters: Parameters,
    /// `None` before the first step.
    state: Option<(StubSampler, Iterations)>,
    /// Those that are complete.
    complete: Vec<Iteration>,
}

/// What a step has come to.
#[derive(Debug)]
pub struct Adapted {
    /// What there is now.
    pub step: Step,
    /// Whether the loop is at its end.
    pub is_last: bool,
}

/// See [`Adapted`].
#[derive(Debug)]
pub enum Step {
    /// One more iteration.
    Iteration(Box<Iteration>),
    /// All iterations, compared with a reference.
    Compared(Vec<Iteration>),
}

/// An iteration that is complete.
#[derive(Clone, Debug)]
pub struct Iteration {
    /// From 1.
    pub number: u32,
    /// On average, of all iterations so far.
    pub samples_per_pixel: f64,
    /// Fewest and most samples of a pixel so far.
    pub spread: [u64; 2],
    /// The samples so far, as a frame.
    pub opened: Opened,
    /// What they were denoised to.
    pub denoised: Denoised,
}

impl Loop {
    /// A loop that has drawn nothing yet.
    pub fn new(setup: Setup, parameters: Parameters) -> Self {
        Self { setup, parameters, state: None, complete: Vec::new() }
    }

    /// Draws and denoises the next iteration, or draws the reference and compares all of them with it. `check` is told
    /// how much of the whole loop is done, and ends it by an error.
    ///
    /// # Errors
    /// A setup that cannot be met, and as [`Iterations::step`].
    pub fn step(
        &mut self,
        gpu: &Gpu,
        pace: Pace,
        check: &(impl Fn(f32) -> stein::Result<()> + Sync),
    ) -> stein::Result<Adapted> {
        if self.state.is_none() {
            gpu.set_timing(true);
            let method = self.parameters.method;
            let iterations =
                Iterations::new(&Denoiser::new(gpu, method)?, &self.setup.plan()?).with_kept(method.intermediates());
            self.state = Some((self.setup.sampler(self.setup.seed.into(), Sequence::Random)?, iterations));
        }
        let Self { setup, parameters, state: Some((sampler, iterations)), complete } = self else {
            return Err(Error::Cancelled);
        };
        let has_reference = setup.reference_samples > 0;
        let parts = (iterations.plan().iterations() + u32::from(has_reference)) as f32;
        if iterations.done() == iterations.plan().iterations() {
            let reference = Arc::new(draw_reference(setup, |share| check((parts - 1.0 + share) / parts))?);
            let layer = reference_layer(&reference);
            for iteration in complete.iter_mut() {
                iteration.opened.compare(&layer);
                iteration.denoised.compare(&reference);
            }
            return Ok(Adapted { step: Step::Compared(std::mem::take(complete)), is_last: true });
        }
        iterations.set_pace(Some(pace));
        let (mut drawn_at, mut finished) = (Instant::now(), None);
        let goes_on = iterations.step(sampler, &mut |event: Event<'_>| match event {
            Event::Planned { iteration, .. } => check((iteration - 1) as f32 / parts),
            // Nobody knows which takes longer; half of the way each is near enough.
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
        Ok(Adapted { step: Step::Iteration(Box::new(iteration)), is_last: !goes_on && !has_reference })
    }
}

/// The samples so far as something that is open.
fn opened_of(setup: &Setup, number: u32, map: Option<&SamplingMap>, samples: &Samples) -> stein::Result<Opened> {
    let (frame, repairs) = samples.to_frame()?;
    let mut layers = input_layers(&frame, None);
    layers.extend(map.map(|map| drawn_layer(&map.counts)));
    let name = format!("{}, iteration {number} of {}", setup.scene, setup.iterations);
    Ok(Opened { source: None, name, frame: Arc::new(frame), repairs, reference: None, noisy_error: None, layers })
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

/// Many samples, spread better than at random. No other seed is likely to be this one.
fn draw_reference(setup: &Setup, check: impl Fn(f32) -> stein::Result<()> + Sync) -> stein::Result<Image> {
    let mut sampler = setup.sampler(!u64::from(setup.seed), Sequence::LowDiscrepancy)?;
    let counts = SampleCounts::uniform(setup.extent, setup.reference_samples)?;
    let mut progress = |share: f32| {
        if check(share).is_ok() { std::ops::ControlFlow::Continue(()) } else { std::ops::ControlFlow::Break(()) }
    };
    let samples = sampler.sample(&counts, Some(&mut progress))?;
    Ok(samples.color().mean)
}

/// What the window has of a loop.
#[derive(Debug, Default)]
pub struct Adaptive {
    /// What the next loop does.
    pub setup: Setup,
    /// What the loop in flight, or the last one, does.
    pub started: Option<Setup>,
    /// Those that are complete.
    pub iterations: Vec<Iteration>,
    /// The one that is shown, by its number; `None` where what is open is not of the loop.
    pub shown: Option<u32>,
    /// Whether the newest one is shown as it comes.
    pub follows: bool,
    /// Whether it goes on.
    pub is_running: bool,
}

impl Adaptive {
    /// Starts anew.
    pub fn start(&mut self, parameters: Parameters) -> Loop {
        self.iterations.clear();
        (self.started, self.shown, self.follows, self.is_running) = (Some(self.setup.clone()), None, true, true);
        Loop::new(self.setup.clone(), parameters)
    }

    /// Forgets the iterations: something else is open.
    pub fn clear(&mut self) {
        *self = Self { setup: std::mem::take(&mut self.setup), ..Self::default() };
    }

    /// An iteration as what is open, with the result of the one before to compare with.
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
