//! A method's parameters as a TOML file that people read and write.

use std::fmt::Write;
use std::path::Path;

use toml::de::{DeTable, DeValue};

use super::{Method, Preset};
use crate::error::{Error, FileCause, RequestCause, Result};
use crate::parameters::{Kind, Parameter, Value};
use crate::text;

/// Largest size of a file, in bytes: far more than all parameters with their comments take.
const MOST_BYTES: u64 = 1 << 20;

/// Width of a comment, in columns.
const WIDTH: usize = 100;

impl Method {
    /// Returns all parameters as a TOML document, each with the first sentence of its documentation and its range. The
    /// document names `preset` as the preset that it starts from. A group or a number that is left out is `false`.
    pub fn to_toml(&self, preset: Preset) -> String {
        let mut document = String::new();
        comment(
            &mut document,
            "Parameters for `stein denoise --params FILE`. What is not said here is as in the preset.",
        );
        let (method, preset) = (self.name(), preset.name());
        // Writing to a string cannot fail.
        let _ = writeln!(document, "method = \"{method}\"\npreset = \"{preset}\"");
        let parameters = self.parameters();
        let there = || parameters.iter().filter_map(|parameter| Some((parameter, parameter.value.as_ref()?)));
        let is_table =
            |parameter: &Parameter, value: &Value| parameter.kind == Kind::Group && *value == Value::Flag(true);
        // Keys below the head of a table belong to the table, so keys without a table come first.
        for (parameter, value) in
            there().filter(|(parameter, value)| !parameter.name.contains('.') && !is_table(parameter, value))
        {
            document.push('\n');
            pair(&mut document, parameter, &parameter.name, value);
        }
        let mut last_table = "";
        for (parameter, value) in
            there().filter(|(parameter, value)| parameter.name.contains('.') || is_table(parameter, value))
        {
            let (table, key) = match parameter.name.rsplit_once('.') {
                _ if is_table(parameter, value) => (parameter.name.as_str(), None),
                Some((table, key)) => (table, Some(key)),
                None => ("", None),
            };
            document.push('\n');
            if table != last_table {
                if key.is_none() {
                    comment(
                        &mut document,
                        &format!(
                            "{} In place of this table, `{table} = false` above leaves it out.",
                            parameter.summary()
                        ),
                    );
                }
                let _ = writeln!(document, "[{table}]");
                last_table = table;
            }
            if let Some(key) = key {
                pair(&mut document, parameter, key, value);
            }
        }
        document
    }

    /// Returns the method and parameters that a TOML document describes, and the preset that it starts from. Without
    /// the keys `method` and `preset`, these are `"dfc"` and `"default"`. Every other key is the name of a parameter;
    /// parameters that are not named have the value of the preset. The table of a group that can be left out turns the
    /// group on.
    ///
    /// ```
    /// use stein::{Method, Preset};
    ///
    /// let (method, preset) = Method::from_toml("window_radius = 20\nguard = false\n[second_pass]\npatch_radius = 1")?;
    /// assert_eq!((method.window_radius(), preset), (20, Preset::Default));
    /// assert_eq!(Method::from_toml(&method.to_toml(preset))?, (method, preset));
    /// # Ok::<(), stein::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Request`] with the line, the key and what to do: text that is not TOML, keys that are no parameters of
    /// the method, values of a wrong type or out of range, and parameters that contradict each other.
    pub fn from_toml(document: &str) -> Result<(Self, Preset)> {
        let parsed = DeTable::parse(document).map_err(|error| {
            let at = error.span().map_or(document.len(), |span| span.start);
            let reason = error.message().to_owned();
            in_line(document, at)(Error::Request(RequestCause::NotToml { reason }))
        })?;
        let mut entries = Vec::new();
        flatten("", parsed.get_ref(), &mut entries);
        // Errors are reported in the order of the document.
        entries.sort_by_key(|entry| entry.at);

        let mut word = |key: &str, names: &[&'static str]| -> Result<Option<usize>> {
            let Some(index) = entries.iter().position(|entry| entry.name == key) else { return Ok(None) };
            let Entry { at, value, .. } = entries.remove(index);
            let found = value.as_str().and_then(|word| names.iter().position(|name| *name == word));
            let wrong = || {
                let rule = format!("one of {}", names.join(", "));
                Error::Request(RequestCause::ParameterValue { name: key.into(), value: shown(value), rule })
            };
            found.map(Some).ok_or_else(|| in_line(document, at)(wrong()))
        };
        let methods = Self::all();
        let base =
            word("method", &methods.map(|method| method.name()))?.map_or_else(Self::default, |index| methods[index]);
        let preset = word("preset", &Preset::ALL.iter().map(|preset| preset.name()).collect::<Vec<_>>())?
            .map_or(Preset::Default, |index| Preset::ALL[index]);

        let mut method = base.of_preset(preset);
        for Entry { at, name, value } in entries {
            method = method.with_entry(&name, value).map_err(in_line(document, at))?;
        }
        method.validate()?;
        Ok((method, preset))
    }

