//! How names are stored and split.

use exr::prelude::Text;

use stein::text;

/// The longest name of a channel, an attribute or a type, in bytes. Readers refuse longer ones.
pub(crate) const LONGEST_NAME: usize = 255;

/// Decodes a stored name. The format stores bytes: they are UTF-8 if they are valid UTF-8, else Latin-1, in which every
/// byte is valid.
pub(crate) fn decoded(stored: &[u8]) -> String {
    str::from_utf8(stored).map_or_else(|_| stored.iter().copied().map(char::from).collect(), str::to_owned)
}

/// Encodes a new name in UTF-8, or returns the reason why it cannot be stored.
pub(crate) fn encoded(name: &str) -> Result<Text, String> {
    if name.is_empty() {
        return Err("a name is empty".into());
    }
    if name.contains('\0') {
        return Err(format!("the name '{}' holds a zero, which ends a name in OpenEXR", text::name(name)));
    }
    if name.len() > LONGEST_NAME {
        let start = text::beginning(name, name.len());
        return Err(format!("the name {start} is longer than the {LONGEST_NAME} bytes that OpenEXR stores"));
    }
    Ok(Text::from_slice_unchecked(name.as_bytes()))
}

/// Returns the part of a layer's name after its last dot.
pub(crate) fn last_component(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(_, last)| last)
}

/// Whether `end` is a layer's whole name, or the part behind one of its dots.
pub(crate) fn ends_with(name: &str, end: &str) -> bool {
    name.strip_suffix(end).is_some_and(|before| before.is_empty() || before.ends_with('.'))
}

/// Returns everything up to the last dot, with the dot: layers of one render share it.
pub(crate) fn group(name: &str) -> &str {
    name.rfind('.').map_or("", |dot| &name[..=dot])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_bytes() {
        for (stored, name) in
            [(&b"plain.R"[..], "plain.R"), ("Größe".as_bytes(), "Größe"), (b"Gr\xf6\xdfe", "Größe"), (b"\xff", "ÿ")]
        {
            assert_eq!(decoded(stored), name);
        }
        assert_eq!(encoded("Größe").map(|stored| stored.as_slice().to_vec()), Ok("Größe".as_bytes().to_vec()));
        assert!(encoded(&"x".repeat(255)).is_ok());
        for (name, why) in
            [("", "empty"), ("a\0b", "a zero"), (&"ö".repeat(128), "(256 bytes) is longer than the 255 bytes")]
        {
            assert!(encoded(name).is_err_and(|problem| problem.contains(why)), "{name}");
        }
    }
}
