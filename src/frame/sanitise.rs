//! Making everything finite, without letting a damaged value leave a trace.

use super::repairs::{Damage, DamagedImage, Layer};
use super::{LayerRepairs, Repairs, SamplesPerPixel, Signal};
use crate::error::{Error, RequestCause, Result};
use crate::image::Extent;

/// Largest magnitude of a value: squares of larger values come too close to the end of f32 for sums of them.
pub(super) const LARGEST: f32 = 1e18;

/// Largest variance; variances are squares already.
pub(super) const LARGEST_VARIANCE: f32 = LARGEST * LARGEST;

/// Least distance that means that the ray hit nothing: Cycles writes 10¹⁰.
const MISS_DISTANCE: f32 = 1e9;

/// State of a value in the repair.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Pixel {
    /// The value is usable for averages.
    Good,
    /// The value must be replaced.
    Bad,
    /// The value belongs to a ray that hit nothing; it is neither replaced nor averaged.
    Miss,
}

/// Result of the repair of a signal.
pub(super) struct Sanitised {
    pub(super) found: LayerRepairs,
    /// Whether each pixel is a miss; misses hold zeros.
    pub(super) misses: Vec<bool>,
    /// Channels whose mean has no usable value; they hold zeros.
    pub(super) unusable: Vec<usize>,
}

/// Repairs a signal in place. Each channel is repaired by itself. Where a mean or its half spread is damaged, mean,
/// half spread and variance are replaced; where only the variance is damaged, only the variance is.
///
/// `may_miss`: the signal is a distance or position, in which infinity or a huge value is no damage.
pub(super) fn sanitise(layer: Layer, signal: &mut Signal, may_miss: bool) -> Sanitised {
    let extent = signal.mean.extent;
    let mut found = LayerRepairs { layer: layer.name.to_owned(), ..LayerRepairs::default() };
    let mut misses = vec![false; extent.pixels()];
    if may_miss {
        let is_miss = |pixel: usize| signal.mean.planes.iter().any(|plane| plane[pixel].abs() >= MISS_DISTANCE);
        let is_nan = |pixel: usize| signal.mean.planes.iter().any(|plane| plane[pixel].is_nan());
        misses.iter_mut().enumerate().for_each(|(pixel, miss)| *miss = is_miss(pixel) && !is_nan(pixel));
        // Where all other pixels are misses, a damaged pixel becomes a miss, too.
        let has_hit =
            |plane: &Vec<f32>| plane.iter().zip(&misses).any(|(value, miss)| !miss && !is_damaged(*value, LARGEST));
        if misses.contains(&true) && !signal.mean.planes.iter().any(has_hit) {
            misses.fill(true);
        }
    }
    found.misses = misses.iter().filter(|miss| **miss).count();

    let mut pixels = Replaced::default();
    let mut variances = Replaced::default();
    let mut unusable = Vec::new();
    for channel in 0..signal.mean.channels() {
        let mean = &mut signal.mean.planes[channel];
        let spread = signal.half_spread.as_mut().map(|image| &mut image.planes[channel]);
        let mut variance = signal.variance_of_mean.as_mut().map(|image| &mut image.planes[channel]);

        let name = layer.channel(channel);
        let mut state: Vec<Pixel> = misses.iter().map(|miss| if *miss { Pixel::Miss } else { Pixel::Good }).collect();
        find_damage(&mut found, DamagedImage::Mean, &name, mean, &mut state, LARGEST);
        if let Some(spread) = &spread {
            find_damage(&mut found, DamagedImage::Halves, &name, spread, &mut state, LARGEST);
        }
        pixels.add(&state);
        let mut values: Vec<&mut Vec<f32>> = std::iter::once(mean).chain(spread).collect();
        if state.contains(&Pixel::Bad) && !repair(&mut values, &state, extent) {
            unusable.push(channel);
        }
        if let Some(variance) = variance.as_deref_mut() {
            find_damage(&mut found, DamagedImage::Variance, &name, variance, &mut state, LARGEST_VARIANCE);
            for value in variance.iter_mut().filter(|value| **value < 0.0 && **value >= -LARGEST_VARIANCE) {
                *value = 0.0;
                found.negative_variances += 1;
            }
            variances.add(&state);
            repair(&mut [variance], &state, extent);
        }
        for plane in values.into_iter().chain(variance) {
            plane.iter_mut().zip(&misses).filter(|(_, miss)| **miss).for_each(|(value, _)| *value = 0.0);
        }
    }
    found.pixels_replaced = pixels.count();
    found.variances_replaced = variances.count_without(&pixels);
    Sanitised { found, misses, unusable }
}

/// Pixels in which a channel was replaced; empty if there are none.
#[derive(Default)]
struct Replaced(Vec<bool>);

impl Replaced {
    fn add(&mut self, state: &[Pixel]) {
        if state.contains(&Pixel::Bad) {
            self.0.resize(state.len(), false);
            self.0.iter_mut().zip(state).for_each(|(replaced, state)| *replaced |= *state == Pixel::Bad);
        }
    }

    fn count(&self) -> usize {
        self.0.iter().filter(|replaced| **replaced).count()
    }

    fn count_without(&self, others: &Self) -> usize {
        self.0.iter().enumerate().filter(|(pixel, replaced)| **replaced && others.0.get(*pixel) != Some(&true)).count()
    }
}

