//! The worker: one thread that reads files and denoises, so that the window never waits.
//!
//! The window sends [`Request`]s and gets [`Reply`]s. Of each [`Task`] only the newest request counts: it replaces a
//! request that waits, and cancels a request that is at work. Tasks that wait are taken in the order of [`Task::ALL`].
//! Long work of low rank is split into several requests, which the worker sends to itself, so that other tasks can run
//! between them.

use std::any::Any;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use eframe::egui::Context;
use stein::error::{FileCause, RequestCause};
use stein::frame::Contradiction;
use stein::gpu::Pace;
use stein::sampling::estimated_relative_mse;
use stein::{Denoiser, Error, Frame, Gpu, Image, Options};
use stein_exr::{BufferSet, BufferSetRequest, LayerRef};

use crate::adaptive::{Adapted, Loop};
use crate::device::no_thread;
use crate::document::{Denoised, InputFiles, MeasuredRun, Opened, Opening, Source, input_layers, relative_mse};
use crate::files::short_name;
use crate::inspector::{Inspected, Question};
use crate::settings::Parameters;
use crate::words;

/// Number of dispatches between which the window can draw, on a graphics card. A processor takes long for a single one.
const DISPATCHES_AT_ONCE: usize = 8;

/// Shortest time between two replies about progress.
const BETWEEN_REPLIES: Duration = Duration::from_millis(200);

/// A run that takes longer than this is measured only once: the time for compiling shaders is small beside it.
const MEASURED_TWICE: Duration = Duration::from_secs(10);

/// Longest time that the window rests after a frame.
const LONGEST_REST: Duration = Duration::from_millis(80);

/// Returns the time for which a window that draws on the processor's own cores leaves them to the worker. `frame` is
/// the time since the previous frame was handed over. If frames follow each other without pause, window and worker thus
/// get half of the time each. The limit keeps input from waiting long.
pub fn rest_after(frame: Duration) -> Duration {
    frame.min(LONGEST_REST)
}

/// A request to the worker.
#[derive(Debug)]
pub enum Request {
    /// Reads a frame, and its reference if there is one.
    Open(Box<Opening>),
    /// Computes which neighbours made a pixel.
    Inspect(Question),
    /// Denoises a frame, and keeps all layers that can be looked at.
    Denoise {
        /// Frame to denoise.
        frame: Arc<Frame>,
        /// Reference to compare with.
        reference: Option<Arc<Image>>,
        /// Method and parameters.
        parameters: Parameters,
    },
    /// Does the next step of an adaptive loop; the worker itself requests the steps after it.
    Adapt(Box<Loop>),
    /// Measures time and error of one run after the other.
    Sweep {
        /// Frame to denoise.
        frame: Arc<Frame>,
        /// Reference to compare with.
        reference: Option<Arc<Image>>,
        /// Method and parameters of each run.
        runs: Arc<[Parameters]>,
        /// Index of the first run that is not yet done.
        next: usize,
    },
}

/// The kinds of requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// [`Request::Open`].
    Open,
    /// [`Request::Inspect`].
    Inspect,
    /// [`Request::Denoise`].
    Denoise,
    /// [`Request::Adapt`].
    Adapt,
    /// [`Request::Sweep`], which makes way for all other tasks and continues after them.
    Sweep,
}

impl Task {
    /// All tasks, in the order in which they are taken.
    pub const ALL: [Self; 5] = [Self::Open, Self::Inspect, Self::Denoise, Self::Adapt, Self::Sweep];

    /// Returns the text that users read while the task is at work.
    pub fn title(self) -> &'static str {
        match self {
            Self::Open => "reading",
            Self::Inspect => "looking at a pixel",
            Self::Denoise => "denoising",
            Self::Adapt => "sampling",
            Self::Sweep => "measuring",
        }
    }
}

