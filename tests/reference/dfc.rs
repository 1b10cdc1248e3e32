//! Algorithm 1, line by line.

use super::candidates::{Candidate, candidate};
use super::keep_clean::{CleanParams, Kept, keep_clean};
use super::nlm::{CentreWeight, Feature, FilterParams, Guide, nlm_filter};
use super::noise::{NoiseParams, completed};
use super::prefilter::{Prefiltered, prefilter};
use super::select::{Evidence, Guard, Significance, color_only_share, differences, select, share, smooth_maps};
use super::spike::{self, Lights, SpikeParams};
use super::sure::{self, ErrorParts, Part, error_blend, smooth_errors, sure};
use super::variance::{BoxWeight, Signal, buffer_var, floored, input_variance, of_color};
use super::{Grid, Planes};

/// Parameters of one candidate. An infinite k means that the colour, or the features, are not compared.
#[derive(Clone, Copy, Debug)]
pub struct CandidateParams {
    pub k_color: f64,
    pub k_feature: f64,
    pub patch_radius: usize,
    pub tau: f64,
    /// Index of the rival: this candidate wins a pixel only if it filters more than the rival.
    pub rival: Option<usize>,
}

/// The filter by the colour only.
#[derive(Clone, Copy, Debug)]
pub struct ColorOnlyParams {
    pub k_color: f64,
    pub patch_radius: usize,
    pub significance: Significance,
}

#[derive(Clone, Copy, Debug)]
pub struct SecondPassParams {
    /// Window of radius ⌈R/2⌉ in place of R.
    pub half_radius: bool,
    pub patch_radius: usize,
    pub k_color: f64,
    /// Whether the noise of each pixel is limited to that of its input.
    pub clamp_to_input: bool,
    /// Largest change of a pixel, in standard deviations of the pixel's noise.
    pub most_sigmas: Option<f64>,
}

#[derive(Clone, Debug)]
pub struct DfcParams {
    /// R.
    pub window_radius: usize,
    /// The candidates that take part; a later one is more robust: FIRST, SECOND, THIRD.
    pub candidates: Vec<CandidateParams>,
    /// Pairs of opposite neighbours and two-sided feature distances. THIRD has only the distances: it is the widest
    /// filter already, and without a colour term nothing would limit the blend of a pair.
    pub symmetric: bool,
    pub centre: CentreWeight,
    /// Weights of pixels when sample variances are scaled by the halves.
    pub box_weight: BoxWeight,
    /// Factor of the last term of SURE.
    pub covariance: f64,
    pub guard: Option<Guard>,
    /// None: spikes stay.
    pub spikes: Option<SpikeParams>,
    pub second_pass: SecondPassParams,
    /// None: the filter by the colour only never takes part.
    pub color_only: Option<ColorOnlyParams>,
    /// None: pixels without noise are filtered like all others.
    pub keep_clean: Option<CleanParams>,
    /// None: missing variances are smoothed squares of the half spread.
    pub noise: Option<NoiseParams>,
}

impl DfcParams {
    /// Algorithm 1 to the letter, its misprint in line 26 mended. It prints 10⁻² as 10E−3.
    pub fn thesis() -> DfcParams {
        let first = CandidateParams { k_color: 0.45, k_feature: 0.6, patch_radius: 1, tau: 1e-2, rival: Some(1) };
        let second = CandidateParams { patch_radius: 3, rival: None, ..first };
        DfcParams {
            window_radius: 10,
            candidates: vec![first, second, CandidateParams { k_color: f64::INFINITY, tau: 1e-3, ..second }],
            symmetric: false,
            centre: CentreWeight::One,
            box_weight: BoxWeight::Even,
            covariance: 1.0,
            guard: None,
            spikes: None,
            second_pass: SecondPassParams {
                half_radius: false,
                patch_radius: 1,
                k_color: 0.45,
                clamp_to_input: false,
                most_sigmas: None,
            },
            color_only: None,
            keep_clean: None,
            noise: None,
        }
    }

    /// The parameters that the filters share, for a window of this radius.
    fn filter(&self, window_radius: usize, candidate: &CandidateParams) -> FilterParams {
        FilterParams {
            window_radius,
            patch_radius: candidate.patch_radius,
            k_color: candidate.k_color,
            k_feature: candidate.k_feature,
            tau: candidate.tau,
            symmetric_features: self.symmetric,
            blend_pairs: self.symmetric && candidate.k_color.is_finite(),
            centre: self.centre,
        }
    }
}

