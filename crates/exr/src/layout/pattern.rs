//! Patterns of names in layouts.

use regex_lite::{Regex, RegexBuilder};

/// A pattern of a layer's or file's name. `*` stands for any text without a dot; `{group}` for nothing or a prefix that
/// ends with a dot; `{of}` for the name of another layer or file; `{stem}` for a part of the input's name.
#[derive(Clone, Debug)]
pub(crate) struct Pattern {
    pub(crate) text: String,
    regex: Regex,
}

/// How many names a pattern fits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Breadth {
    /// The names that it spells.
    Named,
    /// Names made of the name of another layer.
    OfAnother,
    /// Names that have a part in common.
    Similar,
    /// Any name, or any name with so many dots.
    Any,
}

/// The texts that the places of a pattern stand for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Fit {
    /// With its dot; empty without a place for it.
    pub(crate) group: String,
    pub(crate) of: Option<String>,
    pub(crate) stem: Option<String>,
}

const PLACES: [(&str, &str); 4] =
    [("{group}", r"(?<group>(?:.*\.)?)"), ("{of}", "(?<of>.+)"), ("{stem}", "(?<stem>.*)"), ("*", r"[^.]*")];

impl Pattern {
    /// Reads a pattern. Returns the problem of a pattern with an unknown or repeated place.
    pub(crate) fn new(text: &str, is_exact: bool) -> Result<Self, String> {
        let mut regex = String::from("^");
        let mut rest = text;
        while let Some(first) = rest.chars().next() {
            if let Some((place, meaning)) = PLACES.iter().find(|(place, _)| rest.starts_with(place)) {
                regex += meaning;
                rest = &rest[place.len()..];
                continue;
            }
            if first == '{' {
                return Err(format!("'{text}' has a place that is none of {{group}}, {{of}} and {{stem}}"));
            }
            regex += &regex_lite::escape(first.encode_utf8(&mut [0; 4]));
            rest = &rest[first.len_utf8()..];
        }
        regex.push('$');
        let regex = RegexBuilder::new(&regex).case_insensitive(!is_exact).dot_matches_new_line(true).build();
        Ok(Self { text: text.to_owned(), regex: regex.map_err(|_| format!("'{text}' names a place twice"))? })
    }

    /// Reads a pattern of an attribute's name or value, in which `*` stands for any text.
    pub(crate) fn of_text(text: &str) -> Result<Self, String> {
        let parts: Vec<String> = text.split('*').map(regex_lite::escape).collect();
        let regex = RegexBuilder::new(&format!("^{}$", parts.join(".*"))).case_insensitive(true).build();
        Ok(Self { text: text.to_owned(), regex: regex.map_err(|error| error.to_string())? })
    }

    pub(crate) fn fit(&self, name: &str) -> Option<Fit> {
        let found = self.regex.captures(name)?;
        let place = |place: &str| found.name(place).map(|text| text.as_str().to_owned());
        Some(Fit { group: place("group").unwrap_or_default(), of: place("of"), stem: place("stem") })
    }

    /// Returns how many names the pattern fits.
    pub(crate) fn breadth(&self) -> Breadth {
        if self.has("{of}") {
            Breadth::OfAnother
        } else if !self.has("*") {
            Breadth::Named
        } else if self.text.chars().all(|character| matches!(character, '*' | '.')) {
            Breadth::Any
        } else {
            Breadth::Similar
        }
    }

    pub(crate) fn has(&self, place: &str) -> bool {
        self.text.contains(place)
    }

    /// Returns the text with its places filled in.
    pub(crate) fn filled(&self, values: &[(&str, &str)]) -> String {
        values.iter().fold(self.text.clone(), |text, (place, value)| text.replace(place, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(pattern: &str, name: &str) -> Option<(String, Option<String>)> {
        Pattern::new(pattern, false).ok()?.fit(name).map(|fit| (fit.group, fit.of))
    }

    #[test]
    fn places_stand_for_groups_and_other_layers() {
        let group = |group: &str| Some((group.to_owned(), None));
        assert_eq!(fit("{group}Combined", "ViewLayer.combined"), group("ViewLayer."));
        assert_eq!(fit("{group}Combined", "a.b.Combined"), group("a.b."));
        assert_eq!(fit("{group}Combined", "Combined"), group(""));
        assert_eq!(fit("{group}Combined", "xCombined"), None);
        assert_eq!(fit("", ""), group(""));
        assert_eq!(fit("m2_{of}", "m2_nested.img"), Some((String::new(), Some("nested.img".into()))));
        assert_eq!(fit("CryptoObject*", "cryptoobject00"), group(""));
        assert_eq!(fit("a*", "a.b"), None);
        assert_eq!(fit("lpe:C[DS]*", "lpe:C[DS]"), group(""));
        assert!(Pattern::new("Variance", true).is_ok_and(|pattern| pattern.fit("variance").is_none()));
    }

    #[test]
    fn faulty_patterns_are_refused() {
        for (text, why) in [("{name}x", "is none of"), ("{of}{of}", "twice")] {
            assert!(Pattern::new(text, false).is_err_and(|problem| problem.contains(why)), "{text}");
        }
    }
}
