//! Which files are read and written for which frame: settled before any work starts.

use std::collections::{BTreeSet, HashMap};
use std::ops::Range;
use std::path::{Path, PathBuf};

use stein::buffers::{BufferSetRequest, LayerRef};

use super::Args;
use super::pattern::Pattern;
use crate::cli::options::Source;
use crate::cli::{Failure, output};

/// What a run does, in its order.
#[derive(Debug)]
pub(super) struct Plan {
    /// Every file once, ascending; neighbours that are only looked at are among them.
    pub(super) reads: Vec<Read>,
    pub(super) frames: Vec<PlannedFrame>,
    /// Whether the input is a pattern.
    pub(super) is_shot: bool,
}

/// A frame to read.
#[derive(Debug)]
pub(super) struct Read {
    /// `None` of a single image.
    pub(super) number: Option<u32>,
    pub(super) request: BufferSetRequest,
    pub(super) reference: Option<LayerRef>,
    /// Whether it is denoised, and not only looked at by its neighbours.
    pub(super) is_denoised: bool,
}

/// A frame to denoise.
#[derive(Debug)]
pub(super) struct PlannedFrame {
    pub(super) number: Option<u32>,
    pub(super) input: PathBuf,
    pub(super) output: PathBuf,
    /// Positions in [`Plan::reads`] of the frames that it is denoised with; none where an output exists that is to be left alone.
    pub(super) window: Range<usize>,
    /// Its own place among them.
    pub(super) centre: usize,
}

impl PlannedFrame {
    pub(super) fn is_left_alone(&self) -> bool {
        self.window.is_empty()
    }
}

impl Plan {
    /// `source` is what the method reads beside the input.
    pub(super) fn new(args: &Args, source: &Source, input: &Path) -> Result<Self, Failure> {
        match Pattern::of_input(input) {
            Some(pattern) => Self::of_shot(args, source, input, &pattern),
            None => Self::of_image(args, source, input),
        }
    }

    fn of_image(args: &Args, source: &Source, input: &Path) -> Result<Self, Failure> {
        let trouble = if args.frames.is_some() {
            Some("--frames: the input")
        } else if args.temporal_radius > 0 {
            Some("--temporal-radius: the input")
        } else if args.output.as_deref().and_then(Pattern::parse).is_some() {
            Some("the output has a place for a frame number, but the input")
        } else {
            None
        };
        if let Some(trouble) = trouble {
            let input = input.display();
            return Err(Failure::usage(format_args!("{trouble}, {input}, is a single image\n  remedy: give a pattern such as 'shot.####.exr' as the input")));
        }
        let output = output::choose(input, args.output.as_deref());
        let read = Read { number: None, request: source.request(input), reference: args.reference.clone(), is_denoised: true };
        // The input the user may replace, and half A may be one layer of it.
        output::check(&output, read.files().filter(|file| *file != input), args.no_clobber, args.dry_run)?;
        let frame = PlannedFrame { number: None, input: input.to_owned(), output, window: 0..1, centre: 0 };
        Ok(Self { reads: vec![read], frames: vec![frame], is_shot: false })
    }

