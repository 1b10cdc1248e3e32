//! Making everything finite, without letting a damaged value leave a trace.

use super::{LayerRepairs, Repairs, SamplesPerPixel, Signal};
use crate::error::{Error, Result};
use crate::image::Extent;

/// Squares of larger values come too close to the end of f32 for sums of them.
const LARGEST: f32 = 1e18;

/// Variances are squares already.
const LARGEST_VARIANCE: f32 = LARGEST * LARGEST;

/// A distance from here on means that the ray hit nothing: Cycles writes 10¹⁰.
const MISS_DISTANCE: f32 = 1e9;

/// What a pixel is to the repair of others.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Pixel {
    /// Can be averaged.
    Good,
    /// To be replaced.
    Bad,
    /// Neither: a ray that hit nothing.
    Miss,
}

/// Repairs a signal in place. Returns what was done and, for each pixel, whether it is a miss; misses hold zeros.
///
/// `may_miss`: the signal is a distance or position, in which infinity or a huge value is no damage.
pub(super) fn sanitise(name: &str, signal: &mut Signal, may_miss: bool) -> Result<(LayerRepairs, Vec<bool>)> {
    let extent = signal.mean.extent;
    let mut found = LayerRepairs { layer: name.to_owned(), ..LayerRepairs::default() };
    let mut state = vec![Pixel::Good; extent.pixels()];
    if may_miss {
        for plane in &signal.mean.planes {
            mark(&mut state, plane, Pixel::Miss, |value| value.abs() >= MISS_DISTANCE);
        }
        // A NaN in another channel is damage all the same.
        for plane in &signal.mean.planes {
            mark(&mut state, plane, Pixel::Bad, f32::is_nan);
        }
    }
    let misses_so_far = state.clone();
    for plane in [Some(&signal.mean), signal.half_spread.as_ref()].into_iter().flatten().flat_map(|image| &image.planes) {
        count_damage(&mut found, plane, &misses_so_far, LARGEST);
        mark(&mut state, plane, Pixel::Bad, |value| is_damaged(value, LARGEST));
    }
    keep_misses(&mut state, &misses_so_far);

    let mut variance_state = state.clone();
    if let Some(variance) = &mut signal.variance_of_mean {
        for plane in &mut variance.planes {
            count_damage(&mut found, plane, &state, LARGEST_VARIANCE);
            mark(&mut variance_state, plane, Pixel::Bad, |value| is_damaged(value, LARGEST_VARIANCE));
            for value in plane.iter_mut().filter(|value| **value < 0.0 && **value >= -LARGEST_VARIANCE) {
                *value = 0.0;
                found.negative_variances += 1;
            }
        }
        keep_misses(&mut variance_state, &state);
    }

    // Where all that is left are misses, a damaged pixel is one too.
    if !state.contains(&Pixel::Good) && state.contains(&Pixel::Miss) {
        state.fill(Pixel::Miss);
        variance_state.fill(Pixel::Miss);
    }
    found.misses = state.iter().filter(|state| **state == Pixel::Miss).count();
    found.pixels_replaced = state.iter().filter(|state| **state == Pixel::Bad).count();
    found.variances_replaced = variance_state.iter().filter(|state| **state == Pixel::Bad).count() - found.pixels_replaced;

    let mut values: Vec<&mut Vec<f32>> = signal.mean.planes.iter_mut().collect();
    values.extend(signal.half_spread.iter_mut().flat_map(|spread| &mut spread.planes));
    repair(name, "value", &mut values, &state, extent)?;
    if let Some(variance) = &mut signal.variance_of_mean {
        repair(name, "variance", &mut variance.planes.iter_mut().collect::<Vec<_>>(), &variance_state, extent)?;
    }
    let misses: Vec<bool> = state.iter().map(|state| *state == Pixel::Miss).collect();
    let spread_and_variance = [&mut signal.half_spread, &mut signal.variance_of_mean].into_iter().flatten();
    for plane in spread_and_variance.flat_map(|image| &mut image.planes).chain(&mut signal.mean.planes) {
        plane.iter_mut().zip(&misses).filter(|(_, miss)| **miss).for_each(|(value, _)| *value = 0.0);
    }
    Ok((found, misses))
}

