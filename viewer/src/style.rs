//! Fonts and colours of the window, for the dark and the light theme.

use eframe::egui::{Color32, Context, FontDefinitions, FontFamily};

/// Sets fonts and colours.
pub fn apply(context: &Context) {
    let mut fonts = FontDefinitions::default();
    // The monospace font has mathematical signs that the proportional font lacks.
    let [proportional, monospace] = [FontFamily::Proportional, FontFamily::Monospace]
        .map(|family| fonts.families.get(&family).cloned().unwrap_or_default());
    fonts.families.insert(FontFamily::Proportional, proportional.into_iter().chain(monospace).collect());
    context.set_fonts(fonts);
    context.all_styles_mut(|style| {
        // Text on panels is read, not only glanced at.
        let visuals = &mut style.visuals;
        visuals.widgets.noninteractive.fg_stroke.color =
            if visuals.dark_mode { Color32::from_gray(205) } else { Color32::from_gray(50) };
        visuals.error_fg_color =
            if visuals.dark_mode { Color32::from_rgb(255, 120, 110) } else { Color32::from_rgb(170, 0, 0) };
        visuals.weak_text_alpha = 0.75;
    });
}
