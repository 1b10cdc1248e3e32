//! Parameters, what is saved, and error against run time, through the window.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod common;

use std::time::Duration;

use common::{PATIENCE, settle, testdata, window, window_with};
use eframe::egui::accesskit::Role;
use eframe::egui::{Id, Key, Modifiers, Pos2};
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT, Queryable};
use egui_plot::{PlotMemory, PlotPoint};
use stein::parameters::{Kind, Value};
use stein::{Denoiser, Frame, Image, Method, Preset};
use stein_exr::{BufferSet, BufferSetRequest};
use stein_viewer::document::{MeasuredRun, Source};
use stein_viewer::files::Purpose;
use stein_viewer::panel::Panel;
use stein_viewer::panel::plot::PLOT;
use stein_viewer::settings::{Earlier, Parameters, Settings};
use stein_viewer::view::Compare;
use stein_viewer::worker::{Task, rest_after};
use stein_viewer::{Start, Viewer};

const FILE: &str = "cornell_8spp.exr";

/// The file with a small window, so that runs are short, and its parameters in sight.
fn tuning() -> Harness<'static, Viewer> {
    let parameters =
        Parameters { method: Method::default().with_parameter("window_radius", 3).unwrap(), ..Parameters::default() };
    let source = Source::whole(testdata(FILE), None);
    window(Start { source: Some(source), parameters: Some(parameters), panel: Panel::Parameters, ..Default::default() })
}

fn result(harness: &Harness<'static, Viewer>) -> Image {
    harness.state().document.as_ref().unwrap().layer("result").unwrap().image().clone()
}

fn frame() -> Frame {
    let set = BufferSet::read(&BufferSetRequest { input: testdata(FILE), ..Default::default() }).unwrap();
    set.to_frame().unwrap().0
}

fn press(harness: &mut Harness<'static, Viewer>, name: &str) {
    harness.get_by_label(name).click();
    settle(harness);
}

/// The widget of a parameter, which is called like the name beside it.
fn press_value(harness: &mut Harness<'static, Viewer>, name: &str) {
    let widgets: Vec<_> = harness.get_all_by_label(name).collect();
    widgets.into_iter().find(|node| node.accesskit_node().role() == Role::CheckBox).unwrap().click();
    settle(harness);
}

#[test]
fn every_parameter_has_a_widget_under_its_name() {
    let mut harness = window(Start { panel: Panel::Parameters, ..Default::default() });
    for method in Parameters::METHODS {
        harness.state_mut().take_parameters(Parameters::of(method, Preset::Default).unwrap());
        harness.run_steps(2);
        for parameter in harness.state().parameters.method.parameters() {
            let roles: Vec<_> =
                harness.get_all_by_label(&parameter.name).map(|node| node.accesskit_node().role()).collect();
            let role = match parameter.kind {
                Kind::Integer { .. } => Role::Slider,
                Kind::Number { .. } => Role::SpinButton,
                Kind::Flag | Kind::Group => Role::CheckBox,
                Kind::Choice { .. } => Role::ComboBox,
                // Several words, each a button; what they are called together stands before them.
                Kind::Set { .. } => Role::Label,
            };
            assert!(roles.contains(&role), "{method} {}: {roles:?}", parameter.name);
        }
    }
}

#[test]
fn a_changed_parameter_runs_again_changes_the_result_and_can_be_put_back() {
    let mut harness = tuning();
    let before = result(&harness);
    press_value(&mut harness, "second_pass");
    let viewer = harness.state();
    assert_eq!(
        viewer.document.as_ref().unwrap().denoised.as_ref().unwrap().parameters.method,
        viewer.parameters.method
    );
    assert_ne!(result(&harness), before);
    harness.get_by_label("2 not as in default");
    assert!(harness.query_by_label("second_pass.color_k").is_none(), "its group is left out");
    press(&mut harness, "reset second_pass");
    assert_eq!(result(&harness), before);
    press(&mut harness, "Reset all");
    assert_eq!(harness.state().parameters, Parameters::default());
    assert_ne!(result(&harness), before);
}

fn choose(harness: &mut Harness<'static, Viewer>, method: &str) {
    let menu: Vec<_> = harness.get_all_by_label("method").collect();
    menu.into_iter().find(|node| node.accesskit_node().role() == Role::ComboBox).unwrap().click();
    harness.run_steps(2);
    press(harness, method);
}

