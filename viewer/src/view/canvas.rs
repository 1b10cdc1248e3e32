//! The canvas: one or two layers with pan and zoom, and the marks that are drawn over them.

use eframe::egui::{
    Align2, Color32, CursorIcon, FontId, Id, Painter, Pos2, Rect, Response, Role, Sense, Stroke, StrokeKind, Ui, Vec2,
    WidgetInfo,
};

use super::display::{Draw, Operation};
use super::{Camera, Compare, Marked, View, legend, numbers};
use crate::layer::{Kind, Layer, Range, Scale};
use crate::view::colormap::Colormap;

/// Space between two views that are side by side, in points.
const GAP: f32 = 2.0;
/// Distance from the line of a wipe within which a drag moves the line, in points.
const GRIP: f32 = 6.0;
/// Time for which a layer shows while blinking, in seconds.
const BLINK_SECONDS: f64 = 0.6;
/// Smallest magnification at which the pixel under the pointer is framed, in points per pixel.
const FRAMED_ZOOM: f32 = 4.0;

/// Colour of the frame around the neighbour whose distances are shown.
pub const NEIGHBOUR: Color32 = Color32::from_rgb(80, 230, 255);

/// One part of the canvas.
#[derive(Clone, Copy)]
struct Part<'a> {
    /// Rectangle to which the camera maps the image.
    view: Rect,
    /// Part of the rectangle that is visible.
    clip: Rect,
    layer: &'a Layer,
    /// Layer whose false-colour scale is used.
    scaled_as: &'a Layer,
    /// Layer that is subtracted.
    minus: Option<&'a Layer>,
    label: &'static str,
}

/// Shows the layers in the space that is left.
pub fn show(ui: &mut Ui, view: &mut View, a: &Layer, b: Option<&Layer>) -> Response {
    let (rect, response) = ui.allocate_exact_size(ui.available_size().max(Vec2::splat(1.0)), Sense::click_and_drag());
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, format!("image: {}", a.description.title)));
    let compare = if b.is_some() { view.compare } else { Compare::Single };
    let parts = parts(ui, rect, view, compare, a, b);
    let extent = a.image().extent;
    view.camera.settle(parts[0].view, extent);
    reveal(view, parts[0].view);
    navigate(ui, &response, view, &parts);
    if compare == Compare::Wipe {
        drag_line(ui, rect, view);
    }

    let pointer = response.hover_pos();
    let under_pointer = |part: &Part| pointer.filter(|position| part.clip.contains(*position));
    view.hovered = parts.iter().find_map(|part| view.camera.pixel(part.view, extent, under_pointer(part)?));
    if response.clicked() {
        view.pinned = if view.pinned == view.hovered { None } else { view.hovered };
    }

    for part in &parts {
        let painter = ui.painter().with_clip_rect(part.clip);
        paint_part(ui, &painter, view, part);
    }
    if compare == Compare::Wipe {
        let x = rect.left() + rect.width() * view.wipe;
        ui.painter().vline(x, rect.y_range(), Stroke::new(2.0, Color32::WHITE));
        ui.painter().vline(x, rect.y_range(), Stroke::new(1.0, Color32::BLACK));
    }
    response
}

