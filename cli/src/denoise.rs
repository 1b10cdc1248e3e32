//! `stein denoise`

mod frame_list;
mod pattern;
mod plan;
mod progress;
mod reader;
mod results;
mod shot;
mod writer;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use clap::builder::{PossibleValuesParser, TypedValueParser};
use stein::method::{Intermediate, Spikes};
use stein::{Denoiser, Frame, Method, Options, Preset};
use stein_exr::{BufferSet, LayerRef};

use super::explain::Explained;
use super::filter::{Chosen, Filter};
use super::inspect::Input;
use super::options::{Device, Source};
use super::report::{self, FrameReport, PictureReport, Report, Run, Settings};
use super::{Failure, Out, interrupt, quality};
use frame_list::FrameList;
use plan::{PlannedFrame, ShotPlan, State};
use progress::{Progress, ProgressKind};
use reader::{Frames, ReadFrame, Unusable};
use results::Results;
use shot::{BadFrames, Beside, Reported, ShotReport};
use writer::{Contents, Denoised, DenoisedPicture, Done, Writer};

const EXAMPLE: &str = "\
The output keeps the header and the layers of the input. The denoised colour and its halves replace the noisy ones. \
The variance of the noisy colour is left out. `stein.error.V` is added: the estimated squared error, summed over the \
channels.

Examples:
  stein denoise render.exr
  stein denoise seed1.exr seed2.exr -o clean.exr
  stein denoise render.exr -o clean.exr --ref converged.exr
  stein denoise both.exr --half-a seed1.exr --half-b seed2.exr --feature albedo=aux.exr::albedo
  stein denoise render.exr --keep candidates,sure --json
  stein denoise render.exr --explain --candidates second,third --no-error
  stein denoise render.exr --method nlm --keep halves
  stein denoise 'shot.####.exr' --frames 1-240 --temporal-radius 1 -o 'clean.####.exr'

Environment:
  STEIN_CACHE  folder for compiled shaders, kept between runs if the driver hands them out; empty: keep none \
[default: `stein` among the user's caches]

Paths: a path that exists is taken as that file, whatever its characters. In other paths the last `#`, `####`, `%d` or \
`%04d` of a name is the number of the frame, and `FILE::LAYER` is a layer of a file. --literal takes every path as it \
is. Write a name that begins with a dash as ./-name.

Shots: a frame that cannot be used is named and left out, also from the windows of other frames; all others are \
written, and the exit code is 3. A frame of --frames that does not exist counts as such a frame; without --frames, \
gaps are only named. A full disk, a lost device and an interruption end the run.

Exit codes: 0 done, 2 wrong usage, 3 an input file or layer cannot be used (for a shot: of at least one frame), 4 no \
device or a device failed, 5 the output cannot be written, 1 anything else.";

/// Denoise a rendering
#[derive(Debug, clap::Args)]
#[command(
    after_help = EXAMPLE,
    override_usage = "stein denoise [OPTIONS] IN [SEED]...\n       stein denoise [OPTIONS] PATTERN [PATTERN]... -o PATTERN"
)]
pub(crate) struct Args {
    /// OpenEXR file with the noisy colour and, if possible, its halves, variance and features; or a pattern of such
    /// files, such as 'shot.####.exr'
    #[arg(value_name = "IN", required_unless_present = "list_devices")]
    input: Option<PathBuf>,
    /// Other renders of the same frame with other seeds, or patterns of such files: their mean is denoised, and they
    /// tell its noise. Layers that hold no means of samples are as in IN
    #[arg(value_name = "SEED")]
    further: Vec<PathBuf>,
    /// File to write, or a folder for it [default: IN with the extension `.denoised.exr`]. Only this option can replace
    /// the input. For a shot: a pattern such as 'clean.####.exr', or a folder; no file that is read is replaced
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Do not replace an existing output; for a shot, denoise only the frames without output
    #[arg(long)]
    no_clobber: bool,
    /// Show what would be done, and write nothing; for a shot, read only the first frame and its neighbours in time
    #[arg(short = 'n', long)]
    dry_run: bool,
    /// Noise-free reference: print the error before and after; for a shot also the flicker of the frames that this run
    /// denoises
    #[arg(long = "ref", value_name = "FILE[::LAYER]")]
    reference: Option<LayerRef>,
    /// Intermediates to write as layers `stein.*`, such as candidates,sure
    #[arg(long, value_name = "NAME", value_delimiter = ',', value_parser = keepable())]
    keep: Vec<Keep>,
    /// Do not estimate the error: `stein.error` is not written, and its steps are left out
    #[arg(long)]
    no_error: bool,
    /// Also run the steps that this frame does not need, for comparison: the result is the same to the bit, or within
    /// the bounds in docs/leave-out.md
    #[arg(long)]
    everything: bool,
    /// Print the plan: the steps that run for this frame, those that are left out, why, and the time of each step; with
    /// -n without times
    #[arg(long, conflicts_with = "quiet")]
    explain: bool,
    /// Print one JSON document in place of text
    #[arg(long)]
    pub(crate) json: bool,
    /// Also print times per stage and memory
    #[arg(short, long, conflicts_with = "quiet")]
    verbose: bool,
    /// Print nothing but errors
    #[arg(short, long)]
    quiet: bool,
    /// Form of the progress report [default: bar]
    #[arg(long, value_enum, value_name = "KIND", conflicts_with_all = ["json", "quiet"])]
    progress: Option<ProgressKind>,
    /// Frames of the shot, such as 1-240, 1-9x2 (every second one) or 3,5,7 [default: all that exist]
    #[arg(long, value_name = "LIST", help_heading = "Shot")]
    frames: Option<FrameList>,
    /// Number of frames before and after each frame that are filtered together with it, up to 16; frames that do not
    /// exist are left out
    #[arg(
        long,
        value_name = "FRAMES",
        default_value_t = 0,
        value_parser = clap::value_parser!(u32).range(0..=16),
        help_heading = "Shot"
    )]
    temporal_radius: u32,
    #[command(flatten)]
    filter: Filter,
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    pub(crate) device: Device,
}

