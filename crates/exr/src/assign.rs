//! Decides the use of each layer.

use std::path::{Path, PathBuf};

use crate::buffer_set::{BufferSet, Planes, SignalSource};
use crate::file::{ExrFile, FileLayer};
use crate::layer_ref::{LayerRef, SignalPart};
use crate::names;
use crate::request::BufferSetRequest;
use crate::uses::{Note, layer_uses, used_planes};
use stein::error::{Error, FileCause, LayerCause, RequestCause, Result};
use stein::frame::MAX_FEATURES;
use stein::text;

pub(crate) fn read(request: &BufferSetRequest) -> Result<BufferSet> {
    let mut files = Files::default();
    let input = files.open(&request.input)?;
    let mut left_out = Vec::new();
    let color = color_source(&mut files, input, request, &mut left_out)?;
    let mut features = Vec::new();
    for (name, reference) in &request.features {
        if features.iter().any(|(other, _)| other == name) {
            return Err(Error::Request(RequestCause::FeatureTwice { name: name.clone() }));
        }
        features.push((name.clone(), requested_feature(&mut files, name, reference, &mut left_out)?));
    }
    if features.len() > MAX_FEATURES {
        return Err(Error::Request(RequestCause::TooManyFeatures { given: features.len(), most: MAX_FEATURES }));
    }

    let mut notes = Vec::new();
    find_features(&files.list, &color, request, &mut features, &mut notes, &mut left_out)?;
    let mut notes: Vec<Note> = notes.into_iter().map(|(layer, text)| Note { file: 0, layer, text }).collect();
    notes.extend(left_out.into_iter().map(LeftOut::into_note));
    let samples = sample_count(&files.list[input]);
    let mut set = BufferSet { files: files.list, color, features, samples, layer_uses: Vec::new() };
    check_windows(&set)?;
    set.layer_uses = layer_uses(&set, &notes);
    Ok(set)
}

#[derive(Default)]
struct Files {
    list: Vec<ExrFile>,
}

impl Files {
    fn open(&mut self, path: &Path) -> Result<usize> {
        match self.list.iter().position(|file| file.path == path) {
            Some(index) => Ok(index),
            None => {
                self.list.push(ExrFile::read(path)?);
                Ok(self.list.len() - 1)
            }
        }
    }
}

/// A layer that is left out because of a problem.
struct LeftOut {
    file: usize,
    layer: usize,
    path: PathBuf,
    name: String,
    cause: LayerCause,
}

impl LeftOut {
    fn new(files: &[ExrFile], file: usize, layer: usize, cause: LayerCause) -> Self {
        Self { file, layer, path: files[file].path.clone(), name: files[file].layers[layer].name.clone(), cause }
    }

    fn into_note(self) -> Note {
        Note { file: self.file, layer: self.layer, text: self.cause.to_string() }
    }

    /// Converts to the error for a layer that is required.
    fn into_error(self) -> Error {
        Error::Layer { path: self.path, layer: self.name, cause: self.cause }
    }
}

/// Finds the colour with its halves and variance. Leaves out faulty ones as long as another source tells of the noise.
fn color_source(
    files: &mut Files,
    input: usize,
    request: &BufferSetRequest,
    left_out: &mut Vec<LeftOut>,
) -> Result<SignalSource> {
    let file = &files.list[input];
    let layer = color_layer(file, request.layer.as_deref())?;
    let mean = Planes { file: input, layer, channels: color_channels(file, layer)? };
    // Plain `halfA` belongs to plain `R G B` if the file has both that and the chosen layer.
    let name = &file.layers[layer].name;
    let bare_too = names::group(name) == name.as_str()
        || !file.layers.iter().enumerate().any(|(other, candidate)| {
            other != layer
                && candidate.name == names::group(name).trim_end_matches('.')
                && color_channels(file, other).is_ok()
        });
    let mut found = Companions::find(&files.list, &mean, bare_too);
    let mut named = |reference: &Option<LayerRef>, found: Option<Planes>| match reference {
        None => Ok(found),
        Some(reference) => {
            let file = files.open(&reference.file)?;
            if file == input && reference.layer.is_none() {
                return Err(Error::Request(RequestCause::InputItself { file: reference.file.clone() }));
            }
            let layer = color_layer(&files.list[file], reference.layer.as_deref())?;
            Ok(Some(Planes { file, layer, channels: color_channels(&files.list[file], layer)? }))
        }
    };
    found.half_a = named(&request.half_a, found.half_a)?;
    found.half_b = named(&request.half_b, found.half_b)?;
    found.variance = named(&request.variance, found.variance)?;
    found.leave_out_single_half(&files.list);
    let is_told = found.half_a.is_some() || found.variance.is_some();
    // A half that was requested by name is not left out if the other half is missing.
    let is_named = found.half_a.is_none() && (request.half_a.is_some() || request.half_b.is_some());
    if found.left_out.is_empty() || is_told && !is_named {
        left_out.append(&mut found.left_out);
        return Ok(found.beside(mean));
    }
    Err(found.left_out.swap_remove(0).into_error())
}

