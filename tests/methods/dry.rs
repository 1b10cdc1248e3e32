//! Dry runs: their peak memory equals that of a run, and their halo is how far results depend on a frame.

use stein::frame::Signal;
use stein::gpu::{GpuOptions, MemoryUse};
use stein::method::nlm::NlmVariance;
use stein::method::{Intermediate, Preset, Spikes};
use stein::{
    Denoiser, DfcParams, Estimate, Extent, Frame, GemParams, Gpu, Image, Method, NlmParams, Options, Requirements,
};

use crate::behaviour::{denoised, memory_for_strips, random_frame};
use crate::common::{gpu, open};
use crate::frames::new_frame;
use crate::reference::random::Random;

/// What is known of a frame's noise.
#[derive(Clone, Copy, Debug)]
struct Told {
    halves: bool,
    variance: bool,
    features: bool,
}

const KINDS: [Told; 6] = [
    Told { halves: true, variance: true, features: true },
    Told { halves: true, variance: false, features: true },
    Told { halves: false, variance: true, features: true },
    Told { halves: true, variance: true, features: false },
    Told { halves: true, variance: false, features: false },
    Told { halves: false, variance: true, features: false },
];

/// Nothing is known of the noise.
const IMAGE_ONLY: [Told; 2] =
    [Told { halves: false, variance: false, features: true }, Told { halves: false, variance: false, features: false }];

/// A frame with this knowledge of its noise and two features: one with halves only, and one with a single channel and
/// no noise.
fn frame(width: usize, height: usize, told: Told) -> Frame {
    let all = random_frame(width, height, 1.0);
    let color = all.color().clone();
    let color = Signal {
        half_spread: color.half_spread.filter(|_| told.halves),
        variance_of_mean: color.variance_of_mean.filter(|_| told.variance),
        mean: color.mean,
    };
    let depth = Image { planes: vec![color.mean.planes[0].iter().map(|v| v.clamp(0.0, 1.0)).collect()], ..color.mean };
    let features = all.features().iter().map(|feature| (feature.name.clone(), feature.signal.clone()));
    let features =
        features.chain([("depth".to_owned(), Signal { mean: depth, half_spread: None, variance_of_mean: None })]);
    new_frame(color, features.filter(|_| told.features).collect())
}

fn methods() -> Vec<Method> {
    let all = [DfcParams::default().into(), NlmParams::default().into(), Method::from(GemParams::default())];
    all.iter().flat_map(|method| Preset::ALL.iter().map(|preset| method.of_preset(*preset))).collect()
}

/// The method with a small window, so that it runs fast.
fn small(method: Method) -> Method {
    match method {
        Method::Dfc(params) => DfcParams { window_radius: 2, ..params }.into(),
        Method::Nlm(params) => NlmParams { window_radius: 2, ..params }.into(),
        Method::Gem(params) => params.into(),
    }
}

fn own_gpu() -> Gpu {
    open(GpuOptions::default())
}

fn denoiser(gpu: &Gpu, method: Method) -> Denoiser {
    Denoiser::new(gpu, method).unwrap_or_else(|error| panic!("{error}"))
}

/// Compares both peaks, and returns the requirements.
fn check_peak(what: &str, denoiser: &Denoiser, frames: &[&Frame], keep: &[Intermediate]) -> Requirements {
    let options = || Options { keep, ..Options::default() };
    let dry = denoiser.requirements(frames, 0, &options()).unwrap_or_else(|error| panic!("{what}: {error}"));
    let real = denoiser.denoise_window(frames, 0, options()).unwrap_or_else(|error| panic!("{what}: {error}"));
    assert_eq!((dry.peak_bytes, dry.strips), (real.peak_bytes, real.strips), "{what}");
    dry
}

#[test]
fn the_peak_of_a_dry_run_is_that_of_the_run() {
    let gpu = own_gpu();
    for method in methods().into_iter().map(small) {
        let denoiser = denoiser(&gpu, method);
        for told in KINDS.into_iter().chain(IMAGE_ONLY.into_iter().filter(|_| method.pools_variance())) {
            let frame = frame(33, 21, told);
            for keep in [&[], method.intermediates()] {
                check_peak(&format!("{method:?}, {told:?}"), &denoiser, &[&frame], keep);
            }
        }
    }
}

