//! Generated renders, with the truth beside them.

use std::path::Path;
use stein::error::FileCause;
use stein::frame::RawSignal;

use stein::{Extent, Frame, Image};
use stein_exr::{BufferSet, BufferSetRequest, NamedLayer, read_reference, write_layers};
use stein_reference::random::Random;

/// Properties of the surface that a camera sees in a pixel.
#[derive(Clone, Copy)]
pub(super) struct Surface {
    pub(super) radiance: [f64; 3],
    /// Standard deviation of one sample's radiance.
    pub(super) deviation: [f64; 3],
    pub(super) albedo: [f64; 3],
    pub(super) normal: [f64; 3],
    pub(super) depth: f64,
}

impl Surface {
    /// Returns a surface of this radiance, with half of it as a sample's standard deviation, and with the same features
    /// everywhere.
    pub(super) fn of(radiance: [f64; 3]) -> Self {
        Self {
            radiance,
            deviation: radiance.map(|value| 0.5 * value.abs()),
            albedo: [0.5; 3],
            normal: [0.0, 0.0, 1.0],
            depth: 4.0,
        }
    }

    pub(super) fn grey(radiance: f64) -> Self {
        Self::of([radiance, 0.8 * radiance, 0.6 * radiance])
    }
}

/// Returns a wall above a chequered floor that goes into the distance, and on both a shadow that no feature shows. The
/// median brightness is well between two powers of two.
pub(super) fn room(extent: Extent) -> impl Fn(usize, usize) -> Surface {
    let (width, height) = (extent.width as usize, extent.height as usize);
    move |x, y| {
        let lit = if x * 10 < width * 6 { 1.0 } else { 0.55 };
        let (albedo, normal, depth, light) = if 2 * y < height {
            ([0.7, 0.6, 0.5], [0.0, 0.0, 1.0], 5.0, 2.4)
        } else {
            let chequer = if (x / 5 + y / 4) % 2 == 0 { 0.9 } else { 0.35 };
            let near = (y + 1) as f64 / height as f64;
            ([chequer, 0.9 * chequer, 0.7 * chequer], [0.0, 1.0, 0.0], 5.5 - 2.5 * near, 2.4)
        };
        let radiance = albedo.map(|albedo| albedo * light * lit);
        Surface { albedo, normal, depth, ..Surface::of(radiance) }
    }
}

/// Returns a corridor along the longer side: sections of twenty pixels, each of another colour and distance, every
/// other one in a shadow that no feature shows.
pub(super) fn corridor(extent: Extent) -> impl Fn(usize, usize) -> Surface {
    move |x, y| {
        let section = if extent.width >= extent.height { x } else { y } / 20;
        let albedo = [[0.7, 0.6, 0.5], [0.4, 0.5, 0.6], [0.9, 0.8, 0.3]][section % 3];
        let light = if section % 2 == 0 { 2.4 } else { 1.7 };
        Surface { albedo, depth: 3.0 + 0.5 * section as f64, ..Surface::of(albedo.map(|albedo| albedo * light)) }
    }
}

/// A render and the truth. Everything in it may be damaged before it is written.
#[derive(Clone)]
pub(super) struct Picture {
    pub(super) color: RawSignal,
    pub(super) features: Vec<(String, RawSignal)>,
    pub(super) samples: Samples,
    /// Image without noise; `None` if nobody knows it.
    pub(super) truth: Option<Image>,
    /// Brightness that counts as 1. Errors are relative to ref² + 0.01·unit².
    pub(super) unit: f64,
}

#[derive(Clone)]
pub(super) enum Samples {
    Unknown,
    Uniform(u32),
    PerPixel(Vec<f32>),
}

/// How a picture is sampled.
#[derive(Clone, Copy)]
pub(super) struct Sampling {
    /// Samples of each pixel, the first half of them for half A.
    pub(super) samples: usize,
    /// Factor of all deviations.
    pub(super) noise: f64,
    pub(super) seed: u64,
}

impl Sampling {
    pub(super) fn new(noise: f64) -> Self {
        Self { samples: 8, noise, seed: 7 }
    }
}

