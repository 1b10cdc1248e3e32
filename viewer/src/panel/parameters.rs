//! The parameters panel: the method, the preset, and every parameter as the method describes it. A change starts a run,
//! and cancels the run in flight.

use std::ops::Bound;

use eframe::egui::text::LayoutJob;
use eframe::egui::{
    Align, Button, Checkbox, Color32, ComboBox, DragValue, FontId, Id, Label, Layout, Response, RichText, Role, Slider,
    TextFormat, TextStyle, Ui, Vec2, WidgetInfo,
};
use stein::Preset;
use stein::parameters::{Choice, Kind, Parameter, Value};

use crate::action::Action;
use crate::edit::{Edits, Refused};
use crate::files::Purpose;
use crate::settings::Parameters;

/// Width of the names, in points.
const NAME_WIDTH: f32 = 152.0;
/// Width of a number beside its slider, in points.
const NUMBER_WIDTH: f32 = 52.0;
/// Height of a row, in points.
const ROW_HEIGHT: f32 = 18.0;
/// Width of the button that resets a parameter, in points.
const RESET_WIDTH: f32 = 18.0;

/// Shows the panel: the parameters in use, and the edits that wait.
pub fn show(ui: &mut Ui, parameters: Parameters, edits: &Edits) -> Vec<Action> {
    let mut actions: Vec<_> = choose(ui, parameters).into_iter().collect();
    ui.add_space(2.0);
    let listed = parameters.method.parameters();
    let changed = listed.iter().filter(|parameter| parameters.differs(parameter)).count();
    ui.horizontal(|ui| {
        let button = Button::new("Reset all");
        if ui
            .add_enabled(changed > 0 || edits.any_wait(), button)
            .on_hover_text("All parameters as the preset has them")
            .clicked()
        {
            actions.push(Action::ResetParameters);
        }
        if ui
            .button("Save…")
            .on_hover_text("Writes the parameters as TOML, for `stein denoise --params FILE`")
            .clicked()
        {
            actions.push(Action::AskForFile(Purpose::SaveParameters));
        }
        if ui.button("Load…").on_hover_text("Reads parameters from TOML, such as `stein params` writes").clicked() {
            actions.push(Action::AskForFile(Purpose::Parameters));
        }
        let preset = parameters.preset.name();
        let text = if changed == 0 { format!("as in {preset}") } else { format!("{changed} not as in {preset}") };
        ui.label(RichText::new(text).weak());
    });
    ui.separator();
    for parameter in &listed {
        let value = row(ui, parameters, edits.refused(&parameter.name), parameter);
        actions.extend(value.map(|value| Action::SetParameter(parameter.name.clone(), value)));
    }
    actions
}

/// Shows the choice of method and preset.
fn choose(ui: &mut Ui, parameters: Parameters) -> Option<Action> {
    let Parameters { mut preset, method } = parameters;
    let mut name = method.name();
    ui.horizontal(|ui| {
        let label = named(ui, "method");
        let menu = ComboBox::from_id_salt("method").selected_text(name).show_ui(ui, |ui| {
            for method in Parameters::METHODS {
                ui.selectable_value(&mut name, method, method);
            }
        });
        menu.response.labelled_by(label.id);
    });
    ui.horizontal(|ui| {
        named(ui, "preset");
        for (option, choice) in Preset::ALL.iter().zip(Preset::choices()) {
            ui.selectable_value(&mut preset, *option, choice.name).on_hover_text(choice.documentation);
        }
    });
    let is_changed = name != method.name() || preset != parameters.preset;
    is_changed.then_some(Action::ChooseMethod(name, preset))
}

