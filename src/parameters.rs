//! Parameters that describe themselves: the declaration of a struct also gives names, documentation, units, ranges and
//! values of its fields.
//!
//! [`Method::parameters`](crate::Method::parameters) lists the parameters of a method, for a panel or a table.
//! [`Method::with_parameter`](crate::Method::with_parameter) sets one. [`Method::validate`](crate::Method::validate)
//! checks the ranges. The table of all parameters:
#![doc = include_str!("../docs/parameters.md")]

use std::fmt;
use std::ops::{Bound, RangeBounds, RangeInclusive};

use crate::error::{Error, RequestCause, Result};

/// One parameter of a method.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Name of the parameter, with the groups that it is in, as in `second_pass.color_k`.
    pub name: String,
    /// Meaning of the parameter, in sentences; an empty line separates paragraphs. The first sentence can stand alone.
    pub documentation: String,
    /// Unit of the value, such as `pixels`; `None` for a value without unit.
    pub unit: Option<&'static str>,
    /// Kind and range of the allowed values.
    pub kind: Kind,
    /// Current value; [`Value::Flag`] of `false` if the parameter is left out, `None` if a group that it is in is left
    /// out.
    pub value: Option<Value>,
    /// Value in [`Preset::Default`](crate::Preset::Default), in the same form.
    pub default: Option<Value>,
    /// Value in [`Preset::Thesis`](crate::Preset::Thesis), in the same form.
    pub thesis: Option<Value>,
}

/// Kind of a parameter, with its range.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// A whole number.
    Integer {
        /// Allowed values, with both ends.
        range: RangeInclusive<u32>,
    },
    /// A finite number.
    Number {
        /// Allowed values.
        range: (Bound<f32>, Bound<f32>),
        /// Whether `false` leaves it out. `true` then gives it the value of the default preset.
        can_be_off: bool,
    },
    /// `true` or `false`.
    Flag,
    /// One of several words.
    Choice {
        /// The words.
        options: Vec<Choice>,
    },
    /// At least one of several words.
    Set {
        /// The words.
        options: Vec<Choice>,
    },
    /// A group of parameters that `false` leaves out together; their names begin with the name of the group and a dot.
    /// `true` gives a group that is left out the values of the default preset.
    Group,
}

/// One of the words that are values of a parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Choice {
    /// The word.
    pub name: &'static str,
    /// Meaning of the word, in sentences.
    pub documentation: String,
}

/// Value of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Value of a [`Kind::Integer`]; a [`Kind::Number`] takes it as well.
    Integer(u32),
    /// Value of a [`Kind::Number`].
    Number(f32),
    /// Value of a [`Kind::Flag`] or [`Kind::Group`], and of a [`Kind::Number`] that can be left out.
    Flag(bool),
    /// Value of a [`Kind::Choice`].
    Choice(String),
    /// Value of a [`Kind::Set`].
    Set(Vec<String>),
}

impl Parameter {
    /// Returns the first sentence of the documentation.
    pub fn summary(&self) -> &str {
        let text = self.documentation.split("\n\n").next().unwrap_or_default();
        // The point of "eq. 7.6" is no end.
        let is_end = |end: &usize| text[end + 2..].starts_with(char::is_uppercase);
        text.match_indices(". ").map(|(end, _)| end).find(is_end).map_or(text, |end| &text[..=end])
    }

    /// Returns the allowed values with their unit: `from 1 to 64 pixels`, `off, blended, hard`.
    pub fn range(&self) -> String {
        match self.unit {
            Some(unit) => format!("{} {unit}", self.kind),
            None => self.kind.to_string(),
        }
    }

    /// Returns the range as part of a sentence: `a whole number from 1 to 64 pixels`, `one of off, blended, hard`.
    pub fn rule(&self) -> String {
        let range = self.range();
        match &self.kind {
            Kind::Integer { .. } => format!("a whole number {range}"),
            Kind::Number { can_be_off: false, .. } => format!("a number {range}"),
            Kind::Number { can_be_off: true, .. } => format!("a number {range}, or false to leave it out"),
            Kind::Flag | Kind::Group => "true or false".into(),
            Kind::Choice { .. } => format!("one of {range}"),
            Kind::Set { .. } => format!("at least one of {range}, each once"),
        }
    }

