//! Algorithm 1 on the GPU, compared with float64 on parts of renders.
//!
//! The tests of the stages compare each stage with its twin; here errors pass through all of them. If two errors tie,
//! rounding can change a binary decision (which of them is least, whether the guard admits a candidate), and with it
//! the maps of all pixels within the smoothing's radius. So the decisions are compared separately: if one differs, the
//! errors must tie.

use stein::method::Intermediate;
use stein::method::dfc::CandidateSet;
use stein::stage::candidate_filter::{ByColor, ByFeatures, CandidateFilter};
use stein::{Denoiser, DfcParams, Estimate, Frame, Options};

use crate::bridge::{self, dfc_params, exposure, grids};
use crate::common::{assert_near, flat, gpu, own_size};
use crate::frames::{EVERYTHING, Keep, error_of, frame, noisy};
use crate::reference::dfc::{Dfc, DfcParams as TwinParams, dfc, sampling_density};
use crate::reference::{self, Grid, Planes};

/// Compares the parameters one by one: two tables, written independently from one text.
#[test]
fn the_presets_are_those_of_the_reference() {
    for (preset, twin) in [(DfcParams::default(), TwinParams::default()), (DfcParams::thesis(), TwinParams::thesis())] {
        let mut shown = dfc_params(&preset);
        // 0.45 as a float32 is not 0.45.
        let round = |value: &mut f64| *value = format!("{:.4e}", value).parse().unwrap_or(f64::NAN);
        for candidate in &mut shown.candidates {
            [&mut candidate.k_color, &mut candidate.k_feature, &mut candidate.tau]
                .into_iter()
                .filter(|v| v.is_finite())
                .for_each(round);
        }
        shown.guard.iter_mut().for_each(|guard| {
            [&mut guard.smoothed_error, &mut guard.smoothed_noise, &mut guard.own_sigmas, &mut guard.own_noise]
                .into_iter()
                .for_each(round);
        });
        round(&mut shown.second_pass.k_color);
        shown.color_only.iter_mut().for_each(|color_only| round(&mut color_only.k_color));
        assert_eq!(format!("{shown:?}"), format!("{twin:?}"));
    }
}

/// The kept layer with this name, in the units of the reference.
pub(crate) fn layer(estimate: &Estimate, name: &str, factor: f64) -> Planes {
    let layer = estimate.layers.iter().find(|layer| layer.name == name).unwrap_or_else(|| panic!("no layer {name}"));
    grids(&layer.image, factor)
}

struct Compared {
    what: &'static str,
    estimate: Estimate,
    twin: Dfc,
    exposure: f64,
    density: Grid,
    /// For the candidates that take part.
    names: Vec<&'static str>,
    rivals: Vec<Option<usize>>,
}

impl Compared {
    fn new(what: &'static str, frame: &Frame, params: DfcParams) -> Self {
        let denoiser = Denoiser::new(gpu(), params).unwrap_or_else(|error| panic!("{error}"));
        let options = Options { keep: &Intermediate::ALL, ..Options::default() };
        let estimate = denoiser.denoise_with(frame, options).unwrap_or_else(|error| panic!("{error}"));
        let exposure = exposure(frame);
        let filters = params.filters().into_iter();
        let names = filters.filter_map(|(filter, takes_part)| takes_part.then_some(filter.name)).collect();
        let (input, params) = (bridge::frame(frame, exposure), dfc_params(&params));
        let rivals = params.candidates.iter().map(|own| own.rival).collect();
        let twin = dfc(&input, &params);
        let density = sampling_density(&twin, &params, 0.0);
        Self { what, estimate, twin, exposure, density, names, rivals }
    }

    fn near(&self, part: &str, actual: &[Grid], expected: &[Grid], scale: &[Grid], relative: f64, allowed_share: f64) {
        assert_near(&format!("{}: {part}", self.what), actual, expected, scale, relative, allowed_share);
    }

