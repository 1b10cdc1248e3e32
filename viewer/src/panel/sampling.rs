//! The adaptive loop on a built-in scene: its setup, and the iterations as they arrive.

use eframe::egui::{Color32, ComboBox, DragValue, Grid, RichText, Role, Ui, Vec2, WidgetInfo};
use egui_plot::{AxisHints, Legend, Line, MarkerShape, Plot, PlotPoints, Points};
use stein_stub::scenes;

use super::plot::{X_SPACING, marks, tick};
use crate::action::Action;
use crate::adaptive::{Adaptive, Iteration, Setup};
use crate::view::numbers::number;

/// Largest width and height that can be chosen, in pixels. Every iteration keeps all its layers in memory.
const LARGEST_SIDE: u32 = 512;
/// Largest number of iterations that can be chosen.
const MOST_ITERATIONS: u32 = 12;

/// Shows the panel.
pub fn show(ui: &mut Ui, adaptive: &Adaptive) -> Vec<Action> {
    let mut actions = Vec::new();
    ui.label(RichText::new("Adaptive sampling of a built-in scene").strong());
    let about = "Draws samples, denoises, and draws the next where the estimated error is largest. The method is \
                 that of the panel Parameters.";
    ui.label(RichText::new(about).weak());
    ui.add_space(4.0);
    // The widgets change a copy.
    let mut setup = adaptive.setup.clone();
    choose(ui, &mut setup);
    if setup != adaptive.setup {
        actions.push(Action::SetUpLoop(setup));
    }
    ui.add_space(4.0);
    ui.horizontal(|ui| {
        let text = if adaptive.started.is_some() { "Start again" } else { "Start" };
        if ui
            .button(text)
            .on_hover_text("Ends what is at work, and closes what is open once the first iteration is there")
            .clicked()
        {
            actions.push(Action::StartLoop);
        }
        if adaptive.is_running && ui.button("Stop").on_hover_text("Ends the loop; its iterations stay").clicked() {
            actions.push(Action::StopLoop);
        }
    });
    if adaptive.iterations.is_empty() {
        return actions;
    }
    ui.separator();
    if let Some(Setup { scene, samples_per_pixel, iterations, .. }) = &adaptive.started {
        ui.label(
            RichText::new(format!("{scene}: {samples_per_pixel} samples per pixel in {iterations} iterations"))
                .strong(),
        );
    }
    actions.extend(table(ui, adaptive).map(Action::ShowIteration));
    plot(ui, &adaptive.iterations);
    actions
}

fn choose(ui: &mut Ui, setup: &mut Setup) {
    Grid::new("setup").num_columns(2).spacing([8.0, 3.0]).show(ui, |ui| {
        let label = ui.label("scene");
        let menu = ComboBox::from_id_salt("scene").selected_text(&setup.scene).show_ui(ui, |ui| {
            for (name, about) in scenes() {
                ui.selectable_value(&mut setup.scene, name.to_owned(), name).on_hover_text(about);
            }
        });
        menu.response.labelled_by(label.id);
        ui.end_row();
        let about = scenes().find(|(name, _)| *name == setup.scene).map_or("", |(_, about)| about);
        ui.label("");
        ui.add(eframe::egui::Label::new(RichText::new(about).weak().size(11.5)).wrap());
        ui.end_row();
        ui.label("size").on_hover_text("Width and height, in pixels");
        ui.horizontal(|ui| {
            for (name, side) in [("width", &mut setup.extent.width), ("height", &mut setup.extent.height)] {
                let response = ui.add(DragValue::new(side).range(16..=LARGEST_SIDE).suffix(" px"));
                response.widget_info(|| WidgetInfo::labeled(Role::SpinButton, true, name));
            }
        });
        ui.end_row();
    });
    Grid::new("numbers").num_columns(4).spacing([8.0, 3.0]).show(ui, |ui| {
        let about = "Samples per pixel on average, of all iterations together; at least two for each";
        number_of(ui, "samples", about, &mut setup.samples_per_pixel, 2, 1024, true);
        let about = "The first samples evenly; all draw the same number of samples";
        number_of(ui, "iterations", about, &mut setup.iterations, 1, MOST_ITERATIONS, false);
        ui.end_row();
        let about = "Samples per pixel of a reference, which is drawn after the last iteration; 0 for none. Its own \
                     noise counts as error";
        number_of(ui, "reference", about, &mut setup.reference_samples, 0, 1 << 14, true);
        number_of(ui, "seed", "Same seed, same samples", &mut setup.seed, 0, 999_999, false);
        ui.end_row();
    });
    setup.samples_per_pixel = setup.samples_per_pixel.max(2 * setup.iterations);
}

fn number_of(ui: &mut Ui, name: &str, about: &str, value: &mut u32, least: u32, most: u32, is_even: bool) {
    let label = ui.label(name).on_hover_text(about);
    ui.add(DragValue::new(value).range(least..=most)).labelled_by(label.id).on_hover_text(about);
    *value -= if is_even { *value % 2 } else { 0 };
}

