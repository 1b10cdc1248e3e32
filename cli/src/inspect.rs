//! Description of an input: its layers and their use. Printed by `denoise` and `info`.

use std::path::PathBuf;

use serde::Serialize;
use stein::error::{LayerCause, RequestCause};
use stein::frame::{Contradiction, Feature, NoiseCheck, NoiseKnowledge, PayloadKind, Repairs, SamplesPerPixel};
use stein::image::Window;
use stein::text::{self, number};
use stein::{Error, Frame};
use stein_exr::{BufferSet, LayerUse, LayoutUse, RecognisedBy, Role, SignalPart};

use super::Failure;
use super::options::Demands;
use super::out::{indent, table};

/// Description of an input, for programs and people.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Input {
    #[serde(serialize_with = "text::serialize_path")]
    pub(crate) file: PathBuf,
    /// Layout by which the file was read.
    pub(crate) layout: LayoutUse,
    /// Renders with other seeds that were merged with the file.
    #[serde(serialize_with = "serialize_paths")]
    pub(crate) seeds: Vec<PathBuf>,
    /// Files that were found beside the file.
    #[serde(serialize_with = "serialize_paths")]
    pub(crate) siblings: Vec<PathBuf>,
    pub(crate) display_window: Rectangle,
    non_finite_values: usize,
    pub(crate) layers: Vec<LayerUse>,
    /// Whether a variance cannot be used for want of the number of samples.
    pub(crate) needs_samples: bool,
    /// The first picture of the file.
    #[serde(flatten)]
    first: Picture,
    /// Other pictures, such as other view layers.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    further_pictures: Vec<Picture>,
}

/// Description of one picture of an input.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Picture {
    /// Layer of the colour; empty for plain `R G B`.
    pub(crate) layer: String,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) data_window: Rectangle,
    /// Samples per pixel; `None` if unknown.
    pub(crate) samples_per_pixel: Option<Samples>,
    /// Layers that are denoised along with the colour.
    pub(crate) along: Along,
    /// The frame made of the picture, or the problem.
    #[serde(flatten)]
    pub(crate) outcome: Outcome,
}

fn serialize_paths<S: serde::Serializer>(paths: &[PathBuf], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(paths.iter().map(|path| text::path(path)))
}

/// Names of the layers that are denoised along with a colour.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Along {
    lights: Vec<String>,
    alphas: Vec<String>,
}

impl Along {
    fn new(set: &BufferSet, picture: usize) -> Self {
        let names = |wanted: PayloadKind| {
            let of_kind = set.payload(picture).filter(move |(_, kind)| *kind == wanted);
            of_kind.map(|(name, _)| name.to_owned()).collect()
        };
        Self { lights: names(PayloadKind::Light), alphas: names(PayloadKind::Alpha) }
    }

    /// Formats the numbers of layers; `None` if there are none.
    pub(crate) fn text(&self) -> Option<String> {
        let counted = |count: usize, one: &str, several: &str| match count {
            0 => None,
            1 => Some(one.to_owned()),
            _ => Some(format!("{count} {several}")),
        };
        let lights = counted(self.lights.len(), "1 light layer", "light layers");
        let alphas = counted(self.alphas.len(), "alpha", "alphas");
        let told: Vec<String> = [lights, alphas].into_iter().flatten().collect();
        (!told.is_empty()).then(|| told.join(", "))
    }
}

#[derive(Clone, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Outcome {
    /// The input can be denoised.
    Frame {
        /// Source of the noise knowledge of the colour.
        mode: String,
        noise_knowledge: NoiseKnowledge,
        /// Relative MSE of the noise; `None` if nothing is known of the noise.
        noise_level: Option<f64>,
        features: Vec<String>,
        feature_noise: Vec<FeatureNoise>,
        /// Whether the sources of the noise agree.
        check: Box<Check>,
        repairs: Repairs,
    },
    /// The input cannot be denoised, for this reason.
    Problem(String),
}

/// Ratios between the sources from which the noise of the colour is known, and their contradiction.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Check {
    #[serde(flatten)]
    pub(crate) ratios: NoiseCheck,
    pub(crate) contradiction: Option<Contradiction>,
    /// The contradiction and its remedy in words.
    pub(crate) message: Option<String>,
}

