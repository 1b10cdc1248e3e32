//! The denoiser: frames in, estimates out.

mod kernels;

use std::ops::{ControlFlow, Range};
use std::time::Instant;

use glam::{IVec2, Vec3};

use crate::error::{Error, RequestCause, Result};
use crate::frame::{Feature, Frame, NoiseKnowledge, PayloadKind, PayloadLayer};
use crate::gpu::{Buffer, Gpu, Pace, Recorder, Run, StageTime, StepTime, sum_over_steps};
use crate::host_memory::{FreeMemory, Shortage};
use crate::image::Image;
use crate::method::{
    DeviceMemory, Facts, Footprint, FrameInput, GpuEstimate, GpuFrame, Intermediate, KeptPlane, Lane, Method,
    PayloadLeft, PayloadPlace, Plan, Share, SpikeReport, Strip, Unit, Units, Wishes, strips,
};
use crate::stage::PLANE_PIXEL_BYTES;
use crate::stage::frames::Frames;
use crate::stage::nlm::Schedule;

/// Denoises frames with one method and one set of parameters. Make one and use it for many frames: kernels and buffers
/// are kept by the [`Gpu`].
///
/// ```no_run
/// use stein::{Denoiser, Gpu, Method, gpu::DeviceChoice};
/// use stein_exr::{BufferSet, BufferSetRequest};
///
/// # fn main() -> stein::error::Result<()> {
/// let gpu = Gpu::open(&DeviceChoice::Auto)?;
/// let denoiser = Denoiser::new(&gpu, Method::default())?;
/// let set = BufferSet::read(&BufferSetRequest { input: "noisy.exr".into(), ..Default::default() })?;
/// let (frame, repairs) = set.to_frame()?;
/// println!("{repairs}");
/// let estimate = denoiser.denoise(&frame)?;
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct Denoiser {
    gpu: Gpu,
    method: Method,
    schedule: Schedule,
    max_memory: Option<u64>,
    everything: bool,
}

/// Results to compute besides the colour, and reports of progress.
pub struct Options<'a> {
    /// Intermediates to read back as [`Estimate::layers`].
    pub keep: &'a [Intermediate],
    /// Whether to estimate the error; the default is `true`. Without it, [`Estimate::error`] is `None`, and the steps
    /// that serve the error alone are left out.
    pub error: bool,
    /// Called with the share of the work that is done, 0 to 1; `Break` ends it with [`Error::Cancelled`].
    pub progress: Option<&'a mut dyn FnMut(f32) -> ControlFlow<()>>,
    /// Pace of the work on a device that also shows a window. `None` keeps the device as busy as possible.
    pub pace: Option<Pace>,
}

impl Default for Options<'_> {
    fn default() -> Self {
        Self { keep: &[], error: true, progress: None, pace: None }
    }
}

/// An estimate of the true image.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The denoised colour, in the units of the frame.
    pub color: Image,
    /// Half spread of the denoised colour: its filtered halves are `color ± half_spread`. `None` without halves.
    pub half_spread: Option<Image>,
    /// One plane: the estimated squared error of each pixel, summed over the channels, at least 0. `None` where
    /// [`Options::error`] is off.
    ///
    /// DFC adds up four parts: the squared half spread of the result, the distances of its candidates from it, the
    /// pixel's own noise that is left ([`error_blend`](crate::stage::error::error_blend)), and the amounts that the
    /// pixel got from spikes ([`error_spikes`](crate::stage::error::error_spikes)). The sum is mostly right within a
    /// factor of two on regions of 16×16 pixels. NLM estimates the variance left in the result from its halves (thesis
    /// 7.1.2), smoothed, and ignores bias. GEM adds the variance of the chosen scale and the estimated bias of the
    /// steps that led to it (thesis 6.3).
    pub error: Option<Image>,
    /// One plane: the number of pixels that took part in each average. DFC: Σ w over the window, blended like the
    /// candidates (thesis 8.6). NLM: Σ w, the mean of both halves. GEM: 1/Σw² of the normalised weights of the chosen
    /// scale. 1 for a frame that was copied.
    pub weight_sum: Image,
    /// Shares of the candidates in each pixel, one plane for each of [`Estimate::candidates`]; `None` where the method
    /// has no candidates or the frame was copied.
    pub selection: Option<Image>,
    /// Names of the candidates, in the order of [`Estimate::selection`]; empty without a selection.
    pub candidates: Vec<&'static str>,
    /// Names of the features that were used. In a window in time, all frames have these features.
    pub features: Vec<String>,
    /// Report on the spikes that were found; `None` where the method did not look for spikes.
    pub spikes: Option<SpikeReport>,
    /// The payload layers of the frame, filtered along with the colour, in the order of
    /// [`Frame::payload`](crate::frame::Frame::payload).
    pub payload: Vec<DenoisedLayer>,
    /// The intermediates that [`Options::keep`] lists.
    pub layers: Vec<Layer>,
    /// The steps that ran, and those that were left out.
    pub plan: Plan,
    /// Number of strips that the image was cut into.
    pub strips: usize,
    /// GPU time per stage; `None` where [`Gpu::set_timing`] is off or the adapter has no timestamps.
    pub stage_times: Option<Vec<StageTime>>,
    /// GPU time per stage and step of the plan; `None` as in [`Estimate::stage_times`].
    pub step_times: Option<Vec<StepTime>>,
    /// The most memory that buffers took on the device, in bytes.
    pub peak_bytes: u64,
}

