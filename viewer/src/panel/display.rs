//! How values become colours: exposure, tone, false colours, histogram.

use eframe::egui::{
    Align2, Color32, ComboBox, DragValue, FontId, Grid, Rect, RichText, Role, Sense, Slider, Ui, Vec2, WidgetInfo,
};

use crate::action::Action;
use crate::layer::{Histogram, Kind, Layer, Scale};
use crate::view::canvas::titled;
use crate::view::colormap::Colormap;
use crate::view::numbers::number;
use crate::view::{Channel, Display, Tone};

/// Shows the panel for layer A.
pub fn show(ui: &mut Ui, layer: Option<&Layer>, display: &Display) -> Vec<Action> {
    let Some(layer) = layer else {
        ui.label("Open a file to see its layers.");
        return Vec::new();
    };
    // The widgets change a copy.
    let mut edited = display.clone();
    let description = &layer.description;
    ui.label(RichText::new(titled(&description.title, description.unit)).strong());
    ui.label(RichText::new(&description.about).weak());
    ui.separator();

    ui.label(RichText::new("Colour").strong());
    slider(
        ui,
        "exposure",
        "Stops: colours are multiplied by 2 to the power of this (E, Shift+E)",
        &mut edited.exposure,
        -12.0,
        12.0,
    );
    slider(ui, "offset", "Added after the exposure (O, Shift+O)", &mut edited.offset, -1.0, 1.0);
    choice(ui, "tone", &mut edited.tone, &Tone::ALL, Tone::title);
    if edited.tone == Tone::Gamma {
        slider(ui, "gamma", "Colours become x^(1/gamma)", &mut edited.gamma, 0.5, 4.0);
    }
    choice(ui, "channel", &mut edited.channel, &Channel::ALL, Channel::title);
    ui.separator();

    if let Kind::Scalar(_) = description.kind {
        ui.label(RichText::new("False colour").strong());
        false_color(ui, &mut edited, layer);
        ui.checkbox(&mut edited.shares_scale, "one scale for A and B")
            .on_hover_text("Layer B is shown on the scale of A, where both are numbers (L)");
        ui.separator();
    }

    ui.label(RichText::new("Histogram").strong());
    histogram(ui, &layer.histogram, description.kind);
    ui.add_space(6.0);
    let mut actions = Vec::new();
    if edited != *display {
        actions.push(Action::SetDisplay(Box::new(edited)));
    }
    if ui.button("Reset").on_hover_text("Exposure, offset and ranges as at the start (N)").clicked() {
        actions.push(Action::ResetDisplay);
    }
    actions
}

/// Shows a labelled slider.
fn slider(ui: &mut Ui, name: &str, about: &str, value: &mut f32, least: f32, most: f32) {
    ui.horizontal(|ui| {
        let label = ui.add_sized([72.0, 18.0], eframe::egui::Label::new(name)).on_hover_text(about);
        ui.spacing_mut().slider_width = (ui.available_width() - 70.0).max(60.0);
        ui.add(Slider::new(value, least..=most).max_decimals(2)).labelled_by(label.id).on_hover_text(about);
    });
}

/// Shows a labelled menu of a few values.
fn choice<T: Copy + PartialEq>(ui: &mut Ui, name: &str, value: &mut T, all: &[T], title: fn(T) -> &'static str) {
    ui.horizontal(|ui| {
        let label = ui.add_sized([72.0, 18.0], eframe::egui::Label::new(name));
        let menu = ComboBox::from_id_salt(name).selected_text(title(*value)).show_ui(ui, |ui| {
            for option in all {
                ui.selectable_value(value, *option, title(*option));
            }
        });
        menu.response.labelled_by(label.id);
    });
}

