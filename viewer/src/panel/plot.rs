//! Error against run time of the open frame, over radius, preset and method: how much error the time saves.

use std::ops::RangeInclusive;

use eframe::egui::{Button, Color32, Grid, Id, Rangef, Response, RichText, Role, Ui, Vec2, WidgetInfo};
use egui_plot::{
    AxisHints, GridInput, GridMark, Line, LineStyle, MarkerShape, Plot, PlotPoint, PlotPoints, PlotTransform, Points,
};
use stein::Preset;

use crate::action::Action;
use crate::document::{Document, MeasuredRun};
use crate::settings::Parameters;
use crate::sweep::{Sweep, SweepRange, radius};
use crate::view::numbers::number;

/// Name of the plot, by which its transform can be looked up.
pub const PLOT: &str = "error against time";
/// Largest distance at which the pointer is at a point, in points of the screen.
const REACH: f32 = 12.0;
/// Smallest number of marks on an axis, unless the axis is very short.
const LEAST_MARKS: usize = 3;
/// Space between the numbers along the x axis, in points: below `min` a number is hidden, and from `max` on it is fully
/// visible.
pub(super) const X_SPACING: Rangef = Rangef { min: 24.0, max: 40.0 };
/// Margin around the points, in decades.
const MARGIN: f64 = 0.12;

/// A run as a point of the plot.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Spot {
    parameters: Parameters,
    seconds: f64,
    error: f64,
    /// Whether the run kept every layer, as the runs of the window do.
    keeps_layers: bool,
}

impl Spot {
    /// Returns the position in the plot: log₁₀ of the seconds and of the error.
    fn place(&self) -> [f64; 2] {
        [self.seconds.log10(), self.error.log10()]
    }

    fn text(&self) -> String {
        let how = if self.keeps_layers { ", every layer kept" } else { "" };
        format!("{}{how}: {} s, {}", title(&self.parameters), number(self.seconds as f32), number(self.error as f32))
    }
}

/// Shows the panel: the runs of the open frame and of the sweep. `in_use` are the parameters of the next run.
pub fn show(ui: &mut Ui, document: Option<&Document>, sweep: &Sweep, in_use: Parameters) -> Vec<Action> {
    let Some(document) = document else {
        ui.label("Open a file to measure error against run time.");
        return Vec::new();
    };
    let has_reference = document.opened.reference.is_some();
    let axis = if has_reference { "relative MSE against the reference" } else { "relative MSE, estimated" };
    // A value that is not above 0 has no position on a logarithmic axis.
    let spot = |run: &MeasuredRun, keeps_layers: bool| {
        let error = if has_reference { run.error } else { run.estimated_error };
        let error = error.filter(|error| *error > 0.0 && run.seconds > 0.0)?;
        Some(Spot { parameters: run.parameters, seconds: run.seconds, error, keeps_layers })
    };
    let (swept, runs) = (&sweep.points, &document.history);
    let spots: Vec<Spot> =
        swept.iter().filter_map(|run| spot(run, false)).chain(runs.iter().filter_map(|run| spot(run, true))).collect();
    let missing = swept.len() + runs.len() - spots.len();

    let mut actions = choose(ui, sweep, in_use);
    let mut taken = plot(ui, (sweep, in_use), &spots, axis);
    if missing > 0 {
        ui.label(RichText::new(format!("{missing} runs without an error above 0 are left out")).weak());
    }
    ui.label(
        RichText::new(
            "Crosses: runs of this window, which keep every layer. The others made the result and its \
             estimated error alone.",
        )
        .weak()
        .size(11.5),
    );
    taken = taken.or(table(ui, in_use, &spots));
    actions.extend(taken.map(|parameters| Action::TakeParameters(Box::new(parameters))));
    actions
}

