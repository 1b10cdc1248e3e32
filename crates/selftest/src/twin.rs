//! Compares a result with the float64 reference, which gets the same frame.
//!
//! The comparison goes step by step. After a decision of the method (which candidate, which scale), the reference goes
//! on with the device's decision. So a decision that falls the other way in a tie does not hide the steps after it, and
//! every step has its own tolerance. Tolerances are relative to the terms that a value is made of. The decisions
//! themselves may differ in a few pixels.

use stein::frame::NoiseKnowledge;
use stein::{DfcParams, Estimate, Frame, GemParams, Image, Method, NlmParams};
use stein_reference::candidates::{Candidate, finite_difference_step};
use stein_reference::compare::{self, Tolerance, flat, own_size};
use stein_reference::dfc::{ColorOnly, Pass, dfc, rest_of, sampling_density, second_pass};
use stein_reference::gaussian::gaussian_neighbours;
use stein_reference::gem::{self, choose, decided};
use stein_reference::keep_clean::{CleanParams, Kept, allowed, keep_clean, kept_error};
use stein_reference::nlm::{FilterParams, Guide};
use stein_reference::select::{self, Evidence};
use stein_reference::sure::{self, smooth_errors};
use stein_reference::variance::brightness_around;
use stein_reference::{Grid, Planes, Point, channel_mean, nlm_method, square};
use stein_twin as bridge;

/// One compared quantity.
pub(super) struct Part {
    pub(super) name: String,
    /// Distance of the worst value, in tolerances, without the share of values that decisions may change.
    pub(super) off: f64,
    /// Location of the worst value, with the found and the expected value.
    pub(super) detail: String,
}

/// Tolerance of filtered values, relative to their distance from the input. Features agree with their twins to some
/// 10⁻⁶. Where a weight matters, their difference is below 0.1, so that its square over k_f²·2τ (4·10⁻⁴ at least)
/// agrees to 10⁻⁴ or so.
const FILTERED: f64 = 2e-4;
/// Tolerance of derivatives, which are finite differences.
const DERIVED: f64 = 1e-3;
/// Tolerance of sums of squares of filtered values, and of similar terms.
const SQUARED: f64 = 4e-4;
/// Tolerance of averages over few values without weights of their own.
const AVERAGED: f64 = 1e-5;
/// Share of values that a decision may change: by a guard, by a limit, by a cut.
const TURNED: f64 = 0.01;
/// Share of values for which device and reference may disagree whether a pixel is of a spike's kind and gets its part
/// of the spike.
const OF_ONE_KIND: f64 = 0.001;
/// A few units of the last digit of float32.
const ROUNDED: f64 = 2.5e-7;
/// Value that vanishes in products of float32, in the units that the methods work in.
const VANISHING: f64 = 1e-30;

/// Compares everything that an estimate with all its intermediates holds.
pub(super) fn compare(frame: &Frame, method: &Method, estimate: &Estimate) -> Vec<Part> {
    let exposure = bridge::exposure(frame);
    let mut comparison = TwinComparison { estimate, exposure, parts: Vec::new() };
    match method {
        Method::Dfc(params) => comparison.dfc(frame, params),
        Method::Nlm(params) => comparison.nlm(frame, params),
        Method::Gem(params) => comparison.gem(frame, params),
    }
    comparison.parts
}

/// Adds a hundredth of the half spread to the size: a half spread may be far larger than its colour.
fn with_own(spread: &[Grid], size: &[Grid]) -> Planes {
    spread.iter().zip(size).map(|(spread, size)| size.like(|p| size.at(p) + 0.01 * spread.at(p).abs())).collect()
}

struct TwinComparison<'a> {
    estimate: &'a Estimate,
    exposure: f64,
    parts: Vec<Part>,
}