impl Check {
    fn new(frame: &Frame) -> Self {
        let ratios = frame.check_of_noise();
        let contradiction = ratios.contradiction();
        let in_words = |contradiction| {
            let error = Error::Request(RequestCause::Contradiction(contradiction));
            Failure::input(error).message().to_owned()
        };
        Self { ratios, contradiction, message: contradiction.map(in_words) }
    }

    /// Whether both have a contradiction of the same kind, or none.
    fn is_like(&self, other: &Self) -> bool {
        let kind = |check: &Self| check.contradiction.as_ref().map(std::mem::discriminant);
        kind(self) == kind(other)
    }
}

/// Noise knowledge of a feature.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct FeatureNoise {
    pub(crate) name: String,
    /// Noise knowledge; `None` if the feature is taken as free of noise.
    pub(crate) noise_knowledge: Option<NoiseKnowledge>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Rectangle {
    x: i32,
    y: i32,
    width: u32,
    height: u32,
}

impl std::fmt::Display for Rectangle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}×{} at ({}, {})", self.width, self.height, self.x, self.y)
    }
}

impl From<Window> for Rectangle {
    fn from(window: Window) -> Self {
        Self { x: window.x, y: window.y, width: window.extent.width, height: window.extent.height }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Samples {
    Uniform(f32),
    PerPixel { least: f32, mean: f64, most: f32 },
}

impl Samples {
    fn of(samples: &SamplesPerPixel) -> Option<Self> {
        match samples {
            SamplesPerPixel::Unknown => None,
            SamplesPerPixel::Uniform(count) => Some(Self::Uniform(*count)),
            SamplesPerPixel::PerPixel(image) => {
                let counts = image.planes.first()?;
                let mean = counts.iter().map(|&count| f64::from(count)).sum::<f64>() / counts.len() as f64;
                let (least, most) = counts
                    .iter()
                    .fold((f32::INFINITY, 0.0f32), |(least, most), &count| (least.min(count), most.max(count)));
                Some(Self::PerPixel { least, mean, most })
            }
        }
    }
}

impl std::fmt::Display for Samples {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Uniform(1.0) => f.write_str("1 sample per pixel"),
            Self::Uniform(count) => write!(f, "{count} samples per pixel"),
            Self::PerPixel { least, most, .. } if least == most => Self::Uniform(*least).fmt(f),
            Self::PerPixel { least, mean, most } => {
                write!(f, "{least} to {most} samples per pixel, {mean:.1} on average")
            }
        }
    }
}

impl Picture {
    /// Returns the layer of the colour as people call it.
    pub(crate) fn name(&self) -> &str {
        stein_exr::picture_name(&self.layer)
    }

    fn new(set: &BufferSet, index: usize, settled: Result<(&Frame, &Repairs), &Error>) -> Self {
        let window = set.data_window_of(index);
        let samples = match &settled {
            Ok((frame, _)) => Samples::of(frame.samples_per_pixel()),
            Err(error) if needs_samples(error) => None,
            Err(_) => Samples::of(&set.samples_per_pixel()),
        };
        let outcome = match settled {
            Ok((frame, repairs)) => Outcome::Frame {
                mode: frame.noise_knowledge().to_string(),
                noise_knowledge: frame.noise_knowledge(),
                noise_level: frame.noise_level(),
                features: frame.features().iter().map(|feature| feature.name.clone()).collect(),
                feature_noise: feature_noise(frame),
                check: Box::new(Check::new(frame)),
                repairs: repairs.clone(),
            },
            Err(error) => Outcome::Problem(Failure::input(error).message().to_owned()),
        };
        Self {
            layer: set.pictures().nth(index).unwrap_or_default().to_owned(),
            width: window.extent.width,
            height: window.extent.height,
            data_window: window.into(),
            samples_per_pixel: samples,
            along: Along::new(set, index),
            outcome,
        }
    }

    /// Whether the picture of another frame has the same size, layers denoised along, sources of noise and repairs.
    fn is_used_like(&self, other: &Self) -> bool {
        if (self.width, self.height, &self.along) != (other.width, other.height, &other.along) {
            return false;
        }
        match (&self.outcome, &other.outcome) {
            (
                Outcome::Frame { noise_knowledge, feature_noise, check, repairs, .. },
                Outcome::Frame {
                    noise_knowledge: other_knowledge,
                    feature_noise: other_noise,
                    check: other_check,
                    repairs: other_repairs,
                    ..
                },
            ) => {
                (noise_knowledge, feature_noise, repairs) == (other_knowledge, other_noise, other_repairs)
                    && check.is_like(other_check)
            }
            _ => false,
        }
    }
}

