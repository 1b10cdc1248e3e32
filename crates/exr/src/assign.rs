//! Decides the use of each layer.

use std::path::{Path, PathBuf};

use crate::buffer_set::BufferSet;
use crate::classify::{Classified, LayerId, Meaning, Rank, Scope, classify, is_whole_numbers};
use crate::file::ExrFile;
use crate::layer_ref::LayerRef;
use crate::layers::{self, FileLayer};
use crate::layout::{Layout, Quantity, Recognised, RoleName, Rule, Unit, native, recognise};
use crate::names;
use crate::picture_file::PngEncoding;
use crate::request::BufferSetRequest;
use crate::siblings::{self, Sibling};
use crate::source::{self, Picture, Planes, SignalSource, VarianceSource};
use crate::uses::{Note, layer_uses};
use crate::{counts, seeds};
use stein::error::{Error, FileCause, LayerCause, RequestCause, Result};
use stein::frame::{FeatureKind, MAX_FEATURES, SamplesPerPixel};
use stein::image::Window;
use stein::text;

pub(crate) fn read(request: &BufferSetRequest) -> Result<BufferSet> {
    let mut input = ExrFile::read(&request.input, request.png_encoding)?;
    let recognised = match &request.layout {
        Some(name) => Recognised::requested(Layout::named(name)?, &request.input),
        None => recognise(&input, !request.no_siblings),
    };
    let joins = recognised.layout.joins.iter().filter(|join| join.file.is_none());
    joins.for_each(|join| layers::join(&mut input.layers, join));
    let mut files = Files::new(input, &recognised);
    files.png_encoding = request.png_encoding;
    let Siblings { files: siblings, seeds } = files.open_siblings(request, &recognised);
    let request = &BufferSetRequest { seeds: [request.seeds.clone(), seeds].concat(), ..request.clone() };
    let mut left_out = Vec::new();
    let colors = files.colors(request.layer.as_deref())?;
    check_is_one_picture(request, colors.len())?;
    let mut pictures = Vec::new();
    for color in &colors {
        let mut picture = files.picture(color, colors.len(), &recognised.layout, request);
        files.add_noise(&mut picture, color.is_main, request, &mut left_out)?;
        files.add_features(&mut picture, request, &mut left_out)?;
        pictures.push(picture);
    }
    files.check_skipped(request)?;

    let mut notes: Vec<Note> = left_out.into_iter().map(LeftOut::into_note).collect();
    notes.append(&mut files.layer_notes);
    notes.extend(files.orphans());
    let mut set = BufferSet {
        files: files.list,
        pictures,
        layout: recognised.by,
        notes: files.notes,
        siblings,
        seeds: Vec::new(),
        stale: Vec::new(),
        png_encoding: request.png_encoding,
        layer_uses: Vec::new(),
    };
    if !request.seeds.is_empty() {
        notes.extend(seeds::merge(&mut set, request, &files.classified[0], &recognised.layout)?);
    }
    set.layer_uses = layer_uses(&set, &files.classified, &files.rules, &notes);
    Ok(set)
}

/// Files beside the input.
#[derive(Default)]
struct Siblings {
    /// Files with further layers.
    files: Vec<PathBuf>,
    /// Other renders of the same frame.
    seeds: Vec<PathBuf>,
}

/// A layer that is left out because of a problem.
struct LeftOut {
    id: LayerId,
    path: PathBuf,
    name: String,
    cause: LayerCause,
}

impl LeftOut {
    fn new(files: &[ExrFile], id: LayerId, cause: LayerCause) -> Self {
        let file = &files[id.file];
        Self { id, path: file.path.clone(), name: file.layers[id.layer].name.clone(), cause }
    }

    fn into_note(self) -> Note {
        Note { id: self.id, text: self.cause.to_string() }
    }

    /// Converts to the error for a layer that is required.
    fn into_error(self) -> Error {
        Error::Layer { path: self.path, layer: self.name, cause: self.cause }
    }
}

/// The files of a set, and the meanings of their layers.
struct Files {
    list: Vec<ExrFile>,
    classified: Vec<Classified>,
    /// Rules of the layout, and behind them those of the native layout, which knows the usual names.
    rules: Vec<Rule>,
    /// Meaning of the values in PNG files.
    png_encoding: PngEncoding,
    /// Remarks on files.
    notes: Vec<String>,
    /// Remarks on layers that are not used.
    layer_notes: Vec<Note>,
    /// Positions of the files whose layers belong to the pictures without being named: the input and files beside it.
    own_files: Vec<usize>,
    /// Names of features to skip that were found.
    skipped: Vec<String>,
}

/// A colour that is to be denoised.
struct Color {
    layer: usize,
    channels: Vec<usize>,
    /// Whether it is the layer that bare names such as `halfA` refer to.
    is_main: bool,
}

impl Files {
    fn new(input: ExrFile, recognised: &Recognised) -> Self {
        let mut rules = recognised.layout.rules.clone();
        let native = native();
        if recognised.layout.name() != native.name() {
            // Files beside the input are named by the layout alone.
            rules.extend(native.rules.iter().filter(|rule| rule.files.is_empty()).cloned());
        }
        let classified = vec![classify(&rules, &input, 0, None)];
        Self {
            list: vec![input],
            classified,
            rules,
            png_encoding: PngEncoding::Srgb,
            notes: Vec::new(),
            layer_notes: Vec::new(),
            own_files: vec![0],
            skipped: Vec::new(),
        }
    }