impl TwinComparison<'_> {
    fn dfc(&mut self, frame: &Frame, params: &DfcParams) {
        let (input, params) = (bridge::frame(frame, self.exposure), bridge::dfc_params(params));
        let twin = dfc(&input, &params);
        // The colour without its spikes.
        let (u, variance) = (&twin.color.mean.clone(), &twin.color_variance.clone());
        self.own_size("scaled variance", &self.squared("scaled_variance"), variance, variance_tolerance(frame));

        for (feature, expected) in frame.features().iter().zip(&twin.features) {
            let (scale, offset) = (f64::from(feature.unit_scale), f64::from(feature.unit_offset));
            let name = format!("{}_prefiltered", feature.name);
            let actual: Planes =
                self.layer(&name, 1.0).iter().map(|grid| grid.like(|p| (grid.at(p) - offset) / scale)).collect();
            // Values are compared in unit range. Layers are in the file's range, whose offset costs digits.
            let size = flat(&actual, 1.0 + (offset / scale).abs());
            self.add(&name, &actual, &expected.feature.mean, &size, AVERAGED, 0.0);
            let residual = &expected.feature.residual_variance;
            let name = format!("{}_residual_variance", feature.name);
            self.add(&name, &self.layer(&name, scale.powi(-2)), residual, &own_size(residual, 1e-7), 5e-4, 0.0);
        }

        // A pixel's share of spikes is a sum, so its last digits differ from the twin's. They show in a pixel with
        // almost no noise, whose weights are steep. If spikes stay, as with the preset of the thesis, every value
        // counts.
        let steep = if params.spikes.is_some() { TURNED } else { 0.0 };
        if let Some(taken) = &twin.spikes {
            let size: Planes = taken
                .iter()
                .zip(&input.color.mean)
                .map(|(taken, mean)| taken.like(|p| taken.at(p).abs() + mean.at(p).abs() + VANISHING))
                .collect();
            // In a frame without noise the method does not look for spikes.
            let found =
                Some(self.color("spikes")).filter(|found| !found.is_empty()).unwrap_or_else(|| flat(taken, 0.0));
            self.add("spikes", &found, taken, &size, AVERAGED, OF_ONE_KIND);
        }

        // Size of a pixel of a filtered colour: its distance from the input, its noise, and a hundredth of its value.
        let color_size = |filtered: &[Grid]| -> Planes {
            let channel = |i: usize| {
                u[i].like(|p| {
                    (filtered[i].at(p) - u[i].at(p)).abs()
                        + variance[i].at(p).sqrt()
                        + 0.01 * u[i].at(p).abs()
                        + VANISHING
                })
            };
            (0..3).map(channel).collect()
        };
        const NAMES: [&str; 3] = ["first", "second", "third"];
        let around = brightness_around(u);
        for (name, candidate) in NAMES.into_iter().zip(&twin.candidates) {
            self.add(name, &self.color(name), &candidate.mean, &color_size(&candidate.mean), FILTERED, steep);
            let derivative = format!("{name}_derivative");
            // Rounding error of the finite differences: the values are rounded, and so are the exponents of the
            // weights.
            let rounded = |i: usize, p: Point| {
                40.0 * ROUNDED * (candidate.mean[i].at(p) - u[i].at(p)).abs()
                    / finite_difference_step(u[i].at(p), variance[i].at(p), around.at(p)).abs()
            };
            let size: Planes = (0..3)
                .map(|i| u[i].like(|p| 1.0 + candidate.derivative[i].at(p).abs() + rounded(i, p) / DERIVED))
                .collect();
            self.add(&derivative, &self.layer(&derivative, 1.0), &candidate.derivative, &size, DERIVED, steep);
        }
        let terms = |candidate: &Candidate, i: usize, p: Point| {
            let (residual, variance, rounded) =
                (candidate.mean[i].at(p) - u[i].at(p), variance[i].at(p), ROUNDED * u[i].at(p).abs());
            residual * residual
                + variance * (1.0 + 2.0 * params.covariance * candidate.derivative[i].at(p).abs())
                + (2.0 * residual.abs() + rounded) * rounded / SQUARED
        };
        let terms =
            |candidate: &Candidate| u[0].like(|p| (0..3).map(|i| terms(candidate, i, p)).sum::<f64>() + VANISHING);
        let terms: Planes = twin.candidates.iter().map(terms).collect();
        let sure = self.squared("sure");
        self.add("SURE", &sure, &twin.sure, &terms, SQUARED, steep);

        // From here on, the reference follows the decisions of the device.
        let aside =
            FilterParams { symmetric_features: params.symmetric, blend_pairs: params.symmetric, ..aside(&params) };
        let guide = Guide { mean: u, variance };
        let errors = self.squared("sure_smoothed");
        // The largest of nine values, for an average of them.
        let around = |grids: &[Grid]| -> Planes {
            grids
                .iter()
                .map(|grid| {
                    grid.like(|p| {
                        square(1)
                            .map(|o| p + o)
                            .filter(|q| grid.contains(*q))
                            .map(|q| grid.at(q).abs())
                            .fold(VANISHING, f64::max)
                    })
                })
                .collect()
        };
        self.add("SURE smoothed", &errors, &smooth_errors(&sure, guide, &aside), &around(&sure), FILTERED, 0.0);
        let derivatives = NAMES.map(|name| self.layer(&format!("{name}_derivative"), 1.0));
        let selected = self.layer("selected", 1.0);
        // The last digit of a derivative can decide whether FIRST may win.
        let mean_derivative = |k: usize, p: Point| channel_mean(&derivatives[k], p);
        let ties =
            |p: Point| (mean_derivative(0, p) - mean_derivative(1, p)).abs() <= 1e-6 * mean_derivative(1, p).abs();
        let rivals: Vec<_> = params.candidates.iter().map(|own| own.rival).collect();
        let expected = select::select(&errors, &derivatives.each_ref().map(Vec::as_slice), &rivals);
        let expected: Planes = expected
            .iter()
            .zip(&selected)
            .map(|(expected, selected)| expected.like(|p| if ties(p) { selected.at(p) } else { expected.at(p) }))
            .collect();
        self.add("selected", &selected, &expected, &flat(&selected, 1.0), AVERAGED, 0.0);
        let candidates = NAMES.map(|name| self.color(name));
        let means = candidates.each_ref().map(Vec::as_slice);
        let evidence = Evidence { errors: &errors, binary_maps: &selected, sure: &sure, candidates: &means, variance };
        let maps = self.layer("selection", 1.0);
        let expected = select::share(&select::smooth_maps(&selected, guide, &aside), evidence, params.guard.as_ref());
        // The candidates share what the filter by the colour only leaves, if that filter takes part.
        let of_color_only = self.layer("color_only_share", 1.0);
        let expected = of_color_only.first().map_or_else(|| expected.clone(), |share| rest_of(&expected, share));
        let color_only = twin.color_only.as_ref().zip(of_color_only.first());
        let color_only =
            color_only.map(|(own, share)| ColorOnly { candidate: own.candidate.clone(), share: share.clone() });
        assert_eq!(
            color_only.is_some(),
            twin.color_only.is_some(),
            "the filter by the colour only takes part where it does in the reference"
        );
        if let (Some(own), Some(twin)) = (&color_only, &twin.color_only) {
            self.add(
                "color_only",
                &self.color("color_only"),
                &twin.candidate.mean,
                &color_size(&twin.candidate.mean),
                FILTERED,
                steep,
            );
            self.add(
                "color_only_share",
                std::slice::from_ref(&own.share),
                std::slice::from_ref(&twin.share),
                &flat(std::slice::from_ref(&twin.share), 1.0),
                0.1,
                TURNED,
            );
        }
        // Compares the selections by the blends that they make: where the candidates are equal, the choice does not
        // matter.
        let apart = |i: usize, p: Point| {
            (0..3)
                .flat_map(|j| (0..j).map(move |k| (j, k)))
                .map(|(j, k)| (means[j][i].at(p) - means[k][i].at(p)).abs())
                .fold(0.0, f64::max)
        };
        let by = |maps: &[Grid]| -> Planes { (0..3).map(|i| blend(maps, means.map(|mean| &mean[i]))).collect() };
        let size: Planes = (0..3)
            .map(|i| u[0].like(|p| apart(i, p) + ROUNDED * means[0][i].at(p).abs() / FILTERED + VANISHING))
            .collect();
        self.add("selection", &by(&maps), &by(&expected), &size, FILTERED, TURNED);

        let blended = |planes: [&[Grid]; 3]| -> Planes {
            (0..planes[0].len()).map(|i| blend(&maps, planes.map(|planes| &planes[i]))).collect()
        };
        let largest = |planes: [&[Grid]; 3]| -> Planes {
            (0..planes[0].len())
                .map(|i| u[0].like(|p| planes.iter().map(|planes| planes[i].at(p).abs()).fold(VANISHING, f64::max)))
                .collect()
        };
        let spreads: Vec<_> = twin.candidates.iter().filter_map(|candidate| candidate.spread.as_deref()).collect();
        let spread = <[_; 3]>::try_from(spreads).ok().map(blended);
        let pass1 = Pass { mean: blended(means), spread };
        let more = |of: &dyn Fn(&Candidate) -> Planes, planes: Planes| -> Planes {
            let Some(own) = &color_only else { return planes };
            planes
                .iter()
                .zip(of(&own.candidate))
                .map(|(plane, more)| plane.like(|p| plane.at(p) + own.share.at(p) * more.at(p)))
                .collect()
        };
        let pass1 = Pass {
            mean: more(&|own| own.mean.clone(), pass1.mean),
            spread: pass1.spread.map(|spread| more(&|own| own.spread.clone().unwrap_or_default(), spread)),
        };
        // Lights of few pixels hide the filtered values below them.
        let shown = |planes: Planes, instead: &[Grid]| -> Planes {
            let Some(lights) = &twin.lights else { return planes };
            planes
                .iter()
                .zip(instead)
                .map(|(plane, instead)| plane.like(|p| if lights.is_light(p) { instead.at(p) } else { plane.at(p) }))
                .collect()
        };
        let actual = if pass1.spread.is_some() {
            self.color("pass1")
        } else {
            shown(bridge::grids(&self.estimate.color, self.exposure), &pass1.mean)
        };
        // The reference uses its own result of the filter by the colour only.
        let (relative, size) =
            if color_only.is_some() { (FILTERED, color_size(&pass1.mean)) } else { (AVERAGED, largest(means)) };
        self.add("pass 1", &actual, &pass1.mean, &size, relative, if color_only.is_some() { steep } else { 0.0 });
        let weight_sums = [0, 1, 2].map(|k| std::slice::from_ref(&twin.candidates[k].weight_sum));
        let with_more = |sums: Planes| more(&|own| vec![own.weight_sum.clone()], sums);
        let (expected, size) = (with_more(blended(weight_sums)), with_more(largest(weight_sums)));
        self.add("Σ w", &bridge::grids(&self.estimate.weight_sum, 1.0), &expected, &size, 1e-3, steep);

        // The error belongs to the device's result.
        let part = |k: usize| sure::Part { share: &maps[k], mean: means[k], derivative: &derivatives[k] };
        let (mean, spread) = (
            bridge::grids(&self.estimate.color, self.exposure),
            self.grids(self.estimate.half_spread.as_ref(), self.exposure),
        );
        let before = second_pass(&pass1, variance, &params).unwrap_or_else(|| pass1.clone());
        let (mean, spread) = (shown(mean, &before.mean), shown(spread, before.spread.as_deref().unwrap_or_default()));
        let spread = pass1.spread.is_some().then_some(spread.as_slice());
        let parts = sure::ErrorParts::measured(spread.is_some(), true);
        let of_color_only = color_only.iter().map(|own| sure::Part {
            share: &own.share,
            mean: &own.candidate.mean,
            derivative: &own.candidate.derivative,
        });
        let made_of: Vec<_> = [0, 1, 2].map(part).into_iter().chain(of_color_only).collect();
        let error = sure::error_blend(&mean, spread, variance, &made_of, twin.squares.as_ref(), parts);
        // If a pixel is moved back to the input, its value before is not known: its error is only compared with the
        // largest error that such a pixel may have.
        let unlimited = before;
        let clean = params.keep_clean.unwrap_or(CleanParams { noise: 0.0, ..CleanParams::default() });
        let limit = allowed(&twin.color, clean);
        let actual = self.grids(self.estimate.error.as_ref(), self.exposure.powi(2));
        let most = kept_error(&error.like(|_| f64::INFINITY), &twin.color, clean);
        // The density is made from the error as it was before.
        let of_passes = error.clone();
        let error = match actual.first() {
            Some(actual) if params.keep_clean.is_some() => error.like(|p| {
                if limit.at(p).is_infinite() { error.at(p) } else { actual.at(p).min(most.at(p) * (1.0 + 1e-5)) }
            }),
            _ => error,
        };
        let error = match &twin.lights {
            Some(lights) => error.like(|p| if lights.is_light(p) { lights.variance.at(p) } else { error.at(p) }),
            None => error,
        };
        let rounded =
            |p: Point| (0..3).map(|i| (ROUNDED * (mean[i].at(p).abs() + apart(i, p))).powi(2) / AVERAGED).sum::<f64>();
        let size =
            [error.like(|p| error.at(p) + rounded(p) + 2.0 * (error.at(p) * rounded(p) / AVERAGED).sqrt() + VANISHING)];
        // The reference uses its own result of the filter by the colour only, with its own rounding.
        let relative = if color_only.is_some() { SQUARED } else { AVERAGED };
        self.add("error", &actual, std::slice::from_ref(&error), &size, relative, 0.0);

        let twin = stein_reference::dfc::Dfc {
            maps: maps.clone(),
            color_only,
            error: of_passes,
            pass1: pass1.clone(),
            ..twin
        };
        let density = [sampling_density(&twin, &params, bridge::samples(frame, 0.0).mean())];
        if !matches!(frame.samples_per_pixel(), stein::frame::SamplesPerPixel::PerPixel(_)) {
            let size = [density[0].like(|p| density[0].at(p) + density[0].mean() + VANISHING)];
            self.add("density", &self.layer("density", 1.0), &density, &size, 2e-3, 0.0);
        }

        let size = color_size(&unlimited.mean);
        let kept = match params.keep_clean {
            Some(clean) => keep_clean(&twin.color, &unlimited.mean, unlimited.spread.as_deref(), &error, clean),
            None => Kept { mean: unlimited.mean, spread: unlimited.spread, error },
        };
        let result = match &twin.lights {
            Some(lights) => lights.added_to(kept),
            None => kept,
        };
        self.result(&result.mean, result.spread.as_deref(), &size);
    }

    fn nlm(&mut self, frame: &Frame, params: &NlmParams) {
        let color = bridge::signal(frame.color(), self.exposure);
        let twin = nlm_method::nlm(&color, &bridge::nlm_params(params), &bridge::samples(frame, 1.0));
        let (u, variance) = (&color.mean, &twin.variance);
        self.own_size("variance", &self.squared("variance_of_mean"), variance, variance_tolerance(frame));
        let channel = |i: usize| {
            u[i].like(|p| {
                (twin.mean[i].at(p) - u[i].at(p)).abs() + variance[i].at(p).sqrt() + 0.01 * u[i].at(p).abs() + VANISHING
            })
        };
        let size: Planes = (0..3).map(channel).collect();
        self.result(&twin.mean, twin.spread.as_deref(), &size);
        let one = |grid: &Grid| [grid.like(|p| grid.at(p).abs() + 0.01 * grid.mean() + VANISHING)];
        let of = std::slice::from_ref;
        self.add(
            "Σ w",
            &bridge::grids(&self.estimate.weight_sum, 1.0),
            of(&twin.weight_sum),
            &one(&twin.weight_sum),
            2e-3,
            TURNED,
        );
        self.add(
            "error",
            &self.grids(self.estimate.error.as_ref(), self.exposure.powi(2)),
            of(&twin.error),
            &one(&twin.error),
            2e-3,
            TURNED,
        );
        self.add("density", &self.layer("density", 1.0), of(&twin.density), &one(&twin.density), 2e-3, TURNED);
    }

    fn gem(&mut self, frame: &Frame, params: &GemParams) {
        let params = bridge::gem_params(params);
        let twin = gem::gem(&bridge::signal(frame.color(), self.exposure), &bridge::samples(frame, 0.0), &params);
        self.own_size("scaled variance", &self.squared("scaled_variance"), &twin.variance, variance_tolerance(frame));
        // Bias term that rounding alone may cause: the square of float32's last digits of the largest value that a
        // scale averages.
        let rounding = (4e-6 * twin.scales[0].mean.iter().map(largest).fold(0.0, f64::max)).powi(2);
        let mut maps = Vec::new();
        for (index, (step, sigma)) in twin.steps.iter().zip(&params.sigmas).enumerate() {
            let name = format!("stopping_{}", index + 1);
            let (stops, smoothed) = (self.layer(&name, 1.0), self.layer(&format!("{name}_smoothed"), 1.0));
            // If the selector is within rounding of 0, both decisions are right.
            let ties = |p: Point| {
                step.selector(p).abs() <= 1e-4 * (step.bias_term.at(p) + step.variance_term.at(p).abs()) + rounding
            };
            let expected = step.stops();
            let expected = [expected.like(|p| if ties(p) { stops[0].at(p) } else { expected.at(p) })];
            self.add(&name, &stops, &expected, &flat(&expected, 1.0), AVERAGED, 0.0);
            let size = params.outlier_size * sigma;
            let again = [gaussian_neighbours(&stops[0], size, (3.0 * size).ceil() as usize)];
            self.add(&format!("{name} smoothed"), &smoothed, &again, &flat(&again, 1.0), AVERAGED, 0.0);
            maps.push(decided(&stops[0], &smoothed[0], params.coarser_only));
        }
        let chosen = choose(&twin.scales, &twin.steps, &maps);
        let sigma = std::slice::from_ref(&chosen.sigma);
        self.add("scale", &self.layer("scale", 1.0), sigma, &flat(sigma, 1.0), AVERAGED, 0.0);
        let size: Planes =
            twin.scales[0].mean.iter().map(|plane| Grid::filled(plane.width, plane.height, largest(plane))).collect();
        let result = gem::result(&twin, &chosen, &params);
        self.add("result", &bridge::grids(&self.estimate.color, self.exposure), &result.mean, &size, AVERAGED, 0.0);
        if self.estimate.half_spread.is_some() {
            let size: Planes = twin.scales[0]
                .spread
                .iter()
                .map(|plane| Grid::filled(plane.width, plane.height, largest(plane)))
                .collect();
            self.add(
                "half spread",
                &self.grids(self.estimate.half_spread.as_ref(), self.exposure),
                &result.spread.unwrap_or_default(),
                &size,
                AVERAGED,
                0.0,
            );
        }
        let pixels = std::slice::from_ref(&chosen.pixels);
        self.add(
            "pixels",
            &bridge::grids(&self.estimate.weight_sum, 1.0),
            pixels,
            &own_size(pixels, VANISHING),
            AVERAGED,
            0.0,
        );
        let terms = |p: Point| {
            let steps: f64 = twin.steps.iter().map(|step| step.bias_term.at(p) + step.variance_term.at(p).abs()).sum();
            steps + twin.scales[0].variance.iter().map(|plane| plane.at(p)).sum::<f64>() + rounding
        };
        let (error, size) = ([result.error.like(|p| result.error.at(p).max(0.0))], [result.error.like(terms)]);
        self.add("error", &self.grids(self.estimate.error.as_ref(), self.exposure.powi(2)), &error, &size, 1e-4, 0.0);
    }

    fn color(&self, layer: &str) -> Planes {
        self.layer(layer, self.exposure)
    }

    fn squared(&self, layer: &str) -> Planes {
        self.layer(layer, self.exposure * self.exposure)
    }

    /// Returns a kept layer in the units of the reference; empty if there is none.
    fn layer(&self, name: &str, factor: f64) -> Planes {
        let layer = self.estimate.layers.iter().find(|layer| layer.name == name);
        self.grids(layer.map(|layer| &layer.image), factor)
    }

    fn grids(&self, image: Option<&Image>, factor: f64) -> Planes {
        image.map_or_else(Planes::new, |image| bridge::grids(image, factor))
    }

    fn own_size(&mut self, name: &str, actual: &[Grid], expected: &[Grid], relative: f64) {
        self.add(name, actual, expected, &own_size(expected, VANISHING), relative, 0.0);
    }

    /// Compares the denoised colour, and its half spread if there is one. `size` is a scale of the colour.
    fn result(&mut self, mean: &[Grid], spread: Option<&[Grid]>, size: &[Grid]) {
        self.add("result", &bridge::grids(&self.estimate.color, self.exposure), mean, size, FILTERED, TURNED);
        if let Some(spread) = spread {
            let actual = self.grids(self.estimate.half_spread.as_ref(), self.exposure);
            self.add("half spread", &actual, spread, &with_own(spread, size), FILTERED, TURNED);
        }
    }

    /// Compares a quantity. `scale` holds, for each value, the size of a relative error of 1.
    fn add(&mut self, name: &str, actual: &[Grid], expected: &[Grid], scale: &[Grid], relative: f64, share: f64) {
        if actual.len() < expected.len() {
            self.parts.push(Part { name: name.to_owned(), off: f64::INFINITY, detail: "it is missing".into() });
            return;
        }
        // The smallest number of float32 in the file's units, which layers are in.
        let least = f64::from(f32::from_bits(1)) * self.exposure.max(1.0).powi(2);
        let worst = compare::worst(actual, expected, scale, Tolerance { relative, least, share });
        let part = worst.map(|worst| Part { name: name.to_owned(), off: worst.off, detail: worst.to_string() });
        self.parts.extend(part);
    }
}

/// Returns the parameters that the smoothing of errors and maps shares with the candidates.
fn aside(params: &stein_reference::dfc::DfcParams) -> FilterParams {
    FilterParams {
        window_radius: 0,
        patch_radius: 0,
        k_color: f64::INFINITY,
        k_feature: f64::INFINITY,
        tau: 0.0,
        symmetric_features: params.symmetric,
        blend_pairs: params.symmetric,
        centre: params.centre,
    }
}

/// Returns Σ_k maps_k · planes_k, without values of weight 0, which may not be finite.
fn blend(maps: &[Grid], planes: [&Grid; 3]) -> Grid {
    maps[0].like(|p| {
        maps.iter().zip(planes).filter(|(map, _)| map.at(p) > 0.0).map(|(map, plane)| map.at(p) * plane.at(p)).sum()
    })
}

fn largest(plane: &Grid) -> f64 {
    plane.values.iter().fold(VANISHING, |most, value| value.abs().max(most))
}

/// Returns the tolerance of the variance. If only the image tells of the noise, a fit of features is solved for it.
fn variance_tolerance(frame: &Frame) -> f64 {
    if frame.noise_knowledge() == NoiseKnowledge::ImageOnly { 1e-3 } else { AVERAGED }
}