impl Input {
    pub(crate) fn new(set: &BufferSet, settled: Result<&[(Frame, Repairs)], &Error>) -> Self {
        let pictures = match settled {
            Ok(frames) => frames
                .iter()
                .enumerate()
                .map(|(index, (frame, repairs))| Picture::new(set, index, Ok((frame, repairs))))
                .collect(),
            Err(error) => vec![Picture::new(set, 0, Err(error))],
        };
        let mut pictures = pictures.into_iter();
        let Some(first) = pictures.next() else { unreachable!("a set has a picture") };
        Self {
            file: set.input().to_owned(),
            layout: set.layout().clone(),
            seeds: set.seeds().to_vec(),
            siblings: set.siblings().to_vec(),
            display_window: set.display_window().into(),
            non_finite_values: set.layer_uses().iter().map(|layer| layer.non_finite_values).sum(),
            layers: set.layer_uses().to_vec(),
            needs_samples: settled.err().is_some_and(needs_samples) || set.lacks_samples(),
            first,
            further_pictures: pictures.collect(),
        }
    }

    /// Formats the description for people. `all` adds the windows and layers that are left out as unimportant
    /// otherwise.
    pub(crate) fn text(&self, all: bool) -> String {
        let mut lines = self.description(all);
        let origin = [self.read_by(), self.read_beside()].into_iter().flatten().map(|line| format!("  {line}"));
        lines.splice(1..1, origin);
        lines.join("\n")
    }

    /// Formats how the layout was found; `None` if no layout was recognised.
    fn read_by(&self) -> Option<String> {
        let (title, how) = (&self.layout.title, self.layout.recognised_by.to_string());
        self.has_layout().then(|| format!("layout: {}, {}", text::name(title), text::name(&how)))
    }

    /// Formats the other files that were read without having been named one by one.
    fn read_beside(&self) -> Option<String> {
        let seeds = self.seeds.iter().map(|seed| format!("{} (another seed)", text::path(seed)));
        let files: Vec<_> = seeds.chain(self.siblings.iter().map(|file| text::path(file))).collect();
        (!files.is_empty()).then(|| format!("with: {}", text::list(files)))
    }

    /// Whether the layout was recognised or requested. The fallback knows the usual names.
    pub(crate) fn has_layout(&self) -> bool {
        self.layout.recognised_by != RecognisedBy::UsualNames
    }

    /// Formats the description in lines, without the layout and the files beside the input.
    fn description(&self, all: bool) -> Vec<String> {
        let mut head = format!("{}: {}×{}", text::path(&self.file), self.first.width, self.first.height);
        if let Some(samples) = &self.first.samples_per_pixel {
            head += &format!(", {samples}");
        }
        let mut lines = vec![head];
        if all || self.first.data_window != self.display_window {
            lines.push(format!("  data window {}, display window {}", self.first.data_window, self.display_window));
        }
        lines.push(self.roles());
        lines.extend(self.first.along.text().map(|along| format!("  along: {along}")));
        lines.extend(self.unused(all));
        if all {
            lines.push(format!("  not finite: {} values", self.non_finite_values));
        }
        if let Outcome::Frame { noise_knowledge, noise_level, feature_noise, check, repairs, .. } = &self.first.outcome
        {
            lines.push(format!("  noise: known from {noise_knowledge}{}", meaning(*noise_knowledge)));
            if all {
                let level =
                    noise_level.map_or_else(|| "unknown".to_owned(), |level| format!("about {}", number(level)));
                lines.push(format!("  relative MSE of the noise: {level}"));
                lines.extend(feature_noise.iter().map(FeatureNoise::text));
                lines.extend(check.text());
            }
            if !repairs.is_empty() {
                lines.push(indent(&repairs.to_string()));
            }
        }
        for (layer, message) in self.contradictions() {
            let of = if layer.is_empty() { String::new() } else { format!(" of {}", text::name(layer)) };
            lines.push(indent(&format!("contradiction in the noise{of}: {message}")));
        }
        lines
    }

    /// Formats all that is known of the layers: their use, their noise, and each of them by name.
    pub(crate) fn details(&self) -> String {
        let mut lines: Vec<String> = self.description(true).into_iter().skip(1).collect();
        lines.push("  layers:".into());
        let several = self.layers.iter().any(|layer| layer.file != self.file);
        lines.extend(self.layers.iter().map(|layer| {
            let file = if several { format!("{}::", text::path(&layer.file)) } else { String::new() };
            format!("    {file}{layer}")
        }));
        lines.join("\n")
    }

