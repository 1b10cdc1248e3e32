//! Access to the parameters of a method by their names.

use super::{DfcParams, GemParams, Method, NlmParams, Preset};
use crate::error::{Error, RequestCause, Result};
use crate::parameters::{Choice, Describe, Kind, Parameter, Value};

impl Method {
    /// Names of the methods, in the order of [`Method::all`].
    pub const NAMES: [&'static str; 3] = ["dfc", "gem", "nlm"];

    /// Name of the parameter that [`Method::with_window_radius`] changes.
    pub const WINDOW_RADIUS: &'static str = "window_radius";

    /// Name of the parameter that [`Method::with_candidates`] changes.
    pub const CANDIDATES: &'static str = "candidates";

    /// Name of the parameter that says whether a second pass follows.
    pub const SECOND_PASS: &'static str = "second_pass";

    /// Returns all methods, with the parameters of the default preset.
    pub fn all() -> [Self; 3] {
        [Self::Dfc(DfcParams::default()), Self::Gem(GemParams::default()), Self::Nlm(NlmParams::default())]
    }

    /// Returns names and descriptions of the methods, in the order of [`Method::all`].
    pub fn choices() -> [Choice; 3] {
        let about = |method: &Self| match method {
            Self::Dfc(_) => "Combined colour and feature filters.",
            Self::Gem(_) => "Greedy error minimisation over Gaussian scales; needs no features.",
            Self::Nlm(_) => {
                "Non-local means, each half of the samples filtered with the weights of the other; needs no features."
            }
        };
        Self::all().map(|method| Choice { name: method.name(), documentation: about(&method).into() })
    }

    /// Returns the method with the parameters of a preset.
    #[must_use]
    pub fn of_preset(&self, preset: Preset) -> Self {
        match (self, preset) {
            (Self::Dfc(_), Preset::Default) => Self::Dfc(DfcParams::default()),
            (Self::Dfc(_), Preset::Thesis) => Self::Dfc(DfcParams::thesis()),
            (Self::Gem(_), Preset::Default) => Self::Gem(GemParams::default()),
            (Self::Gem(_), Preset::Thesis) => Self::Gem(GemParams::thesis()),
            (Self::Nlm(_), Preset::Default) => Self::Nlm(NlmParams::default()),
            (Self::Nlm(_), Preset::Thesis) => Self::Nlm(NlmParams::thesis()),
        }
    }

    /// Returns the parameters with their documentation, ranges and values, in the order of their declaration.
    pub fn parameters(&self) -> Vec<Parameter> {
        match self {
            Self::Dfc(params) => params.parameters(),
            Self::Gem(params) => params.parameters(),
            Self::Nlm(params) => params.parameters(),
        }
    }

    /// Returns whether the method has a parameter of this name, even if its group is left out.
    pub fn has_parameter(&self, name: &str) -> bool {
        self.parameters().iter().any(|parameter| parameter.name == name)
    }

    /// Returns the method with another value of one parameter, named as in [`Method::parameters`].
    ///
    /// ```
    /// use stein::Method;
    ///
    /// let method = Method::default().with_parameter("window_radius", 5)?.with_parameter("guard", false)?;
    /// assert_eq!(method.window_radius(), 5);
    /// assert!(method.with_parameter("window_radius", 100).is_err());
    /// # Ok::<(), stein::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Request`] naming the parameter and its range: where the method has no parameter of that name, where its
    /// group is left out, where `value` is not allowed, or where `value` contradicts the other parameters.
    pub fn with_parameter(self, name: &str, value: impl Into<Value>) -> Result<Self> {
        let method = self.with_unchecked(name, &value.into())?;
        method.validate()?;
        Ok(method)
    }

    /// Returns the method with other values of several parameters, by name and by value as people write them; see
    /// [`Parameter::parse`]. Later settings build on earlier ones. Together, the settings must not contradict each
    /// other.
    ///
    /// # Errors
    /// As [`Method::with_parameter`].
    pub fn with_settings<'a>(self, settings: impl IntoIterator<Item = (&'a str, &'a str)>) -> Result<Self> {
        let mut method = self;
        for (name, text) in settings {
            let listed = method.parameters();
            let parameter =
                listed.iter().find(|parameter| parameter.name == name).ok_or_else(|| method.has_no(name))?;
            method = method.with_unchecked(name, &parameter.parse(text)?)?;
        }
        method.validate()?;
        Ok(method)
    }

    /// Sets a parameter without checking that it agrees with the others.
    pub(super) fn with_unchecked(mut self, name: &str, value: &Value) -> Result<Self> {
        let listed = self.parameters();
        let Some(parameter) = listed.iter().find(|parameter| parameter.name == name) else {
            return Err(self.has_no(name));
        };
        let value = parameter.settle(value)?;
        if parameter.value.is_none() {
            let is_out = |group: &&Parameter| {
                group.kind == Kind::Group && group.value == Some(Value::Flag(false)) && parameter.is_in(&group.name)
            };
            let group = listed.iter().find(is_out).map_or("", |group| group.name.as_str());
            return Err(Error::Request(RequestCause::GroupLeftOut { name: name.into(), group: group.into() }));
        }
        match &mut self {
            Self::Dfc(params) => params.set(name, &value),
            Self::Gem(params) => params.set(name, &value),
            Self::Nlm(params) => params.set(name, &value),
        }
        Ok(self)
    }

    /// Makes the error for a name that no parameter has.
    fn has_no(&self, name: &str) -> Error {
        let listed = self.parameters();
        let names_in = |group: &str| -> Vec<String> {
            listed
                .iter()
                .filter(|parameter| group.is_empty() || parameter.is_in(group))
                .map(|parameter| parameter.name.clone())
                .collect()
        };
        let (name, method) = (name.to_owned(), self.name());
        let members = names_in(&name);
        if !members.is_empty() {
            return Error::Request(RequestCause::ParameterGroup { name, members });
        }
        let others = Self::all().into_iter().filter(|other| other.has_parameter(&name));
        let others: Vec<_> = others.map(|other| other.name()).collect();
        if !others.is_empty() {
            return Error::Request(RequestCause::ParameterOfOthers { name, method, others });
        }
        let beside = names_in(name.rsplit_once('.').map_or("", |(group, _)| group));
        let names = if beside.is_empty() { names_in("") } else { beside };
        Error::Request(RequestCause::NoSuchParameter { name, method, names })
    }
}
