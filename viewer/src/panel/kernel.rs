//! The kernel panel: which neighbours made the chosen pixel, with which weights, and which distances led to the
//! weights.

use std::ops::RangeInclusive;

use eframe::egui::{
    Color32, ComboBox, Grid, Painter, Pos2, Rect, Response, RichText, Role, Sense, Stroke, StrokeKind, Ui, Vec2,
    WidgetInfo,
};
use stein::FilterKernel;
use stein::kernels::{Compared, Distance, WeightRule};
use stein::method::PlannedStep;

use super::status::joined;
use crate::inspector::{
    FilterWindow, Inspected, Inspector, InspectorAction, Quantity, cell_at, explained_cell, offset_of,
};
use crate::layer::{Kind, Range, Scale, Shown};
use crate::view::canvas::{NEIGHBOUR, outline};
use crate::view::numbers::{number, short};
use crate::view::{View, legend};

/// Largest side of a filter's small window, in points.
const SMALL: f32 = 72.0;
/// Smallest and largest side of the large window, in points.
const LARGE: RangeInclusive<f32> = 200.0..=460.0;
/// Height of all other parts of the panel except for the table, and of a line of the table, in points.
const OTHERS: f32 = 336.0;
const LINE: f32 = 16.0;
/// The weight of a neighbour is explained if it is larger than `TOLD_APART` times the weight that the neighbour would
/// have by itself, plus `LEAST_TOLD`, a difference that is too small to be seen.
const TOLD_APART: f32 = 1.01;
const LEAST_TOLD: f32 = 5e-4;
/// Space between two small windows, in points.
const GAP: f32 = 4.0;
/// Distance between the lines that mark the outside of the frame, in points.
const HATCH: f32 = 5.0;

/// Shows the panel. `is_denoised` tells whether the open frame has kernels.
pub fn show(ui: &mut Ui, inspector: &Inspector, view: &View, is_denoised: bool) -> Vec<InspectorAction> {
    let mut actions = Vec::new();
    ui.spacing_mut().item_spacing.y = 2.0;
    ui.horizontal(|ui| {
        let pixel = inspector.inspected.as_ref().map(|inspected| inspected.question.pixel);
        ui.label(RichText::new(pixel.map_or_else(|| "No pixel".into(), |[x, y]| format!("Pixel ({x}, {y})"))).strong());
        let mut follows = inspector.follows;
        ui.checkbox(&mut follows, "follow the pointer").on_hover_text("Shift+K; or hold Ctrl");
        if follows != inspector.follows {
            actions.push(InspectorAction::ToggleFollow);
        }
        if inspector.waits() {
            ui.spinner();
        }
    });
    let Some(inspected) = &inspector.inspected else {
        point(inspector, None, &mut actions);
        if is_denoised {
            ui.label("Click a pixel to see which neighbours it was made of, and why.");
        } else {
            ui.label("The kernel can be seen once a frame is denoised.");
        }
        return actions;
    };
    filters(ui, inspector, view, inspected, &mut actions);
    let Some((filter, window)) = inspector.shown(inspected) else {
        point(inspector, None, &mut actions);
        ui.label("Nothing is filtered: the frame stays as it is.");
        explanations(ui, inspected, None);
        return actions;
    };
    ui.separator();
    let quantity = head(ui, inspector, filter, &mut actions);
    match large(ui, inspector, view, (filter, window), &quantity, &mut actions) {
        Some(cell) => neighbour(ui, view, (filter, window), cell),
        None => {
            ui.label(
                "Point at a cell, or at the image inside of the window, to see what told that neighbour from \
                 the pixel. Click a cell to keep it.",
            );
        }
    }
    ui.separator();
    explanations(ui, inspected, Some((filter, window)));
    actions
}

/// Records the neighbour under the pointer, if it is another one than before.
fn point(inspector: &Inspector, offset: Option<[i32; 2]>, actions: &mut Vec<InspectorAction>) {
    if inspector.pointed != offset {
        actions.push(InspectorAction::Point(offset));
    }
}

/// Shows how the weights came about, and which steps are left out.
fn explanations(ui: &mut Ui, inspected: &Inspected, shown: Option<(&FilterKernel, &FilterWindow)>) {
    let left_out = inspected
        .kernels
        .plan
        .steps()
        .into_iter()
        .filter(|planned| !planned.runs && planned.makes_kernels)
        .map(left_out);
    let of_filter = shown.into_iter().flat_map(|(filter, window)| [rule(filter), decisions(filter, window)]);
    for text in of_filter.chain(left_out).filter(|text| !text.is_empty()) {
        ui.label(RichText::new(text).size(11.5));
    }
}