    fn open(&mut self, path: &Path) -> Result<usize> {
        match self.list.iter().position(|file| file.path == path) {
            Some(index) => Ok(index),
            None => {
                self.add(ExrFile::read(path, self.png_encoding)?, false);
                Ok(self.list.len() - 1)
            }
        }
    }

    /// Adds a file. Its layers may describe those of the input if it belongs to the input.
    fn add(&mut self, file: ExrFile, is_own: bool) {
        let input = self.list.first().filter(|_| is_own);
        let classified = classify(&self.rules, &file, self.list.len(), input);
        self.classified.push(classified);
        self.list.push(file);
    }

    fn layer(&self, id: LayerId) -> &FileLayer {
        &self.list[id.file].layers[id.layer]
    }

    fn meaning(&self, id: LayerId) -> Option<&Meaning> {
        self.classified[id.file].meanings[id.layer].as_ref()
    }

    fn ids(&self) -> impl Iterator<Item = LayerId> + use<> {
        let counts: Vec<usize> = self.list.iter().map(|file| file.layers.len()).collect();
        counts.into_iter().enumerate().flat_map(|(file, count)| (0..count).map(move |layer| LayerId { file, layer }))
    }

    fn rule(&self, id: LayerId) -> Option<&Rule> {
        self.meaning(id).map(|meaning| &self.rules[meaning.rank.rule])
    }

    /// Opens the files beside the input that belong to it. A file that cannot be read is left out and named.
    fn open_siblings(&mut self, request: &BufferSetRequest, recognised: &Recognised) -> Siblings {
        let mut siblings = Siblings::default();
        if request.no_siblings {
            return siblings;
        }
        let stem = recognised.stem.as_deref();
        let found = siblings::find(&self.rules, &request.input, stem);
        for sibling in found.into_iter().filter(|sibling| !request.seeds.contains(&sibling.path)) {
            if self.rules[sibling.rule].role == Some(RoleName::Seed) {
                siblings.seeds.push(sibling.path);
                continue;
            }
            match self.open_sibling(&sibling, recognised, &request.input) {
                Ok(()) if siblings.files.contains(&sibling.path) => {}
                Ok(()) => siblings.files.push(sibling.path),
                Err(error) => self.notes.push(format!("not used: {error}")),
            }
        }
        siblings
    }

    fn open_sibling(&mut self, sibling: &Sibling, recognised: &Recognised, input: &Path) -> Result<()> {
        let rule = self.rules[sibling.rule].clone();
        let has_more = rule.role == Some(RoleName::More);
        let index = match self.list.iter().position(|file| file.path == sibling.path) {
            Some(index) => index,
            None => {
                let mut file = ExrFile::read(&sibling.path, self.png_encoding)?;
                for join in &recognised.layout.joins {
                    let is_here = |stem: &String| siblings::is(stem, input, recognised.stem.as_deref(), &sibling.path);
                    if join.file.as_ref().is_none_or(is_here) {
                        layers::join(&mut file.layers, join);
                    }
                }
                self.add(file, true);
                let index = self.list.len() - 1;
                self.own_files.push(index);
                if !has_more {
                    // The rules for files alone say what such a file holds.
                    self.classified[index].meanings.iter_mut().for_each(|meaning| *meaning = None);
                    self.classified[index].orphans.clear();
                }
                index
            }
        };
        if has_more {
            return Ok(());
        }
        let of = match &sibling.of {
            None => None,
            Some(path) => match self.list.iter().position(|other| other.path == *path) {
                // The file that this one describes could not be read.
                None => return Ok(()),
                Some(0) => Some(LayerId { file: 0, layer: color_layer_of(&self.list[0], None)? }),
                Some(other) => Some(LayerId { file: other, layer: main_layer(&self.list[other])? }),
            },
        };
        let file = &self.list[index];
        let layers: Vec<usize> = if rule.names.is_empty() {
            vec![main_layer(file)?]
        } else {
            let is_named = |layer: &usize| {
                let own = &file.layers[*layer];
                rule.fits_channels(own) && rule.names.iter().any(|name| name.fit(&own.key).is_some())
            };
            (0..file.layers.len()).filter(is_named).collect()
        };
        for layer in layers {
            let meaning = Meaning::new(Rank { rule: sibling.rule, ..Rank::default() }, &rule, String::new(), of);
            self.classified[index].meanings[layer].get_or_insert(meaning);
        }
        Ok(())
    }

    /// Returns the colours that are to be denoised: the requested layer, or the best one of each view layer and view.
    fn colors(&self, wanted: Option<&str>) -> Result<Vec<Color>> {
        let file = &self.list[0];
        if let Some(wanted) = wanted {
            let layer = named_layer(file, wanted)?;
            let channels = color_channels(file, layer)?;
            let id = LayerId { file: 0, layer };
            let scope = self.scope(id);
            let best = self.best_colors().into_iter().find(|(_, other)| self.scope(*other) == scope);
            return Ok(vec![Color { layer, channels, is_main: best.is_none_or(|(_, best)| best == id) }]);
        }
        let best = self.best_colors();
        if !best.is_empty() {
            let color = |(_, id): (_, LayerId)| {
                let channels = self.channels_of_color(id)?;
                Ok(Color { layer: id.layer, channels, is_main: true })
            };
            return best.into_iter().map(color).collect();
        }
        let layer = self.only_color()?;
        Ok(vec![Color { layer, channels: self.channels_of_color(LayerId { file: 0, layer })?, is_main: true }])
    }

