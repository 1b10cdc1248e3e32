//! The NL-means operator: pixel distances of pairs of neighbours, and a payload filtered by the weights they give
//! (thesis 7.1.1, 8.2).

use glam::IVec2;
use serde::Serialize;

use super::exact::{ExactTiles, Region};
use super::payload::PAYLOAD_STEP;
use super::{PLANE_PIXEL_BYTES, plane_bytes};
use crate::error::Result;
use crate::gpu::{Buffer, Definition, Gpu, Recorder, bindings, uniforms};
use crate::parameters::{choices, parameters};

uniforms! {
    pub(super) struct NlmParams {
        pub(super) extent: IVec2,
        pub(super) first_column: i32,
        pub(super) width: i32,
        pub(super) first_row: i32,
        pub(super) rows: i32,
        pub(super) first_offset: IVec2,
        pub(super) offsets: IVec2,
        pub(super) starts: i32,
        pub(super) completes: i32,
        pub(super) stride: i32,
        pub(super) block_rows: i32,
        pub(super) k_squared: f32,
        pub(super) alpha: f32,
        pub(super) inverse_channels: f32,
        pub(super) cut: f32,
        pub(super) centre_floor: f32,
    }
}

bindings! {
    struct NlmDistance<'a> {
        uniform params: NlmParams, around guide, around variance_of_mean, around neighbours, around neighbours_variance,
        write columns,
    }
    struct NlmWeight<'a> { uniform params: NlmParams, around columns, write weight_columns }
    struct NlmFilter<'a> {
        uniform params: NlmParams, around columns, read payload, around neighbours, write filtered, write weights,
    }
    struct NlmFilterResidual<'a> {
        uniform params: NlmParams, around columns, read payload, around neighbours, write filtered, write weights,
        read variance_of_mean, around neighbours_variance, write residual_variance,
    }
}

choices! {
    /// The weight of a pixel in its own average.
    // A JSON document calls them by the variants' names.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    pub enum CentreWeight {
        /// 1: the distance of a pixel to itself is 0.
        One => "one",
        /// The largest weight among its neighbours, at least 10⁻³: a spike, which has no similar neighbour, does not
        /// keep its own value.
        LargestNeighbour => "largest-neighbour",
    }
}

impl CentreWeight {
    fn floor(self) -> f32 {
        match self {
            // The shader takes a floor above 1 as the request for exactly 1.
            Self::One => 2.0,
            Self::LargestNeighbour => 1e-3,
        }
    }

    /// Returns the weight of a pixel in its own average, where `largest_neighbour` is the largest weight of its
    /// neighbours.
    pub(crate) fn weight(self, largest_neighbour: f32) -> f32 {
        match self {
            Self::One => 1.0,
            Self::LargestNeighbour => largest_neighbour.max(self.floor()),
        }
    }
}

choices! {
    /// Whether pairs of opposite neighbours stand in for each other where their mean matches better than both (eq.
    /// 7.6).
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Symmetry {
        /// Each neighbour stands for itself.
        Off => "off",
        /// By degrees: the blend begins where the weight of the mean exceeds the sum of both weights, and is complete
        /// where it is twice that sum. Weights are continuous, as finite differences require.
        Blended => "blended",
        /// Both weights become the weight of their mean where it exceeds their sum (thesis 7.1.1).
        Hard => "hard",
    }
}

impl Symmetry {
    /// Returns the definitions of this choice for the shaders.
    pub(super) fn definitions(self) -> [(&'static str, Definition); 2] {
        [("SYMMETRIC", (self != Self::Off).into()), ("SYMMETRIC_HARD", (self == Self::Hard).into())]
    }
}

parameters! {
    /// How distances become weights, the same in every filter of a method.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    pub struct Weighting {
        /// Whether the mean of opposite neighbours may stand for both where it matches better (eq. 7.6). It keeps
        /// gradients.
        pub symmetric: Symmetry,
        /// Weight of a pixel in its own average.
        pub centre: CentreWeight,
    }
}

