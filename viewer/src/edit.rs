//! Changes of parameters by hand. One that contradicts the other parameters is told, and waits until it does not;
//! meanwhile the last ones that go together stay in use.

use stein::Error;
use stein::parameters::{Parameter, Value};

use crate::settings::Parameters;

/// A change that cannot be made as yet.
#[derive(Debug)]
pub struct Refused {
    /// Of which parameter.
    pub name: String,
    /// To what.
    pub value: Value,
    /// Why, and what to do.
    pub error: Error,
}

/// The changes that wait.
#[derive(Debug, Default)]
pub struct Edits {
    waiting: Vec<Refused>,
}

impl Edits {
    /// Sets a parameter, and with it those that waited for this. Whether anything was set.
    pub fn set(&mut self, parameters: &mut Parameters, name: &str, value: Value) -> bool {
        self.waiting.retain(|refused| refused.name != name);
        let before = parameters.method;
        match before.with_parameter(name, value.clone()) {
            Ok(method) => {
                parameters.method = method;
                self.retry(parameters);
            }
            Err(error) => self.waiting.push(Refused { name: name.into(), value, error }),
        }
        parameters.method != before
    }

    /// Puts a parameter back to what it is in the preset. Whether anything was set.
    pub fn reset(&mut self, parameters: &mut Parameters, parameter: &Parameter) -> bool {
        parameters.preset_value(parameter).is_some_and(|value| self.set(parameters, &parameter.name, value))
    }

    fn retry(&mut self, parameters: &mut Parameters) {
        let listed = parameters.method.parameters();
        for Refused { name, value, .. } in std::mem::take(&mut self.waiting) {
            if !listed.iter().any(|parameter| parameter.name == name && parameter.value.is_some()) {
                // Its group was left out.
                continue;
            }
            match parameters.method.with_parameter(&name, value.clone()) {
                Ok(method) => parameters.method = method,
                Err(error) => self.waiting.push(Refused { name, value, error }),
            }
        }
    }

    /// What a parameter was to be, where that cannot be as yet.
    pub fn refused(&self, name: &str) -> Option<&Refused> {
        self.waiting.iter().find(|refused| refused.name == name)
    }

    /// Whether any wait.
    pub fn any_wait(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Gives up what waits.
    pub fn clear(&mut self) {
        self.waiting.clear();
    }
}