    fn channels_of_color(&self, id: LayerId) -> Result<Vec<usize>> {
        let unit = self.rule(id).and_then(|rule| rule.unit);
        let layer = self.layer(id);
        match unit.filter(|unit| *unit == Unit::Xyz).map(|_| ["X", "Y", "Z"].map(|name| layer.channel(name))) {
            Some([Some(x), Some(y), Some(z)]) => Ok(vec![x, y, z]),
            _ => color_channels(&self.list[id.file], id.layer),
        }
    }

    /// Returns the best colour of each picture, with its rank: of each part, view layer and view.
    fn best_colors(&self) -> Vec<(Rank, LayerId)> {
        let is_color = |id: &LayerId| {
            self.meaning(*id).is_some_and(|meaning| meaning.is_mean_of(|role| role == RoleName::Color))
                && self.channels_of_color(*id).is_ok()
        };
        let all: Vec<LayerId> = self.ids().filter(|id| id.file == 0).filter(is_color).collect();
        let is_second_choice =
            |id: &LayerId| self.rule(*id).is_some_and(|rule| rule.is_fallback || rule.is_copy);
        let first_choice: Vec<LayerId> = all.iter().copied().filter(|id| !is_second_choice(id)).collect();
        let candidates = if first_choice.is_empty() { all } else { first_choice };
        let mut best: Vec<(Rank, LayerId)> = Vec::new();
        for id in candidates {
            let Some(rank) = self.meaning(id).map(|meaning| meaning.rank) else { continue };
            match best.iter_mut().find(|(_, other)| self.scope(*other) == self.scope(id)) {
                Some(other) if rank < other.0 => *other = (rank, id),
                Some(_) => {}
                None => best.push((rank, id)),
            }
        }
        // Plain R G B is the whole picture; layers of groups beside it are parts of it or other versions.
        let plain: Vec<Scope> =
            best.iter().filter(|(_, id)| self.layer(*id).key.is_empty()).map(|(_, id)| self.scope(*id)).collect();
        let is_beside_plain = |scope: &Scope| {
            plain.iter().any(|plain| (plain.part, &plain.view) == (scope.part, &scope.view) && plain != scope)
        };
        best.retain(|(_, id)| !is_beside_plain(&self.scope(*id)));
        best
    }

    /// Returns the only layer that could be the colour though no name says so.
    fn only_color(&self) -> Result<usize> {
        let file = &self.list[0];
        let colorful = |layer: &usize| color_channels(file, *layer).is_ok();
        let is_unknown = |layer: &usize| self.meaning(LayerId { file: 0, layer: *layer }).is_none();
        let other: Vec<usize> = (0..file.layers.len()).filter(colorful).filter(is_unknown).collect();
        match other.as_slice() {
            [only] => Ok(*only),
            _ if file.layers.len() == 1 && colorful(&0) => Ok(0),
            [] => {
                // A colour of which a channel is missing.
                let is_color = |id: &LayerId| {
                    self.meaning(*id).is_some_and(|meaning| meaning.is_mean_of(|role| role == RoleName::Color))
                };
                if let Some(incomplete) = self.ids().filter(|id| id.file == 0).find(is_color) {
                    color_channels(file, incomplete.layer)?;
                }
                Err(Error::File { path: file.path.clone(), cause: FileCause::NoColor { layers: file.layer_list() } })
            }
            several => Err(Error::File {
                path: file.path.clone(),
                cause: FileCause::SeveralColors {
                    layers: text::list(several.iter().map(|&layer| file.layers[layer].described())),
                },
            }),
        }
    }

    fn scope(&self, id: LayerId) -> Scope {
        Scope::of(self.layer(id), self.meaning(id))
    }

    /// Whether a layer belongs to a picture. A file beside the input belongs to its only picture.
    fn is_in(&self, id: LayerId, picture: &Picture) -> bool {
        if id.file > 0 { self.own_files.contains(&id.file) && picture.is_only } else { self.scope(id) == picture.scope }
    }

    /// Makes a picture of a colour, without noise and features.
    fn picture(&self, color: &Color, count: usize, layout: &Layout, request: &BufferSetRequest) -> Picture {
        let id = LayerId { file: 0, layer: color.layer };
        let is_color = self.meaning(id).is_some_and(|meaning| meaning.role == Some(RoleName::Color));
        let scope = Scope::of(self.layer(id), self.meaning(id).filter(|_| is_color));
        let samples_layer = self.ids().filter(|other| self.own_files.contains(&other.file)).find(|other| {
            let is_count = self.meaning(*other).is_some_and(|meaning| meaning.role == Some(RoleName::Samples));
            let own = self.scope(*other);
            // A count without a group belongs to all pictures of its part.
            let is_shared = own.group.is_empty() && (own.part, &own.view) == (scope.part, &scope.view);
            is_count && (own == scope || is_shared || other.file > 0 && count == 1)
        });
        let is_fraction = samples_layer
            .and_then(|layer| self.meaning(layer))
            .is_some_and(|meaning| meaning.quantity == Quantity::Fraction);
        let counted = samples_layer.map(|layer| Planes {
            file: layer.file,
            layer: layer.layer,
            channels: vec![self.layer(layer).channels[0].index],
        });
        let window = self.list[0].data_window(self.layer(id).part);
        let (samples, samples_layer) = match request.samples {
            Some(count) => (SamplesPerPixel::Uniform(count as f32), None),
            None => {
                let header = counts::in_header(&self.list[0], self.layer(id).part, layout, &scope.group);
                counts::known(&self.list, window, header, counted, is_fraction)
            }
        };
        let mean = Planes { file: 0, layer: color.layer, channels: color.channels.clone() };
        let unit = self.rule(id).and_then(|rule| rule.unit);
        let source =
            SignalSource { mean, half_a: None, half_b: None, variance: None, miss: None, outside: 0.0, unit };
        Picture {
            scope,
            is_only: count == 1,
            color: source,
            features: Vec::new(),
            samples,
            samples_layer,
            counts_are_fractions: is_fraction,
        }
    }

