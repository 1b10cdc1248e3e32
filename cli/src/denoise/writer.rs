//! Writes frames, and compares them with their references, while the device works on the next one.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread::{Scope, ScopedJoinHandle};
use stein_exr::write_estimate;

use stein::method::Intermediate;
use stein::{Estimate, Frame, Image, Method, text};
use stein_exr::BufferSet;

use super::shot::{Beside, Compared, Reported, ShotErrorSums};
use crate::explain::Explained;
use crate::inspect::Input;
use crate::report::{FrameReport, Run};
use crate::{Failure, quality};

/// A denoised frame, with all data for its output and its report.
pub(super) struct Denoised {
    pub(super) number: Option<u32>,
    pub(super) beside: Beside,
    pub(super) output: PathBuf,
    pub(super) original: Box<BufferSet>,
    pub(super) described: Box<Input>,
    /// Description of the input, which is printed before everything else.
    pub(super) introduction: Option<String>,
    pub(super) frame: Arc<Frame>,
    pub(super) reference: Option<Image>,
    pub(super) estimate: Estimate,
    pub(super) run: Run,
    /// Plan of the frame, if `--explain` asks for it.
    pub(super) plan: Option<Explained>,
}

/// A frame whose output is complete.
pub(super) struct Done {
    pub(super) introduction: Option<String>,
    pub(super) reported: Reported,
}

/// Settings of all outputs.
#[derive(Clone, Copy)]
pub(super) struct Contents<'a> {
    pub(super) method: &'a Method,
    pub(super) keep: &'a [Intermediate],
}

/// The thread that writes one frame after the other, in the order in which they come. Stops after the first frame that
/// cannot be written.
pub(super) struct Writer<'scope> {
    /// Channel to the thread; `None` once no more frames come.
    to_write: Option<SyncSender<Denoised>>,
    done: Receiver<Result<Done, Failure>>,
    thread: ScopedJoinHandle<'scope, ShotErrorSums>,
}

impl<'scope> Writer<'scope> {
    pub(super) fn start(scope: &'scope Scope<'scope, '_>, contents: Contents<'scope>) -> Self {
        // No buffer: only the frame that is being written and the frame on the device take memory.
        let (to_write, incoming) = sync_channel::<Denoised>(0);
        let (sender, done) = channel();
        let thread = scope.spawn(move || {
            let mut comparison = ShotErrorSums::default();
            for frame in incoming {
                let number = frame.number;
                let written = contents.finish(frame, &mut comparison).map_err(|failure| failure.in_frame(number));
                let is_last = written.is_err();
                // The receiver is gone once the work has ended early.
                if sender.send(written).is_err() || is_last {
                    break;
                }
            }
            comparison
        });
        Self { to_write: Some(to_write), done, thread }
    }

    /// Hands a frame to the thread, which takes it once the frame before is written. Returns whether the frame was
    /// taken: after a failure, which [`Self::done`] returns, none is.
    pub(super) fn hand_over(&self, frame: Denoised) -> bool {
        self.to_write.as_ref().is_some_and(|to_write| to_write.send(frame).is_ok())
    }

    /// Returns a frame that was written since the last call, or the reason why one was not.
    pub(super) fn done(&self) -> Option<Result<Done, Failure>> {
        self.done.try_recv().ok()
    }

    /// Waits for the next of the frames that were handed over. No frame can be handed over afterwards. Returns `None`
    /// after the last.
    pub(super) fn rest(&mut self) -> Option<Result<Done, Failure>> {
        self.to_write = None;
        self.done.recv().ok()
    }

    /// Returns the comparison of all frames with their references. Called after [`Self::rest`].
    pub(super) fn comparison(self) -> ShotErrorSums {
        self.thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

impl Contents<'_> {
    /// Writes a frame and compares it with its reference.
    fn finish(self, denoised: Denoised, comparison: &mut ShotErrorSums) -> Result<Done, Failure> {
        let Denoised {
            number,
            beside,
            output,
            original,
            described,
            introduction,
            frame,
            reference,
            mut estimate,
            run,
            plan,
        } = denoised;
        let data_window = original.data_window();
        let left_out: Vec<_> = frame
            .features()
            .iter()
            .map(|feature| feature.name.clone())
            .filter(|name| !estimate.features.contains(name))
            .collect();
        // Frees the frame unless a comparison needs it: writing needs memory.
        let frame = reference.is_some().then_some(frame);
        estimate.selection = None;
        let mut written =
            write_estimate(&estimate, *original, &output, self.keep, self.method).map_err(Failure::output)?;
        let missing = self.keep.iter().filter(|one| !estimate.layers.iter().any(|layer| layer.intermediate == **one));
        written.notes.extend(
            missing
                .map(|one| format!("--keep {}: there is nothing of the kind without halves or features", one.name())),
        );
        let not_used = |name: String| {
            format!(
                "feature {}: not used, because a frame beside lacks it or has it the same everywhere",
                text::name(&name)
            )
        };
        written.notes.extend(left_out.into_iter().map(not_used));
        let compared = reference.as_ref().zip(frame.as_deref());
        let errors = compared.map(|(reference, frame)| quality::compare(frame, &estimate, reference)).transpose()?;
        let strips = estimate.strips;
        if let (Some(number), Some(reference), Some(frame), Some(errors)) = (number, reference, frame, &errors) {
            let images = [frame.color().mean.clone(), estimate.color];
            comparison.add(Compared { number, data_window, images, reference }, errors)?;
        }
        let report = FrameReport { input: *described, strips, plan, run: Some(run), output: Some(written), errors };
        Ok(Done { introduction, reported: Reported { number, beside, report } })
    }
}
