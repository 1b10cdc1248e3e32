//! `gaussian`: averages, the variance of averages, and averages of a pixel's neighbours.

use glam::IVec2;
use stein::gpu::{Buffer, Gpu};
use stein::stage::gaussian::{Averaging, Gaussian, gaussian};

use crate::common::{assert_near, bits, checked_gpu, extent_of, flat, gpu, own_size, packed, read, run, scene, upload};
use crate::reference::gaussian as reference;
use crate::reference::{Grid, Planes};

fn smoothed(gpu: &Gpu, planes: &[&[Grid]], kernel: Gaussian, averaging: Averaging) -> (Buffer, IVec2) {
    let extent = extent_of(&planes[0][0]);
    let data: Vec<f32> = planes.iter().flat_map(|plane| packed(plane)).collect();
    let buffer = run(gpu, |rec| {
        let source = rec.upload("source", &data)?;
        gaussian(rec, extent, &source, planes.len() as u32, kernel, averaging)
    });
    (buffer, extent)
}

const SIZES: [(usize, usize); 4] = [(257, 89), (7, 300), (1, 1), (5, 3)];

const SIGMAS: [f32; 4] = [0.8, 1.0, 2.828, 4.0];

fn check(what: &str, averaging: Averaging, twin: impl Fn(&Grid, f64, usize) -> Grid) {
    for (gpu, sizes) in [(gpu(), &SIZES[..]), (checked_gpu(), &[(31, 9)][..])] {
        for &(width, height) in sizes {
            for sigma in SIGMAS {
                let scene = scene(width, height, 61);
                let kernel = Gaussian::new(sigma);
                // Weights and maps have no sign; the sums of the halves' spread cancel.
                let planes: &[&[Grid]] = match averaging {
                    Averaging::Mean => &[&scene.mean, &scene.spread],
                    Averaging::Variance => &[&scene.variance],
                    Averaging::Neighbours => &[&scene.mean[..1]],
                };
                let (buffer, extent) = smoothed(gpu, planes, kernel, averaging);
                for (plane, (actual, source)) in read(gpu, &buffer, extent).iter().zip(planes).enumerate() {
                    let run = |grid: &Grid| twin(grid, sigma.into(), kernel.radius as usize);
                    let expected: Planes = source.iter().map(run).collect();
                    let magnitudes: Planes = source.iter().map(|grid| run(&grid.like(|p| grid.at(p).abs()))).collect();
                    // Without the centre, only the rounding error of a spike is left.
                    let scale: Planes = magnitudes
                        .iter()
                        .zip(*source)
                        .map(|(sum, own)| sum.like(|p| sum.at(p) + own.at(p).abs()))
                        .collect();
                    let scale = if averaging == Averaging::Neighbours { scale } else { own_size(&magnitudes, 0.0) };
                    assert_near(
                        &format!("{what}, {width}×{height}, σ {sigma}, plane {plane}"),
                        actual,
                        &expected,
                        &scale,
                        1e-5,
                        0.0,
                    );
                }
            }
        }
    }
}

#[test]
fn averages_are_weighted_by_a_gaussian() {
    check("mean", Averaging::Mean, reference::gaussian);
}

#[test]
fn variances_are_weighted_by_its_square() {
    check("variance", Averaging::Variance, reference::gaussian_variance);
}

#[test]
fn neighbours_are_averaged_without_the_pixel_itself() {
    check("neighbours", Averaging::Neighbours, reference::gaussian_neighbours);
}

#[test]
fn a_binary_map_stays_between_its_values() {
    let map = scene(64, 40, 62).mean[0].like(|p| f64::from((p.x / 9 + p.y / 7) % 2 == 0));
    let planes: &[Grid] = std::slice::from_ref(&map);
    let (buffer, extent) = smoothed(gpu(), &[planes], Gaussian::new(2.0), Averaging::Neighbours);
    let actual = read(gpu(), &buffer, extent).remove(0);
    assert_near("lowest and highest", &actual[..1], &[map.like(|_| 0.5)], &flat(planes, 0.5), 1.0 + 1e-6, 0.0);
}

/// A pixel's sums do not depend on which rows were uploaded, as long as its window was.
#[test]
fn rows_of_a_part_have_the_bits_of_the_whole() {
    let scene = scene(33, 64, 63);
    for averaging in [Averaging::Mean, Averaging::Variance, Averaging::Neighbours] {
        let kernel = Gaussian::new(1.5);
        let of = |planes: &[Grid]| {
            let extent = extent_of(&planes[0]);
            let buffer = run(gpu(), |rec| {
                let source = upload(rec, planes)?;
                gaussian(rec, extent, &source, 1, kernel, averaging)
            });
            bits(gpu(), &buffer)
        };
        let whole = of(&scene.variance);
        // From row 3 on, where no block of four rows begins.
        let below = |grid: &Grid| Grid { height: 61, values: grid.values[3 * 33..].to_vec(), ..*grid };
        let part = of(&scene.variance.iter().map(below).collect::<Planes>());
        let radius = kernel.radius as usize;
        assert!(whole[(3 + radius) * 33 * 4..] == part[radius * 33 * 4..], "{averaging:?}");
    }
}
