//! The verdict of `stein info` on an input: whether it can be denoised, from what, and by which command.

use std::path::{Path, PathBuf};

use serde::Serialize;
use stein::frame::{IMAGE_ONLY, NoiseKnowledge};
use stein::text;
use stein_exr::{AlphaEncoding, Aovs, BufferSetRequest, LayerRef, LayerUse, Quantity, RecognisedBy, Role};

use super::inspect::{Check, FeatureNoise, Input, Outcome, Picture};
use super::output;

/// Width of the column of labels.
const LABEL: usize = 10;

#[derive(Debug, Serialize)]
pub(crate) struct Verdict {
    state: State,
    /// Numbers of layers of the input that an output keeps as they are. The alphas of layers with other channels do not
    /// count.
    copied: Copied,
    /// Command that denoises the input; `N` and other names in capitals stand for what is missing. `None` if it
    /// cannot be denoised.
    command: Option<String>,
    /// Advice for a better result, and its command.
    better: Option<Advice>,
}

#[derive(Debug, Serialize)]
struct Advice {
    what: &'static str,
    command: String,
}

/// A label and its value.
type Row = (&'static str, String);

/// Whether an input can be denoised.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Ready,
    /// Nothing is known of the noise.
    NoiseUnknown,
    /// The sources of the noise contradict each other.
    Contradiction,
    /// The number of samples is missing.
    NeedsSamples,
    Problem,
}

/// Numbers of layers.
#[derive(Debug, Default, Serialize)]
struct Copied {
    lights: usize,
    ids: usize,
    alphas: usize,
    denoised: usize,
    others: usize,
}

impl Copied {
    fn of(input: &Input) -> Self {
        let mut copied = Self::default();
        for layer in input.layers.iter().filter(|layer| layer.file == input.file && layer.picture.is_none()) {
            let count = match layer.role {
                Role::Light => &mut copied.lights,
                Role::Id => &mut copied.ids,
                Role::Alpha => &mut copied.alphas,
                Role::Denoised => &mut copied.denoised,
                Role::Untouched => &mut copied.others,
                _ => continue,
            };
            *count += 1;
        }
        copied
    }

    fn text(&self) -> Option<String> {
        let plural = |count: usize, name: &str| match count {
            0 => None,
            1 => Some(format!("1 {name}")),
            _ => Some(format!("{count} {name}s")),
        };
        let denoised = (self.denoised > 0).then(|| format!("{} denoised by the renderer", self.denoised));
        let counts = [plural(self.lights, "light"), plural(self.ids, "id"), plural(self.alphas, "alpha"), denoised];
        let mut counts: Vec<String> = counts.into_iter().flatten().collect();
        let name = if counts.is_empty() { "layer" } else { "other" };
        counts.extend(plural(self.others, name));
        (!counts.is_empty()).then(|| format!("{} (-v lists them)", counts.join(", ")))
    }
}

impl Verdict {
    /// `request` is what the user asked for, with all paths taken as they are if `is_literal`.
    pub(crate) fn new(input: &Input, request: &BufferSetRequest, is_literal: bool) -> Self {
        let state = State::of(input);
        let command = |seeds: &[&str], samples: Option<&str>| {
            let mut words = vec!["stein denoise".to_owned(), path_word(&input.file)];
            words.extend(request.seeds.iter().map(|seed| path_word(seed)));
            words.extend(seeds.iter().map(|seed| (*seed).to_owned()));
            words.extend(["-o".to_owned(), path_word(&output::choose(&input.file, None))]);
            words.extend(arguments(request));
            words.extend(samples.map(|samples| format!("--samples {samples}")));
            words.extend(is_literal.then(|| "--literal".to_owned()));
            words.join(" ")
        };
        let has_halves = request.half_a.is_some() || request.half_b.is_some() || !request.seeds.is_empty();
        let better = match state {
            State::NoiseUnknown if !has_halves => {
                Some(Advice { what: "render it again with another seed", command: command(&["OTHER_SEED.exr"], None) })
            }
            State::Ready | State::NoiseUnknown if input.needs_samples => {
                Some(Advice { what: "say how many samples a pixel has", command: command(&[], Some("N")) })
            }
            _ => None,
        };
        let needed = (state == State::NeedsSamples).then_some("N");
        Self {
            state,
            copied: Copied::of(input),
            command: (state != State::Problem).then(|| command(&[], needed)),
            better,
        }
    }

