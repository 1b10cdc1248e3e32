//! Host-side planes.

/// Width and height in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Extent {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Extent {
    /// Number of pixels.
    pub fn pixels(self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// One or more planes of one extent that belong together: the three channels of a colour, the two of a texture coordinate.
///
/// Planar: `planes[channel][y * width + x]`, rows from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Shared by all planes.
    pub extent: Extent,
    /// One vector of `extent.pixels()` values per channel.
    pub planes: Vec<Vec<f32>>,
}

impl Image {
    /// An image of `channels` planes filled with `value`.
    pub fn filled(extent: Extent, channels: usize, value: f32) -> Self {
        Self { extent, planes: vec![vec![value; extent.pixels()]; channels] }
    }

    /// Number of planes.
    pub fn channels(&self) -> usize {
        self.planes.len()
    }
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