/// Shows a parameter, unless its group is left out, and the edit of it that waits. Returns the new value, if the user
/// set or reset the parameter.
fn row(ui: &mut Ui, parameters: Parameters, refused: Option<&Refused>, parameter: &Parameter) -> Option<Value> {
    let value = refused.map(|refused| &refused.value).or(parameter.value.as_ref())?;
    let differs = parameters.differs(parameter) || refused.is_some();
    let mut change = None;
    if parameter.kind == Kind::Group {
        ui.add_space(4.0);
    }
    ui.horizontal(|ui| {
        let about = about(parameter);
        let label = name(ui, parameter, differs).on_hover_text(&about);
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            if differs {
                let preset_value = parameters.preset_value(parameter);
                let before = preset_value
                    .as_ref()
                    .map_or_else(String::new, |value| format!("Back to {value}, as in the preset"));
                let button = ui
                    .add_sized(
                        Vec2::new(RESET_WIDTH, ROW_HEIGHT),
                        Button::new(RichText::new("↺").size(16.0)).frame(false),
                    )
                    .on_hover_text(before);
                button.widget_info(|| WidgetInfo::labeled(Role::Button, true, format!("reset {}", parameter.name)));
                if button.clicked() {
                    change = preset_value;
                }
            } else {
                ui.add_space(RESET_WIDTH + ui.spacing().item_spacing.x);
            }
            ui.with_layout(Layout::left_to_right(Align::Center), |ui| {
                if let Some(value) = widget(ui, parameter, value, label.id, &about) {
                    change = Some(value);
                }
            });
        });
    });
    if let Some(Refused { error, .. }) = refused {
        let text = error.to_string();
        let (problem, remedy) = text.split_once("\n  remedy: ").unwrap_or((&text, ""));
        ui.indent(&parameter.name, |ui| {
            ui.label(RichText::new(problem).color(ui.visuals().error_fg_color));
            ui.label(format!("Remedy: {remedy}. Until then the last value stays in use."));
        });
    }
    change
}

/// Shows the name of a row, with the full width of the column.
fn named(ui: &mut Ui, name: &str) -> Response {
    in_column(ui, Label::new(name))
}

/// Shows the name of a parameter. The name of its group is weak; if the parameter differs from the preset, all of it
/// has a marked colour.
fn name(ui: &mut Ui, parameter: &Parameter, differs: bool) -> Response {
    let font = FontId::proportional(TextStyle::Body.resolve(ui.style()).size - 1.0);
    let marked = if ui.visuals().dark_mode { Color32::from_rgb(110, 185, 255) } else { Color32::from_rgb(0, 75, 165) };
    let strong = if differs { marked } else { ui.visuals().text_color() };
    let mut job = LayoutJob::default();
    let (group, own) =
        parameter.name.rfind('.').map_or(("", parameter.name.as_str()), |dot| parameter.name.split_at(dot + 1));
    job.append(
        group,
        0.0,
        TextFormat::simple(font.clone(), if differs { strong } else { ui.visuals().weak_text_color() }),
    );
    job.append(own, 0.0, TextFormat::simple(font, strong));
    in_column(ui, Label::new(job))
}

fn in_column(ui: &mut Ui, label: Label) -> Response {
    let size = Vec2::new(NAME_WIDTH, ROW_HEIGHT);
    let in_column = |ui: &mut Ui| {
        ui.set_min_width(NAME_WIDTH);
        ui.add(label.truncate())
    };
    ui.allocate_ui_with_layout(size, Layout::left_to_right(Align::Center), in_column).inner
}

/// Returns the explanation of a parameter: its documentation, its rule, and its values in the presets.
fn about(parameter: &Parameter) -> String {
    let in_words = |value: &Option<Value>| match value {
        None | Some(Value::Flag(false)) if parameter.kind == Kind::Group => "left out".to_owned(),
        None => "none, its group is left out".into(),
        Some(Value::Flag(false)) if matches!(parameter.kind, Kind::Number { .. }) => "left out".into(),
        Some(value) => value.to_string(),
    };
    let Parameter { name, documentation, default, thesis, .. } = parameter;
    format!(
        "{name}\n\n{documentation}\n\nCan be {}. Default: {}. Thesis: {}.",
        parameter.rule(),
        in_words(default),
        in_words(thesis)
    )
}