/// Shows the iterations. Returns the number of the one that was clicked.
fn table(ui: &mut Ui, adaptive: &Adaptive) -> Option<u32> {
    let mut chosen = None;
    let has_reference = adaptive.iterations.iter().any(|iteration| iteration.denoised.error.is_some());
    let text = |value: Option<f64>| {
        RichText::new(value.map_or_else(|| "–".to_owned(), |value| number(value as f32))).monospace().size(10.5)
    };
    Grid::new("iterations").num_columns(if has_reference { 6 } else { 4 }).striped(true).spacing([5.0, 1.0]).show(
        ui,
        |ui| {
            let headings = [
                ("", "Iteration: click to show it (Page up, Page down)"),
                ("spp", "Samples per pixel so far, on average"),
                ("range", "Fewest and most samples of a pixel so far"),
                ("estim.", "Relative MSE as it is estimated, without a reference"),
                ("error", "Relative MSE of the result against the reference"),
                ("noisy", "Relative MSE of the noisy image against the reference"),
            ];
            for (heading, about) in headings.iter().take(if has_reference { 6 } else { 4 }) {
                ui.label(RichText::new(*heading).strong()).on_hover_text(*about);
            }
            ui.end_row();
            for iteration in &adaptive.iterations {
                let Iteration { number: place, samples_per_pixel, spread: [least, most], opened, denoised } = iteration;
                let response = ui.selectable_label(adaptive.shown == Some(*place), format!(" {place} "));
                response.widget_info(|| {
                    WidgetInfo::selected(
                        Role::Button,
                        true,
                        adaptive.shown == Some(*place),
                        format!("iteration {place}"),
                    )
                });
                if response.clicked() {
                    chosen = Some(*place);
                }
                ui.label(text(Some(*samples_per_pixel)));
                ui.label(RichText::new(format!("{least}–{most}")).monospace().size(10.5));
                ui.label(text(denoised.estimated_error));
                if has_reference {
                    ui.label(text(denoised.error));
                    ui.label(text(opened.noisy_error));
                }
                ui.end_row();
            }
        },
    );
    chosen
}

/// Plots the errors over the samples, on logarithmic axes.
fn plot(ui: &mut Ui, iterations: &[Iteration]) {
    type Series = (&'static str, fn(&Iteration) -> Option<f64>);
    let colors = if ui.visuals().dark_mode {
        [Color32::from_rgb(250, 170, 70), Color32::from_rgb(90, 170, 250), Color32::from_gray(160)]
    } else {
        [Color32::from_rgb(190, 95, 0), Color32::from_rgb(20, 90, 190), Color32::from_gray(110)]
    };
    let series: [Series; 3] = [
        ("estimated", |iteration| iteration.denoised.estimated_error),
        ("error", |iteration| iteration.denoised.error),
        ("noisy", |iteration| iteration.opened.noisy_error),
    ];
    let width = ui.available_width();
    ui.add_space(4.0);
    let plot = Plot::new("error over samples")
        .width(width)
        .height((width * 0.62).clamp(150.0, 320.0))
        .custom_x_axes(vec![AxisHints::new_x().label("samples per pixel").formatter(tick).label_spacing(X_SPACING)])
        .custom_y_axes(vec![AxisHints::new_y().label("relative MSE").formatter(tick)])
        .x_grid_spacer(marks)
        .y_grid_spacer(marks)
        .set_margin_fraction(Vec2::splat(0.08))
        .legend(Legend::default())
        .allow_scroll(false);
    let shown = plot.show(ui, |ui| {
        for ((name, of), color) in series.into_iter().zip(colors) {
            // A value that is not above 0 has no position on a logarithmic axis.
            let places = iterations.iter().filter_map(|iteration| {
                Some([iteration.samples_per_pixel.log10(), of(iteration).filter(|error| *error > 0.0)?.log10()])
            });
            let places: Vec<_> = places.collect();
            if !places.is_empty() {
                ui.line(Line::new(name, PlotPoints::from(places.clone())).color(color));
                ui.points(
                    Points::new(name, PlotPoints::from(places)).color(color).radius(3.5).shape(MarkerShape::Circle),
                );
            }
        }
    });
    shown.response.widget_info(|| WidgetInfo::labeled(Role::Image, true, "plot: relative MSE over samples per pixel"));
}

#[cfg(test)]
mod tests {
    use egui_kittest::Harness;
    use egui_kittest::kittest::Queryable;

    use super::*;

    /// No window, no worker and no device: a panel is a function of what it reads.
    #[test]
    fn the_panel_returns_what_was_clicked() {
        let adaptive = Adaptive { is_running: true, ..Adaptive::default() };
        let panel = |ui: &mut Ui, actions: &mut Vec<Action>| actions.extend(show(ui, &adaptive));
        let mut harness = Harness::new_ui_state(panel, Vec::new());
        assert!(harness.state().is_empty(), "{:?}", harness.state());
        for (button, action) in [("Start", Action::StartLoop), ("Stop", Action::StopLoop)] {
            harness.get_by_label(button).click();
            harness.run();
            assert_eq!(std::mem::take(harness.state_mut()), [action]);
        }
    }
}