    /// Finds halves and variance of a picture's colour. Leaves out faulty ones as long as another source tells of the
    /// noise.
    fn add_noise(
        &mut self,
        picture: &mut Picture,
        is_main: bool,
        request: &BufferSetRequest,
        left_out: &mut Vec<LeftOut>,
    ) -> Result<()> {
        let window = self.window(&picture.color.mean);
        let id = LayerId { file: 0, layer: picture.color.mean.layer };
        let mut found = Companions::default();
        let belongs = |other: LayerId, meaning: &Meaning| {
            let is_of = |of: LayerId| {
                // Other versions of the same picture have its noise.
                let is_copy = self.rule(of).is_some_and(|rule| rule.is_copy)
                    && (self.layer(of).scope_part, &self.layer(of).view) == (picture.scope.part, &picture.scope.view);
                of == id || is_main && (is_copy || other.file > 0 && of.file == 0 && picture.is_only)
            };
            match meaning.of {
                Some(of) => is_of(of),
                None => is_main && meaning.role == Some(RoleName::Color) && self.is_in(other, picture),
            }
        };
        found.add(self, &picture.color.mean, &picture.samples, window, belongs);
        let named = |files: &mut Self, reference: &Option<LayerRef>| match reference {
            None => Ok(None),
            Some(reference) => files.requested_planes(reference, &picture.color.mean, window).map(Some),
        };
        if let Some(half) = named(self, &request.half_a)? {
            found.half_a = Some(half);
        }
        if let Some(half) = named(self, &request.half_b)? {
            found.half_b = Some(half);
        }
        if let Some(planes) = named(self, &request.variance)? {
            found.variance = Some(self.requested_variance(planes, &picture.samples)?);
        }
        found.leave_out_single_half(&self.list);
        let is_known = found.half_a.is_some() || found.variance.is_some() || !request.seeds.is_empty();
        // A half that was requested by name is not left out if the other half is missing.
        let is_named = found.half_a.is_none() && (request.half_a.is_some() || request.half_b.is_some());
        if found.left_out.is_empty() || is_known && !is_named {
            left_out.append(&mut found.left_out);
            found.put_into(&mut picture.color);
            return Ok(());
        }
        Err(found.left_out.swap_remove(0).into_error())
    }

    fn window(&self, planes: &Planes) -> Window {
        let file = &self.list[planes.file];
        file.data_window(file.layers[planes.layer].part)
    }

    /// Returns the planes of a requested half or variance of the colour `mean`.
    fn requested_planes(&mut self, reference: &LayerRef, mean: &Planes, window: Window) -> Result<Planes> {
        let file = self.open(&reference.file)?;
        if file == 0 && reference.layer.is_none() {
            return Err(Error::Request(RequestCause::InputItself { file: reference.file.clone() }));
        }
        // In a file with the same layers, the layer of the same name is meant.
        let own = &self.layer(LayerId { file: mean.file, layer: mean.layer }).name;
        let same = || self.list[file].layers.iter().position(|layer| !own.is_empty() && layer.name == *own);
        let layer = match reference.layer.as_deref() {
            None => same().map_or_else(|| color_layer_of(&self.list[file], None), Ok)?,
            named => color_layer_of(&self.list[file], named)?,
        };
        let channels = color_channels(&self.list[file], layer)?;
        let planes = Planes { file, layer, channels };
        self.check_window(&planes, window).map_err(LeftOut::into_error)?;
        Ok(planes)
    }

    /// Returns a requested variance with the quantity that its name says.
    fn requested_variance(&self, planes: Planes, samples: &SamplesPerPixel) -> Result<VarianceSource> {
        let id = LayerId { file: planes.file, layer: planes.layer };
        let refuse = |cause| Err(LeftOut::new(&self.list, id, cause).into_error());
        let rule = self.rule(id);
        let quantity = rule.map_or(Quantity::VarianceOfMean, |rule| rule.quantity);
        let quantity = match quantity {
            Quantity::NotAVariance => {
                let why = rule.and_then(|rule| rule.why.clone()).unwrap_or_default();
                return refuse(LayerCause::NotAVariance { why });
            }
            quantity if quantity.is_variance() => quantity,
            _ => Quantity::VarianceOfMean,
        };
        if quantity != Quantity::VarianceOfMean && *samples == SamplesPerPixel::Unknown {
            return refuse(LayerCause::NeedsSamples { quantity: quantity.to_string() });
        }
        let mean = match (quantity, self.meaning(id).and_then(|meaning| meaning.of)) {
            (Quantity::SecondMoment, Some(of)) => self.matching_channels(&planes, of),
            _ => None,
        };
        if quantity == Quantity::SecondMoment && mean.is_none() {
            return refuse(LayerCause::NotAVariance { why: "a second moment whose mean is not in the file".into() });
        }
        Ok(VarianceSource { planes, quantity, mean, unknown: rule.and_then(|rule| rule.unknown) })
    }