    /// Reads a value as people write it on a command line: `5`, `0.45`, `false`, `hard`, `first,second`.
    ///
    /// # Errors
    /// [`Error::Request`] naming the parameter and its range.
    pub fn parse(&self, text: &str) -> Result<Value> {
        let flag = || text.parse().ok().map(Value::Flag);
        let value = match &self.kind {
            Kind::Integer { .. } => text.parse().ok().map(Value::Integer),
            Kind::Number { .. } => text.parse().ok().map(Value::Number).or_else(flag),
            Kind::Flag | Kind::Group => flag(),
            Kind::Choice { .. } => Some(Value::Choice(text.to_owned())),
            Kind::Set { .. } => Some(Value::Set(text.split(',').map(|word| word.trim().to_owned()).collect())),
        };
        value.filter(|value| self.kind.contains(value)).ok_or_else(|| self.refused(text))
    }

    /// Returns whether the parameter is in the group of this name.
    pub fn is_in(&self, group: &str) -> bool {
        self.name.strip_prefix(group).is_some_and(|rest| rest.starts_with('.'))
    }

    /// Checks that the parameter can have this value.
    ///
    /// # Errors
    /// [`Error::Request`] naming the parameter and its range.
    pub fn check(&self, value: &Value) -> Result<()> {
        match value {
            value if self.kind.contains(value) => Ok(()),
            Value::Set(names) if names.is_empty() => Err(self.refused("empty")),
            value => Err(self.refused(value)),
        }
    }

    /// Makes the error for a value that the parameter cannot have.
    pub(crate) fn refused(&self, value: impl fmt::Display) -> Error {
        Error::Request(RequestCause::ParameterValue {
            name: self.name.clone(),
            value: value.to_string(),
            rule: self.rule(),
        })
    }

    /// Returns the value that the parameter gets when it is set to `value`.
    pub(crate) fn settle(&self, value: &Value) -> Result<Value> {
        self.check(value)?;
        let number = |value: &Option<Value>| value.clone().filter(|value| matches!(value, Value::Number(_)));
        match (&self.kind, value) {
            (Kind::Number { .. }, Value::Flag(true)) => {
                number(&self.value).or_else(|| number(&self.default)).ok_or_else(|| self.refused(value))
            }
            _ => Ok(value.clone()),
        }
    }
}

impl Kind {
    /// Returns whether a value is one of the allowed values.
    pub fn contains(&self, value: &Value) -> bool {
        let has = |options: &[Choice], name: &String| options.iter().any(|option| option.name == name);
        match (self, value) {
            (Self::Integer { range }, Value::Integer(value)) => range.contains(value),
            (Self::Number { range, .. }, Value::Number(value)) => value.is_finite() && range.contains(value),
            (Self::Number { range, .. }, Value::Integer(value)) => range.contains(&(*value as f32)),
            (Self::Number { can_be_off, .. }, Value::Flag(_)) => *can_be_off,
            (Self::Flag | Self::Group, Value::Flag(_)) => true,
            (Self::Choice { options }, Value::Choice(name)) => has(options, name),
            (Self::Set { options }, Value::Set(names)) => {
                !names.is_empty()
                    && names
                        .iter()
                        .enumerate()
                        .all(|(index, name)| has(options, name) && !names[..index].contains(name))
            }
            _ => false,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer { range } => write!(f, "from {} to {}", range.start(), range.end()),
            Self::Number { range, .. } => match range {
                (Bound::Included(from), Bound::Included(to)) => write!(f, "from {from} to {to}"),
                (from, to) => {
                    let from = match from {
                        Bound::Included(from) => Some(format!("at least {from}")),
                        Bound::Excluded(from) => Some(format!("above {from}")),
                        Bound::Unbounded => None,
                    };
                    let to = match to {
                        Bound::Included(to) => Some(format!("at most {to}")),
                        Bound::Excluded(to) => Some(format!("below {to}")),
                        Bound::Unbounded => None,
                    };
                    f.write_str(&from.into_iter().chain(to).collect::<Vec<_>>().join(" and "))
                }
            },
            Self::Flag | Self::Group => f.write_str("true, false"),
            Self::Choice { options } | Self::Set { options } => {
                f.write_str(&options.iter().map(|option| option.name).collect::<Vec<_>>().join(", "))
            }
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(value) => write!(f, "{value}"),
            // The shortest digits that only this number has.
            Self::Number(value) => f.write_str(format!("{value:?}").trim_end_matches(".0")),
            Self::Flag(value) => write!(f, "{value}"),
            Self::Choice(name) => f.write_str(name),
            Self::Set(names) => f.write_str(&names.join(", ")),
        }
    }
}

impl From<u32> for Value {
    fn from(value: u32) -> Self {
        Self::Integer(value)
    }
}

