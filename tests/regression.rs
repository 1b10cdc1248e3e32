//! The error of the results on the test renders. Bounds are just above the measured values, so that every increase is
//! noticed.
//!
//! Bounds hold for any adapter: results differ between adapters by a few units of their last digits, and in a few
//! pixels by a tied decision.

#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "common/frames.rs"]
mod frames;

use stein::gpu::{DeviceChoice, Gpu};
use stein::{Denoiser, DfcParams, Estimate, Image};
use stein_metric::relative_mse;

/// Means over squares of 16×16 pixels.
fn blocks(image: &Image, value: impl Fn(usize) -> f64) -> Vec<f64> {
    let (width, height) = (image.extent.width as usize, image.extent.height as usize);
    let block = |left: usize, top: usize| {
        (0..16 * 16).map(|i| value((top + i / 16) * width + left + i % 16)).sum::<f64>() / (16.0 * 16.0)
    };
    (0..height / 16)
        .flat_map(|y| (0..width / 16).map(move |x| (16 * x, 16 * y)))
        .map(|(left, top)| block(left, top))
        .collect()
}

/// The share of blocks whose estimated error is between a quarter and four times the true one.
fn share_within_four(estimate: &Estimate, reference: &Image) -> f64 {
    let squared = |pixel: usize| -> f64 {
        let channels = estimate.color.planes.iter().zip(&reference.planes);
        channels.map(|(plane, reference)| (f64::from(plane[pixel]) - f64::from(reference[pixel])).powi(2)).sum()
    };
    let estimated = |pixel: usize| f64::from(frames::error_of(estimate).planes[0][pixel]);
    let ratios: Vec<f64> = blocks(reference, estimated)
        .iter()
        .zip(blocks(reference, squared))
        .map(|(estimated, known)| estimated / known.max(1e-12))
        .collect();
    ratios.iter().filter(|ratio| (0.25..=4.0).contains(*ratio)).count() as f64 / ratios.len() as f64
}

/// A render and bounds of its relative mean squared error: of the noisy image, with the default parameters, and with
/// the thesis parameters, both at R = 10.
struct Bound {
    render: &'static str,
    scene: &'static str,
    default: f64,
    thesis: f64,
    /// Lower bound of the share of blocks whose estimated error is right within a factor of four, with the default.
    told: f64,
    /// Whether the published algorithm increases the error. In `cornell` lamp and ceiling share all features, so that
    /// THIRD smears one over the other; THIRD does not win there, but the smoothing of the maps gives it a share. The
    /// guard of the default prevents this.
    thesis_fails: bool,
}

/// Three percent above the measured value.
const BOUNDS: [Bound; 4] = [
    Bound { render: "cornell_8spp", scene: "cornell", default: 0.0023, thesis: 3.02, told: 0.75, thesis_fails: true },
    Bound {
        render: "cornell_32spp",
        scene: "cornell",
        default: 0.000785,
        thesis: 1.904,
        told: 0.9,
        thesis_fails: true,
    },
    Bound {
        render: "dof_spheres_32spp",
        scene: "dof_spheres",
        default: 0.00287,
        thesis: 0.00438,
        told: 0.9,
        thesis_fails: false,
    },
    Bound {
        render: "caustic_ring_32spp",
        scene: "caustic_ring",
        default: 0.00638,
        thesis: 0.01987,
        told: 0.45,
        thesis_fails: false,
    },
];

#[test]
fn errors_stay_within_their_bounds() {
    let gpu = Gpu::open(&DeviceChoice::Auto).unwrap_or_else(|error| panic!("{error}"));
    let mut failures = Vec::new();
    for bound in BOUNDS {
        let set = frames::noisy(bound.render);
        let (frame, _) = set.to_frame().unwrap_or_else(|error| panic!("{error}"));
        let reference = frames::converged(bound.scene);
        let error_of = |image: &Image| relative_mse(image, &reference).unwrap_or_else(|error| panic!("{error}"));
        let noisy = error_of(&frame.color().mean);
        for (preset, params, most) in
            [("default", DfcParams::default(), bound.default), ("thesis", DfcParams::thesis(), bound.thesis)]
        {
            let estimate = Denoiser::new(&gpu, params)
                .and_then(|denoiser| denoiser.denoise(&frame))
                .unwrap_or_else(|error| panic!("{error}"));
            let error = error_of(&estimate.color);
            let told = share_within_four(&estimate, &reference);
            println!(
                "{}, {preset}: the error is told within a factor of four on {:.0} % of the blocks",
                bound.render,
                100.0 * told
            );
            if preset == "default" && told < bound.told {
                failures.push(format!(
                    "{}: the error is told within a factor of four on {told:.3} of the blocks, below {}",
                    bound.render, bound.told
                ));
            }
            println!("{}, {preset}: relative MSE {noisy:.6} before, {error:.6} after", bound.render);
            if error > most {
                failures.push(format!("{}, {preset}: relative MSE {error:.6}, above {most:.6}", bound.render));
            }
            if error > noisy && !(preset == "thesis" && bound.thesis_fails) {
                failures.push(format!(
                    "{}, {preset}: relative MSE {error:.6}, the noisy input has {noisy:.6}",
                    bound.render
                ));
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}
