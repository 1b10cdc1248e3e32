//! Checks the head of an OpenEXR file, attribute by attribute, before a decoder reads it.
//!
//! The decoder trusts sizes, repairs what it should refuse (a window whose right edge lies left of its left one) and
//! says little about where a file ends. So the head is walked here first: memory is allocated only for bytes that
//! exist, never for what the head claims.

use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::ops::Range;

use crate::names::{LONGEST_NAME, decoded};
use stein::error::FileCause;
use stein::text;

/// The reason why a file cannot be read.
#[derive(Debug)]
pub(crate) struct Trouble(pub(crate) FileCause);

impl Trouble {
    pub(crate) fn damaged(problem: impl std::fmt::Display) -> Self {
        Self(FileCause::Damaged { reason: problem.to_string() })
    }

    fn with(what: impl Into<String>, form: &'static str) -> Self {
        Self(FileCause::Unsupported { what: what.into(), form })
    }

    pub(crate) fn unsupported(part: impl std::fmt::Display) -> Self {
        Self::with(format!("uses a part of OpenEXR ({part})"), "as a flat scan line image with ZIP compression")
    }

    pub(crate) fn subsampled() -> Self {
        Self::with(
            "has subsampled channels, probably luminance and chroma (Y, RY, BY)",
            "with R, G and B at full resolution",
        )
    }

    pub(crate) fn deep() -> Self {
        Self::with(
            "holds deep data, that is many samples per pixel at different depths",
            "as a flat image as well, or flatten it first (`oiiotool deep.exr --flatten -o flat.exr`): deep \
             compositing is out of scope",
        )
    }

    /// Returns the refusal of a name that no reader opens, so that it cannot be written either.
    fn long_name(what: &'static str, name: &[u8]) -> Self {
        let name = text::beginning(&decoded(name), name.len());
        Self(FileCause::LongName { what, name, most: LONGEST_NAME })
    }

    fn compressed(method: impl std::fmt::Display) -> Self {
        Self::with(
            format!("is compressed by {method}"),
            "with ZIP, PIZ or DWAA compression, or convert it, for example with \
             `exrmetrics --convert -z zip in.exr -o out.exr`",
        )
    }
}

impl From<std::io::Error> for Trouble {
    fn from(error: std::io::Error) -> Self {
        match error.kind() {
            std::io::ErrorKind::UnexpectedEof => Self::damaged("it ends too early"),
            _ => Self(FileCause::Unreadable { reason: error.to_string() }),
        }
    }
}

/// Largest side of an image in pixels: no film and no buffer is larger.
pub(crate) const MOST_PIXELS_PER_SIDE: usize = 1 << 20;

/// Largest number of channels. Renderers write hundreds; the names of all are compared with each other.
const MOST_CHANNELS: usize = 4096;

/// Largest number of attributes: far more than any file has, and few enough to be kept.
const MOST_ATTRIBUTES: usize = 1 << 16;

/// The longest name of an attribute, a type or a channel in a file without the flag for long names, in bytes.
const LONGEST_SHORT_NAME: usize = 31;

/// Bit of the flag for long names, in the byte behind the version.
const LONG_NAMES: u8 = 0x04;

/// Largest size in bytes of an attribute that means something to the decoder: a full list of channels. Others are
/// smaller.
const LONGEST_VALUE: u64 = MOST_CHANNELS as u64 * (LONGEST_NAME as u64 + 17);

/// Position of an attribute in its file.
#[derive(Clone, Debug)]
pub(crate) struct Attribute {
    name: Vec<u8>,
    kind: Vec<u8>,
    /// Bytes of the whole attribute, from its name on.
    whole: Range<u64>,
    value: Range<u64>,
}

/// The head of a file.
#[derive(Debug)]
pub(crate) struct Head {
    /// The attributes of each part, in the file's order.
    pub(crate) parts: Vec<Vec<Attribute>>,
    /// Position at which the offset tables begin.
    pub(crate) end: u64,
}