    fn of_shot(args: &Args, source: &Source, input: &Path, pattern: &Pattern) -> Result<Self, Failure> {
        let frames = match &args.frames {
            Some(list) => list.0.clone(),
            None => pattern.frames_on_disk()?,
        };
        if frames.is_empty() {
            return Err(Failure::input(format_args!("{}: there is no such frame\n  remedy: check the pattern and its number of digits", input.display())));
        }
        let output_pattern = match &args.output {
            Some(output) if !output.is_dir() => Some(Pattern::parse(output).ok_or_else(|| {
                let name = output.display();
                Failure::usage(format_args!(
                    "{name}: has no place for the frame number\n  remedy: give a pattern such as 'clean.####.exr', or a folder that exists"
                ))
            })?),
            _ => None,
        };
        // A neighbour is a frame whose number is near, whatever the list says: so a frame is the same in whichever list it stands.
        let neighbours = |frame: u32| frame.saturating_sub(args.temporal_radius)..=frame.saturating_add(args.temporal_radius);
        let mut planned = Vec::new();
        let mut needed = BTreeSet::new();
        for &frame in &frames {
            let input = pattern.path(frame);
            if !input.exists() {
                return Err(missing(frame, &input));
            }
            let output = match &output_pattern {
                Some(pattern) => pattern.path(frame),
                None => output::choose(&input, args.output.as_deref()),
            };
            let is_left_alone = args.no_clobber && output.exists();
            if !is_left_alone {
                needed.extend(neighbours(frame).filter(|&other| other == frame || pattern.path(other).exists()));
            }
            planned.push((frame, input, output, is_left_alone));
        }

        let denoised: BTreeSet<u32> = planned.iter().filter(|(.., is_left_alone)| !is_left_alone).map(|(frame, ..)| *frame).collect();
        let read = |&frame: &u32| Read {
            number: Some(frame),
            request: source.request(input).map_files(|file| at_frame(file, frame)),
            reference: args.reference.as_ref().filter(|_| denoised.contains(&frame)).map(|reference| reference.map_file(|file| at_frame(file, frame))),
            is_denoised: denoised.contains(&frame),
        };
        let reads: Vec<Read> = needed.iter().map(read).collect();
        for (read, &frame) in reads.iter().zip(&needed) {
            if let Some(file) = read.files().find(|file| !file.exists()) {
                return Err(missing(frame, file));
            }
        }
        let numbers: Vec<u32> = needed.into_iter().collect();
        let position = |frame: u32| numbers.partition_point(|&other| other < frame);
        let frames: Vec<PlannedFrame> = planned
            .into_iter()
            .map(|(frame, input, output, is_left_alone)| {
                let (first, last) = neighbours(frame).into_inner();
                let window = if is_left_alone { 0..0 } else { position(first)..numbers.partition_point(|&other| other <= last) };
                PlannedFrame { number: Some(frame), input, output, centre: position(frame) - window.start.min(position(frame)), window }
            })
            .collect();
        check_outputs(&frames, &reads, args.dry_run)?;
        Ok(Self { reads, frames, is_shot: true })
    }
}

impl Read {
    /// All that it reads.
    fn files(&self) -> impl Iterator<Item = &Path> {
        let reference = self.reference.as_ref().map(|reference| reference.file.as_path());
        self.request.files().chain(reference)
    }
}

/// One frame's file, where the path is a pattern; else the same file for all of them.
fn at_frame(file: &Path, frame: u32) -> PathBuf {
    Pattern::of_input(file).map_or_else(|| file.to_owned(), |pattern| pattern.path(frame))
}

fn missing(frame: u32, file: &Path) -> Failure {
    Failure::input(format_args!("{}: does not exist\n  remedy: render it, or leave the frame and its neighbours out of --frames", file.display()))
        .in_frame(Some(frame))
}

/// A shot replaces nothing that it reads: interrupted, or cut into pieces, it would go on with neighbours that are denoised already.
fn check_outputs(frames: &[PlannedFrame], reads: &[Read], dry_run: bool) -> Result<(), Failure> {
    let read = reads.iter().flat_map(Read::files).chain(frames.iter().map(|frame| frame.input.as_path()));
    let read: HashMap<PathBuf, &Path> = read.filter_map(|file| Some((file.canonicalize().ok()?, file))).collect();
    let mut folder = None;
    for frame in frames {
        let also_read = frame.output.canonicalize().ok().and_then(|output| read.get(&output).copied());
        output::check_name(&frame.output, also_read.into_iter())?;
        // Most shots have one folder.
        if folder != frame.output.parent() {
            output::check_folder(&frame.output, dry_run)?;
            folder = frame.output.parent();
        }
    }
    Ok(())
}
