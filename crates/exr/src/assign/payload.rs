//! Layers that are filtered along with the colour: lights, other colours and alpha.

use super::{Companions, Files, LeftOut};
use crate::along::{AlphaEncoding, Aovs, is_named};
use crate::alpha::ALPHA;
use crate::classify::{LayerId, is_whole_numbers};
use crate::estimate::PREFIX;
use crate::layers::FileLayer;
use crate::layout::{Layout, Quantity, RoleName};
use crate::names;
use crate::picture_file::Format;
use crate::request::BufferSetRequest;
use crate::source::{Alphas, PayloadSource, Picture, Planes, SignalSource};
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
            found.push(self.payload(name, PayloadKind::Light, mean, alpha, picture, request));
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
            picture.color.alphas = picture.alpha.clone().map(|alpha| self.alphas(alpha, halves));
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
        self.payload(name, PayloadKind::Alpha, alpha, None, picture, request)
    }

    fn payload(
        &self,
        name: String,
        kind: PayloadKind,
        mean: Planes,
        alpha: Option<Planes>,
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
        if picture.is_straight && kind == PayloadKind::Light {
            let halves = [signal.half_a.clone(), signal.half_b.clone()];
            signal.alphas = alpha.clone().map(|alpha| self.alphas(alpha, halves));
        }
        PayloadSource { name, kind, signal, alpha, stale, is_converted: false }
    }

    /// Whether a layer is a half or a variance of the layer `of`.
    fn is_noise_of(&self, id: LayerId, of: LayerId) -> bool {
        self.meaning(id).is_some_and(|meaning| {
            let is_noise =
                matches!(meaning.quantity, Quantity::HalfA | Quantity::HalfB) || meaning.quantity.is_variance();
            meaning.of == Some(of) && is_noise
        })
    }

    /// Returns the alphas of a mean and its halves, each of which may have its own.
    fn alphas(&self, mean: Planes, halves: [Option<Planes>; 2]) -> Alphas {
        let [half_a, half_b] = halves.map(|half| half.and_then(|half| self.alpha_in(half.id())));
        Alphas { mean, half_a, half_b }
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
            Aovs::Named(names) => names.iter().any(|name| is_named(name, &self.layer(id).name)),
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
            _ => {}
        }
        self.light_channels(id).is_none().then_some("it has no channels R, G and B, nor a luminance Y")
    }

    /// Returns the channels of a light without its alpha: red, green and blue, or a luminance. A layer that a rule
    /// calls a light may have a single channel of any name.
    fn light_channels(&self, id: LayerId) -> Option<Vec<usize>> {
        let layer = self.layer(id);
        if let (Some(r), Some(g), Some(b)) = (layer.channel("R"), layer.channel("G"), layer.channel("B")) {
            return Some(vec![r, g, b]);
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
