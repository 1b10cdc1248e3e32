//! The line at the bottom: the pixel under the pointer, the magnification, and time and error of the newest run.

use eframe::egui::{Align, Layout, RichText, Ui};

use crate::app::Viewer;
use crate::layer::Layer;
use crate::view::numbers::number;

/// Shows the line.
pub fn show(ui: &mut Ui, viewer: &Viewer) {
    ui.horizontal(|ui| {
        if let Some((Ok(notice), _)) = &viewer.notice {
            ui.label(RichText::new(notice).strong());
            ui.separator();
        }
        let Some(document) = &viewer.document else {
            ui.label(format!("{}, {}", viewer.gpu.summary().name, viewer.gpu.summary().backend));
            return;
        };
        match viewer.view.hovered {
            Some([x, y]) => {
                ui.label(RichText::new(format!("({x}, {y})")).monospace());
                let layers = [Some(("A", viewer.layer())), viewer.view.other.as_ref().map(|_| ("B", viewer.other()))];
                for (label, layer) in layers.into_iter().flatten() {
                    if let Some(values) = layer.and_then(|layer| layer.values(x, y)) {
                        ui.label(RichText::new(format!("{label} {}", joined(&values))).monospace());
                    }
                }
            }
            None => {
                let extent = document.opened.frame.extent();
                ui.label(format!("{} pixels", extent));
            }
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            ui.label(format!("{:.0} %", 100.0 * viewer.view.camera.zoom * ui.ctx().pixels_per_point()));
            if let Some(denoised) = &document.denoised {
                ui.separator();
                let error = denoised.error.zip(document.opened.noisy_error);
                let error = error
                    .map_or_else(String::new, |(error, noisy)| format!(", relative MSE {error:.5} (noisy {noisy:.5})"));
                ui.label(format!("{} in {:.2} s{error}", denoised.parameters.method.name(), denoised.seconds));
            }
        });
    });
}

/// Formats values with blanks between them.
pub fn joined(values: &[f32]) -> String {
    values.iter().map(|value| number(*value)).collect::<Vec<_>>().join(" ")
}

/// Returns the explanation and the name of a layer in two lines, for tooltips.
pub fn explained(layer: &Layer) -> String {
    format!("{}\n{}", layer.description.about, layer.name())
}