fn parts<'a>(ui: &Ui, rect: Rect, view: &View, compare: Compare, a: &'a Layer, b: Option<&'a Layer>) -> Vec<Part<'a>> {
    let Some(b) = b else {
        return vec![Part { view: rect, clip: rect, layer: a, scaled_as: a, minus: None, label: "" }];
    };
    let is_number = |layer: &Layer| matches!(layer.description.kind, Kind::Scalar(_));
    let shares_scale = view.display.shares_scale && is_number(a) && is_number(b);
    let whole = |layer, label| Part {
        view: rect,
        clip: rect,
        layer,
        scaled_as: if shares_scale { a } else { layer },
        minus: None,
        label,
    };
    match compare {
        Compare::Single => vec![whole(a, "")],
        Compare::SideBySide => {
            let middle = rect.center().x;
            let left = Rect::from_min_max(rect.min, Pos2::new(middle - GAP / 2.0, rect.max.y));
            let right = Rect::from_min_max(Pos2::new(middle + GAP / 2.0, rect.min.y), rect.max);
            vec![Part { view: left, clip: left, ..whole(a, "A") }, Part { view: right, clip: right, ..whole(b, "B") }]
        }
        Compare::Wipe => {
            let line = rect.left() + rect.width() * view.wipe;
            let left = Rect::from_min_max(rect.min, Pos2::new(line, rect.max.y));
            let right = Rect::from_min_max(Pos2::new(line, rect.min.y), rect.max);
            vec![Part { clip: left, ..whole(a, "A") }, Part { clip: right, ..whole(b, "B") }]
        }
        Compare::Blink => {
            ui.ctx().request_repaint_after_secs(BLINK_SECONDS as f32 / 4.0);
            let shows_b = (ui.input(|input| input.time) / BLINK_SECONDS) as u64 % 2 == 1;
            vec![if shows_b { whole(b, "B") } else { whole(a, "A") }]
        }
        Compare::Difference | Compare::Relative => vec![Part { minus: Some(b), ..whole(a, "A − B") }],
    }
}

/// Moves the camera to the pinned pixel, if a key has moved that pixel out of sight.
fn reveal(view: &mut View, rect: Rect) {
    let Some([x, y]) = view.pinned.filter(|_| std::mem::take(&mut view.reveals_pinned)) else { return };
    let place = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
    if !rect.contains(view.camera.to_screen(rect, place)) {
        (view.camera.centre, view.camera.fits) = (place, false);
    }
}

fn navigate(ui: &Ui, response: &Response, view: &mut View, parts: &[Part]) {
    if response.double_clicked() {
        view.camera.fits = true;
        view.pinned = None;
    }
    if response.dragged() {
        view.camera.drag(response.drag_delta());
        ui.ctx().set_cursor_icon(CursorIcon::Grabbing);
    }
    let Some(position) = response.hover_pos() else { return };
    let part = parts.iter().find(|part| part.clip.contains(position)).unwrap_or(&parts[0]);
    let (scrolled, pinched) = ui.input(|input| (input.smooth_scroll_delta().y, input.zoom_delta()));
    let factor = pinched * (scrolled / 200.0).exp();
    if factor != 1.0 {
        view.camera.zoom_about(part.view, position, factor);
    }
}

fn drag_line(ui: &Ui, rect: Rect, view: &mut View) {
    let x = rect.left() + rect.width() * view.wipe;
    let grip = Rect::from_min_max(Pos2::new(x - GRIP, rect.top()), Pos2::new(x + GRIP, rect.bottom()));
    let response =
        ui.interact(grip, Id::unique("wipe line"), Sense::drag()).on_hover_cursor(CursorIcon::ResizeHorizontal);
    response.widget_info(|| WidgetInfo::slider(true, f64::from(view.wipe), "wipe line"));
    if response.dragged() {
        view.wipe = ((x + response.drag_delta().x - rect.left()) / rect.width()).clamp(0.0, 1.0);
    }
}

fn paint_part(ui: &Ui, painter: &Painter, view: &mut View, part: &Part) {
    let difference = part.minus.map(|minus| view.difference_range(part.layer, minus));
    let draw = draw(view, part, difference, ui.visuals().dark_mode, ui.ctx().pixels_per_point());
    let (range, scale) = (draw.range, draw.scale);
    painter.add(view.slots.paint(painter.clip_rect(), draw));
    if difference.is_none() {
        numbers::paint(painter, part.view, &view.camera, part.layer);
    }
    frame_pixels(painter, part.view, view);
    mark_window(painter, part.view, view);
    if !part.label.is_empty() {
        label(painter, part);
    }
    let description = &part.layer.description;
    match description.kind {
        _ if difference.is_some() => {
            let title = if view.compare == Compare::Relative { "(A − B)/(|B| + 0.01)" } else { "A − B" };
            legend::scale(painter, part.clip, title, range, Scale::Diverging, Colormap::Diverging);
        }
        Kind::Scalar(_) => {
            let colormap = if scale == Scale::Diverging { Colormap::Diverging } else { view.display.colormap };
            legend::scale(painter, part.clip, &titled(&description.title, description.unit), range, scale, colormap);
        }
        Kind::Shares => legend::shares(painter, part.clip),
        Kind::Color | Kind::Direction => {}
    }
}

