//! The report: the steps that ran or were left out for this frame, their times, and the repairs.

use eframe::egui::{Align, Grid, Layout, RichText, Ui};
use stein::frame::SamplesPerPixel;
use stein::method::PlannedStep;
use stein::text::{self, human_bytes};

use crate::document::{Denoised, Document, Opened};

/// Shows the report.
pub fn show(ui: &mut Ui, document: Option<&Document>) {
    let Some(document) = document else {
        ui.label("Nothing is open.");
        return;
    };
    frame(ui, &document.opened);
    ui.separator();
    match &document.denoised {
        Some(denoised) => run(ui, denoised, document.opened.noisy_error),
        None => {
            ui.label("No run has come to its end yet.");
        }
    }
}

fn frame(ui: &mut Ui, opened: &Opened) {
    let frame = &opened.frame;
    ui.label(RichText::new("Frame").strong());
    match &opened.source {
        Some(source) => {
            let of_files = opened.input.as_ref().map(|input| input.lines(&source.request));
            source.lines().into_iter().chain(of_files.into_iter().flatten()).for_each(|line| {
                ui.label(line);
            });
        }
        None => {
            ui.label(&opened.name);
        }
    }
    let samples = match frame.samples_per_pixel() {
        SamplesPerPixel::Unknown => "samples unknown".to_owned(),
        SamplesPerPixel::Uniform(samples) => format!("{samples} samples per pixel"),
        SamplesPerPixel::PerPixel(_) => "samples by pixel".to_owned(),
    };
    ui.label(format!("{} pixels, {samples}, noise known from {}", frame.extent(), frame.noise_knowledge()));
    let features: Vec<_> = frame.features().iter().map(|feature| feature.name.as_str()).collect();
    ui.label(if features.is_empty() { "no features".to_owned() } else { format!("features: {}", features.join(", ")) });
    let along: Vec<_> = frame.payload().iter().map(|layer| text::name(&layer.name)).collect();
    if !along.is_empty() {
        ui.label(format!("denoised along: {}", along.join(", ")));
    }
    if !opened.repairs.is_empty() {
        ui.label(opened.repairs.to_string());
    }
    if let Some(contradiction) = &opened.contradiction {
        let told = format!("The noise is not as the file tells: {contradiction}");
        ui.label(RichText::new(told).color(ui.visuals().warn_fg_color));
    }
}

fn run(ui: &mut Ui, denoised: &Denoised, noisy_error: Option<f64>) {
    let estimate = &denoised.estimate;
    ui.label(RichText::new("Run").strong());
    ui.label(format!("{} in {:.2} s, with every layer kept", denoised.parameters.method.name(), denoised.seconds));
    if let (Some(error), Some(noisy)) = (denoised.error, noisy_error) {
        ui.label(format!("relative MSE {error:.5}, noisy {noisy:.5}"));
    }
    if let Some(spikes) = &estimate.spikes {
        ui.label(spikes.to_string());
    }
    let strips = if estimate.strips == 1 { "one piece".to_owned() } else { format!("{} strips", estimate.strips) };
    ui.label(format!("{} on the device at most, in {strips}", human_bytes(estimate.peak_bytes)));
    ui.add_space(4.0);
    ui.label(RichText::new("Steps").strong());
    ui.label(
        RichText::new("Times of the device. A step counts as left out where the result and its error do without it.")
            .weak(),
    );
    ui.add_space(2.0);
    let times = estimate.step_times.as_deref().unwrap_or_default();
    for planned in estimate.plan.steps() {
        let lean = denoised.lean_plan.steps().into_iter().find(|lean| lean.name == planned.name).unwrap_or(planned);
        let name = &planned.name;
        let taken: f64 = times.iter().filter(|time| time.step == *name).map(|time| time.time.seconds).sum();
        step(ui, lean, name, taken);
    }
    let Some(stages) = &estimate.stage_times else { return };
    ui.separator();
    ui.label(RichText::new("Stages").strong());
    ui.label(RichText::new("The same times by shader, the longest first.").weak());
    let mut stages: Vec<_> = stages.iter().collect();
    stages.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
    Grid::new("stages").num_columns(3).striped(true).spacing([10.0, 1.0]).show(ui, |ui| {
        for stage in stages {
            ui.label(&stage.stage);
            ui.label(RichText::new(format!("{:.1} ms", stage.seconds * 1e3)).monospace());
            ui.label(
                RichText::new(if stage.dispatches == 1 {
                    "1 dispatch".to_owned()
                } else {
                    format!("{} dispatches", stage.dispatches)
                })
                .weak(),
            );
            ui.end_row();
        }
    });
}

/// Shows a step with its time, and under it the reason why it runs or does not.
fn step(ui: &mut Ui, planned: &PlannedStep, name: &str, seconds: f64) {
    ui.horizontal(|ui| {
        let name = RichText::new(name);
        ui.label(if planned.runs { name } else { name.weak() });
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            if seconds > 0.0 {
                ui.label(RichText::new(format!("{:.1} ms", seconds * 1e3)).monospace());
            }
        });
    });
    let not_for = if planned.skipped > 0.0 && planned.skipped < 1.0 {
        format!(", but for {:.0} % of the pixels", 100.0 * planned.skipped)
    } else {
        String::new()
    };
    let why = if planned.runs { format!("{}{not_for}", planned.why) } else { format!("left out: {}", planned.why) };
    ui.indent(name, |ui| ui.label(RichText::new(why).weak().size(11.5)));
}
