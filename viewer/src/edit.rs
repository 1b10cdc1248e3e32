//! Changes of parameters by hand. A change that contradicts the other parameters is reported, and waits until it agrees
//! with them; meanwhile the last consistent parameters stay in use.

use stein::Error;
use stein::parameters::Value;

use crate::settings::Parameters;

/// A change that waits, because it contradicts other parameters.
#[derive(Debug)]
pub struct Refused {
    /// Name of the parameter.
    pub name: String,
    /// New value of the parameter.
    pub value: Value,
    /// Reason and remedy.
    pub error: Error,
}

/// All changes that wait.
#[derive(Debug, Default)]
pub struct Edits {
    waiting: Vec<Refused>,
}

impl Edits {
    /// Sets a parameter, and tries the waiting changes again. Returns whether anything was set.
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

    fn retry(&mut self, parameters: &mut Parameters) {
        let listed = parameters.method.parameters();
        for Refused { name, value, .. } in std::mem::take(&mut self.waiting) {
            if !listed.iter().any(|parameter| parameter.name == name && parameter.value.is_some()) {
                // The group of this parameter was left out.
                continue;
            }
            match parameters.method.with_parameter(&name, value.clone()) {
                Ok(method) => parameters.method = method,
                Err(error) => self.waiting.push(Refused { name, value, error }),
            }
        }
    }

    /// Returns the change of a parameter that waits, if there is one.
    pub fn refused(&self, name: &str) -> Option<&Refused> {
        self.waiting.iter().find(|refused| refused.name == name)
    }

    /// Returns whether any change waits.
    pub fn any_wait(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Drops all changes that wait.
    pub fn clear(&mut self) {
        self.waiting.clear();
    }
}
