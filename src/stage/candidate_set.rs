//! Which of the candidates of DFC take part.

use std::fmt;

use serde::{Serialize, Serializer};

use crate::gpu::Definition;
use crate::parameters::choice_set;

choice_set! {
    /// Which of FIRST, SECOND and THIRD take part: in the selection, in the guard, and in what is computed at all.
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

    /// Their names, in their order.
    pub const NAMES: [&str; 3] = ["first", "second", "third"];

    /// Whether each of them takes part, in their order.
    pub fn flags(self) -> [bool; 3] {
        [self.first, self.second, self.third]
    }

    /// The names of those that take part.
    pub fn names(self) -> Vec<&'static str> {
        Self::NAMES.into_iter().zip(self.flags()).filter_map(|(name, takes_part)| takes_part.then_some(name)).collect()
    }

    /// How many take part.
    pub fn count(self) -> usize {
        self.flags().into_iter().filter(|takes_part| *takes_part).count()
    }

    /// Whether any of them looks at the colour: THIRD knows none.
    pub(super) fn by_color(self) -> bool {
        self.first || self.second
    }

    /// What tells the shaders.
    pub(super) fn definitions(self) -> [(&'static str, Definition); 3] {
        [("FIRST", self.first.into()), ("SECOND", self.second.into()), ("THIRD", self.third.into())]
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