/// Finds the layer that holds a file's colour.
pub(crate) fn color_layer(file: &ExrFile, wanted: Option<&str>) -> Result<usize> {
    if let Some(wanted) = wanted {
        return named_layer(file, wanted);
    }
    let colorful = |layer: &usize| color_channels(file, *layer).is_ok();
    let usual = (0..file.layers.len())
        .filter(colorful)
        .filter_map(|layer| names::color_rank(&file.layers[layer].name).map(|rank| (rank, layer)))
        .min();
    if let Some((_, layer)) = usual {
        return Ok(layer);
    }
    let other: Vec<usize> = (0..file.layers.len())
        .filter(colorful)
        .filter(|&layer| {
            let name = &file.layers[layer].name;
            names::companion_base(name).is_none()
                && !names::is_bare_half(name)
                && !names::is_feature_name(name)
                && names::why_not_a_variance(name).is_none()
        })
        .collect();
    match other.as_slice() {
        [only] => Ok(*only),
        _ if file.layers.len() == 1 && colorful(&0) => Ok(0),
        [] => Err(Error::File { path: file.path.clone(), cause: FileCause::NoColor { layers: file.layer_list() } }),
        several => Err(Error::File {
            path: file.path.clone(),
            cause: FileCause::SeveralColors {
                layers: text::list(several.iter().map(|&layer| file.layers[layer].described())),
            },
        }),
    }
}

fn named_layer(file: &ExrFile, wanted: &str) -> Result<usize> {
    let position = |matches: &dyn Fn(&FileLayer) -> bool| {
        let mut found = file.layers.iter().enumerate().filter(|(_, layer)| matches(layer)).map(|(index, _)| index);
        // A name that fits two layers counts as no match.
        found.next().filter(|_| found.next().is_none())
    };
    position(&|layer| layer.name == wanted)
        .or_else(|| position(&|layer| layer.name.eq_ignore_ascii_case(wanted)))
        .or_else(|| position(&|layer| names::last_component(&layer.name).eq_ignore_ascii_case(wanted)))
        .ok_or_else(|| Error::Layer {
            path: file.path.clone(),
            layer: wanted.to_owned(),
            cause: LayerCause::Missing { layers: file.layers_like(wanted) },
        })
}

/// Returns the channels R, G, B of a layer; a luminance stands for all three.
pub(crate) fn color_channels(file: &ExrFile, layer: usize) -> Result<Vec<usize>> {
    let layer = &file.layers[layer];
    let find = |suffix: &str| {
        layer.channels.iter().find(|channel| channel.suffix.eq_ignore_ascii_case(suffix)).map(|channel| channel.index)
    };
    if let (Some(r), Some(g), Some(b)) = (find("R"), find("G"), find("B")) {
        return Ok(vec![r, g, b]);
    }
    match find("Y") {
        Some(y) if find("X").is_none() => Ok(vec![y, y, y]),
        _ => Err(Error::Layer {
            path: file.path.clone(),
            layer: layer.name.clone(),
            cause: LayerCause::NoColor { layers: file.layer_list() },
        }),
    }
}

/// Returns the channels of a feature: all but the alpha. Returns `None` unless one to three are left.
fn feature_channels(layer: &FileLayer) -> Option<Vec<usize>> {
    let alpha = |suffix: &str| {
        layer.channels.len() > 1 && (suffix.eq_ignore_ascii_case("A") || suffix.eq_ignore_ascii_case("alpha"))
    };
    let channels: Vec<usize> =
        layer.channels.iter().filter(|channel| !alpha(&channel.suffix)).map(|channel| channel.index).collect();
    (1..=3).contains(&channels.len()).then_some(channels)
}

/// Half A, half B and variance that stand beside a layer in the same file.
#[derive(Default)]
struct Companions {
    half_a: Option<Planes>,
    half_b: Option<Planes>,
    variance: Option<Planes>,
    /// Companions that cannot be used.
    left_out: Vec<LeftOut>,
}

