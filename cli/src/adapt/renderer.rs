//! A renderer in another process.

use std::collections::VecDeque;
use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;

use stein::Extent;
use stein::error::{Error, FileCause, Result};
use stein::sampling::{Progress, SampleCounts, Sampler, Samples};
use stein::text;
use stein_exr::{BufferSet, BufferSetRequest};

use super::super::Failure;
use super::super::interrupt::Companion;
use super::super::progress::is_watched;

/// Number of lines of a command's output that are kept for an error message.
const LINES: usize = 10;

/// Purpose of a run of the command.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Turn {
    /// Iteration of the next call; each call adds 1.
    Iteration(u32),
    /// Even sampling; the number is passed to the command as its iteration.
    Uniform(u32),
}

/// Sampler that draws by running a command.
#[derive(Debug)]
pub(crate) struct Renderer<'a> {
    command: &'a str,
    extent: Extent,
    folder: &'a Path,
    turn: Turn,
    /// Whether the command's output is copied to standard error.
    talk: bool,
    /// Whether a warning is printed if the command draws another number of samples than the map asks for.
    warn: bool,
}

impl<'a> Renderer<'a> {
    /// Refuses a command without the placeholders `{map}` and `{out}`.
    pub(crate) fn check(command: &str) -> std::result::Result<(), Failure> {
        match ["{map}", "{out}"].into_iter().find(|placeholder| !command.contains(placeholder)) {
            None => Ok(()),
            Some(missing) => Err(Failure::usage(format_args!(
                "the sampler command does not say {missing}\
                 \n  remedy: let it read the map {{map}} and write the samples to {{out}}; see `stein adapt --help`"
            ))),
        }
    }

    /// Creates a renderer. The map of each iteration must be in `folder` before its samples are drawn.
    pub(crate) fn new(command: &'a str, extent: Extent, folder: &'a Path, turn: Turn, quiet: bool) -> Self {
        Self { command, extent, folder, turn, talk: !quiet && is_watched(), warn: !quiet }
    }

    fn file(&self, kind: &str) -> PathBuf {
        self.folder.join(match self.turn {
            Turn::Iteration(iteration) => format!("{kind}_{iteration}.exr"),
            Turn::Uniform(_) => format!("{kind}_uniform.exr"),
        })
    }

    fn run(&self, command: &OsStr) -> Result<()> {
        let told = text::path(Path::new(command));
        let failed = |how: String, said: &str| {
            let said = if said.is_empty() { "it said nothing".to_owned() } else { format!("it said:\n{said}") };
            Error::Renderer {
                problem: format!("the sampler command {how}: {told}\n  {said}"),
                remedy: "run the command by itself, as it stands here; then run `stein adapt` again with --resume"
                    .into(),
            }
        };
        let child = shell(command).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let mut child = child.map_err(|error| failed(format!("cannot be run ({error})"), ""))?;
        let _ends_with_this = Companion::of(&child);
        let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
        // Reads both pipes at the same time: a full pipe would block the command.
        let (stdout, stderr) = thread::scope(|scope| {
            let stdout = scope.spawn(|| last_lines(stdout, self.talk));
            let stderr = last_lines(stderr, self.talk);
            (stdout.join().unwrap_or_default(), stderr)
        });
        let status = child.wait().map_err(|error| failed(format!("was lost ({error})"), &stderr))?;
        let said = if stderr.is_empty() { &stdout } else { &stderr };
        if !status.success() {
            return Err(failed(format!("failed ({status})"), said));
        }
        let out = self.file("new");
        if out.exists() { Ok(()) } else { Err(failed(format!("did not write {}", text::path(&out)), said)) }
    }
}

