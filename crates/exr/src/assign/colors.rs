//! The colours of a file.

use super::Files;
use crate::classify::{LayerId, Meaning, Rank, Scope};
use crate::file::ExrFile;
use crate::layers::FileLayer;
use crate::layout::{RoleName, Unit, recognise};
use crate::names;
use stein::error::{Error, FileCause, LayerCause, Result};
use stein::text;

/// A colour that is to be denoised.
pub(super) struct Color {
    pub(super) layer: usize,
    pub(super) channels: Vec<usize>,
    /// Whether it is the layer that bare names such as `halfA` refer to.
    pub(super) is_main: bool,
}

impl Files {
    /// Returns the colours that are to be denoised: the requested layer, or the best one of each view layer and view.
    pub(super) fn colors(&self, wanted: Option<&str>) -> Result<Vec<Color>> {
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

    pub(super) fn channels_of_color(&self, id: LayerId) -> Result<Vec<usize>> {
        let unit = self.rule(id).and_then(|rule| rule.unit);
        let layer = self.layer(id);
        match unit.filter(|unit| *unit == Unit::Xyz).map(|_| ["X", "Y", "Z"].map(|name| layer.channel(name))) {
            Some([Some(x), Some(y), Some(z)]) => Ok(vec![x, y, z]),
            _ => color_channels(&self.list[id.file], id.layer),
        }
    }

    /// Returns the layers of the input whose names say that they are colours.
    fn named_colors(&self) -> impl Iterator<Item = LayerId> {
        let is_color = |meaning: &Meaning| meaning.is_mean_of(|role| role == RoleName::Color);
        self.ids().filter(move |id| id.file == 0 && self.meaning(*id).is_some_and(is_color))
    }

    /// Returns the best colour of each picture, with its rank: of each part, view layer and view.
    pub(super) fn best_colors(&self) -> Vec<(Rank, LayerId)> {
        let has_channels = |id: &LayerId| self.channels_of_color(*id).is_ok();
        let all: Vec<LayerId> = self.named_colors().filter(has_channels).collect();
        let is_second_choice = |id: &LayerId| self.rule(*id).is_some_and(|rule| rule.is_fallback || rule.is_copy);
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
    pub(super) fn only_color(&self) -> Result<usize> {
        let file = &self.list[0];
        let colorful = |layer: &usize| color_channels(file, *layer).is_ok();
        let is_unknown = |layer: &usize| self.meaning(LayerId { file: 0, layer: *layer }).is_none();
        let other: Vec<usize> = (0..file.layers.len()).filter(colorful).filter(is_unknown).collect();
        match other.as_slice() {
            [only] => Ok(*only),
            _ if file.layers.len() == 1 && colorful(&0) => Ok(0),
            [] => {
                // A colour of which a channel is missing.
                if let Some(incomplete) = self.named_colors().next() {
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
}

/// Finds the layer of another file that belongs to the colour `own`: the requested one, the one of the same name, or
/// the file's colour if the input has no other picture.
pub(crate) fn same_or_color(file: &ExrFile, own: &FileLayer, is_only: bool, wanted: Option<&str>) -> Result<usize> {
    let same = file.layers.iter().position(|layer| layer.name == own.name && layer.channel("R").is_some());
    match (wanted, same) {
        (None, Some(same)) if !is_only || !own.name.is_empty() => Ok(same),
        (None, None) if !is_only => Err(Error::Layer {
            path: file.path.clone(),
            layer: own.title(),
            cause: LayerCause::Missing { layers: file.layers_like(&own.name) },
        }),
        (wanted, _) => color_layer_of(file, wanted),
    }
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
    if let Some(rgb) = layer.rgb() {
        return Ok(rgb);
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

/// Returns the layer meant by a file that is named without a layer: the only layer, the layer without a name, or the
/// colour.
pub(super) fn main_layer(file: &ExrFile) -> Result<usize> {
    if file.layers.len() == 1 {
        return Ok(0);
    }
    match file.layers.iter().position(|layer| layer.name.is_empty()) {
        Some(layer) => Ok(layer),
        None => color_layer_of(file, None),
    }
}