#[test]
fn the_peak_of_several_strips_is_that_of_the_run() {
    let gpu = own_gpu();
    for method in methods().into_iter().map(small) {
        let denoiser = denoiser(&gpu, method);
        let frame = frame(17, 461, KINDS[0]);
        for strips in [2, 5] {
            let limit = memory_for_strips(&denoiser, &frame, strips, &[]);
            let limited = denoiser.clone().with_max_memory(limit);
            let Requirements { peak_bytes, strips: found, .. } =
                check_peak(&format!("{method:?}, {strips} strips"), &limited, &[&frame], &[]);
            assert!(
                found >= strips && peak_bytes <= limit,
                "{method:?}: {found} strips, {peak_bytes} of {limit} bytes"
            );
        }
    }
}

#[test]
fn the_peak_of_a_window_in_time_is_that_of_the_run() {
    let gpu = own_gpu();
    for method in methods().into_iter().map(small).filter(Method::filters_in_time) {
        for told in [KINDS[0], KINDS[5]] {
            let frames = [frame(33, 21, told), frame(33, 21, told), frame(33, 21, told)];
            check_peak(&format!("{method:?}, {told:?}"), &denoiser(&gpu, method), &frames.each_ref(), &[]);
        }
    }
}

#[test]
fn a_dry_run_takes_no_memory_and_compiles_nothing() {
    let gpu = own_gpu();
    let frame = frame(33, 21, KINDS[0]);
    denoiser(&gpu, Method::default())
        .requirements(&[&frame], 0, &Options::default())
        .unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((gpu.memory(), gpu.kernel_count()), (MemoryUse::default(), 0));
}

/// Changes of some rows of a frame.
#[derive(Clone, Copy, Debug)]
struct Change {
    /// Factor of the colour's mean, and factor of its spread and deviation.
    mean: f32,
    noise: f32,
    /// Whether features are changed, and the factor of their spread.
    values: bool,
    feature_noise: f32,
}

const CHANGES: [Change; 6] = [
    Change { mean: 50.0, noise: 1.0, values: false, feature_noise: 1.0 },
    Change { mean: 1.0, noise: 1e4, values: false, feature_noise: 1.0 },
    Change { mean: 1e-3, noise: 1e-3, values: false, feature_noise: 1.0 },
    Change { mean: 1.0, noise: 1.0, values: true, feature_noise: 1.0 },
    Change { mean: 1.0, noise: 1.0, values: false, feature_noise: 1e3 },
    Change { mean: 50.0, noise: 1e4, values: true, feature_noise: 1e3 },
];

/// A frame of noise of one brightness with spikes. Some rows are changed; values that are fixed for the whole frame
/// (exposure, ranges) stay.
fn noise(width: usize, height: usize, told: Told, spikes: f64, rows: std::ops::Range<usize>, change: Change) -> Frame {
    let mut random = Random(7);
    let extent = Extent { width: width as u32, height: height as u32 };
    let is_changed = |pixel: usize| rows.contains(&(pixel / width));
    let mut image = |channels: usize, value: &mut dyn FnMut(usize, f64) -> f32| Image {
        extent,
        planes: (0..channels)
            .map(|_| {
                let grid = random.uniform_grid(width, height, 0.0, 1.0);
                grid.values.iter().enumerate().map(|(pixel, random)| value(pixel, *random)).collect()
            })
            .collect(),
    };
    let is_spike = image(1, &mut |_, random| if random < spikes { 1.0 } else { 0.0 });
    let spike = |pixel: usize, factor: f32| if is_spike.planes[0][pixel] > 0.0 { factor } else { 1.0 };
    let factor = |pixel: usize, factor: f32| if is_changed(pixel) { factor } else { 1.0 };
    let color = Signal {
        mean: image(3, &mut |pixel, random| {
            (1.05 + 0.9 * random as f32) * spike(pixel, 40.0) * factor(pixel, change.mean)
        }),
        half_spread: Some(image(3, &mut |pixel, random| {
            (0.6 * random as f32 - 0.3) * spike(pixel, 200.0) * factor(pixel, change.noise)
        }))
        .filter(|_| told.halves),
        variance_of_mean: Some(image(3, &mut |pixel, random| {
            (0.05 + 0.05 * random as f32) * spike(pixel, 20_000.0) * factor(pixel, change.noise * change.noise)
        }))
        .filter(|_| told.variance),
    };
    let mut values = |channels: usize| {
        image(channels, &mut |pixel, random| match pixel {
            // The unit range.
            0 | 1 => pixel as f32,
            _ if change.values && is_changed(pixel) => random.round() as f32,
            _ => 0.4 + 0.2 * random as f32,
        })
    };
    let (albedo, depth) = (values(3), values(1));
    let spread = image(3, &mut |pixel, random| (0.1 * random as f32 - 0.05) * factor(pixel, change.feature_noise));
    let noisy = Signal { mean: albedo, half_spread: Some(spread), variance_of_mean: None };
    let exact = Signal { mean: depth, half_spread: None, variance_of_mean: None };
    let features = [("albedo".to_owned(), noisy), ("depth".to_owned(), exact)];
    new_frame(color, features.into_iter().filter(|_| told.features).collect())
}