    /// Formats the verdict and what it follows from.
    pub(crate) fn text(&self, input: &Input) -> String {
        let mut lines = vec![format!("{}: {}", text::path(&input.file), self.state.text())];
        let mut row = |label: &str, value: &str| {
            // Further lines of a value, such as a remedy, stay behind the label.
            let value = value.replace('\n', &format!("\n  {:LABEL$}", ""));
            lines.push(format!("  {label:LABEL$}{value}"));
        };
        // The first line says it, and standard error.
        if let Some(problem) = input.problem().filter(|_| self.state != State::NeedsSamples) {
            row("problem", &problem.replace("\n  remedy: ", "\nremedy: "));
        }
        row("renderer", &renderer(input));
        row("size", &size(input));
        let files = |files: &[PathBuf]| text::list(files.iter().map(|file| text::path(&name_of(file))));
        if !input.seeds.is_empty() {
            row("seeds", &format!("merged with {}", files(&input.seeds)));
        }
        if !input.siblings.is_empty() {
            row("files", &format!("beside it: {}", files(&input.siblings)));
        }
        // Pictures of which all but the colour is told in the same words share these.
        let mut groups: Vec<(Vec<String>, Vec<Row>)> = Vec::new();
        for (index, picture) in input.pictures().enumerate() {
            let (colour, rows) = (colour(input, picture), rows(input, index, picture));
            match groups.iter_mut().find(|(_, other)| *other == rows) {
                Some((colours, _)) => colours.push(colour),
                None => groups.push((vec![colour], rows)),
            }
        }
        for (colours, rows) in groups {
            let is_one = colours.len() == 1;
            row(if is_one { "colour" } else { "colours" }, &text::list(colours));
            rows.iter().for_each(|(label, value)| row(label, value));
        }
        if let Some(copied) = self.copied.text() {
            row("copied", &copied);
        }
        if let Some(command) = &self.command {
            row("command", command);
        }
        if let Some(Advice { what, command }) = &self.better {
            row("better", &format!("{what}, then\n{command}"));
        }
        lines.join("\n")
    }
}

impl State {
    fn of(input: &Input) -> Self {
        let of_picture = |picture: &Picture| match &picture.outcome {
            Outcome::Problem(_) if input.needs_samples => Self::NeedsSamples,
            Outcome::Problem(_) => Self::Problem,
            Outcome::Frame { check, .. } if check.contradiction.is_some() => Self::Contradiction,
            Outcome::Frame { noise_knowledge: NoiseKnowledge::ImageOnly, .. } => Self::NoiseUnknown,
            Outcome::Frame { .. } => Self::Ready,
        };
        input.pictures().map(of_picture).max_by_key(|state| *state as usize).unwrap_or(Self::Problem)
    }

    fn text(self) -> &'static str {
        match self {
            Self::Ready => "ready to be denoised",
            Self::NoiseUnknown => "can be denoised, but its noise is not known and has to be estimated",
            Self::Contradiction => "can be denoised, but what it tells of its noise is contradictory",
            Self::NeedsSamples => "cannot be denoised before you say how many samples a pixel has (--samples N)",
            Self::Problem => "cannot be denoised",
        }
    }
}

fn renderer(input: &Input) -> String {
    let layout = &input.layout;
    let how = match &layout.recognised_by {
        RecognisedBy::UsualNames => return "not recognised: layers are taken by their usual names".into(),
        RecognisedBy::Request => "as requested".to_owned(),
        RecognisedBy::Signs(signs) => format!("recognised by {signs}"),
    };
    format!("{}; layout {}, {how}", text::name(&layout.title), text::name(&layout.name))
}

/// Formats size, window and samples of the first picture.
fn size(input: &Input) -> String {
    let first = input.first();
    let mut size = sized(first);
    if first.data_window != input.display_window {
        size += &format!("; data window {}, display window {}", first.data_window, input.display_window);
    }
    size
}

fn sized(picture: &Picture) -> String {
    let samples = picture.samples_per_pixel.as_ref();
    let samples = samples.map_or_else(|| "samples per pixel unknown".to_owned(), ToString::to_string);
    format!("{}×{}, {samples}", picture.width, picture.height)
}