/// Division of the work on the window. The result does not depend on it, to the bit.
///
/// Measured on llvmpipe (Mesa 22.3, LLVM 15, vectors of 256 bits), in nanoseconds of processor time per pixel and pair
/// of offsets, R = 10, and in seconds that the driver compiles:
///
/// | kernel | 1 pixel | 2 | **4** | 8 |
/// | --- | --- | --- | --- | --- |
/// | `candidate_accumulate`, four features in two groups | 143, 0.4 s | 131, 1.2 s | 111, 3.4 s | |
/// | `nlm_filter`, f = 3, two planes | 38, 0.1 s | 25, 0.2 s | 19, 0.4 s | 15, 1.0 s |
/// | `nlm_filter`, f = 1, one plane | 20, 0.1 s | 14, 0.1 s | 12, 0.2 s | |
///
/// | kernel | 1 row of offsets | **2** | 4 |
/// | --- | --- | --- | --- |
/// | `nlm_distance`, one size of patches | 30 | 25 | 27 |
/// | `nlm_distance`, two sizes | 37 | 43 | 37 |
///
/// The whole of DFC on 256×256 pixels, in seconds of processor time: 4.9 with 8 MiB of scratch and blocks of 32 rows,
/// 4.6 with 8 or 4 MiB and a block for all of the rows that fit, 5.1 with 32 MiB, 5.3 with 1 MiB, 5.7 with half a MiB.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    /// Bytes of the scratch buffer that holds the column sums of one strip of rows and one chunk of offsets; twice as
    /// many bytes where two sizes of patches are summed.
    pub scratch_bytes: u64,
    /// Rows that one invocation of `nlm_distance` and `nlm_weight` walks down; the 2f rows at its ends are computed
    /// twice.
    pub block_rows: u32,
    /// Number of offsets, one below the other, that one invocation of `nlm_distance` computes at a time if there is one
    /// size of patches.
    pub offset_rows: u32,
    /// Number of adjacent pixels in a row that one invocation of the filters computes at a time.
    pub pixels: u32,
    /// Number of columns of an image that are processed at a time, so that the scratch holds as many rows of a wide
    /// image as of a narrow one.
    pub band_columns: u32,
    /// Cost of the dispatches for one more rectangle, in pixels: the number of pixels whose filtering costs as much. It
    /// counts where parts of an image are left out.
    pub region_pixels: u32,
}

impl Schedule {
    /// Returns the schedule that suits the kind of adapter.
    pub fn for_gpu(gpu: &Gpu) -> Self {
        if gpu.is_software() { Self::SOFTWARE } else { Self::HARDWARE }
    }

    /// Schedule for a processor: intermediate results stay in registers, because loads are the main cost.
    pub const SOFTWARE: Self = Self {
        scratch_bytes: 4 << 20,
        block_rows: 64,
        offset_rows: 2,
        pixels: 4,
        band_columns: 256,
        region_pixels: 512,
    };

    /// Schedule for a graphics card: enough pixels at a time to fill it, and few registers per pixel. Not measured.
    pub const HARDWARE: Self = Self {
        scratch_bytes: 256 << 20,
        block_rows: 16,
        offset_rows: 1,
        pixels: 1,
        band_columns: 1 << 20,
        region_pixels: 1 << 16,
    };

    /// Returns the invocations of a filter over the pixels of a dispatch.
    pub(super) fn per_row_of_pixels(&self, params: &NlmParams) -> [u32; 3] {
        [(params.width as u32).div_ceil(self.pixels), params.rows as u32, 1]
    }

    /// Returns the definition of how many pixels an invocation of the filters computes at a time.
    pub(super) fn pixels_definition(&self) -> (&'static str, Definition) {
        ("PIXELS", Definition::Int(self.pixels as i32))
    }