    pub(crate) fn first(&self) -> &Picture {
        &self.first
    }

    /// Whether another frame of a shot has pictures of the same size, the same sources of noise and the same repairs.
    pub(crate) fn is_used_like(&self, other: &Self) -> bool {
        self.further_pictures.len() == other.further_pictures.len()
            && self.pictures().zip(other.pictures()).all(|(own, other)| own.is_used_like(other))
    }

    pub(crate) fn pictures(&self) -> impl Iterator<Item = &Picture> {
        std::iter::once(&self.first).chain(&self.further_pictures)
    }

    /// Returns the reason why the input cannot be denoised.
    pub(crate) fn problem(&self) -> Option<&str> {
        self.pictures().find_map(|picture| match &picture.outcome {
            Outcome::Frame { .. } => None,
            Outcome::Problem(problem) => Some(problem.as_str()),
        })
    }

    /// Refuses pictures whose sources of noise contradict each other.
    fn require_agreement(&self) -> Result<(), Error> {
        self.pictures().try_for_each(|picture| match &picture.outcome {
            Outcome::Frame { check, .. } => check.ratios.require_agreement(),
            Outcome::Problem(_) => Ok(()),
        })
    }

    /// Returns the contradictions between the sources of the pictures' noise: the layer of the colour if there are
    /// several pictures, and the contradiction with its remedy.
    fn contradictions(&self) -> impl Iterator<Item = (&str, &str)> {
        let layer = |picture| if self.further_pictures.is_empty() { "" } else { Picture::name(picture) };
        self.pictures().filter_map(move |picture| match &picture.outcome {
            Outcome::Frame { check, .. } => Some((layer(picture), check.message.as_deref()?)),
            Outcome::Problem(_) => None,
        })
    }

    /// Formats a line for each signal, with the layers that it was made of.
    fn roles(&self) -> String {
        let mut rows: Vec<[String; 4]> = vec![["used as", "mean", "halves", "variance"].map(String::from)];
        let mut signals: Vec<(String, [Vec<String>; 3])> = Vec::new();
        for layer in &self.layers {
            let Some((signal, column)) = cell(&layer.role) else { continue };
            let index = signals.iter().position(|(name, _)| *name == signal).unwrap_or_else(|| {
                signals.push((signal, Default::default()));
                signals.len() - 1
            });
            signals[index].1[column].push(self.layer_name(layer, column == 0));
        }
        // The file sorts layers by the names of their channels; people look for the colour first.
        signals.sort_by_key(|(name, _)| (name != "colour", name == "samples"));
        let or_none = |layers: Vec<String>| if layers.is_empty() { "-".to_owned() } else { text::list(layers) };
        rows.extend(
            signals
                .into_iter()
                .map(|(name, [mean, halves, variance])| [name, or_none(mean), or_none(halves), or_none(variance)]),
        );
        table(&rows.into_iter().map(Vec::from).collect::<Vec<_>>(), 4)
    }

    /// Formats the layers that are not used: useful-looking layers with the reason, the others by name.
    fn unused(&self, all: bool) -> Vec<String> {
        let mut groups: Vec<(Option<&str>, Vec<String>)> = Vec::new();
        for layer in self.layers.iter().filter(|layer| layer.role == Role::Untouched) {
            let (note, name) = (layer.note.as_deref(), self.layer_name(layer, all));
            // A file that was named for one layer may hold many layers that the user did not mean.
            if note.is_none() && layer.file != self.file && !all {
                continue;
            }
            match groups.iter_mut().find(|(other, _)| *other == note) {
                Some((_, names)) => names.push(name),
                None => groups.push((note, vec![name])),
            }
        }
        groups.sort_by_key(|(note, _)| note.is_none());
        // All names are listed only if `all` asks for them.
        let list = |names: Vec<String>| if all { names.join(", ") } else { text::list(names) };
        let line = |(note, names): (Option<&str>, Vec<String>)| match note {
            Some(note) => format!("  not used: {}: {note}", list(names)),
            None => format!("  not used: {}", list(names)),
        };
        let lines: Vec<String> = groups.into_iter().map(line).collect();
        if all { lines } else { text::lines(lines) }
    }