/// Shows the range of the sweep, and how far the sweep is.
fn choose(ui: &mut Ui, sweep: &Sweep, in_use: Parameters) -> Vec<Action> {
    let mut actions = Vec::new();
    // The widgets change a copy.
    let mut range = sweep.range.clone();
    Grid::new("sweep").num_columns(2).spacing([8.0, 3.0]).show(ui, |ui| {
        ui.label("radii");
        ui.horizontal_wrapped(|ui| {
            SweepRange::RADII.iter().for_each(|radius| {
                toggle(ui, &mut range.radii, *radius, &radius.to_string(), &format!("radius {radius}"));
            });
        });
        ui.end_row();
        ui.label("presets");
        ui.horizontal(|ui| {
            Preset::ALL.iter().for_each(|preset| {
                toggle(ui, &mut range.presets, *preset, preset.name(), &format!("preset {}", preset.name()));
            });
        });
        ui.end_row();
        ui.label("methods");
        ui.horizontal(|ui| {
            Parameters::METHODS
                .iter()
                .for_each(|method| toggle(ui, &mut range.methods, *method, method, &format!("method {method}")));
        });
        ui.end_row();
    });
    let count = range.parameters(in_use).len();
    if range != sweep.range {
        actions.push(Action::SetSweepRange(range));
    }
    ui.horizontal(|ui| {
        if sweep.is_running {
            if ui.button("Stop").on_hover_text("Ends the sweep; what was measured stays").clicked() {
                actions.push(Action::ToggleSweep);
            }
            ui.label(format!("{} of {} measured", sweep.points.len(), sweep.planned.len()));
        } else {
            let about = "Denoises the open frame with each, twice, whenever there is nothing else to do (F9)";
            if ui.add(Button::new(format!("Measure {count}"))).on_hover_text(about).clicked() {
                actions.push(Action::ToggleSweep);
            }
        }
    });
    ui.add_space(2.0);
    actions
}

/// Shows a word that a click adds to a list or removes from it.
fn toggle<T: Copy + PartialEq>(ui: &mut Ui, all: &mut Vec<T>, one: T, text: &str, name: &str) {
    let is_in = all.contains(&one);
    let response = ui.selectable_label(is_in, text);
    response.widget_info(|| WidgetInfo::selected(Role::Button, true, is_in, name));
    if response.clicked() {
        if is_in { all.retain(|other| *other != one) } else { all.push(one) }
    }
}

/// Shows the plot. Returns the parameters of a point that was clicked.
fn plot(ui: &mut Ui, (sweep, in_use): (&Sweep, Parameters), spots: &[Spot], axis: &str) -> Option<Parameters> {
    let width = ui.available_width();
    let series = series(&sweep.points, ui.visuals().dark_mode);
    let strong = ui.visuals().strong_text_color();
    let weak = ui.visuals().weak_text_color();
    // The margin keeps the axes from being filled by a single point.
    let bounds = |axis: usize| {
        let places = || spots.iter().map(|spot| spot.place()[axis]);
        let (least, most) = (places().fold(f64::INFINITY, f64::min), places().fold(f64::NEG_INFINITY, f64::max));
        if spots.is_empty() { (-3.0, 0.0) } else { (least - MARGIN, most + MARGIN) }
    };
    let ((left, right), (bottom, top)) = (bounds(0), bounds(1));
    let plot = Plot::new(PLOT)
        .id(Id::unique(PLOT))
        .height((width * 0.85).clamp(180.0, 420.0))
        .width(width)
        .custom_x_axes(vec![AxisHints::new_x().label("seconds").formatter(tick).label_spacing(X_SPACING)])
        .custom_y_axes(vec![AxisHints::new_y().label(axis).formatter(tick)])
        .x_grid_spacer(marks)
        .y_grid_spacer(marks)
        .include_x(left)
        .include_x(right)
        .include_y(bottom)
        .include_y(top)
        .set_margin_fraction(Vec2::splat(0.02))
        .show_x(false)
        .show_y(false)
        .allow_scroll(false)
        .allow_boxed_zoom(false)
        .label_formatter(|_| None);
    let shown = plot.show(ui, |ui| {
        for Series { method, preset, color, style } in &series {
            let own = spots.iter().filter(|spot| {
                !spot.keeps_layers && spot.parameters.method.name() == *method && spot.parameters.preset == *preset
            });
            let mut places: Vec<[f64; 2]> = own.map(Spot::place).collect();
            places.sort_by(|a, b| a[0].total_cmp(&b[0]));
            let name = format!("{method} {}", preset.name());
            if is_a_line(*preset, method) {
                ui.line(
                    Line::new(&name, PlotPoints::from(places.clone()))
                        .color(*color)
                        .style(*style)
                        .width(1.5)
                        .allow_hover(false),
                );
            }
            ui.points(
                Points::new(&name, PlotPoints::from(places))
                    .color(*color)
                    .radius(4.0)
                    .shape(marker(*preset))
                    .allow_hover(false),
            );
        }
        let runs: Vec<_> = spots.iter().filter(|spot| spot.keeps_layers).map(Spot::place).collect();
        ui.points(
            Points::new("runs of this window", PlotPoints::from(runs))
                .color(weak)
                .radius(4.0)
                .shape(MarkerShape::Cross)
                .allow_hover(false),
        );
        let own = |spot: &&Spot| spot.parameters.method == in_use.method;
        let current =
            spots.iter().find(|spot| own(spot) && !spot.keeps_layers).or_else(|| spots.iter().rev().find(own));
        let ring = PlotPoints::from(current.map(Spot::place).into_iter().collect::<Vec<_>>());
        ui.points(
            Points::new("in use", ring)
                .color(strong)
                .radius(8.0)
                .filled(false)
                .shape(MarkerShape::Circle)
                .allow_hover(false),
        );
    });
    let response = shown.response;
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, format!("plot: {axis} against seconds")));
    let hovered = response.hover_pos().and_then(|pointer| nearest(&shown.transform, spots, pointer));
    tell(&response, hovered);
    legend(ui, &series, spots);
    hovered.filter(|_| response.clicked()).map(|spot| spot.parameters)
}