/// The bits of all results in a row.
fn row(estimate: &Estimate, row: usize) -> Vec<u32> {
    let images = [
        Some(&estimate.color),
        estimate.half_spread.as_ref(),
        estimate.error.as_ref(),
        Some(&estimate.weight_sum),
        estimate.selection.as_ref(),
    ];
    let layers = estimate.layers.iter().map(|layer| &layer.image);
    let planes = images.into_iter().flatten().chain(layers).flat_map(|image| &image.planes);
    let width = estimate.color.extent.width as usize;
    planes.flat_map(|plane| &plane[row * width..][..width]).map(|value| value.to_bits()).collect()
}

/// The row whose results are compared: an odd one, and not the first.
const ROW: usize = 11;
const WIDTH: usize = 37;

/// A method on frames of noise, and its halo.
struct Case {
    denoiser: Denoiser,
    told: Told,
    spikes: f64,
    halo: usize,
    what: String,
}

impl Case {
    fn new(gpu: &Gpu, method: Method, told: Told) -> Self {
        let denoiser = denoiser(gpu, method);
        let spikes = if method.spikes() == Spikes::Keep { 0.0 } else { 0.02 };
        let frame = noise(WIDTH, 40, told, spikes, 0..0, CHANGES[0]);
        let requirements = denoiser.requirements(&[&frame], 0, &Options::default());
        let halo = requirements.unwrap_or_else(|error| panic!("{method:?}: {error}")).halo as usize;
        Self { denoiser, told, spikes, halo, what: format!("{} of {told:?}, halo {halo}", method.name()) }
    }

    /// Returns the results of the row if this many rows from a distance on are changed.
    fn row(&self, from: usize, rows: usize, change: Change) -> Vec<u32> {
        let first = ROW + from;
        let frame = noise(WIDTH, ROW + self.halo + 7, self.told, self.spikes, first..first + rows, change);
        row(&denoised(&self.denoiser, &frame), ROW)
    }

    fn check_beyond(&self) {
        let expected = self.row(0, 0, CHANGES[0]);
        for change in [CHANGES[2], CHANGES[5]] {
            let actual = self.row(self.halo + 1, 6, change);
            assert!(actual == expected, "{}: {change:?} beyond the halo matters", self.what);
        }
    }

    fn check_within(&self) {
        let expected = self.row(0, 0, CHANGES[0]);
        let matters = |change: &Change| (0..3).any(|slack| self.row(self.halo - slack, 1, *change) != expected);
        assert!(CHANGES.iter().rev().any(matters), "{}: the halo is more than 2 rows too large", self.what);
    }
}

#[test]
fn nothing_beyond_the_halo_matters() {
    for method in methods().into_iter().map(small) {
        for told in KINDS.into_iter().chain(IMAGE_ONLY.into_iter().filter(|_| method.pools_variance())) {
            if method.uses_features() || !told.features {
                Case::new(gpu(), method, told).check_beyond();
            }
        }
    }
}

/// For NLM the farthest pixels change bits. The chains of the other methods are so long, or end in so many decisions,
/// that the farthest pixels change no bit. `tests/stages/reach.rs` tests the reach of each of their stages, which a dry
/// run adds up.
#[test]
fn the_halo_is_no_larger_than_what_matters() {
    for params in [NlmParams::default(), NlmParams::thesis()] {
        // Weights between 0 and 1, also of patches with other variances.
        let method = small(NlmParams { k: 1.0, cut: 0.0, variance: NlmVariance::Scaled, ..params }.into());
        for told in KINDS.into_iter().filter(|told| !told.features) {
            Case::new(gpu(), method.with_spikes(Spikes::Keep), told).check_within();
        }
    }
}
