//! Effects of actions.

use eframe::egui::{self, Context};
use stein::Extent;

use super::Viewer;
use crate::action::Action;
use crate::document::counterpart;
use crate::settings::Parameters;
use crate::view::{Compare, Display};
use crate::worker::Task;

impl Viewer {
    /// Does what a panel, a menu or a key asks for.
    pub fn apply(&mut self, action: Action, context: &Context) {
        match action {
            Action::AskForFile(purpose) => self.ask(purpose, context),
            Action::Open(source) => self.open(*source),
            Action::OpenWithSamples(samples) => self.open_with_samples(samples),
            Action::ShowPicture(index) => self.show_picture(index),
            Action::StepPicture(step) => self.step_picture(step),
            Action::Run => self.run(),
            Action::Cancel => self.cancel(),
            Action::Dismiss => {
                (self.trouble, self.notice) = (None, None);
                self.forget_left_out();
            }

            Action::SetParameter(name, value) => {
                if self.edits.set(&mut self.parameters, &name, value) {
                    self.run();
                }
            }
            Action::ChooseMethod(method, preset) => {
                let fresh = Parameters::of(method, preset).unwrap_or(self.parameters);
                self.take_parameters(self.earlier.take_up(fresh));
            }
            Action::TakeParameters(parameters) => self.take_parameters(*parameters),
            Action::ResetParameters => self.take_parameters(self.parameters.reset()),

            Action::SetSweepRange(range) => self.sweep.range = range,
            Action::ToggleSweep => self.toggle_sweep(),

            Action::SetUpLoop(setup) => self.adaptive.setup = setup,
            Action::StartLoop => self.adapt(),
            Action::StopLoop => self.stop_adapting(),
            Action::ShowIteration(number) => self.show_iteration(number, context),
            Action::StepIteration(step) => {
                let number = self.adaptive.shown.and_then(|shown| shown.checked_add_signed(step));
                number.into_iter().for_each(|number| self.show_iteration(number, context));
            }

            Action::ShowLayer { name, scrolls } => {
                if self.has_layer(&name) {
                    self.view.layer = name.into_owned();
                    self.scrolls_to_layer |= scrolls;
                }
            }
            Action::StepLayer(step) => self.step_layer(step),
            Action::ScrolledToLayer => self.scrolls_to_layer = false,
            Action::SetOther(name) => self.view.other = name,
            Action::MarkOther => self.view.other = self.layer().map(|layer| layer.name().to_owned()),
            Action::Swap => {
                if let Some(other) = self.view.other.take() {
                    self.view.other = Some(std::mem::replace(&mut self.view.layer, other));
                }
            }
            Action::ShowCounterpart => {
                let name = match self.view.layer.as_str() {
                    "noisy" => Some("result".to_owned()),
                    "result" => Some("noisy".to_owned()),
                    along => counterpart(along),
                };
                if let Some(name) = name {
                    self.apply(Action::ShowLayer { name: name.into(), scrolls: true }, context);
                }
            }
            Action::Compare(compare) => self.compare(compare),

            Action::SetDisplay(display) => self.view.display = *display,
            Action::ResetDisplay => {
                let Display { tone, colormap, .. } = self.view.display;
                self.view.display = Display { tone, colormap, ..Display::default() };
            }
            Action::Expose(stops) => self.view.display.exposure += stops,
            Action::Offset(by) => self.view.display.offset += by,
            Action::ToggleSharedScale => self.view.display.shares_scale = !self.view.display.shares_scale,
            Action::Fit => self.view.camera.fits = true,
            Action::ActualSize => {
                self.view.camera.fits = false;
                self.view.camera.zoom = 1.0 / context.pixels_per_point();
            }
            Action::Zoom(factor) => self.view.camera.magnify(factor),

            Action::MovePixel(by) => self.move_pixel(by),
            Action::Inspector(action) => self.inspector.apply(action),

            Action::ShowPanel(panel) => self.panel = panel,
            Action::TogglePanel(panel) if self.panel == panel => self.panel = self.panel_before,
            Action::TogglePanel(panel) => self.panel_before = std::mem::replace(&mut self.panel, panel),
            Action::ToggleTheme => context.set_theme(if context.theme() == egui::Theme::Dark {
                egui::Theme::Light
            } else {
                egui::Theme::Dark
            }),
            Action::ToggleHelp => self.shows_help = !self.shows_help,
        }
    }

    /// Returns whether the open document has a layer with this name.
    fn has_layer(&self, name: &str) -> bool {
        self.document.as_ref().is_some_and(|document| document.layer(name).is_some())
    }

    /// Cancels one thing: a message if there is one, or else the help, the work in flight, a reference that waits, or
    /// the pinned pixel.
    fn cancel(&mut self) {
        let is_told = self.trouble.take().is_some() || self.notice.take_if(|(notice, _)| notice.is_err()).is_some();
        if is_told || self.forget_left_out() {
            return;
        }
        if std::mem::take(&mut self.shows_help) {
            return;
        }
        match self.progress.take() {
            Some((Task::Adapt, _)) => self.stop_adapting(),
            Some((Task::Sweep, _)) => self.toggle_sweep(),
            Some((task, _)) => {
                self.worker.cancel(task);
                if task == Task::Open && std::mem::take(&mut self.interrupted) {
                    self.run();
                }
            }
            None if self.waiting_reference.take().is_some() => {}
            None => self.view.pinned = None,
        }
    }

    /// Removes the message about files that are not open. Returns whether there was one.
    fn forget_left_out(&mut self) -> bool {
        self.document.as_mut().and_then(|document| document.opened.left_out.take()).is_some()
    }

    /// Shows the layer that is `step` places further in the strip, and scrolls the strip to it.
    fn step_layer(&mut self, step: isize) {
        let Some(document) = &self.document else { return };
        let layers = document.layers();
        let place = layers.iter().position(|layer| layer.name() == self.view.layer).unwrap_or(0);
        if let Some(layer) = layers.get(place.saturating_add_signed(step).min(layers.len() - 1)) {
            self.view.layer = layer.name().to_owned();
            self.scrolls_to_layer = true;
        }
    }

    /// Pins the pixel at the offset `by` from the chosen one, or from the middle of the image if no pixel is chosen.
    fn move_pixel(&mut self, by: [i32; 2]) {
        let Some(document) = &self.document else { return };
        let Extent { width, height } = document.opened.frame.extent();
        let [x, y] = self.view.chosen().unwrap_or([width / 2, height / 2]);
        self.view.pinned =
            Some([x.saturating_add_signed(by[0]).min(width - 1), y.saturating_add_signed(by[1]).min(height - 1)]);
        self.view.reveals_pinned = true;
    }

    /// Compares in this way. Chooses the likeliest layer B if none is marked.
    pub fn compare(&mut self, compare: Compare) {
        self.view.compare = compare;
        if compare != Compare::Single && self.other().is_none() {
            // The references of the layers that are denoised along are not read. Before the first run, one of the pair
            // does not exist yet.
            let is_known = |name: &str| self.has_layer(name) || self.has_layer(&self.view.layer);
            let own = counterpart(&self.view.layer).filter(|name| is_known(name));
            let likeliest = ["reference", "noisy", "result"]
                .into_iter()
                .find(|name| *name != self.view.layer && self.has_layer(name));
            self.view.other = own.or_else(|| likeliest.map(ToOwned::to_owned));
        }
    }
}