/// A payload layer that was filtered along with the colour.
#[derive(Clone, Debug)]
pub struct DenoisedLayer {
    /// Name of the layer.
    pub name: String,
    /// The denoised layer, in the units of the frame, with the planes that the layer had.
    pub image: Image,
    /// Reason why the layer is as it was; `None` for a layer that was filtered.
    pub left: Option<PayloadLeft>,
}

/// Memory that the work on a frame takes, and reach of its results. Found by a dry run of the method, which records the
/// same work without memory and commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Requirements {
    /// The most memory that buffers take on the device, in bytes: [`Estimate::peak_bytes`] on a device that holds no
    /// other idle buffers.
    pub peak_bytes: u64,
    /// Rows above and below a pixel that its results depend on. Ignores what is fixed for the whole frame: exposure and
    /// plan.
    pub halo: u32,
    /// Number of strips that the image is cut into.
    pub strips: usize,
}

/// An intermediate, in the units of the frame.
#[derive(Clone, Debug)]
pub struct Layer {
    /// The intermediate that the layer is part of.
    pub intermediate: Intermediate,
    /// Name of the layer.
    pub name: String,
    /// Names of the planes.
    pub channels: Vec<String>,
    /// Values of the layer, one plane per channel.
    pub image: Image,
}

impl Denoiser {
    /// Makes a denoiser that works on this device.
    ///
    /// # Errors
    /// [`Error::Request`] where a parameter is out of range.
    pub fn new(gpu: &Gpu, method: impl Into<Method>) -> Result<Self> {
        let method = method.into();
        method.validate()?;
        Ok(Self { gpu: gpu.clone(), method, schedule: Schedule::for_gpu(gpu), max_memory: None, everything: false })
    }

    /// Limits the buffers on the device to `bytes`. An image that would take more is processed in strips of rows. The
    /// result is the same to the bit.
    #[must_use]
    pub fn with_max_memory(mut self, bytes: u64) -> Self {
        self.max_memory = Some(bytes);
        // There are two scratch buffers. Where the window is smallest, running sums take up to four times the size of
        // one of them. All together take at most half of the limit.
        self.schedule.scratch_bytes = self.schedule.scratch_bytes.min(bytes / 12);
        self
    }

    /// Divides the work in another way than the one that suits the kind of the adapter. The result is the same to the
    /// bit.
    #[must_use]
    pub fn with_schedule(mut self, schedule: Schedule) -> Self {
        self.schedule = schedule;
        self
    }

    /// Also runs the steps that a frame does not need, for comparison. The result is the same to the bit, or within the
    /// bounds that the plan of the method states.
    #[must_use]
    pub fn with_everything(mut self) -> Self {
        self.everything = true;
        self
    }

    /// Returns the device.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Returns the method and its parameters.
    pub fn method(&self) -> &Method {
        &self.method
    }

    /// Returns the denoiser with the parameters for frames whose samples are still being drawn.
    #[must_use]
    pub fn while_sampling(&self) -> Self {
        Self { method: self.method.while_sampling(), ..self.clone() }
    }