impl Picture {
    /// Makes a picture from noisy samples: their mean, their halves and their sample variance. The colour is
    /// distributed exponentially, as light that is found by chance; albedo and depth are Gaussian.
    pub(super) fn sampled(extent: Extent, sampling: Sampling, surface: impl Fn(usize, usize) -> Surface) -> Self {
        let mut random = Random(sampling.seed);
        let (width, pixels) = (extent.width as usize, extent.pixels());
        let surfaces: Vec<Surface> = (0..pixels).map(|pixel| surface(pixel % width, pixel / width)).collect();
        let exponential = |random: &mut Random| -(1.0 - random.uniform()).ln() - 1.0;
        let truth: Vec<[f64; 3]> = surfaces.iter().map(|surface| surface.radiance).collect();
        let color = sampled(extent, sampling, &truth, |pixel| {
            // A path brings light to all channels, and more to one or the other.
            let (of_path, deviation) = (exponential(&mut random), surfaces[pixel].deviation);
            [0, 1, 2].map(|channel| deviation[channel] * (0.8 * of_path + 0.6 * exponential(&mut random)))
        });
        let mut random = Random(sampling.seed ^ 0x5eed);
        let albedos: Vec<[f64; 3]> = surfaces.iter().map(|surface| surface.albedo).collect();
        let albedo = sampled(extent, sampling, &albedos, |_| [0; 3].map(|_| 0.05 * random.gaussian()));
        let depths: Vec<[f64; 1]> = surfaces.iter().map(|surface| [surface.depth]).collect();
        let depth = sampled(extent, sampling, &depths, |pixel| [0.01 * depths[pixel][0] * random.gaussian()]);
        Self {
            color,
            features: vec![("albedo".into(), albedo), ("depth".into(), depth)],
            samples: Samples::Uniform(sampling.samples as u32),
            truth: Some(image(extent, &truth)),
            unit: 1.0,
        }
    }

    /// Adds the normals of the surfaces, without noise.
    pub(super) fn with_normals(mut self, surface: impl Fn(usize, usize) -> Surface) -> Self {
        let normals: Vec<[f64; 3]> =
            (0..self.extent().pixels()).map(|pixel| surface(self.column(pixel), self.row(pixel)).normal).collect();
        self.features.push(("normal".into(), exact(image(self.extent(), &normals))));
        self
    }

    pub(super) fn without_features(mut self) -> Self {
        self.features.clear();
        self
    }

    pub(super) fn without_halves(mut self) -> Self {
        (self.color.half_a, self.color.half_b) = (None, None);
        self
    }

    pub(super) fn extent(&self) -> Extent {
        self.color.mean.extent
    }

    fn column(&self, pixel: usize) -> usize {
        pixel % self.extent().width as usize
    }

    fn row(&self, pixel: usize) -> usize {
        pixel / self.extent().width as usize
    }

    pub(super) fn pixel(&self, x: usize, y: usize) -> usize {
        y * self.extent().width as usize + x
    }

    pub(super) fn feature(&mut self, name: &str) -> &mut RawSignal {
        let Some((_, feature)) = self.features.iter_mut().find(|(other, _)| other == name) else {
            unreachable!("generated pictures have the feature {name}")
        };
        feature
    }

    pub(super) fn variance(&mut self) -> &mut Image {
        let extent = self.extent();
        self.color.variance_of_mean.get_or_insert_with(|| Image::filled(extent, 3, 0.0))
    }

    pub(super) fn half_a(&mut self) -> &mut Image {
        let mean = &self.color.mean;
        self.color.half_a.get_or_insert_with(|| mean.clone())
    }

    pub(super) fn half_b(&mut self) -> &mut Image {
        let mean = &self.color.mean;
        self.color.half_b.get_or_insert_with(|| mean.clone())
    }

    /// Adds a value that half A has seen and half B has not, to the mean and to half A.
    pub(super) fn add_to_half_a(&mut self, pixel: usize, value: [f32; 3]) {
        for (channel, value) in value.into_iter().enumerate() {
            self.color.mean.planes[channel][pixel] += value / 2.0;
            self.half_a().planes[channel][pixel] += value;
        }
    }

    /// Adds a value to the mean and to both halves alike, as if the sampler knew no better.
    pub(super) fn add_to_both(&mut self, pixel: usize, value: [f32; 3]) {
        for (channel, value) in value.into_iter().enumerate() {
            self.color.mean.planes[channel][pixel] += value;
            self.half_a().planes[channel][pixel] += value;
            self.half_b().planes[channel][pixel] += value;
        }
    }

    /// Scales all images of the colour, the truth and the unit.
    pub(super) fn scale_radiance(&mut self, factor: f32) {
        let RawSignal { mean, half_a, half_b, variance_of_mean } = &mut self.color;
        let images = [Some(mean), half_a.as_mut(), half_b.as_mut(), self.truth.as_mut()];
        images.into_iter().flatten().flat_map(|image| &mut image.planes).flatten().for_each(|value| *value *= factor);
        variance_of_mean
            .iter_mut()
            .flat_map(|image| &mut image.planes)
            .flatten()
            .for_each(|value| *value *= factor * factor);
        self.unit *= f64::from(factor);
    }

