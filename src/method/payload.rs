//! The payload of a frame on its way to the device and through a method: layers that are filtered along with the
//! colour.

use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::Strip;
use super::frame::GpuPayload;
use crate::error::Result;
use crate::frame::{Frame, PayloadLayer};
use crate::gpu::{Buffer, Recorder};
use crate::image::Image;
use crate::stage::frames::Frames;
use crate::stage::payload::{MOST_PLANES, PayloadGroup};

/// Reason why a payload layer is as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PayloadLeft {
    /// All its pixels are equal, so that no filter changes them.
    Constant,
    /// A frame beside lacks the layer.
    LackedBeside,
    /// No pixel of the colour has noise, so that the frame is copied.
    NoNoise,
}

/// Place of a layer among the planes of the payload: its channels are in one plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PayloadPlace {
    /// Index of the plane.
    plane: usize,
    /// Component that holds the first channel.
    pub(crate) lane: usize,
}

impl PayloadPlace {
    /// Returns the group of planes, and the plane in it.
    pub(crate) fn in_group(self) -> (usize, u32) {
        (self.plane / MOST_PLANES as usize, (self.plane % MOST_PLANES as usize) as u32)
    }
}

/// Layers of a frame, packed into planes.
pub(crate) struct Packing<'a> {
    /// Layers of the own frame with their places, or the reason why a layer is not filtered.
    pub(crate) layers: Vec<(&'a PayloadLayer, std::result::Result<PayloadPlace, PayloadLeft>)>,
    planes: usize,
    with_halves: bool,
}

impl<'a> Packing<'a> {
    /// Packs the layers that all frames have and that are not the same everywhere. Half spreads are packed, too, if
    /// `with_halves` is set.
    pub(super) fn of_window(window: &Frames<&'a Frame>, with_halves: bool) -> Self {
        let layers = window.own.payload();
        let left: Vec<Option<PayloadLeft>> = layers.iter().map(|layer| left(layer, &window.beside)).collect();
        let is_filtered = |index: &usize| left[*index].is_none();
        let channels = |index: usize| layers[index].mean.channels();
        let mut places = vec![PayloadPlace { plane: 0, lane: 0 }; layers.len()];
        // Several channels belong to the channels of the colour and begin in x. A single number goes to a free w.
        let mut free = Vec::new();
        let mut planes = 0;
        for index in (0..layers.len()).filter(is_filtered).filter(|index| channels(*index) > 1) {
            places[index].plane = planes;
            if channels(index) <= SINGLE_LANE {
                free.push(planes);
            }
            planes += 1;
        }
        let mut free = free.into_iter();
        for index in (0..layers.len()).filter(is_filtered).filter(|index| channels(*index) == 1) {
            let plane = free.next().unwrap_or_else(|| {
                planes += 1;
                planes - 1
            });
            places[index] = PayloadPlace { plane, lane: SINGLE_LANE };
        }
        let placed =
            layers.iter().zip(left).zip(places).map(|((layer, left), place)| (layer, left.map_or(Ok(place), Err)));
        Self { layers: placed.collect(), planes, with_halves }
    }

    /// Returns the number of groups of planes.
    pub(crate) fn groups(&self) -> usize {
        self.planes.div_ceil(MOST_PLANES as usize)
    }

    /// Returns the number of layers that are filtered.
    pub(super) fn filtered(&self) -> usize {
        self.layers.iter().filter(|(_, place)| place.is_ok()).count()
    }