/// Positive, finite sample counts; unknown where not one is.
pub(super) fn sanitise_samples(samples: SamplesPerPixel, extent: Extent, repairs: &mut Repairs) -> Result<SamplesPerPixel> {
    match samples {
        SamplesPerPixel::Uniform(count) if count > 0.0 && count <= LARGEST => Ok(SamplesPerPixel::Uniform(count)),
        SamplesPerPixel::Uniform(count) => {
            repairs.notes.push(format!("samples: {count} samples per pixel make no sense, taken as unknown"));
            Ok(SamplesPerPixel::Unknown)
        }
        SamplesPerPixel::Unknown => Ok(SamplesPerPixel::Unknown),
        SamplesPerPixel::PerPixel(mut counts) => {
            if counts.extent != extent || counts.channels() != 1 || counts.planes[0].len() != extent.pixels() {
                return Err(Error::Request {
                    problem: format!("the sample counts are not one plane of {extent}"),
                    remedy: "give one count for each pixel, or one number for all".into(),
                });
            }
            let mut found = LayerRepairs { layer: "samples".into(), ..LayerRepairs::default() };
            let mut state = vec![Pixel::Good; extent.pixels()];
            count_damage(&mut found, &counts.planes[0], &state, LARGEST);
            mark(&mut state, &counts.planes[0], Pixel::Bad, |count| is_damaged(count, LARGEST) || count <= 0.0);
            found.pixels_replaced = state.iter().filter(|state| **state == Pixel::Bad).count();
            if found.pixels_replaced == state.len() {
                repairs.notes.push("samples: not one pixel has a positive count, taken as unknown".into());
                return Ok(SamplesPerPixel::Unknown);
            }
            repair("samples", "count", &mut [&mut counts.planes[0]], &state, extent)?;
            repairs.add(found);
            Ok(SamplesPerPixel::PerPixel(counts))
        }
    }
}

fn is_damaged(value: f32, largest: f32) -> bool {
    value.is_nan() || value.abs() > largest
}

fn mark(state: &mut [Pixel], plane: &[f32], mark: Pixel, matches: impl Fn(f32) -> bool) {
    state.iter_mut().zip(plane).filter(|(_, value)| matches(**value)).for_each(|(state, _)| *state = mark);
}

fn keep_misses(state: &mut [Pixel], before: &[Pixel]) {
    state.iter_mut().zip(before).filter(|(_, before)| **before == Pixel::Miss).for_each(|(state, _)| *state = Pixel::Miss);
}

fn count_damage(found: &mut LayerRepairs, plane: &[f32], state: &[Pixel], largest: f32) {
    for (value, _) in plane.iter().zip(state).filter(|(_, state)| **state != Pixel::Miss) {
        if value.is_nan() {
            found.nan_values += 1;
        } else if value.is_infinite() {
            found.infinite_values += 1;
        } else if is_damaged(*value, largest) {
            found.oversized_values += 1;
        }
    }
}

fn repair(name: &str, what: &str, planes: &mut [&mut Vec<f32>], state: &[Pixel], extent: Extent) -> Result<()> {
    let unreached = fill_from_neighbours(planes, state, extent);
    if unreached.len() == state.len() {
        return Err(Error::Request {
            problem: format!("layer {name}: not one pixel has a usable {what}"),
            remedy: "look at the layer in an image viewer; leave a feature out (`BufferSetRequest::skip_features`) or render it again".into(),
        });
    }
    // Damaged pixels amid misses only: nothing near tells more than the layer's zero.
    for plane in planes {
        unreached.iter().for_each(|&pixel| plane[pixel] = 0.0);
    }
    Ok(())
}

