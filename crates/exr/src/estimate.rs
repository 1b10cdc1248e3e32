//! Writes an estimate into a copy of the file that it was made from.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use exr::prelude::{SampleType, f16};
use serde::Serialize;

use crate::alpha::without_fringe;
use crate::multiplier::{Multiplier, MultiplierKind};
use crate::picture_file::{self, Format};
use crate::source::{self, PayloadSource, Planes};
use crate::write::{ReplacedChannels, write_pictures};
use crate::{BufferSet, DenoisedLayers, LayerUse, NamedLayer, Role};
use stein::error::{FileCause, RequestCause};
use stein::frame::PayloadKind;
use stein::host_memory::FreeMemory;
use stein::method::{Intermediate, Method};
use stein::{DenoisedLayer, Error, Estimate, Image, PayloadLeft, Result, text};

/// Prefix of the names of our layers, which no renderer uses.
pub(crate) const PREFIX: &str = "stein";

/// Report of [`write_estimate`].
#[derive(Clone, Debug, Serialize)]
pub struct Written {
    /// Path of the file.
    #[serde(serialize_with = "text::serialize_path")]
    pub file: PathBuf,
    /// Names of the layers that the input does not have.
    pub added_layers: Vec<String>,
    /// Names of the halves that were replaced by halves of the denoised colour.
    pub replaced_layers: Vec<String>,
    /// Names of the layers that were denoised along with the colour, as in [`BufferSet::payload`].
    pub along: Vec<String>,
    /// Names of the layers that were left out: the input's variance, halves and variances of layers that were denoised
    /// along, and the layers of an earlier run, which do not belong to the denoised colour.
    pub dropped_layers: Vec<String>,
    /// Number of values beyond the largest half float, written as ±65504.
    pub clamped_values: usize,
    /// Number of values that were not finite, written as 0.
    pub non_finite_values: usize,
    /// Other remarks.
    pub notes: Vec<String>,
}

/// Writes the input with its colour and halves and the layers that were denoised along replaced by those of the
/// estimate, and without its variance, which does not belong to the denoised colour. Straight colours are divided by
/// the denoised alpha. Layers that no filter changed stay as they were, to the bit. Adds the estimated error, if there
/// is one, as `stein.error`, and the [`Estimate::layers`] of the intermediates in `keep` as `stein.*`. `set` is the set
/// that the frame was made of, and is used up; `method` is noted in the header.
///
/// An output whose name ends in `.pfm` or `.png` holds the colour and its alpha alone.
///
/// The file appears under its name only when it is complete; an existing file is replaced, even if it is the input.
///
/// # Errors
/// As [`write_denoised`](crate::write_denoised).
pub fn write_estimate(
    estimate: &Estimate,
    set: BufferSet,
    output: &Path,
    keep: &[Intermediate],
    method: &Method,
) -> Result<Written> {
    write_estimates(std::slice::from_ref(estimate), set, output, keep, method)
}

