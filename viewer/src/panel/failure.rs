//! The message about a failure, with its remedy, over the canvas, and the question for what was missing.

use eframe::egui::{Align, Button, Frame as Margins, Id, Key, Layout, RichText, TextEdit, Ui};

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

/// Asks for the number of samples per pixel of files that do not tell it.
pub fn ask_for_samples(ui: &mut Ui) -> Option<Action> {
    let mut action = None;
    Margins::new().fill(ui.visuals().panel_fill).inner_margin(8.0).show(ui, |ui| {
        ui.horizontal(|ui| {
            let id = Id::unique("samples per pixel");
            let mut text = ui.data_mut(|data| data.get_temp::<String>(id)).unwrap_or_default();
            let label = ui.label("Samples per pixel:");
            let edit = ui.add(TextEdit::singleline(&mut text).desired_width(60.0)).labelled_by(label.id);
            let samples = text.trim().parse().ok().filter(|samples| *samples > 0);
            let is_entered = edit.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
            let is_clicked = ui.add_enabled(samples.is_some(), Button::new("Open with these")).clicked();
            action = samples.filter(|_| is_entered || is_clicked).map(Action::OpenWithSamples);
            // The next file has another number.
            let kept = if action.is_some() { String::new() } else { text };
            ui.data_mut(|data| data.insert_temp(id, kept));
        });
        ui.set_min_width(ui.available_width());
    });
    action
}
