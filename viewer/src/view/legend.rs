//! The legend in a corner of the canvas, which shows what the colours mean.

use eframe::egui::{Align2, Color32, FontId, Painter, Pos2, Rect, Shape, Stroke, StrokeKind, Vec2, epaint::Mesh};

use super::colormap::Colormap;
use super::numbers::number;
use crate::layer::{Range, Scale};

const SIZE: Vec2 = Vec2::new(180.0, 12.0);
const MARGIN: f32 = 8.0;
const FONT: f32 = 11.0;
/// Number of rectangles that make up a scale.
const STEPS: usize = 64;
/// Colour behind the text, which keeps it legible on every image.
const BACKDROP: Color32 = Color32::from_black_alpha(190);

/// Returns the value at `share`, 0 to 1, of the way along a scale.
pub fn value_at(range: Range, scale: Scale, share: f32) -> f32 {
    match scale {
        Scale::Log => range.low * (range.high / range.low).powf(share),
        Scale::Linear | Scale::Diverging => range.low + (range.high - range.low) * share,
    }
}

/// Draws the title and the colours of a scale, with values at its ends and in its middle.
pub fn scale(painter: &Painter, view: Rect, title: &str, range: Range, scale: Scale, colormap: Colormap) {
    let inner = Rect::from_min_size(view.max - SIZE - Vec2::new(2.0 * MARGIN, MARGIN + 22.0), SIZE);
    painter.rect_filled(
        Rect::from_min_max(inner.min - Vec2::new(MARGIN, 22.0), inner.max + Vec2::new(MARGIN, 18.0)),
        4.0,
        BACKDROP,
    );
    painter.text(
        inner.left_top() - Vec2::new(0.0, 4.0),
        Align2::LEFT_BOTTOM,
        title,
        FontId::proportional(FONT + 1.0),
        Color32::WHITE,
    );
    bar(painter, inner, (range, scale), colormap, Color32::WHITE);
}

/// Draws the colours of a scale in a rectangle, and values under it in the colour `text`.
pub fn bar(painter: &Painter, inner: Rect, (range, scale): (Range, Scale), colormap: Colormap, text: Color32) {
    let mut mesh = Mesh::default();
    for step in 0..=STEPS {
        let share = step as f32 / STEPS as f32;
        let [r, g, b] = colormap.color(share).map(|channel| (channel * 255.0).round() as u8);
        let x = inner.left() + inner.width() * share;
        mesh.colored_vertex(Pos2::new(x, inner.top()), Color32::from_rgb(r, g, b));
        mesh.colored_vertex(Pos2::new(x, inner.bottom()), Color32::from_rgb(r, g, b));
        if step > 0 {
            let last = 2 * step as u32;
            mesh.add_triangle(last - 2, last - 1, last);
            mesh.add_triangle(last - 1, last, last + 1);
        }
    }
    painter.add(Shape::mesh(mesh));
    painter.rect_stroke(inner, 0.0, Stroke::new(1.0, Color32::GRAY), StrokeKind::Outside);
    for (share, align) in [(0.0, Align2::LEFT_TOP), (0.5, Align2::CENTER_TOP), (1.0, Align2::RIGHT_TOP)] {
        let place = Pos2::new(inner.left() + inner.width() * share, inner.bottom() + 3.0);
        painter.text(place, align, number(value_at(range, scale, share)), FontId::monospace(FONT), text);
    }
}

/// Draws which colour belongs to which candidate.
pub fn shares(painter: &Painter, view: Rect) {
    let names = [("FIRST", 0.0, Color32::RED), ("SECOND", 58.0, Color32::GREEN), ("THIRD", 130.0, Color32::BLUE)];
    let inner =
        Rect::from_min_size(view.max - Vec2::new(SIZE.x + 2.0 * MARGIN, 20.0 + MARGIN), Vec2::new(SIZE.x, 14.0));
    painter.rect_filled(inner.expand2(Vec2::new(MARGIN, 4.0)), 4.0, BACKDROP);
    for (name, place, color) in names {
        let left = inner.left_center() + Vec2::new(place, 0.0);
        painter.rect_filled(Rect::from_center_size(left + Vec2::new(4.0, 0.0), Vec2::splat(8.0)), 1.0, color);
        painter.text(
            left + Vec2::new(11.0, 0.0),
            Align2::LEFT_CENTER,
            name,
            FontId::proportional(FONT),
            Color32::WHITE,
        );
    }
}