    /// Returns the parts of an image to compute, and how the work on each part is cut.
    fn regions(
        &self,
        gpu: &Gpu,
        extent: IVec2,
        window_radius: i32,
        guide: &Guide,
        needs: ChunkNeeds,
    ) -> Vec<(Region, Cut)> {
        let regions = match guide.exact {
            Some(exact) => exact.regions(extent, REGION_CELL, guide.patch_radius as i32, self.region_pixels.into()),
            None => vec![Region { first: IVec2::ZERO, size: extent }],
        };
        let wanted = |region: Region| guide.wanted.map_or(Some(region), |wanted| region.overlap(&wanted));
        // The weights of a patchwise guide need the weights of f more columns on both sides, and the scratch of a band
        // has no distances for these columns.
        let most_columns = if guide.patchwise { i32::MAX } else { self.most_columns(gpu, guide, needs) };
        let bands = |region: Region| {
            let width = region.size.x.min(most_columns);
            (0..region.size.x).step_by(width as usize).map(move |x| Region {
                first: region.first + IVec2::new(x, 0),
                size: IVec2::new(width.min(region.size.x - x), region.size.y),
            })
        };
        regions
            .into_iter()
            .filter_map(wanted)
            .flat_map(bands)
            .map(|region| (region, self.cut(gpu, region.size, window_radius, guide, needs)))
            .collect()
    }

    /// Returns the width of the widest band, in columns, of which one row fits every buffer that is as wide as the
    /// band: the column sums of one offset and the running sums.
    fn most_columns(&self, gpu: &Gpu, guide: &Guide, needs: ChunkNeeds) -> i32 {
        let planes = u64::from(needs.sum_planes + needs.pair_values).max(guide.patch_sizes());
        let columns = gpu.max_binding_bytes() / (planes * PLANE_PIXEL_BYTES);
        // A scratch row is longer than the band.
        let columns = columns.saturating_sub(u64::from(self.pixels + 2 * guide.patch_radius)).max(1);
        i32::try_from(columns).unwrap_or(i32::MAX).min(self.band_columns as i32)
    }

    /// Cuts the work on an image of this extent, so that each buffer whose size follows from the cut fits the adapter's
    /// binding limit.
    fn cut(&self, gpu: &Gpu, extent: IVec2, window_radius: i32, guide: &Guide, needs: ChunkNeeds) -> Cut {
        let ChunkNeeds { sum_planes, pair_values, .. } = needs;
        let patch_radius = guide.patch_radius as i32;
        // The patchwise weights of a strip need the weights of f more rows above and below it.
        let margin = if guide.patchwise { patch_radius } else { 0 };
        // The last invocation of a row may reach beyond the row.
        let stride = (extent.x as u32).next_multiple_of(self.pixels) as i32 + 2 * patch_radius;
        let patch_sizes = guide.patch_sizes();
        let row_bytes = plane_bytes(IVec2::new(stride, 1), 1);
        // Values of the pairs share a buffer with the running sums: half of it for each.
        let most_bytes = gpu.max_binding_bytes() / patch_sizes.max(2 * u64::from(pair_values));
        let budget = (self.scratch_bytes.min(most_bytes) / row_bytes).max(1) as i32;
        // A row of offsets at a time, unless the image is so small that more fit: for each chunk the running sums are
        // loaded and stored once.
        let side = 2 * window_radius + 1;
        let rows = (budget / side - 2 * margin).clamp(1, extent.y);
        // With a small window, the column sums of a strip may fit where its running sums do not.
        let for_sums = if pair_values > 0 { gpu.max_binding_bytes() / 2 } else { gpu.max_binding_bytes() };
        let rows_of_sums = for_sums.checked_div(plane_bytes(IVec2::new(extent.x, 1), sum_planes));
        let rows = rows_of_sums.map_or(rows, |most| rows.min(i32::try_from(most).unwrap_or(i32::MAX)).max(1));
        let block = self.block_rows as i32;
        // Whole blocks, if at least one fits: a block that is cut short still computes its 2f extra rows.
        let rows = if rows < extent.y && rows > block { rows - rows % block } else { rows };
        let planes = (budget / (rows + 2 * margin)).max(1);
        let offset_rows = (planes / side).clamp(1, window_radius);
        let whole = self.offset_rows as i32;
        let offset_rows = if offset_rows > whole { offset_rows - offset_rows % whole } else { offset_rows };
        Cut {
            stride,
            margin,
            rows,
            offsets: IVec2::new(planes.min(side), offset_rows),
            patch_sizes: patch_sizes as u32,
        }
    }
}

/// Size of the cells that rectangles are made of, in pixels: as wide as a vector of invocations of some pixels each.
const REGION_CELL: IVec2 = IVec2::new(32, 16);

