//! Paths with a placeholder for the frame number.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf};

use stein::text;

use crate::Failure;

/// A path with a placeholder, such as `shot.####.exr` or `shot.%04d.exr`. The frame number gets as many digits as there
/// are `#`, or as `%04d` says, and more if it needs them. Only the last placeholder counts: in the file's name, or else
/// in the name of a folder that does not exist. Others are taken literally.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pattern {
    /// Folder of the name with the placeholder, as it was written.
    folder: PathBuf,
    /// Part of that name before the placeholder; `after` is the part behind it.
    before: String,
    digits: usize,
    after: String,
    /// Rest of the path inside the numbered folder; empty if the placeholder is in the file's name.
    below: PathBuf,
}

impl Pattern {
    /// Parses a path; `None` without a placeholder.
    pub(super) fn parse(path: &Path) -> Option<Self> {
        path.ancestors().find_map(|named| {
            let name = named.file_name()?.to_str()?;
            let (place, digits) = hashes(name).into_iter().chain(printf(name)).max_by_key(|(place, _)| place.end)?;
            let below = path.strip_prefix(named).ok()?.to_owned();
            if !below.as_os_str().is_empty() && named.exists() {
                return None;
            }
            let folder = named.parent().unwrap_or(Path::new("")).to_owned();
            Some(Self {
                folder,
                before: name[..place.start].to_owned(),
                digits,
                after: name[place.end..].to_owned(),
                below,
            })
        })
    }

    /// Parses a path as [`Self::parse`] does, but returns `None` for a path that exists.
    pub(super) fn of_input(path: &Path) -> Option<Self> {
        if path.exists() { None } else { Self::parse(path) }
    }

    /// Returns the path of one frame.
    pub(super) fn path(&self, frame: u32) -> PathBuf {
        let Self { folder, before, digits, after, below } = self;
        let named = folder.join(format!("{before}{frame:0digits$}{after}"));
        if below.as_os_str().is_empty() { named } else { named.join(below) }
    }

    /// Returns the frames that exist, in ascending order.
    pub(super) fn frames_on_disk(&self) -> Result<BTreeSet<u32>, Failure> {
        let folder = if self.folder.as_os_str().is_empty() { Path::new(".") } else { &self.folder };
        let entries = folder.read_dir().map_err(|error| {
            let folder = text::path(folder);
            Failure::input(format_args!("{folder}: cannot be listed: {error}\n  remedy: check the path of the pattern"))
        })?;
        let number = |name: &str| {
            let digits = name.strip_prefix(self.before.as_str())?.strip_suffix(self.after.as_str())?;
            if digits.bytes().all(|byte| byte.is_ascii_digit()) { digits.parse().ok() } else { None }
        };
        let frames = entries.flatten().filter_map(|entry| number(entry.file_name().to_str()?));
        // A file with another number of digits is not the file of that frame.
        Ok(frames.filter(|&frame| self.path(frame).exists()).collect())
    }
}

/// Finds the last run of `#`: its range and its length.
fn hashes(text: &str) -> Option<(Range<usize>, usize)> {
    let end = text.rfind('#')? + 1;
    let start = text[..end].trim_end_matches('#').len();
    Some((start..end, end - start))
}

/// Finds the last `%d` or `%0Nd`: its range and the number of digits.
fn printf(text: &str) -> Option<(Range<usize>, usize)> {
    let place = |(start, _)| {
        let rest: &str = &text[start + 1..];
        let width = rest.len() - rest.trim_start_matches(|character: char| character.is_ascii_digit()).len();
        let digits = match &rest[..width] {
            "" => 1,
            width if width.starts_with('0') => width.parse().ok().filter(|digits| (1..=20).contains(digits))?,
            // `%4d` would pad with spaces.
            _ => return None,
        };
        rest[width..].starts_with('d').then_some((start..start + width + 2, digits))
    };
    text.rmatch_indices('%').find_map(place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_has_one_place_for_the_number() {
        for (pattern, frame, path) in [
            ("shot.####.exr", 7, "shot.0007.exr"),
            ("shot.####.exr", 12345, "shot.12345.exr"),
            ("shot.%04d.exr", 7, "shot.0007.exr"),
            ("shot_%d.exr", 12, "shot_12.exr"),
            ("frame#/spp16/input.exr", 3, "frame3/spp16/input.exr"),
            ("take#2/shot.##.exr", 3, "take#2/shot.03.exr"),
            ("take#2/shot.%02d.exr", 3, "take#2/shot.03.exr"),
            ("100%/%03d.#.exr", 3, "100%/%03d.3.exr"),
            ("größe.###.exr", 3, "größe.003.exr"),
            ("my shot v2 #3.%04d.exr", 3, "my shot v2 #3.0003.exr"),
            ("./a//shot.#.exr", 3, "./a//shot.3.exr"),
            ("/#/shot.exr", 3, "/3/shot.exr"),
        ] {
            assert_eq!(
                Pattern::parse(Path::new(pattern)).map(|pattern| pattern.path(frame)),
                Some(PathBuf::from(path)),
                "{pattern}"
            );
        }
        for path in ["shot.0001.exr", "100%.exr", "%4d.exr", "%0d.exr", "%0", "%", "", "/", ".."] {
            assert_eq!(Pattern::parse(Path::new(path)), None, "{path}");
        }
    }

    #[test]
    #[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
    fn a_folder_that_exists_is_that_folder() {
        let folder = tempfile::tempdir().unwrap();
        let inside = |path: &str| folder.path().join(path);
        for name in ["show #3", "50%d"] {
            std::fs::create_dir(inside(name)).unwrap();
            assert_eq!(Pattern::parse(&inside(&format!("{name}/in.exr"))), None);
            let shot = Pattern::parse(&inside(&format!("{name}/in.##.exr"))).unwrap();
            assert_eq!(shot.path(7), inside(&format!("{name}/in.07.exr")));
            std::fs::write(shot.path(7), "").unwrap();
            assert_eq!(shot.frames_on_disk().unwrap(), BTreeSet::from([7]));
        }
        // The folders of the frames are inside a folder whose name looks like a pattern.
        let shot = Pattern::parse(&inside("show #3/##/in.exr")).unwrap();
        assert_eq!(shot.path(7), inside("show #3/07/in.exr"));
        std::fs::write(inside("take#.exr"), "").unwrap();
        assert_eq!(Pattern::of_input(&inside("take#.exr")), None);
    }
}