    /// Uploads the rows of a strip and its halo of some groups of planes. The frame has all the layers.
    pub(super) fn upload(
        &self,
        rec: &mut Recorder,
        frame: &Frame,
        strip: &Strip,
        groups: Range<usize>,
    ) -> Result<Vec<GpuPayload>> {
        let pixels = strip.pixels(frame.extent().width as usize);
        let own = |layer: &PayloadLayer| frame.payload().iter().find(|other| other.name == layer.name);
        let placed: Vec<(&PayloadLayer, PayloadPlace)> =
            self.layers.iter().filter_map(|(layer, place)| Some((own(layer)?, place.ok()?))).collect();
        let has_halves = self.with_halves && placed.iter().any(|(layer, _)| layer.half_spread.is_some());
        let mut uploaded = Vec::with_capacity(groups.len());
        for group in groups {
            let first = group * MOST_PLANES as usize;
            let planes = (self.planes - first).min(MOST_PLANES as usize);
            let members: Vec<_> =
                placed.iter().filter(|(_, place)| (first..first + planes).contains(&place.plane)).collect();
            let mut upload = |image: fn(&PayloadLayer) -> Option<&Image>| {
                let lanes = members.iter().flat_map(|(layer, place)| {
                    let planes = image(layer).map_or(&[][..], |image| &image.planes);
                    planes.iter().zip(place.lane..).map(|(values, lane)| Lane {
                        plane: place.plane - first,
                        lane,
                        values,
                    })
                });
                upload_lanes(rec, &lanes.collect::<Vec<_>>(), planes, &pixels)
            };
            let mean = PayloadGroup { buffer: Arc::new(upload(|layer| Some(&layer.mean))?), planes: planes as u32 };
            let half_spread =
                if has_halves { Some(Arc::new(upload(|layer| layer.half_spread.as_ref())?)) } else { None };
            uploaded.push(GpuPayload { mean, half_spread });
        }
        Ok(uploaded)
    }
}

/// Component of a plane that holds a number that belongs to all channels of the colour.
const SINGLE_LANE: usize = 3;

/// Returns the reason not to filter a layer; `None` if it is filtered.
fn left(layer: &PayloadLayer, beside: &[&Frame]) -> Option<PayloadLeft> {
    let mut others = Vec::with_capacity(beside.len());
    for frame in beside {
        let alike = |other: &&PayloadLayer| other.name == layer.name && other.mean.channels() == layer.mean.channels();
        let Some(other) = frame.payload().iter().find(alike) else { return Some(PayloadLeft::LackedBeside) };
        others.push(other);
    }
    let is_constant = (0..layer.mean.channels()).all(|channel| {
        let value = layer.mean.planes[channel].first().map(|value| value.to_bits());
        let all = std::iter::once(layer).chain(others.iter().copied()).map(|layer| &layer.mean.planes[channel]);
        all.into_iter().all(|plane| plane.iter().all(|other| Some(other.to_bits()) == value))
    });
    is_constant.then_some(PayloadLeft::Constant)
}

/// One channel of a payload plane on the host.
struct Lane<'a> {
    plane: usize,
    lane: usize,
    values: &'a [f32],
}

/// Uploads the same pixels of each lane; components without a lane are 0.
fn upload_lanes(rec: &mut Recorder, lanes: &[Lane], planes: usize, pixels: &Range<usize>) -> Result<Buffer> {
    let count = pixels.len();
    rec.upload_with("payload", 4 * planes * count, |first, piece| {
        // Position of the piece, in pixels of all planes one behind the other.
        let first = first / 4;
        for Lane { plane, lane, values } in lanes {
            let of_plane = plane * count;
            let end = (of_plane + count).min(first + piece.len() / 4);
            let start = of_plane.max(first);
            if start >= end {
                continue;
            }
            let to = &mut piece[4 * (start - first)..4 * (end - first)];
            let from = &values[pixels.start + start - of_plane..pixels.start + end - of_plane];
            to.par_chunks_exact_mut(4).zip(from.par_iter()).with_min_len(4096).for_each(|(to, from)| to[*lane] = *from);
        }
    })
}

/// The payload of a frame inside a method.
#[derive(Clone, Debug, Default)]
pub(super) struct Payload {
    /// As the frame has it, half spreads included.
    pub(super) given: Vec<GpuPayload>,
    /// Without the colour's spikes and lights of few pixels; what the filters average.
    pub(super) repaired: Vec<PayloadGroup>,
}

impl Payload {
    pub(super) fn new(given: Vec<GpuPayload>) -> Self {
        let repaired = given.iter().map(|group| group.mean.clone()).collect();
        Self { given, repaired }
    }

    /// Returns the means as the frame has them.
    pub(super) fn means(&self) -> Vec<PayloadGroup> {
        self.given.iter().map(|group| group.mean.clone()).collect()
    }
}