/// A value of `--keep`.
#[derive(Clone, Copy, Debug)]
enum Keep {
    All,
    One(Intermediate),
}

fn keepable() -> impl TypedValueParser<Value = Keep> {
    let names = std::iter::once("all").chain(Intermediate::ALL.map(Intermediate::name));
    let find = |name: String| {
        Intermediate::ALL.into_iter().find(|intermediate| intermediate.name() == name).map_or(Keep::All, Keep::One)
    };
    PossibleValuesParser::new(names).map(find)
}

impl Args {
    /// Returns the intermediates that go into the output.
    fn keep(&self, method: &Method) -> Result<Vec<Intermediate>, Failure> {
        let has = method.intermediates();
        for keep in &self.keep {
            if let Keep::One(one) = keep
                && !has.contains(one)
            {
                let (name, all) = (method.name(), report::names(has).join(", "));
                return Err(Failure::usage(format_args!(
                    "--keep {}: {name} has no such intermediate\n  remedy: choose from {all}",
                    one.name()
                )));
            }
        }
        let are_looked_for = method.spikes() != Spikes::Keep;
        if self.keep.iter().any(|keep| matches!(keep, Keep::One(Intermediate::Spikes))) && !are_looked_for {
            return Err(Failure::usage(
                "--keep spikes: nothing is taken from spikes\
                 \n  remedy: leave it out, or choose --spikes spread or clamp",
            ));
        }
        let wanted = |intermediate: &Intermediate| {
            (are_looked_for || *intermediate != Intermediate::Spikes)
                && self.keep.iter().any(|keep| match keep {
                    Keep::All => true,
                    Keep::One(one) => one == intermediate,
                })
        };
        Ok(has.iter().copied().filter(wanted).collect())
    }

    fn progress_kind(&self) -> Option<ProgressKind> {
        (!self.quiet && !self.json).then(|| self.progress.unwrap_or(ProgressKind::Bar))
    }
}

/// Denoises an image, or the frames of a shot one after the other.
pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let result = denoise(args, out);
    if let (Err(failure), Some(ProgressKind::Openjd)) = (&result, args.progress) {
        out.line(format_args!(
            "openjd_fail: {}",
            failure.message().lines().map(str::trim).collect::<Vec<_>>().join("; ")
        ));
    }
    result
}