/// Writes as [`write_estimate`] does, with an estimate for each picture of the set, in their order. If there are
/// several, the names of added layers begin with the name of the picture's layer. Pictures behind the last estimate
/// stay as they were.
///
/// # Errors
/// As [`write_denoised`](crate::write_denoised).
pub fn write_estimates(
    estimates: &[Estimate],
    mut set: BufferSet,
    output: &Path,
    keep: &[Intermediate],
    method: &Method,
) -> Result<Written> {
    if let Some(format) = Format::from_extension(output).filter(|format| *format != Format::OpenExr) {
        restore_unchanged(&mut set, estimates)?;
        return write_picture(estimates, &set, output, keep, format);
    }
    FreeMemory::now()
        .check(estimates.iter().map(|estimate| bytes_for_writing(estimate, keep)).sum())
        .map_err(|shortage| shortage.error("writing the output"))?;
    restore_unchanged(&mut set, estimates)?;
    let parameters = serde_json::to_string(method).map_err(|error| Error::File {
        path: output.to_owned(),
        cause: FileCause::Defect {
            problem: format!("the parameters cannot be put into words: {error}"),
            with: "the parameters",
        },
    })?;
    let mut attributes = vec![
        ("stein.version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ("stein.parameters".to_owned(), parameters),
    ];
    if !set.seeds.is_empty() {
        attributes.push(("stein.seeds".to_owned(), (set.seeds.len() + 1).to_string()));
    }
    let mut notes = Vec::new();
    let is_stale = |layer: &LayerUse| layer.layer.split('.').any(|component| component == PREFIX);
    // Layers of an earlier run do not belong to this colour.
    let stale: Vec<String> =
        set.uses_in_input().iter().filter(|layer| is_stale(layer)).map(|layer| layer.layer.clone()).collect();
    if !stale.is_empty() {
        notes.push("the input was denoised before".into());
    }
    let of_seeds = set.stale.iter().map(|layer| set.files[0].layers[*layer].name.clone());
    let names: Vec<String> = set.pictures().map(str::to_owned).collect();
    let mut pictures = Vec::new();
    for (picture, estimate) in estimates.iter().enumerate() {
        let prefix = match names[picture].as_str() {
            name if names.len() > 1 && !name.is_empty() => format!("{name}.{PREFIX}"),
            _ => PREFIX.to_owned(),
        };
        pictures.push(OfPicture::new(&set, picture, estimate, keep, &prefix, &mut notes));
    }
    notes.extend(lacked_beside(estimates));
    let mut stale: Vec<String> = stale.into_iter().chain(of_seeds).collect();
    let others = pictures.iter_mut().flat_map(|picture| std::mem::take(&mut picture.others)).collect();
    let layers: Vec<DenoisedLayers<'_>> = pictures
        .iter_mut()
        .enumerate()
        .map(|(index, picture)| {
            picture.dropped.append(&mut stale);
            let attributes = if index == 0 { attributes.as_slice() } else { &[] };
            DenoisedLayers {
                color: &picture.color,
                replacements: &picture.replacements,
                dropped: &picture.dropped,
                extra: &picture.extra,
                attributes,
            }
        })
        .collect();
    let report = write_pictures(set, output, &layers, others)?;
    notes.extend(report.to_string().lines().map(str::to_owned));
    let mut written = Written {
        file: output.to_owned(),
        added_layers: Vec::new(),
        replaced_layers: Vec::new(),
        along: Vec::new(),
        dropped_layers: Vec::new(),
        clamped_values: report.clamped_values,
        non_finite_values: report.non_finite_values,
        notes,
    };
    for OfPicture { replacements, along, dropped, extra, .. } in pictures {
        let added = extra.into_iter().map(|layer| layer.name).filter(|name| !report.left_out.contains(name));
        written.added_layers.extend(added);
        written.replaced_layers.extend(replacements.into_iter().map(|(name, _)| name));
        written.along.extend(along);
        written.dropped_layers.extend(dropped);
    }
    Ok(written)
}

/// Writes the colour of the first picture, with its alpha, as a file that holds nothing else.
fn write_picture(
    estimates: &[Estimate],
    set: &BufferSet,
    output: &Path,
    keep: &[Intermediate],
    format: Format,
) -> Result<Written> {
    let mut notes = Vec::new();
    if estimates.len() > 1 || set.pictures().len() > 1 {
        notes.push("the file holds the first picture alone".into());
    }
    if !keep.is_empty() {
        notes.push("the file holds the colour alone: OpenEXR holds intermediates, too".into());
    }
    let Some(first) = estimates.first() else {
        return Err(Error::Request(RequestCause::Misuse {
            problem: "no estimate is to be written".into(),
            change: "give one for each picture",
        }));
    };
    let picture = &set.pictures[0];
    let form = Form::new(set, 0, first);
    let mut along = Vec::new();
    let alpha = picture.alpha.as_ref().filter(|alpha| alpha.layer == picture.color.mean.layer);
    let mut image = match format {
        // The encoder divides by alpha.
        Format::Png => form.without_fringe(Cow::Borrowed(&first.color)),
        _ => form.stored(Cow::Borrowed(&first.color), &picture.color.multipliers, |_| &None),
    }
    .into_owned();
    if let Some(planes) = alpha {
        match picture.payload.iter().find(|source| source.signal.mean == *planes) {
            Some(source) => {
                let is_denoised = denoised(first, source).is_some_and(|layer| layer.left.is_none());
                along.extend(is_denoised.then(|| source.name.clone()));
                image.planes.push(form.alpha(planes));
            }
            None => image.planes.extend(set.image(0, planes, 0.0).planes),
        }
    }
    let counts = picture_file::write(output, &image, format, set.png_encoding)?;
    notes.extend(counts.notes());
    Ok(Written {
        file: output.to_owned(),
        added_layers: Vec::new(),
        replaced_layers: Vec::new(),
        along,
        dropped_layers: Vec::new(),
        clamped_values: counts.clamped_values,
        non_finite_values: counts.non_finite_values,
        notes,
    })
}

/// Returns the denoised layer of a source.
fn denoised<'a>(estimate: &'a Estimate, source: &PayloadSource) -> Option<&'a DenoisedLayer> {
    estimate.payload.iter().find(|layer| layer.name == source.name)
}