    /// Refuses planes that do not cover the colour's pixels.
    fn check_window(&self, planes: &Planes, window: Window) -> std::result::Result<(), LeftOut> {
        let file = &self.list[planes.file];
        let own = source::window_of(file, file.layers[planes.layer].part, window);
        if source::covers(own, window) { Ok(()) } else { Err(self.outside(planes, own, window)) }
    }

    fn outside(&self, planes: &Planes, own: Window, window: Window) -> LeftOut {
        let (found, expected) = (own.to_string(), window.to_string());
        let cause = LayerCause::DataWindow { found, expected, color_file: self.list[0].path.clone() };
        LeftOut::new(&self.list, LayerId { file: planes.file, layer: planes.layer }, cause)
    }

    /// Returns the channels of `layer` that correspond to `planes`: by name, or by position if the names differ
    /// throughout (`Z` and `Y` of single channels). Returns `None` if they do not match.
    fn matching_channels(&self, planes: &Planes, layer: LayerId) -> Option<Planes> {
        let own = self.layer(LayerId { file: planes.file, layer: planes.layer });
        let candidate = self.layer(layer);
        let by_name = |index: &usize| {
            let suffix = own.channels.iter().find(|channel| channel.index == *index)?;
            candidate.channels.iter().find(|channel| channel.is(suffix.letter())).map(|channel| channel.index)
        };
        let by_name: Option<Vec<usize>> = planes.channels.iter().map(by_name).collect();
        let by_place = || feature_channels(candidate).filter(|channels| channels.len() == planes.channels.len());
        let channels = by_name.or_else(by_place)?;
        Some(Planes { file: layer.file, layer: layer.layer, channels })
    }

    /// Adds the requested features, and the input's own ones unless the request excludes them.
    fn add_features(
        &mut self,
        picture: &mut Picture,
        request: &BufferSetRequest,
        left_out: &mut Vec<LeftOut>,
    ) -> Result<()> {
        for (name, reference) in &request.features {
            if picture.features.iter().any(|(other, _)| other == name) {
                return Err(Error::Request(RequestCause::FeatureTwice { name: name.clone() }));
            }
            let source = self.requested_feature(name, reference, picture, left_out)?;
            picture.features.push((name.clone(), source));
        }
        if picture.features.len() > MAX_FEATURES {
            let given = picture.features.len();
            return Err(Error::Request(RequestCause::TooManyFeatures { given, most: MAX_FEATURES }));
        }
        self.find_features(picture, request, left_out);
        self.add_feature_noise(picture, request)
    }

    fn requested_feature(
        &mut self,
        name: &str,
        reference: &LayerRef,
        picture: &Picture,
        left_out: &mut Vec<LeftOut>,
    ) -> Result<SignalSource> {
        // Directions and distances are no light, so that no curve applies to them.
        let is_light = matches!(FeatureKind::from_name(name), FeatureKind::Albedo | FeatureKind::Other);
        let encoding = std::mem::replace(&mut self.png_encoding, PngEncoding::Linear);
        self.png_encoding = if is_light { encoding } else { PngEncoding::Linear };
        let index = self.open(&reference.file);
        self.png_encoding = encoding;
        let index = index?;
        let file = &self.list[index];
        let (layer, is_main) = match &reference.layer {
            Some(layer) => (named_layer(file, layer)?, false),
            None => match file.layers.iter().position(|layer| layer.name == name) {
                Some(layer) => (layer, false),
                None => (main_layer(file)?, true),
            },
        };
        let id = LayerId { file: index, layer };
        let mean = self.feature_planes(id).map_err(LeftOut::into_error)?;
        let window = self.window(&picture.color.mean);
        let mut source = self.feature_source(mean, name, id);
        self.check_overlap(&source.mean, window).map_err(LeftOut::into_error)?;
        let mut found = Companions::default();
        let belongs = |other: LayerId, meaning: &Meaning| {
            let is_bare = is_main && meaning.of.is_none() && meaning.role == Some(RoleName::Color);
            other.file == index && (meaning.of == Some(id) || is_bare)
        };
        found.add(self, &source.mean, &picture.samples, window, belongs);
        // A separate file may also name them after the feature: `R G B` with `albedo_halfA.R` ...
        if is_main {
            found.add_orphans(self, &source.mean, name, &picture.samples);
        }
        found.leave_out_single_half(&self.list);
        left_out.append(&mut found.left_out);
        found.put_into(&mut source);
        Ok(source)
    }

    fn feature_planes(&self, id: LayerId) -> std::result::Result<Planes, LeftOut> {
        let layer = self.layer(id);
        match feature_channels(layer) {
            Some(channels) => Ok(Planes { file: id.file, layer: id.layer, channels }),
            None => {
                let cause = LayerCause::FeatureChannels { channels: layer.channels.len() };
                Err(LeftOut::new(&self.list, id, cause))
            }
        }
    }

