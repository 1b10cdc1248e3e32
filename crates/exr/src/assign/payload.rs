//! Layers that are filtered along with the colour: lights, other colours and alpha.

use super::{Companions, Files, LeftOut};
use crate::along::{AlphaEncoding, Aovs, is_named};
use crate::alpha::ALPHA;
use crate::classify::{LayerId, Meaning, is_whole_numbers};
use crate::estimate::PREFIX;
use crate::layers::FileLayer;
use crate::layout::{Layout, Pattern, Quantity, RoleName};
use crate::multiplier::{Multiplier, MultiplierKind};
use crate::names;
use crate::picture_file::Format;
use crate::request::BufferSetRequest;
use crate::source::{PayloadSource, Picture, Planes, SignalSource};
use stein::error::{Error, FileCause, LayerCause, Result};
use stein::frame::PayloadKind;

/// Parts of names of layers that hold data of textures and motion, not light.
const NO_LIGHT: [&str; 8] = ["uv", "st", "pref", "vector", "motion", "velocity", "texture", "texcoord"];

impl Files {
    /// Adds the layers that are filtered along with the colour, and says how the colours relate to their alpha.
    pub(super) fn add_payload(
        &mut self,
        picture: &mut Picture,
        layout: &Layout,
        request: &BufferSetRequest,
        left_out: &mut Vec<LeftOut>,
    ) {
        let encoding = match self.list[0].format {
            // The decoder multiplies the colours of PNG files by their alpha.
            Format::Png => AlphaEncoding::Premultiplied,
            _ => request.alpha.unwrap_or(layout.alpha),
        };
        let own = picture.color.mean.id();
        let alphas: Vec<LayerId> = self.ids().filter(|id| self.is_alpha(*id, picture)).collect();
        picture.alpha = self.alpha_in(own).or_else(|| alphas.first().map(|id| self.all_channels(*id)));
        picture.keeps_alpha = request.no_alpha;
        let is_skipped = request.skip_features.iter().any(|skip| skip == ALPHA);
        if is_skipped && picture.alpha.is_some() {
            self.skipped.push(ALPHA.into());
        }
        picture.alpha_guides = !request.no_alpha && !request.no_features && !is_skipped;
        picture.is_straight = encoding == AlphaEncoding::Straight && picture.alpha.is_some();
        let mut found = Vec::new();
        for id in self.ids().filter(|id| self.is_along(*id, picture, &request.aovs)) {
            let Some(channels) = self.light_channels(id) else { continue };
            let mean = Planes { file: id.file, layer: id.layer, channels };
            if let Err(trouble) = self.check_overlap(&mean, self.window(&picture.color.mean)) {
                left_out.push(trouble);
                continue;
            }
            let own_alpha = self.alpha_in(id);
            let alpha = own_alpha.clone().or_else(|| picture.alpha.clone());
            let name = self.layer(id).name.clone();
            let factor = self.factor(id, picture, mean.channels.len());
            found.push(self.light(name, mean, [factor, alpha], picture, request));
            if let Some(alpha) = own_alpha.filter(|_| !picture.keeps_alpha) {
                found.push(self.alpha_payload(alpha, picture, request));
            }
        }
        if !picture.keeps_alpha {
            for id in alphas {
                let planes = self.all_channels(id);
                match self.check_overlap(&planes, self.window(&picture.color.mean)) {
                    Ok(()) => found.push(self.alpha_payload(planes, picture, request)),
                    Err(trouble) => left_out.push(trouble),
                }
            }
            found.extend(self.alpha_in(own).map(|alpha| self.alpha_payload(alpha, picture, request)));
        }
        picture.payload = found;
        if picture.is_straight {
            let halves = [picture.color.half_a.clone(), picture.color.half_b.clone()];
            picture.color.multipliers.extend(picture.alpha.clone().map(|alpha| self.alpha_multiplier(alpha, halves)));
        }
    }

