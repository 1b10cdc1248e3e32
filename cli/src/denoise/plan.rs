//! The plan of a run: which files are read and written for which frame. Made before any work starts.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Serialize;
use stein::text;
use stein_exr::{BufferSetRequest, LayerRef};

use super::Args;
use super::pattern::Pattern;
use crate::options::{Demands, Source};
use crate::{Failure, output};

/// All steps of a run, in order.
#[derive(Debug)]
pub(super) struct ShotPlan {
    /// Frames to read, each once, in ascending order. Frames that only serve as neighbours are among them.
    pub(super) reads: Vec<Read>,
    pub(super) frames: Vec<PlannedFrame>,
    /// Missing numbers between the frames that were found; empty if the frames were listed.
    pub(super) gaps: Vec<Gap>,
    /// Whether the input is a pattern.
    pub(super) is_shot: bool,
}

/// A frame to read.
#[derive(Debug)]
pub(super) struct Read {
    /// Number of the frame; `None` for a single image.
    pub(super) number: Option<u32>,
    pub(super) request: BufferSetRequest,
    pub(super) demands: Demands,
    pub(super) reference: Option<LayerRef>,
    /// File to write; `None` if the frame only serves as a neighbour.
    pub(super) output: Option<PathBuf>,
}

/// A frame to denoise.
#[derive(Debug)]
pub(super) struct PlannedFrame {
    pub(super) number: Option<u32>,
    pub(super) input: PathBuf,
    pub(super) output: PathBuf,
    pub(super) state: State,
    /// Positions in [`ShotPlan::reads`] of the frames that this frame is denoised with; empty if it is not denoised.
    pub(super) window: Range<usize>,
    /// Position of the frame itself in `window`.
    pub(super) centre: usize,
}

/// Consecutive frames that are missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(super) struct Gap {
    first: u32,
    last: u32,
}

impl std::fmt::Display for Gap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { first, last } = self;
        if first == last { write!(f, "{first}") } else { write!(f, "{first}-{last}") }
    }
}

/// Decision about a frame.
#[derive(Debug)]
pub(super) enum State {
    ToDo,
    /// The output exists and is left alone.
    LeftAlone,
    /// A file that the frame needs does not exist.
    Missing(Failure),
}

impl ShotPlan {
    /// Makes the plan of a run. `source` names the layers that the method reads beside the input.
    pub(super) fn new(args: &Args, source: &Source, input: &Path) -> Result<Self, Failure> {
        let pattern = if source.literal { None } else { Pattern::of_input(input) };
        match pattern {
            Some(pattern) => Self::of_shot(args, source, input, &pattern),
            None => Self::of_image(args, source, input),
        }
    }

    fn of_image(args: &Args, source: &Source, input: &Path) -> Result<Self, Failure> {
        let is_pattern = |output: &Path| !source.literal && Pattern::of_input(output).is_some();
        let trouble = if args.frames.is_some() {
            Some("--frames: the input")
        } else if args.temporal_radius > 0 {
            Some("--temporal-radius: the input")
        } else if args.output.as_deref().is_some_and(is_pattern) {
            Some("the output has a place for a frame number, but the input")
        } else {
            None
        };
        if let Some(trouble) = trouble {
            let (input, remedy) = (text::path(input), "give a pattern such as 'shot.####.exr' as the input");
            let literal = if args.output.as_deref().is_some_and(is_pattern) {
                ", or take the paths as they are with --literal"
            } else {
                ""
            };
            return Err(Failure::usage(format_args!(
                "{trouble}, {input}, is a single image\n  remedy: {remedy}{literal}"
            )));
        }
        let output = output::choose(input, args.output.as_deref());
        let reference = args.reference.as_ref().map(|reference| source.reference(reference));
        let read = Read {
            number: None,
            request: source.request(input, &args.further),
            demands: source.demands,
            reference,
            output: Some(output.clone()),
        };
        // The user may replace the input, and a half may be a layer of the input.
        output::check(
            &output,
            output::PICTURE,
            read.files().filter(|file| *file != input),
            args.no_clobber,
            args.dry_run,
        )?;
        let frame =
            PlannedFrame { number: None, input: input.to_owned(), output, state: State::ToDo, window: 0..1, centre: 0 };
        Ok(Self { reads: vec![read], frames: vec![frame], gaps: Vec::new(), is_shot: false })
    }

