//! Text files that are read whole; names, paths, lists and numbers in messages; templates of commands.
//!
//! Names and paths come from outside and may hold anything: an escape sequence that moves the cursor, a line break that
//! forges a line. Messages show control characters escaped. Files and JSON keep them as they are.

mod template;

use std::borrow::Cow;
use std::fmt::Write;
use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::path::{Path, PathBuf};

use serde::Serializer;
pub use template::fill;

/// Number of entries that a message lists; it only counts the rest.
pub const LISTED: usize = 10;

/// Number of characters that a message shows of a name that is too long to be stored.
const BEGINNING: usize = 40;

/// Reads a text file of at most `most_bytes`. Pipes and devices are refused before they are opened: some never end, and
/// others would block.
///
/// # Errors
/// Errors of the file system; [`ErrorKind::InvalidInput`] for anything but a file, [`ErrorKind::FileTooLarge`] for a
/// file that is too large, [`ErrorKind::InvalidData`] for a file that is not UTF-8. All of them have a message in
/// words.
pub fn read_file(path: &Path, most_bytes: u64) -> Result<String> {
    let kind = path.metadata()?;
    if kind.is_dir() {
        return Err(Error::new(ErrorKind::InvalidInput, "it is a folder"));
    }
    if !kind.is_file() {
        return Err(Error::new(ErrorKind::InvalidInput, "it is a pipe or a device, and no file"));
    }
    let mut text = String::new();
    // The file may grow while it is read.
    File::open(path)?.take(most_bytes + 1).read_to_string(&mut text).map_err(|error| match error.kind() {
        ErrorKind::InvalidData => Error::new(ErrorKind::InvalidData, "it is no text in UTF-8"),
        _ => error,
    })?;
    if text.len() as u64 > most_bytes {
        let problem = format!("it is larger than {most_bytes} bytes, which no file of this kind is");
        return Err(Error::new(ErrorKind::FileTooLarge, problem));
    }
    Ok(text)
}

/// Formats a number of bytes for people, such as `1.5 GiB`.
pub fn human_bytes(bytes: u64) -> String {
    let units = ["B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB"];
    let mut value = bytes as f64;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < units.len() {
        value /= 1024.0;
        unit += 1;
    }
    if value.fract() < 0.05 { format!("{value:.0} {}", units[unit]) } else { format!("{value:.1} {}", units[unit]) }
}

/// Formats a number that may be anything from 10⁻⁶ to 10⁶, with four significant digits.
pub fn number(value: f64) -> String {
    match value.abs() {
        magnitude if magnitude == 0.0 || (1e-3..1e4).contains(&magnitude) => {
            let before = magnitude.max(1e-3).log10().floor() as i32;
            format!("{value:.*}", usize::try_from(3 - before).unwrap_or(0))
        }
        _ => format!("{value:.3e}"),
    }
}

/// Formats milliseconds for a column of their own, without the unit.
pub fn milliseconds(milliseconds: f64) -> String {
    let digits = if milliseconds < 10.0 { 3 } else { usize::from(milliseconds < 1000.0) };
    format!("{milliseconds:.digits$}")
}

/// Returns whether a terminal acts on the character, or hides the character or the order of its neighbours.
fn is_hidden(character: char) -> bool {
    let is_direction =
        matches!(character, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    character.is_control() || is_direction || matches!(character, '\u{2028}' | '\u{2029}')
}

fn escaped(text: &str, is_escaped: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_escaped) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len());
    for character in text.chars() {
        if is_escaped(character) {
            shown.extend(character.escape_default());
        } else {
            shown.push(character);
        }
    }
    Cow::Owned(shown)
}

/// Returns a name as one word of a message: control characters are escaped, line breaks among them.
pub fn name(text: &str) -> Cow<'_, str> {
    escaped(text, is_hidden)
}

/// Returns a whole message: control characters are escaped, except line breaks.
pub fn message(text: &str) -> Cow<'_, str> {
    escaped(text, |character| character != '\n' && is_hidden(character))
}

/// Returns a path as one word of a message, as [`name`]; bytes that are no Unicode become `\xff`.
pub fn path(path: &Path) -> String {
    let mut shown = String::new();
    for chunk in path.as_os_str().as_encoded_bytes().utf8_chunks() {
        shown += &name(chunk.valid());
        for byte in chunk.invalid() {
            // Writing to a string cannot fail.
            let _ = write!(shown, "\\x{byte:02x}");
        }
    }
    shown
}

/// Returns entries with commas between them: the first [`LISTED`], then the number of the others.
pub fn list(entries: impl IntoIterator<Item = impl AsRef<str>>) -> String {
    let (shown, more) = first(entries);
    let shown = shown.join(", ");
    if more > 0 { format!("{shown} and {more} more") } else { shown }
}