    /// Scale of the error of a filtered pixel: its change, its noise, and a hundredth of its value.
    fn color_scale(&self, input: &[Grid], filtered: &[Grid]) -> Planes {
        let channel = |i: usize| {
            let (u, f, v) = (&input[i], &filtered[i], &self.twin.color_variance[i]);
            u.like(|p| (f.at(p) - u.at(p)).abs() + v.at(p).sqrt() + 0.01 * u.at(p).abs())
        };
        (0..3).map(channel).collect()
    }

    /// The share of pixels in which a decision may differ, or that the smoothing of such a decision reaches. With more
    /// candidates, more of them tie.
    fn flipped(&self) -> f64 {
        FLIPPED * (self.names.len() as f64 / 3.0).max(1.0)
    }

    fn check(&self, frame: &Frame) {
        let (twin, exposure) = (&self.twin, self.exposure);
        let layer = |name: &str, factor: f64| layer(&self.estimate, name, factor);
        // Four numbers to a layer.
        let numbers = |name: &str, factor: f64| -> Planes {
            let more = if self.names.len() > 4 { layer(&format!("{name}_2"), factor) } else { Planes::new() };
            layer(name, factor).into_iter().chain(more).collect()
        };
        let input = &twin.color.mean;

        self.near(
            "scaled variance",
            &layer("scaled_variance", exposure * exposure),
            &twin.color_variance,
            &own_size(&twin.color_variance, 0.0),
            1e-5,
            0.0,
        );

        for (feature, expected) in frame.features().iter().zip(&twin.features) {
            let (scale, offset) = (f64::from(feature.unit_scale), f64::from(feature.unit_offset));
            let name = format!("{}_prefiltered", feature.name);
            let actual: Planes =
                layer(&name, 1.0).iter().map(|grid| grid.like(|p| (grid.at(p) - offset) / scale)).collect();
            // In unit range; layers are in the file's range, whose offset costs digits.
            let size = 1.0 + (offset / scale).abs();
            self.near(&name, &actual, &expected.feature.mean, &flat(&actual, size), 1e-5, 0.0);
            let name = format!("{}_residual_variance", feature.name);
            let residual = &expected.feature.residual_variance;
            self.near(&name, &layer(&name, scale.powi(-2)), residual, &own_size(residual, 1e-7), 5e-4, 0.0);
        }

        for (candidate, name) in twin.candidates.iter().zip(self.names.iter().copied()) {
            self.near(
                name,
                &layer(name, exposure),
                &candidate.mean,
                &self.color_scale(input, &candidate.mean),
                FILTERED,
                OF_ONE_KIND,
            );
            let derivative = format!("{name}_derivative");
            self.near(
                &derivative,
                &layer(&derivative, 1.0),
                &candidate.derivative,
                &own_size(&candidate.derivative, 1.0),
                1e-3,
                OF_ONE_KIND,
            );
        }

        let terms = |k: usize| {
            let candidate = &twin.candidates[k];
            input[0].like(|p| {
                let term = |i: usize| {
                    let (residual, variance) = (candidate.mean[i].at(p) - input[i].at(p), twin.color_variance[i].at(p));
                    residual * residual + variance * (1.0 + 3.0 * candidate.derivative[i].at(p).abs())
                };
                (0..3).map(term).sum()
            })
        };
        let count = twin.candidates.len();
        let terms: Planes = (0..count).map(terms).collect();
        self.near("SURE", &numbers("sure", exposure * exposure), &twin.sure, &terms, 4e-4, OF_ONE_KIND);
        self.check_decisions(&numbers("selected", 1.0), &terms);

        self.near("maps", &numbers("selection", 1.0), &twin.maps, &flat(&twin.maps, 1.0), FILTERED, self.flipped());
        if frame.color().half_spread.is_some() {
            self.near(
                "pass 1",
                &layer("pass1", exposure),
                &twin.pass1.mean,
                &self.color_scale(input, &twin.pass1.mean),
                FILTERED,
                self.flipped(),
            );
        }
        let result = &twin.result;
        self.near(
            "result",
            &grids(&self.estimate.color, exposure),
            &result.mean,
            &self.color_scale(input, &result.mean),
            FILTERED,
            self.flipped(),
        );
        let spread = self.estimate.half_spread.as_ref().map(|image| grids(image, exposure));
        assert_eq!(spread.is_some(), result.spread.is_some(), "{}: half spread", self.what);
        if let (Some(spread), Some(expected)) = (&spread, &result.spread) {
            self.near(
                "half spread",
                spread,
                expected,
                &self.color_scale(input, &result.mean),
                FILTERED,
                self.flipped(),
            );
        }
        // If shares differ by rounding, another candidate's distance counts.
        let size: Planes = vec![terms[0].like(|p| twin.result_error.at(p) + terms[0].at(p))];
        self.near(
            "error",
            &grids(error_of(&self.estimate), exposure * exposure),
            std::slice::from_ref(&twin.result_error),
            &size,
            2e-3,
            self.flipped(),
        );
        // An average over a wide window, in which any decision may differ.
        let density = std::slice::from_ref(&self.density);
        let size = [self.density.like(|p| self.density.at(p) + self.density.mean())];
        self.near("density", &layer("density", 1.0), density, &size, 2e-3, self.flipped());
    }

