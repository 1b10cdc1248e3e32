//! Decides the use of each layer.

mod beside;
mod colors;
mod features;
mod noise;
mod payload;

use std::path::{Path, PathBuf};

use crate::buffer_set::BufferSet;
use crate::classify::{Classified, LayerId, Meaning, Rules, Scope, classify};
use crate::counts;
use crate::file::ExrFile;
use crate::layers::{self, FileLayer};
use crate::layout::{Layout, Recognised, RoleName, Rule, recognise};
use crate::picture_file::PngEncoding;
use crate::request::BufferSetRequest;
use crate::seeds::{self, Reading};
use crate::source::{Picture, Planes, SignalSource};
use crate::uses::{Note, layer_uses};
use stein::error::{Error, LayerCause, Result};
use stein::frame::{FeatureKind, SamplesPerPixel};
use stein::image::Window;
use stein::text;

use beside::Siblings;
use colors::{Color, main_layer, named_layer};
pub(crate) use colors::{color_channels, color_layer_of, same_or_color};
use features::feature_channels;
use noise::{Companions, check_is_one_picture};

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
    let mut left_out = Vec::new();
    if request.layout.is_some() && !files.fits(&recognised.layout) {
        let name = text::name(recognised.layout.name()).into_owned();
        files.notes.push(format!("no layer fits the layout {name}: the file is read by the usual names"));
    }
    let colors = files.colors(request.layer.as_deref())?;
    check_is_one_picture(request, colors.len())?;
    let mut pictures = Vec::new();
    for color in &colors {
        let mut picture = files.picture(color, colors.len(), &recognised.layout, request);
        let has_seeds = !request.seeds.is_empty() || !seeds.is_empty();
        files.add_noise(&mut picture, color.is_main, has_seeds, request, &mut left_out)?;
        files.add_features(&mut picture, request, &mut left_out)?;
        files.add_payload(&mut picture, &recognised.layout, request, &mut left_out);
        pictures.push(picture);
    }
    files.check_skipped(request)?;
    files.check_named_along(request)?;

    // Layers of files beside the input are nowhere else named.
    let beside = left_out.iter().filter(|it| it.id.file > 0);
    files.notes.extend(beside.map(|it| format!("not used: {}: {}", text::path(&it.path), it.cause)));
    let lacks_samples = left_out.iter().any(LeftOut::lacks_samples);
    let mut notes: Vec<Note> = left_out.into_iter().map(LeftOut::into_note).collect();
    notes.append(&mut files.layer_notes);
    notes.extend(files.orphans());
    notes.extend(files.elsewhere(&pictures));
    let mut set = BufferSet {
        files: files.list,
        pictures,
        layout: recognised.by,
        notes: files.notes,
        siblings,
        seeds: Vec::new(),
        seed_files: Vec::new(),
        stale: Vec::new(),
        lacks_samples,
        png_encoding: request.png_encoding,
        layer_uses: Vec::new(),
    };
    if !request.seeds.is_empty() || !seeds.is_empty() {
        let reading = Reading {
            layout: &recognised.layout,
            rules: &files.rules,
            classified: &files.classified,
            own_files: &files.own_files,
            seeds: &seeds,
        };
        seeds::merge(&mut set, request, &reading)?;
    }
    set.layer_uses = layer_uses(&set, &files.classified, &files.rules.list, &notes);
    Ok(set)
}

/// A layer that is left out because of a problem.
struct LeftOut {
    id: LayerId,
    path: PathBuf,
    name: String,
    cause: Box<LayerCause>,
}

impl LeftOut {
    fn new(files: &[ExrFile], id: LayerId, cause: LayerCause) -> Self {
        let file = &files[id.file];
        Self { id, path: file.path.clone(), name: file.layers[id.layer].title(), cause: Box::new(cause) }
    }

    fn lacks_samples(&self) -> bool {
        matches!(*self.cause, LayerCause::NeedsSamples { .. })
    }

