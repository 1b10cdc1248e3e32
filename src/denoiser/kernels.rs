//! The kernels at a pixel: computed on the device from a frame, and converted back to the units of the frame.

use std::sync::Arc;

use glam::{IVec2, Vec3};

use super::{Denoiser, Options, exposure};
use crate::error::{Error, RequestCause, Result};
use crate::frame::Frame;
use crate::gpu::{Buffer, Gpu, Run};
use crate::image::{Extent, Image, Window};
use crate::kernels::{Compared, Distance, FilterKernel, Kernels, PixelInFrame, WeightRule};
use crate::method::kernels::{KernelOnGpu, LimitOnGpu, WeightsOnGpu};
use crate::method::{FrameInput, Lane, Plan, Share, Strip, Units};
use crate::stage::PLANE_PIXEL_BYTES;
use crate::stage::exact::Region;
use crate::stage::frames::Frames;
use crate::stage::gaussian::Gaussian;
use crate::stage::nlm::CentreWeight;
use crate::stage::window::{CellLane, DistanceLanes};

impl Denoiser {
    /// Returns the kernels of the method's filters at the pixel in column `x` and row `y`: the weights of all
    /// neighbours in the window, and the distances behind the weights. They are read back from the device and equal
    /// those of a run with the same `options`. Works on no more of the frame than they depend on, and does not call
    /// [`Options::progress`].
    ///
    /// The frame is taken by itself: there are no kernels over a window in time.
    ///
    /// # Errors
    /// [`Error::Request`] where the frame has no such pixel; [`Error::Cancelled`] where [`Options::pace`] was
    /// cancelled; otherwise as [`Denoiser::plan`] and [`Denoiser::denoise`].
    pub fn kernels(&self, frame: &Frame, x: u32, y: u32, options: &Options) -> Result<Kernels> {
        let extent = frame.extent();
        if x >= extent.width || y >= extent.height {
            return Err(Error::Request(RequestCause::PixelOutside { x, y, extent }));
        }
        let plan = self.plan(&[frame], 0, options)?;
        if plan.copies_the_frame() {
            return Ok(Kernels { x, y, filters: Vec::new(), plan });
        }

        let pixel = IVec2::new(x as i32, y as i32);
        let reach = self.reach_of_kernels(frame, pixel, &plan)?;
        let Region { first, size } =
            Region::around(pixel, reach, IVec2::new(extent.width as i32, extent.height as i32));
        let part = Window { x: first.x, y: first.y, extent: Extent { width: size.x as u32, height: size.y as u32 } };
        let part_of_frame = frame.cropped(part);
        let units = Units::of_window(&Frames::one(&part_of_frame), &self.method, exposure(frame));
        let all_of_it = Strip::whole(part.extent);
        let mut rec = self.gpu.record_in(&Run::new(self.max_memory));
        if let Some(pace) = &options.pace {
            rec.set_pace(pace.clone());
        }
        let plan_of_part = plan.starting_at(first);
        // The mean variance is fixed for the whole frame, not for the part.
        let mean_variance = self.method.mean_variance(frame, units.exposure);
        let on_gpu =
            FrameInput::upload(&mut rec, &part_of_frame, mean_variance, &all_of_it, &units, 0..0, &plan_of_part)?;
        let kernels = self.method.kernels(&mut rec, on_gpu, pixel - first, &plan_of_part, self.schedule)?;
        rec.submit()?;

        let mut reader = Reader {
            gpu: &self.gpu,
            read: Vec::new(),
            part,
            at: PixelInFrame { x, y, extent },
            exposure: units.exposure,
        };
        let filters = kernels.iter().map(|kernel| reader.kernel(kernel)).collect::<Result<_>>()?;
        Ok(Kernels { x, y, filters, plan })
    }

    /// Returns how far the kernels at a pixel depend on the frame, in pixels, found by a dry run.
    fn reach_of_kernels(&self, frame: &Frame, pixel: IVec2, plan: &Plan) -> Result<u32> {
        let units = Units::of_window(&Frames::one(frame), &self.method, 1.0);
        let mut rec = self.gpu.record_in(&Run::dry(None));
        let whole = Strip::whole(frame.extent());
        let dry = FrameInput::upload(&mut rec, frame, Some(Vec3::ZERO), &whole, &units, 0..0, plan)?;
        let kernels = self.method.kernels(&mut rec, dry, pixel, plan, self.schedule)?;
        Ok(kernels.iter().map(|kernel| kernel.reach().max_element()).max().unwrap_or(0))
    }
}

/// Reads kernels back.
struct Reader<'a> {
    gpu: &'a Gpu,
    /// Buffers that were read, with their values: some filters of a method share buffers.
    read: Vec<(Arc<Buffer>, Arc<Vec<f32>>)>,
    /// Part of the frame that is on the device.
    part: Window,
    at: PixelInFrame,
    exposure: f32,
}