/// Sizes of the work of one dispatch.
struct Cut {
    /// Pixels of a scratch row.
    stride: i32,
    /// Rows of distances above and below a strip.
    margin: i32,
    /// Rows of a strip.
    rows: i32,
    /// Columns and rows of offsets in a chunk.
    offsets: IVec2,
    patch_sizes: u32,
}

impl Cut {
    fn scratch_bytes(&self, margin: i32) -> u64 {
        plane_bytes(IVec2::new(self.stride, self.rows + 2 * margin), (self.offsets.x * self.offsets.y) as u32)
    }

    /// Returns the half window as rectangles, in reading order: first offset, and number of columns and rows. The
    /// pixel's own row is separate, because it is half as long; in a frame beside it has one more neighbour, at the
    /// same position.
    fn rectangles(&self, window_radius: i32, in_other_frame: bool) -> Vec<(IVec2, IVec2)> {
        let mut rectangles = Vec::new();
        let mut add_rows = |first_x: i32, y: i32, rows: i32| {
            for x in (first_x..=window_radius).step_by(self.offsets.x as usize) {
                rectangles.push((IVec2::new(x, y), IVec2::new(self.offsets.x.min(window_radius + 1 - x), rows)));
            }
        };
        add_rows(if in_other_frame { 0 } else { 1 }, 0, 1);
        for y in (1..=window_radius).step_by(self.offsets.y as usize) {
            add_rows(-window_radius, y, self.offsets.y.min(window_radius + 1 - y));
        }
        rectangles
    }
}

/// Image whose patches are compared to weigh neighbours.
#[derive(Clone, Copy, Debug)]
pub struct Guide<'a> {
    /// Image of one or more planes, of which the first is compared; a signal serves.
    pub signal: &'a Buffer,
    /// Variance of the mean, one plane.
    pub variance_of_mean: &'a Buffer,
    /// Number of channels, 1 to 3.
    pub channels: u32,
    /// k_c: scale of differences in the distance (eq. 7.4), in standard deviations.
    pub k: f32,
    /// α: how much of the variance is cancelled from squared differences; 1 removes the amount that noise adds to them,
    /// a larger value also disregards larger differences.
    pub alpha: f32,
    /// f: patches are 2f+1 pixels wide.
    pub patch_radius: u32,
    /// Radius of a second, smaller patch whose sums are computed too.
    pub small_patch_radius: Option<u32>,
    /// Whether the weight of a neighbour is the mean of the weights of all pairs of pixels in the two patches (thesis
    /// 7.1.1), instead of the weight of their centres alone.
    pub patchwise: bool,
    /// Least weight that counts: smaller weights become 0, so that many faint neighbours do not outweigh a few good
    /// ones. 0 keeps all weights.
    pub cut: f32,
    /// Frames beside this one that also supply neighbours.
    pub beside: &'a [Beside<'a>],
    /// Whether all channels are equal, in the values and in the variance, in every frame.
    pub grey: bool,
    /// Tiles in which no pixel within the reach of the filter has noise, in any frame: pixels in them keep their
    /// values.
    pub exact: Option<&'a ExactTiles>,
    /// Pixels to compute; the values of other pixels are arbitrary. `None` computes all pixels.
    pub wanted: Option<Region>,
}

impl<'a> Guide<'a> {
    /// Makes a guide with plain patches of one size, in one frame: α is 1, every weight counts.
    pub fn new(signal: &'a Buffer, variance_of_mean: &'a Buffer, channels: u32, k: f32, patch_radius: u32) -> Self {
        Self {
            signal,
            variance_of_mean,
            channels,
            k,
            alpha: 1.0,
            patch_radius,
            small_patch_radius: None,
            patchwise: false,
            cut: 0.0,
            beside: &[],
            grey: false,
            exact: None,
            wanted: None,
        }
    }

    /// Returns the number of patch sizes whose sums are computed.
    fn patch_sizes(&self) -> u64 {
        if self.small_patch_radius.is_some() { 2 } else { 1 }
    }
}

