//! The camera: pan and zoom of an image. All views of a canvas share one camera.

use eframe::egui::{Pos2, Rect, Vec2};
use stein::Extent;

const LEAST_ZOOM: f32 = 1.0 / 64.0;
const MOST_ZOOM: f32 = 512.0;

/// Pan and zoom. Positions in the image are in pixels; (0, 0) is the upper left corner of the first pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Position in the image that is in the middle of the view.
    pub centre: Vec2,
    /// Points on the screen per pixel of the image.
    pub zoom: f32,
    /// Whether the image is to be fitted into the view, whatever its size.
    pub fits: bool,
}

impl Default for Camera {
    fn default() -> Self {
        Self { centre: Vec2::ZERO, zoom: 1.0, fits: true }
    }
}

impl Camera {
    /// Fits the image into a view, if [`Camera::fits`] is set.
    pub fn settle(&mut self, view: Rect, extent: Extent) {
        if self.fits {
            let size = Vec2::new(extent.width as f32, extent.height as f32);
            self.centre = size / 2.0;
            self.zoom = (view.width() / size.x).min(view.height() / size.y).clamp(LEAST_ZOOM, MOST_ZOOM);
        }
    }

    /// Converts a position in the image to a position on the screen.
    pub fn to_screen(&self, view: Rect, place: Vec2) -> Pos2 {
        view.center() + (place - self.centre) * self.zoom
    }

    /// Converts a position on the screen to a position in the image.
    pub fn to_image(&self, view: Rect, position: Pos2) -> Vec2 {
        self.centre + (position - view.center()) / self.zoom
    }

    /// Magnifies about the middle of the view.
    pub fn magnify(&mut self, factor: f32) {
        self.zoom = (self.zoom * factor).clamp(LEAST_ZOOM, MOST_ZOOM);
        self.fits = false;
    }

    /// Magnifies the image, while its point at `position` on the screen stays there.
    pub fn zoom_about(&mut self, view: Rect, position: Pos2, factor: f32) {
        let place = self.to_image(view, position);
        self.magnify(factor);
        self.centre = place - (position - view.center()) / self.zoom;
    }

    /// Moves the image with the pointer.
    pub fn drag(&mut self, by: Vec2) {
        self.centre -= by / self.zoom;
        self.fits = false;
    }

    /// Returns the pixel at a position on the screen; `None` outside of the image.
    pub fn pixel(&self, view: Rect, extent: Extent, position: Pos2) -> Option<[u32; 2]> {
        let place = self.to_image(view, position);
        let inside = |value: f32, size: u32| (0.0..size as f32).contains(&value).then_some(value as u32);
        Some([inside(place.x, extent.width)?, inside(place.y, extent.height)?])
    }
}
