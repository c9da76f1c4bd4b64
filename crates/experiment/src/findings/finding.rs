//! `Finding`: implausible property of data, and what mends it.

use serde::{Deserialize, Serialize};
use std::fmt::{self, Display, Formatter};

/// Implausible property of data. Its text is one sentence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    /// Name, such as `orientation`: equal for all data with this fault.
    pub name: String,
    /// Number of transmitters, links or points that show it.
    pub count: usize,
    /// Problem, with its numbers.
    pub problem: String,
    /// Option, setting or conversion that mends it.
    pub mend: String,
}

impl Finding {
    /// Creates a finding that `count` transmitters, links or points show.
    pub(super) fn new(name: &str, count: usize, problem: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { name: name.into(), count, problem: problem.into(), mend: mend.into() }
    }
}

impl Display for Finding {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { name, problem, mend, .. } = self;
        write!(f, "{name}: {problem}; {mend}")
    }
}