impl Sampler for Renderer<'_> {
    fn extent(&self) -> Extent {
        self.extent
    }

    fn sample(&mut self, counts: &SampleCounts, _progress: Progress<'_>) -> Result<Samples> {
        let (map, out) = (self.file("map"), self.file("new"));
        let unusable = |problem: String, remedy: String| Error::File {
            path: out.clone(),
            cause: FileCause::Other { problem, remedy },
        };
        // Removes the output of an interrupted run, which must not be taken for the output of this one.
        match std::fs::remove_file(&out) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(unusable(
                    format!("cannot be replaced: {error}"),
                    "check that the folder may be written to".into(),
                ));
            }
            _ => {}
        }
        let (Turn::Iteration(iteration) | Turn::Uniform(iteration)) = self.turn;
        let (iteration, map, quoted_out) = (OsString::from(iteration.to_string()), quoted(&map), quoted(&out));
        self.run(&text::fill(self.command, &[("{map}", &map), ("{out}", &quoted_out), ("{iteration}", &iteration)]))?;
        let set = BufferSet::read(&BufferSetRequest { input: out.clone(), no_siblings: true, ..Default::default() })?;
        let samples = set.to_samples().map_err(|error| error.in_file(&out))?;
        if samples.extent() != self.extent {
            let problem = format!("is of {}, but the map of {}", samples.extent(), self.extent);
            return Err(unusable(problem, "let the renderer take its size from the map, or give --size".into()));
        }
        let (asked, drawn) = (counts.total_samples(), samples.counts().total_samples());
        if self.warn && asked != drawn {
            let out = text::path(&out);
            eprintln!("warning: {out}: holds {drawn} samples, but the map asks for {asked}; what was drawn counts");
        }
        self.turn = match self.turn {
            Turn::Iteration(iteration) => Turn::Iteration(iteration + 1),
            uniform @ Turn::Uniform(_) => uniform,
        };
        Ok(samples)
    }
}

#[cfg(not(windows))]
fn shell(command: &OsStr) -> Command {
    let mut shell = Command::new("sh");
    shell.arg("-c").arg(command);
    shell
}

#[cfg(windows)]
fn shell(command: &OsStr) -> Command {
    use std::os::windows::process::CommandExt;
    let mut shell = Command::new("cmd");
    // `cmd` takes everything between the first and the last quote as it is.
    let mut line = OsString::from("/S /C \"");
    line.push(command);
    line.push("\"");
    shell.raw_arg(line);
    shell
}

/// Quotes a path as one word for the shell.
#[cfg(unix)]
fn quoted(path: &Path) -> OsString {
    use std::os::unix::ffi::{OsStrExt, OsStringExt};
    let bytes = path.as_os_str().as_bytes();
    let parts: Vec<&[u8]> = bytes.split(|byte| *byte == b'\'').collect();
    OsString::from_vec([b"'", parts.join(&br"'\''"[..]).as_slice(), b"'"].concat())
}

/// Quotes a path as one word for the shell. The path itself contains no quotes.
#[cfg(not(unix))]
fn quoted(path: &Path) -> OsString {
    let mut quoted = OsString::from("\"");
    quoted.push(path);
    quoted.push("\"");
    quoted
}

/// Largest number of bytes of a line that are handled at once: a command may write endlessly without a line break.
const LINE_BYTES: u64 = 4096;

/// Reads the stream to its end and returns the last lines. Copies everything to standard error if `talk` is set.
fn last_lines(stream: Option<impl Read>, talk: bool) -> String {
    let mut lines = VecDeque::new();
    let Some(mut stream) = stream.map(BufReader::new) else {
        return String::new();
    };
    let mut line = Vec::new();
    while matches!(stream.by_ref().take(LINE_BYTES).read_until(b'\n', &mut line), Ok(bytes) if bytes > 0) {
        if talk {
            // Copies the bytes unchanged, with the command's progress bars and colours, to the user's terminal. Ignores
            // errors: the work goes on if nobody reads standard error any more.
            let _ = std::io::stderr().write_all(&line);
        }
        if lines.len() == LINES {
            lines.pop_front();
        }
        lines.push_back(format!("    {}", String::from_utf8_lossy(&line).trim_end()));
        line.clear();
    }
    lines.into_iter().collect::<Vec<_>>().join("\n")
}
