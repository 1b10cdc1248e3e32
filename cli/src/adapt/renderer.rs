//! A renderer in another process.

use std::collections::VecDeque;
use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;

use stein::Extent;
use stein::error::{Error, Result};
use stein::sampling::{Progress, SampleCounts, Sampler, Samples};
use stein::text;
use stein_exr::{BufferSet, BufferSetRequest};

use super::super::Failure;
use super::super::interrupt::Companion;
use super::super::progress::is_watched;
use super::super::template::fill;

/// How much of what a command said is kept for an error message.
const LINES: usize = 10;

/// What a command is run for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Turn {
    /// The next call is for this iteration, and so on.
    Iteration(u32),
    /// Even sampling, with this for the number of the iteration.
    Uniform(u32),
}

/// Draws samples by a command.
#[derive(Debug)]
pub(crate) struct Renderer<'a> {
    command: &'a str,
    extent: Extent,
    folder: &'a Path,
    turn: Turn,
    /// Passes on what the command says.
    talk: bool,
    /// Tells what looks wrong and is not.
    warn: bool,
}

impl<'a> Renderer<'a> {
    /// Whether a command can do its work.
    pub(crate) fn check(command: &str) -> std::result::Result<(), Failure> {
        match ["{map}", "{out}"].into_iter().find(|placeholder| !command.contains(placeholder)) {
            None => Ok(()),
            Some(missing) => Err(Failure::usage(format_args!(
                "the sampler command does not say {missing}\n  remedy: let it read the map {{map}} and write the samples to {{out}}; see `stein adapt --help`"
            ))),
        }
    }

    /// Finds the maps in `folder`, where they must be before they are drawn.
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
        // Both at once: a full pipe would make the command wait.
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
        let unusable = |problem: String, remedy: String| Error::File { path: out.clone(), problem, remedy };
        // What an interrupted run left must not be taken for an answer.
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
        self.run(&fill(self.command, &[("{map}", &map), ("{out}", &quoted_out), ("{iteration}", &iteration)]))?;
        let set = BufferSet::read(&BufferSetRequest { input: out.clone(), ..Default::default() })?;
        let samples = set.to_samples().map_err(|error| match error {
            Error::Request { problem, remedy } => unusable(problem, remedy),
            error => error,
        })?;
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

/// A path as one word for the shell.
#[cfg(unix)]
fn quoted(path: &Path) -> OsString {
    use std::os::unix::ffi::{OsStrExt, OsStringExt};
    let bytes = path.as_os_str().as_bytes();
    let parts: Vec<&[u8]> = bytes.split(|byte| *byte == b'\'').collect();
    OsString::from_vec([b"'", parts.join(&br"'\''"[..]).as_slice(), b"'"].concat())
}

/// A path as one word for the shell; it holds no quotes.
#[cfg(not(unix))]
fn quoted(path: &Path) -> OsString {
    let mut quoted = OsString::from("\"");
    quoted.push(path);
    quoted.push("\"");
    quoted
}

/// Bytes of a line that are looked at as one: a command may write without end and never end a line.
const LINE_BYTES: u64 = 4096;

/// Reads to the end and keeps the last lines.
fn last_lines(stream: Option<impl Read>, talk: bool) -> String {
    let mut lines = VecDeque::new();
    let Some(mut stream) = stream.map(BufReader::new) else {
        return String::new();
    };
    let mut line = Vec::new();
    while matches!(stream.by_ref().take(LINE_BYTES).read_until(b'\n', &mut line), Ok(bytes) if bytes > 0) {
        if talk {
            // As the command wrote it, progress bars and colours among it: it has the terminal of whoever named it.
            // Where nobody listens any more, the work goes on.
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
