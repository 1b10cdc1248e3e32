//! `keep_clean`. A share is a square root of a quotient, so that f32 keeps six digits of it.

use stein::gpu::Gpu;
use stein::stage::keep_clean::{CleanRule, Input, keep_clean};

use crate::common::{
    Scene, assert_near, checked_gpu, extent_of, gpu, own_size, packed_signal, read, rounded, run, scene, upload,
};
use crate::reference::keep_clean::{CleanParams, allowed, clean_shares, kept, kept_error};
use crate::reference::random::Random;
use crate::reference::variance::Signal;
use crate::reference::{Grid, Planes, Point};

/// A scene in which the noise of each pixel ranges from none to more than a hundredth of its value. Two blocks are
/// black, one of them except for one pixel.
fn nearly_clean_scene(width: usize, height: usize) -> Scene {
    let Scene { mean, spread, variance } = scene(width, height, 51);
    let mut random = Random(52);
    let size = random.uniform_grid(width, height, -7.0, 0.0);
    let noise_of = |p: Point| if size.at(p) < -6.0 { 0.0 } else { 10f64.powf(size.at(p)) };
    let is_black = |p: Point| p.y < 14 && p.x < 22;
    let is_lit = |p: Point| p.x == 17 && p.y == 7;
    let changed = |planes: &Planes, value: &(dyn Fn(f64, Point) -> f64 + Sync)| -> Planes {
        planes
            .iter()
            .map(|grid| rounded(grid.like(|p| if is_black(p) && !is_lit(p) { 0.0 } else { value(grid.at(p), p) })))
            .collect()
    };
    Scene {
        mean: changed(&mean, &|value, _| value),
        spread: changed(&spread, &|value, p| value * noise_of(p)),
        variance: changed(&variance, &|value, p| value * noise_of(p).powi(2)),
    }
}

fn check(gpu: &Gpu, width: usize, height: usize, with_variance: bool, with_error: bool) -> [usize; 3] {
    let Scene { mean, spread, variance } = nearly_clean_scene(width, height);
    let other = scene(width, height, 53);
    let (filtered_mean, filtered_spread) = (other.mean, other.spread);
    let error = rounded(Random(54).uniform_grid(width, height, 0.0, 2.0));
    let extent = extent_of(&mean[0]);
    let component = 2;
    let (found, errors) = run(gpu, |rec| {
        let signal = rec.upload("signal", &packed_signal(&mean, &spread))?;
        let sample_variance = with_variance.then(|| upload(rec, &variance)).transpose()?;
        let filtered = rec.upload("filtered", &packed_signal(&filtered_mean, &filtered_spread))?;
        let errors = upload(rec, &[error.clone(), error.clone(), error.clone()])?;
        let input = Input { signal: &signal, sample_variance: sample_variance.as_ref() };
        let found =
            keep_clean(rec, extent, input, &filtered, with_error.then_some((&errors, component)), CleanRule::DEFAULT)?;
        Ok((found, errors))
    });

    let input = Signal {
        mean: mean.clone(),
        spread: Some(spread.clone()),
        sample_variance: with_variance.then(|| variance.clone()),
    };
    let shares = clean_shares(&input, &filtered_mean, CleanParams::default());
    let what = |part: &str| format!("{part}, {width}×{height}, variance {with_variance}, error {with_error}");
    let signal = read(gpu, &found, extent);
    for (part, actual, own, filtered) in
        [("mean", &signal[0], &mean, &filtered_mean), ("half spread", &signal[1], &spread, &filtered_spread)]
    {
        let size: Planes =
            own.iter().zip(filtered).map(|(a, b)| a.like(|p| a.at(p).abs() + b.at(p).abs() + 1e-9)).collect();
        assert_near(&what(part), actual, &kept(own, filtered, &shares), &size, 1e-5, 0.0);
    }
    let errors = read(gpu, &errors, extent).remove(0);
    let expected = if with_error { kept_error(&error, &input, CleanParams::default()) } else { error.clone() };
    assert_near(
        &what("error"),
        &errors[2..3],
        std::slice::from_ref(&expected),
        &own_size(std::slice::from_ref(&expected), 1e-6),
        1e-4,
        0.0,
    );
    assert_near(
        &what("other components"),
        &errors[..2],
        &[error.clone(), error.clone()],
        &own_size(&[error.clone(), error], 0.0),
        0.0,
        0.0,
    );
    let count = |matches: &dyn Fn(f64) -> bool| shares.values.iter().filter(|share| matches(**share)).count();
    let free = allowed(&input, CleanParams::default()).values.iter().filter(|allowed| allowed.is_infinite()).count();
    [count(&|share| share == 0.0), count(&|share| share > 0.0 && share < 1.0), free]
}

#[test]
fn clean_pixels_stay_and_noisy_ones_do_not() {
    for (with_variance, with_error) in [(true, true), (true, false), (false, true), (false, false)] {
        let [stay, between, free] = check(gpu(), 257, 89, with_variance, with_error);
        assert!(stay > 100 && between > 100 && free > 1000, "{stay} stay, {between} are between, {free} are free");
    }
    for (width, height) in [(7, 300), (1, 1), (31, 9)] {
        check(gpu(), width, height, true, true);
        check(checked_gpu(), width, height, false, true);
    }
}

#[test]
fn black_stays_black_amid_black_alone() {
    let mean: Planes = nearly_clean_scene(40, 30).mean;
    let no_noise = Signal { spread: None, sample_variance: Some(vec![Grid::filled(40, 30, 0.0); 3]), mean };
    let filtered = vec![Grid::filled(40, 30, 1.0); 3];
    let shares = clean_shares(&no_noise, &filtered, CleanParams::default());
    let at = |x, y| shares.at(Point { x, y });
    assert_eq!(
        (at(5, 5), at(14, 7), at(13, 7), at(17, 7)),
        (0.0, 1.0, 0.0, 0.0),
        "deep in black, near the lit pixel, just beyond, that pixel itself"
    );
}
