//! The measuring itself: warm-up, then repeats, all configurations in turn.

use std::path::Path;
use std::time::Instant;

use cpu_time::ProcessTime;
use stein::frame::NoiseKnowledge;
use stein::gpu::StageTime;
use stein::{Denoiser, Frame, Gpu, Image, Method, Options};
use stein_metric as metric;

use crate::configuration::{How, PreparedConfiguration};
use crate::external::External;
use crate::observer::Observer;
use crate::results::mark_front;
use crate::statistics::median;
use crate::{Error, Errors, Result, Row, Set, Stage};

/// A configuration, ready to run.
pub(super) struct Contestant<'a> {
    configuration: &'a PreparedConfiguration,
    runner: Runner<'a>,
}

enum Runner<'a> {
    Stein(Denoiser),
    External(&'a External),
}

impl<'a> Contestant<'a> {
    pub(super) fn new(
        configuration: &'a PreparedConfiguration,
        denoiser: impl FnOnce(Method) -> Result<Denoiser>,
    ) -> Result<Self> {
        let runner = match &configuration.how {
            How::Stein { method, everything: false, .. } => Runner::Stein(denoiser(*method)?),
            How::Stein { method, everything: true, .. } => Runner::Stein(denoiser(*method)?.with_everything()),
            How::External(external) => Runner::External(external),
        };
        Ok(Self { configuration, runner })
    }

    /// Returns the noise knowledge that is left to the contestant; `None` if nothing is taken away.
    pub(super) fn noise_knowledge(&self) -> Option<NoiseKnowledge> {
        match &self.configuration.how {
            How::Stein { noise, .. } => noise.knowledge(),
            How::External(_) => None,
        }
    }

    /// Whether the contestant can run on the case. Another program reads the set's file, so it cannot run on a resized
    /// set.
    fn can_run(&self, case: &Case<'_>) -> bool {
        matches!(self.runner, Runner::Stein(_)) || !case.set.is_resized
    }
}

/// A set at a size, in memory.
pub(super) struct Case<'a> {
    pub(super) set: &'a Set,
    pub(super) frame: &'a Frame,
    /// Frames with less noise knowledge, one for each knowledge that contestants ask for.
    pub(super) less_known: &'a [(NoiseKnowledge, Frame)],
    pub(super) reference: Option<&'a Image>,
}

impl Case<'_> {
    /// Returns the frame as the contestant gets it.
    fn frame_for(&self, contestant: &Contestant<'_>) -> &Frame {
        let knowledge = contestant.noise_knowledge();
        self.less_known.iter().find(|(known, _)| Some(*known) == knowledge).map_or(self.frame, |(_, frame)| frame)
    }
}

/// Result of a configuration on a case.
pub(super) struct Outcome {
    pub(super) row: Row,
    pub(super) image: Image,
}

/// Measurements of a configuration so far.
struct Record {
    first_ms: f64,
    image: Image,
    predicted_mse: Option<f64>,
    walls_ms: Vec<f64>,
    cpus_ms: Vec<f64>,
    /// Name, number of dispatches, and milliseconds of each run, for every stage.
    stages: Vec<(String, usize, Vec<f64>)>,
    peak_bytes: Option<u64>,
    strips: Option<usize>,
}

/// Returns the number of runs that [`measure`] makes for each contestant.
pub(super) fn runs(repeats: u32) -> u64 {
    1 + 2 * u64::from(repeats)
}

