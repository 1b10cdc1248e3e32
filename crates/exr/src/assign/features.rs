//! Features.

use super::payload::aovs_name;
use super::{Companions, Files, LeftOut};
use super::{main_layer, named_layer};
use crate::classify::{Classified, LayerId, Meaning, Rank, is_whole_numbers};
use crate::layer_ref::LayerRef;
use crate::layers::FileLayer;
use crate::layout::{Quantity, RoleName};
use crate::names::ends_with;
use crate::request::BufferSetRequest;
use crate::source::{self, Picture, Planes, SignalSource};
use crate::uses::Note;
use stein::error::{Error, FileCause, LayerCause, RequestCause, Result};
use stein::frame::{FeatureKind, MAX_FEATURES};
use stein::image::Window;
use stein::text;

impl Files {
    /// Adds the requested features, and the input's own ones unless the request excludes them.
    pub(super) fn add_features(
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

    pub(super) fn requested_feature(
        &mut self,
        name: &str,
        reference: &LayerRef,
        picture: &Picture,
        left_out: &mut Vec<LeftOut>,
    ) -> Result<SignalSource> {
        let index = self.open(&reference.file, Some(name))?;
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
            miss: self.rule(id).and_then(|rule| rule.miss),
            // Outside of a cropped layer, no ray hit anything.
            outside: if is_distance { f32::INFINITY } else { 0.0 },
            unit: self.rule(id).and_then(|rule| rule.unit),
            ..SignalSource::new(mean)
        }
    }

    pub(super) fn check_overlap(&self, planes: &Planes, window: Window) -> std::result::Result<(), LeftOut> {
        self.check_resolution(planes, window)?;
        let file = &self.list[planes.file];
        let own = source::window_of(file, file.layers[planes.layer].part, window);
        if source::overlap(own, window) > 0 { Ok(()) } else { Err(self.outside(planes, own, window)) }
    }

    /// Adds the picture's own features: one for each role, and layers that come with halves or a variance. Each name to
    /// skip must match one of them: its whole name, the part behind one of its dots, or the name of its role.
    fn find_features(&mut self, picture: &mut Picture, request: &BufferSetRequest, left_out: &mut Vec<LeftOut>) {
        let window = self.window(&picture.color.mean);
        let of_color: Vec<LayerId> = picture.color.planes().map(Planes::id).collect();
        let mut candidates: Vec<FeatureCandidate> = self
            .ids()
            .filter(|id| !of_color.contains(id))
            // What is denoised along on request is no feature that its noise alone makes one.
            .filter(|id| self.meaning(*id).is_some() || !aovs_name(&request.aovs, &self.layer(*id).name))
            .filter_map(|id| self.feature_candidate(id, picture))
            .collect();
        let is_named = |skip: &str, candidate: &FeatureCandidate| {
            ends_with(&self.layer(candidate.id).name, skip) || candidate.name == skip
        };
        let found = request.skip_features.iter().filter(|skip| candidates.iter().any(|it| is_named(skip, it)));
        let found: Vec<String> = found.cloned().collect();
        let (mut notes, mut padded) = (Vec::new(), Vec::new());
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
                note(
                    candidate.id,
                    format!("'{}' is the better {}", text::name(&self.layer(better.id).name), better.name),
                );
                continue;
            }
            let FeatureCandidate { id, name, .. } = candidate;
            if is_whole_numbers(&self.list[id.file], id.layer) {
                note(*id, "whole numbers are not a feature".into());
                continue;
            }
            let mean = match self.feature_planes(*id).and_then(|mean| self.check_overlap(&mean, window).map(|()| mean))
            {
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
                let own = source::window_of(&self.list[id.file], self.layer(*id).part, window);
                if !source::covers(own, window) {
                    let name = text::name(name);
                    padded.push(format!("feature {name}: its pixels are {own}; around them nothing was hit"));
                }
                picture.features.push((name.clone(), source));
            }
        }
        self.layer_notes.append(&mut notes);
        self.notes.append(&mut padded);
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
    pub(super) fn has_companions(&self, id: LayerId) -> bool {
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
                let index = self.open(&reference.file, Some(name))?;
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
            if let Some((half, missing)) = source::single_half(&source.half_a, &source.half_b) {
                let mut trouble = LeftOut::new(&self.list, half.id(), LayerCause::SingleHalf { missing });
                trouble.name = format!("{} (feature {name})", trouble.name);
                return Err(trouble.into_error());
            }
        }
        Ok(())
    }

    /// Refuses names of features to skip that no picture of the file has, whether it is denoised or not.
    pub(super) fn check_skipped(&self, request: &BufferSetRequest) -> Result<()> {
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

    /// Returns remarks on features that belong to no picture.
    pub(super) fn elsewhere(&self, pictures: &[Picture]) -> Vec<Note> {
        let is_feature =
            |id: &LayerId| self.meaning(*id).is_some_and(|meaning| meaning.is_mean_of(RoleName::is_feature));
        let is_alone = |id: &LayerId| !pictures.iter().any(|picture| self.is_in(*id, picture));
        let ids = self.ids().filter(|id| id.file == 0).filter(is_feature).filter(is_alone);
        ids.map(|id| Note { id, text: "its name puts it beside another picture than the colour".into() }).collect()
    }

    /// Returns remarks on halves and variances of layers that are not in their file.
    pub(super) fn orphans(&self) -> Vec<Note> {
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

/// A layer that may be a feature of a picture.
struct FeatureCandidate {
    id: LayerId,
    name: String,
    /// Smaller ranks are preferred among layers of the same name.
    rank: Rank,
    /// Whether the feature is named by its role, not by its layer.
    has_role_name: bool,
}

/// Returns the channels of a feature: all but the alpha. Returns `None` unless one to three are left.
pub(super) fn feature_channels(layer: &FileLayer) -> Option<Vec<usize>> {
    let channels = layer.without_alpha();
    (1..=3).contains(&channels.len()).then_some(channels)
}
