//! All values of the chosen pixel: the pixel that was clicked, or else the pixel under the pointer.

use eframe::egui::{Grid, RichText, Ui};

use super::status::explained;
use crate::action::Action;
use crate::document::Document;
use crate::layer::Group;
use crate::view::View;
use crate::view::numbers::number;

/// Shows the panel. A click on a title shows that layer.
pub fn show(ui: &mut Ui, document: Option<&Document>, view: &View) -> Vec<Action> {
    let (Some(document), Some([x, y])) = (document, view.chosen()) else {
        ui.label("Point at a pixel to see its values in every layer. Click to keep it.");
        return Vec::new();
    };
    let how =
        if view.pinned.is_some() { "kept; click it again to let it go" } else { "under the pointer; click to keep it" };
    ui.label(RichText::new(format!("Pixel ({x}, {y})")).strong());
    ui.label(RichText::new(how).weak());
    let mut actions = Vec::new();
    for group in Group::ALL {
        let members: Vec<_> = document.layers().iter().filter(|layer| layer.description.group == group).collect();
        if members.is_empty() {
            continue;
        }
        ui.add_space(4.0);
        ui.label(RichText::new(group.title()).strong());
        Grid::new(group.title()).num_columns(4).striped(true).spacing([6.0, 1.0]).show(ui, |ui| {
            for layer in members {
                let Some(values) = layer.values(x, y) else { continue };
                let is_shown = layer.name() == view.layer;
                if ui
                    .selectable_label(is_shown, RichText::new(&layer.description.title).size(11.5))
                    .on_hover_text(explained(layer))
                    .clicked()
                {
                    actions.push(Action::ShowLayer { name: layer.name().to_owned().into(), scrolls: false });
                }
                for value in values {
                    ui.label(RichText::new(number(value)).monospace().size(10.5));
                }
                ui.end_row();
            }
        });
    }
    actions
}