/// Measures all contestants that can run on a case, in their order. `folder` is for the files of other programs.
pub(super) fn measure(
    gpu: &Gpu,
    contestants: &[Contestant<'_>],
    case: &Case<'_>,
    repeats: u32,
    folder: &Path,
    observer: &mut dyn Observer,
) -> Result<Vec<Outcome>> {
    let all = contestants.len();
    let contestants: Vec<_> = contestants.iter().filter(|contestant| contestant.can_run(case)).collect();
    observer.skipped((all - contestants.len()) as u64 * runs(repeats));
    let output = folder.join("out.exr");
    let input =
        std::path::absolute(&case.set.file).map_err(|error| Error::Path { path: case.set.file.clone(), error })?;
    let mut records = Vec::new();
    for contestant in &contestants {
        go_on(observer)?;
        records.push(match &contestant.runner {
            Runner::Stein(denoiser) => warm_up(gpu, denoiser, case.frame_for(contestant))?,
            Runner::External(external) => warm_up_external(external, &input, &output, case, observer)?,
        });
        observer.ran(1);
    }
    for _ in 0..repeats {
        // Contestants take turns, so that a machine that slows down affects all of them alike.
        for (contestant, record) in contestants.iter().zip(&mut records) {
            go_on(observer)?;
            match &contestant.runner {
                Runner::Stein(denoiser) => {
                    let frame = case.frame_for(contestant);
                    gpu.set_timing(false);
                    let (start, cpu_start) = (Instant::now(), ProcessTime::try_now());
                    let estimate = denoiser.denoise(frame)?;
                    record.walls_ms.push(start.elapsed().as_secs_f64() * 1e3);
                    let cpu = cpu_start.and_then(|start| start.try_elapsed());
                    record.cpus_ms.extend(cpu.map(|cpu| cpu.as_secs_f64() * 1e3));
                    (record.peak_bytes, record.strips) = (Some(estimate.peak_bytes), Some(estimate.strips));
                    observer.ran(1);
                    gpu.set_timing(true);
                    record.add_stages(denoiser.denoise(frame)?.stage_times.unwrap_or_default());
                    observer.ran(1);
                }
                Runner::External(external) => {
                    record.walls_ms.push(external.run(&input, &output, observer)? * 1e3);
                    observer.ran(2);
                }
            }
        }
    }
    let _ = std::fs::remove_file(&output);
    let mut outcomes = Vec::new();
    for (contestant, record) in contestants.iter().zip(records) {
        outcomes.push(record.finish(&contestant.configuration.described.name, case)?);
    }
    let mut rows: Vec<Row> = outcomes.iter().map(|outcome| outcome.row.clone()).collect();
    mark_front(&mut rows);
    outcomes.iter_mut().zip(rows).for_each(|(outcome, row)| outcome.row = row);
    Ok(outcomes)
}

/// Fails if the observer ended the run.
fn go_on(observer: &dyn Observer) -> Result<()> {
    if observer.is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
}

/// Makes the first run of a contestant: the first dispatch of a kernel compiles it.
fn warm_up(gpu: &Gpu, denoiser: &Denoiser, frame: &Frame) -> Result<Record> {
    gpu.set_timing(false);
    let start = Instant::now();
    let estimate = denoiser.denoise_with(frame, Options::default())?;
    let first_ms = start.elapsed().as_secs_f64() * 1e3;
    Ok(Record {
        first_ms,
        predicted_mse: estimate
            .error
            .as_ref()
            .and_then(|error| error.planes.first())
            .map(|plane| metric::mean(plane) / estimate.color.channels() as f64),
        image: estimate.color,
        walls_ms: Vec::new(),
        cpus_ms: Vec::new(),
        stages: Vec::new(),
        peak_bytes: None,
        strips: None,
    })
}

fn warm_up_external(
    external: &External,
    input: &Path,
    output: &Path,
    case: &Case<'_>,
    observer: &mut dyn Observer,
) -> Result<Record> {
    let first_ms = external.run(input, output, observer)? * 1e3;
    let image = external.read(output, case.frame.extent())?;
    Ok(Record {
        first_ms,
        image,
        predicted_mse: None,
        walls_ms: Vec::new(),
        cpus_ms: Vec::new(),
        stages: Vec::new(),
        peak_bytes: None,
        strips: None,
    })
}

impl Record {
    fn add_stages(&mut self, times: Vec<StageTime>) {
        for StageTime { stage, seconds, dispatches } in times {
            let known = self.stages.iter().position(|(name, ..)| *name == stage).unwrap_or_else(|| {
                self.stages.push((stage, dispatches, Vec::new()));
                self.stages.len() - 1
            });
            self.stages[known].2.push(seconds * 1e3);
        }
    }

    fn finish(self, configuration: &str, case: &Case<'_>) -> Result<Outcome> {
        let wall_ms = median(self.walls_ms);
        let stages: Vec<_> = self
            .stages
            .into_iter()
            .map(|(stage, dispatches, times)| Stage { stage, ms: median(times), dispatches })
            .collect();
        let row = Row {
            set: case.set.name.clone(),
            configuration: configuration.to_owned(),
            first_ms: self.first_ms,
            wall_ms,
            wall_ms_per_megapixel: wall_ms / case.set.megapixels(),
            cpu_ms: (!self.cpus_ms.is_empty()).then(|| median(self.cpus_ms)),
            device_ms: (!stages.is_empty()).then(|| stages.iter().map(|stage| stage.ms).sum()),
            stages,
            peak_bytes: self.peak_bytes,
            strips: self.strips,
            errors: case.reference.map(|reference| errors(&self.image, reference)).transpose()?,
            predicted_mse: self.predicted_mse,
            on_front: None,
        };
        Ok(Outcome { row, image: self.image })
    }
}

/// Computes all error measures of an image against its reference.
pub(super) fn errors(image: &Image, reference: &Image) -> Result<Errors> {
    let finite = |value: f64| value.is_finite().then_some(value);
    let relative_mse = finite(metric::relative_mse(image, reference)?);
    Ok(Errors {
        relative_mse,
        mse: finite(metric::mse(image, reference)?),
        ssim: finite(metric::ssim(image, reference)?),
        // FLIP takes values that are not finite for black, so it is computed only for finite images.
        flip: relative_mse.map(|_| metric::flip(image, reference)).transpose()?,
    })
}