impl Request {
    /// Returns the kind of the request.
    pub fn task(&self) -> Task {
        match self {
            Self::Open(_) => Task::Open,
            Self::Inspect(_) => Task::Inspect,
            Self::Denoise { .. } => Task::Denoise,
            Self::Adapt(_) => Task::Adapt,
            Self::Sweep { .. } => Task::Sweep,
        }
    }

    /// Returns a sweep without its next `done` runs; `None` if no runs are left, and for other requests.
    fn after(&self, done: usize) -> Option<Self> {
        match self {
            Self::Sweep { frame, reference, runs, next } if next + done < runs.len() => Some(Self::Sweep {
                frame: frame.clone(),
                reference: reference.clone(),
                runs: runs.clone(),
                next: next + done,
            }),
            _ => None,
        }
    }
}

/// A message from the worker.
#[derive(Debug)]
pub enum Reply {
    /// Share of a task that is done, 0 to 1.
    Progress(Task, f32),
    /// A frame was read.
    Opened(Box<Opened>),
    /// The kernels of a pixel are ready.
    Inspected(Box<Inspected>),
    /// A frame was denoised.
    Denoised(Box<Denoised>),
    /// An adaptive loop is one step further.
    Adapted(Box<Adapted>),
    /// A run was measured.
    Swept(Box<MeasuredRun>),
    /// A task failed because of this error. Cancelled tasks send no such reply.
    Failed(Task, Error),
}

/// The worker, as the window uses it.
#[derive(Debug)]
pub struct Worker {
    mailbox: Arc<Mailbox>,
    replies: Receiver<(u64, Reply)>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Mailbox {
    state: Mutex<State>,
    /// Wakes the thread when there is a new request.
    news: Condvar,
    /// Wakes the window when a request has ended.
    done: Condvar,
}

#[derive(Debug, Default)]
struct State {
    /// Requests that wait, with their numbers: at most one of each task.
    waiting: Vec<(u64, Request)>,
    at_work: Option<AtWork>,
    /// Number of the newest request of each task: replies to older requests do not count.
    newest: [u64; Task::ALL.len()],
    sent: u64,
    ends: bool,
}

#[derive(Debug)]
struct AtWork {
    task: Task,
    cancelled: Arc<AtomicBool>,
}

impl Mailbox {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Returns a task that is at work or waits.
    fn busy(&self) -> Option<Task> {
        let at_work = self.at_work.as_ref().map(|at_work| at_work.task);
        at_work.or_else(|| self.waiting.first().map(|(_, request)| request.task()))
    }

    /// Cancels a task, whether it waits or is at work.
    fn cancel(&mut self, task: Task) {
        self.waiting.retain(|(_, waiting)| waiting.task() != task);
        if let Some(at_work) = self.at_work.as_ref().filter(|at_work| at_work.task == task) {
            at_work.cancelled.store(true, Ordering::Relaxed);
        }
        self.sent += 1;
        self.newest[task as usize] = self.sent;
    }

    /// Ends the request that is at work. The rest of it waits, unless the request was cancelled.
    fn end(&mut self, number: u64, goes_on: Option<Request>) {
        self.at_work = None;
        self.waiting.extend(
            goes_on.filter(|request| self.newest[request.task() as usize] == number).map(|request| (number, request)),
        );
    }

    /// Interrupts a sweep for a task of higher rank; the sweep continues afterwards.
    fn make_way(&self, task: Task) {
        if let Some(at_work) =
            self.at_work.as_ref().filter(|at_work| at_work.task == Task::Sweep && task != Task::Sweep)
        {
            at_work.cancelled.store(true, Ordering::Relaxed);
        }
    }
}

impl Worker {
    /// Starts the thread, which wakes the window of `context` with each reply.
    ///
    /// # Errors
    /// [`Error::Device`] if the system cannot start a thread.
    pub fn start(gpu: &Gpu, context: &Context) -> stein::Result<Self> {
        let mailbox = Arc::<Mailbox>::default();
        let (sender, replies) = channel();
        let desk = Desk { gpu: gpu.clone(), mailbox: mailbox.clone(), replies: sender, context: context.clone() };
        let thread =
            std::thread::Builder::new().name("stein-worker".into()).spawn(move || desk.work()).map_err(no_thread)?;
        Ok(Self { mailbox, replies, thread: Some(thread) })
    }

