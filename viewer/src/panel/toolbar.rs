//! The bar at the top: files, comparison, and the progress of the worker.

use eframe::egui::{Align, ComboBox, Layout, ProgressBar, Ui};

use crate::action::Action;
use crate::document::{InputFiles, Source, picture_title};
use crate::files::{Purpose, short_name};
use crate::view::Compare;
use crate::worker::Task;

/// State of the window that the bar reads.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a> {
    /// Whether a frame is open.
    pub has_document: bool,
    /// Whether the open frame was denoised.
    pub is_denoised: bool,
    /// Recent files, newest first.
    pub recent: &'a [Source],
    /// Comparison of the two layers.
    pub compare: Compare,
    /// Task of the worker, and the share of it that is done, 0 to 1.
    pub progress: Option<(Task, f32)>,
    /// Files of the open frame; `None` for a frame that was rendered here.
    pub input: Option<&'a InputFiles>,
}

/// Shows the bar.
pub fn show(ui: &mut Ui, model: &Model) -> Vec<Action> {
    let mut actions = Vec::new();
    ui.add_space(3.0);
    ui.horizontal(|ui| {
        ui.menu_button("File", |ui| {
            let mut item = |ui: &mut Ui, text: &str, purpose: Purpose, enabled: bool| {
                if ui.add_enabled(enabled, eframe::egui::Button::new(text)).clicked() {
                    actions.push(Action::AskForFile(purpose));
                    ui.close();
                }
            };
            item(ui, "Open…", Purpose::Input, true);
            item(ui, "Open reference…", Purpose::Reference, true);
            item(ui, "Load parameters…", Purpose::Parameters, true);
            ui.separator();
            item(ui, "Save result…", Purpose::SaveResult, model.is_denoised);
            item(ui, "Save view…", Purpose::SaveView, model.has_document);
            item(ui, "Save layer…", Purpose::SaveLayer, model.has_document);
            item(ui, "Save parameters…", Purpose::SaveParameters, true);
            if !model.recent.is_empty() {
                ui.separator();
                actions.extend(recent(ui, model.recent));
            }
        });
        ui.separator();
        for compare in Compare::ALL {
            if ui.selectable_label(model.compare == compare, compare.title()).on_hover_text(compare.about()).clicked() {
                actions.push(Action::Compare(compare));
            }
        }
        if let Some(input) = model.input.filter(|input| input.pictures.len() > 1) {
            ui.separator();
            actions.extend(pictures(ui, input));
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            if ui.button("Help").on_hover_text("Keys (H)").clicked() {
                actions.push(Action::ToggleHelp);
            }
            let theme = if ui.visuals().dark_mode { "Light" } else { "Dark" };
            if ui.button(theme).on_hover_text("Dark or light (T)").clicked() {
                actions.push(Action::ToggleTheme);
            }
            match model.progress {
                Some((task, share)) => {
                    if ui.button("Cancel").on_hover_text("Ends the work in flight (Esc)").clicked() {
                        actions.push(Action::Cancel);
                    }
                    let text = format!("{} {:.0} %", task.title(), 100.0 * share);
                    ui.add(ProgressBar::new(share).desired_width(150.0).text(text));
                }
                None => {
                    if ui
                        .add_enabled(model.has_document, eframe::egui::Button::new("Denoise"))
                        .on_hover_text("Denoises again (F5)")
                        .clicked()
                    {
                        actions.push(Action::Run);
                    }
                }
            }
        });
    });
    ui.add_space(1.0);
    actions
}

/// Shows the choice among the pictures of the input.
fn pictures(ui: &mut Ui, input: &InputFiles) -> Option<Action> {
    let mut chosen = input.picture;
    ComboBox::from_id_salt("picture")
        .selected_text(picture_title(&input.pictures[input.picture]))
        .show_ui(ui, |ui| {
            for (index, name) in input.pictures.iter().enumerate() {
                ui.selectable_value(&mut chosen, index, picture_title(name));
            }
        })
        .response
        .on_hover_text("The picture of the file that is open: a view layer, or the view of an eye (P)");
    (chosen != input.picture).then_some(Action::ShowPicture(chosen))
}

/// Shows the recent files, as buttons.
pub fn recent(ui: &mut Ui, sources: &[Source]) -> Option<Action> {
    let mut chosen = None;
    for source in sources {
        let input = match source.request.seeds.len() {
            0 => source.name(),
            1 => format!("{} and another seed", source.name()),
            seeds => format!("{} and {seeds} other seeds", source.name()),
        };
        let text = match &source.reference {
            Some(reference) => format!("{input} with {}", short_name(&reference.file)),
            None => input,
        };
        if ui.button(text).on_hover_text(source.lines().join("\n")).clicked() {
            chosen = Some(Action::Open(Box::new(source.clone())));
            ui.close();
        }
    }
    chosen
}