fn left_out(planned: &PlannedStep) -> String {
    format!("{} is left out: {}", title(&planned.name), planned.why)
}

/// Returns the title of a filter, as its layer is called.
fn title(filter: &str) -> String {
    match filter {
        "first" | "second" | "third" => filter.to_uppercase(),
        other => other.replace('_', " "),
    }
}

/// Shows the windows of all filters side by side, with their results.
fn filters(ui: &mut Ui, inspector: &Inspector, view: &View, inspected: &Inspected, actions: &mut Vec<InspectorAction>) {
    let count = inspected.windows.len().max(1) as f32;
    let width = (ui.available_width() - GAP * (count - 1.0)) / count;
    let side = width.min(SMALL);
    ui.horizontal_top(|ui| {
        ui.spacing_mut().item_spacing.x = GAP;
        for (place, (filter, window)) in inspected.kernels.filters.iter().zip(&inspected.windows).enumerate() {
            ui.vertical(|ui| {
                // Long lines are wrapped, so that the panel keeps its width.
                ui.set_width(width);
                ui.spacing_mut().item_spacing.y = 1.0;
                let is_shown = inspector.filter.min(inspected.windows.len() - 1) == place;
                let (rect, response) = ui.allocate_exact_size(Vec2::splat(side), Sense::click());
                response.widget_info(|| {
                    WidgetInfo::selected(Role::Button, true, is_shown, format!("filter {}", filter.name))
                });
                if response.clicked() {
                    actions.push(InspectorAction::SelectFilter(place));
                }
                let scale = inspector.scale_of_weights();
                paint(ui.painter(), view, rect, filter, (&window.weights, Kind::Scalar(scale.1)), scale);
                if is_shown {
                    ui.painter().rect_stroke(
                        rect,
                        0.0,
                        Stroke::new(2.0, ui.visuals().strong_text_color()),
                        StrokeKind::Middle,
                    );
                }
                ui.label(RichText::new(title(filter.name)).strong());
                if let Some(share) = filter.share {
                    let about = "Its share in pass 1 of the pixel: the smoothed selection map there";
                    small(ui, format!("{:.0} % of pass 1", 100.0 * share), about);
                } else if filter.name == "second_pass" {
                    let about = "It averages pass 1, what the candidates were blended to, and makes the result of it";
                    small(ui, "the result".into(), about);
                }
                swatch(ui, view, (&window.value, [0, 0], side), filter.value, "What the filter makes of the pixel");
                let about = "Sum of the weights, and the effective number of pixels, (Σw)²/Σw²: so many of equal \
                             weight leave as much noise";
                small(ui, format!("Σw {}, n {}", short(filter.weight_sum), short(window.effective_pixels)), about);
            });
        }
    });
}

fn small(ui: &mut Ui, text: String, about: &str) {
    ui.label(RichText::new(text).size(10.5)).on_hover_text(about);
}

/// Shows a pixel of an image in the colours of the canvas, with its values under it.
fn swatch(ui: &mut Ui, view: &View, (image, place, width): (&Shown, [usize; 2], f32), color: [f32; 3], about: &str) {
    let (rect, response) = ui.allocate_exact_size(Vec2::new(width, 10.0), Sense::hover());
    view.paint_pixel(ui.painter(), rect, image.clone(), place);
    response.on_hover_text(about);
    let text = RichText::new(color.map(short).join(" ")).size(9.5);
    ui.label(text).on_hover_text(format!("{about}: {}", joined(&color)));
}

/// Shows the choice of the large window's quantity and scale. Returns the quantity.
fn head(ui: &mut Ui, inspector: &Inspector, filter: &FilterKernel, actions: &mut Vec<InspectorAction>) -> Quantity {
    let name = |quantity: &Quantity| match quantity {
        Quantity::Weight => "weights".to_owned(),
        Quantity::Colors => "what is averaged".to_owned(),
        Quantity::Alone(of) => format!("weights by {} alone", of.name()),
    };
    // The filters differ in patch radius and τ. The same distance is therefore found in each filter by its name.
    let mut quantity = match &inspector.quantity {
        Quantity::Alone(of) => same_distance(filter, of)
            .map_or(Quantity::Weight, |place| Quantity::Alone(filter.distances[place].of.clone())),
        other => other.clone(),
    };
    let mut scale = inspector.scale;
    ui.horizontal(|ui| {
        let alone = filter.distances.iter().map(|distance| Quantity::Alone(distance.of.clone()));
        ComboBox::from_id_salt("quantity").selected_text(name(&quantity)).show_ui(ui, |ui| {
            for option in [Quantity::Weight, Quantity::Colors].into_iter().chain(alone) {
                let text = name(&option);
                ui.selectable_value(&mut quantity, option, text);
            }
        });
        for (option, text) in [(Scale::Log, "log"), (Scale::Linear, "linear")] {
            ui.selectable_value(&mut scale, option, text);
        }
    });
    if quantity != inspector.quantity {
        actions.push(InspectorAction::ShowQuantity(quantity.clone()));
    }
    if scale != inspector.scale {
        actions.push(InspectorAction::SetScale(scale));
    }
    quantity
}