fn false_color(ui: &mut Ui, display: &mut Display, layer: &Layer) {
    let (mut range, mut scale) = display.scale_of(layer);
    let before = (range, scale);
    choice(ui, "scale", &mut scale, &[Scale::Linear, Scale::Log, Scale::Diverging], |scale| match scale {
        Scale::Linear => "linear",
        Scale::Log => "logarithmic",
        Scale::Diverging => "diverging",
    });
    if scale != Scale::Diverging {
        choice(ui, "colours", &mut display.colormap, &Colormap::SEQUENTIAL, Colormap::title);
    }
    Grid::new("range").num_columns(2).show(ui, |ui| {
        let speed = f64::from(range.high - range.low) / 200.0;
        for (name, value) in [("from", &mut range.low), ("to", &mut range.high)] {
            let label = ui.add_sized([72.0, 18.0], eframe::egui::Label::new(name));
            let drag = DragValue::new(value).speed(speed).custom_formatter(|value, _| number(value as f32));
            ui.add(drag).labelled_by(label.id).on_hover_text("Drag, or click to type");
            ui.end_row();
        }
    });
    if scale == Scale::Diverging && before.1 != scale {
        let most = range.high.abs().max(range.low.abs());
        (range.low, range.high) = (-most, most);
    }
    if scale == Scale::Log {
        range.high = range.high.max(f32::MIN_POSITIVE);
        range.low = range.low.clamp(range.high * 1e-12, range.high * 0.999);
    }
    if range.low >= range.high {
        (range, scale) = before;
    }
    if (range, scale) != before {
        display.scales.insert(layer.name().to_owned(), (range, scale));
    }
    if display.scales.contains_key(layer.name())
        && ui.button("Automatic").on_hover_text("The range that shows most of the values").clicked()
    {
        display.scales.remove(layer.name());
    }
}

/// Draws the bars of all planes over one another, on a square-root scale so that rare values are visible.
fn histogram(ui: &mut Ui, histogram: &Histogram, kind: Kind) {
    let size = Vec2::new(ui.available_width(), 96.0);
    let (rect, response) = ui.allocate_exact_size(size, Sense::hover());
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, "histogram"));
    let painter = ui.painter();
    painter.rect_filled(rect, 2.0, Color32::from_gray(20));
    let colors = match (histogram.counts.len(), kind) {
        (1, _) => vec![Color32::from_gray(200)],
        _ => vec![Color32::from_rgb(170, 45, 45), Color32::from_rgb(40, 140, 40), Color32::from_rgb(60, 80, 200)],
    };
    // If one value fills the image, such as a black background, its bar would make the others too small to see.
    let mut counts: Vec<u32> = histogram.counts.iter().flatten().copied().collect();
    counts.sort_unstable();
    let most = counts[counts.len().saturating_sub(4)].max(1) as f32;
    let width = rect.width() / Histogram::BINS as f32;
    for bin in 0..Histogram::BINS {
        for (plane, color) in histogram.counts.iter().zip(&colors) {
            let height = (plane[bin] as f32 / most).sqrt().min(1.0) * rect.height();
            let left = rect.left() + bin as f32 * width;
            let bar = Rect::from_min_max((left, rect.bottom() - height).into(), (left + width, rect.bottom()).into());
            painter.rect_filled(bar, 0.0, color.additive());
        }
    }
    let edge = |value: f32| if histogram.logarithmic { number(value.exp2()) } else { number(value) };
    let font = FontId::monospace(11.0);
    ui.horizontal(|ui| {
        let (row, _) = ui.allocate_exact_size(Vec2::new(rect.width(), 12.0), Sense::hover());
        let color = ui.visuals().text_color();
        ui.painter().text(row.left_center(), Align2::LEFT_CENTER, edge(histogram.first), font.clone(), color);
        let middle = if histogram.logarithmic { "logarithmic" } else { "linear" };
        ui.painter().text(
            row.center(),
            Align2::CENTER_CENTER,
            middle,
            FontId::proportional(11.0),
            ui.visuals().weak_text_color(),
        );
        ui.painter().text(row.right_center(), Align2::RIGHT_CENTER, edge(histogram.last), font, color);
    });
    let bad = if histogram.not_finite > 0 { format!(", {} not finite", histogram.not_finite) } else { String::new() };
    ui.label(format!(
        "least {}, mean {}, most {}{bad}",
        number(histogram.least),
        number(histogram.mean as f32),
        number(histogram.most)
    ));
}