fn colour(input: &Input, picture: &Picture) -> String {
    let name = text::name(picture.name());
    let own = sized(picture);
    if own == sized(input.first()) { name.into_owned() } else { format!("{name} ({own})") }
}

/// Formats what a picture is denoised from.
fn rows(input: &Input, index: usize, picture: &Picture) -> Vec<Row> {
    let Outcome::Frame { noise_knowledge, noise_level, feature_noise, check, repairs, .. } = &picture.outcome else {
        let layers = input.layers.iter().filter(|layer| layer.picture == Some(index));
        let features: Vec<_> = layers
            .filter_map(|layer| match &layer.role {
                Role::Feature(name, stein_exr::SignalPart::Mean) => Some(text::name(name).into_owned()),
                _ => None,
            })
            .collect();
        return if features.is_empty() { Vec::new() } else { vec![("guides", features.join(", "))] };
    };
    let mut rows = vec![("guides", guides(feature_noise))];
    rows.extend(picture.along.text().map(|along| ("along", along)));
    let mut noise = match noise_knowledge {
        NoiseKnowledge::ImageOnly => "estimated from the image itself: it has neither halves nor a variance".to_owned(),
        knowledge => format!("known from {knowledge}{}", converted(input, index)),
    };
    if let Some(level) = noise_level {
        noise += &format!("; relative MSE about {}", two_digits(*level));
    }
    rows.push(("noise", noise));
    if *noise_knowledge == NoiseKnowledge::ImageOnly {
        rows.extend(mistakable(input).into_iter().map(|layers| ("not used", layers)));
    } else {
        rows.push(("check", checked(check)));
    }
    // Rays without a hit are no damage.
    let damaged = repairs.layers.iter().filter(|layer| !layer.damage.is_empty() || layer.negative_variances > 0);
    let notes = repairs.notes.iter().filter(|note| is_important(note)).cloned();
    let notes = text::lines(damaged.map(ToString::to_string).chain(notes));
    rows.extend(notes.into_iter().map(|note| ("note", note)));
    rows
}

/// Whether a remark is more than a detail of a feature: it is about the colour or a file, or a feature is left out. The
/// row on the noise says already that it is estimated.
fn is_important(note: &str) -> bool {
    note != IMAGE_ONLY && (!note.starts_with("feature ") || note.ends_with(", left out"))
}

/// Returns layers that look like a variance and are none, with the reason.
fn mistakable(input: &Input) -> Vec<String> {
    let mut groups: Vec<(&str, Vec<String>)> = Vec::new();
    let layers = input.layers.iter().filter(|layer| layer.quantity == Some(Quantity::NotAVariance));
    for layer in layers {
        let note = layer.note.as_deref().unwrap_or("not a variance");
        let name = match layer.layer.as_str() {
            "" => text::path(&name_of(&layer.file)),
            name => text::name(name).into_owned(),
        };
        match groups.iter_mut().find(|(other, _)| *other == note) {
            Some((_, names)) => names.push(name),
            None => groups.push((note, vec![name])),
        }
    }
    groups.into_iter().map(|(note, names)| format!("{}: {note}", text::list(names))).collect()
}

/// Formats the features, those with the same knowledge of their noise together.
fn guides(features: &[FeatureNoise]) -> String {
    if features.is_empty() {
        return "none; albedo and normal would help".into();
    }
    let mut groups: Vec<(Option<NoiseKnowledge>, Vec<String>)> = Vec::new();
    for FeatureNoise { name, noise_knowledge } in features {
        let name = text::name(name).into_owned();
        match groups.iter_mut().find(|(knowledge, _)| knowledge == noise_knowledge) {
            Some((_, names)) => names.push(name),
            None => groups.push((*noise_knowledge, vec![name])),
        }
    }
    let told = groups.into_iter().map(|(knowledge, names)| match knowledge {
        Some(knowledge) => format!("{} (noise known from {knowledge})", text::list(names)),
        None => format!("{} (taken as free of noise)", text::list(names)),
    });
    told.collect::<Vec<_>>().join(", ")
}

