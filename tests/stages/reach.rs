//! The declared reach of each stage: pixels beyond it change nothing, the farthest pixels within it do. If this holds
//! for every stage, it holds for the halo of a method, which a dry run adds up from them.

use glam::IVec2;
use stein::error::Result;
use stein::gpu::{Buffer, Recorder, Run};
use stein::stage::candidate::{CandidateFrame, CandidateWindow, Candidates, Needed, candidates};
use stein::stage::candidate_filter::{ByColor, ByFeatures, CandidateFilter};
use stein::stage::feature::{Features, feature_pack};
use stein::stage::frames::Frames;
use stein::stage::gaussian::{Averaging, Gaussian, gaussian};
use stein::stage::keep_clean::{CleanRule, Input, keep_clean};
use stein::stage::nlm::{CentreWeight, Guide, Payload, Schedule, Symmetry, Weighting, nlm_filter};
use stein::stage::noise::{ImageRule, NoiseRule, NoisyFeatures, Pooled, noise_feature, noise_of_image, noise_pool};
use stein::stage::spike::{Repaired, SpikeRule, spike_find, spike_spread};
use stein::stage::variance::{
    BoxWeight, Floor, INPUT_SMOOTHING, variance_floor, variance_pair, variance_scale, variance_smooth,
};

use crate::common::{bits, gpu};
use crate::reference::random::Random;

const WIDTH: i32 = 97;
/// The row whose results are compared.
const ROW: i32 = 2;

/// Random planes of a signal, a variance and a feature.
struct Inputs {
    /// Mean and half spread.
    signal: Buffer,
    variance: Buffer,
    /// A signal, too.
    feature: Buffer,
}

/// Functions that make the mean, the half spread and the variance of a pixel from a random number.
type Levels = fn(IVec2, f64) -> [f64; 3];

impl Inputs {
    /// `changed`: a factor for the values of each row.
    fn new(rec: &mut Recorder, extent: IVec2, levels: Levels, changed: impl Fn(i32) -> f64) -> Result<Self> {
        let mut random = Random(3);
        let mut planes = |of: &[usize]| -> Vec<f32> {
            let pixels = extent.x * extent.y;
            let values = of.iter().flat_map(|level| (0..pixels).map(move |pixel| (*level, pixel)));
            values
                .flat_map(|(level, pixel)| {
                    let factor = changed(pixel / extent.x);
                    // Values of 0 change as well.
                    let shift = (factor - 1.0).clamp(0.0, 1.0);
                    let mut channel = || {
                        let random = random.uniform_grid(1, 1, 0.0, 1.0).values[0];
                        (levels(IVec2::new(pixel % extent.x, pixel / extent.x), random)[level] * factor + shift) as f32
                    };
                    [channel(), channel(), channel(), 0.0]
                })
                .collect()
        };
        Ok(Self {
            signal: rec.upload("signal", &planes(&[0, 1]))?,
            variance: rec.upload("variance", &planes(&[2]))?,
            feature: rec.upload("feature", &planes(&[0, 1]))?,
        })
    }
}

fn even(_: IVec2, random: f64) -> [f64; 3] {
    [0.5 + random, 0.2 * random - 0.1, 0.01 + 0.02 * random]
}

/// Compares the measured reach of a stage with the reach of a dry run.
fn check(what: &str, levels: Levels, work: impl Fn(&mut Recorder, IVec2, &Inputs) -> Result<Buffer>) {
    check_within(0, what, levels, work);
}

