//! Sampling maps as files, for renderers in another process.

use std::path::Path;

use stein::error::{FileCause, LayerCause};
use stein::sampling::{SampleCounts, SamplingMap};
use stein::{Error, Image, Result};

use crate::file::ExrFile;
use crate::picture_file::PngEncoding;
use crate::samples::layer;
use crate::{Windows, write_layers_in};

/// A sampling map as a file stores it: layer `density.V`, real samples per pixel; `samples.V`, whole and even
/// numbers of samples to draw; and `drawn.V`, how many samples of the pixel were drawn before, so that a renderer can
/// go on where it was.
#[derive(Clone, Debug)]
pub struct MapFile {
    /// Samples to draw.
    pub map: SamplingMap,
    /// Samples that were drawn before; `None` if unknown.
    pub drawn: Option<SampleCounts>,
    /// Windows of the picture that the map belongs to; `None` if both begin at (0, 0).
    pub windows: Option<Windows>,
}

impl MapFile {
    /// Writes the map, with texts for the header. The file appears under its name only when it is complete; an existing
    /// file is replaced.
    ///
    /// # Errors
    /// As [`write_layers`](crate::write_layers).
    pub fn write(&self, path: &Path, attributes: &[(String, String)]) -> Result<()> {
        let whole = |counts: &SampleCounts| Image {
            extent: counts.extent(),
            planes: vec![counts.pairs().iter().map(|pairs| 2.0 * *pairs as f32).collect()],
        };
        let mut layers =
            vec![layer("density", &["V"], self.map.density.clone()), layer("samples", &["V"], whole(&self.map.counts))];
        layers.extend(self.drawn.as_ref().map(|drawn| layer("drawn", &["V"], whole(drawn))));
        write_layers_in(self.windows, path, &layers, attributes)
    }

    /// Reads a map. In a file without `density`, `samples` is taken for the density.
    ///
    /// # Errors
    /// [`Error::File`] for a file that cannot be read or has no layer `samples`; [`Error::Layer`] for numbers that are
    /// not whole and even.
    pub fn read(path: &Path) -> Result<Self> {
        let file = ExrFile::read(path, PngEncoding::Linear)?;
        let find = |name: &str| {
            let found = file.layers.iter().find(|layer| layer.name == name)?;
            let channel = found.channels.first()?;
            Some(file.planes(found.part, &[channel.index]))
        };
        let Some(samples) = find("samples") else {
            return Err(Error::File { path: path.to_owned(), cause: FileCause::NoMap { layers: file.layer_list() } });
        };
        let counts = |name: &str, image: &Image| {
            let whole = |samples: &f32| {
                (*samples >= 0.0 && *samples % 2.0 == 0.0 && *samples < 2.0 * u32::MAX as f32)
                    .then_some((samples / 2.0) as u32)
            };
            let pairs: Option<Vec<u32>> = image.planes[0].iter().map(whole).collect();
            let pairs = pairs.ok_or_else(|| Error::Layer {
                path: path.to_owned(),
                layer: name.to_owned(),
                cause: LayerCause::UnevenCounts,
            })?;
            SampleCounts::from_pairs(image.extent, pairs)
        };
        let drawn = find("drawn").map(|drawn| counts("drawn", &drawn)).transpose()?;
        let density = find("density").unwrap_or_else(|| samples.clone());
        let part = file.layers.iter().find(|layer| layer.name == "samples").map_or(0, |layer| layer.part);
        let windows = Some(Windows { data: file.data_window(part), display: file.display_window() });
        Ok(Self { map: SamplingMap { density, counts: counts("samples", &samples)? }, drawn, windows })
    }
}
