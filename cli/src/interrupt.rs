//! Ctrl-C and similar signals: the work ends where it stands, and no unfinished file is left.
//!
//! The first signal is a request: running work calls [`check`] between its steps and ends as on any failure. If the
//! work has not ended soon after (a step is long, a file is large, a renderer does not listen), or at a second signal,
//! unfinished files are removed and the process ends at once. In both cases the process ends by that signal, as its
//! parent expects: a shell reports 130, 143 or 129, and ends the loop that it was in.
//!
//! If memory runs out inside a library or a driver, the library aborts the process, and nobody can catch that as an
//! error. The signal of the abort can be caught: unfinished files are removed, a message tells what to do, and the
//! process ends with the exit code of a device that failed.
//! process ends with the exit code of a device that failed.

use std::process::Child;
use std::sync::atomic::{AtomicI32, AtomicU32, Ordering};
use std::time::Duration;

use super::Failure;

/// The first signal that came; 0 before any.
static SIGNAL: AtomicI32 = AtomicI32::new(0);

/// Process number of the program that is running; 0 without one. At most one program runs at a time.
static CHILD: AtomicU32 = AtomicU32::new(0);

/// Time that the work may take to end by itself.
const PATIENCE: Duration = Duration::from_millis(1500);

/// Whether a signal asked the work to end.
pub(crate) fn is_asked() -> bool {
    SIGNAL.load(Ordering::Relaxed) != 0
}

/// Fails if a signal asked the work to end.
pub(crate) fn check() -> Result<(), Failure> {
    if is_asked() { Err(Failure::other("interrupted")) } else { Ok(()) }
}

/// Registration of a program that ends with this one. Dropping it ends the registration.
pub(crate) struct Companion;

impl Companion {
    pub(crate) fn of(child: &Child) -> Self {
        CHILD.store(child.id(), Ordering::Relaxed);
        Self
    }
}

impl Drop for Companion {
    fn drop(&mut self) {
        CHILD.store(0, Ordering::Relaxed);
    }
}

/// Ends the process by the signal that asked for its end, if one did.
pub(crate) fn end_if_asked() {
    if is_asked() {
        end(SIGNAL.load(Ordering::Relaxed));
    }
}

/// Exit code if a library or a driver aborts: the code of a device that failed.
#[cfg(unix)]
const ABORTED: i32 = 4;

/// Ends a process in which a library or a driver aborts.
#[cfg(unix)]
fn give_up() -> ! {
    stein_exr::atomic_file::abandon();
    let problem = "no memory was left, or a library or driver gave up for another reason";
    let remedy = "crop the image, raise the limit on memory (`ulimit -v`, or the container's), or use a computer with \
                  more memory; where there is enough memory, report this with the output of `stein devices`";
    Failure::other(format_args!("{problem}\n  remedy: {remedy}")).tell();
    signal_hook::low_level::exit(ABORTED)
}

/// Records a signal. Gives the work time to end after the first signal, and ends the process at the second.
fn take(signal: i32) {
    if SIGNAL.compare_exchange(0, signal, Ordering::Relaxed, Ordering::Relaxed).is_err() {
        end(signal);
    }
    #[cfg(unix)]
    system::pass_on(signal);
    let in_time = std::thread::Builder::new().name("patience".into()).spawn(move || {
        std::thread::sleep(PATIENCE);
        end(signal);
    });
    if in_time.is_err() {
        end(signal);
    }
}

#[cfg(unix)]
mod system {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    use signal_hook::consts::{SIGABRT, SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
    use signal_hook::iterator::Signals;

    /// Starts to listen. Signals that the parent set to be ignored stay ignored, as under `nohup`.
    pub(crate) fn listen() {
        // A write beyond the limit on file sizes then fails, and is reported like a full disk.
        let _ = signal_hook::flag::register(SIGXFSZ, Arc::new(AtomicBool::new(false)));
        let (ready, is_ready) = std::sync::mpsc::channel();
        let listening = move || {
            let signals =
                Signals::new([SIGABRT, SIGHUP, SIGINT, SIGTERM].into_iter().filter(|signal| !is_ignored(*signal)));
            // The waiting thread need not know whether this succeeded.
            let _ = ready.send(());
            if let Ok(mut signals) = signals {
                signals
                    .forever()
                    .for_each(|signal| if signal == SIGABRT { super::give_up() } else { super::take(signal) });
            }
        };
        // Without the thread, the system's default applies, as nothing else handles signals: the process ends at once.
        if std::thread::Builder::new().name("signals".into()).spawn(listening).is_ok() {
            let _ = is_ready.recv();
            hold_aborts();
        }
    }

    /// Keeps a thread that aborts from ending the process before the listening thread ends it.
    #[expect(unsafe_code, reason = "few functions may be called in a handler of signals")]
    fn hold_aborts() {
        // SAFETY: a signal handler may sleep, and may end the process at once.
        let held = unsafe {
            signal_hook::low_level::register(SIGABRT, || {
                std::thread::sleep(super::PATIENCE);
                signal_hook::low_level::exit(super::ABORTED);
            })
        };
        // Without the handler, the process aborts as any other does.
        let _ = held;
    }

    #[expect(unsafe_code, reason = "there is no other way to ask")]
    fn is_ignored(signal: i32) -> bool {
        // SAFETY: without a new action, nothing is changed; the old one is plain data that the call fills.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            libc::sigaction(signal, std::ptr::null(), &mut action) == 0 && action.sa_sigaction == libc::SIG_IGN
        }
    }

    /// Passes a signal on to the program that is running. The terminal itself sends Ctrl-C to all its programs.
    pub(super) fn pass_on(signal: i32) {
        if signal != SIGINT {
            terminate_child();
        }
    }

    pub(super) fn end(signal: i32) -> ! {
        stein_exr::atomic_file::abandon();
        terminate_child();
        // Skips the exit handlers of drivers, which do not expect to run while other threads of theirs work.
        let _ = signal_hook::low_level::emulate_default_handler(signal);
        signal_hook::low_level::exit(128 + signal)
    }

    #[expect(unsafe_code, reason = "the standard library kills, but does not ask to end")]
    fn terminate_child() {
        let child = super::CHILD.load(Ordering::Relaxed);
        if child != 0 {
            // SAFETY: a call without pointers.
            unsafe {
                libc::kill(child as libc::pid_t, libc::SIGTERM);
            }
        }
    }
}

#[cfg(windows)]
mod system {
    /// Number of the signal of Ctrl-C, as on Unix.
    const INTERRUPT: i32 = 2;

    /// Starts to listen.
    pub(crate) fn listen() {
        // Without a handler, the system's default applies: the process ends at once.
        let _ = ctrlc::set_handler(|| super::take(INTERRUPT));
    }

    /// Ends the process. Programs that it started share the console, which sends them the signal.
    pub(super) fn end(signal: i32) -> ! {
        stein_exr::atomic_file::abandon();
        std::process::exit(128 + signal)
    }
}

use system::end;
pub(crate) use system::listen;
