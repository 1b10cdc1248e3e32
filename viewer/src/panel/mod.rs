//! The panels beside the canvas, one file each.

pub mod display;
pub mod help;
pub mod kernel;
pub mod layers;
pub mod parameters;
pub mod pixel;
pub mod plot;
pub mod report;
pub mod sampling;
pub mod status;
pub mod toolbar;

use eframe::egui::{RichText, ScrollArea, Ui};

use crate::app::Viewer;

/// Size of the tabs' text, in points.
const TAB_SIZE: f32 = 11.0;

/// The panels at the right, of which one is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Panel {
    /// Exposure, ranges, histogram.
    #[default]
    Display,
    /// Method, preset, and every parameter.
    Parameters,
    /// The values of a pixel.
    Pixel,
    /// Which neighbours made a pixel, and why.
    Kernel,
    /// Steps that ran or were left out, and the properties of the frame.
    Report,
    /// Error against run time.
    Plot,
    /// The adaptive loop on a built-in scene.
    Sampling,
}

impl Panel {
    /// All panels, in the order of their tabs.
    pub const ALL: [Self; 7] =
        [Self::Display, Self::Parameters, Self::Pixel, Self::Kernel, Self::Report, Self::Plot, Self::Sampling];

    /// Returns the title that users read.
    pub fn title(self) -> &'static str {
        match self {
            Self::Display => "Display",
            Self::Parameters => "Parameters",
            Self::Pixel => "Pixel",
            Self::Kernel => "Kernel",
            Self::Report => "Report",
            Self::Plot => "Plot",
            Self::Sampling => "Sampling",
        }
    }
}

/// Shows the tabs, and the panel that is chosen.
pub fn show(ui: &mut Ui, viewer: &mut Viewer) {
    // Short contents would let the panel shrink.
    ui.set_min_width(ui.available_width());
    ui.add_space(2.0);
    ui.horizontal_wrapped(|ui| {
        // The tabs fit into one line while the panel has its initial width.
        (ui.spacing_mut().item_spacing.x, ui.spacing_mut().button_padding.x) = (1.0, 3.0);
        for panel in Panel::ALL {
            ui.selectable_value(&mut viewer.panel, panel, RichText::new(panel.title()).size(TAB_SIZE));
        }
    });
    ui.separator();
    // Scrolls in both directions: contents that are too wide would widen the panel and move the image.
    ScrollArea::both().id_salt(viewer.panel.title()).auto_shrink(false).show(ui, |ui| match viewer.panel {
        Panel::Display => display::show(ui, viewer),
        Panel::Parameters => parameters::show(ui, viewer),
        Panel::Pixel => pixel::show(ui, viewer),
        Panel::Kernel => kernel::show(ui, viewer),
        Panel::Report => report::show(ui, viewer),
        Panel::Plot => plot::show(ui, viewer),
        Panel::Sampling => sampling::show(ui, viewer),
    });
}