#[test]
fn a_method_and_preset_that_is_chosen_again_has_its_edits() {
    let mut harness = tuning();
    let edited = harness.state().parameters;
    choose(&mut harness, "nlm");
    assert_eq!(harness.state().parameters, Parameters::of("nlm", Preset::Default).unwrap());
    press_value(&mut harness, "dual_buffer");
    let nlm = harness.state().parameters;
    assert_ne!(nlm, nlm.reset());
    choose(&mut harness, "dfc");
    assert_eq!(harness.state().parameters, edited);
    assert_eq!(harness.state().document.as_ref().unwrap().denoised.as_ref().unwrap().parameters.method, edited.method);
    press(&mut harness, "thesis");
    assert_eq!(harness.state().parameters, Parameters::of("dfc", Preset::Thesis).unwrap());
    press(&mut harness, "default");
    assert_eq!(harness.state().parameters, edited);
    // What was reset is not edited any more, the other method is.
    press(&mut harness, "Reset all");
    choose(&mut harness, "nlm");
    assert_eq!(harness.state().parameters, nlm);
    choose(&mut harness, "dfc");
    assert_eq!(harness.state().parameters, Parameters::default());
}

#[test]
fn a_contradiction_is_told_and_waits_while_the_last_parameters_stay_in_use() {
    let mut harness = tuning();
    let viewer = harness.state_mut();
    let in_use = viewer.parameters;
    let runs = viewer.document.as_ref().unwrap().history.len();
    assert!(!viewer.edits.set(&mut viewer.parameters, "first_patch_radius", Value::Integer(4)));
    settle(&mut harness);
    harness.get_by_label("`first_patch_radius` is 4, and `second_patch_radius` 3");
    harness.get_by_label_contains("choose the patches of FIRST no larger than those of SECOND");
    assert_eq!(harness.state().parameters, in_use);
    assert_eq!(harness.state().document.as_ref().unwrap().history.len(), runs);
    // With larger patches of SECOND there is no contradiction any more.
    let viewer = harness.state_mut();
    assert!(viewer.edits.set(&mut viewer.parameters, "second_patch_radius", Value::Integer(5)));
    let value = |name: &str| {
        viewer.parameters.method.parameters().into_iter().find(|parameter| parameter.name == name).unwrap().value
    };
    assert_eq!(
        (value("first_patch_radius"), value("second_patch_radius")),
        (Some(Value::Integer(4)), Some(Value::Integer(5)))
    );
    assert!(!viewer.edits.any_wait());
}

#[test]
fn parameters_are_remembered_and_read_from_files() {
    let method = Method::default().with_parameter("window_radius", 7).unwrap().with_parameter("guard", false).unwrap();
    let own = Parameters { preset: Preset::Thesis, method };
    let settings = Settings { parameters: Some(own.to_toml()), ..Default::default() };
    let context = eframe::egui::Context::default();
    let gpu = stein::Gpu::open(&stein::gpu::DeviceChoice::Auto).unwrap();
    let viewer = |settings: &Settings, start| {
        Viewer::new(&context, &gpu, eframe::wgpu::TextureFormat::Rgba8Unorm, settings.clone(), start).unwrap()
    };
    assert_eq!(viewer(&settings, Start::default()).parameters, own);
    let said = Start { parameters: Some(Parameters::default()), ..Default::default() };
    let started = viewer(&settings, said);
    assert_eq!(started.parameters, Parameters::default());
    // What is remembered comes back when it is chosen, and so do others from before.
    let nlm = Parameters {
        method: Parameters::of("nlm", Preset::Default).unwrap().method.with_parameter("cut", 0.1).unwrap(),
        ..Parameters::default()
    };
    let settings = Settings { earlier: vec![nlm.to_toml(), "nonsense".into()], ..settings };
    let earlier = viewer(&settings, Start::default()).earlier;
    for left in [own, nlm] {
        assert_eq!(started.earlier.take_up(own.reset()), own);
        assert_eq!(Earlier::from_toml(&earlier.to_toml()).take_up(left.reset()), left);
    }

    let folder = tempfile::tempdir().unwrap();
    let (good, bad) = (folder.path().join("good.toml"), folder.path().join("bad.toml"));
    std::fs::write(&good, own.to_toml()).unwrap();
    std::fs::write(&bad, "window_radius = 100\n").unwrap();
    let mut viewer = viewer(&Settings::default(), Start::default());
    let mut load = |path| {
        viewer.take_file(Purpose::Parameters, path, &context);
        while !viewer.is_idle() {
            viewer.poll(&context);
        }
    };
    load(good);
    load(bad);
    assert_eq!(viewer.parameters, own);
    let told = viewer.notice.unwrap().0.unwrap_err().to_string();
    assert!(told.contains("bad.toml: line 1") && told.contains("from 1 to 64"), "{told}");
}