/// Returns a title with the unit in brackets, if there is a unit.
pub fn titled(title: &str, unit: &str) -> String {
    if unit.is_empty() { title.to_owned() } else { format!("{title} [{unit}]") }
}

fn draw(view: &View, part: &Part, difference: Option<Range>, dark: bool, pixels_per_point: f32) -> Draw {
    let Camera { centre, zoom, .. } = view.camera;
    let first = centre - part.view.center().to_vec2() / zoom;
    let step = 1.0 / (zoom * pixels_per_point);
    let scale = view.display.scale_of(part.scaled_as);
    let on_scale = view.draw_on(part.layer.shown.clone(), part.layer.description.kind, scale, first.into(), step);
    let draw = Draw { background: if dark { [0.09; 3] } else { [0.72; 3] }, ..on_scale };
    match (part.minus, difference) {
        (Some(minus), Some(range)) => {
            let operation = if view.compare == Compare::Relative { Operation::Relative } else { Operation::Difference };
            Draw { b: Some(minus.shown.clone()), operation, range, scale: Scale::Diverging, ..draw }
        }
        _ => draw,
    }
}

fn frame_pixels(painter: &Painter, rect: Rect, view: &View) {
    let framed = |[x, y]: [u32; 2], color: Color32| {
        let corner = view.camera.to_screen(rect, Vec2::new(x as f32, y as f32));
        let pixel = Rect::from_min_size(corner, Vec2::splat(view.camera.zoom.max(3.0)));
        outline(painter, pixel, color);
    };
    if let Some(hovered) = view.hovered.filter(|_| view.camera.zoom >= FRAMED_ZOOM) {
        framed(hovered, Color32::WHITE);
    }
    if let Some(pinned) = view.pinned {
        framed(pinned, Color32::YELLOW);
    }
}

/// Outlines the window around a pixel, and in it the neighbour that is explained.
fn mark_window(painter: &Painter, rect: Rect, view: &View) {
    let Some(Marked { pixel: [x, y], radius, neighbour }) = view.marked else { return };
    let place = |x: f32, y: f32| view.camera.to_screen(rect, Vec2::new(x, y));
    let (x, y, radius) = (x as f32, y as f32, radius as f32);
    let window = Rect::from_min_max(place(x - radius, y - radius), place(x + radius + 1.0, y + radius + 1.0));
    outline(painter, window, Color32::YELLOW);
    if let Some([x, y]) = neighbour {
        let corner = place(x as f32, y as f32);
        outline(painter, Rect::from_min_size(corner, Vec2::splat(view.camera.zoom.max(3.0))), NEIGHBOUR);
    }
}

/// Draws an outline in two colours, so that it is visible on every image.
pub fn outline(painter: &Painter, rect: Rect, color: Color32) {
    painter.rect_stroke(rect.expand(1.0), 0.0, Stroke::new(1.0, Color32::BLACK), StrokeKind::Outside);
    painter.rect_stroke(rect, 0.0, Stroke::new(1.0, color), StrokeKind::Outside);
}

fn label(painter: &Painter, part: &Part) {
    let (place, align) = match part.label {
        "B" if part.clip != part.view => (part.clip.right_top() + Vec2::new(-10.0, 8.0), Align2::RIGHT_TOP),
        _ => (part.clip.left_top() + Vec2::new(10.0, 8.0), Align2::LEFT_TOP),
    };
    let text = match part.minus {
        Some(minus) => format!("{} − {}", part.layer.description.title, minus.description.title),
        None => format!("{}: {}", part.label, part.layer.description.title),
    };
    let galley = painter.layout_no_wrap(text, FontId::proportional(13.0), Color32::WHITE);
    let rect = align.anchor_size(place, galley.size());
    painter.rect_filled(rect.expand2(Vec2::new(6.0, 3.0)), 4.0, Color32::from_black_alpha(190));
    painter.galley(rect.min, galley, Color32::WHITE);
}
