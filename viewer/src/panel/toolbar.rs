//! The bar at the top: files, comparison, and the progress of the worker.

use eframe::egui::{Align, Layout, ProgressBar, Ui};

use crate::app::Viewer;
use crate::files::short_name;
use crate::shortcut::Action;
use crate::view::Compare;

/// Shows the bar.
pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    ui.add_space(3.0);
    ui.horizontal(|ui| {
        let mut asked = None;
        ui.menu_button("File", |ui| {
            let has_document = viewer.document.is_some();
            let mut item = |ui: &mut Ui, text: &str, action: Action, enabled: bool| {
                if ui.add_enabled(enabled, eframe::egui::Button::new(text)).clicked() {
                    asked = Some(action);
                    ui.close();
                }
            };
            item(ui, "Open…", Action::Open, true);
            item(ui, "Open reference…", Action::OpenReference, true);
            item(ui, "Load parameters…", Action::OpenParameters, true);
            ui.separator();
            let is_denoised = viewer.document.as_ref().is_some_and(|document| document.denoised.is_some());
            item(ui, "Save result…", Action::SaveResult, is_denoised);
            item(ui, "Save view…", Action::SaveView, has_document);
            item(ui, "Save layer…", Action::SaveLayer, has_document);
            item(ui, "Save parameters…", Action::SaveParameters, true);
            if !viewer.settings.recent.is_empty() {
                ui.separator();
                recent(ui, viewer);
            }
        });
        if let Some(action) = asked {
            viewer.perform(action, &ui.ctx().clone());
        }
        ui.separator();
        for compare in Compare::ALL {
            if ui
                .selectable_label(viewer.view.compare == compare, compare.title())
                .on_hover_text(compare.about())
                .clicked()
            {
                viewer.compare(compare);
            }
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            if ui.button("Help").on_hover_text("Keys (H)").clicked() {
                viewer.shows_help = !viewer.shows_help;
            }
            let context = ui.ctx().clone();
            let theme = if ui.visuals().dark_mode { "Light" } else { "Dark" };
            if ui.button(theme).on_hover_text("Dark or light (T)").clicked() {
                viewer.perform(Action::ToggleTheme, &context);
            }
            match viewer.progress {
                Some((task, share)) => {
                    if ui.button("Cancel").on_hover_text("Ends the work in flight (Esc)").clicked() {
                        viewer.perform(Action::Cancel, &context);
                    }
                    let text = format!("{} {:.0} %", task.title(), 100.0 * share);
                    ui.add(ProgressBar::new(share).desired_width(150.0).text(text));
                }
                None => {
                    if ui
                        .add_enabled(viewer.document.is_some(), eframe::egui::Button::new("Denoise"))
                        .on_hover_text("Denoises again (F5)")
                        .clicked()
                    {
                        viewer.run();
                    }
                }
            }
        });
    });
    ui.add_space(1.0);
}

/// Shows the recent files, as buttons.
pub fn recent(ui: &mut Ui, viewer: &mut Viewer) {
    let mut chosen = None;
    for source in &viewer.settings.recent {
        let input = source.name();
        let text = match &source.reference {
            Some(reference) => format!("{input} with {}", short_name(&reference.file)),
            None => input,
        };
        if ui.button(text).on_hover_text(source.lines().join("\n")).clicked() {
            chosen = Some(source.clone());
        }
    }
    if let Some(source) = chosen {
        viewer.open(source);
        ui.close();
    }
}
