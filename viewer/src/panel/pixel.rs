//! All values of the chosen pixel: the pixel that was clicked, or else the pixel under the pointer.

use eframe::egui::{Button, Grid, RichText, Ui};

use super::status::explained;
use crate::action::Action;
use crate::document::Document;
use crate::layer::Group;
use crate::view::View;
use crate::view::numbers::number;

/// Space for a value, in points. Long titles are wrapped so that three values fit beside them.
const VALUE_WIDTH: f32 = 52.0;
/// Space between columns, in points.
const GAP: f32 = 6.0;

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
        let title_width = ui.available_width() - 3.0 * (VALUE_WIDTH + GAP);
        let grid = Grid::new(group.title()).num_columns(4).max_col_width(title_width).striped(true).spacing([GAP, 1.0]);
        grid.show(ui, |ui| {
            for layer in members {
                let Some(values) = layer.values(x, y) else { continue };
                let is_shown = layer.name() == view.layer;
                let title = Button::selectable(is_shown, RichText::new(&layer.description.title).size(11.5)).wrap();
                if ui.add(title).on_hover_text(explained(layer)).clicked() {
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
