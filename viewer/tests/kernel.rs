//! The kernel's panel: what it draws and tells against the library's numbers.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod common;

use std::sync::Arc;

use common::{settle, testdata, window};
use eframe::egui::{Key, Modifiers, Pos2, Rect};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use stein::{Denoiser, FilterKernel, Image, Kernels, Method, Options, Preset};
use stein_viewer::document::Source;
use stein_viewer::inspector::{Inspected, Quantity, cell_at, offset_of};
use stein_viewer::layer::Scale;
use stein_viewer::panel::Panel;
use stein_viewer::settings::Parameters;
use stein_viewer::view::colormap::Colormap;
use stein_viewer::view::numbers::{number, short};
use stein_viewer::{Start, Viewer};

/// Close to the upper left corner, so that the window is cut.
const PIXEL: [u32; 2] = [5, 40];
const NEIGHBOUR: [i32; 2] = [3, -2];

fn open(method: &str, pixel: Option<[u32; 2]>) -> Harness<'static, Viewer> {
    let mut parameters = Parameters::of(method, Preset::Default).unwrap();
    if method != "gem" {
        parameters.method = parameters.method.with_parameter("window_radius", 6).unwrap();
    }
    let source = Some(Source::whole(testdata("dof_spheres_32spp.exr"), None));
    window(Start {
        source,
        parameters: Some(parameters),
        panel: Panel::Kernel,
        pixel,
        neighbour: Some(NEIGHBOUR),
        ..Default::default()
    })
}

fn inspected(harness: &Harness<'static, Viewer>) -> Arc<Inspected> {
    harness.state().inspector.inspected.clone().unwrap()
}

/// Asked apart from the window.
fn by_the_library(viewer: &Viewer, [x, y]: [u32; 2]) -> Kernels {
    let document = viewer.document.as_ref().unwrap();
    let method: Method = document.denoised.as_ref().unwrap().parameters.method;
    let options = Options { keep: method.intermediates(), ..Default::default() };
    Denoiser::new(&viewer.gpu, method).unwrap().kernels(&document.opened.frame, x, y, &options).unwrap()
}

fn same_bits(a: &Image, b: &Image) -> bool {
    let bits = |image: &Image| image.planes.iter().flatten().map(|value| value.to_bits()).collect::<Vec<_>>();
    a.extent == b.extent && bits(a) == bits(b)
}

#[test]
fn the_weights_that_are_drawn_are_the_library_s() {
    for method in Parameters::METHODS {
        let harness = open(method, Some(PIXEL));
        let (shown, kernels) = (inspected(&harness), by_the_library(harness.state(), PIXEL));
        assert!(!kernels.filters.is_empty() && shown.windows.len() == kernels.filters.len(), "{method}");
        for (window, filter) in shown.windows.iter().zip(&kernels.filters) {
            let what = format!("{method}, {}", filter.name);
            assert!(same_bits(&window.weights.image, &filter.weights), "{what}");
            assert!(same_bits(&window.colors.image, &filter.colors), "{what}");
            for (alone, distance) in window.alone.iter().zip(&filter.distances) {
                assert!(same_bits(&alone.image, &distance.weights), "{what}, {}", distance.of.name());
            }
            let weights = || filter.weights.planes[0].iter().map(|weight| f64::from(*weight));
            let effective = weights().sum::<f64>().powi(2) / weights().map(|weight| weight * weight).sum::<f64>();
            assert!((f64::from(window.effective_pixels) / effective - 1.0).abs() < 1e-5, "{what}");
            harness.get_by_label(&format!("filter {}", filter.name));
        }
    }
}

/// The colour of a cell of the large window, on a logarithmic or linear scale from 0.001 or 0 to 1.
fn colour_of(weight: f32, scale: Scale) -> [f32; 3] {
    let place = match scale {
        Scale::Log => 1.0 + weight.max(1e-3).log10() / 3.0,
        _ => weight,
    };
    Colormap::Viridis.color(place).map(|channel| channel * 255.0)
}