    /// Returns the plan for `frames[centre]` in its window: the steps that would run, the steps that would be left out,
    /// and why.
    ///
    /// # Errors
    /// As [`Denoiser::denoise_window`]; [`Error::Device`] where not even one row fits into the memory.
    pub fn plan(&self, frames: &[&Frame], centre: usize, options: &Options) -> Result<Plan> {
        let window = self.checked_window(frames, centre)?;
        let units = Units::of_window(&window, &self.method, 1.0);
        self.plan_in(&window, &units, options).map(|(plan, _)| plan)
    }

    fn plan_in(&self, window: &Frames<&Frame>, units: &Units, options: &Options) -> Result<(Plan, Cut)> {
        let start = Instant::now();
        let facts = Facts::of_window(window, units, self.method.uses_features());
        let wishes = Wishes { keep: options.keep, error: options.error, everything: self.everything };
        let plan = self.method.plan(&facts, &wishes);
        let analysis_seconds = start.elapsed().as_secs_f64();
        let cut = self.cut(window, units, &plan, options)?;
        Ok((Plan { strips: cut.strips.len(), rounds: cut.rounds, analysis_seconds, ..plan }, cut))
    }

    /// Cuts the frame into strips whose buffers fit. Layers that are filtered along may be too many for strips of
    /// reasonable height. Then they are distributed over several rounds, each of which filters the colour anew.
    fn cut(&self, window: &Frames<&Frame>, units: &Units, plan: &Plan, options: &Options) -> Result<Cut> {
        let mut best = self.cut_for(window, units, plan, options, 1);
        let mut tried = 1;
        loop {
            let rounds = (2 * tried).min(units.payload.groups());
            // One strip is all that more rounds could achieve.
            if rounds <= tried || best.as_ref().is_ok_and(|cut| cut.strips.len() == 1) {
                return best;
            }
            tried = rounds;
            let other = self.cut_for(window, units, plan, options, rounds);
            let rows = |cut: &Cut| cut.rounds * cut.strips.iter().map(Strip::rows_with_halo).sum::<usize>();
            let is_better = match (&best, &other) {
                (Ok(best), Ok(other)) => rows(other) < rows(best),
                (Err(_), Ok(_)) => true,
                (_, Err(_)) => false,
            };
            if is_better {
                best = other;
            }
        }
    }

    /// Cuts the frame into strips whose buffers fit with the layers of one round of at most so many.
    fn cut_for(
        &self,
        window: &Frames<&Frame>,
        units: &Units,
        plan: &Plan,
        options: &Options,
        most_rounds: usize,
    ) -> Result<Cut> {
        let extent = window.own.extent();
        let groups = units.payload.groups().div_ceil(most_rounds);
        let rounds = units.payload.groups().div_ceil(groups.max(1)).max(1);
        let dry_run = |limit, strips: &[Strip]| self.dry_run(window, units, groups, plan, limit, strips);
        let whole = dry_run(self.max_memory, &[Strip::whole(extent)])?;
        let memory = self.memory(window.own, whole.kept_planes, options)?;
        let limit = memory.bytes();
        let (strips, footprint) = strips(&self.gpu, extent, memory, whole, |strips| dry_run(limit, strips))?;
        Ok(Cut { strips, footprint, limit, rounds, groups })
    }

    /// Runs the method dry on these strips, one after the other, with this many groups of layers.
    fn dry_run(
        &self,
        window: &Frames<&Frame>,
        units: &Units,
        groups: usize,
        plan: &Plan,
        memory_limit: Option<u64>,
        strips: &[Strip],
    ) -> Result<Footprint> {
        let run = Run::dry(memory_limit);
        let mut footprint = Footprint { halo: 0, peak_bytes: 0, largest_bytes: 0, kept_planes: 0 };
        // Nothing runs for a frame that is copied.
        for strip in strips.iter().filter(|_| !plan.copies_the_frame()) {
            let mut rec = self.gpu.record_in(&run);
            let upload = |frame| FrameInput::upload(&mut rec, frame, Some(Vec3::ZERO), strip, units, 0..groups, plan);
            let inputs = window.clone().try_map(upload)?;
            let plan = plan.starting_at(IVec2::new(0, strip.first_with_halo as i32));
            let estimate = self.method.record(&mut rec, inputs, &plan, self.schedule, |_, _| Ok(()))?;
            footprint.halo = footprint.halo.max(estimate.reach().y);
            footprint.kept_planes = estimate.kept.iter().map(|kept| kept.channels.len() as u64).sum();
        }
        Ok(Footprint { peak_bytes: run.peak_bytes(), largest_bytes: run.largest_bytes(), ..footprint })
    }