#[test]
fn the_command_line_takes_a_file_of_parameters_and_says_what_is_wrong_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let picture = folder.path().join("picture.png");
    let program = |options: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_stein-viewer"));
        command
            .env("STEIN_CACHE", "")
            .arg(testdata("anim/shot.0000.exr"))
            .arg("--screenshot")
            .arg(&picture)
            .args(options);
        let output = command.output().unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let gem = file("gem.toml", "method = \"gem\"\n");
    let nlm = file("nlm.toml", "method = \"nlm\"\nwindow_radius = 2\n");
    let bad = file("bad.toml", "\nwindow_radius = 100\n");
    let (code, said) = program(&["--params", &gem, "--method", "gem", "--layer", "noisy"]);
    assert!(code == Some(0) && picture.exists(), "{said}");
    let cases: [(&[&str], i32, &[&str]); 7] = [
        // It is what denoises: GEM has no FIRST.
        (&["--params", &gem, "--layer", "first"], 2, &["there is no layer 'first'", "stopping"]),
        (
            &["--params", &gem, "--method", "nlm"],
            2,
            &["--method nlm: ", "gem.toml is for gem", "remedy: leave the option out, or write `method = \"nlm\"`"],
        ),
        (&["--params", &nlm, "--preset", "thesis"], 2, &["--preset thesis: ", "nlm.toml is for default"]),
        (&["--params", &gem, "--radius", "3"], 2, &["--radius is no option of the method gem"]),
        (&["--params", &nlm, "--radius", "100"], 2, &["`window_radius` cannot be 100", "from 1 to 64 pixels"]),
        (&["--params", &bad], 3, &["bad.toml: line 2: `window_radius` cannot be 100"]),
        (&["--params", "nowhere.toml"], 3, &["nowhere.toml: cannot be read", "remedy: name a TOML file of parameters"]),
    ];
    for (options, expected, parts) in cases {
        let (code, said) = program(options);
        assert!(
            code == Some(expected) && parts.iter().all(|part| said.contains(part)),
            "{options:?}: {code:?}, {said}"
        );
    }
}

#[test]
fn saved_parameters_and_results_hold_the_bits_of_the_window() {
    let mut harness = tuning();
    press_value(&mut harness, "second_pass.half_window");
    let own = result(&harness);
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let context = harness.ctx.clone();
    harness.state_mut().take_file(Purpose::SaveParameters, path("own.toml"), &context);
    settle(&mut harness);
    harness.get_by_label("Wrote own.toml");
    let (method, preset) = Method::from_toml(&std::fs::read_to_string(path("own.toml")).unwrap()).unwrap();
    assert_eq!((method, preset), (harness.state().parameters.method, Preset::Default));
    let estimate = Denoiser::new(&harness.state().gpu, method).unwrap().denoise(&frame()).unwrap();
    assert!(estimate.color == own, "other bits from the file's parameters");

    harness.state_mut().take_file(Purpose::SaveResult, path("own.exr"), &context);
    settle(&mut harness);
    let written = BufferSet::read(&BufferSetRequest { input: path("own.exr"), ..Default::default() }).unwrap();
    let original = BufferSet::read(&BufferSetRequest { input: testdata(FILE), ..Default::default() }).unwrap();
    stein_exr::write_estimate(&estimate, original, &path("library.exr"), &[], &method).unwrap();
    let expected = BufferSet::read(&BufferSetRequest { input: path("library.exr"), ..Default::default() }).unwrap();
    assert_eq!(written.color(), expected.color());
    let layers = |set: &BufferSet| set.layer_uses().iter().map(|layer| layer.layer.clone()).collect::<Vec<_>>();
    assert_eq!(layers(&written), layers(&expected));

    // What is open is not replaced, and a folder that is not there is told.
    for (name, text) in [(testdata(FILE), "is open here"), (path("nowhere/own.exr"), "nowhere")] {
        harness.state_mut().take_file(Purpose::SaveResult, name, &context);
        settle(&mut harness);
        harness.get_by_label_contains(text);
        press(&mut harness, "Dismiss");
    }
}

