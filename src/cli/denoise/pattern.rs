//! Paths with a place for the frame number.

use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf, is_separator};

use crate::cli::Failure;

/// `shot.####.exr` or `shot.%04d.exr`: as many digits as `#`, or as the number says, and more where the frame number has more. The last such place in the path counts,
/// in a file's or a folder's name; others are taken literally.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pattern {
    before: String,
    digits: usize,
    after: String,
}

impl Pattern {
    /// `None` where the path has no place for a number.
    pub(super) fn parse(path: &Path) -> Option<Self> {
        let text = path.to_str()?;
        let (place, digits) = hashes(text).into_iter().chain(printf(text)).max_by_key(|(place, _)| place.end)?;
        Some(Self { before: text[..place.start].to_owned(), digits, after: text[place.end..].to_owned() })
    }

    /// As [`Self::parse`], but `None` for a file of exactly this name.
    pub(super) fn of_input(path: &Path) -> Option<Self> {
        if path.exists() { None } else { Self::parse(path) }
    }

    /// The path of one frame.
    pub(super) fn path(&self, frame: u32) -> PathBuf {
        let Self { before, digits, after } = self;
        format!("{before}{frame:0digits$}{after}").into()
    }

    /// The frames that exist, in ascending order.
    pub(super) fn frames_on_disk(&self) -> Result<BTreeSet<u32>, Failure> {
        let name = self.before.rfind(is_separator).map_or(0, |separator| separator + 1);
        let (folder, before) = self.before.split_at(name);
        let folder = Path::new(if folder.is_empty() { "." } else { folder });
        let after = self.after.split(is_separator).next().unwrap_or_default();
        let entries = folder
            .read_dir()
            .map_err(|error| Failure::input(format_args!("{}: cannot be listed: {error}\n  remedy: check the path of the pattern", folder.display())))?;
        let number = |name: &str| {
            let digits = name.strip_prefix(before)?.strip_suffix(after)?;
            if digits.bytes().all(|byte| byte.is_ascii_digit()) { digits.parse().ok() } else { None }
        };
        let frames = entries.flatten().filter_map(|entry| number(entry.file_name().to_str()?));
        // Other numbers of digits are other files.
        Ok(frames.filter(|&frame| self.path(frame).exists()).collect())
    }
}

/// The last run of `#`.
fn hashes(text: &str) -> Option<(Range<usize>, usize)> {
    let end = text.rfind('#')? + 1;
    let start = text[..end].trim_end_matches('#').len();
    Some((start..end, end - start))
}

/// The last `%d` or `%0Nd`.
fn printf(text: &str) -> Option<(Range<usize>, usize)> {
    let place = |(start, _)| {
        let rest: &str = &text[start + 1..];
        let width = rest.len() - rest.trim_start_matches(|character: char| character.is_ascii_digit()).len();
        let digits = match &rest[..width] {
            "" => 1,
            width if width.starts_with('0') => width.parse().ok().filter(|digits| (1..=20).contains(digits))?,
            // Padded with spaces.
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
        ] {
            assert_eq!(Pattern::parse(Path::new(pattern)).map(|pattern| pattern.path(frame)), Some(PathBuf::from(path)), "{pattern}");
        }
        for path in ["shot.0001.exr", "100%.exr", "%4d.exr", "%0d.exr", "%0", "%"] {
            assert_eq!(Pattern::parse(Path::new(path)), None, "{path}");
        }
    }
}