fn denoise(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let input = args.input.as_deref().ok_or_else(|| Failure::usage("no input is given"))?;
    if args.quiet || args.json {
        out.silence();
    }
    let Chosen { method, preset } = args.filter.chosen()?;
    if args.temporal_radius > 0 && !method.filters_in_time() {
        let name = method.name();
        return Err(Failure::usage(format_args!(
            "--temporal-radius: {name} has no filter over several frames\
             \n  remedy: leave the option out, or choose another method"
        )));
    }
    args.source.check(&method)?;
    let keep = args.keep(&method)?;
    let plan = ShotPlan::new(args, &args.source.for_method(&method), input)?;
    let job = ShotRun { args, method, preset, keep, plan: &plan };
    std::thread::scope(|scope| {
        let contents = Contents { method: &job.method, keep: &job.keep };
        job.run(Frames::start(scope, &plan.reads), Writer::start(scope, contents), input, out)
    })
}

struct ShotRun<'a> {
    args: &'a Args,
    method: Method,
    preset: Preset,
    /// Intermediates that go into the output.
    keep: Vec<Intermediate>,
    plan: &'a ShotPlan,
}

impl ShotRun<'_> {
    fn run(&self, mut frames: Frames, writer: Writer, input: &Path, out: &mut Out) -> Result<(), Failure> {
        let mut to_do: Vec<&PlannedFrame> =
            self.plan.frames.iter().filter(|frame| matches!(frame.state, State::ToDo)).collect();
        if self.args.dry_run {
            // One frame is enough to show how all would be used.
            to_do.truncate(1);
        }
        let mut bad = BadFrames::missing(self.plan);
        // Reports files that cannot be used before a device that cannot.
        let usable = self.first_usable(&to_do, &mut frames, &mut bad, out)?;
        if usable.is_empty() && !bad.is_empty() {
            return bad.verdict(self.args.dry_run);
        }
        let gpu = self.args.device.open()?;
        let mut denoiser = self.args.device.denoiser(&gpu, self.method)?;
        if self.args.everything {
            denoiser = denoiser.with_everything();
        }
        gpu.set_timing(self.args.verbose || self.args.json || self.args.explain);
        let settings = Settings {
            preset: self.preset,
            parameters: self.method,
            device: gpu.summary().clone(),
            max_memory_bytes: self.args.device.max_memory,
            kept: report::names(&self.keep),
        };

        let progress = Progress::new(self.args.progress_kind(), usable.len());
        let mut results = Results::new(writer, progress, &settings.device, self.args.verbose, self.plan.is_shot);
        let ended = self.denoise_all(usable, &mut frames, &denoiser, &mut results, &mut bad, out);
        let (reports, errors) = results.finish(ended, out).map_err(|end| bad.before(end))?;
        if self.args.verbose
            && let Some(pipelines) = report::pipelines(gpu.save_pipelines())
        {
            out.say(pipelines);
        }

        if self.plan.is_shot {
            let report = ShotReport {
                input: input.to_owned(),
                temporal_radius: self.args.temporal_radius,
                settings,
                frames: shot::frames(self.plan, reports, &bad),
                gaps: self.plan.gaps.clone(),
                errors,
            };
            if let Some(text) = report.text(self.args.dry_run) {
                out.say(text);
            }
            if self.args.json {
                out.json(&report)?;
            }
            return bad.verdict(self.args.dry_run);
        }
        match reports.first() {
            Some(frame) if self.args.json => out.json(&Report { settings: &settings, frame: &frame.report }),
            _ => Ok(()),
        }
    }

    /// Returns the frames from the first usable one on. Notes the frames before it as bad.
    fn first_usable<'p, 'f>(
        &self,
        to_do: &'f [&'p PlannedFrame],
        frames: &mut Frames,
        bad: &mut BadFrames,
        out: &mut Out,
    ) -> Result<&'f [&'p PlannedFrame], Failure> {
        for (index, planned) in to_do.iter().enumerate() {
            interrupt::check()?;
            let window = frames.move_to(&planned.window)?;
            let Err(unusable) = &window[planned.centre] else { return Ok(&to_do[index..]) };
            let failure = self.unusable(unusable, bad, out)?;
            out.say(format_args!("{}: not denoised", failure.cause()));
        }
        Ok(&[])
    }

    /// Notes a frame of a shot as bad and returns the failure. Fails for a single image, and if the failure is not
    /// about an input file.
    fn unusable(&self, unusable: &Unusable, bad: &mut BadFrames, out: &mut Out) -> Result<Failure, Failure> {
        let Unusable { number, described, failure } = unusable;
        match number {
            Some(number) if failure.is_of_input() => {
                bad.add(*number, failure.clone());
                Ok(failure.clone())
            }
            _ => {
                // The contents of an unusable file show why it cannot be used.
                if let Some(described) = described {
                    out.say(described.text(self.args.verbose));
                }
                Err(failure.clone())
            }
        }
    }

    /// Denoises one frame after the other, up to the first failure that is not the fault of a frame's files.
    fn denoise_all(
        &self,
        to_do: &[&PlannedFrame],
        held: &mut Frames,
        denoiser: &Denoiser,
        results: &mut Results,
        bad: &mut BadFrames,
        out: &mut Out,
    ) -> Result<(), Failure> {
        let mut before: Option<Input> = None;
        for (position, planned) in to_do.iter().enumerate() {
            interrupt::check()?;
            results.progress.begin(planned, out);
            let window = held.move_to(&planned.window)?;
            if let Err(unusable) = &window[planned.centre] {
                let failure = self.unusable(unusable, bad, out)?;
                results.leave_out(&failure, out);
                continue;
            }
            let own = window[planned.centre].as_mut().ok().and_then(|own| own.original.take());
            let Some((original, described)) = own else {
                unreachable!("frames that are denoised are read with all that is in their files")
            };
            // Describes the input again if it is used differently from the frame before. The text is printed with the
            // result of this frame, because an earlier frame may still be being written.
            let is_said = self.args.verbose || before.as_ref().is_none_or(|before| !before.is_used_like(&described));
            let mut introduction = is_said.then(|| described.text(self.args.verbose));
            if before.is_none()
                && let Some(introduction) = introduction.take()
            {
                results.progress.say(out, introduction);
            }
            before = Some((*described).clone());
            let read = Read { original, described, introduction };
            match self
                .frame(planned, window, read, denoiser, results, out)
                .map_err(|failure| failure.in_frame(planned.number))
            {
                Err(failure) if failure.is_of_input() && self.plan.is_shot => {
                    let unusable = Unusable { number: planned.number, described: None, failure };
                    let failure = self.unusable(&unusable, bad, out)?;
                    results.leave_out(&failure, out);
                }
                done => done?,
            }
            // Frees the frames that no later frame is denoised with, so that they take no memory while this one is
            // written.
            held.let_go_before(to_do.get(position + 1).map_or(usize::MAX, |next| next.window.start));
        }
        Ok(())
    }

    /// Denoises the pictures of a frame and hands them to the writer.
    fn frame(
        &self,
        planned: &PlannedFrame,
        window: &mut [Result<ReadFrame, Unusable>],
        read: Read,
        denoiser: &Denoiser,
        results: &mut Results,
        out: &mut Out,
    ) -> Result<(), Failure> {
        let Read { original, described, introduction } = read;
        let count = window[planned.centre].as_ref().map_or(0, |own| own.pictures.len());
        let mut beside: Option<Beside> = None;
        let mut planned_only = Vec::new();
        let mut pictures = Vec::new();
        for picture in 0..count {
            let neighbours = neighbours(window, planned.centre, picture);
            let (references, data_window) = match &mut window[planned.centre] {
                Ok(own) => (own.pictures[picture].references.take(), own.pictures[picture].data_window),
                Err(unusable) => return Err(unusable.failure.clone()),
            };
            match &mut beside {
                None => beside = Some(neighbours.beside),
                // What is left out is the same for most pictures.
                Some(beside) => {
                    let other = neighbours.beside.left_out;
                    let new: Vec<_> = other.into_iter().filter(|text| !beside.left_out.contains(text)).collect();
                    beside.left_out.extend(new);
                }
            }
            let frames: Vec<&Frame> = neighbours.frames.iter().map(|frame| &**frame).collect();
            let mut needed = self.keep.clone();
            if references.is_some() {
                let has = self.method.intermediates();
                needed.extend(quality::NEEDED.iter().filter(|one| has.contains(one) && !self.keep.contains(one)));
            }
            let layer = (count > 1).then(|| original.pictures().nth(picture).unwrap_or_default().to_owned());
            if self.args.dry_run {
                let options = Options { keep: &needed, error: !self.args.no_error, ..Default::default() };
                let plan = denoiser.plan(&frames, neighbours.centre, &options)?;
                let explained = self.args.explain.then(|| Explained::new(&plan, None));
                planned_only.push(PictureReport {
                    layer,
                    strips: plan.strips,
                    plan: explained,
                    run: None,
                    errors: None,
                    errors_along: None,
                });
                continue;
            }
            let start = Instant::now();
            // Reporting progress makes the device wait. On a software device that costs nothing, and a frame takes long
            // enough to be interrupted.
            let is_wanted = results.progress.is_wanted() || denoiser.gpu().is_software();
            let mut tell = |share: f32| {
                results.progress.share((picture as f32 + share) / count as f32, out);
                if interrupt::is_asked() { ControlFlow::Break(()) } else { results.collect(out) }
            };
            let options = Options {
                keep: &needed,
                error: !self.args.no_error,
                progress: if is_wanted { Some(&mut tell) } else { None },
                ..Default::default()
            };
            let estimate = denoiser.denoise_window(&frames, neighbours.centre, options)?;
            let run = Run::new(&estimate, start.elapsed().as_secs_f64());
            let plan = self.args.explain.then(|| Explained::new(&estimate.plan, estimate.step_times.as_deref()));
            let frame = Arc::clone(&neighbours.frames[neighbours.centre]);
            pictures.push(DenoisedPicture { layer, frame, references, data_window, estimate, run, plan });
        }
        let beside = beside.unwrap_or_default();
        if self.args.dry_run {
            let report = FrameReport::new(*described, planned_only, None);
            results.progress.denoised(out);
            results.add(Ok(Done { introduction, reported: Reported { number: planned.number, beside, report } }), out);
            return Ok(());
        }
        let output = planned.output.clone();
        results.hand_over(
            Denoised { number: planned.number, beside, output, original, described, introduction, pictures },
            out,
        )
    }
}