/// The middle of each cell, but for those that are outlined and their neighbours.
fn check_cells(
    harness: &mut Harness<'static, Viewer>,
    filter: &FilterKernel,
    image: &Image,
    scale: Scale,
    neighbour: [i32; 2],
) {
    let rect: Rect = harness.get_by_label("window of weights").rect();
    let picture = harness.render().unwrap();
    let side = filter.side();
    let outlined = [side * side / 2, cell_at(filter, neighbour).unwrap()];
    let mut inside = 0;
    for cell in (0..side * side).filter(|cell| !outlined.contains(cell)) {
        let size = rect.width() / side as f32;
        let place: Pos2 =
            rect.min + size * eframe::egui::Vec2::new((cell % side) as f32 + 0.5, (cell / side) as f32 + 0.5);
        let found = picture.get_pixel(place.x as u32, place.y as u32).0;
        if filter.pixel(cell).is_none() {
            assert!(found[0] == found[1] && found[1] == found[2], "a cell outside of the frame is {found:?}");
            continue;
        }
        inside += 1;
        let expected = colour_of(image.planes[0][cell], scale);
        let off = found
            .iter()
            .zip(expected)
            .map(|(found, expected)| (f32::from(*found) - expected).abs())
            .fold(0.0, f32::max);
        assert!(off <= 2.5, "cell {cell} is {found:?}, its weight {} should be {expected:?}", image.planes[0][cell]);
    }
    assert!(inside > side);
}

#[test]
fn the_picture_of_a_window_shows_its_weights() {
    let mut harness = open("dfc", Some(PIXEL));
    let shown = inspected(&harness);
    let place = shown.kernels.filters.iter().position(|filter| !filter.distances.is_empty()).unwrap();
    let filter = &shown.kernels.filters[place];
    harness.get_by_label(&format!("filter {}", filter.name)).click();
    harness.run_steps(3);
    assert_eq!(harness.state().inspector.filter, place);
    assert!(filter.pixel(0).is_none(), "the window is cut");
    check_cells(&mut harness, filter, &filter.weights, Scale::Log, NEIGHBOUR);
    harness.get_by_label("linear").click();
    harness.run_steps(3);
    check_cells(&mut harness, filter, &filter.weights, Scale::Linear, NEIGHBOUR);
    let distance = &filter.distances[0];
    harness.state_mut().inspector.quantity = Quantity::Alone(distance.of.clone());
    harness.run_steps(3);
    check_cells(&mut harness, filter, &distance.weights, Scale::Linear, NEIGHBOUR);
}

#[test]
fn the_chosen_neighbour_s_distances_are_the_library_s() {
    let harness = open("dfc", Some(PIXEL));
    let kernels = by_the_library(harness.state(), PIXEL);
    let filter = &kernels.filters[0];
    let cell = cell_at(filter, NEIGHBOUR).unwrap();
    let (x, y) = filter.pixel(cell).unwrap();
    harness.get_by_label(&format!("Neighbour ({x}, {y}), offset (+3, -2)"));
    harness.get_by_label_contains(&format!("w {}, ", number(filter.weights.planes[0][cell])));
    assert!(!filter.distances.is_empty());
    for distance in &filter.distances {
        assert!(harness.query_all_by_label(distance.of.name()).next().is_some(), "{}", distance.of.name());
        for image in [&distance.distances, &distance.weights] {
            assert!(
                harness.query_all_by_label(&number(image.planes[0][cell])).next().is_some(),
                "{}",
                distance.of.name()
            );
        }
    }
    assert_eq!(harness.query_by_label("decides").is_some(), filter.decided_by(cell).is_some());
    let marked = harness.state().view.marked.unwrap();
    assert_eq!((marked.pixel, marked.radius, marked.neighbour), (PIXEL, filter.window_radius, Some([x, y])));
}

/// Shows the filter of this name, and this neighbour.
fn choose(harness: &mut Harness<'static, Viewer>, name: &str, neighbour: [i32; 2]) {
    harness.state_mut().inspector.kept = Some(neighbour);
    harness.get_by_label(&format!("filter {name}")).click();
    harness.run_steps(3);
}