    fn into_note(self) -> Note {
        Note { id: self.id, text: self.cause.to_string() }
    }

    /// Converts to the error for a layer that is required.
    fn into_error(self) -> Error {
        Error::Layer { path: self.path, layer: self.name, cause: *self.cause }
    }
}

/// The files of a set, and the meanings of their layers.
struct Files {
    list: Vec<ExrFile>,
    classified: Vec<Classified>,
    rules: Rules,
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

impl Files {
    fn new(input: ExrFile, recognised: &Recognised) -> Self {
        let rules = Rules::of(&recognised.layout);
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

    /// Whether a rule of the layout fits a layer.
    fn fits(&self, layout: &Layout) -> bool {
        let meanings = self.classified.iter().flat_map(|classified| classified.meanings.iter().flatten());
        meanings.map(|meaning| meaning.rank.rule).any(|rule| rule < layout.rules.len())
    }

    /// Opens a file that was named, as a colour or as the feature of that name.
    fn open(&mut self, path: &Path, feature: Option<&str>) -> Result<usize> {
        match self.list.iter().position(|file| file.path == path) {
            Some(index) => Ok(index),
            None => {
                self.add(ExrFile::read(path, self.encoding(feature))?, false);
                Ok(self.list.len() - 1)
            }
        }
    }

    /// Returns the meaning of the values of a PNG file. Directions and distances are no light, so that no curve applies
    /// to them.
    fn encoding(&self, feature: Option<&str>) -> PngEncoding {
        match feature.map(FeatureKind::from_name) {
            Some(FeatureKind::Normal | FeatureKind::Distance) => PngEncoding::Linear,
            _ => self.png_encoding,
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
        self.meaning(id).map(|meaning| &self.rules.list[meaning.rank.rule])
    }

    fn scope(&self, id: LayerId) -> Scope {
        Scope::of(self.layer(id), self.meaning(id))
    }

    /// Whether a layer belongs to a picture. A file beside the input belongs to its only picture.
    fn is_in(&self, id: LayerId, picture: &Picture) -> bool {
        if id.file > 0 {
            return self.own_files.contains(&id.file) && picture.is_only;
        }
        let mut own = self.scope(id);
        // Parts whose layers have names of their own belong to the only picture.
        if own.part.is_none() && picture.is_only {
            own.part = picture.scope.part;
        }
        own == picture.scope
    }

    /// Makes a picture of a colour, without noise and features.
    fn picture(&self, color: &Color, count: usize, layout: &Layout, request: &BufferSetRequest) -> Picture {
        let id = LayerId { file: 0, layer: color.layer };
        let is_color = self.meaning(id).is_some_and(|meaning| meaning.role == Some(RoleName::Color));
        let scope = Scope::of(self.layer(id), self.meaning(id).filter(|_| is_color));
        let window = self.list[0].data_window(self.layer(id).part);
        let (samples, samples_layer) = match request.samples {
            Some(count) => (SamplesPerPixel::Uniform(count as f32), None),
            None => {
                let counted = counts::layer(&self.list, &self.classified, &self.own_files, &scope, count == 1);
                let header = counts::in_header(&self.list[0], self.layer(id).part, layout, &scope.group);
                counts::known(&self.list, window, header, counted)
            }
        };
        let mean = Planes { file: 0, layer: color.layer, channels: color.channels.clone() };
        let unit = self.rule(id).and_then(|rule| rule.unit);
        let source = SignalSource { unit, ..SignalSource::new(mean) };
        Picture {
            scope,
            is_only: count == 1,
            color: source,
            features: Vec::new(),
            samples,
            samples_layer,
            payload: Vec::new(),
            alpha: None,
            is_straight: false,
            keeps_alpha: false,
            alpha_guides: false,
            empty: None,
        }
    }

    fn window(&self, planes: &Planes) -> Window {
        let file = &self.list[planes.file];
        file.data_window(file.layers[planes.layer].part)
    }
}
