//! A stand-in for a renderer: a path tracer over a few analytic shapes, small enough to read, and realistic enough to
//! test a denoiser and its sampling loop.
//!
//! It has area lights, a sky and a sun, diffuse and rough glossy surfaces, mirrors, glass, depth of field and motion
//! blur, and a box pixel filter. Its features are noisy like those of a renderer: albedo, normal (world, towards the
//! viewer) and depth (along the ray) of the first hit, all 0 where a ray hits nothing; visibility, the fraction of
//! unblocked shadow rays from the first surface that scatters light, 1 where there is none; caustic, the radiance that
//! reached such a surface through mirrors or glass (thesis 8.4).
//!
//! ```
//! use stein::Extent;
//! use stein::sampling::{SampleCounts, Sampler};
//! use stein_stub::{Sequence, StubSampler};
//!
//! # fn main() -> stein::error::Result<()> {
//! let extent = Extent { width: 24, height: 16 };
//! let scene = stein_stub::scene("dof").expect("one of `stein_stub::scenes()`");
//! let mut sampler = StubSampler::new(scene, extent, 1, Sequence::Random);
//! let mut samples = sampler.sample(&SampleCounts::uniform(extent, 4)?, None)?;
//! // A pass that asks for more where it matters: here, in the lower half.
//! let wanted = (0..extent.pixels()).map(|pixel| if pixel < extent.pixels() / 2 { 0 } else { 8 });
//! let counts = SampleCounts::from_samples(extent, &wanted.collect::<Vec<_>>())?;
//! samples.merge(&sampler.sample(&counts, None)?)?;
//! let (frame, _repairs) = samples.to_frame()?;
//! # assert_eq!(frame.extent(), extent);
//! # Ok(())
//! # }
//! ```
//!
//! The same seed gives the same picture whatever the number of threads and however the samples are split into passes,
//! up to the order of summation.

mod camera;
mod light;
mod material;
mod path;
mod random;
mod scene;
mod scenes;
mod shape;
mod texture;

use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

pub use camera::Camera;
pub use light::{Environment, Sun};
pub use material::Material;
pub use random::Sequence;
pub use scene::Scene;
pub use scenes::{scene, scenes};
pub use shape::Shape;
pub use texture::Texture;

use camera::View;
use path::{CHANNELS, FEATURES};
use random::Numbers;
use stein::error::{Error, RequestCause, Result};
use stein::image::Extent;
use stein::sampling::{PixelAccumulator, Progress, SampleCounts, Sampler, Samples};

/// How paths find light. Both ways have the same mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Transport {
    /// Shadow rays, weighed against light met by chance.
    LightSampling,
    /// Paths find light by chance only: much noisier, and visibility is 1 everywhere.
    Chance,
}

/// Draws samples of a scene.
#[derive(Clone, Debug)]
pub struct StubSampler {
    scene: Scene,
    extent: Extent,
    seed: u64,
    sequence: Sequence,
    transport: Transport,
    /// Number of samples drawn so far in each half, for each pixel.
    drawn: Vec<u32>,
}

impl StubSampler {
    /// Creates a sampler that has not drawn anything yet. Two samplers with the same seed draw the same samples.
    pub fn new(scene: Scene, extent: Extent, seed: u64, sequence: Sequence) -> Self {
        Self { scene, extent, seed, sequence, transport: Transport::LightSampling, drawn: vec![0; extent.pixels()] }
    }

    /// Sets how paths find light.
    #[must_use]
    pub fn with_transport(mut self, transport: Transport) -> Self {
        self.transport = transport;
        self
    }

    /// Continues after these samples, as if this sampler had drawn them, for example to continue a stored render.
    ///
    /// # Errors
    /// [`Error::Request`] for counts of another extent.
    pub fn continue_after(mut self, drawn: &SampleCounts) -> Result<Self> {
        self.check(drawn)?;
        self.drawn = drawn.pairs().to_vec();
        Ok(self)
    }

    fn check(&self, counts: &SampleCounts) -> Result<()> {
        if counts.extent() == self.extent {
            return Ok(());
        }
        Err(Error::Request(RequestCause::CountsLength { counts: counts.pairs().len(), extent: self.extent }))
    }

    fn pixel(&self, view: &View, pixel: usize, pairs: u32) -> PixelAccumulator<CHANNELS> {
        let mut statistics = PixelAccumulator::default();
        let first = self.drawn[pixel];
        let width = self.extent.width as usize;
        let (column, row) = ((pixel % width) as f32, (pixel / width) as f32);
        for index in first..first.saturating_add(pairs) {
            let samples = [0, 1].map(|half| {
                let mut numbers = Numbers::new(self.sequence, self.seed, pixel, half, index);
                let [x, y, u, v] = numbers.next_four();
                let [time, ..] = numbers.next_four();
                let ray = view.ray(column + x, row + y, [u, v], time);
                path::trace(&self.scene, self.transport, ray, &mut numbers).channels()
            });
            statistics.add_pair([&samples[0], &samples[1]]);
        }
        statistics
    }
}

/// State that the threads share: rows are added as they are finished.
struct Finished<'a, 'b> {
    samples: Samples,
    drawn: u64,
    progress: &'a mut Progress<'b>,
}

impl Sampler for StubSampler {
    fn extent(&self) -> Extent {
        self.extent
    }

    fn sample(&mut self, counts: &SampleCounts, mut progress: Progress<'_>) -> Result<Samples> {
        self.check(counts)?;
        let total = counts.total_samples().max(1);
        let view = View::new(&self.scene.camera, self.extent);
        let width = self.extent.width as usize;
        let finished =
            Mutex::new(Finished { samples: Samples::none(self.extent, &FEATURES), drawn: 0, progress: &mut progress });
        (0..self.extent.height as usize).into_par_iter().try_for_each(|row| {
            let pixels = row * width..(row + 1) * width;
            let statistics: Vec<_> =
                pixels.clone().map(|pixel| self.pixel(&view, pixel, counts.pairs()[pixel])).collect();
            // If a callback panicked in another thread, nothing here is left half done.
            let mut finished = finished.lock().unwrap_or_else(PoisonError::into_inner);
            for (pixel, statistics) in pixels.clone().zip(&statistics) {
                finished.samples.set(pixel, statistics);
            }
            finished.drawn += counts.pairs()[pixels].iter().map(|&pairs| 2 * u64::from(pairs)).sum::<u64>();
            let share = (finished.drawn as f64 / total as f64) as f32;
            match &mut *finished.progress {
                Some(progress) => {
                    if progress(share).is_break() {
                        Err(Error::Cancelled)
                    } else {
                        Ok(())
                    }
                }
                None => Ok(()),
            }
        })?;
        let samples = finished.into_inner().unwrap_or_else(PoisonError::into_inner).samples;
        self.drawn.iter_mut().zip(counts.pairs()).for_each(|(drawn, pairs)| *drawn = drawn.saturating_add(*pairs));
        Ok(samples)
    }
}
