//! The buffer sets to measure, and the reference of each.

use std::cmp::Ordering;
use std::path::{Path, PathBuf};

use stein::text;
use stein_exr::{LayerRef, same_file};

use crate::{Error, Result};

/// A buffer set, not read yet.
#[derive(Clone, Debug, PartialEq)]
pub struct SetFile {
    pub(crate) file: PathBuf,
    pub(crate) reference: Option<LayerRef>,
    /// Name of the scene that the set shows. Sets with the same reference are one scene.
    pub(crate) scene: String,
    /// Whether the file was found in a folder, in which not every file need be a set.
    pub(crate) was_found: bool,
}

/// Returns the sets of the given files and folders, in their order; sets of a folder are in the order of their names.
/// `references` holds one reference for each input, or none; in that case each set's reference is looked for.
///
/// # Errors
/// [`Error::ReferenceCount`], [`Error::ReferenceOfFolder`], and [`Error::NoSets`] for a folder without sets;
/// [`Error::Unreadable`] and [`Error::UnreadableFolder`] for files and folders that cannot be opened.
pub fn find_sets(inputs: &[PathBuf], references: &[LayerRef]) -> Result<Vec<SetFile>> {
    if !references.is_empty() && references.len() != inputs.len() {
        let (references, inputs) = (references.len(), inputs.len());
        return Err(Error::ReferenceCount { references, inputs });
    }
    let mut sets: Vec<SetFile> = Vec::new();
    for (index, input) in inputs.iter().enumerate() {
        let given = references.get(index);
        if !input.is_dir() {
            readable(input)?;
            sets.push(SetFile::new(input, given.cloned().or_else(|| find_reference(input)), false));
            continue;
        }
        if given.is_some() {
            return Err(Error::ReferenceOfFolder { folder: input.clone() });
        }
        let mut files = Vec::new();
        collect(input, &mut files)?;
        files.retain(|file| !is_reference(file));
        files.sort_by(|a, b| by_name(&a.to_string_lossy(), &b.to_string_lossy()));
        if files.is_empty() {
            return Err(Error::NoSets { folder: input.clone() });
        }
        sets.extend(files.iter().map(|file| SetFile::new(file, find_reference(file), true)));
    }
    for reference in sets.iter().filter_map(|set| set.reference.as_ref()) {
        readable(&reference.file)?;
    }
    name_apart(&mut sets);
    Ok(sets)
}

impl SetFile {
    fn new(file: &Path, reference: Option<LayerRef>, was_found: bool) -> Self {
        let scene =
            reference.as_ref().map_or_else(|| scene_of_file(file), |reference| scene_of_reference(&reference.file));
        Self { file: file.to_owned(), reference, scene, was_found }
    }
}

/// Checks before anything is measured that a file can be opened.
fn readable(file: &Path) -> Result<()> {
    // Does not open a pipe, which would block. Anything else that is no file is refused when it is read.
    let opened =
        file.metadata().and_then(|kind| if kind.is_file() { std::fs::File::open(file).map(drop) } else { Ok(()) });
    opened.map_err(|error| Error::Unreadable { path: file.to_owned(), error })
}

/// Collects all OpenEXR files below a folder, except hidden ones.
fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> Result<()> {
    let failed = |error| Error::UnreadableFolder { folder: folder.to_owned(), error };
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let path = entry.path();
        if entry.file_name().to_string_lossy().starts_with('.') {
            continue;
        }
        // Does not follow a link to a folder: it may lead around in circles.
        if entry.file_type().map_err(failed)?.is_dir() {
            collect(&path, files)?;
        } else if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr")) && path.is_file() {
            files.push(path);
        }
    }
    Ok(())
}

fn stem(file: &Path) -> String {
    file.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned())
}

/// Returns the frame number: `0007` of `shot.0007`.
fn frame_number(stem: &str) -> Option<&str> {
    let (_, number) = stem.rsplit_once('.')?;
    (!number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())).then_some(number)
}

/// Returns `NAME` of `NAME_32spp`.
fn without_samples(stem: &str) -> Option<&str> {
    let (name, samples) = stem.rsplit_once('_')?;
    let count = samples.strip_suffix("spp")?;
    (!name.is_empty() && !count.is_empty() && count.bytes().all(|byte| byte.is_ascii_digit())).then_some(name)
}

fn is_reference(file: &Path) -> bool {
    let stem = stem(file);
    stem == "reference"
        || stem.ends_with("_reference")
        || (stem.starts_with("reference.") && frame_number(&stem).is_some())
}

/// Finds the reference of a file: `NAME_reference.exr` beside `NAME_<n>spp.exr` or `NAME.exr`, `reference.0007.exr`
/// beside `shot.0007.exr`, or `reference.exr` in the same folder or the one above.
fn find_reference(file: &Path) -> Option<LayerRef> {
    let stem = stem(file);
    let beside = |name: String| file.with_file_name(name);
    let names = [without_samples(&stem), Some(stem.as_str())]
        .into_iter()
        .flatten()
        .map(|name| beside(format!("{name}_reference.exr")));
    let of_frame = frame_number(&stem).map(|number| beside(format!("reference.{number}.exr")));
    let folder = beside(String::new());
    let above = if folder.as_os_str().is_empty() { PathBuf::from("..") } else { folder.join("..") };
    let parent = folder.parent().filter(|parent| !parent.as_os_str().is_empty()).map_or(above, Path::to_owned);
    let mut candidates = names.chain(of_frame).chain([beside("reference.exr".into()), parent.join("reference.exr")]);
    let found = candidates.find(|candidate| candidate.is_file() && !same_file(candidate, file))?;
    Some(LayerRef { file: found, layer: None })
}