fn tell(response: &Response, hovered: Option<&Spot>) {
    if let Some(spot) = hovered {
        response.clone().on_hover_text_at_pointer(format!("{}\nClick to take these parameters.", spot.text()));
    }
}

/// Returns the spot under the pointer.
fn nearest<'a>(transform: &PlotTransform, spots: &'a [Spot], pointer: eframe::egui::Pos2) -> Option<&'a Spot> {
    let distance = |spot: &Spot| {
        let [x, y] = spot.place();
        transform.position_from_point(&PlotPoint::new(x, y)).distance(pointer)
    };
    let nearest = spots.iter().map(|spot| (spot, distance(spot))).min_by(|a, b| a.1.total_cmp(&b.1));
    nearest.filter(|(_, distance)| *distance <= REACH).map(|(spot, _)| spot)
}

/// A series of points: one method with one preset.
struct Series {
    method: &'static str,
    preset: Preset,
    color: Color32,
    style: LineStyle,
}

fn series(swept: &[MeasuredRun], is_dark: bool) -> Vec<Series> {
    let colors = if is_dark {
        [Color32::from_rgb(90, 170, 250), Color32::from_rgb(110, 210, 130), Color32::from_rgb(250, 170, 70)]
    } else {
        [Color32::from_rgb(20, 90, 190), Color32::from_rgb(20, 125, 55), Color32::from_rgb(190, 95, 0)]
    };
    let is_there = |method: &str, preset: Preset| {
        swept.iter().any(|run| run.parameters.method.name() == method && run.parameters.preset == preset)
    };
    let of_method = |(method, color): (&'static str, Color32)| {
        let presets = Preset::ALL.iter().copied().filter(move |preset| is_there(method, *preset));
        presets.map(move |preset| {
            let style = if preset == Preset::Default { LineStyle::Solid } else { LineStyle::dashed_loose() };
            Series { method, preset, color, style }
        })
    };
    Parameters::METHODS.into_iter().zip(colors).flat_map(of_method).collect()
}

/// Returns whether the points of a series differ in the radius.
fn is_a_line(preset: Preset, method: &str) -> bool {
    Parameters::of(method, preset).is_some_and(|parameters| radius(&parameters.method).is_some())
}

fn marker(preset: Preset) -> MarkerShape {
    if preset == Preset::Default { MarkerShape::Circle } else { MarkerShape::Diamond }
}

fn legend(ui: &mut Ui, series: &[Series], spots: &[Spot]) {
    if spots.is_empty() {
        return;
    }
    ui.horizontal_wrapped(|ui| {
        for Series { method, preset, color, .. } in series {
            let sign = if *preset == Preset::Default { "●" } else { "◆" };
            ui.label(RichText::new(format!("{sign} {method} {}", preset.name())).color(*color));
        }
        ui.label(RichText::new("○ in use").strong());
    });
}