    /// Makes a frame by way of a file, so that any damage arrives in the way that a user's damage does.
    pub(super) fn frame(&self, folder: &Path) -> stein::Result<Frame> {
        let path = folder.join("picture.exr");
        let mut layers = Vec::new();
        push(&mut layers, &["R", "G", "B"], &self.color, ["", "halfA", "halfB", "variance"].map(str::to_owned));
        for (name, signal) in &self.features {
            let channels: &[&str] = if signal.mean.channels() == 1 { &["Z"] } else { &["X", "Y", "Z"] };
            push(
                &mut layers,
                channels,
                signal,
                ["", "_halfA", "_halfB", "_variance"].map(|part| format!("{name}{part}")),
            );
        }
        let mut attributes = Vec::new();
        match &self.samples {
            Samples::Unknown => {}
            Samples::Uniform(count) => attributes.push(("samples".to_owned(), count.to_string())),
            Samples::PerPixel(counts) => {
                let image = Image { extent: self.extent(), planes: vec![counts.clone()] };
                layers.push(NamedLayer { name: String::new(), channels: vec!["samples".into()], image });
            }
        }
        write_layers(&path, &layers, &attributes)?;
        read(&path).map(|(frame, _)| frame)
    }

    /// Reads a render from a file, with the truth in its layer `reference`.
    pub(super) fn rendered(file: &[u8], folder: &Path) -> stein::Result<Self> {
        let path = folder.join("render.exr");
        std::fs::write(&path, file).map_err(|error| stein::Error::File {
            path: path.clone(),
            cause: FileCause::Other {
                problem: format!("cannot be written: {error}"),
                remedy: "let TMPDIR name a folder that may be written to".into(),
            },
        })?;
        let (_, set) = read(&path)?;
        let features = set.features().map(|(name, signal)| (name.to_owned(), signal)).collect();
        let truth = Some(read_reference(&path, Some("reference"))?);
        Ok(Self { color: set.color(), features, samples: Samples::Unknown, truth, unit: 1.0 })
    }
}

fn read(path: &Path) -> stein::Result<(Frame, BufferSet)> {
    let set = BufferSet::read(&BufferSetRequest { input: path.to_owned(), ..BufferSetRequest::default() })?;
    let (frame, _) = set.to_frame()?;
    Ok((frame, set))
}

fn push(layers: &mut Vec<NamedLayer>, channels: &[&str], signal: &RawSignal, names: [String; 4]) {
    let RawSignal { mean, half_a, half_b, variance_of_mean } = signal;
    let images = [Some(mean), half_a.as_ref(), half_b.as_ref(), variance_of_mean.as_ref()];
    let layer = |(name, image): (String, &Image)| NamedLayer {
        name,
        channels: channels.iter().map(|&channel| channel.to_owned()).collect(),
        image: image.clone(),
    };
    layers.extend(names.into_iter().zip(images).filter_map(|(name, image)| Some((name, image?))).map(layer));
}

/// Returns a feature of which only the mean is known.
pub(super) fn exact(mean: Image) -> RawSignal {
    RawSignal { mean, half_a: None, half_b: None, variance_of_mean: None }
}

pub(super) fn image<const N: usize>(extent: Extent, pixels: &[[f64; N]]) -> Image {
    let plane = |channel: usize| pixels.iter().map(|pixel| pixel[channel] as f32).collect();
    Image { extent, planes: (0..N).map(plane).collect() }
}

/// Returns the means of all samples and of both halves, and s²/n, from deviations that are drawn one after another.
fn sampled<const N: usize>(
    extent: Extent,
    sampling: Sampling,
    truth: &[[f64; N]],
    mut draw: impl FnMut(usize) -> [f64; N],
) -> RawSignal {
    let (count, of_a) = (sampling.samples, sampling.samples.div_ceil(2));
    let mut sums = [vec![[0.0; N]; truth.len()], vec![[0.0; N]; truth.len()]];
    let mut squares = vec![[0.0; N]; truth.len()];
    for sample in 0..count {
        for (pixel, truth) in truth.iter().enumerate() {
            for (channel, deviation) in draw(pixel).into_iter().enumerate() {
                let deviation = sampling.noise * deviation;
                sums[usize::from(sample >= of_a)][pixel][channel] += truth[channel] + deviation;
                squares[pixel][channel] += deviation * deviation;
            }
        }
    }
    let per_pixel = |value: &dyn Fn(usize, usize) -> f64| -> Vec<[f64; N]> {
        (0..truth.len()).map(|pixel| std::array::from_fn(|channel| value(pixel, channel))).collect()
    };
    let mean = per_pixel(&|pixel, channel| (sums[0][pixel][channel] + sums[1][pixel][channel]) / count as f64);
    let half = |half: usize, count: usize| {
        image(extent, &per_pixel(&|pixel, channel| sums[half][pixel][channel] / count.max(1) as f64))
    };
    let variance = per_pixel(&|pixel, channel| {
        let of_mean = mean[pixel][channel] - truth[pixel][channel];
        let of_sample =
            (squares[pixel][channel] - count as f64 * of_mean * of_mean) / count.saturating_sub(1).max(1) as f64;
        of_sample.max(0.0) / count as f64
    });
    RawSignal {
        mean: image(extent, &mean),
        half_a: Some(half(0, of_a)),
        half_b: Some(half(1, count - of_a)),
        variance_of_mean: Some(image(extent, &variance)),
    }
}