    fn feature_source(&self, mean: Planes, name: &str, id: LayerId) -> SignalSource {
        let is_distance = FeatureKind::from_name(name) == FeatureKind::Distance;
        SignalSource {
            mean,
            half_a: None,
            half_b: None,
            variance: None,
            miss: self.rule(id).and_then(|rule| rule.miss),
            // Outside of a cropped layer, no ray hit anything.
            outside: if is_distance { f32::INFINITY } else { 0.0 },
            unit: self.rule(id).and_then(|rule| rule.unit),
        }
    }

    fn check_overlap(&self, planes: &Planes, window: Window) -> std::result::Result<(), LeftOut> {
        let file = &self.list[planes.file];
        let own = source::window_of(file, file.layers[planes.layer].part, window);
        if source::overlap(own, window) > 0 { Ok(()) } else { Err(self.outside(planes, own, window)) }
    }

    /// Adds the picture's own features: one for each role, and layers that come with halves or a variance. Each name to
    /// skip must match one of them: its whole name, the part behind one of its dots, or the name of its role.
    fn find_features(
        &mut self,
        picture: &mut Picture,
        request: &BufferSetRequest,
        left_out: &mut Vec<LeftOut>,
    ) {
        let window = self.window(&picture.color.mean);
        let of_color: Vec<LayerId> =
            picture.color.planes().map(|planes| LayerId { file: planes.file, layer: planes.layer }).collect();
        let mut candidates: Vec<FeatureCandidate> =
            self.ids().filter(|id| !of_color.contains(id)).filter_map(|id| self.feature_candidate(id, picture)).collect();
        let is_named = |skip: &str, candidate: &FeatureCandidate| {
            ends_with(&self.layer(candidate.id).name, skip) || candidate.name == skip
        };
        let found = request.skip_features.iter().filter(|skip| candidates.iter().any(|it| is_named(skip, it)));
        let found: Vec<String> = found.cloned().collect();
        let mut notes = Vec::new();
        let mut note = |id: LayerId, text: String| notes.push(Note { id, text });
        candidates.retain(|candidate| {
            let is_skipped = request.skip_features.iter().any(|skip| is_named(skip, candidate));
            if is_skipped && !request.no_features {
                note(candidate.id, "left out on request".into());
            }
            !is_skipped && !request.no_features
        });
        for index in 0..candidates.len() {
            let candidate = &candidates[index];
            let better = candidates
                .iter()
                .filter(|other| other.name == candidate.name && other.rank < candidate.rank)
                .min_by_key(|other| other.rank);
            if let Some(better) = better {
                note(candidate.id, format!("'{}' is the better {}", text::name(&self.layer(better.id).name), better.name));
                continue;
            }
            let FeatureCandidate { id, name, .. } = candidate;
            if is_whole_numbers(&self.list[id.file], id.layer) {
                note(*id, "whole numbers are not a feature".into());
                continue;
            }
            let mean = match self.feature_planes(*id).and_then(|mean| self.check_overlap(&mean, window).map(|()| mean)) {
                Ok(mean) => mean,
                Err(trouble) => {
                    left_out.push(trouble);
                    continue;
                }
            };
            if picture.features.iter().any(|(other, _)| other == name) {
                note(*id, "replaced by the feature of that name given on request".into());
            } else if picture.features.len() == MAX_FEATURES {
                note(*id, format!("left out: at most {MAX_FEATURES} features can be used"));
            } else {
                let mut source = self.feature_source(mean, name, *id);
                let mut found = Companions::default();
                let belongs = |other: LayerId, meaning: &Meaning| {
                    let is_of_role = meaning.of.is_none()
                        && candidate.has_role_name
                        && meaning.role.and_then(RoleName::feature_name) == Some(name)
                        && self.is_in(other, picture);
                    meaning.of == Some(*id) || is_of_role
                };
                found.add(self, &source.mean, &picture.samples, window, belongs);
                found.leave_out_single_half(&self.list);
                left_out.append(&mut found.left_out);
                found.put_into(&mut source);
                picture.features.push((name.clone(), source));
            }
        }
        self.layer_notes.append(&mut notes);
        self.skipped.extend(found);
    }

    /// Returns the layer as a feature of the picture, if it is one.
    fn feature_candidate(&self, id: LayerId, picture: &Picture) -> Option<FeatureCandidate> {
        if !self.is_in(id, picture) {
            return None;
        }
        let (role, rank) = match self.meaning(id) {
            Some(meaning) if meaning.is_mean_of(RoleName::is_feature) => (meaning.role?, meaning.rank),
            Some(_) => return None,
            None if self.has_companions(id) => (RoleName::Feature, Rank { rule: usize::MAX, ..Rank::default() }),
            None => return None,
        };
        let key = &self.layer(id).key;
        let local = key.strip_prefix(picture.scope.group.as_str()).unwrap_or(key);
        let name = role.feature_name().unwrap_or(local).to_owned();
        Some(FeatureCandidate { id, name, rank, has_role_name: role.feature_name().is_some() })
    }

    /// Whether halves or a variance of the layer are in its file.
    fn has_companions(&self, id: LayerId) -> bool {
        let meanings = self.classified[id.file].meanings.iter().flatten();
        meanings.filter(|meaning| meaning.of == Some(id)).any(|meaning| {
            matches!(meaning.quantity, Quantity::HalfA | Quantity::HalfB) || meaning.quantity.is_variance()
        })
    }