/// Reads the layers again that no filter changed, so that they are written as they were. Those that were merged from
/// seeds become what the input would store.
fn restore_unchanged(set: &mut BufferSet, estimates: &[Estimate]) -> Result<()> {
    set.divide_products(|picture, source| match (estimates.get(picture), source) {
        (Some(estimate), Some(source)) => denoised(estimate, source).is_none(),
        (estimate, _) => estimate.is_none(),
    });
    set.restore_payload(|picture, source| {
        let estimate = estimates.get(picture);
        estimate.and_then(|estimate| denoised(estimate, source)).is_none_or(|layer| layer.left.is_some())
    })
}

/// Converts denoised layers of a picture to the form in which its input stores them.
struct Form<'a> {
    set: &'a BufferSet,
    picture: usize,
    estimate: &'a Estimate,
    /// Alpha of the output, and the pixels of the input without hits; `None` if alpha stays as it is.
    hits: Option<(Vec<f32>, Cow<'a, [bool]>)>,
}

impl<'a> Form<'a> {
    fn new(set: &'a BufferSet, picture: usize, estimate: &'a Estimate) -> Self {
        let mut form = Self { set, picture, estimate, hits: None };
        let own = &set.pictures[picture];
        if let Some(planes) = own.alpha.as_ref().filter(|_| !own.keeps_alpha) {
            let empty = match &own.empty {
                Some(empty) => Cow::Borrowed(empty.as_slice()),
                // The samples of the colour are still there.
                None => Cow::Owned(set.empty_pixels(picture, &set.raw(picture, &own.color)).unwrap_or_default()),
            };
            form.hits = Some((form.alpha(planes), empty));
        }
        form
    }

    /// Returns an alpha as the output has it, from 0 to 1, in the window of the picture.
    fn alpha(&self, planes: &Planes) -> Vec<f32> {
        let payload = self.set.pictures[self.picture].payload.iter();
        let source = payload.filter(|source| source.signal.mean == *planes);
        let mut alpha = match source.into_iter().find_map(|source| denoised(self.estimate, source)) {
            Some(layer) => layer.image.planes[0].clone(),
            None => self.set.image(self.picture, planes, 0.0).planes.swap_remove(0),
        };
        alpha.iter_mut().for_each(|alpha| *alpha = alpha.clamp(0.0, 1.0));
        alpha
    }