impl From<f32> for Value {
    fn from(value: f32) -> Self {
        Self::Number(value)
    }
}

impl From<bool> for Value {
    fn from(value: bool) -> Self {
        Self::Flag(value)
    }
}

impl From<&str> for Value {
    fn from(name: &str) -> Self {
        Self::Choice(name.into())
    }
}

impl<const N: usize> From<[&str; N]> for Value {
    fn from(names: [&str; N]) -> Self {
        Self::Set(names.map(str::to_owned).to_vec())
    }
}

/// A value whose parts have names; [`parameters!`], [`choices!`] and [`choice_set!`] implement it.
pub(crate) trait Describe: Copy {
    /// Limits that a declaration states besides the type.
    type Limits;

    /// Appends the parameter at `place` and the parameters below it.
    fn list(values: Values<Self>, place: Place<'_>, limits: Self::Limits, into: &mut Vec<Parameter>);

    /// Sets the part with this name, or the whole for an empty name, to a value of its kind. Does nothing for an
    /// unknown name or another kind; [`Parameter::check`] refuses these before.
    fn set(&mut self, name: &str, value: &Value);
}

/// The three values in a [`Parameter`].
#[derive(Clone, Copy)]
pub(crate) struct Values<T> {
    pub(crate) value: Option<T>,
    pub(crate) default: Option<T>,
    pub(crate) thesis: Option<T>,
}

impl<T> Values<T> {
    pub(crate) fn and_then<P>(self, part: impl Fn(T) -> Option<P>) -> Values<P> {
        Values {
            value: self.value.and_then(&part),
            default: self.default.and_then(&part),
            thesis: self.thesis.and_then(&part),
        }
    }

    pub(crate) fn map<P>(self, part: impl Fn(T) -> P) -> Values<P> {
        self.and_then(|whole| Some(part(whole)))
    }
}

/// Name and documentation of a declared parameter.
#[derive(Clone, Copy)]
pub(crate) struct Place<'a> {
    /// Name of the parameter.
    pub(crate) name: &'a str,
    /// Lines of its documentation comment.
    pub(crate) documentation: &'static [&'static str],
}

impl Place<'_> {
    pub(crate) fn parameter(self, values: Values<Value>, unit: Option<&'static str>, kind: Kind) -> Parameter {
        let Values { value, default, thesis } = values;
        Parameter {
            name: self.name.into(),
            documentation: text(self.documentation),
            unit,
            kind,
            value,
            default,
            thesis,
        }
    }
}

/// Joins the lines of a documentation comment to paragraphs of running text.
pub(crate) fn text(lines: &[&str]) -> String {
    let paragraphs = lines.split(|line| line.trim().is_empty());
    let paragraphs = paragraphs
        .map(|lines| lines.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" "))
        .filter(|text| !text.is_empty());
    paragraphs.collect::<Vec<_>>().join("\n\n")
}

/// Limits of an integer parameter.
pub(crate) struct Whole {
    range: RangeInclusive<u32>,
    unit: Option<&'static str>,
}

/// Allows whole numbers of pixels.
pub(crate) fn pixels(range: RangeInclusive<u32>) -> Whole {
    Whole { range, unit: Some("pixels") }
}

/// Limits of a number parameter.
pub(crate) struct Real {
    range: (Bound<f32>, Bound<f32>),
    unit: Option<&'static str>,
}

/// Allows numbers of a range.
pub(crate) fn real(range: impl RangeBounds<f32>) -> Real {
    Real { range: (range.start_bound().cloned(), range.end_bound().cloned()), unit: None }
}

/// Allows numbers above `bound`.
pub(crate) fn above(bound: f32) -> Real {
    real((Bound::Excluded(bound), Bound::Unbounded))
}

impl Real {
    /// Sets the unit of the number.
    pub(crate) fn of(self, unit: &'static str) -> Self {
        Self { unit: Some(unit), ..self }
    }
}

/// A word that is not allowed in one group of parameters, although its type has it.
#[derive(Clone, Copy)]
pub(crate) struct Without {
    /// Name of the parameter within the group.
    pub(crate) parameter: &'static str,
    pub(crate) choice: &'static str,
    /// Reason, as a sentence.
    pub(crate) because: &'static str,
}

impl Without {
    /// Removes the word from the listed parameters of a group.
    pub(crate) fn narrow(self, parameters: &mut [Parameter]) {
        for parameter in
            parameters.iter_mut().filter(|parameter| parameter.name.rsplit('.').next() == Some(self.parameter))
        {
            if let Kind::Choice { options } = &mut parameter.kind {
                options.retain(|option| option.name != self.choice);
                parameter.documentation =
                    format!("{}\n\nNot {}: {}", parameter.documentation, self.choice, self.because);
            }
        }
    }
}