#[test]
fn saved_pictures_show_the_view_and_the_layer() {
    let mut harness = window_with(FILE, Some("cornell_reference.exr"));
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let context = harness.ctx.clone();
    harness.state_mut().compare(Compare::Wipe);
    harness.run_steps(2);
    harness.state_mut().take_file(Purpose::SaveView, path("view.png"), &context);
    harness.state_mut().take_file(Purpose::SaveLayer, path("layer.png"), &context);
    settle(&mut harness);
    harness.get_by_label_contains("Wrote ");
    let extent = result(&harness).extent;
    let read = |name: &str| {
        let mut reader =
            png::Decoder::new(std::io::BufReader::new(std::fs::File::open(path(name)).unwrap())).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut bytes).unwrap();
        (info.width, info.height, bytes)
    };
    let (width, height, layer) = read("layer.png");
    assert_eq!((width, height), (extent.width, extent.height));
    // The layer in sRGB, to a step of eight bits.
    let image = result(&harness);
    let encoded =
        |value: f32| 255.0 * if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 };
    for pixel in (0..extent.pixels()).step_by(97) {
        for channel in 0..3 {
            let expected = encoded(image.planes[channel][pixel].clamp(0.0, 1.0));
            assert!(
                (f32::from(layer[4 * pixel + channel]) - expected).abs() <= 1.0,
                "pixel {pixel}, channel {channel}"
            );
        }
    }
    let (width, height, view) = read("view.png");
    let shown = harness.render().unwrap();
    let canvas = harness.get_by_label_contains("image: result").rect();
    assert_eq!((width, height), (canvas.width().round() as u32, canvas.height().round() as u32));
    // As in the window, wherever the canvas is: text may be placed by fractions of a pixel.
    let Pos2 { x: left, y: top } = canvas.min.round();
    let differs = |pixel: usize| {
        let (x, y) = (pixel as u32 % width, pixel as u32 / width);
        let own = shown.get_pixel(left as u32 + x, top as u32 + y).0;
        (0..3).any(|channel| own[channel].abs_diff(view[4 * pixel + channel]) > 12)
    };
    let different = (0..(width * height) as usize).filter(|pixel| differs(*pixel)).count();
    assert!(different * 50 < (width * height) as usize, "{different} of {} pixels", width * height);
}

#[test]
fn a_run_keeps_the_preset_that_it_was_made_with() {
    let mut harness = tuning();
    let radius = |preset| {
        let parameters = Parameters::of("dfc", preset).unwrap();
        Parameters { method: parameters.method.with_parameter("window_radius", 3).unwrap(), ..parameters }
    };
    harness.state_mut().take_parameters(radius(Preset::Thesis));
    settle(&mut harness);
    harness.state_mut().take_parameters(radius(Preset::Default));
    harness.state_mut().panel = Panel::Plot;
    settle(&mut harness);
    let history = harness.state().document.as_ref().unwrap().history.clone();
    assert_eq!(
        history.iter().map(|run| run.parameters.preset).collect::<Vec<_>>(),
        [Preset::Default, Preset::Thesis, Preset::Default]
    );
    let transform = PlotMemory::load(&harness.ctx, Id::unique(PLOT)).unwrap().transform();
    let thesis = PlotPoint::new(history[1].seconds.log10(), history[1].estimated_error.unwrap().log10());
    harness.hover_at(transform.position_from_point(&thesis));
    harness.run_steps(8);
    harness.get_by_label_contains("dfc thesis, radius 3, every layer kept");
}

#[test]
fn a_window_that_makes_room_waits_for_the_work_and_no_longer() {
    let mut harness = tuning();
    harness.state_mut().run();
    let worker = &harness.state().worker;
    assert_eq!(worker.busy(), Some(Task::Denoise));
    worker.make_room(PATIENCE);
    assert_eq!(worker.busy(), None);
    worker.make_room(PATIENCE);
    settle(&mut harness);
    assert_eq!(harness.state().document.as_ref().unwrap().history.len(), 2);

    // A half of the time is for the work, but input is not put off for as long as a slow frame takes.
    for milliseconds in [0, 1, 60] {
        let frame = Duration::from_millis(milliseconds);
        assert_eq!(rest_after(frame), frame);
    }
    assert_eq!(rest_after(Duration::from_secs(60)), rest_after(Duration::from_millis(200)));
}

