//! Writes an estimate into a copy of the file that it was made from.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::picture_file::{self, Format};
use crate::write::write_pictures;
use crate::{BufferSet, DenoisedLayers, LayerUse, NamedLayer, Role};
use stein::error::{FileCause, RequestCause};
use stein::host_memory::FreeMemory;
use stein::method::{Intermediate, Method};
use stein::{Error, Estimate, Image, Result, text};

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
    /// Names of the layers that were left out: the input's variance and the layers of an earlier run, which do not
    /// belong to the denoised colour.
    pub dropped_layers: Vec<String>,
    /// Number of values beyond the largest half float, written as ±65504.
    pub clamped_values: usize,
    /// Number of values that were not finite, written as 0.
    pub non_finite_values: usize,
    /// Other remarks.
    pub notes: Vec<String>,
}

/// Writes the input with its colour and halves replaced by those of the estimate, and without its variance, which does
/// not belong to the denoised colour. Adds the estimated error, if there is one, as `stein.error`, and the
/// [`Estimate::layers`] of the intermediates in `keep` as `stein.*`. `set` is the set that the frame was made of, and
/// is used up; `method` is noted in the header.
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
    set: BufferSet,
    output: &Path,
    keep: &[Intermediate],
    method: &Method,
) -> Result<Written> {
    if let Some(format) = Format::from_extension(output).filter(|format| *format != Format::OpenExr) {
        return write_picture(estimates, &set, output, keep, format);
    }
    FreeMemory::now()
        .check(estimates.iter().map(|estimate| bytes_for_writing(estimate, keep)).sum())
        .map_err(|shortage| shortage.error("writing the output"))?;
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
    let mut stale: Vec<String> = stale.into_iter().chain(of_seeds).collect();
    let layers: Vec<DenoisedLayers<'_>> = estimates
        .iter()
        .zip(&mut pictures)
        .enumerate()
        .map(|(index, (estimate, picture))| {
            picture.dropped.append(&mut stale);
            let attributes = if index == 0 { attributes.as_slice() } else { &[] };
            DenoisedLayers {
                color: &estimate.color,
                replacements: &picture.replacements,
                dropped: &picture.dropped,
                extra: &picture.extra,
                attributes,
            }
        })
        .collect();
    let report = write_pictures(set, output, &layers)?;
    notes.extend(report.to_string().lines().map(str::to_owned));
    let mut written = Written {
        file: output.to_owned(),
        added_layers: Vec::new(),
        replaced_layers: Vec::new(),
        dropped_layers: Vec::new(),
        clamped_values: report.clamped_values,
        non_finite_values: report.non_finite_values,
        notes,
    };
    for OfPicture { replacements, dropped, extra } in pictures {
        let added = extra.into_iter().map(|layer| layer.name).filter(|name| !report.left_out.contains(name));
        written.added_layers.extend(added);
        written.replaced_layers.extend(replacements.into_iter().map(|(name, _)| name));
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
    let mut image = first.color.clone();
    image.planes.extend(set.alpha().into_iter().flat_map(|alpha| alpha.planes));
    let counts = picture_file::write(output, &image, format, set.png_encoding)?;
    notes.extend(counts.notes());
    Ok(Written {
        file: output.to_owned(),
        added_layers: Vec::new(),
        replaced_layers: Vec::new(),
        dropped_layers: Vec::new(),
        clamped_values: counts.clamped_values,
        non_finite_values: counts.non_finite_values,
        notes,
    })
}

/// Layers of the output that belong to one picture.
struct OfPicture {
    replacements: Vec<(String, Image)>,
    dropped: Vec<String>,
    extra: Vec<NamedLayer>,
}

impl OfPicture {
    fn new(
        set: &BufferSet,
        picture: usize,
        estimate: &Estimate,
        keep: &[Intermediate],
        prefix: &str,
        notes: &mut Vec<String>,
    ) -> Self {
        let mut replacements = Vec::new();
        let mut dropped = Vec::new();
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
                    replacements.push((layer.layer.clone(), half(&estimate.color, half_spread, sign)));
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
        Self { replacements, dropped, extra: error.into_iter().chain(named).collect() }
    }
}

/// Returns the largest number of bytes in memory, besides the estimate, before the file is written: the colour and its
/// halves as the file stores them, the halves as they are computed, and two copies of the added layers.
fn bytes_for_writing(estimate: &Estimate, keep: &[Intermediate]) -> u64 {
    let halves = estimate.half_spread.as_ref().map_or(0, |_| 2 * estimate.color.channels());
    let kept =
        estimate.layers.iter().filter(|layer| keep.contains(&layer.intermediate)).map(|layer| layer.image.channels());
    let added = kept.sum::<usize>() + estimate.error.as_ref().map_or(0, Image::channels);
    4 * (estimate.color.extent.pixels() * (estimate.color.channels() + 2 * halves + 2 * added)) as u64
}

/// Returns half A (`sign` 1) or half B (`sign` −1) of the denoised colour.
fn half(color: &Image, half_spread: &Image, sign: f32) -> Image {
    let planes = color.planes.iter().zip(&half_spread.planes);
    let planes =
        planes.map(|(mean, spread)| mean.iter().zip(spread).map(|(mean, spread)| mean + sign * spread).collect());
    Image { extent: color.extent, planes: planes.collect() }
}
