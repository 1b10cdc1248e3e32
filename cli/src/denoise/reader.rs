//! Reads frames from their files for the device: each frame once, and the next one while the device works.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::Scope;

use stein::Frame;
use stein::image::Window;
use stein_exr::{BufferSet, References};

use super::plan::Read;
use crate::inspect::{Input, settle};
use crate::{Failure, options, output};

/// A frame in memory.
pub(super) struct ReadFrame {
    pub(super) number: Option<u32>,
    /// Pictures of the frame, such as view layers; mostly one.
    pub(super) pictures: Vec<ReadPicture>,
    /// Data for the frame's output, until the frame is denoised; `None` for a frame that only serves as a neighbour.
    pub(super) original: Option<(Box<BufferSet>, Box<Input>)>,
}

/// A picture of a frame.
pub(super) struct ReadPicture {
    pub(super) frame: Arc<Frame>,
    pub(super) references: Option<References>,
    pub(super) data_window: Window,
}

/// A frame that cannot be used: the reason, and a description of its file if the file could be read.
pub(super) struct Unusable {
    pub(super) number: Option<u32>,
    pub(super) described: Option<Box<Input>>,
    pub(super) failure: Failure,
}

/// The frames of a window that moves forwards. Only these frames are in memory, and the frame that is being read.
pub(super) struct Frames {
    incoming: Receiver<Result<ReadFrame, Unusable>>,
    held: VecDeque<Result<ReadFrame, Unusable>>,
    /// Position of the first held frame among all frames that are read.
    first: usize,
}

impl Frames {
    /// Starts a thread that reads the frames.
    pub(super) fn start<'scope>(scope: &'scope Scope<'scope, '_>, reads: &'scope [Read]) -> Self {
        // No buffer: the reader waits while it holds one frame.
        let (sender, incoming) = sync_channel(0);
        scope.spawn(move || {
            for read in reads {
                // The receiver is gone once the work has failed.
                if sender.send(load(read)).is_err() {
                    break;
                }
            }
        });
        Self { incoming, held: VecDeque::new(), first: 0 }
    }

    /// Frees the frames before the frame at `start`.
    pub(super) fn let_go_before(&mut self, start: usize) {
        while self.first < start && self.held.pop_front().is_some() {
            self.first += 1;
        }
    }

    /// Frees the frames before the window and waits until all frames of the window are read.
    pub(super) fn move_to(&mut self, window: &Range<usize>) -> Result<&mut [Result<ReadFrame, Unusable>], Failure> {
        self.let_go_before(window.start);
        while self.first + self.held.len() < window.end {
            let frame =
                self.incoming.recv().map_err(|_| Failure::other("a frame is missing after all have been read"))?;
            self.held.push_back(frame);
        }
        Ok(&mut self.held.make_contiguous()[..window.len()])
    }
}

fn load(read: &Read) -> Result<ReadFrame, Unusable> {
    let number = read.number;
    let unusable = |described, failure: Failure| Unusable { number, described, failure: failure.in_frame(number) };
    let mut set = options::read(&read.request).map_err(|failure| unusable(None, failure))?;
    if let Some(output) = &read.output {
        output::check_not_read(output, &set).map_err(|failure| unusable(None, failure))?;
    }
    let (frames, described) = settle(&mut set, read.demands);
    let described = Box::new(described);
    let frames = match frames {
        Ok(frames) => frames,
        Err(error) => return Err(unusable(Some(described), Failure::in_file(&read.request.input, error))),
    };
    let mut pictures = Vec::with_capacity(frames.len());
    for (index, frame) in frames.into_iter().enumerate() {
        let references = read.reference.as_ref().map(|reference| set.read_references(index, reference)).transpose();
        match references {
            Ok(references) => {
                let data_window = set.data_window_of(index);
                pictures.push(ReadPicture { frame: Arc::new(frame), references, data_window });
            }
            Err(error) => return Err(unusable(Some(described), error.into())),
        }
    }
    let original = read.output.is_some().then(|| (Box::new(set), described));
    Ok(ReadFrame { number: read.number, pictures, original })
}
