//! Other denoisers, run as programs.

use std::ffi::OsString;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Stdio};
use std::str::FromStr;
use std::time::Instant;

use stein::{Extent, Image, text};
use stein_exr::read_reference;

use crate::observer::Observer;
use crate::{Configuration, Error, Result};

/// Number of lines of a program's output that are kept for an error message.
const LINES: usize = 10;

/// Another denoiser, written `NAME=command {in} {out}`.
#[derive(Clone, Debug, PartialEq)]
pub struct External {
    pub(crate) name: String,
    command: String,
    words: Vec<String>,
}

/// The reason why a text names no other denoiser.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExternalSyntax {
    /// The name or the command is missing.
    #[error("it must look like 'NAME=command {{in}} {{out}}'")]
    Shape,
    /// The command cannot be split into words.
    #[error("{reason} in: {command}")]
    Words {
        /// What is wrong.
        reason: String,
        /// The command.
        command: String,
    },
    /// A placeholder is missing.
    #[error("the command does not say {placeholder}; {shape}", shape = Self::Shape)]
    Placeholder {
        /// The placeholder, with its braces.
        placeholder: &'static str,
    },
}

/// The reason why another denoiser has no result.
#[derive(Debug, thiserror::Error)]
pub enum ExternalCause {
    /// The program does not run or fails.
    #[error("{end}: {command}\n  {}", if said.is_empty() { "it said nothing".to_owned() } else { format!("it said:\n{said}") })]
    Program {
        /// How the program ended.
        end: ExternalEnd,
        /// Command that ran, as one types it into a shell.
        command: String,
        /// Last lines that the program wrote to standard error, indented.
        said: String,
    },
    /// The output cannot be read.
    #[error("{}", .0.problem())]
    Unreadable(stein::Error),
    /// The output has another size than the input.
    #[error("its output is of {output}, but the input of {input}")]
    OtherExtent {
        /// Size of the output.
        output: Extent,
        /// Size of the input.
        input: Extent,
    },
}

/// How another denoiser ended.
#[derive(Debug, thiserror::Error)]
pub enum ExternalEnd {
    /// The output of an earlier run cannot be removed.
    #[error("{} cannot be replaced ({error})", text::path(output))]
    NotReplaced {
        /// The output.
        output: PathBuf,
        /// Error of the system.
        error: std::io::Error,
    },
    /// The program cannot be started.
    #[error("cannot be run ({0})")]
    NotStarted(std::io::Error),
    /// The program reports a failure.
    #[error("failed ({})", .0.code().map_or_else(|| .0.to_string(), |code| format!("exit code {code}")))]
    Failed(ExitStatus),
    /// The program reports success, but there is no output.
    #[error("did not write its output")]
    NoOutput,
}

impl FromStr for External {
    type Err = ExternalSyntax;

    fn from_str(text: &str) -> std::result::Result<Self, ExternalSyntax> {
        let (name, command) = text.split_once('=').ok_or(ExternalSyntax::Shape)?;
        let (name, command) = (name.trim(), command.trim());
        let words = shell_words::split(command)
            .map_err(|error| ExternalSyntax::Words { reason: error.to_string(), command: command.to_owned() })?;
        if name.is_empty() || words.is_empty() {
            return Err(ExternalSyntax::Shape);
        }
        // The first word is the program, so that only the other words can name files.
        match ["{in}", "{out}"]
            .into_iter()
            .find(|placeholder| !words[1..].iter().any(|word| word.contains(placeholder)))
        {
            None => Ok(Self { name: name.to_owned(), command: command.to_owned(), words }),
            Some(placeholder) => Err(ExternalSyntax::Placeholder { placeholder }),
        }
    }
}

impl External {
    pub(crate) fn described(&self) -> Configuration {
        Configuration {
            name: self.name.clone(),
            series: self.name.clone(),
            stein: None,
            command: Some(self.command.clone()),
        }
    }