/// Requirements of a filter on the chunks that it goes through.
#[derive(Clone, Copy)]
pub(super) struct ChunkNeeds {
    /// Whether to compute the column sums of the distances.
    pub(super) distances: bool,
    /// Planes of running sums that the filter keeps for the pixels of a strip; 0 where it keeps them for the whole
    /// image.
    pub(super) sum_planes: u32,
    /// Values of four numbers that the filter stores for each pixel and pair of offsets of a chunk, behind the sums.
    pub(super) pair_values: u32,
}

/// A frame beside the one that is filtered, whose pixels take part as neighbours (thesis 7.3, 8.6): the same window
/// around the same position, patches inside that frame. Pairs of opposite neighbours are formed within a frame.
#[derive(Clone, Copy, Debug)]
pub struct Beside<'a> {
    /// As [`Guide::signal`].
    pub signal: &'a Buffer,
    /// As [`Guide::variance_of_mean`].
    pub variance_of_mean: &'a Buffer,
}

/// One chunk of offsets over one strip of rows. The stage after `nlm_distance` gets the column sums of distances (of
/// weights, if the guide is patchwise) and these parameters.
pub(super) struct Chunk<'a> {
    pub(super) params: NlmParams,
    /// Column sums of the patches, and behind them of the smaller patches, if there are any; without distances the
    /// buffer holds nothing.
    pub(super) columns: &'a Buffer,
    /// Column sums of distances, also for a patchwise guide; then with f more rows above and below.
    pub(super) distances: &'a Buffer,
    /// Index of the frame beside that holds the neighbours; `None` for the frame itself.
    pub(super) beside: Option<usize>,
    /// Whether no offsets are left for these rows in this frame.
    pub(super) ends_frame: bool,
    /// Whether no offsets are left for these rows in this frame and in the frames after it.
    pub(super) last: bool,
    /// Share of all pixels that are done once this strip is complete, from 0 to 1.
    pub(super) done: f32,
    /// The most bytes that one value of four numbers takes for all pixels and pairs of offsets in a chunk of this
    /// strip.
    pub(super) most_pair_bytes: u64,
}

/// Runs `nlm_distance`, and for a patchwise guide `nlm_weight`, chunk by chunk, and hands each chunk to `consume`:
/// strips from top to bottom, all chunks of a strip before the next strip, the chunks of the frame itself first. A
/// filter without distances goes through the same chunks.
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub(super) fn for_each_chunk(
    rec: &mut Recorder,
    extent: IVec2,
    guide: &Guide,
    needs: ChunkNeeds,
    window_radius: u32,
    weighting: Weighting,
    schedule: Schedule,
    consume: impl FnMut(&mut Recorder, &Chunk) -> Result<()>,
) -> Result<()> {
    let regions = schedule.regions(rec.gpu(), extent, window_radius as i32, guide, needs);
    for_each_chunk_of(rec, extent, regions, guide, needs.distances, window_radius, weighting, schedule, consume)
}

/// Goes through the window of one pixel. The chunks are no larger than the weights of this pixel need, so that other
/// pixels cannot use them.
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub(super) fn for_each_chunk_around(
    rec: &mut Recorder,
    extent: IVec2,
    pixel: IVec2,
    guide: &Guide,
    with_distances: bool,
    window_radius: u32,
    weighting: Weighting,
    schedule: Schedule,
    consume: impl FnMut(&mut Recorder, &Chunk) -> Result<()>,
) -> Result<()> {
    // A patchwise weight is made of the weights of all pixels in its patch; the margin of the chunk supplies the rows
    // of the patch.
    let columns = if guide.patchwise { guide.patch_radius as i32 } else { 0 };
    let first = IVec2::new((pixel.x - columns).max(0), pixel.y);
    let region = Region { first, size: IVec2::new((pixel.x + columns + 1).min(extent.x) - first.x, 1) };
    let needs = ChunkNeeds { distances: with_distances, sum_planes: 0, pair_values: 0 };
    let cut = schedule.cut(rec.gpu(), region.size, window_radius as i32, guide, needs);
    for_each_chunk_of(
        rec,
        extent,
        vec![(region, cut)],
        guide,
        with_distances,
        window_radius,
        weighting,
        schedule,
        consume,
    )
}