#[test]
fn the_second_pass_is_a_filter_among_the_others() {
    let pixel = [20, 30];
    let mut harness = open("dfc", Some(pixel));
    let shown = inspected(&harness);
    let names: Vec<_> = shown.kernels.filters.iter().map(|filter| filter.name).collect();
    assert_eq!(names, ["first", "second", "third", "second_pass"]);
    for filter in &shown.kernels.filters[..3] {
        let text = format!("{:.0} % of pass 1", 100.0 * filter.share.unwrap());
        assert!(harness.query_all_by_label(&text).next().is_some(), "{text}");
    }
    choose(&mut harness, "second_pass", [-2, 1]);
    let filter = &shown.kernels.filters[3];
    assert!(filter.weight_sum > 2.0, "neighbours take part");
    check_cells(&mut harness, filter, &filter.weights, Scale::Log, [-2, 1]);
    harness.get_by_label(&format!("Neighbour ({}, {}), offset (-2, +1)", pixel[0] - 2, pixel[1] + 1));
    harness.get_by_label("told apart by");
    // What is large stands for the result of the run.
    let estimate = harness.state().document.as_ref().unwrap().denoised.as_ref().unwrap().estimate.clone();
    let at = (pixel[1] * estimate.color.extent.width + pixel[0]) as usize;
    for (value, plane) in filter.value.iter().zip(&estimate.color.planes) {
        assert!((value - plane[at]).abs() <= 1e-5 * plane[at].abs(), "{value} and {}", plane[at]);
    }
    assert_eq!(harness.state().view.marked.unwrap().radius, filter.window_radius);
}

/// d of a pair may be large beside a weight of 1: then it is told why.
#[test]
fn a_neighbour_whose_opposite_stands_in_is_told() {
    let mut harness = open("dfc", Some([5, 35]));
    let shown = inspected(&harness);
    let filters = || shown.kernels.filters.iter();
    // How much more it weighs than by itself.
    let gain = |filter: &FilterKernel, cell: usize| {
        filter.distances[0].weights.planes[0][cell] - filter.distances[0].own_weight(cell)
    };
    let cells = filters().flat_map(|filter| (0..filter.weights.extent.pixels()).map(move |cell| (filter, cell)));
    let (filter, cell) = cells
        .filter(|(filter, _)| filter.name != "third")
        .max_by(|(a, i), (b, j)| gain(a, *i).total_cmp(&gain(b, *j)))
        .unwrap();
    assert!(gain(filter, cell) > 0.1);
    let told = |harness: &Harness<'static, Viewer>| harness.query_all_by_label_contains("its opposite (").count();
    choose(&mut harness, filter.name, offset_of(filter, cell));
    let [dx, dy] = offset_of(filter, filter.opposite(cell).unwrap());
    harness.get_by_label_contains(&format!(
        "By colour it would weigh {}, its opposite ({dx:+}, {dy:+})",
        short(filter.distances[0].own_weight(cell))
    ));

    // Nobody stands in for one whose opposite lies outside of the frame.
    let filter = shown.kernels.filter("first").unwrap();
    let alone = cell_at(filter, [6, 0]).unwrap();
    assert_eq!(filter.opposite(alone), None);
    choose(&mut harness, "first", [6, 0]);
    assert_eq!(told(&harness), 0);
}

/// A second pass that goes too far: neighbours weigh nothing, so that no distance decides about them and no pair stands
/// in.
#[test]
fn of_a_refused_filter_no_distance_decides() {
    let mut harness = open("dfc", Some([20, 30]));
    // The one that says most.
    let told = |harness: &Harness<'static, Viewer>| {
        let shown = inspected(harness);
        let filter = shown.kernels.filter("second_pass").unwrap();
        let gain = |cell: &usize| filter.distances[0].weights.planes[0][*cell] - filter.distances[0].own_weight(*cell);
        let cells = (0..filter.weights.extent.pixels()).filter(|cell| filter.decided_by(*cell).is_some());
        let cell = cells.max_by(|a, b| gain(a).total_cmp(&gain(b))).unwrap();
        assert!(gain(&cell) > 0.01);
        offset_of(filter, cell)
    };
    let neighbour = told(&harness);
    choose(&mut harness, "second_pass", neighbour);
    harness.get_by_label("as pair, decides");

    let viewer = harness.state_mut();
    let method = viewer.parameters.method.with_parameter("second_pass.most_sigmas", 1e-6).unwrap();
    viewer.take_parameters(Parameters { method, ..viewer.parameters });
    settle(&mut harness);
    assert_eq!(told(&harness), neighbour);
    harness.get_by_label("told apart by");
    harness.get_by_label_contains("is refused: pass 1 is the result");
    harness.get_by_label_contains("w 0, 0.00 % of Σw");
    for text in ["decides", "as pair", "its opposite (", "Nothing speaks against", "neighbours decided"] {
        assert_eq!(harness.query_all_by_label_contains(text).count(), 0, "{text}");
    }
}