    /// Returns the limits on the buffers of the device, after the host has its share of the memory.
    fn memory(&self, frame: &Frame, kept_planes: u64, options: &Options) -> Result<DeviceMemory> {
        // Colour, halves, error, sum of weights, and the shares of the candidates where the method has any.
        let planes_of_shares = match &self.method {
            Method::Dfc(params) => params.filters().len() as u64,
            Method::Gem(_) | Method::Nlm(_) => 0,
        };
        let planes_of_halves = if frame.color().half_spread.is_some() { 3 } else { 0 };
        let planes_of_payload = frame.payload().iter().map(|layer| layer.mean.channels() as u64).sum::<u64>();
        let planes_of_result =
            3 + planes_of_halves + u64::from(options.error) + 1 + planes_of_shares + planes_of_payload;
        let host = frame.extent().pixels() as u64 * 4 * (planes_of_result + kept_planes)
            + TRANSFER_BYTES.min(frame.extent().pixels() as u64 * 64);
        let free = FreeMemory::now();
        free.check(host).map_err(|shortage| shortage.error(&format!("the result of {} pixels", frame.extent())))?;
        Ok(DeviceMemory { asked: self.max_memory, shared: self.gpu.is_software().then_some((free, host)) })
    }

    /// Returns the memory that the work on `frames[centre]` in its window takes on the device, and how far its results
    /// depend on the frame, without doing it.
    ///
    /// # Errors
    /// As [`Denoiser::plan`].
    pub fn requirements(&self, frames: &[&Frame], centre: usize, options: &Options) -> Result<Requirements> {
        let window = self.checked_window(frames, centre)?;
        let units = Units::of_window(&window, &self.method, 1.0);
        let (_, Cut { strips, footprint, .. }) = self.plan_in(&window, &units, options)?;
        let Footprint { halo, peak_bytes, .. } = footprint;
        Ok(Requirements { peak_bytes, halo, strips: strips.len() })
    }

    /// Returns how far the influence of a pixel reaches, in pixels along either axis, for any frame and any requested
    /// results. Ignores what is fixed for the whole frame: exposure and plan.
    ///
    /// # Errors
    /// Errors of the recorder.
    pub fn reach(&self) -> Result<u32> {
        self.method.reach(&self.gpu, self.schedule)
    }

    /// Denoises a frame.
    ///
    /// # Errors
    /// [`Error::Device`] where the device is lost or has too little memory.
    pub fn denoise(&self, frame: &Frame) -> Result<Estimate> {
        self.denoise_with(frame, Options::default())
    }

    /// Denoises a frame, keeping intermediates and reporting progress.
    ///
    /// # Errors
    /// As [`Denoiser::denoise`], and [`Error::Cancelled`].
    pub fn denoise_with(&self, frame: &Frame, options: Options) -> Result<Estimate> {
        self.denoise_window(&[frame], 0, options)
    }

