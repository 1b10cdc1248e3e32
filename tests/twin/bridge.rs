//! Converts the library's types to those of the float64 reference: frames, in the units of a method, and parameters.

use stein::frame::{Feature, SamplesPerPixel, Signal};
use stein::image::Image;
use stein::method::Spikes;
use stein::method::gem::Phase;
use stein::method::nlm::NlmVariance;
use stein::stage::candidate_filter::CandidateFilter;
use stein::stage::nlm::{CentreWeight, Symmetry};
use stein::stage::spike::SpikeRule;
use stein::stage::variance::BoxWeight;
use stein::{DfcParams, Frame, GemParams, NlmParams};
use stein_reference::dfc::{self, CandidateParams, ColorOnlyParams, SecondPassParams};
use stein_reference::keep_clean::CleanParams;
use stein_reference::noise::NoiseParams;
use stein_reference::{Grid, Planes, exposure, gem, nlm, nlm_method, select, spike, variance};

/// The planes of an image, times a factor.
pub fn grids(image: &Image, factor: f64) -> Planes {
    let (width, height) = (image.extent.width as usize, image.extent.height as usize);
    image
        .planes
        .iter()
        .map(|plane| Grid { width, height, values: plane.iter().map(|value| f64::from(*value) * factor).collect() })
        .collect()
}

/// Factor of the colour on the device.
pub fn exposure(frame: &Frame) -> f64 {
    let planes = |image: &Option<Image>| image.as_ref().map_or_else(Planes::new, |image| grids(image, 1.0));
    let color = frame.color();
    exposure::exposure(&grids(&color.mean, 1.0), &planes(&color.half_spread), &planes(&color.variance_of_mean))
}

/// A signal in other units.
pub fn signal(signal: &Signal, factor: f64) -> variance::Signal {
    variance::Signal {
        mean: grids(&signal.mean, factor),
        spread: signal.half_spread.as_ref().map(|image| grids(image, factor)),
        sample_variance: signal.variance_of_mean.as_ref().map(|image| grids(image, factor * factor)),
    }
}

/// The input of DFC.
pub fn frame(frame: &Frame, exposure: f64) -> dfc::Frame {
    let may_explain = |feature: &Feature| {
        feature.signal.mean.channels() == 3 && ["albedo", "normal"].iter().any(|name| feature.name.contains(name))
    };
    let features = frame.features();
    dfc::Frame {
        color: signal(frame.color(), exposure),
        features: features.iter().map(|feature| signal(&feature.signal, 1.0)).collect(),
        explaining: (0..features.len()).filter(|&index| may_explain(&features[index])).take(2).collect(),
    }
}

/// Samples of each pixel; `unknown` if the frame does not tell.
pub fn samples(frame: &Frame, unknown: f64) -> Grid {
    let uniform = |count: f64| Grid::filled(frame.extent().width as usize, frame.extent().height as usize, count);
    match frame.samples_per_pixel() {
        SamplesPerPixel::PerPixel(counts) => grids(counts, 1.0).remove(0),
        SamplesPerPixel::Uniform(count) => uniform(f64::from(*count)),
        SamplesPerPixel::Unknown => uniform(unknown),
    }
}

fn centre(centre: CentreWeight) -> nlm::CentreWeight {
    match centre {
        CentreWeight::One => nlm::CentreWeight::One,
        CentreWeight::LargestNeighbour => nlm::CentreWeight::LargestNeighbour,
    }
}