fn same_distance(filter: &FilterKernel, of: &Compared) -> Option<usize> {
    filter.distances.iter().position(|distance| distance.of.name() == of.name())
}

/// Shows the window as large as the space permits, its legend, and the cell under the pointer. Returns the cell of the
/// neighbour to explain.
fn large(
    ui: &mut Ui,
    inspector: &Inspector,
    view: &View,
    (filter, window): (&FilterKernel, &FilterWindow),
    quantity: &Quantity,
    actions: &mut Vec<InspectorAction>,
) -> Option<usize> {
    // Leaves space for the table.
    let room = ui.clip_rect().height() - OTHERS - LINE * filter.distances.len() as f32;
    let side = ui.available_width().min(room.clamp(*LARGE.start(), *LARGE.end()));
    let (rect, response) = ui.allocate_exact_size(Vec2::splat(side), Sense::click());
    response.widget_info(|| WidgetInfo::labeled(Role::Image, true, "window of weights"));
    let scale = inspector.scale_of_weights();
    let (shown, kind) = match quantity {
        Quantity::Weight => (&window.weights, Kind::Scalar(scale.1)),
        Quantity::Colors => (&window.colors, Kind::Color),
        Quantity::Alone(of) => {
            (same_distance(filter, of).map_or(&window.weights, |place| &window.alone[place]), Kind::Scalar(scale.1))
        }
    };
    paint(ui.painter(), view, rect, filter, (shown, kind), scale);

    let pointed = cell_under_pointer(&response, rect, filter).or_else(|| on_canvas(inspector, view, filter));
    point(inspector, pointed, actions);
    let mut kept = inspector.kept;
    if let Some(offset) = pointed.filter(|_| response.clicked()) {
        kept = if kept == Some(offset) { None } else { Some(offset) };
        actions.push(InspectorAction::Keep(kept));
    }
    let explained = explained_cell(filter, pointed, kept);
    let middle = filter.weights.extent.pixels() / 2;
    outline(ui.painter(), cell_rect(rect, filter, middle), Color32::YELLOW);
    if let Some(cell) = explained {
        outline(ui.painter(), cell_rect(rect, filter, cell), NEIGHBOUR);
    }
    if let Kind::Scalar(_) = kind {
        let (row, _) = ui.allocate_exact_size(Vec2::new(side, 26.0), Sense::hover());
        let bar = Rect::from_min_size(row.min + Vec2::new(0.0, 2.0), Vec2::new(side, 8.0));
        legend::bar(ui.painter(), bar, scale, view.display.colormap, ui.visuals().text_color());
    }
    explained
}

/// Draws an image of a window's size, hatched outside of the frame; numbers are on the given scale.
fn paint(
    painter: &Painter,
    view: &View,
    rect: Rect,
    filter: &FilterKernel,
    (shown, kind): (&Shown, Kind),
    scale: (Range, Scale),
) {
    view.paint_image(painter, rect, shown.clone(), kind, scale);
    let inside = inside(rect, filter);
    let beside = [
        Rect::from_min_max(rect.min, Pos2::new(inside.left(), rect.bottom())),
        Rect::from_min_max(Pos2::new(inside.right(), rect.top()), rect.max),
        Rect::from_min_max(Pos2::new(inside.left(), rect.top()), Pos2::new(inside.right(), inside.top())),
        Rect::from_min_max(Pos2::new(inside.left(), inside.bottom()), Pos2::new(inside.right(), rect.bottom())),
    ];
    for outside in beside.into_iter().filter(|outside| outside.width() > 0.0 && outside.height() > 0.0) {
        hatch(&painter.with_clip_rect(outside.intersect(painter.clip_rect())), outside, rect);
    }
}