#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
fn for_each_chunk_of(
    rec: &mut Recorder,
    extent: IVec2,
    regions: Vec<(Region, Cut)>,
    guide: &Guide,
    with_distances: bool,
    window_radius: u32,
    weighting: Weighting,
    schedule: Schedule,
    mut consume: impl FnMut(&mut Recorder, &Chunk) -> Result<()>,
) -> Result<()> {
    let radius = window_radius as i32;
    let patch_radius = guide.patch_radius as i32;
    let largest = |bytes: &dyn Fn(&Cut) -> u64| regions.iter().map(|(_, cut)| bytes(cut)).max().unwrap_or(0);
    let column_bytes =
        if with_distances { largest(&|cut| cut.scratch_bytes(cut.margin) * u64::from(cut.patch_sizes)) } else { 0 };
    let columns = rec.take("column sums of distances", column_bytes)?;
    let weight_columns = guide
        .patchwise
        .then(|| rec.take("column sums of weights", largest(&|cut| cut.scratch_bytes(0))))
        .transpose()?;
    let itself = Beside { signal: guide.signal, variance_of_mean: guide.variance_of_mean };
    let frames: Vec<_> = std::iter::once((None, itself))
        .chain(guide.beside.iter().enumerate().map(|(index, frame)| (Some(index), *frame)))
        .collect();
    let strips = regions
        .iter()
        .flat_map(|(region, cut)| (0..region.size.y).step_by(cut.rows as usize).map(move |row| (region, cut, row)));
    let all_pixels = regions.iter().map(|(region, _)| region.size.element_product()).sum::<i32>() as f32;
    let mut pixels_done = 0;
    for (region, cut, row) in strips {
        let (first_row, rows) = (region.first.y + row, cut.rows.min(region.size.y - row));
        let margin = cut.margin;
        pixels_done += region.size.x * rows;
        for (place, (beside, neighbours)) in frames.iter().enumerate() {
            let rectangles = cut.rectangles(radius, beside.is_some());
            for (index, (first_offset, offsets)) in rectangles.iter().copied().enumerate() {
                let ends_frame = index + 1 == rectangles.len();
                if rec.is_dry() && index > 0 && !ends_frame {
                    // A dry run needs no chunk between the first and the last: such a chunk takes no other buffers and
                    // reads no further around a pixel.
                    continue;
                }
                let last = ends_frame && place + 1 == frames.len();
                let params = NlmParams {
                    extent,
                    first_column: region.first.x,
                    width: region.size.x,
                    first_row,
                    rows,
                    first_offset,
                    offsets,
                    starts: i32::from(place == 0 && index == 0),
                    completes: i32::from(last),
                    stride: cut.stride,
                    block_rows: schedule.block_rows as i32,
                    k_squared: guide.k * guide.k,
                    alpha: guide.alpha,
                    inverse_channels: 1.0 / guide.channels as f32,
                    cut: guide.cut,
                    centre_floor: weighting.centre.floor(),
                };
                let blocks = |rows: i32| (rows as u32).div_ceil(schedule.block_rows);
                let with_margin = NlmParams { first_row: first_row - margin, rows: rows + 2 * margin, ..params };
                // An invocation computes several rows of offsets only if they divide the rows of the chunk evenly.
                let in_whole_rows = guide.small_patch_radius.is_none() && offsets.y % schedule.offset_rows as i32 == 0;
                let offset_rows = if in_whole_rows { schedule.offset_rows } else { 1 };
                let definitions = [
                    ("PATCH_RADIUS", Definition::Int(patch_radius)),
                    ("SMALL_PATCH_RADIUS", Definition::Int(guide.small_patch_radius.map_or(-1, |small| small as i32))),
                    ("OFFSET_ROWS", Definition::Int(offset_rows as i32)),
                    ("ONE_CHANNEL", (guide.channels == 1).into()),
                    ("GREY", guide.grey.into()),
                    // Only the existence of the distance to the mean matters here, not how the weights use it.
                    ("SYMMETRIC", (weighting.symmetric != Symmetry::Off).into()),
                ];
                let planes = (offsets.x * offsets.y) as u32;
                if with_distances {
                    // The stage reads a column of a patch at the pixel and one anywhere in the window; the filters then
                    // read the columns beside.
                    let bound = NlmDistance {
                        params: with_margin,
                        guide: guide.signal.within_columns_and_rows(0, guide.patch_radius).front(),
                        variance_of_mean: guide.variance_of_mean.within_columns_and_rows(0, guide.patch_radius),
                        neighbours: neighbours
                            .signal
                            .within_columns_and_rows(window_radius, window_radius + guide.patch_radius)
                            .front(),
                        neighbours_variance: neighbours
                            .variance_of_mean
                            .within_columns_and_rows(window_radius, window_radius + guide.patch_radius),
                        columns: &columns,
                    };
                    rec.dispatch(
                        "nlm_distance",
                        &definitions,
                        &bound,
                        [cut.stride as u32, blocks(with_margin.rows), planes / offset_rows],
                    )?;
                }
                if let Some(weight_columns) = &weight_columns {
                    let [symmetric, hard] = weighting.symmetric.definitions();
                    let definitions = [
                        ("PATCH_RADIUS", Definition::Int(patch_radius)),
                        schedule.pixels_definition(),
                        symmetric,
                        hard,
                    ];
                    let invocations = [(cut.stride as u32).div_ceil(schedule.pixels), blocks(rows), planes];
                    rec.dispatch(
                        "nlm_weight",
                        &definitions,
                        &NlmWeight { params, columns: columns.within(guide.patch_radius), weight_columns },
                        invocations,
                    )?;
                }
                consume(
                    rec,
                    &Chunk {
                        params,
                        columns: weight_columns.as_ref().unwrap_or(&columns),
                        distances: &columns,
                        beside: *beside,
                        ends_frame,
                        last,
                        done: pixels_done as f32 / all_pixels,
                        most_pair_bytes: cut.scratch_bytes(0),
                    },
                )?;
            }
        }
    }
    Ok(())
}

