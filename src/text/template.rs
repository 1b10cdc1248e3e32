//! Commands with placeholders.

use std::ffi::{OsStr, OsString};

/// Replaces the names by their values in one pass: a name inside a value is not replaced.
pub fn fill(template: &str, values: &[(&str, &OsStr)]) -> OsString {
    let mut filled = OsString::new();
    let mut rest = template;
    loop {
        let places = values.iter().filter_map(|(name, value)| Some((rest.find(name)?, name, value)));
        let Some((at, name, value)) = places.min_by_key(|(at, ..)| *at) else { break };
        filled.push(&rest[..at]);
        filled.push(value);
        rest = &rest[at + name.len()..];
    }
    filled.push(rest);
    filled
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_not_looked_at_again() {
        let values = [
            ("{map}", OsStr::new("a {out} b")),
            ("{out}", OsStr::new("{map}{iteration}")),
            ("{iteration}", OsStr::new("3")),
        ];
        assert_eq!(
            fill("x {map}, {out}{out} {iteration}{", &values),
            "x a {out} b, {map}{iteration}{map}{iteration} 3{"
        );
        assert_eq!(fill("", &values), "");
    }
}