#[test]
fn a_sweep_measures_makes_way_and_hands_over_its_parameters() {
    let mut harness = window_with(FILE, Some("cornell_reference.exr"));
    harness.state_mut().panel = Panel::Plot;
    harness.state_mut().sweep.range.radii = vec![2, 3];
    harness.run_steps(2);
    harness.get_by_label("method gem").click();
    harness.run_steps(2);
    harness.key_press(Key::F9);
    harness.run_steps(1);
    assert!(harness.state().sweep.is_running);
    // A run of the user's own goes first, and the sweep on.
    harness.state_mut().run();
    settle(&mut harness);
    let viewer = harness.state();
    assert!(viewer.trouble.is_none(), "{:?}", viewer.trouble);
    assert_eq!(viewer.document.as_ref().unwrap().history.len(), 2);
    // Two radii of two presets, two of GEM, and what is in use.
    assert_eq!(viewer.sweep.points.len(), 7);
    assert!(
        viewer
            .sweep
            .points
            .iter()
            .all(|point| point.seconds > 0.0 && point.error.unwrap() > 0.0 && point.estimated_error.unwrap() > 0.0)
    );
    let in_use = viewer.sweep.points.iter().find(|point| point.parameters == viewer.parameters).unwrap();
    let denoised = viewer.document.as_ref().unwrap().denoised.as_ref().unwrap();
    assert_eq!(in_use.error, denoised.error, "the result does not depend on what is kept");
    harness.get_by_label("plot: relative MSE against the reference against seconds");

    press(&mut harness, "dfc thesis, radius 3");
    let expected = Parameters::of("dfc", Preset::Thesis).unwrap().method.with_parameter("window_radius", 3).unwrap();
    assert_eq!(harness.state().parameters, Parameters { preset: Preset::Thesis, method: expected });
    assert_eq!(harness.state().document.as_ref().unwrap().denoised.as_ref().unwrap().parameters.method, expected);

    // Of the points, the one that lies most by itself is clicked.
    let transform = PlotMemory::load(&harness.ctx, Id::unique(PLOT)).unwrap().transform();
    let place = |point: &MeasuredRun| {
        transform.position_from_point(&PlotPoint::new(point.seconds.log10(), point.error.unwrap().log10()))
    };
    let points = harness.state().sweep.points.clone();
    let others = |point: &MeasuredRun| {
        points.iter().filter(|other| other.parameters != point.parameters).map(place).collect::<Vec<_>>()
    };
    let alone = |point: &MeasuredRun| {
        others(point).into_iter().map(|other| other.distance(place(point))).fold(f32::INFINITY, f32::min)
    };
    let clickable = points.iter().filter(|point| point.parameters.method != expected);
    let point = clickable.max_by(|a, b| alone(a).total_cmp(&alone(b))).unwrap();
    assert!(alone(point) > 1.0, "{points:?}");
    let place = place(point);
    harness.hover_at(place);
    harness.run_steps(8);
    harness.get_by_label_contains("Click to take these parameters.");
    harness.drag_at(place);
    harness.drop_at(place);
    settle(&mut harness);
    assert_eq!(harness.state().parameters, point.parameters);
    assert_eq!(
        harness.state().document.as_ref().unwrap().denoised.as_ref().unwrap().parameters.method,
        point.parameters.method
    );

    // Stopped, it leaves what was measured.
    harness.key_press(Key::F9);
    harness.run_steps(2);
    press(&mut harness, "Stop");
    assert!(harness.state().sweep.points.len() < 7);
    let edited = Parameters::of("dfc", Preset::Thesis).unwrap();
    let edited = Parameters { method: edited.method.with_parameter("window_radius", 2).unwrap(), ..edited };
    harness.state_mut().take_parameters(edited);
    harness.key_press_modifiers(Modifiers::COMMAND, Key::Backspace);
    settle(&mut harness);
    assert_eq!(harness.state().parameters, Parameters::of("dfc", Preset::Thesis).unwrap());
}
