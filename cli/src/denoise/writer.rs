//! Writes frames, and compares them with their references, while the device works on the next one.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread::{Scope, ScopedJoinHandle};

use stein::frame::{PayloadKind, PayloadLayer};
use stein::image::Window;
use stein::method::Intermediate;
use stein::{Estimate, Frame, Method, text};
use stein_exr::{BufferSet, References, write_estimates};

use super::shot::{Beside, Compared, Place, Reported, ShotErrorSums};
use crate::explain::Explained;
use crate::inspect::Input;
use crate::report::{FrameReport, PictureReport, Run};
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
    pub(super) pictures: Vec<DenoisedPicture>,
}

/// A denoised picture of a frame.
pub(super) struct DenoisedPicture {
    /// Layer of the colour, if the frame has several pictures.
    pub(super) layer: Option<String>,
    pub(super) frame: Arc<Frame>,
    pub(super) references: Option<References>,
    pub(super) data_window: Window,
    pub(super) estimate: Estimate,
    pub(super) run: Run,
    /// Plan of the picture, if `--explain` asks for it.
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

/// Returns the noisy and the denoised alpha of the colour with its reference; `None` if one of them is missing.
fn alpha(frame: &Frame, estimate: &Estimate, references: &References) -> Option<Compared> {
    let (name, reference) = &references.payload[references.alpha?];
    let noisy = frame.payload().iter().find(|layer| layer.name == *name)?;
    let result = estimate.payload.iter().find(|layer| layer.name == *name)?;
    Some(Compared { images: [noisy.mean.clone(), result.image.clone()], reference: reference.clone() })
}

impl Contents<'_> {
    /// Writes a frame and compares it with its reference.
    fn finish(self, denoised: Denoised, comparison: &mut ShotErrorSums) -> Result<Done, Failure> {
        let Denoised { number, beside, output, original, described, introduction, pictures } = denoised;
        let mut notes = Vec::new();
        let mut estimates = Vec::new();
        let mut rest = Vec::new();
        for picture in pictures {
            let DenoisedPicture { layer, frame, references, data_window, mut estimate, run, plan } = picture;
            notes.extend(self.notes(&frame, &estimate));
            estimate.selection = None;
            estimates.push(estimate);
            // Frees the frame unless a comparison needs it: writing needs memory.
            let compared = references.map(|references| (references, frame));
            rest.push((layer, compared, data_window, run, plan));
        }
        let mut written =
            write_estimates(&estimates, *original, &output, self.keep, self.method).map_err(Failure::output)?;
        notes.dedup();
        written.notes.extend(notes);
        let mut reports = Vec::new();
        for (picture, (estimate, (layer, compared, data_window, run, plan))) in
            estimates.into_iter().zip(rest).enumerate()
        {
            let strips = estimate.strips;
            let (mut errors, mut errors_along) = (None, None);
            if let Some((references, frame)) = compared {
                let found = quality::compare(&frame, &estimate, &references.color)?;
                let along = quality::compare_along(&frame, &estimate, &references.payload)?;
                if let Some(number) = number {
                    let images = [frame.color().mean.clone(), estimate.color.clone()];
                    let place = Place { number, picture, data_window };
                    let alpha = alpha(&frame, &estimate, &references);
                    comparison.add(place, Compared { images, reference: references.color }, alpha)?;
                }
                errors = Some(found);
                errors_along = Some(along);
            }
            reports.push(PictureReport { layer, strips, plan, run: Some(run), errors, errors_along });
        }
        let report = FrameReport::new(*described, reports, Some(written));
        Ok(Done { introduction, reported: Reported { number, beside, report } })
    }

    /// Returns remarks on features and intermediates that are missing in the result.
    fn notes(self, frame: &Frame, estimate: &Estimate) -> Vec<String> {
        let missing = self.keep.iter().filter(|one| !estimate.layers.iter().any(|layer| layer.intermediate == **one));
        let of_kind = |one: &Intermediate| {
            format!("--keep {}: there is nothing of the kind without halves or features", one.name())
        };
        let left_out =
            frame.features().iter().map(|feature| &feature.name).filter(|name| !estimate.features.contains(name));
        let not_used = |name: &String| {
            format!(
                "feature {}: not used, because a frame beside lacks it or has it the same everywhere",
                text::name(name)
            )
        };
        let is_mean_alone = |layer: &&PayloadLayer| layer.kind == PayloadKind::Light && layer.half_spread.is_none();
        let needs_halves = self.method.filters_halves() && frame.color().half_spread.is_some();
        let without_halves: Vec<_> = frame.payload().iter().filter(is_mean_alone).filter(|_| needs_halves).collect();
        let no_sum = (!without_halves.is_empty()).then(|| {
            let names = text::list(without_halves.iter().map(|layer| text::name(&layer.name)));
            format!(
                "without halves, and {} filters halves: denoised lights do not add up to the colour exactly: {names}",
                self.method.name()
            )
        });
        missing.map(of_kind).chain(left_out.map(not_used)).chain(no_sum).collect()
    }
}