    /// Denoises `frames[centre]` with the help of the frames beside it. The frames are consecutive frames of a shot, in
    /// temporal order; the window of a pixel covers the same region in each of them (thesis 7.3, 8.6). Features that
    /// one of the frames lacks are not used.
    ///
    /// # Errors
    /// As [`Denoiser::denoise_with`], and [`Error::Request`] where the method does not filter over time, or where a
    /// frame has another extent or kind of noise than the others.
    pub fn denoise_window(&self, frames: &[&Frame], centre: usize, options: Options) -> Result<Estimate> {
        let window = self.checked_window(frames, centre)?;
        let frame = window.own;
        let units = Units::of_window(&window, &self.method, exposure(frame));
        let with_mean_variance = window.clone().map(|frame| (frame, self.method.mean_variance(frame, units.exposure)));
        // Idle buffers of an earlier frame of another size would count against the limit.
        self.gpu.trim();
        let (plan, Cut { strips, limit, rounds, groups, .. }) = self.plan_in(&window, &units, &options)?;
        let Options { error, mut progress, pace, .. } = options;
        let run = Run::new(limit);
        let out_of_memory = |shortage: Shortage| shortage.error("the result");
        let mut assembly = Assembly::new(frame, &units, error).map_err(out_of_memory)?;
        if plan.copies_the_frame() {
            assembly.copy();
            return Ok(assembly.finish(plan, None, 0));
        }
        // Rounds after the first only filter further layers.
        let of_further_rounds = (rounds > 1).then(|| {
            let facts = Facts::of_window(&window, &units, self.method.uses_features());
            self.method.plan(&facts, &Wishes { keep: &[], error: false, everything: self.everything })
        });
        let parts = (0..rounds).flat_map(|round| strips.iter().map(move |strip| (round, strip)));
        for (index, (round, strip)) in parts.enumerate() {
            let groups =
                (round * groups).min(units.payload.groups())..((round + 1) * groups).min(units.payload.groups());
            let plan = of_further_rounds.as_ref().filter(|_| round > 0).unwrap_or(&plan);
            let mut rec = self.gpu.record_in(&run);
            if let Some(pace) = &pace {
                rec.set_pace(pace.clone());
            }
            let plan = plan.starting_at(IVec2::new(0, strip.first_with_halo as i32));
            let upload = |(frame, mean_variance)| {
                FrameInput::upload(&mut rec, frame, mean_variance, strip, &units, groups.clone(), &plan)
            };
            let on_gpu = with_mean_variance.clone().try_map(upload)?;
            let extent = on_gpu.own.extent;
            let report = |rec: &mut Recorder, share: f32| match &mut progress {
                None => Ok(()),
                Some(progress) => {
                    // Work is reported as done only after the device has done it.
                    rec.flush()?;
                    rec.gpu().wait()?;
                    let done = (index as f32 + share) / (rounds * strips.len()) as f32;
                    if progress(done).is_break() { Err(Error::Cancelled) } else { Ok(()) }
                }
            };
            let estimate = self.method.record(&mut rec, on_gpu, &plan, self.schedule, report)?;
            rec.submit()?;
            if round == 0 {
                assembly.add(&self.gpu, &estimate, extent, strip)?;
            }
            assembly.add_payload(&self.gpu, &estimate, groups, extent, strip)?;
        }
        let step_times = self.gpu.step_timings(&run)?;
        Ok(assembly.finish(plan, step_times, run.peak_bytes()))
    }

    /// The window around `frames[centre]`, if its frames go together.
    fn checked_window<'a>(&self, frames: &[&'a Frame], centre: usize) -> Result<Frames<&'a Frame>> {
        let Some(&frame) = frames.get(centre) else {
            return Err(Error::Request(RequestCause::NoSuchFrame { centre, frames: frames.len() }));
        };
        self.method.check_beside(frames.len() - 1)?;
        self.method.check_noise_is_known(frame.noise_knowledge() == NoiseKnowledge::ImageOnly)?;
        let knows = |frame: &Frame| (frame.color().half_spread.is_some(), frame.color().variance_of_mean.is_some());
        for (index, other) in frames.iter().enumerate() {
            let (extent, expected) = (other.extent(), frame.extent());
            if extent != expected {
                return Err(Error::Request(RequestCause::FrameExtent { index, extent, expected }));
            }
            if knows(other) != knows(frame) {
                return Err(Error::Request(RequestCause::FrameNoise { index }));
            }
        }
        let beside = frames.iter().enumerate().filter(|(index, _)| *index != centre).map(|(_, frame)| *frame);
        Ok(Frames { own: frame, beside: beside.collect() })
    }

    /// Records the work on a frame that is on the GPU already. `beside` holds the other frames of its window in time:
    /// they have the units, extent and features of the frame, and halves if it has halves. Reads nothing back.
    ///
    /// For a renderer that embeds the denoiser: record with [`Gpu::record_whole`], then put the commands into an
    /// encoder with [`Recorder::encode_into`]. The frame must fit the binding limit as a whole.
    ///
    /// # Errors
    /// [`Error::Device`] where a buffer exceeds the device's limits; [`Error::Request`] where a frame in `beside` does
    /// not match, where the method does not filter over time, or where it needs a [`GpuFrame::mean_variance`] that is
    /// not given.
    pub fn record(&self, rec: &mut Recorder, frame: GpuFrame, beside: Vec<GpuFrame>) -> Result<GpuEstimate> {
        let wishes = Wishes { keep: &[], error: true, everything: self.everything };
        let plan = self.method.plan(&Facts::of_gpu_frame(&frame, beside.len(), self.method.uses_features()), &wishes);
        let frames = Frames { own: frame, beside }.map(FrameInput::from);
        self.method.record(rec, frames, &plan, self.schedule, |_, _| Ok(()))
    }
}