    fn alpha_payload(&self, alpha: Planes, picture: &Picture, request: &BufferSetRequest) -> PayloadSource {
        let layer = self.layer(alpha.id());
        let suffix = |channel: usize| {
            layer.channels.iter().find(|it| it.index == channel).map_or("A", |channel| channel.suffix.as_str())
        };
        let name = match (layer.name.as_str(), alpha.channels.as_slice()) {
            ("", [channel, ..]) => suffix(*channel).to_owned(),
            (name, [channel]) if layer.channels.len() > 1 => format!("{name}.{}", suffix(*channel)),
            (name, _) => name.to_owned(),
        };
        self.payload(name, PayloadKind::Alpha, alpha, picture, request)
    }

    /// Returns the source of a light with the layers by which it is multiplied: its factor first, then its alpha if
    /// colours are straight.
    fn light(
        &self,
        name: String,
        mean: Planes,
        [factor, alpha]: [Option<Planes>; 2],
        picture: &Picture,
        request: &BufferSetRequest,
    ) -> PayloadSource {
        let mut source = self.payload(name, PayloadKind::Light, mean, picture, request);
        let signal = &mut source.signal;
        let halves = [signal.half_a.clone(), signal.half_b.clone()];
        signal.multipliers.extend(factor.map(|factor| self.factor_multiplier(factor, &halves)));
        let alpha = alpha.filter(|_| picture.is_straight);
        signal.multipliers.extend(alpha.map(|alpha| self.alpha_multiplier(alpha, halves)));
        source
    }

    fn payload(
        &self,
        name: String,
        kind: PayloadKind,
        mean: Planes,
        picture: &Picture,
        request: &BufferSetRequest,
    ) -> PayloadSource {
        let id = mean.id();
        let color = &picture.color;
        let is_of_color = id == color.mean.id();
        // The colour has its own rules for its noise.
        let stale = self.ids().filter(|other| other.file == 0 && !is_of_color && self.is_noise_of(*other, id));
        let stale = stale.map(|other| other.layer).collect();
        let mut signal = SignalSource::new(mean);
        if request.payload_halves || kind == PayloadKind::Alpha {
            let mut found = Companions::default();
            let window = self.window(&color.mean);
            found.add(self, &signal.mean, &picture.samples, window, |other, meaning| {
                let half = |half: &Option<Planes>, quantity| {
                    half.as_ref().is_some_and(|half| half.id() == other) && meaning.quantity == quantity
                };
                let is_half = matches!(meaning.quantity, Quantity::HalfA | Quantity::HalfB);
                let of_color = half(&color.half_a, Quantity::HalfA) || half(&color.half_b, Quantity::HalfB);
                is_half && if is_of_color { of_color } else { meaning.of == Some(id) }
            });
            // A half that says nothing alone is no trouble: nothing depends on it.
            found.leave_out_single_half(&self.list);
            found.put_into(&mut signal);
        }
        PayloadSource { name, kind, signal, stale }
    }

    /// Whether a layer is a half or a variance of the layer `of`.
    fn is_noise_of(&self, id: LayerId, of: LayerId) -> bool {
        self.meaning(id).is_some_and(|meaning| {
            let is_noise =
                matches!(meaning.quantity, Quantity::HalfA | Quantity::HalfB) || meaning.quantity.is_variance();
            meaning.of == Some(of) && is_noise
        })
    }

    /// Returns the alpha `mean` as a multiplier. Each of the halves may have an alpha of its own in its layer.
    fn alpha_multiplier(&self, mean: Planes, halves: [Option<Planes>; 2]) -> Multiplier {
        let [half_a, half_b] = halves.map(|half| half.and_then(|half| self.alpha_in(half.id())));
        Multiplier { kind: MultiplierKind::Alpha, mean, half_a, half_b }
    }

