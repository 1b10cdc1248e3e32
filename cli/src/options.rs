//! Options that several subcommands share.

use std::path::{Path, PathBuf};

use stein::gpu::DeviceChoice;
use stein::text;
use stein::{Denoiser, Extent, Gpu, Method};
use stein_exr::options::gpu_options;
use stein_exr::{BufferSet, BufferSetRequest, LayerRef};

use super::Failure;

/// Layers of the colour, its noise and the features.
#[derive(Clone, Debug, PartialEq, clap::Args)]
#[command(next_help_heading = "Layers")]
pub(crate) struct Source {
    /// Layer with the noisy colour [default: plain R G B, or a layer with a usual name such as `Combined` or `beauty`]
    #[arg(long, value_name = "NAME")]
    layer: Option<String>,
    #[command(flatten)]
    others: BufferSetRequest,
    /// Take every path as it is, without frame numbers (`#`, `%04d`) and layers (`::`)
    #[arg(long)]
    pub(crate) literal: bool,
    #[command(flatten)]
    pub(crate) demands: Demands,
}

/// What an input has to tell of its noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, clap::Args)]
pub(crate) struct Demands {
    /// Refuse an image that has neither halves nor a variance of its colour; without this option the noise is estimated
    /// from the image itself
    #[arg(long)]
    pub(crate) require_noise: bool,
    /// Refuse an image whose halves, variance and visible noise contradict each other, as if the variance were that of
    /// one sample; without this option the contradiction is only reported
    #[arg(long)]
    pub(crate) strict: bool,
}

impl Source {
    /// Returns the request for an input with everything that was named beside it. `seeds` are further renders of the
    /// same frame, besides those of `--seed`.
    pub(crate) fn request(&self, input: &Path, seeds: &[PathBuf]) -> BufferSetRequest {
        let others = if self.literal { self.others.literal() } else { self.others.clone() };
        let seeds = [seeds, &others.seeds].concat();
        BufferSetRequest { input: input.to_owned(), layer: self.layer.clone(), seeds, ..others }
    }

    /// Returns a layer of another file, such as a reference, and takes its path literally if `--literal` says so.
    pub(crate) fn reference(&self, named: &LayerRef) -> LayerRef {
        if self.literal { named.clone().literal() } else { named.clone() }
    }

    /// Refuses options that the method has no use for.
    pub(crate) fn check(&self, method: &Method) -> Result<(), Failure> {
        let given = self.others.features.first().map(|(feature, _)| format!("--feature {}", text::name(feature)));
        let given =
            given.or_else(|| self.others.skip_features.first().map(|feature| format!("--skip-feature {feature}")));
        match given.filter(|_| !method.uses_features()) {
            Some(option) => {
                let name = method.name();
                Err(Failure::usage(format_args!(
                    "{option}: {name} uses no features\n  remedy: leave it out, or choose another --method"
                )))
            }
            None => Ok(()),
        }
    }

    /// Returns the source as the method reads it: without features if the method uses none, so that they are not listed
    /// as used; with halves of the layers that are denoised along if the method uses them.
    pub(crate) fn for_method(&self, method: &Method) -> Self {
        let mut source = self.clone();
        source.others.no_features |= !method.uses_features();
        source.others.payload_halves = method.filters_halves();
        source
    }
}

/// Reads an input with everything that was named beside it.
pub(crate) fn read(request: &BufferSetRequest) -> Result<BufferSet, Failure> {
    BufferSet::read(request).map_err(|error| Failure::in_file(&request.input, error))
}

/// The device and its memory limit.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Device")]
pub(crate) struct Device {
    /// Adapter, by its index or a part of its name, such as 1 or rtx [default: the fastest kind]
    #[arg(long, value_name = "NAME|INDEX")]
    device: Option<DeviceChoice>,
    /// List the adapters, like `stein devices`, and do nothing else
    #[arg(long)]
    pub(crate) list_devices: bool,
    /// Memory limit on the device, such as 2G, 512M or a number of bytes; larger images are processed in strips, with
    /// the same result
    #[arg(long, value_name = "SIZE", value_parser = memory_size)]
    pub(crate) max_memory: Option<u64>,
}

impl Device {
    pub(crate) fn open(&self) -> Result<Gpu, Failure> {
        Ok(Gpu::open_with(self.device.as_ref().unwrap_or(&DeviceChoice::Auto), gpu_options())?)
    }

    pub(crate) fn denoiser(&self, gpu: &Gpu, method: Method) -> Result<Denoiser, Failure> {
        let denoiser = Denoiser::new(gpu, method).map_err(Failure::usage)?;
        Ok(match self.max_memory {
            Some(bytes) => denoiser.with_max_memory(bytes),
            None => denoiser,
        })
    }
}

/// Parses a number of bytes, or one with K, M, G or T (of 1024), which B or iB may follow.
fn memory_size(text: &str) -> Result<u64, String> {
    let wrong = || "it must be a positive number of bytes, or one with K, M, G or T, as in 512M or 1.5GiB".to_owned();
    let text = text.trim();
    let digits = text.find(|character: char| !character.is_ascii_digit() && character != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let power = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 0,
        "k" | "kb" | "kib" => 1,
        "m" | "mb" | "mib" => 2,
        "g" | "gb" | "gib" => 3,
        "t" | "tb" | "tib" => 4,
        _ => return Err(wrong()),
    };
    let number: f64 = number.parse().map_err(|_| wrong())?;
    let bytes = number * 1024.0_f64.powi(power);
    if bytes >= 1.0 { Ok(bytes as u64) } else { Err(wrong()) }
}

/// Parses a width and a height, as in 1024x768.
pub(crate) fn size(text: &str) -> Result<Extent, String> {
    let sides =
        text.split_once(['x', 'X', '×']).and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)));
    match sides {
        Some((width @ 1..=65_536, height @ 1..=65_536)) => Ok(Extent { width, height }),
        _ => Err("it must look like 1024x1024".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_counted_in_powers_of_1024() {
        for (text, bytes) in [("4096", 4096), ("512M", 512 << 20), ("1.5GiB", 3 << 29), ("2 kb", 2048), ("1T", 1 << 40)]
        {
            assert_eq!(memory_size(text), Ok(bytes), "{text}");
        }
        for text in ["", "G", "-1", "0", "5 bananas", "1.2.3M"] {
            assert!(memory_size(text).is_err(), "{text}");
        }
    }
}