/// Strips of a frame, what they take on the device, and the bytes that buffers may take there.
struct Cut {
    strips: Vec<Strip>,
    footprint: Footprint,
    limit: Option<u64>,
    /// Number of rounds over the strips, each with other layers.
    rounds: usize,
    /// The most groups of layers in a round.
    groups: usize,
}

/// Largest number of bytes in transfer between host and device at one time, and in copies of them on the host.
const TRANSFER_BYTES: u64 = 96 << 20;

/// Largest value after scaling: squares of scaled values are summed over channels and patches in f32.
const LARGEST_SCALED: f32 = 1e17;

/// Returns a power of two that scales the colour to the order of 1, for which the small constants of the methods are
/// made. A power of two changes no digit. The scale follows from the median of the pixels' largest channels, over
/// pixels that are not black.
fn exposure(frame: &Frame) -> f32 {
    let planes = &frame.color().mean.planes;
    // Only the exponent of the median counts, so a histogram of exponents replaces sorting a copy of the pixels.
    let mut pixels_by_exponent = [0_usize; 256];
    let mut brightest = 0.0_f32;
    for pixel in 0..frame.extent().pixels() {
        let brightness = planes.iter().fold(0.0f32, |most, plane| most.max(plane[pixel].abs()));
        if brightness > f32::MIN_POSITIVE {
            pixels_by_exponent[(brightness.to_bits() >> 23) as usize] += 1;
            brightest = brightest.max(brightness);
        }
    }
    let middle = pixels_by_exponent.iter().sum::<usize>() / 2;
    let mut pixels_below = 0;
    let exponent_of_median = pixels_by_exponent.iter().position(|count| {
        pixels_below += count;
        pixels_below > middle
    });
    let Some(exponent_of_median) = exponent_of_median else { return 1.0 };
    let log2_of_median = exponent_of_median as f32 - 127.0;
    // The square of a scaled value must stay finite.
    let color = frame.color();
    let deviations =
        color.variance_of_mean.iter().flat_map(|variance| &variance.planes).flatten().map(|variance| variance.sqrt());
    let spreads = color.half_spread.iter().flat_map(|spread| &spread.planes).flatten().map(|spread| spread.abs());
    let most = deviations.chain(spreads).fold(brightest, f32::max);
    let headroom = (LARGEST_SCALED / most).log2().floor();
    (-log2_of_median).clamp(-60.0, 60.0).min(headroom).exp2()
}

/// Puts the strips together on the host, in the units of the frame.
struct Assembly<'a> {
    frame: &'a Frame,
    exposure: f32,
    features: &'a [&'a Feature],
    color: Image,
    /// `None` where the frame has no halves.
    half_spread: Option<Image>,
    selection: Option<Image>,
    candidates: Vec<&'static str>,
    error: Option<Image>,
    weight_sum: Image,
    spikes: Option<FoundSpikes>,
    /// Layers of the frame's payload, with their places on the device.
    payload: Vec<(DenoisedLayer, Option<PayloadPlace>)>,
    layers: Vec<Layer>,
}

/// Spikes found in the strips so far, in the units of the device.
#[derive(Default)]
struct FoundSpikes {
    pixels: usize,
    taken: f64,
    spread: f64,
}

impl<'a> Assembly<'a> {
    fn new(frame: &'a Frame, units: &'a Units, with_error: bool) -> std::result::Result<Self, Shortage> {
        let image = |channels| Image::try_filled(frame.extent(), channels, 0.0);
        let denoised = |(layer, place): &(&PayloadLayer, _)| {
            let image = match place {
                Ok(_) => image(layer.mean.channels())?,
                Err(_) => layer.mean.clone(),
            };
            Ok((DenoisedLayer { name: layer.name.clone(), image, left: place.err() }, place.ok()))
        };
        let payload = units.payload.layers.iter().map(denoised).collect::<std::result::Result<_, _>>()?;
        Ok(Self {
            frame,
            exposure: units.exposure,
            features: &units.features,
            color: image(3)?,
            half_spread: frame.color().half_spread.is_some().then(|| image(3)).transpose()?,
            selection: None,
            candidates: Vec::new(),
            error: with_error.then(|| image(1)).transpose()?,
            weight_sum: image(1)?,
            spikes: None,
            payload,
            layers: Vec::new(),
        })
    }

