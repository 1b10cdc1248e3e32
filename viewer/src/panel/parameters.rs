//! How is denoised: method, preset, radius. A change starts a run, and ends the one in flight.

use eframe::egui::{ComboBox, Label, Slider, Ui};
use stein::Preset;

use crate::app::Viewer;
use crate::settings::Parameters;

/// The largest radius that a slider offers, in pixels.
const LARGEST_RADIUS: u32 = 32;

/// Shows it.
pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    let before = viewer.parameters;
    let parameters = &mut viewer.parameters;
    let mut method = parameters.method.name();
    ui.horizontal(|ui| {
        let label = ui.add_sized([72.0, 18.0], Label::new("method"));
        let menu = ComboBox::from_id_salt("method").selected_text(method).show_ui(ui, |ui| {
            for name in Parameters::METHODS {
                ui.selectable_value(&mut method, name, name);
            }
        });
        menu.response.labelled_by(label.id);
    });
    ui.horizontal(|ui| {
        ui.add_sized([72.0, 18.0], Label::new("preset"));
        for (preset, title) in [(Preset::Default, "default"), (Preset::Thesis, "thesis")] {
            ui.selectable_value(&mut parameters.preset, preset, title);
        }
    });
    if method != before.method.name() || parameters.preset != before.preset {
        *parameters = Parameters::of(method, parameters.preset).unwrap_or(before);
    }
    if let Some(radius) = parameters.radius_mut() {
        ui.horizontal(|ui| {
            let label = ui.add_sized([72.0, 18.0], Label::new("radius"));
            ui.add(Slider::new(radius, 1..=LARGEST_RADIUS).suffix(" px"))
                .labelled_by(label.id)
                .on_hover_text("Radius of the window that a pixel is averaged over, in pixels; work grows with its square");
        });
    }
    ui.add_space(6.0);
    if ui.button("Reset").on_hover_text("The parameters of the preset").clicked() {
        *parameters = parameters.reset();
    }
    if *parameters != before {
        viewer.run();
    }
}