    /// Reads method and preset from a file.
    ///
    /// # Errors
    /// [`Error::File`] where the file cannot be read, or with the error of [`Method::from_toml`].
    pub fn read_toml(path: &Path) -> Result<(Self, Preset)> {
        let text = text::read_file(path, MOST_BYTES).map_err(|error| Error::File {
            path: path.to_owned(),
            cause: FileCause::NoParameters { reason: error.to_string() },
        })?;
        Self::from_toml(&text).map_err(|error| error.in_file(path))
    }

    fn with_entry(self, name: &str, value: &DeValue<'_>) -> Result<Self> {
        let parameters = self.parameters();
        let parameter = parameters.iter().find(|parameter| parameter.name == name);
        let value = match (parameter, value) {
            // The entries of the table follow.
            (None, DeValue::Table(_)) if parameters.iter().any(|parameter| parameter.is_in(name)) => return Ok(self),
            (Some(Parameter { kind: Kind::Group, .. }), DeValue::Table(_)) => Value::Flag(true),
            // The method reports what is wrong with the name.
            (None, _) => Value::Flag(true),
            (Some(parameter), value) => read(value)
                .filter(|read| parameter.kind.contains(read))
                .ok_or_else(|| parameter.refused(shown(value)))?,
        };
        self.with_unchecked(name, &value)
    }
}

/// An entry of a document: a key with its value.
struct Entry<'a> {
    /// Name of the key, with the tables that it is in.
    name: String,
    /// Position of the key in the document, in bytes.
    at: usize,
    value: &'a DeValue<'a>,
}

fn flatten<'a>(table: &str, entries: &'a DeTable<'a>, into: &mut Vec<Entry<'a>>) {
    for (key, value) in entries {
        let name = if table.is_empty() { key.get_ref().to_string() } else { format!("{table}.{}", key.get_ref()) };
        let value = value.get_ref();
        into.push(Entry { name: name.clone(), at: key.span().start, value });
        if let DeValue::Table(entries) = value {
            flatten(&name, entries, into);
        }
    }
}

/// Reads a value of the kinds that parameters have.
fn read(value: &DeValue<'_>) -> Option<Value> {
    match value {
        DeValue::Boolean(flag) => Some(Value::Flag(*flag)),
        DeValue::Integer(number) => {
            let integer = u32::from_str_radix(number.as_str(), number.radix()).ok().map(Value::Integer);
            // A number that is negative or too large for an integer.
            integer.or_else(|| number.as_str().parse().ok().filter(|_| number.radix() == 10).map(Value::Number))
        }
        // Parses the digits directly, without rounding to another precision first.
        DeValue::Float(number) => number.as_str().parse().ok().map(Value::Number),
        DeValue::String(word) => Some(Value::Choice(word.to_string())),
        DeValue::Array(words) => {
            words.iter().map(|word| word.get_ref().as_str().map(str::to_owned)).collect::<Option<_>>().map(Value::Set)
        }
        DeValue::Datetime(_) | DeValue::Table(_) => None,
    }
}

/// Formats a value as the document writes it.
fn shown(value: &DeValue<'_>) -> String {
    match value {
        DeValue::Boolean(flag) => flag.to_string(),
        DeValue::Integer(number) => number.to_string(),
        DeValue::Float(number) => number.to_string(),
        DeValue::String(word) => format!("{word:?}"),
        DeValue::Datetime(time) => time.to_string(),
        DeValue::Array(values) => {
            format!("[{}]", values.iter().map(|value| shown(value.get_ref())).collect::<Vec<_>>().join(", "))
        }
        DeValue::Table(_) => "a table".into(),
    }
}

/// Adds the line to an error.
fn in_line(document: &str, at: usize) -> impl Fn(Error) -> Error {
    let line = 1 + document.bytes().take(at).filter(|byte| *byte == b'\n').count();
    move |error| match error {
        Error::Request(cause) => Error::Request(RequestCause::InLine { line, cause: Box::new(cause) }),
        error => error,
    }
}

/// Writes a key with its value, and above it a comment with its meaning and range.
fn pair(document: &mut String, parameter: &Parameter, key: &str, value: &Value) {
    let mut rule = parameter.rule();
    if let Some(first) = rule.get_mut(..1) {
        first.make_ascii_uppercase();
    }
    comment(document, &format!("{} {rule}.", parameter.summary()));
    let value = match value {
        Value::Integer(number) => number.to_string(),
        // With a point or an exponent, which makes it a float.
        Value::Number(number) => format!("{number:?}"),
        Value::Flag(flag) => flag.to_string(),
        Value::Choice(word) => format!("\"{word}\""),
        Value::Set(words) => {
            format!("[{}]", words.iter().map(|word| format!("\"{word}\"")).collect::<Vec<_>>().join(", "))
        }
    };
    let _ = writeln!(document, "{key} = {value}");
}

/// Writes text as lines of comments.
fn comment(document: &mut String, text: &str) {
    let mut line = String::from("#");
    for word in text.split_whitespace() {
        if line.chars().count() + 1 + word.chars().count() > WIDTH {
            let _ = writeln!(document, "{line}");
            line = String::from("#");
        }
        line.push(' ');
        line.push_str(word);
    }
    let _ = writeln!(document, "{line}");
}