/// Images to average.
#[derive(Clone, Copy, Debug)]
pub struct Payload<'a> {
    /// Buffer of `count` planes.
    pub planes: &'a Buffer,
    /// Number of planes.
    pub count: u32,
    /// One such buffer for each frame beside the guide.
    pub beside: &'a [&'a Buffer],
    /// Components of each plane to average.
    pub lanes: Lanes,
}

/// Components that a plane holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lanes {
    /// Four numbers per pixel.
    All,
    /// One number, in x; the others are 0.
    First,
    /// Equal numbers in x, y and z; w becomes 0.
    Grey,
}

impl<'a> Payload<'a> {
    /// Makes a payload of one frame alone, with all components of its planes.
    pub fn new(planes: &'a Buffer, count: u32) -> Self {
        Self { planes, count, beside: &[], lanes: Lanes::All }
    }
}

/// A payload filtered with the weights of a guide.
#[derive(Debug)]
pub struct Filtered {
    /// Filtered planes, as many as the payload has.
    pub planes: Buffer,
    /// One plane, x: Σ w, including the weight of the centre.
    pub weights: Buffer,
    /// One plane, if requested: Σ w²·Var / (Σ w)², the variance left in the filtered guide if its pixels were
    /// independent and the weights fixed.
    pub residual_variance: Option<Buffer>,
}

/// Filters the payload over a window of 2·`window_radius`+1 pixels with NL-means weights from `guide` (eq. 7.1 to 7.6),
/// in its frame and in the frames beside it.
///
/// # Errors
/// As [`Recorder::take`] and [`Recorder::dispatch`].
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn nlm_filter(
    rec: &mut Recorder,
    extent: IVec2,
    guide: &Guide,
    payload: &Payload,
    window_radius: u32,
    weighting: Weighting,
    with_residual_variance: bool,
    schedule: Schedule,
) -> Result<Filtered> {
    let payloads = std::slice::from_ref(payload);
    let mut filtered =
        nlm_filter_all(rec, extent, guide, payloads, window_radius, weighting, with_residual_variance, schedule)?;
    Ok(filtered.swap_remove(0))
}