impl Describe for u32 {
    type Limits = Whole;

    fn list(values: Values<Self>, place: Place<'_>, Whole { range, unit }: Whole, into: &mut Vec<Parameter>) {
        into.push(place.parameter(values.map(Value::Integer), unit, Kind::Integer { range }));
    }

    fn set(&mut self, _: &str, value: &Value) {
        if let Value::Integer(value) = value {
            *self = *value;
        }
    }
}

impl Describe for f32 {
    type Limits = Real;

    fn list(values: Values<Self>, place: Place<'_>, Real { range, unit }: Real, into: &mut Vec<Parameter>) {
        into.push(place.parameter(values.map(Value::Number), unit, Kind::Number { range, can_be_off: false }));
    }

    fn set(&mut self, _: &str, value: &Value) {
        match value {
            Value::Number(value) => *self = *value,
            Value::Integer(value) => *self = *value as f32,
            _ => {}
        }
    }
}

impl Describe for Option<f32> {
    type Limits = Real;

    fn list(values: Values<Self>, place: Place<'_>, Real { range, unit }: Real, into: &mut Vec<Parameter>) {
        let values = values.map(|value| value.map_or(Value::Flag(false), Value::Number));
        into.push(place.parameter(values, unit, Kind::Number { range, can_be_off: true }));
    }

    fn set(&mut self, name: &str, value: &Value) {
        *self = match value {
            Value::Flag(_) => None,
            value => {
                let mut number = self.unwrap_or_default();
                number.set(name, value);
                Some(number)
            }
        };
    }
}

impl Describe for bool {
    type Limits = ();

    fn list(values: Values<Self>, place: Place<'_>, (): (), into: &mut Vec<Parameter>) {
        into.push(place.parameter(values.map(Value::Flag), None, Kind::Flag));
    }

    fn set(&mut self, _: &str, value: &Value) {
        if let Value::Flag(value) = value {
            *self = *value;
        }
    }
}

/// A group that can be left out.
impl<G: Group> Describe for Option<G> {
    type Limits = Option<Without>;

    fn list(values: Values<Self>, place: Place<'_>, limits: Self::Limits, into: &mut Vec<Parameter>) {
        into.push(place.parameter(values.map(|group| Value::Flag(group.is_some())), None, Kind::Group));
        G::list(values.and_then(|group| group), place, limits, into);
    }

    fn set(&mut self, name: &str, value: &Value) {
        match (name, value) {
            ("", Value::Flag(true)) => *self = Some(self.unwrap_or_default()),
            ("", _) => *self = None,
            (name, value) => {
                if let Some(group) = self {
                    group.set(name, value);
                }
            }
        }
    }
}

/// Several parameters; the default values are those of the default preset.
pub(crate) trait Group: Describe<Limits = Option<Without>> + Default {}

/// Lists the parameters of a method.
pub(crate) fn list<P: Describe<Limits = Option<Without>>>(values: Values<P>) -> Vec<Parameter> {
    let mut parameters = Vec::new();
    P::list(values, Place { name: "", documentation: &[] }, None, &mut parameters);
    parameters
}

/// Checks the values of the listed parameters against their ranges.
///
/// # Errors
/// [`Error::Request`] naming the parameter and its range.
pub(crate) fn check(listed: &[Parameter]) -> Result<()> {
    listed
        .iter()
        .filter_map(|parameter| Some((parameter, parameter.value.as_ref()?)))
        .try_for_each(|(parameter, value)| parameter.check(value))
}