    /// Adds halves and variances that were requested for features by name.
    fn add_feature_noise(&mut self, picture: &mut Picture, request: &BufferSetRequest) -> Result<()> {
        let window = self.window(&picture.color.mean);
        let parts = [&request.feature_half_a, &request.feature_half_b, &request.feature_variance];
        for (part, requested) in parts.into_iter().enumerate() {
            for (name, reference) in requested {
                let index = self.open(&reference.file)?;
                let file = &self.list[index];
                let layer = match &reference.layer {
                    Some(layer) => named_layer(file, layer)?,
                    None => main_layer(file)?,
                };
                let id = LayerId { file: index, layer };
                let Some((_, source)) = picture.features.iter_mut().find(|(other, _)| other == name) else {
                    return Err(Error::Request(RequestCause::NoSuchFeature { name: name.clone() }));
                };
                let Some(planes) = self.matching_channels(&source.mean, id) else {
                    let of = self.list[source.mean.file].layers[source.mean.layer].name.clone();
                    return Err(LeftOut::new(&self.list, id, LayerCause::CompanionChannels { of }).into_error());
                };
                self.check_overlap(&planes, window).map_err(LeftOut::into_error)?;
                match part {
                    0 => source.half_a = Some(planes),
                    1 => source.half_b = Some(planes),
                    _ => source.variance = Some(self.requested_variance(planes, &picture.samples)?),
                }
            }
        }
        for (name, source) in &picture.features {
            let missing = match (&source.half_a, &source.half_b) {
                (Some(half), None) => Some((half, 'B')),
                (None, Some(half)) => Some((half, 'A')),
                _ => None,
            };
            if let Some((half, missing)) = missing {
                let id = LayerId { file: half.file, layer: half.layer };
                let mut trouble = LeftOut::new(&self.list, id, LayerCause::SingleHalf { missing });
                trouble.name = format!("{} (feature {name})", trouble.name);
                return Err(trouble.into_error());
            }
        }
        Ok(())
    }

    /// Refuses names of features to skip that no picture of the file has, whether it is denoised or not.
    fn check_skipped(&self, request: &BufferSetRequest) -> Result<()> {
        let is_elsewhere = |skip: &str| {
            let is_it = |id: LayerId| {
                let is_feature = match self.meaning(id) {
                    Some(meaning) => meaning.is_mean_of(RoleName::is_feature),
                    None => self.has_companions(id),
                };
                is_feature && ends_with(&self.layer(id).name, skip)
            };
            self.ids().filter(|id| id.file == 0).any(is_it)
        };
        match request.skip_features.iter().find(|skip| !self.skipped.contains(skip) && !is_elsewhere(skip)) {
            None => Ok(()),
            Some(skip) => Err(Error::File {
                path: self.list[0].path.clone(),
                cause: FileCause::NoFeatureToSkip { name: skip.clone(), layers: self.list[0].layers_like(skip) },
            }),
        }
    }

    /// Returns remarks on halves and variances of layers that are not in their file.
    fn orphans(&self) -> Vec<Note> {
        let of_file = |(file, classified): (usize, &Classified)| {
            let orphan = move |(layer, of): &(usize, String)| Note {
                id: LayerId { file, layer: *layer },
                text: format!("its layer '{}' is not in the file", text::name(of)),
            };
            classified.orphans.iter().map(orphan).collect::<Vec<_>>()
        };
        self.classified.iter().enumerate().flat_map(of_file).collect()
    }
}

/// Whether `end` is a layer's whole name, or the part behind one of its dots.
fn ends_with(name: &str, end: &str) -> bool {
    name.strip_suffix(end).is_some_and(|before| before.is_empty() || before.ends_with('.'))
}

/// A layer that may be a feature of a picture.
struct FeatureCandidate {
    id: LayerId,
    name: String,
    /// Smaller ranks are preferred among layers of the same name.
    rank: Rank,
    /// Whether the feature is named by its role, not by its layer.
    has_role_name: bool,
}

/// Half A, half B and variance of a layer.
#[derive(Default)]
struct Companions {
    half_a: Option<Planes>,
    half_b: Option<Planes>,
    variance: Option<VarianceSource>,
    /// Companions that cannot be used.
    left_out: Vec<LeftOut>,
}

impl Companions {
    /// Adds the companions that are still missing, the best first. `belongs` tells whether a layer with its meaning
    /// belongs to the layer of `mean`.
    fn add(
        &mut self,
        files: &Files,
        mean: &Planes,
        samples: &SamplesPerPixel,
        window: Window,
        belongs: impl Fn(LayerId, &Meaning) -> bool,
    ) {
        let own = LayerId { file: mean.file, layer: mean.layer };
        let mut found: Vec<(LayerId, &Meaning)> =
            files.ids().filter_map(|id| Some((id, files.meaning(id)?))).filter(|(id, _)| *id != own).collect();
        found.retain(|(id, meaning)| belongs(*id, meaning));
        found.sort_by_key(|(_, meaning)| meaning.rank);
        for (id, meaning) in found {
            self.add_one(files, mean, samples, Some(window), id, meaning.quantity, meaning.of);
        }
    }

    /// Adds companions that are named after `name`, though no layer of their file is.
    fn add_orphans(&mut self, files: &Files, mean: &Planes, name: &str, samples: &SamplesPerPixel) {
        for (layer, of) in &files.classified[mean.file].orphans {
            let id = LayerId { file: mean.file, layer: *layer };
            let quantity = files.rules.iter().find_map(|rule| {
                let is_it = |pattern: &crate::layout::Pattern| {
                    pattern.fit(&files.layer(id).key).is_some_and(|fit| fit.of.as_ref() == Some(of))
                };
                rule.names.iter().any(is_it).then_some(rule.quantity)
            });
            if let Some(quantity) = quantity.filter(|_| of.eq_ignore_ascii_case(name)) {
                self.add_one(files, mean, samples, None, id, quantity, None);
            }
        }
    }

