//! What ran for this frame and what was left out, what each step took, and what had to be repaired.

use eframe::egui::{Grid, RichText, Ui};
use stein::frame::{NoiseKnowledge, SamplesPerPixel};

use crate::app::Viewer;
use crate::document::{Denoised, Opened};

/// Shows it.
pub fn show(ui: &mut Ui, viewer: &Viewer) {
    let Some(document) = &viewer.document else {
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
    ui.label(opened.source.input.display().to_string());
    if let Some(reference) = &opened.source.reference {
        ui.label(format!("reference: {}", reference.display()));
    }
    let noise = match frame.noise_knowledge() {
        NoiseKnowledge::HalvesAndVariance => "halves and variance",
        NoiseKnowledge::HalvesOnly => "halves, no variance",
        NoiseKnowledge::VarianceOnly => "variance, no halves",
    };
    let samples = match frame.samples_per_pixel() {
        SamplesPerPixel::Unknown => "samples unknown".to_owned(),
        SamplesPerPixel::Uniform(samples) => format!("{samples} samples per pixel"),
        SamplesPerPixel::PerPixel(_) => "samples by pixel".to_owned(),
    };
    ui.label(format!("{} pixels, {samples}, {noise}", frame.extent()));
    let features: Vec<_> = frame.features().iter().map(|feature| feature.name.as_str()).collect();
    ui.label(if features.is_empty() { "no features".to_owned() } else { format!("features: {}", features.join(", ")) });
    if !opened.repairs.is_empty() {
        ui.label(opened.repairs.to_string());
    }
}

fn run(ui: &mut Ui, denoised: &Denoised, noisy_error: Option<f64>) {
    let estimate = &denoised.estimate;
    ui.label(RichText::new("Run").strong());
    ui.label(format!("{} in {:.2} s, with every layer kept", denoised.method.name(), denoised.seconds));
    if let (Some(error), Some(noisy)) = (denoised.error, noisy_error) {
        ui.label(format!("relative MSE {error:.5}, noisy {noisy:.5}"));
    }
    if let Some(spikes) = &estimate.spikes {
        ui.label(spikes.to_string());
    }
    ui.label(format!("{:.0} MiB on the device at most, in {} strips", estimate.peak_bytes as f64 / f64::from(1 << 20), estimate.strips));
    ui.add_space(4.0);
    ui.label(RichText::new("Steps").strong());
    ui.label(RichText::new("Grey steps are left out here, or would be if only the result were wanted.").weak().small());
    let times = estimate.step_times.as_deref().unwrap_or_default();
    Grid::new("steps").num_columns(3).striped(true).spacing([8.0, 2.0]).show(ui, |ui| {
        for planned in &estimate.plan.steps {
            let lean = denoised.lean_plan.steps.iter().find(|lean| lean.step == planned.step).unwrap_or(planned);
            let name = planned.step.name();
            let taken: f64 = times.iter().filter(|time| time.step == name).map(|time| time.time.seconds).sum();
            let name = RichText::new(name);
            ui.label(if lean.runs { name } else { name.weak() });
            ui.label(RichText::new(if taken > 0.0 { format!("{:.0} ms", taken * 1e3) } else { String::new() }).monospace());
            let share =
                |skipped: f64| if skipped > 0.0 && skipped < 1.0 { format!(" (not for {:.0} % of the pixels)", 100.0 * skipped) } else { String::new() };
            let why = if lean.runs { format!("{}{}", lean.why, share(lean.skipped)) } else { format!("left out: {}", lean.why) };
            let why = RichText::new(why);
            ui.label(if lean.runs { why } else { why.weak() });
            ui.end_row();
        }
    });
}