/// Says from which quantity the variance was converted.
fn converted(input: &Input, index: usize) -> String {
    let is_it = |layer: &&LayerUse| layer.role == Role::Variance && layer.picture == Some(index);
    let Some(layer) = input.layers.iter().find(is_it) else { return String::new() };
    let name = match layer.layer.as_str() {
        "" => text::path(&name_of(&layer.file)),
        name => text::name(name).into_owned(),
    };
    match layer.quantity {
        Some(Quantity::VarianceOfSample) => format!(" ({name}, of one sample: divided by the samples per pixel)"),
        Some(quantity) => format!(" ({name}, a {quantity}: converted)"),
        None => String::new(),
    }
}

/// Formats the result of the check.
fn checked(check: &Check) -> String {
    if let Some(message) = &check.message {
        return message.replace("\n  remedy: ", "\nremedy: ");
    }
    let ratios = &check.ratios;
    let sources = match (ratios.variance_over_image, ratios.halves_over_variance, ratios.halves_over_image) {
        (_, Some(_), _) => "no contradiction between halves, variance and the noise in the image",
        (Some(_), None, _) => "no contradiction between the variance and the noise in the image",
        (None, None, Some(_)) => "no contradiction between the halves and the noise in the image",
        (None, None, None) => "too few pixels with noise to compare what is known of it with the image",
    };
    sources.into()
}

/// Formats a positive number with two digits.
fn two_digits(value: f64) -> String {
    let before = value.max(1e-9).log10().floor();
    format!("{value:.*}", (1.0 - before).max(0.0) as usize)
}

/// Returns the options that a request stands for, besides the input and its seeds.
fn arguments(request: &BufferSetRequest) -> Vec<String> {
    let mut words = Vec::new();
    let mut option = |name: &str, value: &str| words.push(format!("{name} {}", shell_word(value)));
    if let Some(layer) = &request.layer {
        option("--layer", &text::name(layer));
    }
    let layers = [("--half-a", &request.half_a), ("--half-b", &request.half_b), ("--variance", &request.variance)];
    for (name, layer) in layers {
        if let Some(layer) = layer {
            option(name, &layer.to_string());
        }
    }
    let features: [(&str, &Vec<(String, LayerRef)>); 4] = [
        ("--feature", &request.features),
        ("--feature-half-a", &request.feature_half_a),
        ("--feature-half-b", &request.feature_half_b),
        ("--feature-variance", &request.feature_variance),
    ];
    for (name, layers) in features {
        layers.iter().for_each(|(feature, layer)| option(name, &format!("{}={layer}", text::name(feature))));
    }
    request.skip_features.iter().for_each(|feature| option("--skip-feature", &text::name(feature)));
    if request.aovs != Aovs::default() {
        option("--aovs", &text::name(&request.aovs.to_string()));
    }
    match request.alpha {
        Some(AlphaEncoding::Straight) => option("--alpha", "straight"),
        Some(AlphaEncoding::Premultiplied) => option("--alpha", "premultiplied"),
        None => {}
    }
    if let Some(samples) = request.samples {
        option("--samples", &samples.to_string());
    }
    if let Some(layout) = &request.layout {
        option("--layout", &text::name(layout));
    }
    let flags = [
        ("--no-features", request.no_features),
        ("--no-alpha", request.no_alpha),
        ("--no-siblings", request.no_siblings),
    ];
    words.extend(flags.iter().filter(|(_, given)| *given).map(|(name, _)| (*name).to_owned()));
    words
}

/// Returns a path as the shell reads it. A path that begins with a dash is none of the options.
fn path_word(path: &Path) -> String {
    let word = text::path(path);
    shell_word(&if word.starts_with('-') { format!("./{word}") } else { word })
}

/// Quotes a word for the shell, if it needs quotes.
fn shell_word(word: &str) -> String {
    let is_plain = |character: char| character.is_alphanumeric() || "/._-+=:,@%".contains(character);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

/// Returns the name of a file without its folder.
fn name_of(file: &Path) -> PathBuf {
    file.file_name().map_or_else(|| file.to_owned(), Into::into)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_a_command_are_quoted_where_the_shell_needs_it() {
        for (word, quoted) in [("a/b-1.exr", "a/b-1.exr"), ("my shot.exr", "'my shot.exr'"), ("it's", r"'it'\''s'")] {
            assert_eq!(shell_word(word), quoted);
        }
        assert_eq!(path_word(Path::new("-dash.exr")), "./-dash.exr");
        assert_eq!(shell_word("a::b#1"), "'a::b#1'");
    }
}