impl Reader<'_> {
    fn values(&mut self, buffer: &Arc<Buffer>) -> Result<Arc<Vec<f32>>> {
        if let Some((_, values)) = self.read.iter().find(|(read, _)| Arc::ptr_eq(read, buffer)) {
            return Ok(values.clone());
        }
        let values = Arc::new(self.gpu.read(buffer)?);
        self.read.push((buffer.clone(), values.clone()));
        Ok(values)
    }

    /// Returns the index of a pixel of the frame in a plane of the part, counted in values.
    fn place(&self, (x, y): (u32, u32)) -> usize {
        let (column, row) = (x as usize - self.part.x as usize, y as usize - self.part.y as usize);
        (row * self.part.extent.width as usize + column) * 4
    }

    /// Returns the value of a lane at the pixel.
    fn at_pixel(&mut self, Lane { buffer, plane, component }: &Lane) -> Result<f32> {
        let place =
            *plane as usize * self.part.extent.pixels() * 4 + self.place((self.at.x, self.at.y)) + *component as usize;
        Ok(self.values(buffer)?[place])
    }

    /// Returns whether the result at the pixel differs from the filtered value.
    fn is_refused(&mut self, LimitOnGpu { filtered, result, .. }: &LimitOnGpu) -> Result<bool> {
        for component in 0..3 {
            let of = |buffer: &Arc<Buffer>| Lane { buffer: buffer.clone(), plane: 0, component };
            if self.at_pixel(&of(filtered))? != self.at_pixel(&of(result))? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn kernel(&mut self, kernel: &KernelOnGpu) -> Result<FilterKernel> {
        let KernelOnGpu { name, share, averaged, weights } = kernel;
        let share = match share {
            Some(Share::Lane(lane)) => Some(self.at_pixel(lane)?),
            Some(Share::Whole) => Some(1.0),
            Some(Share::None) => Some(0.0),
            None => None,
        };
        let alone = |offset: IVec2| if offset == IVec2::ZERO { 1.0 } else { 0.0 };
        let (window_radius, rule, weights, distances) = match weights {
            WeightsOnGpu::Cells { cells, window_radius, weight, distances, rule, centre, limit } => {
                let window = WindowOfCells { cells: self.values(cells)?, radius: *window_radius, at: self.at };
                let (rule, weights) = match limit {
                    Some(limit) if self.is_refused(limit)? => {
                        (WeightRule::Refused { sigmas: limit.sigmas }, self.window(*window_radius, alone))
                    }
                    _ => (*rule, window.weights(*weight, *centre)),
                };
                (*window_radius, rule, weights, window.distances(distances))
            }
            WeightsOnGpu::Gaussian(lane) => {
                let sigma = self.at_pixel(lane)?;
                let gaussian = Gaussian::new(sigma);
                (
                    gaussian.radius,
                    WeightRule::Gaussian { sigma },
                    self.window(gaussian.radius, |offset| gaussian.weight(offset)),
                    Vec::new(),
                )
            }
            WeightsOnGpu::Exact { window_radius } => {
                (*window_radius, WeightRule::Exact, self.window(*window_radius, alone), Vec::new())
            }
        };

        let averaged = self.values(averaged)?;
        let mut colors = Image::filled(weights.extent, 3, 0.0);
        let (mut weight_sum, mut sums) = (0.0, [0.0; 3]);
        let centre = self.place((self.at.x, self.at.y));
        for (cell, weight) in weights.planes[0].iter().enumerate() {
            let Some(pixel) = self.at.neighbour(cell, window_radius) else { continue };
            let at = self.place(pixel);
            weight_sum += f64::from(*weight);
            for (channel, sum) in sums.iter_mut().enumerate() {
                let value = averaged[at + channel];
                colors.planes[channel][cell] = value / self.exposure;
                *sum += f64::from(*weight) * (f64::from(value) - f64::from(averaged[centre + channel]));
            }
        }
        let value = std::array::from_fn(|channel| {
            (f64::from(averaged[centre + channel]) + sums[channel] / weight_sum) as f32 / self.exposure
        });
        Ok(FilterKernel {
            name,
            window_radius,
            weights,
            weight_sum: weight_sum as f32,
            colors,
            value,
            share,
            rule,
            distances,
            at: self.at,
        })
    }

    /// Returns weights that are functions of the offset.
    fn window(&self, radius: u32, weight: impl Fn(IVec2) -> f32) -> Image {
        window(radius, |cell| {
            let exists = self.at.neighbour(cell, radius).is_some();
            let (column, row) = (cell as i32 % (2 * radius as i32 + 1), cell as i32 / (2 * radius as i32 + 1));
            if exists { weight(IVec2::new(column, row) - radius as i32) } else { 0.0 }
        })
    }
}

/// Makes an image of one window, with one plane.
fn window(radius: u32, value: impl Fn(usize) -> f32) -> Image {
    let side = 2 * radius + 1;
    let extent = Extent { width: side, height: side };
    Image { extent, planes: vec![(0..extent.pixels()).map(value).collect()] }
}

/// Cells of a window, as a stage wrote them.
struct WindowOfCells {
    cells: Arc<Vec<f32>>,
    radius: u32,
    at: PixelInFrame,
}

impl WindowOfCells {
    /// Returns a lane of the cells, with other values for the middle and for the cells outside of the frame.
    fn lane(&self, lane: CellLane, middle: f32, outside: f32) -> Image {
        let side = 2 * self.radius as usize + 1;
        let first = lane.plane as usize * side * side;
        window(self.radius, |cell| match self.at.neighbour(cell, self.radius) {
            None => outside,
            Some(_) if cell == side * side / 2 => middle,
            Some(_) => self.cells[(first + cell) * (PLANE_PIXEL_BYTES as usize / 4) + lane.component as usize],
        })
    }

    fn weights(&self, lane: CellLane, centre: CentreWeight) -> Image {
        let mut weights = self.lane(lane, 0.0, 0.0);
        let plane = &mut weights.planes[0];
        let middle = plane.len() / 2;
        plane[middle] = centre.weight(plane.iter().copied().fold(0.0, f32::max));
        weights
    }

    fn distances(&self, distances: &[(Compared, DistanceLanes)]) -> Vec<Distance> {
        let distance = |(of, lanes): &(Compared, DistanceLanes)| Distance {
            of: of.clone(),
            distances: self.lane(lanes.distance, 0.0, f32::INFINITY),
            weights: self.lane(lanes.weight, 1.0, 0.0),
        };
        distances.iter().map(distance).collect()
    }
}
