//! The strip of layers at the left, with thumbnails by group.

use std::sync::Arc;

use eframe::egui::{
    Align, Align2, Color32, FontId, Rect, RichText, Role, ScrollArea, Sense, Stroke, StrokeKind, Ui, Vec2, WidgetInfo,
};

use super::status::explained;
use crate::app::Viewer;
use crate::layer::{Group, Layer};

const THUMBNAIL: Vec2 = Vec2::new(56.0, 38.0);
const ROW: f32 = 42.0;

/// Shows the strip.
pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    // Short contents would let the panel shrink.
    ui.set_min_width(ui.available_width());
    ui.add_space(2.0);
    let Some(document) = &viewer.document else {
        ui.label(RichText::new("Layers").strong());
        ui.label("Nothing is open.");
        return;
    };
    ui.label(RichText::new("click: A, right click: B").weak());
    let layers: Vec<Arc<Layer>> = document.layers().to_vec();
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.spacing_mut().item_spacing.y = 1.0;
        for group in Group::ALL {
            let mut members = layers.iter().filter(|layer| layer.description.group == group).peekable();
            if members.peek().is_some() {
                ui.add_space(4.0);
                ui.label(RichText::new(group.title()).strong());
                members.for_each(|layer| row(ui, viewer, layer));
            }
        }
    });
}

fn row(ui: &mut Ui, viewer: &mut Viewer, layer: &Layer) {
    let (rect, response) = ui.allocate_exact_size(Vec2::new(ui.available_width(), ROW), Sense::click());
    let is_a = viewer.layer().is_some_and(|shown| shown.name() == layer.name());
    let is_b = viewer.view.other.as_deref() == Some(layer.name());
    let title = &layer.description.title;
    response.widget_info(|| WidgetInfo::selected(Role::Button, true, is_a, title));
    if is_a && std::mem::take(&mut viewer.scrolls_to_layer) {
        response.scroll_to_me(Some(Align::Center));
    }
    if response.clicked() {
        viewer.view.layer = layer.name().to_owned();
    }
    if response.secondary_clicked() {
        viewer.view.other = (!is_b).then(|| layer.name().to_owned());
    }
    if !ui.is_rect_visible(rect) {
        return;
    }
    let visuals = ui.style().interact_selectable(&response, is_a);
    if is_a || response.hovered() {
        ui.painter().rect_filled(rect, 3.0, visuals.weak_bg_fill);
    }
    let thumbnail = Rect::from_min_size(rect.min + Vec2::new(4.0, (ROW - THUMBNAIL.y) / 2.0), THUMBNAIL);
    ui.painter().rect_filled(thumbnail, 0.0, Color32::BLACK);
    viewer.view.paint_thumbnail(ui.painter(), thumbnail, layer);
    let width = rect.right() - thumbnail.right() - 8.0 - if is_a || is_b { 18.0 } else { 0.0 };
    let text = ui.painter().layout(title.clone(), FontId::proportional(13.0), visuals.text_color(), width);
    let place = thumbnail.right_center() + Vec2::new(8.0, -text.size().y / 2.0);
    ui.painter().galley(place, text, visuals.text_color());
    for (is_marked, label, color, offset) in
        [(is_a, "A", Color32::from_rgb(60, 130, 230), -8.0), (is_b, "B", Color32::from_rgb(220, 120, 30), 8.0)]
    {
        if is_marked {
            let mark = Rect::from_center_size(rect.right_center() + Vec2::new(-12.0, offset), Vec2::splat(14.0));
            ui.painter().rect_filled(mark, 3.0, color);
            ui.painter().text(mark.center(), Align2::CENTER_CENTER, label, FontId::proportional(11.0), Color32::WHITE);
        }
    }
    if is_a {
        ui.painter().rect_stroke(
            thumbnail,
            0.0,
            Stroke::new(1.0, Color32::from_rgb(60, 130, 230)),
            StrokeKind::Outside,
        );
    }
    response.on_hover_text(explained(layer));
}