    fn of_shot(args: &Args, source: &Source, input: &Path, pattern: &Pattern) -> Result<Self, Failure> {
        let frames = match &args.frames {
            Some(list) => list.0.clone(),
            None => pattern.frames_on_disk()?,
        };
        if frames.is_empty() {
            let input = text::path(input);
            return Err(Failure::input(format_args!(
                "{input}: there is no such file; if it is a pattern, there is no such frame\
                 \n  remedy: check the path, or the number of digits"
            )));
        }
        let fixed = source.request(input, &args.further).seeds;
        if let Some(seed) = fixed.iter().find(|seed| Pattern::of_input(seed).is_none()) {
            return Err(Failure::usage(format_args!(
                "{}: a shot is merged with another shot, not with one file\
                 \n  remedy: give a pattern such as 'seed2.####.exr'",
                text::path(seed)
            )));
        }
        let output_pattern = match &args.output {
            Some(output) if !output.is_dir() => Some(Pattern::parse(output).ok_or_else(|| {
                let name = text::path(output);
                Failure::usage(format_args!(
                    "{name}: has no place for the frame number\
                     \n  remedy: give a pattern such as 'clean.####.exr', or a folder that exists"
                ))
            })?),
            _ => None,
        };
        let read = |frame: u32, output: Option<&PathBuf>| Read {
            number: Some(frame),
            request: source.request(input, &args.further).map_files(|file| at_frame(file, frame)),
            demands: source.demands,
            reference: args
                .reference
                .as_ref()
                .filter(|_| output.is_some())
                .map(|reference| reference.map_file(|file| at_frame(file, frame))),
            output: output.cloned(),
        };
        // Neighbours are all frames with near numbers, whether the list has them or not: the result of a frame does not
        // depend on the list.
        let neighbours =
            |frame: u32| frame.saturating_sub(args.temporal_radius)..=frame.saturating_add(args.temporal_radius);
        let mut planned = Vec::new();
        let mut reads = BTreeMap::new();
        let mut beside = BTreeSet::new();
        for &frame in &frames {
            let input = pattern.path(frame);
            let output = match &output_pattern {
                Some(pattern) => pattern.path(frame),
                None => output::choose(&input, args.output.as_deref()),
            };
            let mut state = if args.no_clobber && output.exists() { State::LeftAlone } else { State::ToDo };
            if let State::ToDo = state {
                let read = read(frame, Some(&output));
                match read.missing() {
                    Some(file) => state = State::Missing(missing(frame, file)),
                    None => {
                        reads.insert(frame, read);
                        beside.extend(neighbours(frame));
                    }
                }
            }
            planned.push((frame, input, output, state));
        }
        // Neighbours of which a file is missing are left out of the windows.
        for frame in beside {
            reads.entry(frame).or_insert_with(|| read(frame, None));
        }
        reads.retain(|_, read| read.output.is_some() || read.missing().is_none());

        let numbers: Vec<u32> = reads.keys().copied().collect();
        let position = |frame: u32| numbers.partition_point(|&other| other < frame);
        let frames: Vec<PlannedFrame> = planned
            .into_iter()
            .map(|(frame, input, output, state)| {
                let (first, last) = neighbours(frame).into_inner();
                let is_to_do = matches!(state, State::ToDo);
                let window =
                    if is_to_do { position(first)..numbers.partition_point(|&other| other <= last) } else { 0..0 };
                let centre = if is_to_do { position(frame) - window.start } else { 0 };
                PlannedFrame { number: Some(frame), input, output, state, centre, window }
            })
            .collect();
        let gaps =
            if args.frames.is_some() { Vec::new() } else { gaps(frames.iter().filter_map(|frame| frame.number)) };
        let reads: Vec<Read> = reads.into_values().collect();
        check_outputs(&frames, &reads, args.dry_run)?;
        Ok(Self { reads, frames, gaps, is_shot: true })
    }
}

impl Read {
    /// Returns all files that are read for the frame.
    pub(super) fn files(&self) -> impl Iterator<Item = &Path> {
        let reference = self.reference.as_ref().map(|reference| reference.file.as_path());
        self.request.files().chain(reference)
    }

    /// Returns a file of the frame that does not exist.
    fn missing(&self) -> Option<&Path> {
        self.files().find(|file| !file.exists())
    }
}

/// Returns the frame's file if the path is a pattern, else the path itself, which all frames share.
fn at_frame(file: &Path, frame: u32) -> PathBuf {
    Pattern::of_input(file).map_or_else(|| file.to_owned(), |pattern| pattern.path(frame))
}

fn missing(frame: u32, file: &Path) -> Failure {
    let file = text::path(file);
    let remedy = "render it, or leave the frame out of --frames";
    Failure::input(format_args!("{file}: does not exist\n  remedy: {remedy}")).in_frame(Some(frame))
}

/// Finds the numbers that are missing between ascending ones. The numbers may have a step, as in a preview of every
/// other frame.
fn gaps(numbers: impl Iterator<Item = u32>) -> Vec<Gap> {
    let numbers: Vec<u32> = numbers.collect();
    let pairs = || numbers.windows(2).map(|pair| (pair[0], pair[1]));
    let step = pairs().map(|(before, after)| after - before).fold(0, greatest_common_divisor);
    let holes = pairs().filter(|(before, after)| after - before > step);
    holes.map(|(before, after)| Gap { first: before + step, last: after - step }).collect()
}

fn greatest_common_divisor(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

/// Refuses an output that would replace a file that the shot reads. If the run were interrupted or divided, it would go
/// on with neighbours that are denoised already.
fn check_outputs(frames: &[PlannedFrame], reads: &[Read], dry_run: bool) -> Result<(), Failure> {
    let read = reads.iter().flat_map(Read::files).chain(frames.iter().map(|frame| frame.input.as_path()));
    let read: HashMap<PathBuf, &Path> = read.filter_map(|file| Some((file.canonicalize().ok()?, file))).collect();
    let mut folder = None;
    for frame in frames {
        let also_read = frame.output.canonicalize().ok().and_then(|output| read.get(&output).copied());
        output::check_name(&frame.output, output::PICTURE, also_read.into_iter())?;
        // Checks the folder again only if it changes: most shots have one folder.
        if folder != frame.output.parent() {
            output::check_folder(&frame.output, dry_run)?;
            folder = frame.output.parent();
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_what_breaks_the_step() {
        for (found, missing) in [
            (&[][..], ""),
            (&[5], ""),
            (&[1, 2, 3, 5, 8], "4, 6-7"),
            (&[1, 3, 5, 11], "7-9"),
            (&[1, 100], ""),
            (&[0, 1, u32::MAX], "2-4294967294"),
        ] {
            let told = text::list(gaps(found.iter().copied()).iter().map(Gap::to_string));
            assert_eq!(told, missing, "{found:?}");
        }
    }
}