    /// Returns a colour that is 0 where neither the input nor the output has a hit.
    fn without_fringe<'b>(&self, image: Cow<'b, Image>) -> Cow<'b, Image> {
        match &self.hits {
            Some((alpha, empty)) => without_fringe(image, alpha, empty),
            None => image,
        }
    }

    /// Returns a colour or light, which is multiplied by its multipliers, as the input stores it. `of_half` returns the
    /// multiplier of a half that the output keeps; `None` takes that of the mean.
    fn stored<'b>(
        &self,
        image: Cow<'b, Image>,
        multipliers: &[Multiplier],
        of_half: impl Fn(&Multiplier) -> &Option<Planes>,
    ) -> Cow<'b, Image> {
        let image = self.without_fringe(image);
        multipliers.iter().rev().fold(image, |image, multiplier| {
            let planes = of_half(multiplier).as_ref().unwrap_or(&multiplier.mean);
            let by = match multiplier.kind {
                MultiplierKind::Alpha => Image { extent: image.extent, planes: vec![self.alpha(planes)] },
                MultiplierKind::Factor => self.factor(planes),
            };
            Cow::Owned(multiplier.kind.divided(&image, &by))
        })
    }

    /// Returns a factor as the output has it, in the window of the picture.
    fn factor(&self, planes: &Planes) -> Image {
        let mut factor = self.set.image(self.picture, planes, 0.0);
        let file = &self.set.files[planes.file];
        for (plane, channel) in factor.planes.iter_mut().zip(&planes.channels) {
            // The mean of several seeds is rounded when it is written.
            if file.stored_types[self.set.part(planes)][*channel] == SampleType::F16 {
                plane.iter_mut().for_each(|value| *value = f16::from_f32(*value).to_f32());
            }
        }
        factor
    }

    /// Returns channels of the input with a denoised image in their own window. Pixels outside of the picture stay as
    /// they were.
    fn replaced(&self, layer: &str, planes: &Planes, image: Cow<'_, Image>) -> ReplacedChannels {
        let window = self.set.data_window_of(self.picture);
        let own = self.set.window(planes, window);
        let part = self.set.part(planes);
        let image = if source::covers(window, own) {
            source::aligned(image.into_owned(), window, own, 0.0)
        } else {
            let payload = &self.set.pictures[self.picture].payload;
            let mut whole = match payload.iter().find(|source| source.signal.mean == *planes) {
                Some(source) => self.set.quotient(&source.signal),
                None => self.set.files[0].planes(part, &planes.channels),
            };
            source::overlay(&mut whole, own, &image, window);
            whole
        };
        ReplacedChannels { layer: layer.to_owned(), part, channels: planes.channels.clone(), image }
    }

    /// Returns the alpha of a half of the colour with the denoised alpha in its place; `None` without one.
    fn alpha_of_half(&self, name: &str, alpha: &Image) -> Option<ReplacedChannels> {
        let index = self.set.files[0].layers.iter().position(|layer| layer.name == name)?;
        let layer = &self.set.files[0].layers[index];
        let channel = layer.channel("A").filter(|_| layer.channels.len() > 1)?;
        let planes = Planes { file: 0, layer: index, channels: vec![channel] };
        Some(self.replaced(name, &planes, Cow::Borrowed(alpha)))
    }
}

/// Returns a remark on layers that are as they were because a frame beside lacks them.
fn lacked_beside(estimates: &[Estimate]) -> Option<String> {
    let layers = estimates.iter().flat_map(|estimate| &estimate.payload);
    let lacked: Vec<_> = layers
        .filter(|layer| layer.left == Some(PayloadLeft::LackedBeside))
        .map(|layer| text::name(&layer.name).into_owned())
        .collect();
    (!lacked.is_empty()).then(|| format!("as they were, because a frame beside lacks them: {}", text::list(lacked)))
}

/// Layers of the output that belong to one picture.
struct OfPicture<'a> {
    color: Cow<'a, Image>,
    replacements: Vec<(String, Image)>,
    /// Channels of layers that are denoised along.
    others: Vec<ReplacedChannels>,
    /// Names of the layers that are denoised along.
    along: Vec<String>,
    dropped: Vec<String>,
    extra: Vec<NamedLayer>,
}

