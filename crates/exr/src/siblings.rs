//! Files beside the input that belong to it, by their names.

use std::path::{Path, PathBuf};

use crate::layout::{RoleName, Rule};

/// A file's name in pieces: `color.0001.exr` has the stem `color`.
pub(crate) struct FileName {
    folder: PathBuf,
    /// The name without the number of the frame and the extension.
    pub(crate) stem: String,
    /// Number of the frame and extension, with their dots.
    tail: String,
}

impl FileName {
    pub(crate) fn of(path: &Path) -> Self {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let without_extension = name.rfind('.').filter(|dot| *dot > 0).unwrap_or(name.len());
        let is_frame = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        let frame = name[..without_extension].rfind('.').filter(|dot| *dot > 0);
        let end = frame.filter(|dot| is_frame(&name[dot + 1..without_extension])).unwrap_or(without_extension);
        Self {
            folder: path.parent().map(Path::to_owned).unwrap_or_default(),
            stem: name[..end].to_owned(),
            tail: name[end..].to_owned(),
        }
    }

    /// Returns the path of the file with another stem in the same folder, with the same frame and extension.
    pub(crate) fn beside(&self, stem: &str) -> PathBuf {
        self.folder.join(format!("{stem}{}", self.tail))
    }

    /// Returns the path of the file with another stem if there is one, in capitals if the input's name is.
    pub(crate) fn existing(&self, stem: &str) -> Option<PathBuf> {
        let is_capital = self.stem.chars().any(char::is_uppercase) && !self.stem.chars().any(char::is_lowercase);
        let capital = is_capital.then(|| stem.to_uppercase());
        std::iter::once(stem.to_owned()).chain(capital).map(|stem| self.beside(&stem)).find(|path| path.is_file())
    }
}

/// A file that belongs to the input.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Sibling {
    pub(crate) path: PathBuf,
    /// Position of the rule that names it.
    pub(crate) rule: usize,
    /// The file that it describes: the input or another sibling.
    pub(crate) of: Option<PathBuf>,
    /// Whether the rule names layers of the file.
    pub(crate) is_for_layers: bool,
}

/// Whether `path` is the file beside the input that a text with `{stem}` names.
pub(crate) fn is(text: &str, input: &Path, stem: Option<&str>, path: &Path) -> bool {
    let name = FileName::of(input);
    name.existing(&text.replace("{stem}", stem.unwrap_or(&name.stem))).is_some_and(|found| found == path)
}

/// Finds the files beside the input that the rules name. `stem` is the part of the input's name that `{stem}` stands
/// for, if the layout says so.
pub(crate) fn find(rules: &[Rule], input: &Path, stem: Option<&str>) -> Vec<Sibling> {
    let name = FileName::of(input);
    let stem = stem.unwrap_or(&name.stem).to_owned();
    let mut stems = vec![(name.stem.clone(), input.to_owned())];
    let mut found: Vec<Sibling> = Vec::new();
    // A file may have several rules, if each names other layers of it.
    let is_new = |path: &Path, rule: &Rule, found: &[Sibling]| {
        let is_taken = |sibling: &Sibling| sibling.path == path && (!sibling.is_for_layers || rule.names.is_empty());
        path != input && !found.iter().any(is_taken)
    };
    let of_others = |rule: &&(usize, &Rule)| rule.1.files.iter().any(|file| file.has("{of}"));
    let rules: Vec<(usize, &Rule)> = rules.iter().enumerate().filter(|(_, rule)| !rule.files.is_empty()).collect();
    for (index, rule) in rules.iter().filter(|rule| !of_others(rule)) {
        let stems_of_rule = rule.files.iter().map(|file| file.filled(&[("{stem}", &stem)]));
        let existing = stems_of_rule.filter_map(|stem| Some((name.existing(&stem)?, stem)));
        let existing: Vec<_> = existing.filter(|(path, _)| is_new(path, rule, &found)).collect();
        // Of several files that could be one feature, the first is the best.
        let most = if rule.role.is_some_and(RoleName::is_feature) { 1 } else { existing.len() };
        for (path, stem) in existing.into_iter().take(most) {
            stems.push((stem, path.clone()));
            found.push(Sibling { path, rule: *index, of: None, is_for_layers: !rule.names.is_empty() });
        }
    }
    for (index, rule) in rules.iter().filter(of_others) {
        for (of_stem, of) in &stems {
            let filled = |file: &crate::layout::Pattern| file.filled(&[("{of}", of_stem), ("{stem}", &stem)]);
            let mut existing = rule.files.iter().filter_map(|file| name.existing(&filled(file)));
            let path = existing.find(|path| is_new(path, rule, &found));
            let is_for_layers = !rule.names.is_empty();
            found.extend(path.map(|path| Sibling { path, rule: *index, of: Some(of.clone()), is_for_layers }));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_has_a_stem_a_frame_and_an_extension() {
        for (path, stem, beside) in [
            ("a/color.exr", "color", "a/x.exr"),
            ("color.0001.exr", "color", "x.0001.exr"),
            ("x.b0.0012.exr", "x.b0", "x.0012.exr"),
            ("scene.hdr.pfm", "scene.hdr", "x.pfm"),
            ("noext", "noext", "x"),
            (".hidden", ".hidden", "x"),
            ("0001.exr", "0001", "x.exr"),
        ] {
            let name = FileName::of(Path::new(path));
            assert_eq!((name.stem.as_str(), name.beside("x")), (stem, PathBuf::from(beside)), "{path}");
        }
    }
}
