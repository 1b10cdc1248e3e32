//! The output: where it goes, and what is in it besides the denoised colour.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use serde::Serialize;
use stein::buffers::{BufferSet, DenoisedLayers, NamedLayer, Role, write_denoised};
use stein::method::Intermediate;
use stein::{Estimate, Image, Method};

use super::Failure;
use super::options::same_file;

/// Layers of ours stand under this name, where no renderer's do.
const PREFIX: &str = "stein";

/// The path that was asked for, or `IN` with `.denoised` before its extension.
pub(crate) fn choose(input: &Path, named: Option<&Path>) -> PathBuf {
    let mut name = input.file_stem().map_or_else(|| OsString::from("image"), OsString::from);
    name.push(".denoised.exr");
    match named {
        Some(folder) if folder.is_dir() => folder.join(name),
        Some(file) => file.to_owned(),
        None => input.with_file_name(name),
    }
}

/// Tells before the work what would go wrong after it.
pub(crate) fn check<'a>(output: &Path, others: impl Iterator<Item = &'a Path>, no_clobber: bool, dry_run: bool) -> Result<(), Failure> {
    check_name(output, others.filter(|other| same_file(output, other)))?;
    if no_clobber && output.exists() {
        let name = output.display();
        return Err(Failure::output(format_args!("{name}: exists already\n  remedy: choose another name with -o, or leave --no-clobber out")));
    }
    check_folder(output, dry_run)
}

/// That it is an OpenEXR file, and that none of what is read would be replaced: `same_files` are those that are the same file as the output.
pub(crate) fn check_name<'a>(output: &Path, mut same_files: impl Iterator<Item = &'a Path>) -> Result<(), Failure> {
    let name = output.display();
    if !output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr")) {
        return Err(Failure::usage(format_args!("{name}: the output is an OpenEXR file\n  remedy: give it a name that ends in .exr")));
    }
    if let Some(other) = same_files.next() {
        return Err(Failure::output(format_args!(
            "{name}: is also read, as {}, and would be replaced\n  remedy: choose another name with -o",
            other.display()
        )));
    }
    Ok(())
}

/// That its folder can be written to.
pub(crate) fn check_folder(output: &Path, dry_run: bool) -> Result<(), Failure> {
    let name = output.display();
    let folder = match output.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let trouble = match folder.metadata() {
        Err(error) => Some(error),
        // It is gone again at once.
        Ok(_) if !dry_run => tempfile::tempfile_in(folder).err(),
        Ok(_) => None,
    };
    match trouble {
        None => Ok(()),
        Some(error) => Err(Failure::output(format_args!(
            "{name}: cannot be written: {error}\n  remedy: check that the folder exists, may be written to and has space left"
        ))),
    }
}

/// What was written.
#[derive(Debug, Serialize)]
pub(crate) struct Written {
    pub(crate) file: PathBuf,
    /// Layers that the input does not have.
    added_layers: Vec<String>,
    /// Halves that were replaced by those of the denoised colour.
    replaced_layers: Vec<String>,
    /// The input's variance, and what an earlier run added: they are not those of the denoised colour.
    dropped_layers: Vec<String>,
    clamped_values: usize,
    non_finite_values: usize,
    pub(crate) notes: Vec<String>,
}

/// Writes the denoised colour, its halves, the estimated error if there is one, and the intermediates in `keep`.
pub(crate) fn write(set: BufferSet, output: &Path, estimate: &Estimate, keep: &[Intermediate], method: &Method) -> Result<Written, Failure> {
    let mut notes = Vec::new();
    let mut replacements = Vec::new();
    let mut dropped = Vec::new();
    let in_input = || set.layer_uses().iter().filter(|layer| layer.file == set.input());
    for layer in in_input() {
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
            Some(half_spread) if plain == 3 || plain == 1 => replacements.push((layer.layer.clone(), half(&estimate.color, half_spread, sign))),
            _ => notes.push(format!("layer '{}' is as it was: it holds more than a half of the colour", layer.layer)),
        }
    }

    let error = estimate.error.as_ref().map(|image| NamedLayer { name: format!("{PREFIX}.error"), channels: vec!["V".into()], image: image.clone() });
    let kept = estimate.layers.iter().filter(|layer| keep.contains(&layer.intermediate));
    let named = kept.map(|layer| NamedLayer { name: format!("{PREFIX}.{}", layer.name), channels: layer.channels.clone(), image: layer.image.clone() });
    let extra: Vec<_> = error.into_iter().chain(named).collect();
    // An earlier run's are not of this colour.
    let stale: Vec<_> = in_input().map(|layer| &layer.layer).filter(|layer| layer.strip_prefix(PREFIX).is_some_and(|rest| rest.starts_with('.'))).collect();
    if !stale.is_empty() {
        notes.push("the input was denoised before".into());
    }
    dropped.extend(stale.into_iter().cloned());

    let parameters = serde_json::to_string(method).map_err(|error| Failure::output(format_args!("{}: {error}", output.display())))?;
    let attributes = [("stein.version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()), ("stein.parameters".to_owned(), parameters)];
    let layers = DenoisedLayers { color: &estimate.color, replacements: &replacements, dropped: &dropped, extra: &extra, attributes: &attributes };
    let report = write_denoised(set, output, &layers).map_err(Failure::output)?;
    notes.extend(report.to_string().lines().map(str::to_owned));
    Ok(Written {
        file: output.to_owned(),
        added_layers: extra.into_iter().map(|layer| layer.name).collect(),
        replaced_layers: replacements.into_iter().map(|(name, _)| name).collect(),
        dropped_layers: dropped,
        clamped_values: report.clamped_values,
        non_finite_values: report.non_finite_values,
        notes,
    })
}

/// Half A or B of the denoised colour.
fn half(color: &Image, half_spread: &Image, sign: f32) -> Image {
    let planes = color.planes.iter().zip(&half_spread.planes);
    let planes = planes.map(|(mean, spread)| mean.iter().zip(spread).map(|(mean, spread)| mean + sign * spread).collect());
    Image { extent: color.extent, planes: planes.collect() }
}
