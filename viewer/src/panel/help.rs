//! The help: every key of the table, over the window.

use eframe::egui::{Context, Grid, Id, Modal, RichText, ScrollArea, Ui};

use crate::action::Action;
use crate::shortcut::{SECTIONS, Section};

/// Number of columns.
const COLUMNS: usize = 3;

/// Shows the help.
pub fn show(context: &Context) -> Vec<Action> {
    let modal = Modal::new(Id::unique("help")).show(context, |ui| {
        ui.heading("Keys");
        ui.label(
            RichText::new(
                "Drag pans, the wheel zooms about the pointer, a double click fits. A click keeps a pixel. In the \
                 strip, a right click chooses layer B.",
            )
            .weak(),
        );
        ui.add_space(6.0);
        let screen = context.content_rect();
        ui.set_width((screen.width() - 80.0).min(1120.0));
        ScrollArea::vertical().max_height(screen.height() - 150.0).show(ui, |ui| {
            ui.columns(COLUMNS, |columns| {
                let lines =
                    |sections: &[Section]| sections.iter().map(|section| section.shortcuts.len()).sum::<usize>();
                for (index, part) in SECTIONS.iter().enumerate() {
                    let before = lines(&SECTIONS[..index]) + part.shortcuts.len() / 2;
                    section(&mut columns[before * COLUMNS / lines(SECTIONS)], part);
                }
            });
        });
        ui.button("Close").clicked()
    });
    if modal.inner || modal.backdrop_response.clicked() { vec![Action::ToggleHelp] } else { Vec::new() }
}

fn section(ui: &mut Ui, section: &Section) {
    ui.label(RichText::new(section.title).strong());
    let context = ui.ctx().clone();
    ui.spacing_mut().interact_size.y = 15.0;
    Grid::new(section.title).num_columns(2).min_row_height(15.0).spacing([12.0, 2.0]).show(ui, |ui| {
        for shortcut in section.shortcuts.iter().filter(|shortcut| !shortcut.about.is_empty()) {
            let keys = section.shortcuts.iter().filter(|other| other.action == shortcut.action);
            let keys: Vec<_> = keys.map(|other| context.format_shortcut(&other.keys)).collect();
            ui.label(RichText::new(keys.join(", ")).monospace());
            ui.label(shortcut.about);
            ui.end_row();
        }
    });
    ui.add_space(6.0);
}