    /// Sends a request. Cancels the previous request of the same task; a request that replaces the open frame cancels
    /// all other work as well.
    pub fn send(&self, request: Request) {
        let mut state = self.mailbox.lock();
        let task = request.task();
        if matches!(task, Task::Open | Task::Adapt) {
            Task::ALL.into_iter().for_each(|task| state.cancel(task));
        } else {
            state.cancel(task);
        }
        state.make_way(task);
        let number = state.newest[task as usize];
        state.waiting.push((number, request));
        self.mailbox.news.notify_one();
    }

    /// Cancels a task, whether it waits or is at work.
    pub fn cancel(&self, task: Task) {
        self.mailbox.lock().cancel(task);
    }

    /// Returns the next reply that still counts, if there is one. Replies are taken one at a time, because the reaction
    /// to one reply may cancel the task of another.
    pub fn next_reply(&self) -> Option<Reply> {
        let counts = |(number, reply): &(u64, Reply)| *number == self.mailbox.lock().newest[reply.task() as usize];
        self.replies.try_iter().find(counts).map(|(_, reply)| reply)
    }

    /// Returns a task that is at work or waits.
    pub fn busy(&self) -> Option<Task> {
        self.mailbox.lock().busy()
    }

    /// Returns whether this task is at work or waits.
    pub fn has(&self, task: Task) -> bool {
        let state = self.mailbox.lock();
        state.at_work.as_ref().is_some_and(|at_work| at_work.task == task)
            || state.waiting.iter().any(|(_, request)| request.task() == task)
    }

    /// Blocks until all work is done, but no longer than `time`.
    pub fn make_room(&self, time: Duration) {
        let state = self.mailbox.lock();
        // The window continues, however the wait ended.
        drop(self.mailbox.done.wait_timeout_while(state, time, |state| state.busy().is_some()));
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        {
            let mut state = self.mailbox.lock();
            Task::ALL.into_iter().for_each(|task| state.cancel(task));
            state.ends = true;
        }
        self.mailbox.news.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic in the thread was already reported.
            let _ = thread.join();
        }
    }
}

impl Reply {
    fn task(&self) -> Task {
        match self {
            Self::Progress(task, _) | Self::Failed(task, _) => *task,
            Self::Opened(_) => Task::Open,
            Self::Inspected(_) => Task::Inspect,
            Self::Denoised(_) => Task::Denoise,
            Self::Adapted(_) => Task::Adapt,
            Self::Swept(_) => Task::Sweep,
        }
    }
}

/// The worker as its thread uses it: where requests come from and where replies go.
struct Desk {
    gpu: Gpu,
    mailbox: Arc<Mailbox>,
    replies: Sender<(u64, Reply)>,
    context: Context,
}

/// A request at work, as the functions that do the work see it.
struct WorkerJob<'a> {
    desk: &'a Desk,
    number: u64,
    task: Task,
    cancelled: Arc<AtomicBool>,
    /// Time of the newest reply about progress.
    reported: Mutex<Option<Instant>>,
}