/// As [`nlm_filter`], for several payloads, at least one, whose distances are computed once. The first one may get a
/// residual variance.
///
/// # Errors
/// As [`nlm_filter`].
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
pub fn nlm_filter_all(
    rec: &mut Recorder,
    extent: IVec2,
    guide: &Guide,
    payloads: &[Payload],
    window_radius: u32,
    weighting: Weighting,
    with_residual_variance: bool,
    schedule: Schedule,
) -> Result<Vec<Filtered>> {
    let mut all = Vec::with_capacity(payloads.len());
    for (index, payload) in payloads.iter().enumerate() {
        let with_residual_variance = with_residual_variance && index == 0;
        all.push(Filtered {
            planes: rec.take("filtered planes", plane_bytes(extent, payload.count))?,
            weights: rec.take("weight sums", plane_bytes(extent, 1))?,
            residual_variance: with_residual_variance
                .then(|| rec.take("residual variance", plane_bytes(extent, 1)))
                .transpose()?,
        });
    }
    let [symmetric, hard] = weighting.symmetric.definitions();
    let needs = ChunkNeeds { distances: true, sum_planes: 0, pair_values: 0 };
    for_each_chunk(rec, extent, guide, needs, window_radius, weighting, schedule, |rec, chunk| {
        for (index, (payload, filtered)) in payloads.iter().zip(&all).enumerate() {
            let definitions = [
                ("PATCH_RADIUS", Definition::Int(guide.patch_radius as i32)),
                ("PAYLOAD_PLANES", Definition::Int(payload.count as i32)),
                ("ONE_LANE", (payload.lanes != Lanes::All).into()),
                ("GREY", (payload.lanes == Lanes::Grey).into()),
                schedule.pixels_definition(),
                ("PATCHWISE", guide.patchwise.into()),
                symmetric,
                hard,
                ("RESIDUAL", filtered.residual_variance.is_some().into()),
            ];
            let filter = |rec: &mut Recorder| {
                filter_chunk(rec, chunk, guide, payload, window_radius, schedule, &definitions, filtered)
            };
            if index == 0 { filter(rec)? } else { rec.in_step(PAYLOAD_STEP, filter)? }
        }
        Ok(())
    })?;
    if let Some(exact) = guide.exact {
        let tiles = exact.upload(rec, extent)?;
        for (payload, Filtered { planes, weights, residual_variance }) in payloads.iter().zip(&all) {
            tiles.copy(rec, payload.planes, planes, payload.count)?;
            tiles.fill(rec, weights, 1, true)?;
            residual_variance.iter().try_for_each(|variance| tiles.fill(rec, variance, 1, false))?;
        }
    }
    Ok(all)
}

/// Adds the pairs of a chunk to the sums of a payload.
#[expect(clippy::too_many_arguments, reason = "they are the operator's definition; a struct would only rename them")]
fn filter_chunk(
    rec: &mut Recorder,
    chunk: &Chunk,
    guide: &Guide,
    payload: &Payload,
    window_radius: u32,
    schedule: Schedule,
    definitions: &[(&str, Definition)],
    filtered: &Filtered,
) -> Result<()> {
    let (params, columns) = (chunk.params, chunk.columns.within_columns_and_rows(guide.patch_radius, 0));
    let invocations = schedule.per_row_of_pixels(&params);
    let Filtered { planes: filtered, weights, residual_variance } = filtered;
    let variance_of_mean = guide.variance_of_mean;
    let neighbours = chunk.beside.map_or(payload.planes, |index| payload.beside[index]).within(window_radius);
    let neighbours_variance = chunk.beside.map_or(variance_of_mean, |index| guide.beside[index].variance_of_mean);
    let neighbours_variance = neighbours_variance.within(window_radius);
    let payload = payload.planes;
    match residual_variance {
        None => rec.dispatch(
            "nlm_filter",
            definitions,
            &NlmFilter { params, columns, payload, neighbours, filtered, weights },
            invocations,
        ),
        Some(residual_variance) => {
            let bound = NlmFilterResidual {
                params,
                columns,
                payload,
                neighbours,
                filtered,
                weights,
                variance_of_mean,
                neighbours_variance,
                residual_variance,
            };
            rec.dispatch("nlm_filter", definitions, &bound, invocations)
        }
    }
}