    /// If the winner is not that of the reference, its error ties with the reference's winner, or the derivative of a
    /// candidate ties with that of its rival, such as FIRST with SECOND.
    fn check_decisions(&self, selected: &[Grid], terms: &[Grid]) {
        let twin = &self.twin;
        let mut flipped = 0usize;
        for y in 0..selected[0].height {
            for x in 0..selected[0].width {
                let p = reference::Point { x: x as isize, y: y as isize };
                let winner = |maps: &[Grid]| (0..maps.len()).find(|k| maps[*k].at(p) == 1.0);
                let (actual, expected) = (winner(selected), winner(&twin.binary_maps));
                if actual == expected {
                    continue;
                }
                flipped += 1;
                let Some((actual, expected)) = actual.zip(expected) else {
                    panic!("{}: no winner at {x}, {y}", self.what)
                };
                let difference = (twin.errors[actual].at(p) - twin.errors[expected].at(p)).abs();
                // Smoothed errors are averages of nine.
                let nearby = reference::square(1).map(|o| p + o).filter(|q| terms[0].contains(*q));
                let size = nearby.map(|q| terms[actual].at(q).max(terms[expected].at(q))).fold(0.0, f64::max);
                let derivative = |k: usize| reference::channel_mean(&twin.candidates[k].derivative, p);
                let tie = |(k, rival): (usize, &Option<usize>)| {
                    rival.is_some_and(|rival| (derivative(k) - derivative(rival)).abs() < 1e-3)
                };
                let derivatives_tie = self.rivals.iter().enumerate().any(tie);
                assert!(
                    difference < 4e-3 * size || derivatives_tie,
                    "{}: at {x}, {y} {actual} wins in place of {expected}",
                    self.what
                );
            }
        }
        assert!(
            flipped as f64 <= self.flipped() * selected[0].values.len() as f64,
            "{}: {flipped} decisions differ",
            self.what
        );
    }
}

/// Tolerance of filtered values, relative to their distance from the input. Features agree to about 10⁻⁶ with their
/// twins. Where a weight counts, their difference is below 0.1, so that its square over k_f²·2τ, at the least 4·10⁻⁴,
/// agrees to 10⁻⁴ or so; the errors of hundreds of weights average out.
const FILTERED: f64 = 2e-4;

/// The share of values in which the decision may differ whether a pixel is of a spike's kind and gets a part of it.
const OF_ONE_KIND: f64 = 0.001;

/// As [`Compared::flipped`], of three candidates.
const FLIPPED: f64 = 0.005;

fn check(what: &'static str, render: &str, rectangle: [usize; 4], keep: Keep, params: DfcParams) {
    let frame = frame(&noisy(render), rectangle, keep);
    let names: Vec<&str> = frame.features().iter().map(|feature| feature.name.as_str()).collect();
    assert_eq!(names, keep.features, "{what}");
    Compared::new(what, &frame, params).check(&frame);
}