#[test]
fn a_pixel_is_chosen_by_click_and_moved_by_keys() {
    let mut harness = open("dfc", None);
    harness.get_by_label_contains("Click a pixel");
    let middle = harness.get_by_label_contains("image: ").rect().center();
    harness.hover_at(middle);
    harness.run_steps(2);
    harness.drag_at(middle);
    harness.drop_at(middle);
    settle(&mut harness);
    let clicked = harness.state().view.pinned.unwrap();
    assert_eq!(inspected(&harness).question.pixel, clicked);

    harness.key_press_modifiers(Modifiers::SHIFT, Key::ArrowLeft);
    harness.key_press(Key::ArrowUp);
    settle(&mut harness);
    let moved = [clicked[0] - 10, clicked[1] - 1];
    assert_eq!(harness.state().view.pinned, Some(moved));
    assert_eq!(inspected(&harness).question.pixel, moved);

    harness.hover_at(middle);
    harness.run_steps(2);
    assert_eq!(harness.state().view.hovered, Some(clicked));
    harness.key_press_modifiers(Modifiers::SHIFT, Key::K);
    settle(&mut harness);
    assert_eq!(inspected(&harness).question.pixel, clicked);

    harness.key_press(Key::K);
    settle(&mut harness);
    assert_eq!((harness.state().panel, harness.state().view.marked), (Panel::Display, None));
    harness.key_press(Key::K);
    settle(&mut harness);
    assert_eq!(harness.state().panel, Panel::Kernel);
}

#[test]
fn a_change_of_parameters_asks_again() {
    let mut harness = open("dfc", Some(PIXEL));
    assert_eq!(inspected(&harness).kernels.filters[0].window_radius, 6);
    let viewer = harness.state_mut();
    let method = viewer.parameters.method.with_parameter("window_radius", 3).unwrap();
    viewer.take_parameters(Parameters { method, ..viewer.parameters });
    settle(&mut harness);
    assert_eq!(inspected(&harness).kernels.filters[0].window_radius, 3);
    assert_eq!(
        inspected(&harness).question.method,
        harness.state().document.as_ref().unwrap().denoised.as_ref().unwrap().parameters.method
    );
}

/// Three candidates as three colours, on the result of a run and not only on made-up numbers.
#[test]
fn the_selection_is_drawn_in_the_library_s_shares() {
    let mut harness = open("dfc", Some(PIXEL));
    harness.state_mut().panel = Panel::Display;
    harness.state_mut().view.layer = "selection".into();
    harness.state_mut().view.pinned = None;
    harness.run_steps(3);
    let rect = harness.get_by_label("image: selection").rect();
    let picture = harness.render().unwrap();
    let viewer = harness.state();
    let shares = viewer.document.as_ref().unwrap().denoised.as_ref().unwrap().estimate.selection.clone().unwrap();
    let (width, height) = (shares.extent.width, shares.extent.height);
    let mut checked = 0;
    for y in (1..height - 1).step_by(3) {
        // Below lies the legend.
        for x in (1..width - 1).step_by(3) {
            let place = viewer.view.camera.to_screen(rect, eframe::egui::Vec2::new(x as f32 + 0.5, y as f32 + 0.5));
            if place.y > rect.bottom() - 40.0 {
                continue;
            }
            let found = picture.get_pixel(place.x as u32, place.y as u32).0;
            let expected =
                [0, 1, 2].map(|plane| shares.planes[plane][(y * width + x) as usize].clamp(0.0, 1.0) * 255.0);
            let off = found
                .iter()
                .zip(expected)
                .map(|(found, expected)| (f32::from(*found) - expected).abs())
                .fold(0.0, f32::max);
            assert!(off <= 1.5, "({x}, {y}) is {found:?}, its shares are {expected:?}");
            checked += 1;
        }
    }
    assert!(checked > 200);
}

#[test]
fn the_title_tells_the_file_that_is_open() {
    let mut harness = open("gem", None);
    harness.state_mut().open(Source::whole(testdata("cornell_8spp.exr"), None));
    let mut titles = Vec::new();
    while titles.is_empty() {
        harness.step();
        let commands = harness.output().viewport_output.values().flat_map(|output| output.commands.clone());
        titles.extend(commands.filter(|command| matches!(command, eframe::egui::ViewportCommand::Title(_))));
    }
    assert_eq!(titles, [eframe::egui::ViewportCommand::Title("cornell_8spp.exr - Stein".into())]);
    settle(&mut harness);
}
