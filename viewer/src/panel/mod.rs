//! The panels beside the canvas, one file each. A panel reads a view model, which the window makes of its state for
//! each frame, and returns actions; it changes nothing itself.

pub mod display;
pub mod failure;
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
pub mod welcome;

use eframe::egui::{RichText, ScrollArea, Ui};

use crate::action::Action;
use crate::adaptive::Adaptive;
use crate::document::Document;
use crate::edit::Edits;
use crate::inspector::Inspector;
use crate::layer::Layer;
use crate::settings::Parameters;
use crate::sweep::Sweep;
use crate::view::View;

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

/// State of the window that the panels at the right read.
#[derive(Clone, Copy, Debug)]
pub struct Model<'a> {
    /// The panel that is shown.
    pub panel: Panel,
    /// The open frame with its runs and layers.
    pub document: Option<&'a Document>,
    /// Layer A.
    pub layer: Option<&'a Layer>,
    /// Layers that are shown, and how they are shown.
    pub view: &'a View,
    /// Method and parameters.
    pub parameters: Parameters,
    /// Changes that wait because they contradict other parameters.
    pub edits: &'a Edits,
    /// Error against run time.
    pub sweep: &'a Sweep,
    /// The adaptive loop.
    pub adaptive: &'a Adaptive,
    /// Which neighbours made a pixel.
    pub inspector: &'a Inspector,
}

/// Shows the tabs, and the panel that is chosen.
pub fn show(ui: &mut Ui, model: &Model) -> Vec<Action> {
    // Short contents would let the panel shrink.
    ui.set_min_width(ui.available_width());
    ui.add_space(2.0);
    let mut panel = model.panel;
    ui.horizontal_wrapped(|ui| {
        // The tabs fit into one line while the panel has its initial width.
        (ui.spacing_mut().item_spacing.x, ui.spacing_mut().button_padding.x) = (1.0, 3.0);
        for option in Panel::ALL {
            ui.selectable_value(&mut panel, option, RichText::new(option.title()).size(TAB_SIZE));
        }
    });
    let mut actions = Vec::new();
    if panel != model.panel {
        actions.push(Action::ShowPanel(panel));
    }
    ui.separator();
    // Scrolls in both directions: contents that are too wide would widen the panel and move the image.
    let contents = ScrollArea::both().id_salt(panel.title()).auto_shrink(false).show(ui, |ui| match panel {
        Panel::Display => display::show(ui, model.layer, &model.view.display),
        Panel::Parameters => parameters::show(ui, model.parameters, model.edits),
        Panel::Pixel => pixel::show(ui, model.document, model.view),
        Panel::Kernel => {
            let is_denoised = model.document.is_some_and(|document| document.denoised.is_some());
            let actions = kernel::show(ui, model.inspector, model.view, is_denoised);
            actions.into_iter().map(Action::Inspector).collect()
        }
        Panel::Report => {
            report::show(ui, model.document);
            Vec::new()
        }
        Panel::Plot => plot::show(ui, model.document, model.sweep, model.parameters),
        Panel::Sampling => sampling::show(ui, model.adaptive),
    });
    actions.extend(contents.inner);
    actions
}
