//! The line at the bottom: the pixel under the pointer, the magnification, and time and error of the newest run.

use eframe::egui::{Align, Layout, RichText, Ui};
use stein::gpu::AdapterSummary;

use crate::document::Document;
use crate::layer::Layer;
use crate::view::numbers::number;

/// State of the window that the line reads.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a> {
    /// Device of the denoiser and the window.
    pub device: &'a AdapterSummary,
    /// Newest message about files.
    pub notice: Option<&'a str>,
    /// The open frame with its runs.
    pub document: Option<&'a Document>,
    /// Layer A.
    pub a: Option<&'a Layer>,
    /// Layer B.
    pub b: Option<&'a Layer>,
    /// Pixel under the pointer, [column, row].
    pub hovered: Option<[u32; 2]>,
    /// Points on the screen per pixel of the image.
    pub zoom: f32,
}

/// Shows the line.
pub fn show(ui: &mut Ui, model: &Model) {
    ui.horizontal(|ui| {
        if let Some(notice) = model.notice {
            ui.label(RichText::new(notice).strong());
            ui.separator();
        }
        let Some(document) = model.document else {
            ui.label(format!("{}, {}", model.device.name, model.device.backend));
            return;
        };
        match model.hovered {
            Some([x, y]) => {
                ui.label(RichText::new(format!("({x}, {y})")).monospace());
                for (label, layer) in [("A", model.a), ("B", model.b)] {
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
            ui.label(format!("{:.0} %", 100.0 * model.zoom * ui.ctx().pixels_per_point()));
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