    /// Returns the factor `mean` as a multiplier. Each of the halves is multiplied by the same half of the factor if
    /// there is one.
    fn factor_multiplier(&self, mean: Planes, halves: &[Option<Planes>; 2]) -> Multiplier {
        let own = |half: &Option<Planes>, quantity| {
            half.as_ref()?;
            let is_half = |meaning: &Meaning| meaning.of == Some(mean.id()) && meaning.quantity == quantity;
            let found = self.ids().find(|id| self.meaning(*id).is_some_and(is_half))?;
            self.matching_channels(&mean, found)
        };
        let (half_a, half_b) = (own(&halves[0], Quantity::HalfA), own(&halves[1], Quantity::HalfB));
        Multiplier { kind: MultiplierKind::Factor, mean, half_a, half_b }
    }

    /// Returns the channels of the layer by which a light with so many channels is multiplied; `None` if its rule names
    /// no such layer, or none that the light's part and view have.
    fn factor(&self, id: LayerId, picture: &Picture, channels: usize) -> Option<Planes> {
        let found = self.factor_of(id).filter(|found| *found != picture.color.mean.id())?;
        let layer = self.layer(found);
        let all = layer.rgb().unwrap_or_else(|| layer.without_alpha());
        let is_usable = (all.len() == 1 || all.len() == channels) && !is_whole_numbers(&self.list[0], found.layer);
        is_usable.then_some(Planes { file: found.file, layer: found.layer, channels: all })
    }

    /// Returns the layer by which the rule of a light of the input says that it is multiplied.
    fn factor_of(&self, id: LayerId) -> Option<LayerId> {
        let own = self.layer(id);
        let group = &self.meaning(id)?.group;
        let named = |pattern: &Pattern| {
            let is_it = |other: &FileLayer| {
                let fits = pattern.fit(&other.key).is_some_and(|fit| !pattern.has("{group}") || fit.group == *group);
                fits && (other.scope_part, &other.view) == (own.scope_part, &own.view) && other.name != own.name
            };
            self.list[0].layers.iter().position(is_it)
        };
        let layer = self.rule(id)?.factors.iter().find_map(named)?;
        Some(LayerId { file: 0, layer })
    }

    /// Whether a light of the input is multiplied by a layer.
    fn is_factor(&self, id: LayerId) -> bool {
        self.ids().any(|other| other.file == 0 && self.factor_of(other) == Some(id))
    }

    /// Returns the alpha of a layer with other channels.
    fn alpha_in(&self, id: LayerId) -> Option<Planes> {
        let layer = self.layer(id);
        let alpha = layer.channel("A").filter(|_| layer.channels.len() > 1)?;
        Some(Planes { file: id.file, layer: id.layer, channels: vec![alpha] })
    }

    fn all_channels(&self, id: LayerId) -> Planes {
        let channels = self.layer(id).channels.iter().map(|channel| channel.index).collect();
        Planes { file: id.file, layer: id.layer, channels }
    }

    /// Whether a layer of the input is nothing but an alpha of the picture.
    fn is_alpha(&self, id: LayerId, picture: &Picture) -> bool {
        id.file == 0
            && self.meaning(id).is_some_and(|meaning| meaning.is_mean_of(|role| role == RoleName::Alpha))
            && self.layer(id).channels.len() == 1
            && !is_whole_numbers(&self.list[0], id.layer)
            && self.is_in(id, picture)
    }

    /// Whether a layer is filtered along with a picture.
    fn is_along(&self, id: LayerId, picture: &Picture, aovs: &Aovs) -> bool {
        if id.file > 0 || !self.is_in(id, picture) || self.why_not_along(id, aovs).is_some() {
            return false;
        }
        if id == picture.color.mean.id() {
            return false;
        }
        let is_light = self.meaning(id).is_some_and(|meaning| meaning.role == Some(RoleName::Light));
        match aovs {
            Aovs::None => false,
            Aovs::Lights => is_light,
            Aovs::All => {
                let is_copy = self.rule(id).is_some_and(|rule| rule.is_copy);
                is_light || is_copy || self.meaning(id).is_none() && may_be_light(self.layer(id))
            }
            Aovs::Named(_) => aovs_name(aovs, &self.layer(id).name),
        }
    }

