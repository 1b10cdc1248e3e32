//! The message about a failure, with its remedy, over the canvas.

use eframe::egui::{Align, Frame as Margins, Layout, RichText, Ui};

use crate::action::Action;

/// Shows the text of an error, which [`told`](crate::words::told) makes.
pub fn show(ui: &mut Ui, told: &str) -> Option<Action> {
    let (problem, remedy) = told.split_once("\n  remedy: ").unwrap_or((told, ""));
    let mut action = None;
    Margins::new().fill(ui.visuals().extreme_bg_color).inner_margin(8.0).show(ui, |ui| {
        ui.horizontal_top(|ui| {
            ui.with_layout(Layout::right_to_left(Align::TOP), |ui| {
                if ui.button("Dismiss").clicked() {
                    action = Some(Action::Dismiss);
                }
                ui.with_layout(Layout::top_down(Align::LEFT), |ui| {
                    ui.label(RichText::new(problem).color(ui.visuals().error_fg_color));
                    if !remedy.is_empty() {
                        ui.label(format!("Remedy: {remedy}"));
                    }
                });
            });
        });
    });
    action
}
