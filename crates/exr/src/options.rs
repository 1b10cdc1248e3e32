//! What programs offer as options.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use stein::parameters::Choice;

/// Reads one of several values by the word of the choice at the same place; its help tells what they mean.
pub fn choice<T: Clone + Send + Sync + 'static>(values: &[T], choices: &[Choice]) -> impl TypedValueParser<Value = T> + use<T> {
    let by_name: Vec<(&str, T)> = choices.iter().map(|choice| choice.name).zip(values.iter().cloned()).collect();
    let find = move |name: String| by_name.iter().find(|(other, _)| *other == name).map(|(_, value)| value.clone()).ok_or("it is none of them");
    PossibleValuesParser::new(choices.iter().map(possible)).try_map(find)
}

/// A choice as clap lists it.
pub fn possible(choice: &Choice) -> PossibleValue {
    PossibleValue::new(choice.name).help(choice.documentation.trim_end_matches('.').to_owned())
}