    /// Returns the reason why a layer of the input is never filtered along with a colour.
    fn why_not_along(&self, id: LayerId, aovs: &Aovs) -> Option<&'static str> {
        let layer = self.layer(id);
        if is_whole_numbers(&self.list[0], id.layer) {
            return Some("it holds whole numbers");
        }
        if layer.name.split('.').any(|component| component == PREFIX) {
            return Some("it is a result of an earlier run");
        }
        match self.meaning(id) {
            Some(meaning) if meaning.role == Some(RoleName::Id) => return Some("it holds numbers of objects"),
            Some(meaning) if meaning.role == Some(RoleName::Samples) => return Some("it counts samples"),
            Some(meaning) if meaning.role == Some(RoleName::Denoised) => return Some("the renderer has denoised it"),
            Some(meaning) if meaning.role == Some(RoleName::Alpha) => {
                return Some("it is alpha, which is denoised without being named");
            }
            Some(meaning) if meaning.quantity != Quantity::Mean || meaning.of.is_some() => {
                return Some("it tells the noise of another layer");
            }
            Some(meaning) if meaning.role.is_some_and(RoleName::is_feature) => {
                return Some("it is a feature, which guides the filter and stays as it is");
            }
            None if self.has_companions(id) && !aovs_name(aovs, &layer.name) => {
                return Some("it is a feature, which guides the filter and stays as it is");
            }
            _ if self.is_factor(id) => return Some("other layers are multiplied by it, and it stays as it is"),
            _ => {}
        }
        self.light_channels(id).is_none().then_some("it has no channels R, G and B, nor a luminance Y")
    }

    /// Returns the channels of a light without its alpha: red, green and blue, or a luminance. A layer that a rule
    /// calls a light may have a single channel of any name.
    fn light_channels(&self, id: LayerId) -> Option<Vec<usize>> {
        let layer = self.layer(id);
        if let Some(rgb) = layer.rgb() {
            return Some(rgb);
        }
        let is_light = self.meaning(id).is_some_and(|meaning| meaning.role == Some(RoleName::Light));
        match (layer.channel("Y"), layer.without_alpha().as_slice()) {
            (Some(y), _) if layer.channel("X").is_none() => Some(vec![y]),
            (_, [only]) if is_light => Some(vec![*only]),
            _ => None,
        }
    }

    /// Refuses names of layers to filter along that the input does not have, or that no colour is filtered along with.
    pub(super) fn check_named_along(&self, request: &BufferSetRequest) -> Result<()> {
        let Aovs::Named(wanted) = &request.aovs else { return Ok(()) };
        let file = &self.list[0];
        for wanted in wanted {
            let mut named = self.ids().filter(|id| id.file == 0 && is_named(wanted, &self.layer(*id).name)).peekable();
            let Some(first) = named.peek().copied() else {
                let cause = FileCause::NoLayerAlong { name: wanted.clone(), layers: file.layers_like(wanted) };
                return Err(Error::File { path: file.path.clone(), cause });
            };
            if let Some(why) = self.why_not_along(first, &request.aovs)
                && named.all(|id| self.why_not_along(id, &request.aovs).is_some())
            {
                let layer = self.layer(first).title();
                return Err(Error::Layer { path: file.path.clone(), layer, cause: LayerCause::NotAlong { why } });
            }
        }
        Ok(())
    }
}

/// Whether a list names a layer.
pub(super) fn aovs_name(aovs: &Aovs, layer: &str) -> bool {
    matches!(aovs, Aovs::Named(wanted) if wanted.iter().any(|wanted| is_named(wanted, layer)))
}

/// Whether the name of a layer that no rule knows says nothing of textures and motion.
fn may_be_light(layer: &FileLayer) -> bool {
    let name = names::last_component(&layer.key).to_lowercase();
    !NO_LIGHT.iter().any(|word| if word.len() < 5 { name == *word } else { name.contains(word) })
}