/// Like [`check`], for a chain of stages in which the effect of the farthest pixels may be rounded away: the measured
/// reach may be `slack` rows less.
fn check_within(
    slack: i32,
    what: &str,
    levels: Levels,
    work: impl Fn(&mut Recorder, IVec2, &Inputs) -> Result<Buffer>,
) {
    let dry = &mut gpu().record_in(&Run::dry(None));
    let least = IVec2::new(WIDTH, 1);
    let inputs = Inputs::new(dry, least, levels, |_| 1.0).unwrap_or_else(|error| panic!("{what}: {error}"));
    let reach = work(dry, least, &inputs).unwrap_or_else(|error| panic!("{what}: {error}")).reach().y as i32;
    let extent = IVec2::new(WIDTH, ROW + reach + 4);
    let row = |changed: &dyn Fn(i32) -> f64| -> Vec<u32> {
        let mut rec = gpu().record();
        let inputs = Inputs::new(&mut rec, extent, levels, changed).unwrap_or_else(|error| panic!("{what}: {error}"));
        let output = work(&mut rec, extent, &inputs).unwrap_or_else(|error| panic!("{what}: {error}"));
        rec.submit().unwrap_or_else(|error| panic!("{what}: {error}"));
        let bits = bits(gpu(), &output);
        let [row, plane] = [4 * WIDTH, 4 * WIDTH * extent.y].map(|values| values as usize);
        bits.chunks_exact(plane).flat_map(|plane| plane[ROW as usize * row..][..row].to_vec()).collect()
    };
    let expected = row(&|_| 1.0);
    let changes = |first: i32, last: i32| {
        [1e3, 1e-3]
            .into_iter()
            .any(|factor| row(&|y| if (first..=last).contains(&y) { factor } else { 1.0 }) != expected)
    };
    assert!(!changes(ROW + reach + 1, extent.y), "{what} depends on more than {reach} rows");
    let matters = (0..=slack).any(|slack| changes(ROW + reach - slack, ROW + reach - slack));
    assert!(matters, "{what} depends on less than {reach} rows");
}

#[test]
fn variances_look_as_far_as_they_say() {
    for weight in [BoxWeight::Even, BoxWeight::Deviation] {
        check("variance_scale", even, |rec, extent, Inputs { signal, variance, .. }| {
            variance_scale(rec, extent, signal, variance, 4, weight)
        });
    }
    check("variance_smooth", even, |rec, extent, inputs| {
        variance_smooth(rec, extent, &inputs.signal, INPUT_SMOOTHING, None)
    });
    check("variance_floor", even, |rec, extent, Inputs { signal, variance, .. }| {
        variance_floor(rec, extent, signal, variance, Floor::Relative)
    });
    check("variance_pair", even, |rec, extent, Inputs { signal, variance, .. }| {
        Ok(variance_pair(rec, extent, signal, variance)?.uncertainty)
    });
}

#[test]
fn gaussians_and_features_look_as_far_as_they_say() {
    for averaging in [Averaging::Mean, Averaging::Variance, Averaging::Neighbours] {
        check("gaussian", even, |rec, extent, inputs| {
            gaussian(rec, extent, &inputs.signal, 2, Gaussian::new(1.5), averaging)
        });
    }
    check("feature_pack", even, |rec, extent, Inputs { signal, variance, .. }| {
        let features = Features::take(rec, extent, &[3])?;
        feature_pack(rec, extent, &features, features.packing.slots[0], signal, Some(variance))?;
        Ok(features.buffer)
    });
}

fn noisy_features(rec: &mut Recorder, extent: IVec2, feature: &Buffer) -> Result<NoisyFeatures> {
    let mut features = NoisyFeatures::take(rec, extent, &[3])?;
    noise_feature(rec, extent, &features, features.packing.slots[0], feature, None, &NoiseRule::HALVES)?;
    features.are_pooled = true;
    Ok(features)
}

#[test]
fn estimates_of_noise_look_as_far_as_they_say() {
    check("noise_feature", even, |rec, extent, inputs| Ok(noisy_features(rec, extent, &inputs.feature)?.buffer));
    check("noise_pool", even, |rec, extent, Inputs { signal, feature, .. }| {
        let features = noisy_features(rec, extent, feature)?;
        let Pooled { buffer } = noise_pool(rec, extent, signal, None, Some(&features), &NoiseRule::HALVES)?;
        Ok(buffer)
    });
    check("noise_pool of a variance", even, |rec, extent, Inputs { signal, variance, .. }| {
        Ok(noise_pool(rec, extent, signal, Some(variance), None, &NoiseRule::VARIANCE)?.buffer)
    });
    // With edges at which the variance is limited by that of the pixels around.
    let edges: Levels = |p, random| {
        let [mean, spread, variance] = even(p, random);
        [if p.x / 12 % 2 == 0 { mean } else { 1e3 * mean }, spread, variance]
    };
    check_within(2, "noise_of_image", edges, |rec, extent, inputs| {
        noise_of_image(rec, extent, &inputs.signal, None, &[], &ImageRule::DEFAULT)
    });
    check_within(2, "noise_of_image by features", edges, |rec, extent, Inputs { signal, feature, .. }| {
        let features = noisy_features(rec, extent, feature)?;
        noise_of_image(rec, extent, signal, Some(&features), &[0], &ImageRule::DEFAULT)
    });
}