/// The parameters that measured best on renders.
impl Default for DfcParams {
    fn default() -> DfcParams {
        let mut thesis = DfcParams::thesis();
        // Two-sided distances are scaled by both pixels: half of the printed value.
        thesis.candidates[2].tau = 5e-4;
        DfcParams {
            symmetric: true,
            centre: CentreWeight::LargestNeighbour,
            box_weight: BoxWeight::Deviation,
            covariance: 1.5,
            guard: Some(Guard { smoothed_error: 4.0, smoothed_noise: 0.3, own_sigmas: 8.0, own_noise: 4.0 }),
            spikes: Some(SpikeParams::default()),
            second_pass: SecondPassParams {
                half_radius: true,
                patch_radius: 3,
                k_color: 0.45,
                clamp_to_input: true,
                most_sigmas: Some(4.0),
            },
            color_only: Some(ColorOnlyParams { k_color: 0.45, patch_radius: 3, significance: Significance::default() }),
            keep_clean: Some(CleanParams::default()),
            noise: Some(NoiseParams::default()),
            ..thesis
        }
    }
}

pub struct Frame {
    pub color: Signal,
    /// In unit range.
    pub features: Vec<Signal>,
    /// The features that may explain the texture of an image without halves and variance: albedo and normal.
    pub explaining: Vec<usize>,
}

/// A filtered mean and, with halves, its spread.
#[derive(Clone)]
pub struct Pass {
    pub mean: Planes,
    pub spread: Option<Planes>,
}

/// SECOND without features.
pub struct ColorOnly {
    pub candidate: Candidate,
    /// Share in pass 1; the candidates' maps sum to the rest.
    pub share: Grid,
}

/// Every value that Algorithm 1 passes through.
pub struct Dfc {
    /// The input without spikes.
    pub color: Signal,
    /// The energy removed from spikes. None if spikes stay.
    pub spikes: Option<Planes>,
    /// The squares of the energy that pixels got from spikes.
    pub squares: Option<Grid>,
    /// Lights of few pixels, which the filters do not see. None if spikes stay.
    pub lights: Option<Lights>,
    pub color_variance: Planes,
    pub features: Vec<Prefiltered>,
    pub candidates: Vec<Candidate>,
    /// Eq. 8.5, one plane per candidate.
    pub sure: Planes,
    /// SURE, smoothed.
    pub errors: Planes,
    pub binary_maps: Planes,
    pub smoothed_maps: Planes,
    /// The maps of the blend: the smoothed ones, guarded if the parameters ask for it.
    pub maps: Planes,
    /// The pixels in which a feature has no noise.
    pub color_only: Option<ColorOnly>,
    /// The result of pass 2, or of pass 1 without a second pass.
    pub error: Grid,
    /// The passes' result with clean pixels and lights kept, and its error.
    pub result: Pass,
    pub result_error: Grid,
    pub pass1: Pass,
    /// None without halves, because the noise that is left is unknown.
    pub pass2: Option<Pass>,
}