/// Shows the widget for the kind of a parameter. Returns the new value, if the user changed it.
fn widget(ui: &mut Ui, parameter: &Parameter, value: &Value, label: Id, about: &str) -> Option<Value> {
    let suffix = match parameter.unit {
        Some("pixels") => " px".to_owned(),
        Some(unit) => format!(" {unit}"),
        None => String::new(),
    };
    match (&parameter.kind, value) {
        (Kind::Integer { range }, Value::Integer(value)) => {
            let mut new = *value;
            slide(ui, Slider::new(&mut new, range.clone()).suffix(suffix), label, about);
            (new != *value).then_some(Value::Integer(new))
        }
        (Kind::Number { range, can_be_off: false }, Value::Number(value)) => {
            number(ui, *value, *range, &suffix, label, about).map(Value::Number)
        }
        (Kind::Number { range, can_be_off: true }, value) => {
            let is_on = *value != Value::Flag(false);
            let mut new = is_on;
            ui.add(Checkbox::without_text(&mut new)).labelled_by(label).on_hover_text(about);
            let number = match value {
                Value::Number(value) => number(ui, *value, *range, &suffix, label, about).map(Value::Number),
                _ => None,
            };
            if new == is_on { number } else { Some(Value::Flag(new)) }
        }
        (Kind::Flag | Kind::Group, Value::Flag(value)) => {
            let mut new = *value;
            ui.add(Checkbox::without_text(&mut new)).labelled_by(label).on_hover_text(about);
            (new != *value).then_some(Value::Flag(new))
        }
        (Kind::Choice { options }, Value::Choice(value)) => choice(ui, parameter, options, value, label, about),
        (Kind::Set { options }, Value::Set(names)) => set(ui, options, names),
        // The library ensures that values match their kinds.
        _ => None,
    }
}

fn slide(ui: &mut Ui, slider: Slider<'_>, label: Id, about: &str) -> Response {
    ui.spacing_mut().slider_width = (ui.available_width() - NUMBER_WIDTH - ui.spacing().item_spacing.x).max(36.0);
    ui.add(slider.update_while_editing(false)).labelled_by(label).on_hover_text(about)
}

/// Shows a number: as a slider if its range has two bounds, or else as a field to drag, in steps that grow with the
/// number.
fn number(
    ui: &mut Ui,
    value: f32,
    range: (Bound<f32>, Bound<f32>),
    suffix: &str,
    label: Id,
    about: &str,
) -> Option<f32> {
    let bound = |bound: Bound<f32>| match bound {
        // The library reports a value that is at an excluded bound.
        Bound::Included(bound) | Bound::Excluded(bound) => Some(bound),
        Bound::Unbounded => None,
    };
    let shown = |value: f64, _: std::ops::RangeInclusive<usize>| Value::Number(value as f32).to_string();
    let mut new = value;
    let response = match (bound(range.0), bound(range.1)) {
        (Some(from), Some(to)) => {
            slide(ui, Slider::new(&mut new, from..=to).suffix(suffix).custom_formatter(shown), label, about)
        }
        (from, to) => {
            let range = from.unwrap_or(f32::MIN)..=to.unwrap_or(f32::MAX);
            let drag = DragValue::new(&mut new)
                .range(range)
                .speed(f64::from(value.abs().max(1e-6)) * 0.01)
                .suffix(suffix)
                .custom_formatter(shown);
            ui.add(drag.update_while_editing(false))
                .labelled_by(label)
                .on_hover_text(format!("{about}\n\nDrag, or click to type."))
        }
    };
    if response.dragged() {
        new = rounded(new);
    }
    (new != value).then_some(new)
}

/// Rounds a dragged number to three digits.
fn rounded(value: f32) -> f32 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

fn choice(
    ui: &mut Ui,
    parameter: &Parameter,
    options: &[Choice],
    value: &str,
    label: Id,
    about: &str,
) -> Option<Value> {
    let mut new = value;
    let menu = ComboBox::from_id_salt(&parameter.name)
        .width(ui.available_width() - ui.spacing().item_spacing.x)
        .truncate()
        .selected_text(value);
    let menu = menu.show_ui(ui, |ui| {
        for option in options {
            ui.selectable_value(&mut new, option.name, option.name).on_hover_text(&option.documentation);
        }
    });
    menu.response.labelled_by(label).on_hover_text(about);
    (new != value).then(|| new.into())
}

fn set(ui: &mut Ui, options: &[Choice], names: &[String]) -> Option<Value> {
    let mut change = None;
    ui.spacing_mut().item_spacing.x = 2.0;
    ui.spacing_mut().button_padding.x = 4.0;
    for option in options {
        let is_in = names.iter().any(|name| name == option.name);
        if ui.selectable_label(is_in, option.name).on_hover_text(&option.documentation).clicked() {
            let stays = |other: &&Choice| (other.name == option.name) != names.iter().any(|name| name == other.name);
            change = Some(Value::Set(options.iter().filter(stays).map(|option| option.name.to_owned()).collect()));
        }
    }
    change
}
