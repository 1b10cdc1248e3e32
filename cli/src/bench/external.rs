//! Other denoisers, run as programs.

use std::ffi::OsString;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::process::{Command, Stdio};
use std::str::FromStr;
use std::time::Instant;

use stein::text;
use stein::{Extent, Image};
use stein_exr::read_reference;

use super::super::Failure;
use super::super::interrupt::Companion;
use super::super::template::fill;
use super::results;

/// Number of lines of a program's output that are kept for an error message.
const LINES: usize = 10;

/// Another denoiser, written `NAME=command {in} {out}`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct External {
    pub(super) name: String,
    command: String,
    words: Vec<String>,
}

impl FromStr for External {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let shape = "it must look like 'NAME=command {in} {out}'";
        let (name, command) = text.split_once('=').ok_or(shape)?;
        let (name, command) = (name.trim(), command.trim());
        let words = shell_words::split(command).map_err(|error| format!("{error} in: {command}"))?;
        if name.is_empty() || words.is_empty() {
            return Err(shape.into());
        }
        // The first word is the program, so that only the other words can name files.
        match ["{in}", "{out}"]
            .into_iter()
            .find(|placeholder| !words[1..].iter().any(|word| word.contains(placeholder)))
        {
            None => Ok(Self { name: name.to_owned(), command: command.to_owned(), words }),
            Some(missing) => Err(format!("the command does not say {missing}; {shape}")),
        }
    }
}

impl External {
    pub(super) fn described(&self) -> results::Configuration {
        results::Configuration {
            name: self.name.clone(),
            series: self.name.clone(),
            stein: None,
            command: Some(self.command.clone()),
        }
    }

    /// Runs the program on a file and returns the wall-clock time in seconds. The result is in `output` afterwards. No
    /// shell is used, so that a path is always one word.
    pub(super) fn run(&self, input: &Path, output: &Path) -> Result<f64, Failure> {
        let paths = [("{in}", input.as_os_str()), ("{out}", output.as_os_str())];
        let words: Vec<OsString> = self.words.iter().map(|word| fill(word, &paths)).collect();
        let failed = |how: String, said: &str| {
            let said = if said.is_empty() { "it said nothing".to_owned() } else { format!("it said:\n{said}") };
            let command = shell_words::join(words.iter().map(|word| text::path(Path::new(word))));
            Failure::input(format_args!(
                "--external {}: {how}: {command}\n  {said}\n  remedy: run the command by itself, as it stands here",
                self.name
            ))
        };
        // Removes the output of an earlier run, which must not be taken for the output of this one.
        match std::fs::remove_file(output) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(failed(format!("{} cannot be replaced ({error})", text::path(output)), ""));
            }
            _ => {}
        }
        // Standard error goes into a file, which never makes a program wait.
        let log = output.with_extension("log");
        let unusable = |error: std::io::Error| {
            Failure::output(format_args!(
                "{}: {error}\n  remedy: check the folder for temporary files",
                text::path(&log)
            ))
        };
        let stderr = File::create(&log).map_err(unusable)?;
        let start = Instant::now();
        let child =
            Command::new(&words[0]).args(&words[1..]).stdin(Stdio::null()).stdout(Stdio::null()).stderr(stderr).spawn();
        let ended = child.and_then(|mut child| {
            let _ends_with_this = Companion::of(&child);
            child.wait()
        });
        let seconds = start.elapsed().as_secs_f64();
        let status = ended.map_err(|error| failed(format!("cannot be run ({error})"), ""))?;
        let said = last_lines(&end_of(&log).map_err(unusable)?);
        if !status.success() {
            let code = status.code().map_or_else(|| status.to_string(), |code| format!("exit code {code}"));
            return Err(failed(format!("failed ({code})"), &said));
        }
        if output.is_file() { Ok(seconds) } else { Err(failed("did not write its output".into(), &said)) }
    }

    /// Reads the image that the program wrote.
    pub(super) fn read(&self, output: &Path, extent: Extent) -> Result<Image, Failure> {
        let failed = |problem: String| Failure::input(format_args!("--external {}: {problem}", self.name));
        let image = read_reference(output, None)
            .map_err(|error| Failure::input(error).at(format_args!("--external {}", self.name)))?;
        if image.extent == extent {
            return Ok(image);
        }
        Err(failed(format!(
            "its output is of {}, but the input of {extent}\n  remedy: let it keep the size of its input",
            image.extent
        )))
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
            let problem = text.parse::<External>().unwrap_err();
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
        assert!(external.run(&input, &output).unwrap() > 0.0);
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
        external.run(&input, &output).unwrap();
        assert_eq!(std::fs::read(&output).unwrap(), b"content");
        // Only the end of megabytes of messages is read.
        let external: External =
            "noise=sh -c 'head -c 9000000 /dev/zero >&2; echo the end >&2; exit 3' {in} {out}".parse().unwrap();
        let failure = external.run(&input, &output).unwrap_err();
        assert!(
            failure.message().contains("the end") && failure.message().len() < 1 << 17,
            "{}",
            failure.message().len()
        );
    }

    #[test]
    fn the_end_of_what_was_said_is_kept() {
        let text = (0..30).map(|line| format!("line {line}\n")).collect::<String>();
        let kept = last_lines(&text);
        assert!(kept.starts_with("    line 20\n") && kept.ends_with("    line 29"), "{kept}");
        assert_eq!(last_lines(""), "");
    }
}