/// Returns entries with a line each: the first [`LISTED`], then the number of the others.
pub fn lines(entries: impl IntoIterator<Item = impl AsRef<str>>) -> Vec<String> {
    let (mut shown, more) = first(entries);
    shown.extend((more > 0).then(|| format!("  and {more} more")));
    shown
}

/// Returns the first entries, and the number of the others. If only one is left over, it is listed: it takes no more
/// room than its count.
fn first(entries: impl IntoIterator<Item = impl AsRef<str>>) -> (Vec<String>, usize) {
    let mut entries = entries.into_iter();
    let mut shown: Vec<String> = entries.by_ref().take(LISTED + 1).map(|entry| entry.as_ref().to_owned()).collect();
    let mut more = entries.count();
    if more > 0 {
        shown.truncate(LISTED);
        more += 1;
    }
    (shown, more)
}

/// Returns the beginning of a name that is too long, and its length in bytes.
pub fn beginning(text: &str, bytes: usize) -> String {
    let start: String = text.chars().take(BEGINNING).collect();
    format!("'{}…' ({bytes} bytes)", name(&start))
}

/// Serialises a path for a document: unchanged where it is Unicode, otherwise as [`path`] shows it.
///
/// # Errors
/// Errors of the serializer.
pub fn serialize_path<S: Serializer>(path: &Path, serializer: S) -> std::result::Result<S::Ok, S::Error> {
    match path.to_str() {
        Some(text) => serializer.serialize_str(text),
        None => serializer.serialize_str(&self::path(path)),
    }
}

/// As [`serialize_path`], for a path that may be missing.
///
/// # Errors
/// Errors of the serializer.
pub fn serialize_path_or_none<S: Serializer>(
    path: &Option<PathBuf>,
    serializer: S,
) -> std::result::Result<S::Ok, S::Error> {
    match path {
        Some(path) => serialize_path(path, serializer),
        None => serializer.serialize_none(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_small_text_files_are_read() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("text");
        std::fs::write(&file, "four").expect("a file");
        assert_eq!(read_file(&file, 4).expect("it fits"), "four");
        let kind = |path: &Path, most| read_file(path, most).map_err(|error| error.kind());
        assert_eq!(kind(&file, 3), Err(ErrorKind::FileTooLarge));
        assert_eq!(kind(folder.path(), 4), Err(ErrorKind::InvalidInput));
        std::fs::write(&file, b"\xff").expect("a file");
        assert_eq!(kind(&file, 4), Err(ErrorKind::InvalidData));
        #[cfg(unix)]
        assert_eq!(kind(Path::new("/dev/zero"), 4), Err(ErrorKind::InvalidInput));
    }

    #[test]
    fn what_a_terminal_would_obey_is_shown() {
        assert_eq!(name("Größe 深度.R"), "Größe 深度.R");
        assert_eq!(name("a\u{1b}[31mb\nc\u{9b}d\u{202e}e\u{7f}"), "a\\u{1b}[31mb\\nc\\u{9b}d\\u{202e}e\\u{7f}");
        assert_eq!(message("a\u{1b}\nb\r"), "a\\u{1b}\nb\\r");
        assert_eq!(path(Path::new("in\nout.exr")), "in\\nout.exr");
        #[cfg(unix)]
        {
            let bytes: std::ffi::OsString = std::os::unix::ffi::OsStringExt::from_vec(b"bad\xff\xfe\x07.exr".to_vec());
            assert_eq!(path(Path::new(&bytes)), "bad\\xff\\xfe\\u{7}.exr");
        }
    }

    #[test]
    fn numbers_have_four_significant_digits() {
        let numbers = [0.0, 0.001_234_6, 0.5, 12.346, 1234.6, -12.346, 12_345.6, 1e-6];
        let shown = ["0.000000", "0.001235", "0.5000", "12.35", "1235", "-12.35", "1.235e4", "1.000e-6"];
        assert_eq!(numbers.map(number), shown);
        assert_eq!([0.123_4, 12.346, 1234.6].map(milliseconds), ["0.123", "12.3", "1235"]);
        assert_eq!([1023, 1536, 160 << 20].map(human_bytes), ["1023 B", "1.5 KiB", "160 MiB"]);
    }

    #[test]
    fn long_lists_are_cut() {
        let names = |count: usize| (1..=count).map(|index| index.to_string()).collect::<Vec<_>>();
        assert_eq!(list(names(0)), "");
        assert_eq!(list(names(11)), "1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11", "the eleventh takes the room of its count");
        assert_eq!(list(names(12)), "1, 2, 3, 4, 5, 6, 7, 8, 9, 10 and 2 more");
        assert_eq!(lines(names(3900)).len(), 11);
        assert_eq!(lines(names(3900))[10], "  and 3890 more");
    }
}