    #[expect(clippy::too_many_arguments, reason = "a companion has all of these")]
    fn add_one(
        &mut self,
        files: &Files,
        mean: &Planes,
        samples: &SamplesPerPixel,
        window: Option<Window>,
        id: LayerId,
        quantity: Quantity,
        of: Option<LayerId>,
    ) {
        let is_taken = match quantity {
            Quantity::HalfA => self.half_a.is_some(),
            Quantity::HalfB => self.half_b.is_some(),
            quantity if quantity.is_variance() => self.variance.is_some(),
            _ => true,
        };
        if is_taken {
            return;
        }
        let trouble = |cause| LeftOut::new(&files.list, id, cause);
        let Some(planes) = files.matching_channels(mean, id) else {
            let of = files.layer(LayerId { file: mean.file, layer: mean.layer }).name.clone();
            self.left_out.push(trouble(LayerCause::CompanionChannels { of }));
            return;
        };
        if let Some(outside) = window.and_then(|window| files.check_window(&planes, window).err())
            && files.window(&planes) != files.window(mean)
        {
            self.left_out.push(outside);
            return;
        }
        if !quantity.is_variance() {
            let slot = if quantity == Quantity::HalfA { &mut self.half_a } else { &mut self.half_b };
            *slot = Some(planes);
            return;
        }
        if quantity != Quantity::VarianceOfMean && *samples == SamplesPerPixel::Unknown {
            self.left_out.push(trouble(LayerCause::NeedsSamples { quantity: quantity.to_string() }));
            return;
        }
        let of_moment = of.and_then(|of| files.matching_channels(&planes, of)).unwrap_or_else(|| mean.clone());
        let mean = (quantity == Quantity::SecondMoment).then_some(of_moment);
        let unknown = files.rule(id).and_then(|rule| rule.unknown);
        self.variance = Some(VarianceSource { planes, quantity, mean, unknown });
    }

    /// Leaves out a half without the other one, because it says nothing alone.
    fn leave_out_single_half(&mut self, files: &[ExrFile]) {
        let (single, missing) = match (&mut self.half_a, &mut self.half_b) {
            (single @ Some(_), None) => (single, 'B'),
            (None, single @ Some(_)) => (single, 'A'),
            _ => return,
        };
        if let Some(Planes { file, layer, .. }) = single.take() {
            self.left_out.push(LeftOut::new(files, LayerId { file, layer }, LayerCause::SingleHalf { missing }));
        }
    }

    fn put_into(self, source: &mut SignalSource) {
        let Self { half_a, half_b, variance, .. } = self;
        (source.half_a, source.half_b, source.variance) = (half_a, half_b, variance);
    }
}

/// Refuses layers that were requested by name if the input holds several pictures: they would belong to one of them.
fn check_is_one_picture(request: &BufferSetRequest, pictures: usize) -> Result<()> {
    let has_layer = |reference: &Option<LayerRef>| reference.as_ref().is_some_and(|it| it.layer.is_some());
    let is_for_one = has_layer(&request.half_a)
        || has_layer(&request.half_b)
        || has_layer(&request.variance)
        || [&request.features, &request.feature_half_a, &request.feature_half_b, &request.feature_variance]
            .iter()
            .any(|requested| !requested.is_empty());
    if pictures > 1 && is_for_one {
        let cause = FileCause::SeveralPictures { pictures };
        return Err(Error::File { path: request.input.clone(), cause });
    }
    Ok(())
}

/// Finds the layer that holds a file's colour: the requested one, or the one that the usual names say.
pub(crate) fn color_layer_of(file: &ExrFile, wanted: Option<&str>) -> Result<usize> {
    let recognised = recognise(file, false);
    let files = Files::new(file.clone_without_samples(), &recognised);
    files.colors(wanted).map(|colors| colors[0].layer)
}

pub(crate) fn named_layer(file: &ExrFile, wanted: &str) -> Result<usize> {
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
    if let (Some(r), Some(g), Some(b)) = (layer.channel("R"), layer.channel("G"), layer.channel("B")) {
        return Ok(vec![r, g, b]);
    }
    match layer.channel("Y") {
        Some(y) if layer.channel("X").is_none() => Ok(vec![y, y, y]),
        _ => Err(Error::Layer {
            path: file.path.clone(),
            layer: layer.name.clone(),
            cause: LayerCause::NoColor { layers: file.layer_list() },
        }),
    }
}

/// Returns the channels of a feature: all but the alpha. Returns `None` unless one to three are left.
fn feature_channels(layer: &FileLayer) -> Option<Vec<usize>> {
    let channels = layer.without_alpha();
    (1..=3).contains(&channels.len()).then_some(channels)
}

/// Returns the layer meant by a file that is named without a layer: the only layer, the layer without a name, or the
/// colour.
fn main_layer(file: &ExrFile) -> Result<usize> {
    if file.layers.len() == 1 {
        return Ok(0);
    }
    match file.layers.iter().position(|layer| layer.name.is_empty()) {
        Some(layer) => Ok(layer),
        None => color_layer_of(file, None),
    }
}