impl WorkerJob<'_> {
    /// Sends a reply, and wakes the window.
    fn tell(&self, reply: Reply) {
        // Nobody listens once the window is closed.
        let _ = self.desk.replies.send((self.number, reply));
        self.desk.context.request_repaint();
    }

    /// Reports the share that is done, 0 to 1. Returns whether the request goes on.
    fn progress(&self, share: f32) -> ControlFlow<()> {
        // Each reply makes the window draw again, on the same device.
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        if reported.is_none_or(|reported| reported.elapsed() >= BETWEEN_REPLIES) {
            *reported = Some(Instant::now());
            self.tell(Reply::Progress(self.task, share));
        }
        if self.cancelled.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Returns a pace that lets the window draw between the dispatches, and that ends soon after a cancellation.
    fn pace(&self) -> Pace {
        let dispatches = if self.desk.gpu.is_software() { 1 } else { DISPATCHES_AT_ONCE };
        Pace { dispatches, cancelled: self.cancelled.clone() }
    }

    /// As [`WorkerJob::progress`], for work that ends with an error.
    ///
    /// # Errors
    /// [`Error::Cancelled`] if the request was cancelled.
    fn check(&self, share: f32) -> stein::Result<()> {
        if self.progress(share).is_break() { Err(Error::Cancelled) } else { Ok(()) }
    }
}

impl Desk {
    fn work(self) {
        while let Some((number, request, cancelled)) = self.next() {
            let task = request.task();
            let job = WorkerJob { desk: &self, number, task, cancelled, reported: Mutex::default() };
            // A sweep that only made way for another task is done again, as a whole. `State::end` drops a sweep that
            // the user cancelled.
            let whole = request.after(0);
            let done = catch_unwind(AssertUnwindSafe(|| self.fulfil(&job, request)))
                .unwrap_or_else(|panic| Err(defect(panic.as_ref())));
            let (told, goes_on) = match done {
                Ok((reply, rest)) => (Ok(reply), rest),
                Err(Error::Cancelled) => (Err(Error::Cancelled), whole),
                Err(error) => (Err(error), None),
            };
            self.mailbox.lock().end(number, goes_on);
            self.mailbox.done.notify_one();
            match told {
                Ok(reply) => job.tell(reply),
                Err(Error::Cancelled) => self.context.request_repaint(),
                Err(error) => job.tell(Reply::Failed(task, error)),
            }
        }
    }