pub fn dfc(frame: &Frame, params: &DfcParams) -> Dfc {
    // Missing variances. Not in Algorithm 1.
    let completed = params.noise.map(|noise| completed(&frame.color, &frame.features, &frame.explaining, &noise));
    let completed = completed.map(|(color, features)| Frame { color, features, explaining: Vec::new() });
    let frame = completed.as_ref().unwrap_or(frame);
    // Lines 2–5 and 6–10: features and variances. Spikes are not in Algorithm 1.
    let prefiltered: Vec<Prefiltered> = frame
        .features
        .iter()
        .map(|signal| prefilter(signal, params.symmetric, params.centre, params.box_weight))
        .collect();
    let features: Vec<Feature> = prefiltered.iter().map(|prefiltered| prefiltered.feature.clone()).collect();
    let repaired = params.spikes.map(|params| spike::repaired(&frame.color, &features, &params));
    let (color, spikes, squares, lights) = match repaired {
        Some(repaired) => (repaired.signal, Some(repaired.taken), Some(repaired.squares), Some(repaired.lights)),
        None => (frame.color.clone(), None, None, None),
    };
    let color_variance =
        floored(&color.mean, &input_variance(&color, params.box_weight), of_color(params.keep_clean.is_some()));

    // Lines 11–17: candidate filters.
    let filtered = |own: &CandidateParams, features: &[Feature]| {
        let filter = params.filter(params.window_radius, own);
        candidate(&color.mean, color.spread.as_deref(), &color_variance, features, &filter)
    };
    let candidates: Vec<Candidate> = params.candidates.iter().map(|own| filtered(own, &features)).collect();

    // Lines 18–22: errors.
    let guide = Guide { mean: &color.mean, variance: &color_variance };
    let aside = params.filter(0, &params.candidates[0]);
    let sure: Planes = candidates
        .iter()
        .map(|c| sure(&color.mean, &color_variance, &c.mean, &c.derivative, params.covariance))
        .collect();
    let errors = smooth_errors(&sure, guide, &aside);

    // Lines 23–31: selection maps.
    let derivatives: Vec<_> = candidates.iter().map(|c| c.derivative.as_slice()).collect();
    let rivals: Vec<_> = params.candidates.iter().map(|own| own.rival).collect();
    let binary_maps = select(&errors, &derivatives, &rivals);
    let smoothed_maps = smooth_maps(&binary_maps, guide, &aside);
    let means: Vec<_> = candidates.iter().map(|c| c.mean.as_slice()).collect();
    let evidence = Evidence {
        errors: &errors,
        binary_maps: &binary_maps,
        sure: &sure,
        candidates: &means,
        variance: &color_variance,
    };
    let maps = share(&smoothed_maps, evidence, params.guard.as_ref());

    // Lines 32 and 33: candidate averaging.
    let pass1 = Pass {
        mean: blend_channels(&maps, &means),
        spread: color.spread.as_ref().map(|_| {
            let spreads: Vec<_> = candidates.iter().map(|c| c.spread.as_deref().unwrap_or_default()).collect();
            blend_channels(&maps, &spreads)
        }),
    };

    // A filter by the colour only, where features may have edges that the colour lacks. Not in Algorithm 1.
    let several = candidates.len() > 1;
    let color_only = params.color_only.filter(|_| several && frame.features.iter().any(is_without_noise));
    let color_only = color_only.map(|ColorOnlyParams { k_color, patch_radius, significance }| {
        let own = CandidateParams { k_color, k_feature: f64::INFINITY, patch_radius, tau: 0.0, rival: None };
        let candidate = filtered(&own, &[]);
        let of_each = blend_channels(&maps, &derivatives);
        let of_blend = sure::sure(&color.mean, &color_variance, &pass1.mean, &of_each, params.covariance);
        let of_color_only =
            sure::sure(&color.mean, &color_variance, &candidate.mean, &candidate.derivative, params.covariance);
        let share = color_only_share(&differences(&of_color_only, &of_blend, &color_variance), significance);
        ColorOnly { candidate, share }
    });
    let (maps, pass1) = match &color_only {
        None => (maps, pass1),
        Some(color_only) => (rest_of(&maps, &color_only.share), with_color_only(&pass1, color_only)),
    };

    // Lines 34–37: second pass.
    let pass2 = second_pass(&pass1, &color_variance, params);

    // The error of the result. A single candidate is not a blend.
    let part = |k: usize| Part { share: &maps[k], mean: means[k], derivative: derivatives[k] };
    let of_color_only = color_only.iter().map(|ColorOnly { candidate, share }| Part {
        share,
        mean: &candidate.mean,
        derivative: &candidate.derivative,
    });
    let made_of: Vec<Part> = (0..candidates.len()).map(part).chain(of_color_only).collect();
    let result = pass2.as_ref().unwrap_or(&pass1);
    let parts = ErrorParts::measured(result.spread.is_some(), made_of.len() > 1);
    let error = error_blend(&result.mean, result.spread.as_deref(), &color_variance, &made_of, squares.as_ref(), parts);
    let kept = match params.keep_clean {
        Some(params) => keep_clean(&color, &result.mean, result.spread.as_deref(), &error, params),
        None => Kept { mean: result.mean.clone(), spread: result.spread.clone(), error: error.clone() },
    };
    let kept = match &lights {
        Some(lights) => lights.added_to(kept),
        None => kept,
    };
    let (result, result_error) = (Pass { mean: kept.mean, spread: kept.spread }, kept.error);

    Dfc {
        color,
        spikes,
        squares,
        lights,
        color_variance,
        features: prefiltered,
        candidates,
        sure,
        errors,
        binary_maps,
        smoothed_maps,
        maps,
        color_only,
        error,
        result,
        result_error,
        pass1,
        pass2,
    }
}

/// Whether nothing is known of a feature's noise.
fn is_without_noise(feature: &Signal) -> bool {
    [&feature.spread, &feature.sample_variance]
        .into_iter()
        .flatten()
        .flatten()
        .all(|plane| plane.values.iter().all(|value| *value == 0.0))
}

/// The candidates' maps, scaled to the share that the filter by the colour only leaves.
pub fn rest_of(maps: &[Grid], share: &Grid) -> Planes {
    maps.iter().map(|map| map.like(|p| (1.0 - share.at(p)) * map.at(p))).collect()
}

/// A blend of candidates in which the filter by the colour only takes part.
pub fn with_color_only(blend: &Pass, ColorOnly { candidate, share }: &ColorOnly) -> Pass {
    let mixed = |a: &[Grid], b: &[Grid]| -> Planes {
        a.iter().zip(b).map(|(a, b)| a.like(|p| (1.0 - share.at(p)) * a.at(p) + share.at(p) * b.at(p))).collect()
    };
    let spread = blend.spread.as_deref().zip(candidate.spread.as_deref()).map(|(a, b)| mixed(a, b));
    Pass { mean: mixed(&blend.mean, &candidate.mean), spread }
}

