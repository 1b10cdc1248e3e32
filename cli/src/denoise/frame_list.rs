//! `--frames`

use std::collections::BTreeSet;
use std::str::FromStr;

/// Largest number of frames: far more than a shot has, so that a typing error cannot fill the memory.
const MOST_FRAMES: usize = 1_000_000;

/// Numbers of frames, each once and in ascending order, from a list such as `1-10,20-40x5,55`. A step may also follow a
/// colon, as in Open Job Description.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FrameList(pub(super) BTreeSet<u32>);

impl FromStr for FrameList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut frames = BTreeSet::new();
        for item in text.split(',') {
            let (first, last, step) = parts(item.trim())?;
            if first > last {
                return Err(format!("'{item}' runs backwards: give the lower number first"));
            }
            for frame in (first..=last).step_by(step) {
                frames.insert(frame);
                if frames.len() > MOST_FRAMES {
                    return Err(format!("these are more than {MOST_FRAMES} frames"));
                }
            }
        }
        Ok(Self(frames))
    }
}

/// Parses first, last and step of `7`, `1-10`, `1-9x2` or `1-9:2`.
fn parts(item: &str) -> Result<(u32, u32, usize), String> {
    if item.starts_with('-') {
        return Err(format!("'{item}' is negative: frames are numbered from 0 up"));
    }
    let wrong = || format!("'{item}' must look like 7, 1-10 or 1-9x2");
    let number = |text: &str| text.trim().parse::<u32>().map_err(|_| wrong());
    let Some((first, rest)) = item.split_once('-') else {
        return number(item).map(|frame| (frame, frame, 1));
    };
    let (last, step) = rest.split_once(['x', 'X', ':']).unwrap_or((rest, "1"));
    match number(step)? {
        0 => Err(format!("'{item}' has a step of 0: it must be 1 at least")),
        step => Ok((number(first)?, number(last)?, step as usize)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_numbers_ranges_and_steps() {
        for (text, frames) in [
            ("5", &[5][..]),
            ("1-4", &[1, 2, 3, 4]),
            ("1-9x2", &[1, 3, 5, 7, 9]),
            ("0-10:4", &[0, 4, 8]),
            ("7,3,5", &[3, 5, 7]),
            ("1-3, 2-4 , 10", &[1, 2, 3, 4, 10]),
            ("0001-0002", &[1, 2]),
            ("4294967294-4294967295", &[u32::MAX - 1, u32::MAX]),
        ] {
            assert_eq!(text.parse(), Ok(FrameList(frames.iter().copied().collect())), "{text}");
        }
    }

    #[test]
    fn lists_that_cannot_be_meant_say_why() {
        for (text, why) in [
            ("", "must look like"),
            ("1,,2", "must look like"),
            ("a-b", "must look like"),
            ("1-", "must look like"),
            ("1-9x", "must look like"),
            ("4294967296", "must look like"),
            ("-3", "negative"),
            ("-3-5", "negative"),
            ("9-1", "backwards"),
            ("1-9x0", "step of 0"),
            ("0-4000000000", "more than 1000000"),
        ] {
            let error = text.parse::<FrameList>().err().unwrap_or_default();
            assert!(error.contains(why), "{text}: {error}");
        }
    }
}
