//! The set of candidates that take part.

use std::fmt;

use serde::{Serialize, Serializer};

use crate::parameters::{Describe, Parameter, Place, Value, Values, choice_set};
use crate::stage::candidate_filter::CandidateFilter;

choice_set! {
    /// Candidates that take part: in the selection, in the guard, and in the computation at all.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub struct CandidateSet {
        /// Small patches: sharp.
        pub first,
        /// Large patches: smooth.
        pub second,
        /// Features alone.
        pub third,
    }
}

impl CandidateSet {
    /// All three.
    pub const ALL: Self = Self { first: true, second: true, third: true };

    /// Names of the candidates, in their order.
    pub const NAMES: [&str; 3] = ["first", "second", "third"];

    /// Returns whether each candidate takes part, in their order.
    pub fn flags(self) -> [bool; 3] {
        [self.first, self.second, self.third]
    }

    /// Returns the names of the candidates that take part.
    pub fn names(self) -> Vec<&'static str> {
        Self::NAMES.into_iter().zip(self.flags()).filter_map(|(name, takes_part)| takes_part.then_some(name)).collect()
    }

    /// Returns the number of candidates that take part.
    pub fn count(self) -> usize {
        self.flags().into_iter().filter(|takes_part| *takes_part).count()
    }
}

impl fmt::Display for CandidateSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.names().join(", "))
    }
}

impl Serialize for CandidateSet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.names())
    }
}

/// Candidates that a program adds, which have no names among the parameters.
impl Describe for &'static [CandidateFilter] {
    type Limits = ();

    fn list(_: Values<Self>, _: Place<'_>, (): (), _: &mut Vec<Parameter>) {}

    fn set(&mut self, _: &str, _: &Value) {}
}