fn small(params: DfcParams) -> DfcParams {
    DfcParams { window_radius: 4, ..params }
}

#[test]
fn everything_with_the_default_preset() {
    // The lamp and a ceiling with the same features. Everything is lit, so visibility is constant.
    let keep = Keep { features: &["albedo", "depth", "normal"], ..EVERYTHING };
    check("cornell, default", "cornell_32spp", [16, 20, 64, 64], keep, DfcParams::default());
}

#[test]
fn everything_with_the_thesis_preset() {
    check("depth of field, thesis", "dof_spheres_32spp", [40, 30, 32, 32], EVERYTHING, small(DfcParams::thesis()));
}

#[test]
fn halves_without_variance() {
    check(
        "halves only",
        "caustic_ring_32spp",
        [20, 30, 40, 33],
        Keep { variance: false, ..EVERYTHING },
        small(DfcParams::default()),
    );
}

#[test]
fn variance_without_halves() {
    check(
        "variance only",
        "dof_spheres_32spp",
        [30, 20, 40, 33],
        Keep { halves: false, ..EVERYTHING },
        small(DfcParams::default()),
    );
}

#[test]
fn no_features() {
    check(
        "no features",
        "cornell_8spp",
        [20, 0, 33, 40],
        Keep { features: &[], ..EVERYTHING },
        small(DfcParams::default()),
    );
}

#[test]
fn candidates_that_take_no_part() {
    let without_first = CandidateSet { first: false, ..CandidateSet::ALL };
    let without_second = CandidateSet { second: false, ..CandidateSet::ALL };
    for (what, candidates) in [("without FIRST", without_first), ("without SECOND", without_second)] {
        let keep = Keep { features: &["albedo", "normal"], ..EVERYTHING };
        check(what, "cornell_8spp", [20, 62, 32, 30], keep, DfcParams { candidates, ..small(DfcParams::default()) });
    }
}

/// Two more candidates, each an entry in the list: one with softer patches, and one that compares only the colour.
const FURTHER: &[CandidateFilter] = &[
    CandidateFilter {
        name: "soft",
        color: Some(ByColor { k: 0.8, patch_radius: 2 }),
        features: Some(ByFeatures { k: 0.6, tau: 1e-2 }),
        rival: None,
    },
    CandidateFilter { name: "plain", color: Some(ByColor { k: 1.2, patch_radius: 1 }), features: None, rival: None },
];

#[test]
fn candidates_beside_the_three_of_the_thesis() {
    for (what, further) in [("four candidates", &FURTHER[..1]), ("five candidates", FURTHER)] {
        let keep = Keep { features: &["albedo", "normal"], ..EVERYTHING };
        check(what, "cornell_8spp", [20, 62, 32, 30], keep, DfcParams { further, ..small(DfcParams::default()) });
    }
    let params = DfcParams {
        candidates: CandidateSet::of_names(&["second"]),
        further: &FURTHER[..1],
        ..small(DfcParams::thesis())
    };
    check("a further one beside SECOND alone", "dof_spheres_32spp", [40, 30, 32, 32], EVERYTHING, params);
}

/// A feature with neither halves nor variance is used unchanged; the colour keeps its halves and variance.
#[test]
fn one_feature_without_noise() {
    let set = noisy("cornell_32spp");
    let rectangle = [10, 5, 33, 30];
    let exact = frame(&set, rectangle, Keep { features: &["normal"], ..EVERYTHING });
    let feature = &exact.features()[0];
    let normal = stein::frame::Signal { mean: feature.signal.mean.clone(), half_spread: None, variance_of_mean: None };
    let exact = crate::frames::new_frame(exact.color().clone(), vec![("shape".into(), normal)]);
    Compared::new("a feature without noise", &exact, small(DfcParams::default())).check(&exact);
}