/// Repairs the sample counts: they become positive and finite, or unknown if not one of them is.
pub(super) fn sanitise_samples(
    samples: SamplesPerPixel,
    extent: Extent,
    repairs: &mut Repairs,
) -> Result<SamplesPerPixel> {
    match samples {
        SamplesPerPixel::Uniform(count) if count > 0.0 && count <= LARGEST => Ok(SamplesPerPixel::Uniform(count)),
        SamplesPerPixel::Uniform(count) => {
            repairs.notes.push(format!("samples: {count} samples per pixel make no sense, taken as unknown"));
            Ok(SamplesPerPixel::Unknown)
        }
        SamplesPerPixel::Unknown => Ok(SamplesPerPixel::Unknown),
        SamplesPerPixel::PerPixel(mut counts) => {
            if counts.extent != extent || counts.channels() != 1 || counts.planes[0].len() != extent.pixels() {
                return Err(Error::Request(RequestCause::CountsShape { extent }));
            }
            let mut found = LayerRepairs { layer: "samples".into(), ..LayerRepairs::default() };
            let mut state = vec![Pixel::Good; extent.pixels()];
            find_damage(&mut found, DamagedImage::Counts, "channel 1", &counts.planes[0], &mut state, LARGEST);
            mark(&mut state, &counts.planes[0], |count| count <= 0.0);
            found.pixels_replaced = state.iter().filter(|state| **state == Pixel::Bad).count();
            if !repair(&mut [&mut counts.planes[0]], &state, extent) {
                repairs.notes.push("samples: not one pixel has a positive count, taken as unknown".into());
                return Ok(SamplesPerPixel::Unknown);
            }
            repairs.add(found);
            Ok(SamplesPerPixel::PerPixel(counts))
        }
    }
}

pub(super) fn is_damaged(value: f32, largest: f32) -> bool {
    value.is_nan() || value.abs() > largest
}

/// Marks the values that match as bad, except misses.
fn mark(state: &mut [Pixel], plane: &[f32], matches: impl Fn(f32) -> bool) {
    let hits = state.iter_mut().zip(plane).filter(|(state, _)| **state != Pixel::Miss);
    hits.filter(|(_, value)| matches(**value)).for_each(|(state, _)| *state = Pixel::Bad);
}

/// Counts the damaged values of a plane and marks them as bad. Misses are not damage.
fn find_damage(
    found: &mut LayerRepairs,
    image: DamagedImage,
    channel: &str,
    plane: &[f32],
    state: &mut [Pixel],
    largest: f32,
) {
    let mut values = 0;
    for (value, _) in
        plane.iter().zip(&*state).filter(|(value, state)| **state != Pixel::Miss && is_damaged(**value, largest))
    {
        values += 1;
        if value.is_nan() {
            found.nan_values += 1;
        } else if value.is_infinite() {
            found.infinite_values += 1;
        } else {
            found.oversized_values += 1;
        }
    }
    if values > 0 {
        found.damage.push(Damage { image, channel: channel.to_owned(), values });
        mark(state, plane, |value| is_damaged(value, largest));
    }
}

/// Fills the bad pixels of some planes. Returns whether there was a good pixel; without any, all values become 0.
fn repair(planes: &mut [&mut Vec<f32>], state: &[Pixel], extent: Extent) -> bool {
    if !state.contains(&Pixel::Bad) {
        return true;
    }
    // Damaged pixels among misses only: no pixel near them has a value, so they become 0.
    let unreached = fill_from_neighbours(planes, state, extent);
    for plane in planes {
        unreached.iter().for_each(|&pixel| plane[pixel] = 0.0);
    }
    state.contains(&Pixel::Good)
}

/// Replaces every bad pixel by an average of good pixels, from the rim of each damaged region inwards. A pixel beside
/// good pixels becomes the average of those among its eight neighbours; each further ring becomes the average of the
/// ring before it. Reads only pixels that are good or were filled in an earlier ring, so that the result does not
/// depend on any order. Time is proportional to the number of bad pixels.
///
/// Returns the bad pixels that no good pixel can reach: all of them if there are no good ones, else those enclosed by
/// misses.
fn fill_from_neighbours(planes: &mut [&mut Vec<f32>], state: &[Pixel], extent: Extent) -> Vec<usize> {
    let mut usable: Vec<bool> = state.iter().map(|state| *state == Pixel::Good).collect();
    let mut waiting: Vec<bool> = state.iter().map(|state| *state == Pixel::Bad).collect();
    let bad = (0..state.len()).filter(|&pixel| waiting[pixel]);
    let mut ring: Vec<usize> =
        bad.clone().filter(|&pixel| neighbours(pixel, extent).any(|neighbour| usable[neighbour])).collect();
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

/// Returns the up to eight neighbours of a pixel that lie inside the image.
fn neighbours(pixel: usize, extent: Extent) -> impl Iterator<Item = usize> {
    let (width, height) = (extent.width as usize, extent.height as usize);
    let (x, y) = (pixel % width, pixel / width);
    let rows = y.saturating_sub(1)..(y + 2).min(height);
    rows.flat_map(move |row| (x.saturating_sub(1)..(x + 2).min(width)).map(move |column| row * width + column))
        .filter(move |&neighbour| neighbour != pixel)
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