impl Companions {
    fn find(files: &[ExrFile], mean: &Planes, bare_too: bool) -> Self {
        let mut found = Self::default();
        found.add(files, mean, &files[mean.file].layers[mean.layer].name, bare_too);
        found
    }

    /// Adds the companions that are named after `base` and still missing.
    fn add(&mut self, files: &[ExrFile], mean: &Planes, base: &str, bare_too: bool) {
        let file = &files[mean.file];
        let parts = [
            (&mut self.half_a, SignalPart::HalfA),
            (&mut self.half_b, SignalPart::HalfB),
            (&mut self.variance, SignalPart::Variance),
        ];
        for (slot, part) in parts.into_iter().filter(|(slot, _)| slot.is_none()) {
            let named = |layer: &usize| {
                *layer != mean.layer && names::is_companion(&file.layers[*layer].name, base, part, bare_too)
            };
            let Some(layer) = (0..file.layers.len()).find(named) else { continue };
            match matching_channels(file, mean, layer) {
                Some(channels) => *slot = Some(Planes { file: mean.file, layer, channels }),
                None => {
                    let cause = LayerCause::CompanionChannels { of: file.layers[mean.layer].name.clone() };
                    self.left_out.push(LeftOut::new(files, mean.file, layer, cause));
                }
            }
        }
    }

    /// Leaves out a half without the other one, because it says nothing alone.
    fn leave_out_single_half(&mut self, files: &[ExrFile]) {
        let (single, missing) = match (&mut self.half_a, &mut self.half_b) {
            (single @ Some(_), None) => (single, 'B'),
            (None, single @ Some(_)) => (single, 'A'),
            _ => return,
        };
        if let Some(Planes { file, layer, .. }) = single.take() {
            self.left_out.push(LeftOut::new(files, file, layer, LayerCause::SingleHalf { missing }));
        }
    }

    fn beside(self, mean: Planes) -> SignalSource {
        SignalSource { mean, half_a: self.half_a, half_b: self.half_b, variance: self.variance }
    }
}

/// Returns the channels of `layer` that correspond to those of the mean: by name, or by position if the names differ
/// throughout (`Z` and `Y` of single channels). Returns `None` if they do not match.
fn matching_channels(file: &ExrFile, mean: &Planes, layer: usize) -> Option<Vec<usize>> {
    let mean_layer = &file.layers[mean.layer];
    let suffix_of = |index: &usize| {
        mean_layer.channels.iter().find(|channel| channel.index == *index).map(|channel| channel.suffix.as_str())
    };
    let candidate = &file.layers[layer];
    let by_name = |index: &usize| {
        let suffix = suffix_of(index)?;
        candidate
            .channels
            .iter()
            .find(|channel| channel.suffix.eq_ignore_ascii_case(suffix))
            .map(|channel| channel.index)
    };
    let by_name: Option<Vec<usize>> = mean.channels.iter().map(by_name).collect();
    by_name.or_else(|| feature_channels(candidate).filter(|channels| channels.len() == mean.channels.len()))
}

fn requested_feature(
    files: &mut Files,
    name: &str,
    reference: &LayerRef,
    left_out: &mut Vec<LeftOut>,
) -> Result<SignalSource> {
    let index = files.open(&reference.file)?;
    let file = &files.list[index];
    let (layer, bare_too) = match &reference.layer {
        Some(layer) => (named_layer(file, layer)?, false),
        None => match file.layers.iter().position(|layer| layer.name == name) {
            Some(layer) => (layer, false),
            None => (main_layer(file)?, true),
        },
    };
    let Some(channels) = feature_channels(&file.layers[layer]) else {
        return Err(Error::Layer {
            path: file.path.clone(),
            layer: file.layers[layer].name.clone(),
            cause: LayerCause::FeatureChannels { channels: file.layers[layer].channels.len() },
        });
    };
    let mean = Planes { file: index, layer, channels };
    let mut found = Companions::find(&files.list, &mean, bare_too);
    // A separate file may also name them after the feature: `R G B` with `albedo_halfA.R` ...
    if bare_too {
        found.add(&files.list, &mean, name, false);
    }
    found.leave_out_single_half(&files.list);
    left_out.append(&mut found.left_out);
    Ok(found.beside(mean))
}