/// Data for a frame's output and report, besides the result.
struct Read {
    original: Box<BufferSet>,
    described: Box<Input>,
    introduction: Option<String>,
}

/// The frames that a picture is denoised with, itself among them.
struct Neighbours {
    frames: Vec<Arc<Frame>>,
    /// Position of the picture itself in `frames`.
    centre: usize,
    beside: Beside,
}

/// Returns a picture of the usable frames of a window. Leaves out frames that cannot be used, at all or together with
/// the frame at `centre`, which is usable.
fn neighbours(window: &[Result<ReadFrame, Unusable>], centre: usize, picture: usize) -> Neighbours {
    let of = |frame: &'_ ReadFrame| frame.pictures.get(picture).map(|it| (it.data_window, it.frame.noise_knowledge()));
    let own = window[centre].as_ref().ok().and_then(of);
    let mut found = Neighbours { frames: Vec::new(), centre: 0, beside: Beside::default() };
    for (index, other) in window.iter().enumerate() {
        let left_out = match other {
            Err(unusable) => Some(unusable.failure.cause().to_owned()),
            Ok(other) => {
                let number = other.number.map_or_else(String::new, |number| format!("frame {number}"));
                match (own, of(other)) {
                    (_, None) => Some(format!("{number}: it has fewer pictures")),
                    (Some((window, _)), Some((data_window, _))) if window != data_window => {
                        Some(format!("{number}: its pixels are {data_window}, not {window}"))
                    }
                    (Some((_, noise)), Some((_, other))) if noise != other => {
                        Some(format!("{number}: halves or variance of its colour are not known as they are here"))
                    }
                    _ => None,
                }
            }
        };
        match (left_out, other) {
            (None, Ok(other)) => {
                if index == centre {
                    found.centre = found.frames.len();
                }
                found.beside.window.extend(other.number);
                found.frames.extend(other.pictures.get(picture).map(|it| Arc::clone(&it.frame)));
            }
            (left_out, _) => found.beside.left_out.extend(left_out.map(|cause| format!("not filtered with {cause}"))),
        }
    }
    found
}