/// Draws lines that continue from one part of the outside to the next.
fn hatch(painter: &Painter, outside: Rect, whole: Rect) {
    painter.rect_filled(outside, 0.0, Color32::from_gray(70));
    let lines = (2.0 * whole.width() / HATCH) as usize;
    for line in 0..=lines {
        let x = whole.left() + line as f32 * HATCH;
        let from = Pos2::new(x, whole.top());
        painter.line_segment(
            [from, from + Vec2::new(-whole.height(), whole.height())],
            Stroke::new(1.0, Color32::from_gray(150)),
        );
    }
}

/// Returns the rectangle of the cells that are inside of the frame.
fn inside(rect: Rect, filter: &FilterKernel) -> Rect {
    let mut cells = (0..filter.weights.extent.pixels()).filter(|cell| filter.pixel(*cell).is_some());
    match (cells.next(), cells.next_back()) {
        (Some(first), Some(last)) => cell_rect(rect, filter, first).union(cell_rect(rect, filter, last)),
        _ => rect,
    }
}

fn cell_rect(rect: Rect, filter: &FilterKernel, cell: usize) -> Rect {
    let size = rect.width() / filter.side() as f32;
    let corner = Vec2::new((cell % filter.side()) as f32, (cell / filter.side()) as f32) * size;
    Rect::from_min_size(rect.min + corner, Vec2::splat(size))
}

fn cell_under_pointer(response: &Response, rect: Rect, filter: &FilterKernel) -> Option<[i32; 2]> {
    let place = (response.hover_pos()? - rect.min) / rect.width() * filter.side() as f32;
    let last = filter.side() - 1;
    let offset = offset_of(filter, (place.y as usize).min(last) * filter.side() + (place.x as usize).min(last));
    cell_at(filter, offset).map(|_| offset)
}

/// Returns the neighbour under the pointer on the canvas, as an offset from the pixel; `None` unless the pixel is
/// pinned, because otherwise the window follows the pointer.
fn on_canvas(inspector: &Inspector, view: &View, filter: &FilterKernel) -> Option<[i32; 2]> {
    let pixel = inspector.inspected.as_ref()?.question.pixel;
    let hovered = view.hovered.filter(|_| view.pinned == Some(pixel))?;
    let offset = [0, 1].map(|axis| hovered[axis] as i32 - pixel[axis] as i32);
    cell_at(filter, offset).map(|_| offset)
}

/// Describes how the weights came about.
fn rule(filter: &FilterKernel) -> String {
    let side = filter.side();
    let of = if filter.name == "second_pass" { " of pass 1" } else { "" };
    match filter.rule {
        WeightRule::Least if filter.distances.is_empty() => {
            format!("A box of {side}×{side}: nothing tells the neighbours apart.")
        }
        WeightRule::Least => {
            format!("{side}×{side} cells{of}. A neighbour weighs as its largest distance says: the least of exp(−d).")
        }
        WeightRule::Cut { cut } => {
            format!("{side}×{side} cells, exp(−d) of the patches; weights below {} count as 0.", number(cut))
        }
        WeightRule::PatchMean { cut } => {
            format!(
                "{side}×{side} cells. The mean of the weights of all pairs of pixels in the two patches; below {} it \
                 counts as 0.",
                number(cut)
            )
        }
        WeightRule::Gaussian { sigma: 0.0 } => "The pixel filter: no neighbour takes part.".into(),
        WeightRule::Gaussian { sigma } => {
            format!("A Gaussian of σ = {} pixels, by distance on the image alone.", number(sigma))
        }
        WeightRule::Refused { sigmas } => {
            format!(
                "{side}×{side} cells{of}. It would change the pixel by more than {} σ of its noise, and is refused: \
                 pass 1 is the result.",
                number(sigmas)
            )
        }
        WeightRule::Exact => "No pixel with noise is within reach: the pixel is left as it is.".into(),
    }
}

/// Returns whether the neighbours weigh nothing, whatever their distances are.
fn is_refused(filter: &FilterKernel) -> bool {
    matches!(filter.rule, WeightRule::Refused { .. })
}

/// Describes how many neighbours each distance decided about.
fn decisions(filter: &FilterKernel, window: &FilterWindow) -> String {
    if filter.distances.is_empty() || is_refused(filter) {
        return String::new();
    }
    let decided: Vec<_> = filter
        .distances
        .iter()
        .zip(&window.decided)
        .map(|(distance, count)| format!("{} {count}", distance.of.name()))
        .collect();
    let free = window.neighbours - window.decided.iter().sum::<usize>();
    format!("Of {} neighbours decided: {}; {free} are like the pixel in all.", window.neighbours, decided.join(", "))
}