impl<'a> OfPicture<'a> {
    fn new(
        set: &BufferSet,
        picture: usize,
        estimate: &'a Estimate,
        keep: &[Intermediate],
        prefix: &str,
        notes: &mut Vec<String>,
    ) -> Self {
        let own = &set.pictures[picture];
        let form = Form::new(set, picture, estimate);
        let mut replacements = Vec::new();
        let mut dropped = Vec::new();
        let mut others = Vec::new();
        let mut along = Vec::new();
        let mut alpha_of_color = None;
        for source in &own.payload {
            let Some(layer) = denoised(estimate, source) else { continue };
            let planes = &source.signal.mean;
            let part = set.part(planes);
            let is_changed = layer.left.is_none();
            let is_lost = || planes.channels.iter().any(|channel| set.files[0].is_freed(part, *channel));
            if !is_changed && !source.signal.is_product && !is_lost() {
                continue;
            }
            let image = match source.kind {
                PayloadKind::Light => form.stored(Cow::Borrowed(&layer.image), &source.signal.multipliers, |_| &None),
                PayloadKind::Alpha => {
                    let mut image = layer.image.clone();
                    image.planes.iter_mut().flatten().for_each(|alpha| *alpha = alpha.clamp(0.0, 1.0));
                    Cow::Owned(image)
                }
            };
            if is_changed {
                along.push(source.name.clone());
                let stale = source.stale.iter().map(|layer| set.files[0].layers[*layer].name.clone());
                let stale: Vec<String> = stale.filter(|name| !dropped.contains(name)).collect();
                dropped.extend(stale);
                if Some(planes) == own.alpha.as_ref() {
                    alpha_of_color = Some(image.clone());
                }
            }
            others.push(form.replaced(&source.name, planes, image));
        }
        if !dropped.is_empty() {
            let names = dropped.iter().map(|name| text::name(name).into_owned());
            notes.push(format!(
                "left out, halves and variances of layers that are denoised along: {}",
                text::list(names)
            ));
        }
        for layer in set.uses_in_input().iter().filter(|layer| layer.picture == Some(picture)) {
            let sign = match layer.role {
                Role::HalfA => 1.0,
                Role::HalfB => -1.0,
                Role::Variance => {
                    dropped.push(layer.layer.clone());
                    continue;
                }
                _ => continue,
            };
            let plain = layer.channels.iter().filter(|channel| !channel.eq_ignore_ascii_case("A")).count();
            match &estimate.half_spread {
                Some(half_spread) if plain == 3 || plain == 1 => {
                    let image = Cow::Owned(half(&estimate.color, half_spread, sign));
                    // A half whose alpha stays as it was is divided by it.
                    let stored = form.stored(image, &own.color.multipliers, |by| match &alpha_of_color {
                        Some(_) => &None,
                        None if sign > 0.0 => &by.half_a,
                        None => &by.half_b,
                    });
                    replacements.push((layer.layer.clone(), stored.into_owned()));
                    others.extend(alpha_of_color.as_ref().and_then(|alpha| form.alpha_of_half(&layer.layer, alpha)));
                }
                _ => notes.push(format!(
                    "layer '{}' is as it was: it holds more than a half of the colour",
                    text::name(&layer.layer)
                )),
            }
        }
        let error = estimate.error.as_ref().map(|image| NamedLayer {
            name: format!("{prefix}.error"),
            channels: vec!["V".into()],
            image: image.clone(),
        });
        let kept = estimate.layers.iter().filter(|layer| keep.contains(&layer.intermediate));
        let named = kept.map(|layer| NamedLayer {
            name: format!("{prefix}.{}", layer.name),
            channels: layer.channels.clone(),
            image: layer.image.clone(),
        });
        let color = form.stored(Cow::Borrowed(&estimate.color), &own.color.multipliers, |_| &None);
        Self { color, replacements, others, along, dropped, extra: error.into_iter().chain(named).collect() }
    }
}

/// Returns the largest number of bytes in memory, besides the estimate, before the file is written: the colour and its
/// halves as the file stores them, the halves as they are computed, and two copies of the added layers, of the colour
/// and of the layers that are denoised along.
fn bytes_for_writing(estimate: &Estimate, keep: &[Intermediate]) -> u64 {
    let halves = estimate.half_spread.as_ref().map_or(0, |_| 2 * estimate.color.channels());
    let kept =
        estimate.layers.iter().filter(|layer| keep.contains(&layer.intermediate)).map(|layer| layer.image.channels());
    let added = kept.sum::<usize>() + estimate.error.as_ref().map_or(0, Image::channels);
    let along = estimate.payload.iter().map(|layer| layer.image.channels()).sum::<usize>();
    4 * (estimate.color.extent.pixels() * (2 * estimate.color.channels() + 2 * halves + 2 * added + 2 * along)) as u64
}

/// Returns half A (`sign` 1) or half B (`sign` −1) of the denoised colour.
fn half(color: &Image, half_spread: &Image, sign: f32) -> Image {
    let planes = color.planes.iter().zip(&half_spread.planes);
    let planes =
        planes.map(|(mean, spread)| mean.iter().zip(spread).map(|(mean, spread)| mean + sign * spread).collect());
    Image { extent: color.extent, planes: planes.collect() }
}