/// Returns the layer meant by a file that is named without a layer: the only layer, the layer without a name, or the
/// colour.
fn main_layer(file: &ExrFile) -> Result<usize> {
    if file.layers.len() == 1 {
        return Ok(0);
    }
    match file.layers.iter().position(|layer| layer.name.is_empty()) {
        Some(layer) => Ok(layer),
        None => color_layer(file, None),
    }
}

/// Adds the input's own features to the requested ones, unless the request excludes them. Each name to skip must match
/// one of these features: its whole name, or the part behind one of its dots.
fn find_features(
    files: &[ExrFile],
    color: &SignalSource,
    request: &BufferSetRequest,
    features: &mut Vec<(String, SignalSource)>,
    notes: &mut Vec<(usize, String)>,
    left_out: &mut Vec<LeftOut>,
) -> Result<()> {
    let file = &files[0];
    let taken = |layer: usize| {
        [Some(&color.mean), color.half_a.as_ref(), color.half_b.as_ref(), color.variance.as_ref()]
            .into_iter()
            .flatten()
            .any(|planes| planes.file == 0 && planes.layer == layer)
    };
    let group = names::group(&file.layers[color.mean.layer].name);
    let mut not_there: Vec<&String> = request.skip_features.iter().collect();
    for (layer, candidate) in file.layers.iter().enumerate() {
        let name = candidate.name.strip_prefix(group).unwrap_or(&candidate.name);
        if taken(layer) || names::why_not_a_variance(&candidate.name).is_some() || names::is_sample_count_name(name) {
            continue;
        }
        // A companion is used with its layer only. If that layer is not in the file, a note says so.
        if let Some((base, _)) = names::companion_base(&candidate.name) {
            if !file.layers.iter().any(|other| other.name == base) {
                notes.push((layer, format!("its layer '{}' is not in the file", text::name(base))));
            }
            continue;
        }
        let has_companions = file.layers.iter().any(|other| {
            let belongs = |part| names::is_companion(&other.name, &candidate.name, part, false);
            belongs(SignalPart::HalfA) || belongs(SignalPart::HalfB) || belongs(SignalPart::Variance)
        });
        if !has_companions && !names::is_feature_name(name) {
            continue;
        }
        let is_named = |skip: &str| {
            candidate.name.strip_suffix(skip).is_some_and(|before| before.is_empty() || before.ends_with('.'))
        };
        let skipped = request.skip_features.iter().any(|skip| is_named(skip));
        not_there.retain(|skip| !is_named(skip));
        if request.no_features {
            continue;
        }
        let Some(channels) = feature_channels(candidate) else {
            notes.push((layer, "a feature has one to three channels".into()));
            continue;
        };
        if skipped {
            notes.push((layer, "left out on request".into()));
        } else if features.iter().any(|(other, _)| other == name) {
            notes.push((layer, "replaced by the feature of that name given on request".into()));
        } else if features.len() == MAX_FEATURES {
            notes.push((layer, format!("left out: at most {MAX_FEATURES} features can be used")));
        } else {
            let mean = Planes { file: 0, layer, channels };
            let mut found = Companions::find(files, &mean, false);
            found.leave_out_single_half(files);
            left_out.append(&mut found.left_out);
            features.push((name.to_owned(), found.beside(mean)));
        }
    }
    match not_there.first() {
        None => Ok(()),
        Some(skip) => Err(Error::File {
            path: file.path.clone(),
            cause: FileCause::NoFeatureToSkip { name: (*skip).clone(), layers: file.layers_like(skip) },
        }),
    }
}

fn sample_count(file: &ExrFile) -> Option<Planes> {
    let layer =
        file.layers.iter().position(|layer| layer.channels.len() == 1 && names::is_sample_count_name(&layer.name))?;
    Some(Planes { file: 0, layer, channels: vec![file.layers[layer].channels[0].index] })
}

/// Checks that all images of a set show the same pixels.
fn check_windows(set: &BufferSet) -> Result<()> {
    let expected = set.data_window();
    for (planes, _) in used_planes(set) {
        let file = &set.files[planes.file];
        let layer = &file.layers[planes.layer];
        let found = file.data_window(layer.part);
        // A separate file may be cropped to its data window: its pixels are the same if the extent is.
        let same = if planes.file == 0 { found == expected } else { found.extent == expected.extent };
        if !same {
            return Err(Error::Layer {
                path: file.path.clone(),
                layer: layer.name.clone(),
                cause: LayerCause::DataWindow {
                    found: found.to_string(),
                    expected: expected.to_string(),
                    color_file: set.input().to_owned(),
                },
            });
        }
    }
    Ok(())
}
