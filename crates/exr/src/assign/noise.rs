//! Halves and variances.

use super::{Files, LeftOut};
use super::{color_channels, feature_channels, same_or_color};
use crate::classify::{LayerId, Meaning};
use crate::file::ExrFile;
use crate::layer_ref::LayerRef;
use crate::layout::{Quantity, RoleName};
use crate::request::BufferSetRequest;
use crate::source::{self, Picture, Planes, SignalSource, VarianceSource};
use stein::error::{Error, FileCause, LayerCause, RequestCause, Result};
use stein::frame::SamplesPerPixel;
use stein::image::Window;

impl Files {
    /// Finds halves and variance of a picture's colour. Leaves out faulty ones as long as another source tells of the
    /// noise.
    pub(super) fn add_noise(
        &mut self,
        picture: &mut Picture,
        is_main: bool,
        has_seeds: bool,
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
                let is_color = self.meaning(of).is_none_or(|meaning| meaning.role == Some(RoleName::Color));
                of == id || is_main && (is_copy || other.file > 0 && of.file == 0 && picture.is_only && is_color)
            };
            match meaning.of {
                Some(of) => is_of(of),
                None => is_main && meaning.role == Some(RoleName::Color) && self.is_in(other, picture),
            }
        };
        found.add(self, &picture.color.mean, &picture.samples, window, belongs);
        let named = |files: &mut Self, reference: &Option<LayerRef>| match reference {
            None => Ok(None),
            Some(reference) => {
                files.requested_planes(reference, &picture.color.mean, picture.is_only, window).map(Some)
            }
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
        let is_known = found.half_a.is_some() || found.variance.is_some() || has_seeds;
        // A half that was requested by name is not left out if the other half is missing.
        let is_named = found.half_a.is_none() && (request.half_a.is_some() || request.half_b.is_some());
        // Files beside the input were not asked for, but the samples may be all that is missing.
        let is_beside = |file: usize| file > 0 && self.own_files.contains(&file);
        let stops = |it: &LeftOut| !is_beside(it.id.file) || it.lacks_samples();
        match found.left_out.iter().position(stops).filter(|_| !is_known || is_named) {
            Some(first) => Err(found.left_out.swap_remove(first).into_error()),
            None => {
                left_out.append(&mut found.left_out);
                found.put_into(&mut picture.color);
                Ok(())
            }
        }
    }

    /// Returns the planes of a requested half or variance of the colour `mean`.
    pub(super) fn requested_planes(
        &mut self,
        reference: &LayerRef,
        mean: &Planes,
        is_only: bool,
        window: Window,
    ) -> Result<Planes> {
        let file = self.open(&reference.file, None)?;
        if file == 0 && reference.layer.is_none() {
            return Err(Error::Request(RequestCause::InputItself { file: reference.file.clone() }));
        }
        // In a file with the same layers, the layer of the same name is meant.
        let own = self.layer(mean.id());
        let layer = same_or_color(&self.list[file], own, is_only, reference.layer.as_deref())?;
        let id = LayerId { file, layer };
        if let Some(why) = self.rule(id).filter(|rule| rule.quantity == Quantity::NotAVariance).map(|rule| &rule.why) {
            let cause = LayerCause::NotAVariance { why: why.clone().unwrap_or_default() };
            return Err(LeftOut::new(&self.list, id, cause).into_error());
        }
        let channels = color_channels(&self.list[file], layer)?;
        let planes = Planes { file, layer, channels };
        self.check_window(&planes, window).map_err(LeftOut::into_error)?;
        Ok(planes)
    }

    /// Returns a requested variance with the quantity that its name says.
    pub(super) fn requested_variance(&self, planes: Planes, samples: &SamplesPerPixel) -> Result<VarianceSource> {
        let id = planes.id();
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

    /// Refuses planes of a file with another resolution: its windows cannot be compared.
    pub(super) fn check_resolution(&self, planes: &Planes, window: Window) -> std::result::Result<(), LeftOut> {
        let (own, file) = (&self.list[0], &self.list[planes.file]);
        match source::other_resolution(own, window, file, file.layers[planes.layer].part) {
            None => Ok(()),
            Some(cause) => Err(LeftOut::new(&self.list, planes.id(), cause)),
        }
    }

    /// Refuses planes that do not cover the colour's pixels.
    pub(super) fn check_window(&self, planes: &Planes, window: Window) -> std::result::Result<(), LeftOut> {
        self.check_resolution(planes, window)?;
        let file = &self.list[planes.file];
        let own = source::window_of(file, file.layers[planes.layer].part, window);
        if source::covers(own, window) { Ok(()) } else { Err(self.outside(planes, own, window)) }
    }

    pub(super) fn outside(&self, planes: &Planes, own: Window, window: Window) -> LeftOut {
        let (found, expected) = (own.to_string(), window.to_string());
        let cause = LayerCause::DataWindow { found, expected, color_file: self.list[0].path.clone() };
        LeftOut::new(&self.list, planes.id(), cause)
    }

    /// Returns the channels of `layer` that correspond to `planes`: by name, or by position if the names differ
    /// throughout (`Z` and `Y` of single channels). Returns `None` if they do not match.
    pub(super) fn matching_channels(&self, planes: &Planes, layer: LayerId) -> Option<Planes> {
        let own = self.layer(planes.id());
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
}

/// Half A, half B and variance of a layer.
#[derive(Default)]
pub(super) struct Companions {
    pub(super) half_a: Option<Planes>,
    half_b: Option<Planes>,
    variance: Option<VarianceSource>,
    /// Companions that cannot be used.
    pub(super) left_out: Vec<LeftOut>,
}

impl Companions {
    /// Adds the companions that are still missing, the best first. `belongs` tells whether a layer with its meaning
    /// belongs to the layer of `mean`.
    pub(super) fn add(
        &mut self,
        files: &Files,
        mean: &Planes,
        samples: &SamplesPerPixel,
        window: Window,
        belongs: impl Fn(LayerId, &Meaning) -> bool,
    ) {
        let own = mean.id();
        let mut found: Vec<(LayerId, &Meaning)> =
            files.ids().filter_map(|id| Some((id, files.meaning(id)?))).filter(|(id, _)| *id != own).collect();
        found.retain(|(id, meaning)| belongs(*id, meaning));
        found.sort_by_key(|(_, meaning)| meaning.rank);
        for (id, meaning) in found {
            self.add_one(files, mean, samples, Some(window), id, meaning.quantity, meaning.of);
        }
    }

    /// Adds companions that are named after `name`, though no layer of their file is.
    pub(super) fn add_orphans(&mut self, files: &Files, mean: &Planes, name: &str, samples: &SamplesPerPixel) {
        for (layer, of) in &files.classified[mean.file].orphans {
            let id = LayerId { file: mean.file, layer: *layer };
            let quantity = files.rules.list.iter().find_map(|rule| {
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
    pub(super) fn add_one(
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
            let of = files.layer(mean.id()).name.clone();
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
    pub(super) fn leave_out_single_half(&mut self, files: &[ExrFile]) {
        if let Some((half, missing)) = source::single_half(&self.half_a, &self.half_b) {
            self.left_out.push(LeftOut::new(files, half.id(), LayerCause::SingleHalf { missing }));
            (self.half_a, self.half_b) = (None, None);
        }
    }

    pub(super) fn put_into(self, source: &mut SignalSource) {
        let Self { half_a, half_b, variance, .. } = self;
        (source.half_a, source.half_b, source.variance) = (half_a, half_b, variance);
    }
}

/// Refuses layers that were requested by name if the input holds several pictures: they would belong to one of them.
pub(super) fn check_is_one_picture(request: &BufferSetRequest, pictures: usize) -> Result<()> {
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