/// Replaces every bad pixel by an average of good ones, from the rim of each damaged region inwards: a pixel next to good pixels takes the average of
/// those among its eight neighbours, the next ring takes the average of what the ring before it took, and so on. Reads only pixels that are good or were
/// filled in an earlier ring, so that the result does not depend on any order. Time is proportional to the number of bad pixels.
///
/// Returns the bad pixels that no good pixel can reach: all of them if there are no good ones, else those enclosed by misses.
fn fill_from_neighbours(planes: &mut [&mut Vec<f32>], state: &[Pixel], extent: Extent) -> Vec<usize> {
    let mut usable: Vec<bool> = state.iter().map(|state| *state == Pixel::Good).collect();
    let mut waiting: Vec<bool> = state.iter().map(|state| *state == Pixel::Bad).collect();
    let bad = (0..state.len()).filter(|&pixel| waiting[pixel]);
    let mut ring: Vec<usize> = bad.clone().filter(|&pixel| neighbours(pixel, extent).any(|neighbour| usable[neighbour])).collect();
    while !ring.is_empty() {
        for plane in planes.iter_mut() {
            for &pixel in &ring {
                let (mut sum, mut count) = (0.0, 0.0);
                for neighbour in neighbours(pixel, extent).filter(|&neighbour| usable[neighbour]) {
                    sum += f64::from(plane[neighbour]);
                    count += 1.0;
                }
                plane[pixel] = (sum / count) as f32;
            }
        }
        for &pixel in &ring {
            usable[pixel] = true;
            waiting[pixel] = false;
        }
        let mut next = Vec::new();
        for neighbour in ring.iter().flat_map(|&pixel| neighbours(pixel, extent)) {
            if std::mem::take(&mut waiting[neighbour]) {
                next.push(neighbour);
            }
        }
        ring = next;
    }
    (0..state.len()).filter(|&pixel| state[pixel] == Pixel::Bad && !usable[pixel]).collect()
}

/// The up to eight neighbours of a pixel that lie inside the image.
fn neighbours(pixel: usize, extent: Extent) -> impl Iterator<Item = usize> {
    let (width, height) = (extent.width as usize, extent.height as usize);
    let (x, y) = (pixel % width, pixel / width);
    let rows = y.saturating_sub(1)..(y + 2).min(height);
    rows.flat_map(move |row| (x.saturating_sub(1)..(x + 2).min(width)).map(move |column| row * width + column)).filter(move |&neighbour| neighbour != pixel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Image;

    #[test]
    fn a_hole_is_filled_from_its_rim_inwards() {
        let extent = Extent { width: 5, height: 1 };
        let mut plane = vec![2.0, f32::NAN, f32::NAN, f32::NAN, 8.0];
        let state = [Pixel::Good, Pixel::Bad, Pixel::Bad, Pixel::Bad, Pixel::Good];
        let unreached = fill_from_neighbours(&mut [&mut plane], &state, extent);
        assert_eq!((plane, unreached.len()), (vec![2.0, 2.0, 5.0, 8.0, 8.0], 0));
    }

    #[test]
    fn misses_neither_give_nor_take() {
        let extent = Extent { width: 4, height: 1 };
        let mut plane = vec![3.0, 1e10, f32::NAN, 1e10];
        let state = [Pixel::Good, Pixel::Miss, Pixel::Bad, Pixel::Miss];
        assert_eq!(fill_from_neighbours(&mut [&mut plane], &state, extent), [2]);
        assert_eq!(plane[1], 1e10);
    }

    #[test]
    fn sample_counts_must_be_positive() {
        let extent = Extent { width: 2, height: 1 };
        let counts = Image { extent, planes: vec![vec![0.0, 16.0]] };
        let mut repairs = Repairs::default();
        let settled = sanitise_samples(SamplesPerPixel::PerPixel(counts), extent, &mut repairs);
        assert_eq!(settled.ok(), Some(SamplesPerPixel::PerPixel(Image::filled(extent, 1, 16.0))));
        assert_eq!(repairs.layer("samples").map(|found| found.pixels_replaced), Some(1));
    }
}