    /// Formats the name of a layer, with the name of its file if that is not the input.
    fn layer_name(&self, layer: &LayerUse, with_channels: bool) -> String {
        let mut name = if layer.file == self.file { String::new() } else { format!("{}::", text::path(&layer.file)) };
        let channels = layer.channels.join(" ");
        let channels = text::name(&channels);
        if layer.layer.is_empty() {
            name += &channels;
        } else {
            name += &text::name(&layer.layer);
            if with_channels && layer.channels != [layer.layer.clone()] {
                name += &format!(" ({channels})");
            }
        }
        if with_channels { format!("{name} {}", layer.sample_kind) } else { name }
    }
}

/// Returns the signal that a layer belongs to, and its column: mean, halves or variance.
fn cell(role: &Role) -> Option<(String, usize)> {
    let colour = |column| Some(("colour".to_owned(), column));
    match role {
        Role::Color => colour(0),
        Role::HalfA | Role::HalfB => colour(1),
        Role::Variance => colour(2),
        Role::Feature(name, part) => {
            let column = match part {
                SignalPart::Mean => 0,
                SignalPart::HalfA | SignalPart::HalfB => 1,
                SignalPart::Variance => 2,
            };
            Some((format!("feature {}", text::name(name)), column))
        }
        Role::Samples => Some(("samples".to_owned(), 0)),
        Role::Alpha | Role::Light | Role::Id | Role::Denoised | Role::Untouched => None,
    }
}

/// Explains how the filters get a variance, if no other remark says so.
fn meaning(knowledge: NoiseKnowledge) -> &'static str {
    match knowledge {
        NoiseKnowledge::HalvesOnly => ", pooled from the halves of similar pixels",
        NoiseKnowledge::HalvesAndVariance | NoiseKnowledge::VarianceOnly | NoiseKnowledge::ImageOnly => "",
    }
}

fn feature_noise(frame: &Frame) -> Vec<FeatureNoise> {
    let noise = |feature: &Feature| FeatureNoise {
        name: feature.name.clone(),
        noise_knowledge: feature.signal.noise_knowledge(),
    };
    frame.features().iter().map(noise).collect()
}

impl FeatureNoise {
    fn text(&self) -> String {
        let knowledge =
            self.noise_knowledge.map_or_else(|| "none".to_owned(), |knowledge| format!("known from {knowledge}"));
        format!("  noise of feature {}: {knowledge}", text::name(&self.name))
    }
}

impl Check {
    /// Formats the ratios; `None` if there are none.
    fn text(&self) -> Option<String> {
        let ratios = [
            ("variance to image", self.ratios.variance_over_image),
            ("halves to variance", self.ratios.halves_over_variance),
            ("halves to image", self.ratios.halves_over_image),
        ];
        let told: Vec<_> =
            ratios.iter().filter_map(|(name, ratio)| Some(format!("{name} {}", number((*ratio)?)))).collect();
        (!told.is_empty()).then(|| format!("  noise compared: {}", told.join(", ")))
    }
}

/// Whether nothing but the number of samples is missing.
pub(crate) fn needs_samples(error: &Error) -> bool {
    matches!(error, Error::Layer { cause: LayerCause::NeedsSamples { .. }, .. })
}

/// Makes the frames of a set's pictures and describes the input. The set keeps the data for an output. Refuses an input
/// that does not tell of its noise what `demands` says.
pub(crate) fn settle(set: &mut BufferSet, demands: Demands) -> (Result<Vec<Frame>, Error>, Input) {
    let settled = set.take_frames().and_then(|frames| {
        if demands.require_noise {
            frames.iter().try_for_each(|(frame, repairs)| frame.require_noise(repairs))?;
        }
        Ok(frames)
    });
    match settled {
        Ok(frames) => {
            let input = Input::new(set, Ok(&frames));
            let agreement = if demands.strict { input.require_agreement() } else { Ok(()) };
            (agreement.map(|()| frames.into_iter().map(|(frame, _)| frame).collect()), input)
        }
        Err(error) => {
            let input = Input::new(set, Err(&error));
            (Err(error), input)
        }
    }
}

/// Makes the frame of a set's first picture, as [`settle`] does.
pub(crate) fn settle_first(set: &mut BufferSet, demands: Demands) -> (Result<Frame, Error>, Input) {
    let (frames, input) = settle(set, demands);
    (frames.map(|mut frames| frames.swap_remove(0)), input)
}
