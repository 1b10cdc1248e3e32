//! Host-side planes.

use crate::host_memory::{Shortage, try_filled};

/// Width and height in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Extent {
    /// Number of pixels in a row.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
}

impl Extent {
    /// Returns the number of pixels.
    pub fn pixels(self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// One or more planes of one extent that belong together: the three channels of a colour, the two of a texture
/// coordinate.
///
/// Planar: `planes[channel][y * width + x]`, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Width and height of every plane.
    pub extent: Extent,
    /// One vector of `extent.pixels()` values per channel.
    pub planes: Vec<Vec<f32>>,
}

impl Image {
    /// Makes an image of `channels` planes filled with `value`.
    pub fn filled(extent: Extent, channels: usize, value: f32) -> Self {
        Self { extent, planes: vec![vec![value; extent.pixels()]; channels] }
    }

    /// As [`Image::filled`], but returns an error if memory is short.
    ///
    /// # Errors
    /// [`Shortage`] if an allocation fails.
    pub fn try_filled(extent: Extent, channels: usize, value: f32) -> Result<Self, Shortage> {
        let planes = (0..channels).map(|_| try_filled(extent.pixels(), value)).collect::<Result<_, _>>()?;
        Ok(Self { extent, planes })
    }

    /// Returns a part of the image.
    pub(crate) fn cropped(&self, part: Window) -> Self {
        Self {
            extent: part.extent,
            planes: self.planes.iter().map(|plane| cropped(plane, self.extent, part)).collect(),
        }
    }

    /// Returns the number of planes.
    pub fn channels(&self) -> usize {
        self.planes.len()
    }
}

/// Returns the values of a part of a plane; the part must lie inside.
pub(crate) fn cropped<T: Copy>(plane: &[T], extent: Extent, part: Window) -> Vec<T> {
    let (left, width) = (part.x as usize, part.extent.width as usize);
    let rows = plane.chunks_exact(extent.width as usize).skip(part.y as usize).take(part.extent.height as usize);
    rows.flat_map(|row| &row[left..left + width]).copied().collect()
}

/// A rectangle of pixels in an image's own coordinates: an OpenEXR data or display window.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Window {
    /// Column of the left edge; may be negative.
    pub x: i32,
    /// Row of the top edge; may be negative.
    pub y: i32,
    /// Width and height.
    pub extent: Extent,
}

impl std::fmt::Display for Extent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}×{}", self.width, self.height)
    }
}

impl std::fmt::Display for Window {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} at ({}, {})", self.extent, self.x, self.y)
    }
}