impl Head {
    /// Reads the head from one attribute to the next. `file_bytes` is the size of the file.
    pub(crate) fn read(file: &mut (impl BufRead + Seek), file_bytes: u64) -> Result<Self, Trouble> {
        let mut start = Vec::new();
        file.by_ref().take(8).read_to_end(&mut start)?;
        if start.is_empty() {
            return Err(Trouble(FileCause::Empty));
        }
        if !start.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
            return Err(Trouble(FileCause::UnknownFormat));
        }
        let Ok(start) = <[u8; 8]>::try_from(start) else {
            return Err(Trouble::damaged("it ends in its first eight bytes"));
        };
        let [.., version, flags, flags_above, flags_unused] = start;
        if version != 2 {
            return Err(Trouble::unsupported(format_args!("version {version} of the format")));
        }
        if flags & 0x08 != 0 {
            return Err(Trouble::deep());
        }
        if flags & 0xe1 != 0 || flags_above != 0 || flags_unused != 0 {
            return Err(Trouble::unsupported("flags that are not of version 2 of the format"));
        }
        let mut walk = Walk { file, at: 8, end: file_bytes, attributes: 0 };
        let mut parts = Vec::new();
        let many_parts = flags & 0x10 != 0;
        loop {
            let attributes = walk.part()?;
            // A part without attributes ends the list.
            if many_parts && attributes.is_empty() {
                break;
            }
            parts.push(attributes);
            if !many_parts {
                break;
            }
        }
        if parts.is_empty() {
            return Err(Trouble::damaged("it has no parts"));
        }
        let end = walk.at;
        Ok(Self { parts, end })
    }

    /// Refuses a head that the decoder would misread, or stumble over.
    pub(crate) fn check(&self, file: &mut (impl BufRead + Seek)) -> Result<(), Trouble> {
        let mut channels = 0;
        for part in &self.parts {
            for (index, attribute) in part.iter().enumerate() {
                let names = |name: &[u8], kind: &[u8]| attribute.name == name && attribute.kind == kind;
                let is_window = names(b"dataWindow", b"box2i") || names(b"displayWindow", b"box2i");
                let is_channels = names(b"channels", b"chlist");
                let (is_compression, is_type) = (names(b"compression", b"compression"), names(b"type", b"string"));
                if !(is_window || is_channels || is_compression || is_type) {
                    continue;
                }
                let name = shown(&attribute.name);
                if part[..index].iter().any(|before| before.name == attribute.name) {
                    return Err(Trouble::damaged(format_args!("its header gives '{name}' twice")));
                }
                let value = attribute.value(file)?;
                if is_window {
                    check_window(&name, &value)?;
                } else if is_channels {
                    channels += check_channels(&value)?.len();
                } else if is_compression {
                    check_compression(&value)?;
                } else if value.starts_with(b"deep") {
                    return Err(Trouble::deep());
                }
            }
        }
        if channels > MOST_CHANNELS {
            return Err(Trouble::unsupported(format_args!("it has {channels} channels, more than {MOST_CHANNELS}")));
        }
        Ok(())
    }

    /// Whether the name of an attribute, a type or a channel is so long that the file needs a flag.
    fn has_long_names(&self, file: &mut (impl BufRead + Seek)) -> Result<bool, Trouble> {
        for attribute in self.parts.iter().flatten() {
            let mut is_long = [&attribute.name, &attribute.kind].iter().any(|name| name.len() > LONGEST_SHORT_NAME);
            if attribute.name == b"channels" && attribute.kind == b"chlist" {
                let value = attribute.value(file)?;
                is_long |= check_channels(&value)?.iter().any(|name| name.len() > LONGEST_SHORT_NAME);
            }
            if is_long {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

/// Completes the head of a file that was just written. Sorts the attributes by name, so that the same image gives the
/// same file: the encoder leaves their order to chance. Sets the flag for long names also if only channels have them:
/// other readers refuse such names without the flag.
pub(crate) fn settle(file: &mut (impl Read + Write + Seek)) -> std::io::Result<()> {
    let bytes = file.seek(SeekFrom::End(0))?;
    file.rewind()?;
    let mut reader = BufReader::new(&mut *file);
    let failed = |trouble: Trouble| std::io::Error::other(trouble.0.to_string());
    let head = Head::read(&mut reader, bytes).map_err(failed)?;
    let has_long_names = head.has_long_names(&mut reader).map_err(failed)?;
    drop(reader);
    if has_long_names {
        let mut flags = [0];
        file.seek(SeekFrom::Start(5))?;
        file.read_exact(&mut flags)?;
        file.seek(SeekFrom::Start(5))?;
        file.write_all(&[flags[0] | LONG_NAMES])?;
    }
    for mut part in head.parts {
        let Some(start) = part.first().map(|attribute| attribute.whole.start) else { continue };
        part.sort_by(|a, b| a.name.cmp(&b.name));
        let mut sorted = Vec::new();
        for attribute in part {
            file.seek(SeekFrom::Start(attribute.whole.start))?;
            file.take(attribute.whole.end - attribute.whole.start).read_to_end(&mut sorted)?;
        }
        file.seek(SeekFrom::Start(start))?;
        file.write_all(&sorted)?;
    }
    Ok(())
}

impl Attribute {
    fn value(&self, file: &mut (impl BufRead + Seek)) -> Result<Vec<u8>, Trouble> {
        let bytes = self.value.end - self.value.start;
        if bytes > LONGEST_VALUE {
            return Err(Trouble::damaged(format_args!("'{}' in its header takes {bytes} bytes", shown(&self.name))));
        }
        file.seek(SeekFrom::Start(self.value.start))?;
        let mut value = vec![0; bytes as usize];
        file.read_exact(&mut value)?;
        Ok(value)
    }
}

struct Walk<'a, F> {
    file: &'a mut F,
    at: u64,
    end: u64,
    attributes: usize,
}

impl<F: BufRead + Seek> Walk<'_, F> {
    /// Reads the attributes up to the empty name that ends them.
    fn part(&mut self) -> Result<Vec<Attribute>, Trouble> {
        let mut attributes = Vec::new();
        loop {
            let start = self.at;
            let name = self.name()?;
            if name.is_empty() {
                return Ok(attributes);
            }
            self.attributes += 1;
            if self.attributes > MOST_ATTRIBUTES {
                return Err(Trouble::damaged(format_args!("its header has more than {MOST_ATTRIBUTES} attributes")));
            }
            let kind = self.name()?;
            let mut size = [0; 4];
            self.file.read_exact(&mut size).map_err(|error| self.ended(error))?;
            self.at += 4;
            let shown = shown(&name);
            let Ok(size) = u64::try_from(i32::from_le_bytes(size)) else {
                return Err(Trouble::damaged(format_args!("'{shown}' in its header has a negative size")));
            };
            let value = self.at..self.at + size;
            if value.end > self.end {
                return Err(Trouble::damaged(format_args!(
                    "it ends in its header, in '{shown}', which takes {size} bytes"
                )));
            }
            // A small step stays within the buffer.
            self.file.seek_relative(size as i64)?;
            self.at = value.end;
            attributes.push(Attribute { name, kind, whole: start..self.at, value });
        }
    }

    fn name(&mut self) -> Result<Vec<u8>, Trouble> {
        let mut name = Vec::new();
        self.file.by_ref().take(LONGEST_NAME as u64 + 1).read_until(0, &mut name)?;
        self.at += name.len() as u64;
        match name.pop() {
            Some(0) => Ok(name),
            Some(_) if name.len() == LONGEST_NAME => {
                let start: String = decoded(&name).chars().take(40).collect();
                let start = text::name(&start);
                let problem =
                    format_args!("its header has a name that does not end within {LONGEST_NAME} bytes, '{start}…'");
                Err(Trouble::damaged(problem))
            }
            _ => Err(self.ended(std::io::ErrorKind::UnexpectedEof.into())),
        }
    }

    fn ended(&self, error: std::io::Error) -> Trouble {
        match error.kind() {
            std::io::ErrorKind::UnexpectedEof => Trouble::damaged("it ends in its header"),
            _ => error.into(),
        }
    }
}

/// Formats a name from a file for a message.
pub(crate) fn shown(stored: &[u8]) -> String {
    text::name(&decoded(stored)).into_owned()
}

/// Checks a window. Both corners belong to the window, so that a valid window has at least one pixel.
fn check_window(name: &str, value: &[u8]) -> Result<(), Trouble> {
    let (corners, []) = value.as_chunks::<4>() else {
        return Err(Trouble::damaged(format_args!("'{name}' is no window")));
    };
    let corners: Vec<i64> = corners.iter().map(|corner| i32::from_le_bytes(*corner).into()).collect();
    let &[left, top, right, bottom] = corners.as_slice() else {
        return Err(Trouble::damaged(format_args!("'{name}' is no window")));
    };
    let (width, height) = (right - left + 1, bottom - top + 1);
    if width < 1 || height < 1 {
        return Err(Trouble::damaged(format_args!(
            "'{name}' goes from ({left}, {top}) to ({right}, {bottom}), which is no pixel"
        )));
    }
    let most = MOST_PIXELS_PER_SIDE as i64;
    if name == "dataWindow" && (width > most || height > most) {
        return Err(Trouble::damaged(format_args!("its header claims {width}×{height} pixels")));
    }
    Ok(())
}

/// Returns the names of all channels. The list holds, for each channel, a name, a type, four bytes, and the steps in x
/// and y at which there are samples.
fn check_channels(value: &[u8]) -> Result<Vec<&[u8]>, Trouble> {
    let mut rest = value;
    let mut names: Vec<&[u8]> = Vec::new();
    while let Some(end) = rest.iter().position(|byte| *byte == 0) {
        if end == 0 {
            return Ok(names);
        }
        let name = &rest[..end];
        if name.len() > LONGEST_NAME {
            return Err(Trouble::long_name("channel", name));
        }
        // The decoder makes sure that the names are sorted.
        if names.last() == Some(&name) {
            return Err(Trouble::damaged(format_args!("its list of channels has '{}' twice", shown(name))));
        }
        names.push(name);
        let Some((fields, behind)) = rest[end + 1..].split_first_chunk::<16>() else { break };
        if fields[8..] != [1, 0, 0, 0, 1, 0, 0, 0] {
            return Err(Trouble::subsampled());
        }
        rest = behind;
    }
    Err(Trouble::damaged("its list of channels does not end"))
}

fn check_compression(value: &[u8]) -> Result<(), Trouble> {
    match value {
        [0..=9] => Ok(()),
        [10 | 11] => Err(Trouble::compressed("HTJ2K (high-throughput JPEG 2000)")),
        [12] => Err(Trouble::compressed("ZSTD")),
        [other] => Err(Trouble::compressed(format_args!("an unknown method (number {other})"))),
        _ => Err(Trouble::damaged("its compression is no number")),
    }
}