    /// Waits for the next request; `None` if the worker ends.
    fn next(&self) -> Option<(u64, Request, Arc<AtomicBool>)> {
        let mut state = self.mailbox.lock();
        loop {
            if state.ends {
                return None;
            }
            if let Some(first) = (0..state.waiting.len()).min_by_key(|index| state.waiting[*index].1.task() as usize) {
                let (number, request) = state.waiting.remove(first);
                let cancelled = Arc::<AtomicBool>::default();
                state.at_work = Some(AtWork { task: request.task(), cancelled: cancelled.clone() });
                return Some((number, request, cancelled));
            }
            state = self.mailbox.news.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Does the work of a request. Returns the reply, and the rest of the work.
    fn fulfil(&self, job: &WorkerJob, request: Request) -> stein::Result<(Reply, Option<Request>)> {
        let mut rest = request.after(1);
        let reply = match request {
            Request::Open(opening) => Reply::Opened(Box::new(match *opening {
                Opening::Frame(source) => open(job, *source)?,
                Opening::Together { files, reference, samples } => {
                    open_together(job, &files, reference.as_deref(), samples)?
                }
            })),
            Request::Inspect(question) => Reply::Inspected(Box::new(inspect(&self.gpu, job, question)?)),
            Request::Denoise { frame, reference, parameters } => {
                Reply::Denoised(Box::new(denoise(&self.gpu, job, &frame, reference.as_ref(), parameters)?))
            }
            Request::Adapt(mut adaptive) => {
                let adapted = adaptive.step(&self.gpu, job.pace(), &|share| job.check(share))?;
                rest = (!adapted.is_last).then_some(Request::Adapt(adaptive));
                Reply::Adapted(Box::new(adapted))
            }
            Request::Sweep { frame, reference, runs, next } => {
                let share = |share: f32| (next as f32 + share) / runs.len() as f32;
                Reply::Swept(Box::new(measure(&self.gpu, job, &frame, reference.as_ref(), runs[next], share)?))
            }
        };
        Ok((reply, rest))
    }
}

fn open(job: &WorkerJob, source: Source) -> stein::Result<Opened> {
    job.check(0.0)?;
    // The frame stays open if the user changes to NLM, which alone uses the halves of the layers that are denoised along.
    let request = BufferSetRequest { payload_halves: true, ..source.request.clone() };
    let mut set = BufferSet::read(&request).map_err(|error| error.in_file(&source.request.input))?;
    job.check(0.4)?;
    let input = InputFiles::new(&set);
    let (frame, repairs) = set.take_frame().map_err(|error| error.in_file(&source.request.input))?;
    let most = job.desk.gpu.wgpu_device().limits().max_texture_dimension_2d;
    if frame.extent().width.max(frame.extent().height) > most {
        return Err(Error::File {
            path: source.request.input.clone(),
            cause: FileCause::Other {
                problem: format!(
                    "it has {} pixels, and '{}' shows {most} along each side",
                    frame.extent(),
                    job.desk.gpu.summary().name
                ),
                remedy: "crop it, or choose another adapter; `stein denoise` takes it as it is".into(),
            },
        });
    }
    job.check(0.6)?;
    let reference = source.reference.as_ref();
    let reference = reference.map(|reference| set.read_reference(0, reference)).transpose()?.map(Arc::new);
    drop(set);
    job.check(0.8)?;
    let layers = input_layers(&frame, reference.as_ref());
    let noisy_error = relative_mse(&frame.color().mean, reference.as_ref());
    let name = source.name();
    let contradiction = frame.check_of_noise().contradiction();
    Ok(Opened {
        source: Some(source),
        input: Some(input),
        name,
        frame: Arc::new(frame),
        repairs,
        contradiction,
        left_out: None,
        reference,
        noisy_error,
        layers,
    })
}

/// Opens files that came together: the file that finds most of the others beside it, or else all of them as renders of
/// one frame with different seeds, or else the first file alone. [`Opened::left_out`] gives the reason if some file is
/// not open.
fn open_together(
    job: &WorkerJob,
    files: &[PathBuf],
    reference: Option<&Path>,
    samples: Option<u32>,
) -> stein::Result<Opened> {
    let source = |input: &Path, seeds: &[PathBuf]| Source {
        request: BufferSetRequest { input: input.to_owned(), seeds: seeds.to_vec(), samples, ..Default::default() },
        reference: reference.map(LayerRef::whole),
    };
    let Some((first, others)) = files.split_first() else { unreachable!("at least one file came") };
    if others.is_empty() {
        return open(job, source(first, &[]));
    }
    // Buffers of one frame have the same size as well, so that only their names tell them from seeds.
    let mut best: Option<(&Path, Vec<&PathBuf>)> = None;
    for input in files {
        job.check(0.0)?;
        let request = source(input, &[]).request;
        let Ok(set) = BufferSet::read(&request) else { continue };
        let found = InputFiles::new(&set);
        let is_left_out =
            |file: &&PathBuf| *file != input && !found.found(&request).any(|other| other == file.as_path());
        let left_out: Vec<_> = files.iter().filter(is_left_out).collect();
        let least = best.as_ref().map_or(others.len(), |(_, left_out)| left_out.len());
        if left_out.len() < least {
            best = Some((input, left_out));
        }
    }
    if let Some((input, left_out)) = best {
        let mut opened = open(job, source(input, &[]))?;
        let names: Vec<_> = left_out.into_iter().map(|file| short_name(file)).collect();
        opened.left_out = (!names.is_empty()).then(|| {
            Error::Request(RequestCause::Other {
                problem: format!(
                    "{} is open with the files that belong to it, left out: {}",
                    short_name(input),
                    names.join(", ")
                ),
                remedy: "drop seeds of one frame without other files".into(),
            })
        });
        return Ok(opened);
    }
    let reason = match open(job, source(first, others)) {
        Ok(opened) => match opened.contradiction {
            // Frames of a shot and views of a scene may be alike in everything but their content.
            Some(different @ Contradiction::HalvesTooDifferent { .. }) => Error::File {
                path: others[0].clone(),
                cause: FileCause::NotASeed { of: first.clone(), reason: different.to_string() },
            },
            _ => return Ok(opened),
        },
        Err(Error::Cancelled) => return Err(Error::Cancelled),
        Err(error) => error,
    };
    let mut opened = open(job, source(first, &[]))?;
    let told = words::told(&reason);
    let (problem, remedy) = told.split_once("\n  remedy: ").unwrap_or((&told, "open one file at a time"));
    opened.left_out = Some(Error::Request(RequestCause::Other {
        problem: format!("only {} is open: {problem}", short_name(first)),
        remedy: remedy.into(),
    }));
    Ok(opened)
}

fn inspect(gpu: &Gpu, job: &WorkerJob, question: Question) -> stein::Result<Inspected> {
    let denoiser = Denoiser::new(gpu, question.method)?;
    let [x, y] = question.pixel;
    // Keeps the same intermediates as the run that is looked at.
    let options = Options { keep: question.method.intermediates(), pace: Some(job.pace()), ..Default::default() };
    let kernels = denoiser.kernels(&question.frame, x, y, &options)?;
    Ok(Inspected::new(question, kernels))
}

fn denoise(
    gpu: &Gpu,
    job: &WorkerJob,
    frame: &Frame,
    reference: Option<&Arc<Image>>,
    parameters: Parameters,
) -> stein::Result<Denoised> {
    let start = Instant::now();
    job.check(0.0)?;
    gpu.set_timing(true);
    let denoiser = Denoiser::new(gpu, parameters.method)?;
    let mut progress = |share| job.progress(share);
    let options = Options {
        keep: parameters.method.intermediates(),
        progress: Some(&mut progress),
        pace: Some(job.pace()),
        ..Default::default()
    };
    let estimate = denoiser.denoise_with(frame, options)?;
    let seconds = start.elapsed().as_secs_f64();
    job.check(1.0)?;
    Denoised::new(&denoiser, parameters.preset, frame, estimate, reference, seconds)
}

/// Measures time and error of a run that makes the result and its estimated error, and keeps nothing else.
fn measure(
    gpu: &Gpu,
    job: &WorkerJob,
    frame: &Frame,
    reference: Option<&Arc<Image>>,
    parameters: Parameters,
    share: impl Fn(f32) -> f32,
) -> stein::Result<MeasuredRun> {
    job.check(share(0.0))?;
    gpu.set_timing(false);
    let denoiser = Denoiser::new(gpu, parameters.method)?;
    let run = |first: f32| {
        let start = Instant::now();
        let mut progress = |done: f32| job.progress(share(first + done / 2.0));
        let estimate = denoiser.denoise_with(
            frame,
            Options { progress: Some(&mut progress), pace: Some(job.pace()), ..Default::default() },
        )?;
        Ok::<_, Error>((estimate, start.elapsed()))
    };
    let (estimate, mut time) = run(0.0)?;
    if time < MEASURED_TWICE {
        time = time.min(run(0.5)?.1);
    }
    let (error, estimated_error) = (relative_mse(&estimate.color, reference), estimated_relative_mse(&estimate));
    Ok(MeasuredRun { parameters, seconds: time.as_secs_f64(), error, estimated_error })
}

/// Makes an error of a panic, which is a defect of this program: the window stays open and reports it.
fn defect(panic: &(dyn Any + Send)) -> Error {
    let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
    Error::Request(RequestCause::Other {
        problem: format!("the work ended with a panic: {}", text.unwrap_or("nothing is known of it")),
        remedy: "this is a defect of stein-viewer: please report it with the file that was open".into(),
    })
}
