//! Numbers as people read them, and numbers that are drawn into magnified pixels.

use eframe::egui::{Align2, Color32, FontId, Painter, Rect, Vec2};

use super::Camera;
use crate::layer::Layer;

/// Smallest side of an image pixel into which its values are drawn, in points.
const LEAST_SIDE: f32 = 52.0;
/// Height of a line, in points.
const LINE: f32 = 13.0;

/// Formats a number with four digits, or with all digits before the point; very small and very large numbers have an
/// exponent.
pub fn number(value: f32) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".into()
    } else if !value.is_finite() {
        value.to_string()
    } else if (0.001..100_000.0).contains(&size) {
        let digits = (3.0 - size.log10().floor()).clamp(0.0, 6.0) as usize;
        format!("{value:.digits$}")
    } else {
        format!("{value:.2e}")
    }
}

/// Formats a number with three digits, for narrow spaces.
pub fn short(value: f32) -> String {
    let size = value.abs();
    if (0.001..1000.0).contains(&size) {
        let digits = (2.0 - size.log10().floor()).clamp(0.0, 5.0) as usize;
        format!("{value:.digits$}")
    } else {
        number(value)
    }
}

/// Draws the values into pixels that are magnified enough.
pub fn paint(painter: &Painter, view: Rect, camera: &Camera, layer: &Layer) {
    let lines = layer.image().channels() as f32;
    if camera.zoom < LEAST_SIDE.max(lines * LINE + 6.0) {
        return;
    }
    let extent = layer.image().extent;
    let first = camera.to_image(view, view.min);
    let last = camera.to_image(view, view.max);
    let range = |low: f32, high: f32, size: u32| (low.max(0.0) as u32)..(high.ceil().clamp(0.0, size as f32) as u32);
    for y in range(first.y, last.y, extent.height) {
        for x in range(first.x, last.x, extent.width) {
            let Some(values) = layer.values(x, y) else { continue };
            let middle = camera.to_screen(view, Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
            for (line, value) in values.iter().enumerate() {
                let place = middle + Vec2::new(0.0, (line as f32 - (lines - 1.0) / 2.0) * LINE);
                let text = number(*value);
                // A shadow keeps the text legible on every colour.
                painter.text(
                    place + Vec2::splat(1.0),
                    Align2::CENTER_CENTER,
                    &text,
                    FontId::monospace(11.0),
                    Color32::BLACK,
                );
                painter.text(place, Align2::CENTER_CENTER, &text, FontId::monospace(11.0), Color32::WHITE);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn numbers_have_four_digits() {
        for (value, text) in [
            (0.0, "0"),
            (1.0, "1.000"),
            (-12.345_678, "-12.35"),
            (0.012_343, "0.01234"),
            (1234.5, "1234"),
            (1e-7, "1.00e-7"),
            (f32::NAN, "NaN"),
        ] {
            assert_eq!(number(value), text);
        }
    }
}
