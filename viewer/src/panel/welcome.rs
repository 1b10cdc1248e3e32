//! The welcome, which is shown instead of the canvas while nothing is open.

use std::path::Path;

use eframe::egui::{RichText, Ui};

use super::toolbar::recent;
use crate::action::Action;
use crate::document::Source;
use crate::files::{Purpose, short_name};

/// State of the window that the welcome reads.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a> {
    /// Whether the worker is reading a file.
    pub is_opening: bool,
    /// Reference for the file that is opened next.
    pub waiting_reference: Option<&'a Path>,
    /// Recent files, newest first.
    pub recent: &'a [Source],
}

/// Shows the welcome.
pub fn show(ui: &mut Ui, model: &Model) -> Vec<Action> {
    let mut actions = Vec::new();
    ui.vertical_centered(|ui| {
        ui.add_space(ui.available_height() * 0.28);
        if model.is_opening {
            ui.spinner();
            return;
        }
        ui.heading("Drop the files of a frame here");
        ui.label("OpenEXR, PFM or PNG: the noisy image with its halves or variance, and features;");
        ui.label("or several renders with different seeds; with them, if there is one, the reference");
        ui.add_space(10.0);
        if ui.button("Open…").clicked() {
            actions.push(Action::AskForFile(Purpose::Input));
        }
        if let Some(reference) = model.waiting_reference {
            ui.add_space(10.0);
            ui.label(format!("The reference {} waits for its frame.", short_name(reference)));
        }
        if !model.recent.is_empty() {
            ui.add_space(16.0);
            ui.label(RichText::new("Recent").strong());
            actions.extend(recent(ui, model.recent));
        }
    });
    actions
}