/// Returns the name of the file's folder, wherever the path starts.
fn folder_name(file: &Path) -> Option<String> {
    let file = file.canonicalize().ok()?;
    Some(file.parent()?.file_name()?.to_string_lossy().into_owned())
}

fn scene_of_reference(file: &Path) -> String {
    let stem = stem(file);
    if stem == "reference" {
        return folder_name(file).unwrap_or(stem);
    }
    match (stem.strip_suffix("_reference"), frame_number(&stem)) {
        (Some(name), _) if !name.is_empty() => name.to_owned(),
        (_, Some(number)) if is_reference(file) => {
            folder_name(file).map_or_else(|| stem.clone(), |folder| format!("{folder}.{number}"))
        }
        _ => stem,
    }
}

fn scene_of_file(file: &Path) -> String {
    let stem = stem(file);
    without_samples(&stem).map_or(stem.clone(), str::to_owned)
}

/// Gives scenes with different references different names.
fn name_apart(sets: &mut [SetFile]) {
    for index in 1..sets.len() {
        let (before, rest) = sets.split_at_mut(index);
        let set = &mut rest[0];
        let same = |other: &SetFile| match (&other.reference, &set.reference) {
            (Some(a), Some(b)) => a.layer == b.layer && same_file(&a.file, &b.file),
            (None, None) => true,
            _ => false,
        };
        if before.iter().any(|other| other.scene == set.scene && !same(other)) {
            let file = set.reference.as_ref().map_or(&set.file, |reference| &reference.file);
            set.scene = format!("{} ({})", set.scene, text::path(file));
        }
    }
}

/// Compares names with their numbers as numbers: `spp8` comes before `spp32`.
fn by_name(a: &str, b: &str) -> Ordering {
    let split = |text: &str| -> Vec<(String, u64)> {
        let mut parts: Vec<(String, u64)> = vec![(String::new(), 0)];
        let mut in_number = false;
        for character in text.chars() {
            match character.to_digit(10) {
                Some(digit) => {
                    if let Some((_, number)) = parts.last_mut() {
                        *number = number.saturating_mul(10).saturating_add(digit.into());
                    }
                }
                None if in_number => parts.push((character.into(), 0)),
                None => {
                    if let Some((name, _)) = parts.last_mut() {
                        name.push(character);
                    }
                }
            }
            in_number = character.is_ascii_digit();
        }
        parts
    };
    split(a).cmp(&split(b)).then_with(|| a.cmp(b))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod tests {
    use super::*;

    /// Creates a folder with these empty files.
    fn folder(files: &[&str]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        folder
    }

    /// Returns file, reference and scene of each set, relative to the folder.
    fn found(folder: &tempfile::TempDir) -> Vec<[String; 3]> {
        let relative = |path: &Path| {
            path.canonicalize()
                .unwrap()
                .strip_prefix(folder.path().canonicalize().unwrap())
                .unwrap()
                .display()
                .to_string()
        };
        let sets = find_sets(&[folder.path().to_owned()], &[]).unwrap();
        let reference =
            |set: &SetFile| set.reference.as_ref().map_or_else(String::new, |reference| relative(&reference.file));
        sets.iter().map(|set| [relative(&set.file), reference(set), set.scene.clone()]).collect()
    }

    #[test]
    fn references_are_found_by_their_names_and_are_no_sets() {
        let folder = folder(&[
            "box/reference.exr",
            "box/spp128/input.exr",
            "box/spp8/input.exr",
            "flat/ring_8spp.exr",
            "flat/ring_reference.exr",
            "flat/lone_8spp.exr",
            "flat/.hidden.exr",
            "flat/notes.txt",
            "shot/shot.0002.exr",
            "shot/reference.0002.exr",
            "here/noisy.exr",
            "here/reference.exr",
        ]);
        let expected = [
            ["box/spp8/input.exr", "box/reference.exr", "box"],
            ["box/spp128/input.exr", "box/reference.exr", "box"],
            ["flat/lone_8spp.exr", "", "lone"],
            ["flat/ring_8spp.exr", "flat/ring_reference.exr", "ring"],
            ["here/noisy.exr", "here/reference.exr", "here"],
            ["shot/shot.0002.exr", "shot/reference.0002.exr", "shot.0002"],
        ];
        assert_eq!(found(&folder), expected.map(|row| row.map(str::to_owned)));
    }

    #[test]
    fn scenes_of_the_same_name_are_told_apart_by_their_references() {
        let folder = folder(&["a/box/reference.exr", "a/box/input.exr", "b/box/reference.exr", "b/box/input.exr"]);
        let scenes: Vec<String> = found(&folder).into_iter().map(|[_, _, scene]| scene).collect();
        assert_eq!(scenes[0], "box");
        assert!(scenes[1].starts_with("box (") && scenes[1].contains("reference.exr"), "{scenes:?}");
    }

    #[test]
    fn numbers_in_names_are_ordered_as_numbers() {
        assert_eq!(by_name("spp8/a", "spp32/a"), Ordering::Less);
        assert_eq!(by_name("a10b2", "a10b10"), Ordering::Less);
        assert_eq!(by_name("b1", "a2"), Ordering::Greater);
        assert_eq!(by_name("a01", "a1"), Ordering::Less);
    }

    #[test]
    fn what_cannot_be_read_is_told_before_anything_is_measured() {
        let folder = folder(&["only/reference.exr"]);
        assert!(find_sets(&[folder.path().join("missing.exr")], &[]).is_err());
        assert!(find_sets(&[folder.path().to_owned()], &[]).is_err());
        let reference = LayerRef { file: folder.path().join("only/reference.exr"), layer: None };
        assert!(find_sets(&[folder.path().to_owned()], &[reference]).is_err());
    }
}
