//! Layers by which others are multiplied before they are filtered: factors, such as the colours of materials, and alpha
//! for straight colours. What is filtered is the product, and what is written is the quotient.

use stein::image::Image;

use crate::source::Planes;

/// What a multiplier is, which decides the values that count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MultiplierKind {
    /// A layer that a renderer's compositor multiplies by this one. Values that are negative or not finite count as 0.
    Factor,
    /// The alpha of a straight colour. It counts as 0 to 1.
    Alpha,
}

/// A layer by which the stored values of a signal are multiplied.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Multiplier {
    pub(crate) kind: MultiplierKind,
    /// One channel for all channels of the signal, or one for each.
    pub(crate) mean: Planes,
    /// Multiplier of half A; `None` takes that of the mean.
    pub(crate) half_a: Option<Planes>,
    /// Multiplier of half B; `None` takes that of the mean.
    pub(crate) half_b: Option<Planes>,
}

impl MultiplierKind {
    /// Returns the number by which a value is multiplied for a stored multiplier. Where it is 0, the product is 0
    /// whatever the value is, also NaN. An alpha that is not finite makes the product NaN, so that the pixel is
    /// repaired.
    fn number(self, stored: f32) -> f32 {
        match self {
            Self::Factor if stored.is_finite() => stored.max(0.0),
            Self::Factor => 0.0,
            Self::Alpha if stored.is_finite() => stored.clamp(0.0, 1.0),
            Self::Alpha => f32::NAN,
        }
    }

    /// Multiplies the values of an image.
    pub(crate) fn multiply(self, image: &mut Image, by: &Image) {
        for (channel, plane) in image.planes.iter_mut().enumerate() {
            self.multiply_plane(plane, of_channel(by, channel));
        }
    }

    /// Multiplies the values of a plane.
    pub(crate) fn multiply_plane(self, plane: &mut [f32], by: &[f32]) {
        self.scale(plane, by, |number| number);
    }

    /// Multiplies the variances in an image by the squares.
    pub(crate) fn multiply_variance(self, image: &mut Image, by: &Image) {
        for (channel, plane) in image.planes.iter_mut().enumerate() {
            self.multiply_variance_plane(plane, of_channel(by, channel));
        }
    }

    /// Multiplies the variances in a plane by the squares.
    pub(crate) fn multiply_variance_plane(self, plane: &mut [f32], by: &[f32]) {
        self.scale(plane, by, |number| number * number);
    }

    fn scale(self, plane: &mut [f32], by: &[f32], scale: impl Fn(f32) -> f32) {
        for (value, stored) in plane.iter_mut().zip(by) {
            let number = self.number(*stored);
            *value = if number == 0.0 { 0.0 } else { *value * scale(number) };
        }
    }

    /// Returns the values of an image of products as they were before the multiplication; 0 where the multiplier is 0.
    pub(crate) fn divided(self, image: &Image, by: &Image) -> Image {
        let divided = |(channel, plane): (usize, &Vec<f32>)| {
            let pixels = plane.iter().zip(of_channel(by, channel));
            let quotient = |(value, stored): (&f32, &f32)| {
                let number = self.number(*stored);
                if number > 0.0 { value / number } else { 0.0 }
            };
            pixels.map(quotient).collect()
        };
        Image { extent: image.extent, planes: image.planes.iter().enumerate().map(divided).collect() }
    }
}

/// Returns the plane of a multiplier for a channel of the signal: a single plane is for all channels.
fn of_channel(by: &Image, channel: usize) -> &[f32] {
    &by.planes[if by.planes.len() == 1 { 0 } else { channel }]
}

#[cfg(test)]
mod tests {
    use stein::image::Extent;

    use super::*;

    fn image(planes: &[&[f32]]) -> Image {
        let extent = Extent { width: planes[0].len() as u32, height: 1 };
        Image { extent, planes: planes.iter().map(|plane| plane.to_vec()).collect() }
    }

    #[test]
    fn colours_are_multiplied_by_alpha_and_divided_again() {
        let alpha = image(&[&[0.5, 0.0, -1.0, 2.0]]);
        let mut colour = image(&[&[3.0, f32::NAN, f32::INFINITY, 4.0]]);
        MultiplierKind::Alpha.multiply(&mut colour, &alpha);
        assert_eq!(colour.planes[0], [1.5, 0.0, 0.0, 4.0]);
        let mut damaged = image(&[&[1.0; 3]]);
        MultiplierKind::Alpha.multiply(&mut damaged, &image(&[&[f32::NAN, f32::INFINITY, f32::NEG_INFINITY]]));
        assert!(damaged.planes[0].iter().all(|value| value.is_nan()));
        assert_eq!(MultiplierKind::Alpha.divided(&colour, &alpha).planes[0], [3.0, 0.0, 0.0, 4.0]);
        let mut variance = image(&[&[8.0, f32::NAN]]);
        MultiplierKind::Alpha.multiply_variance(&mut variance, &alpha);
        assert_eq!(variance.planes[0], [2.0, 0.0]);
    }

    #[test]
    fn factors_multiply_each_channel_and_never_make_a_value_that_is_not_finite() {
        let factor = image(&[&[0.5, 0.0, -1.0], &[4.0, f32::NAN, f32::INFINITY]]);
        let mut light = image(&[&[3.0, f32::NAN, 2.0], &[1.0, 2.0, 3.0]]);
        MultiplierKind::Factor.multiply(&mut light, &factor);
        assert_eq!(light.planes, [[1.5, 0.0, 0.0], [4.0, 0.0, 0.0]]);
        let denoised = image(&[&[2.0; 3], &[2.0; 3]]);
        let quotient = MultiplierKind::Factor.divided(&denoised, &factor);
        assert_eq!(quotient.planes, [[4.0, 0.0, 0.0], [0.5, 0.0, 0.0]]);
    }
}