/// Parameters with a second pass, as both presets have.
pub fn dfc_params(params: &DfcParams) -> dfc::DfcParams {
    let filters: Vec<_> =
        params.filters().into_iter().filter_map(|(filter, takes_part)| takes_part.then_some(filter)).collect();
    let candidate = |filter: &CandidateFilter| CandidateParams {
        k_color: filter.color.map_or(f64::INFINITY, |color| color.k.into()),
        k_feature: filter.features.map_or(f64::INFINITY, |features| features.k.into()),
        // A filter without a colour term has no patches, so any size is right.
        patch_radius: filter.color.map_or(params.second_patch_radius, |color| color.patch_radius) as usize,
        tau: filter.features.map_or(1.0, |features| features.tau.into()),
        rival: filter.rival.and_then(|rival| filters.iter().position(|other| other.name == rival)),
    };
    let Some(pass) = params.second_pass else { unreachable!("the presets have a second pass") };
    dfc::DfcParams {
        window_radius: params.window_radius as usize,
        candidates: filters.iter().map(candidate).collect(),
        symmetric: params.weighting.symmetric != Symmetry::Off,
        centre: centre(params.weighting.centre),
        box_weight: match params.box_weight {
            BoxWeight::Even => variance::BoxWeight::Even,
            BoxWeight::Deviation => variance::BoxWeight::Deviation,
        },
        covariance: params.covariance.into(),
        guard: params.guard.map(|guard| select::Guard {
            smoothed_error: guard.smoothed_error.into(),
            smoothed_noise: guard.smoothed_noise.into(),
            own_sigmas: guard.own_sigmas.into(),
            own_noise: guard.own_noise.into(),
        }),
        spikes: spikes(params.spikes),
        second_pass: SecondPassParams {
            half_radius: pass.half_window,
            patch_radius: pass.patch_radius as usize,
            k_color: pass.color_k.into(),
            clamp_to_input: pass.clamp_to_input,
            most_sigmas: pass.most_sigmas.map(f64::from),
        },
        color_only: params.color_only.then(|| ColorOnlyParams {
            k_color: params.color_k.into(),
            patch_radius: params.second_patch_radius as usize,
            significance: select::Significance::default(),
        }),
        keep_clean: params.keep_clean.then(CleanParams::default),
        noise: params.pooled_variance.then(NoiseParams::default),
    }
}

/// Treatment of spikes of a method.
fn spikes(spikes: Spikes) -> Option<spike::SpikeParams> {
    let SpikeRule {
        window_radius,
        spread_radius,
        least_neighbours,
        prominence,
        most_samples,
        light_samples,
        share_limit,
        feature_k,
        feature_tau,
    } = SpikeRule::DEFAULT;
    // 0.1 as a float32 is not 0.1.
    let [prominence, most_samples, light_samples, share_limit, k_feature, tau] =
        [prominence, most_samples, light_samples, share_limit, feature_k, feature_tau]
            .map(|value| format!("{value:.4e}").parse().unwrap_or(f64::NAN));
    let params = spike::SpikeParams {
        window_radius: window_radius as usize,
        spread_radius: spread_radius as usize,
        least_neighbours: least_neighbours as usize,
        prominence,
        most_samples,
        light_samples,
        share_limit: (spikes == Spikes::Spread).then_some(share_limit),
        k_feature,
        tau,
    };
    (spikes != Spikes::Keep).then_some(params)
}

/// Parameters of NLM.
pub fn nlm_params(params: &NlmParams) -> nlm_method::NlmParams {
    nlm_method::NlmParams {
        filter: nlm_method::Filter {
            window_radius: params.window_radius as usize,
            patch_radius: params.patch_radius as usize,
            k: params.k.into(),
            alpha: params.alpha.into(),
            symmetric: match params.weighting.symmetric {
                Symmetry::Off => nlm_method::Symmetry::Off,
                Symmetry::Blended => nlm_method::Symmetry::Blended,
                Symmetry::Hard => nlm_method::Symmetry::Hard,
            },
            patchwise: params.patchwise,
            cut: params.cut.into(),
            centre: centre(params.weighting.centre),
        },
        dual_buffer: params.dual_buffer,
        spikes: spikes(params.spikes),
        keep_clean: params.keep_clean.then(CleanParams::default),
        noise: params.pooled_variance.then(NoiseParams::where_lacking),
        variance: match params.variance {
            NlmVariance::Scaled => nlm_method::Variance::Scaled,
            NlmVariance::CrossFiltered => nlm_method::Variance::CrossFiltered,
            NlmVariance::Uniform => nlm_method::Variance::Uniform,
        },
    }
}

/// Parameters of GEM.
pub fn gem_params(params: &GemParams) -> gem::GemParams {
    // 0.15 as a float32 is not 0.15.
    let gamma = format!("{}", params.gamma).parse().unwrap_or(f64::NAN);
    let of_phase = match params.phase {
        Phase::Sampling => gem::GemParams::while_sampling(gamma),
        Phase::Final => gem::GemParams::for_the_final_image(gamma, params.final_outlier_size.into()),
    };
    gem::GemParams {
        spikes: spikes(params.spikes),
        keep_clean: params.keep_clean.then(CleanParams::default),
        noise: params.pooled_variance.then(NoiseParams::where_lacking),
        ..of_phase
    }
}