/// Filters the noise that pass 1 leaves, by means of its halves.
pub fn second_pass(pass1: &Pass, input_variance: &[Grid], params: &DfcParams) -> Option<Pass> {
    let spread = pass1.spread.as_ref()?;
    let own = params.second_pass;
    let mut variance = buffer_var(spread);
    if own.clamp_to_input {
        variance = variance
            .iter()
            .zip(input_variance)
            .map(|(residual, input)| residual.like(|p| residual.at(p).min(input.at(p))))
            .collect();
    }
    let variance = floored(&pass1.mean, &variance, of_color(params.keep_clean.is_some()));
    let full = params.window_radius;
    let filter = params.filter(
        if own.half_radius { full.div_ceil(2) } else { full },
        &CandidateParams {
            k_color: own.k_color,
            k_feature: f64::INFINITY,
            patch_radius: own.patch_radius,
            tau: 0.0,
            rival: None,
        },
    );
    let guide = Guide { mean: &pass1.mean, variance: &variance };
    let payload = [pass1.mean.as_slice(), spread].concat();
    let mut mean = nlm_filter(&payload, Some(guide), &[], &filter).planes;
    let spread = mean.split_off(pass1.mean.len());
    let pass2 = Pass { mean, spread: Some(spread) };
    Some(match own.most_sigmas {
        Some(sigmas) => limited(pass1, &pass2, input_variance, sigmas),
        None => pass2,
    })
}

/// Pass 2 where it changes pass 1 by no more than noise can explain.
pub fn limited(pass1: &Pass, pass2: &Pass, input_variance: &[Grid], sigmas: f64) -> Pass {
    let spread = |pass: &Pass| pass.spread.clone().unwrap_or_default();
    let (spread1, spread2) = (spread(pass1), spread(pass2));
    let plausible = |p| {
        let correction: f64 = pass1.mean.iter().zip(&pass2.mean).map(|(a, b)| (b.at(p) - a.at(p)).powi(2)).sum();
        let noise: f64 =
            input_variance.iter().zip(&spread1).map(|(variance, spread)| variance.at(p) + spread.at(p).powi(2)).sum();
        correction <= sigmas * sigmas * noise
    };
    let choose = |a: &[Grid], b: &[Grid]| {
        a.iter().zip(b).map(|(a, b)| a.like(|p| if plausible(p) { b.at(p) } else { a.at(p) })).collect()
    };
    Pass { mean: choose(&pass1.mean, &pass2.mean), spread: Some(choose(&spread1, &spread2)) }
}

/// Where the next samples pay most (section 8.6): the error of the blend relative to its square, times W(p) = Σ w/(1 +
/// n_p), smoothed.
pub fn sampling_density(result: &Dfc, params: &DfcParams, samples_per_pixel: f64) -> Grid {
    let weight_sums: Vec<_> = result.candidates.iter().map(|c| &c.weight_sum).collect();
    let weight_sum = blend(&result.maps, &weight_sums);
    let more = |p| {
        result
            .color_only
            .as_ref()
            .map_or(0.0, |ColorOnly { candidate, share }| share.at(p) * candidate.weight_sum.at(p))
    };
    let weight_sum = weight_sum.like(|p| weight_sum.at(p) + more(p));
    // With halves, the noise that they show (section 7.1.2); without halves, the error of the blend.
    let left = result
        .pass1
        .spread
        .as_ref()
        .map(|spread| spread[0].like(|p| spread.iter().map(|plane| plane.at(p) * plane.at(p)).sum()));
    let density = sure::sample_density(
        &result.pass1.mean,
        left.as_ref().unwrap_or(&result.error),
        &weight_sum,
        samples_per_pixel,
    );
    let own = CandidateParams { k_color: 1.0, k_feature: f64::INFINITY, patch_radius: 1, tau: 0.0, rival: None };
    let guide = Guide { mean: &result.color.mean, variance: &result.color_variance };
    nlm_filter(&[density], Some(guide), &[], &params.filter(10, &own)).planes.remove(0)
}

fn blend_channels(maps: &[Grid], candidates: &[&[Grid]]) -> Planes {
    let channel = |i: usize| blend(maps, &candidates.iter().map(|planes| &planes[i]).collect::<Vec<_>>());
    (0..candidates[0].len()).map(channel).collect()
}

/// Σ_k maps_k · planes_k, without planes of weight 0, which may not be finite.
fn blend(maps: &[Grid], planes: &[&Grid]) -> Grid {
    maps[0].like(|p| {
        maps.iter().zip(planes).filter(|(map, _)| map.at(p) > 0.0).map(|(map, plane)| map.at(p) * plane.at(p)).sum()
    })
}