    /// Takes the frame itself as the result.
    fn copy(&mut self) {
        let color = self.frame.color();
        let copies = [(&mut self.color, Some(&color.mean))]
            .into_iter()
            .chain(self.half_spread.as_mut().map(|spread| (spread, color.half_spread.as_ref())));
        for (copy, image) in copies {
            let planes = copy.planes.iter_mut().zip(image.iter().flat_map(|image| &image.planes));
            planes.for_each(|(copy, plane)| copy.copy_from_slice(plane));
        }
        self.weight_sum.planes[0].fill(1.0);
        for ((denoised, _), layer) in self.payload.iter_mut().zip(self.frame.payload()) {
            denoised.image.clone_from(&layer.mean);
            denoised.left.get_or_insert(PayloadLeft::NoNoise);
        }
    }

    /// Adds the layers of these groups, which are the groups of the estimate.
    fn add_payload(
        &mut self,
        gpu: &Gpu,
        estimate: &GpuEstimate,
        groups: Range<usize>,
        extent: IVec2,
        strip: &Strip,
    ) -> Result<()> {
        let rows = Rows { gpu, extent, strip };
        for (layer, place) in &mut self.payload {
            let Some((place, (group, plane))) = place.map(|place| (place, place.in_group())) else { continue };
            if groups.contains(&group) {
                let buffer = &estimate.payload[group - groups.start].buffer;
                rows.place(buffer, plane, place.lane as u32, (1.0, 0.0), &mut layer.image)?;
            }
        }
        Ok(())
    }

    fn add(&mut self, gpu: &Gpu, estimate: &GpuEstimate, extent: IVec2, strip: &Strip) -> Result<()> {
        let frame_extent = self.frame.extent();
        let width = frame_extent.width as usize;
        let rows = Rows { gpu, extent, strip };
        if let Some(spikes) = &estimate.spikes {
            let found = self.spikes.get_or_insert_default();
            rows.read(spikes, 0, &mut |_, values| {
                for pixel in values.chunks_exact(4).filter(|pixel| pixel[..3] != [0.0; 3]) {
                    let taken: f64 = pixel[..3].iter().map(|value| f64::from(*value)).sum();
                    found.pixels += 1;
                    found.taken += taken;
                    found.spread += taken * f64::from(pixel[3]);
                }
            })?;
        }
        let out_of_memory = |shortage: Shortage| shortage.error("the result");
        let number = (1.0, 0.0);
        let color = (1.0 / self.exposure, 0.0);
        let squared = (color.0 * color.0, 0.0);

        rows.place(&estimate.signal, 0, 0, color, &mut self.color)?;
        if let Some(half_spread) = &mut self.half_spread {
            rows.place(&estimate.signal, 1, 0, color, half_spread)?;
        }
        if let (Some(error), Some(Lane { buffer, plane, component })) = (&mut self.error, &estimate.error) {
            rows.place(buffer, *plane, *component, squared, error)?;
        }
        let Lane { buffer, plane, component } = &estimate.weight_sum;
        rows.place(buffer, *plane, *component, number, &mut self.weight_sum)?;
        if let Some(shares) = &estimate.selection {
            let selection = match &mut self.selection {
                Some(selection) => selection,
                none => {
                    self.candidates = shares.iter().map(|(name, _)| *name).collect();
                    none.insert(Image::try_filled(frame_extent, shares.len(), 0.0).map_err(out_of_memory)?)
                }
            };
            for ((_, share), to) in shares.iter().zip(&mut selection.planes) {
                match share {
                    Share::None => {}
                    Share::Whole => to.fill(1.0),
                    Share::Lane(Lane { buffer, plane, component }) => {
                        let to = &mut to[strip.first * width..];
                        rows.read(buffer, *plane, &mut |first, values| {
                            let pixels = values.chunks_exact(4).map(|pixel| pixel[*component as usize]);
                            to[first..].iter_mut().zip(pixels).for_each(|(to, share)| *to = share);
                        })?;
                    }
                }
            }
        }
        if self.layers.is_empty() {
            let layer = |kept: &KeptPlane| {
                Ok(Layer {
                    intermediate: kept.intermediate,
                    name: kept.layer.clone(),
                    channels: kept.channels.clone(),
                    image: Image::try_filled(frame_extent, kept.channels.len(), 0.0).map_err(out_of_memory)?,
                })
            };
            self.layers = estimate.kept.iter().map(layer).collect::<Result<_>>()?;
        }
        for (layer, kept) in self.layers.iter_mut().zip(&estimate.kept) {
            let unit = match kept.unit {
                Unit::Color => color,
                Unit::ColorSquared => squared,
                Unit::Number => number,
                Unit::Feature(index) => (self.features[index].unit_scale, self.features[index].unit_offset),
                Unit::FeatureSquared(index) => (self.features[index].unit_scale.powi(2), 0.0),
            };
            rows.place(&kept.buffer, kept.plane, 0, unit, &mut layer.image)?;
        }
        Ok(())
    }