/// Shows position, weight, colour and distances of a neighbour.
fn neighbour(ui: &mut Ui, view: &View, (filter, window): (&FilterKernel, &FilterWindow), cell: usize) {
    let Some((x, y)) = filter.pixel(cell) else { return };
    let [dx, dy] = offset_of(filter, cell);
    let weight = filter.weights.planes[0][cell];
    ui.label(RichText::new(format!("Neighbour ({x}, {y}), offset ({dx:+}, {dy:+})")).strong());
    let color = [0, 1, 2].map(|channel| filter.colors.planes[channel][cell]);
    ui.horizontal(|ui| {
        ui.label(format!("w {}, {:.2} % of Σw", number(weight), 100.0 * weight / filter.weight_sum));
        let place = [cell % filter.side(), cell / filter.side()];
        swatch(ui, view, (&window.colors, place, 28.0), color, "What of the neighbour is averaged");
    });
    if filter.distances.is_empty() {
        return;
    }
    let is_refused = is_refused(filter);
    let decided = filter.decided_by(cell).filter(|_| !is_refused).map(|distance| &distance.of);
    ui.spacing_mut().interact_size.y = LINE;
    Grid::new("distances").num_columns(4).striped(true).spacing([10.0, 2.0]).show(ui, |ui| {
        for (text, about) in [
            ("told apart by", "What is compared"),
            ("d", "Distance, in units of what noise explains; at or below 0 nothing speaks against the neighbour"),
            (
                "alone",
                "The weight that this distance alone would give: exp(−d), or more where the mean of the \
                 neighbour and its opposite stands in for both",
            ),
            ("", ""),
        ] {
            ui.label(RichText::new(text).weak().size(11.5)).on_hover_text(about);
        }
        ui.end_row();
        for distance in &filter.distances {
            let decides = decided == Some(&distance.of);
            let styled = |text: String| if decides { RichText::new(text).strong() } else { RichText::new(text) };
            ui.label(styled(distance.of.name().to_owned())).on_hover_text(compared(&distance.of));
            for image in [&distance.distances, &distance.weights] {
                ui.label(styled(number(image.planes[0][cell])).monospace().size(11.0));
            }
            let as_pair = stands_in(filter, distance, cell);
            let text = match (decides, as_pair.is_some()) {
                (true, true) => "as pair, decides",
                (true, false) => "decides",
                (false, true) => "as pair",
                (false, false) => "",
            };
            let label = ui.label(text);
            if let Some(about) = as_pair {
                label.on_hover_text(about);
            }
            ui.end_row();
        }
    });
    if decided.is_none() && !is_refused {
        ui.label(RichText::new("Nothing speaks against this neighbour.").weak());
    }
    for text in filter.distances.iter().filter_map(|distance| stands_in(filter, distance, cell)) {
        ui.label(RichText::new(text).size(11.5));
    }
}

/// Explains a weight that is larger than its distance gives: returns the weights that the neighbour and its opposite
/// would have by themselves. `None` for other neighbours.
fn stands_in(filter: &FilterKernel, distance: &Distance, cell: usize) -> Option<String> {
    let opposite = filter.opposite(cell).filter(|_| !is_refused(filter))?;
    let [own, of_opposite] = [cell, opposite].map(|cell| distance.own_weight(cell));
    let shown = distance.weights.planes[0][cell];
    (shown > TOLD_APART * own + LEAST_TOLD).then(|| {
        let [dx, dy] = offset_of(filter, opposite);
        let (name, own, of_opposite, shown) = (distance.of.name(), short(own), short(of_opposite), short(shown));
        format!(
            "By {name} it would weigh {own}, its opposite ({dx:+}, {dy:+}) {of_opposite}. Their mean matches the \
             pixel better and stands in: {shown}."
        )
    })
}

/// Describes a distance: the values that are compared, and how strictly.
fn compared(of: &Compared) -> String {
    match of {
        Compared::Color { patch_radius, k } => {
            let side = 2 * patch_radius + 1;
            format!("patches of {side}×{side} pixels; differences count in {} standard deviations", number(*k))
        }
        Compared::Feature { k, tau, .. } => {
            format!(
                "pixel by pixel; k_f = {}, squared differences from τ = {} on count, in squares of the unit range",
                number(*k),
                number(*tau)
            )
        }
    }
}