/// Declares a struct of parameters. The documentation of a field is the documentation of the parameter. The range
/// stands behind `=>`, if the type of the field has one, as in `pub cut: f32 => real(0.0..=1.0)`.
macro_rules! parameters {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident {
            $(
                $(#[doc = $documentation:literal])*
                $(#[serde $serde:tt])?
                $field_vis:vis $field:ident: $type:ty $(=> $limits:expr)?
            ),+ $(,)?
        }
    ) => {
        $(#[$meta])*
        $vis struct $name { $($(#[doc = $documentation])* $(#[serde $serde])? $field_vis $field: $type),+ }

        impl $crate::parameters::Describe for $name {
            type Limits = Option<$crate::parameters::Without>;

            fn list(
                values: $crate::parameters::Values<Self>,
                place: $crate::parameters::Place<'_>,
                without: Self::Limits,
                into: &mut Vec<$crate::parameters::Parameter>,
            ) {
                let first = into.len();
                $({
                    let name = if place.name.is_empty() {
                        stringify!($field).to_owned()
                    } else {
                        format!("{}.{}", place.name, stringify!($field))
                    };
                    let place = $crate::parameters::Place { name: &name, documentation: &[$($documentation),*] };
                    let limits = $crate::parameters::parameters!(@limits $($limits)?);
                    let field = values.map(|whole| whole.$field);
                    <$type as $crate::parameters::Describe>::list(field, place, limits, into);
                })+
                if let Some(without) = without {
                    without.narrow(&mut into[first..]);
                }
            }

            fn set(&mut self, name: &str, value: &$crate::parameters::Value) {
                let (field, rest) = name.split_once('.').unwrap_or((name, ""));
                $(if field == stringify!($field) {
                    $crate::parameters::Describe::set(&mut self.$field, rest, value);
                })+
            }
        }
    };
    (@limits) => { Default::default() };
    (@limits $limits:expr) => { $limits };
}
pub(crate) use parameters;

/// Declares an enum of words, each with its documentation: `Variant => "word"`.
macro_rules! choices {
    (
        $(#[$meta:meta])*
        $vis:vis enum $name:ident { $($(#[doc = $documentation:literal])* $variant:ident => $word:literal),+ $(,)? }
    ) => {
        $(#[$meta])*
        $vis enum $name { $($(#[doc = $documentation])* $variant),+ }

        impl $name {
            /// All words.
            pub const ALL: &[Self] = &[$(Self::$variant),+];

            /// Returns the word of this variant.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $word),+ }
            }

            /// Returns the words and their meanings, in the same order.
            pub fn choices() -> Vec<$crate::parameters::Choice> {
                vec![$($crate::parameters::Choice {
                    name: $word,
                    documentation: $crate::parameters::text(&[$($documentation),*]),
                }),+]
            }
        }

        impl $crate::parameters::Describe for $name {
            type Limits = ();

            fn list(
                values: $crate::parameters::Values<Self>,
                place: $crate::parameters::Place<'_>,
                (): (),
                into: &mut Vec<$crate::parameters::Parameter>,
            ) {
                let values = values.map(|value| value.name().into());
                into.push(place.parameter(values, None, $crate::parameters::Kind::Choice { options: Self::choices() }));
            }

            fn set(&mut self, _: &str, value: &$crate::parameters::Value) {
                if let $crate::parameters::Value::Choice(name) = value
                    && let Some(choice) = Self::ALL.iter().find(|choice| choice.name() == name)
                {
                    *self = *choice;
                }
            }
        }
    };
}
pub(crate) use choices;

/// Declares a set of words as a struct of flags, each with its documentation.
macro_rules! choice_set {
    (
        $(#[$meta:meta])*
        $vis:vis struct $name:ident { $($(#[doc = $documentation:literal])* $field_vis:vis $field:ident),+ $(,)? }
    ) => {
        $(#[$meta])*
        $vis struct $name { $($(#[doc = $documentation])* $field_vis $field: bool),+ }

        impl $name {
            /// Returns the words and their meanings, in their order.
            pub fn choices() -> Vec<$crate::parameters::Choice> {
                vec![$($crate::parameters::Choice {
                    name: stringify!($field),
                    documentation: $crate::parameters::text(&[$($documentation),*]),
                }),+]
            }

            /// Returns the set of those of its words that `names` contains; other names are ignored.
            pub fn of_names<N: AsRef<str>>(names: &[N]) -> Self {
                Self { $($field: names.iter().any(|name| name.as_ref() == stringify!($field))),+ }
            }
        }

        impl $crate::parameters::Describe for $name {
            type Limits = ();

            fn list(
                values: $crate::parameters::Values<Self>,
                place: $crate::parameters::Place<'_>,
                (): (),
                into: &mut Vec<$crate::parameters::Parameter>,
            ) {
                let values = values.map(|set| {
                    $crate::parameters::Value::Set(set.names().into_iter().map(str::to_owned).collect())
                });
                into.push(place.parameter(values, None, $crate::parameters::Kind::Set { options: Self::choices() }));
            }

            fn set(&mut self, _: &str, value: &$crate::parameters::Value) {
                if let $crate::parameters::Value::Set(names) = value {
                    *self = Self::of_names(names);
                }
            }
        }
    };
}
pub(crate) use choice_set;