    fn finish(self, plan: Plan, step_times: Option<Vec<StepTime>>, peak_bytes: u64) -> Estimate {
        let Self {
            frame,
            exposure,
            features,
            color,
            half_spread,
            selection,
            candidates,
            error,
            weight_sum,
            spikes,
            payload,
            layers,
        } = self;
        let kinds = frame.payload().iter().map(|layer| layer.kind);
        let payload = payload.into_iter().zip(kinds).map(|((mut layer, _), kind)| {
            if kind == PayloadKind::Alpha && layer.left.is_none() {
                // A spike may take more of the opacity of its surroundings along than there is.
                layer.image.planes.iter_mut().flatten().for_each(|value| *value = value.clamp(0.0, 1.0));
            }
            layer
        });
        let payload = payload.collect();
        let features = features.iter().map(|feature| feature.name.clone()).collect();
        let spikes = spikes.map(|FoundSpikes { pixels, taken, spread }| {
            let energy: f64 = frame.color().mean.planes.iter().flatten().map(|value| f64::from(*value)).sum();
            // In an image without energy, every share counts as 0.
            let share = |scaled: f64| if energy > 0.0 { scaled / f64::from(exposure) / energy } else { 0.0 };
            SpikeReport { pixels, taken: share(taken), spread: share(spread) }
        });
        let strips = plan.strips;
        Estimate {
            color,
            half_spread,
            error,
            weight_sum,
            selection,
            candidates,
            features,
            spikes,
            payload,
            layers,
            plan,
            strips,
            stage_times: step_times.as_deref().map(sum_over_steps),
            step_times,
            peak_bytes,
        }
    }
}

/// The rows that a strip contributes to a result.
struct Rows<'a> {
    gpu: &'a Gpu,
    /// Width and height of the strip with its halo.
    extent: IVec2,
    strip: &'a Strip,
}

impl Rows<'_> {
    /// Reads the rows of a plane, piece by piece: `take` gets the position of the first pixel of a piece among these
    /// rows, and the pixels.
    fn read(&self, buffer: &Buffer, plane: u32, take: &mut dyn FnMut(usize, &[f32])) -> Result<()> {
        let Self { gpu, extent, strip } = self;
        let width = extent.x as usize;
        let first = u64::from(plane) * extent.x as u64 * extent.y as u64
            + ((strip.first - strip.first_with_halo) * width) as u64;
        gpu.read_with(buffer, first * PLANE_PIXEL_BYTES, (strip.end - strip.first) * width * 4, |first, values| {
            take(first / 4, values);
        })
    }

    /// Reads the rows of a plane and puts them into an image, beginning with one of the plane's components.
    fn place(
        &self,
        buffer: &Buffer,
        plane: u32,
        component: u32,
        (factor, offset): (f32, f32),
        image: &mut Image,
    ) -> Result<()> {
        let first_of_strip = self.strip.first * self.extent.x as usize;
        self.read(buffer, plane, &mut |first, values| {
            place(values, component as usize, factor, offset, first_of_strip + first, image);
        })
    }
}

/// Copies pixels of vec4 into the planes of an image, from pixel `first` of the image and from component
/// `first_component` of the vec4 on.
fn place(values: &[f32], first_component: usize, factor: f32, offset: f32, first: usize, image: &mut Image) {
    for (channel, plane) in image.planes.iter_mut().enumerate() {
        for (to, from) in plane[first..].iter_mut().zip(values.chunks_exact(4)) {
            *to = from[first_component + channel] * factor + offset;
        }
    }
}
