//! Normals that are stored as (n + 1)/2.

use super::Signal;
use crate::image::Image;

/// How a layer of normals stores them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// As n, or in an unknown way.
    Plain,
    /// As (n + 1)/2.
    Halved,
}

/// Largest difference of a vector's length from 1 for the vector to count as a normal: noise and defocus change the
/// length.
const LENGTH_TOLERANCE: f32 = 0.1;
/// Distance by which noise may take components of encoded normals out of 0 to 1.
const COMPONENT_TOLERANCE: f32 = 0.05;
/// Largest share of the vectors with components farther out.
const OUT_OF_RANGE: f64 = 0.01;
/// Least share of the vectors that are normals after decoding.
const DECODED: f64 = 0.5;
/// Largest ratio of vectors of length 1 before decoding to those after it. In a scene of normals without negative
/// components, stored vectors have length 1 as they are.
const STORED: f64 = 0.5;
/// Least share of the pixels that hold a vector other than 0 and grey.
const LEAST_VECTORS: f64 = 0.01;

/// Finds how the three channels store normals: compares the lengths of the vectors before and after decoding.
///
/// If every vector of a scene fits both ways, the normals count as plain.
pub(super) fn encoding(mean: &Image) -> Encoding {
    let [x, y, z] = mean.planes.as_slice() else { return Encoding::Plain };
    let is_normal = |vector: [f32; 3]| (length(vector) - 1.0).abs() <= LENGTH_TOLERANCE;
    let (mut vectors, mut out_of_range, mut decoded, mut stored) = (0usize, 0usize, 0usize, 0usize);
    for pixel in 0..x.len() {
        let vector = [x[pixel], y[pixel], z[pixel]];
        let unfolded = vector.map(|component| 2.0 * component - 1.0);
        // A pixel that hit nothing is 0, or encodes 0.
        if vector == [0.0; 3] || length(unfolded) <= COMPONENT_TOLERANCE {
            continue;
        }
        vectors += 1;
        out_of_range += usize::from(
            !vector.iter().all(|component| (-COMPONENT_TOLERANCE..=1.0 + COMPONENT_TOLERANCE).contains(component)),
        );
        decoded += usize::from(is_normal(unfolded));
        stored += usize::from(is_normal(vector));
    }
    let share = |count: usize| count as f64 / vectors as f64;
    let is_halved = vectors as f64 >= LEAST_VECTORS * x.len() as f64
        && vectors > 0
        && share(out_of_range) <= OUT_OF_RANGE
        && share(decoded) >= DECODED
        && share(stored) <= STORED * share(decoded);
    if is_halved { Encoding::Halved } else { Encoding::Plain }
}

/// Turns (n + 1)/2 into n, and scales the noise with it. Pixels of 0 in all channels hit nothing and stay 0.
pub(super) fn decode(signal: &mut Signal) {
    let is_empty = |planes: &[Vec<f32>], pixel: usize| planes.iter().all(|plane| plane[pixel] == 0.0);
    for pixel in 0..signal.mean.extent.pixels() {
        if !is_empty(&signal.mean.planes, pixel) {
            signal.mean.planes.iter_mut().for_each(|plane| plane[pixel] = 2.0 * plane[pixel] - 1.0);
        }
    }
    let [spread, variance] = [&mut signal.half_spread, &mut signal.variance_of_mean]
        .map(|image| image.iter_mut().flat_map(|image| &mut image.planes));
    spread.flatten().for_each(|value| *value *= 2.0);
    variance.flatten().for_each(|value| *value *= 4.0);
}

fn length(vector: [f32; 3]) -> f32 {
    vector.iter().map(|component| component * component).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Extent;

    fn layer(vectors: &[[f32; 3]]) -> Image {
        let extent = Extent { width: vectors.len() as u32, height: 1 };
        Image { extent, planes: (0..3).map(|channel| vectors.iter().map(|vector| vector[channel]).collect()).collect() }
    }

    fn encoded(vectors: &[[f32; 3]]) -> Vec<[f32; 3]> {
        vectors.iter().map(|vector| vector.map(|component| (component + 1.0) / 2.0)).collect()
    }

    /// A sphere as a camera sees it, each vector shortened to `length`.
    fn sphere(length: f32) -> Vec<[f32; 3]> {
        let vector = |index: usize| {
            let (turn, out) = (index as f32 * 2.399_963, ((index as f32 + 0.5) / 500.0).sqrt());
            [out * turn.cos() * length, out * turn.sin() * length, (1.0 - out * out).sqrt() * length]
        };
        (0..500).map(vector).collect()
    }

    #[test]
    fn encoded_normals_are_told_by_their_lengths() {
        let wall = vec![[0.0, 0.0, 1.0]; 500];
        let floor = vec![[0.0, 1.0, 0.0]; 500];
        let corner = [vec![[1.0, 0.0, 0.0]; 200], vec![[0.0, 1.0, 0.0]; 200], vec![[0.0, 0.0, 1.0]; 200]].concat();
        for scene in [sphere(1.0), sphere(0.93), wall, floor, corner] {
            assert_eq!(encoding(&layer(&scene)), Encoding::Plain);
            assert_eq!(encoding(&layer(&encoded(&scene))), Encoding::Halved);
            let absolute: Vec<_> = scene.iter().map(|vector| vector.map(f32::abs)).collect();
            assert_eq!(encoding(&layer(&absolute)), Encoding::Plain);
            for background in [0.0, 0.5] {
                let with_sky = [encoded(&scene), vec![[background; 3]; 2000]].concat();
                assert_eq!(encoding(&layer(&with_sky)), Encoding::Halved, "{background}");
            }
        }
        // Defocus shortens vectors, down to nothing.
        for length in [0.8, 0.5, 0.2] {
            assert_eq!(encoding(&layer(&sphere(length))), Encoding::Plain, "{length}");
        }
        assert_eq!(encoding(&layer(&[[0.0; 3]; 100])), Encoding::Plain);
    }
}