#[test]
fn repairs_of_spikes_look_as_far_as_they_say() {
    let spikes: Levels = |p, random| {
        if (37 * p.x + 101 * p.y + 3 * p.x * p.y) % 41 == 0 { [60.0, 50.0, 2500.0] } else { even(p, random) }
    };
    let find = |rec: &mut Recorder, extent: IVec2, Inputs { signal, variance, .. }: &Inputs| {
        spike_find(rec, extent, signal, Some(variance), None, &SpikeRule::DEFAULT)
    };
    check("spike_find", spikes, |rec, extent, inputs| Ok(find(rec, extent, inputs)?.signal));
    check_within(2, "spike_spread", spikes, |rec, extent, inputs| {
        let mut repaired = find(rec, extent, inputs)?;
        spike_spread(rec, extent, None, &SpikeRule::DEFAULT, &mut repaired)?;
        let Repaired { signal, .. } = repaired;
        Ok(signal)
    });
}

#[test]
fn clean_pixels_look_as_far_as_they_say() {
    let black: Levels = |_, random| [0.0, 0.0, random];
    check("keep_clean", black, |rec, extent, Inputs { signal, .. }| {
        let ones = vec![1.0; 8 * (extent.x * extent.y) as usize];
        let filtered = rec.upload("filtered", &ones)?;
        keep_clean(rec, extent, Input { signal, sample_variance: None }, &filtered, None, CleanRule::DEFAULT)
    });
}

const WEIGHTINGS: [Weighting; 2] = [
    Weighting { symmetric: Symmetry::Off, centre: CentreWeight::One },
    Weighting { symmetric: Symmetry::Blended, centre: CentreWeight::LargestNeighbour },
];

#[test]
fn filters_look_as_far_as_they_say() {
    for weighting in WEIGHTINGS {
        for patchwise in [false, true] {
            check("nlm_filter", even, |rec, extent, Inputs { signal, variance, feature }| {
                let guide = Guide { patchwise, ..Guide::new(signal, variance, 3, 2.0, 1) };
                let payload = Payload::new(feature, 2);
                Ok(nlm_filter(rec, extent, &guide, &payload, 3, weighting, false, Schedule::SOFTWARE)?.planes)
            });
        }
        let features = Some(ByFeatures { k: 1.0, tau: 0.1 });
        let by_color = |name, patch_radius| {
            let color = Some(ByColor { k: 2.0, patch_radius });
            CandidateFilter { name, color, features, rival: None }
        };
        let filters = [by_color("small", 1), by_color("large", 2)];
        let window = CandidateWindow { radius: 3, weighting };
        for part in ["means", "half spreads", "derivatives"] {
            check(part, even, |rec, extent, Inputs { signal, variance, feature }| {
                let features = &Features::take(rec, extent, &[3])?;
                feature_pack(rec, extent, features, features.packing.slots[0], feature, None)?;
                let (payload, variance_of_mean) = (signal, variance);
                let frame =
                    CandidateFrame { payload, guide: None, variance_of_mean, features: Some(features), layers: &[] };
                let (frames, needed, schedule) = (Frames::one(frame), Needed::EVERYTHING, Schedule::SOFTWARE);
                let made = candidates(rec, extent, &frames, &filters, window, needed, schedule, |_, _| Ok(()))?;
                let Candidates { means, spreads, derivatives, .. } = made.together;
                let output = match part {
                    "means" => Some(means),
                    "half spreads" => Some(spreads),
                    _ => derivatives,
                };
                let output = output.and_then(std::sync::Arc::into_inner);
                Ok(output.unwrap_or_else(|| panic!("nobody else holds it")))
            });
        }
    }
}
