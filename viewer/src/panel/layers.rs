//! The strip of layers at the left, with thumbnails by group.

use std::sync::Arc;

use eframe::egui::{
    Align, Align2, Color32, FontId, Rect, RichText, Role, ScrollArea, Sense, Stroke, StrokeKind, Ui, Vec2, WidgetInfo,
};

use super::status::explained;
use crate::action::Action;
use crate::layer::{Group, Layer};
use crate::view::View;

const THUMBNAIL: Vec2 = Vec2::new(56.0, 38.0);
const ROW: f32 = 42.0;

/// State of the window that the strip reads.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a> {
    /// All layers in the order of the strip; `None` if nothing is open.
    pub layers: Option<&'a [Arc<Layer>]>,
    /// Name of layer A.
    pub a: Option<&'a str>,
    /// Name of layer B.
    pub b: Option<&'a str>,
    /// View that draws the thumbnails.
    pub view: &'a View,
    /// Whether the strip has to scroll to layer A.
    pub scrolls: bool,
}

/// Shows the strip.
pub fn show(ui: &mut Ui, model: &Model) -> Vec<Action> {
    // Short contents would let the panel shrink.
    ui.set_min_width(ui.available_width());
    ui.add_space(2.0);
    let mut actions = Vec::new();
    let Some(layers) = model.layers else {
        ui.label(RichText::new("Layers").strong());
        ui.label("Nothing is open.");
        return actions;
    };
    ui.label(RichText::new("click: A, right click: B").weak());
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.spacing_mut().item_spacing.y = 1.0;
        for group in Group::ALL {
            let mut members = layers.iter().filter(|layer| layer.description.group == group).peekable();
            if members.peek().is_some() {
                ui.add_space(4.0);
                ui.label(RichText::new(group.title()).strong());
                members.for_each(|layer| row(ui, model, layer, &mut actions));
            }
        }
    });
    actions
}

fn row(ui: &mut Ui, model: &Model, layer: &Layer, actions: &mut Vec<Action>) {
    let (rect, response) = ui.allocate_exact_size(Vec2::new(ui.available_width(), ROW), Sense::click());
    let (is_a, is_b) = (model.a == Some(layer.name()), model.b == Some(layer.name()));
    let title = &layer.description.title;
    response.widget_info(|| WidgetInfo::selected(Role::Button, true, is_a, title));
    if is_a && model.scrolls {
        response.scroll_to_me(Some(Align::Center));
        actions.push(Action::ScrolledToLayer);
    }
    if response.clicked() {
        // The row is in sight already.
        actions.push(Action::ShowLayer { name: layer.name().to_owned().into(), scrolls: false });
    }
    if response.secondary_clicked() {
        actions.push(Action::SetOther((!is_b).then(|| layer.name().to_owned())));
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
    model.view.paint_thumbnail(ui.painter(), thumbnail, layer);
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