    /// Runs the program on a file and returns the wall-clock time in seconds. The result is in `output` afterwards. No
    /// shell is used, so that a path is always one word.
    pub(crate) fn run(&self, input: &Path, output: &Path, observer: &mut dyn Observer) -> Result<f64> {
        let paths = [("{in}", input.as_os_str()), ("{out}", output.as_os_str())];
        let words: Vec<OsString> = self.words.iter().map(|word| text::fill(word, &paths)).collect();
        let failed = |end: ExternalEnd, said: String| {
            let command = shell_words::join(words.iter().map(|word| text::path(Path::new(word))));
            self.failed(ExternalCause::Program { end, command, said })
        };
        // Removes the output of an earlier run, which must not be taken for the output of this one.
        match std::fs::remove_file(output) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(failed(ExternalEnd::NotReplaced { output: output.to_owned(), error }, String::new()));
            }
            _ => {}
        }
        // Standard error goes into a file, which never makes a program wait.
        let log = output.with_extension("log");
        let unusable = |error: std::io::Error| Error::Log { path: log.clone(), error };
        let stderr = File::create(&log).map_err(unusable)?;
        let start = Instant::now();
        let child =
            Command::new(&words[0]).args(&words[1..]).stdin(Stdio::null()).stdout(Stdio::null()).stderr(stderr).spawn();
        let ended = child.and_then(|mut child| {
            observer.program_started(&child);
            let status = child.wait();
            observer.program_ended();
            status
        });
        let seconds = start.elapsed().as_secs_f64();
        let status = ended.map_err(|error| failed(ExternalEnd::NotStarted(error), String::new()))?;
        let said = last_lines(&end_of(&log).map_err(unusable)?);
        if !status.success() {
            return Err(failed(ExternalEnd::Failed(status), said));
        }
        if output.is_file() { Ok(seconds) } else { Err(failed(ExternalEnd::NoOutput, said)) }
    }

    /// Reads the image that the program wrote.
    pub(crate) fn read(&self, output: &Path, extent: Extent) -> Result<Image> {
        let image = read_reference(output, None).map_err(|error| self.failed(ExternalCause::Unreadable(error)))?;
        if image.extent == extent {
            return Ok(image);
        }
        Err(self.failed(ExternalCause::OtherExtent { output: image.extent, input: extent }))
    }

    fn failed(&self, cause: ExternalCause) -> Error {
        Error::External { name: self.name.clone(), cause: Box::new(cause) }
    }
}

/// Reads the end of a file, however large the file is.
fn end_of(path: &Path) -> std::io::Result<String> {
    const BYTES: u64 = 1 << 16;
    let mut file = File::open(path)?;
    let bytes = file.metadata()?.len();
    file.seek(SeekFrom::Start(bytes.saturating_sub(BYTES)))?;
    let mut end = Vec::new();
    file.take(BYTES).read_to_end(&mut end)?;
    Ok(String::from_utf8_lossy(&end).into_owned())
}

fn last_lines(text: &str) -> String {
    let lines: Vec<&str> = text.trim_end().lines().collect();
    let last = &lines[lines.len().saturating_sub(LINES)..];
    last.iter().map(|line| format!("    {line}")).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_split_into_words_as_a_shell_would() {
        let external: External = "my tool=tool --in={in} 'two words' \"{out}\"".parse().unwrap();
        assert_eq!(
            (external.name.as_str(), external.words),
            ("my tool", ["tool", "--in={in}", "two words", "{out}"].map(String::from).to_vec())
        );
        for (text, missing) in [
            ("tool {in} {out}", "NAME="),
            ("a=tool {in}", "{out}"),
            ("a=tool {out}", "{in}"),
            ("a='tool {in} {out}", "quote"),
            ("=x {in} {out}", "NAME"),
        ] {
            let problem = text.parse::<External>().unwrap_err().to_string();
            assert!(problem.contains(missing), "{text}: {problem}");
        }
    }

    #[test]
    #[cfg(unix)]
    fn paths_are_never_read_as_commands() {
        let folder = tempfile::tempdir().unwrap();
        let input = folder.path().join("a; touch b $(touch c) 'd.exr");
        std::fs::write(&input, "content").unwrap();
        let output = folder.path().join("out.exr");
        let external: External = "copy=cp {in} {out}".parse().unwrap();
        assert!(external.run(&input, &output, &mut ()).unwrap() > 0.0);
        assert_eq!(std::fs::read(&output).unwrap(), b"content");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "the input, the output and its log");
    }

    #[test]
    #[cfg(unix)]
    fn a_placeholder_in_a_path_is_a_part_of_the_path() {
        let folder = tempfile::tempdir().unwrap();
        let (input, output) = (folder.path().join("a{out}.exr"), folder.path().join("b{in}.exr"));
        std::fs::write(&input, "content").unwrap();
        let external: External = "copy=cp {in} {out}".parse().unwrap();
        external.run(&input, &output, &mut ()).unwrap();
        assert_eq!(std::fs::read(&output).unwrap(), b"content");
        // Only the end of megabytes of messages is read.
        let external: External =
            "noise=sh -c 'head -c 9000000 /dev/zero >&2; echo the end >&2; exit 3' {in} {out}".parse().unwrap();
        let message = external.run(&input, &output, &mut ()).unwrap_err().to_string();
        assert!(message.contains("the end") && message.len() < 1 << 17, "{}", message.len());
    }

    #[test]
    fn the_end_of_what_was_said_is_kept() {
        let text = (0..30).map(|line| format!("line {line}\n")).collect::<String>();
        let kept = last_lines(&text);
        assert!(kept.starts_with("    line 20\n") && kept.ends_with("    line 29"), "{kept}");
        assert_eq!(last_lines(""), "");
    }
}