/// Shows the measured runs as text. Returns the parameters of a line that was clicked.
fn table(ui: &mut Ui, in_use: Parameters, spots: &[Spot]) -> Option<Parameters> {
    let mut taken = None;
    let mut swept: Vec<&Spot> = spots.iter().filter(|spot| !spot.keeps_layers).collect();
    if swept.is_empty() {
        return None;
    }
    swept.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    ui.separator();
    Grid::new("measured").num_columns(3).striped(true).spacing([10.0, 1.0]).show(ui, |ui| {
        for heading in ["parameters", "seconds", "relative MSE"] {
            ui.label(RichText::new(heading).strong());
        }
        ui.end_row();
        for spot in swept {
            let is_in_use = spot.parameters.method == in_use.method;
            if ui
                .selectable_label(is_in_use, title(&spot.parameters))
                .on_hover_text("Click to take these parameters")
                .clicked()
            {
                taken = Some(spot.parameters);
            }
            ui.label(RichText::new(number(spot.seconds as f32)).monospace());
            ui.label(RichText::new(number(spot.error as f32)).monospace());
            ui.end_row();
        }
    });
    taken
}

/// Describes parameters: method, preset, radius, and how many other parameters differ from the preset.
fn title(parameters: &Parameters) -> String {
    let Parameters { preset, method } = parameters;
    let radius = radius(method);
    let others = method
        .parameters()
        .iter()
        .filter(|parameter| parameter.name != "window_radius" && parameters.differs(parameter))
        .count();
    let radius = radius.map_or_else(String::new, |radius| format!(", radius {radius}"));
    let changed = if others > 0 { format!(", {others} changed") } else { String::new() };
    format!("{} {}{radius}{changed}", method.name(), preset.name())
}

/// Returns the marks of a logarithmic axis: whole decades, or parts of decades if those are too few. A mark that also
/// belongs to a coarser division gets the step size of that division, so that its number stays if there is no room for
/// all numbers.
pub(super) fn marks(input: GridInput) -> Vec<GridMark> {
    let (low, high) = input.bounds;
    let tenths = |step: usize| (10..100).step_by(step).collect::<Vec<u32>>();
    let divisions = [vec![10], vec![10, 20, 50], tenths(10), tenths(5), tenths(1)];
    let marks = |index: usize| {
        let mark = |decade: i32, tenth: u32| {
            let coarsest = divisions.iter().find(|division| division.contains(&tenth)).unwrap_or(&divisions[index]);
            let next = coarsest.iter().copied().find(|other| *other > tenth).unwrap_or(100);
            GridMark {
                value: f64::from(decade) + (f64::from(tenth) / 10.0).log10(),
                step_size: (f64::from(next) / f64::from(tenth)).log10(),
            }
        };
        let decades = low.floor() as i32..=high.ceil() as i32;
        let all = decades.flat_map(|decade| divisions[index].iter().map(move |tenth| mark(decade, *tenth)));
        all.filter(|mark| (low..=high).contains(&mark.value)).collect::<Vec<_>>()
    };
    let finest = divisions.len() - 1;
    (0..finest).map(marks).find(|marks| marks.len() >= LEAST_MARKS).unwrap_or_else(|| marks(finest))
}

/// Formats the number at a mark, with two digits.
pub(super) fn tick(mark: GridMark, _: &RangeInclusive<f64>) -> String {
    let text = format!("{:.1e}", 10.0_f64.powf(mark.value));
    match text.parse::<f64>() {
        Ok(value) if value >= 1e-4 => value.to_string(),
        _ => text.replace(".0e", "e"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticks(low: f64, high: f64) -> Vec<String> {
        let input = GridInput { bounds: (low.log10(), high.log10()), base_step_size: 1.0 };
        marks(input).into_iter().map(|mark| tick(mark, &(0.0..=1.0))).collect()
    }

    #[test]
    fn axes_have_as_few_marks_as_will_do() {
        assert_eq!(ticks(9e-7, 1.1), ["1e-6", "1e-5", "0.0001", "0.001", "0.01", "0.1", "1"]);
        assert_eq!(ticks(0.9, 6.0), ["1", "2", "5"]);
        assert_eq!(ticks(0.0028, 0.0053), ["0.003", "0.004", "0.005"]);
        assert_eq!(ticks(0.00288, 0.00312), ["0.0029", "0.003", "0.0031"]);
    }
}
