//! The layout of the window: which panel is where, and which part of the state it reads.

use eframe::egui::{CentralPanel, Context, Frame as Margins, Panel as SidePanel, Ui};
use stein::Error;
use stein::error::Remedy;

use super::Viewer;
use crate::action::Action;
use crate::panel::{self, Panel};
use crate::view::canvas;
use crate::worker::Task;
use crate::{shortcut, words};

impl Viewer {
    /// Shows the whole window. The actions of a panel take effect before the next panel is shown.
    pub fn show(&mut self, ui: &mut Ui) {
        let context = ui.ctx().clone();
        self.view.begin_frame(self.format);
        self.poll(&context);
        self.apply_all(shortcut::pressed(&context), &context);

        let toolbar = SidePanel::top("toolbar");
        let actions = toolbar.show(ui, |ui| panel::toolbar::show(ui, &self.toolbar_model())).inner;
        self.apply_all(actions, &context);

        SidePanel::bottom("status").show(ui, |ui| panel::status::show(ui, &self.status_model()));

        let strip = SidePanel::left("layers").resizable(true).default_size(216.0).size_range(150.0..=420.0);
        let actions = strip.show(ui, |ui| panel::layers::show(ui, &self.strip_model())).inner;
        self.apply_all(actions, &context);

        let side = SidePanel::right("panel").resizable(true).default_size(336.0).size_range(240.0..=620.0);
        let actions = side.show(ui, |ui| panel::show(ui, &self.side_model())).inner;
        self.apply_all(actions, &context);

        let centre = CentralPanel::default().frame(Margins::NONE.fill(ui.visuals().panel_fill));
        let actions = centre.show(ui, |ui| self.show_canvas(ui)).inner;
        self.apply_all(actions, &context);

        if self.shows_help {
            let actions = panel::help::show(&context);
            self.apply_all(actions, &context);
        }
    }

    fn apply_all(&mut self, actions: Vec<Action>, context: &Context) {
        actions.into_iter().for_each(|action| self.apply(action, context));
    }

    fn toolbar_model(&self) -> panel::toolbar::Model<'_> {
        panel::toolbar::Model {
            has_document: self.document.is_some(),
            is_denoised: self.is_denoised(),
            recent: &self.settings.recent,
            compare: self.view.compare,
            progress: self.progress,
            input: self.document.as_ref().and_then(|document| document.opened.input.as_ref()),
        }
    }

    fn status_model(&self) -> panel::status::Model<'_> {
        panel::status::Model {
            device: self.gpu.summary(),
            notice: self.notice.as_ref().and_then(|(notice, _)| notice.as_deref().ok()),
            document: self.document.as_ref(),
            a: self.layer().map(AsRef::as_ref),
            b: self.other().map(AsRef::as_ref),
            hovered: self.view.hovered,
            zoom: self.view.camera.zoom,
        }
    }

    fn strip_model(&self) -> panel::layers::Model<'_> {
        panel::layers::Model {
            layers: self.document.as_ref().map(|document| document.layers()),
            a: self.layer().map(|layer| layer.name()),
            b: self.view.other.as_deref(),
            view: &self.view,
            scrolls: self.scrolls_to_layer,
        }
    }

    fn side_model(&self) -> panel::Model<'_> {
        panel::Model {
            panel: self.panel,
            document: self.document.as_ref(),
            layer: self.layer().map(AsRef::as_ref),
            view: &self.view,
            parameters: self.parameters,
            edits: &self.edits,
            sweep: &self.sweep,
            adaptive: &self.adaptive,
            inspector: &self.inspector,
        }
    }

    fn welcome_model(&self) -> panel::welcome::Model<'_> {
        panel::welcome::Model {
            is_opening: matches!(self.progress, Some((Task::Open, _))),
            waiting_reference: self.waiting_reference.as_deref(),
            recent: &self.settings.recent,
        }
    }

    /// Shows failures, and under them the canvas.
    fn show_canvas(&mut self, ui: &mut Ui) -> Vec<Action> {
        let failures = [
            self.trouble.as_ref().map(|(_, error)| error),
            self.notice.as_ref().and_then(|(notice, _)| notice.as_ref().err()),
            self.document.as_ref().and_then(|document| document.opened.left_out.as_ref()),
        ];
        let failures: Vec<_> = failures.into_iter().flatten().map(words::told).collect();
        let mut actions: Vec<_> = failures.iter().filter_map(|failure| panel::failure::show(ui, failure)).collect();
        let needs_samples = |error: &Error| error.remedies().contains(&Remedy::GiveSamples);
        if self.trouble.as_ref().is_some_and(|(task, error)| *task == Task::Open && needs_samples(error)) {
            actions.extend(panel::failure::ask_for_samples(ui));
        }
        self.view.marked = if self.panel == Panel::Kernel { self.inspector.marked() } else { None };
        let (layer, other) = (self.layer().cloned(), self.other().cloned());
        match layer {
            Some(layer) => {
                self.canvas = canvas::show(ui, &mut self.view, &layer, other.as_deref()).rect.size();
            }
            None => actions.extend(panel::welcome::show(ui, &self.welcome_model())),
        }
        actions
    }
}
