//! `Finding`: implausible property of data, and what mends it.

use pwrfgs_core::{Dataset, Error, Result, did_you_mean};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt::{self, Display, Formatter};

/// Names of the findings that make results meaningless: they stop a command that does not accept them. The others warn.
const ERRORS: [&str; 10] = [
    "axes",
    "channel-phase",
    "conjugate",
    FAR,
    "index-coordinate",
    "lone-value",
    "position-unit",
    "power-unit",
    "receiver-order",
    "row-order",
];
/// Name of the finding that most links of new data lie outside the intervals of a model.
const FAR: &str = "far-from-model";

/// Implausible property of data. Its text is one sentence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    /// Name, such as `orientation`: equal for all data with this fault.
    pub name: String,
    /// Number of transmitters, links or points that show it.
    pub count: usize,
    /// Problem, with its numbers and an example.
    pub problem: String,
    /// Option, setting or conversion that mends it.
    pub mend: String,
}

impl Finding {
    /// Creates a finding that `count` transmitters, links or points show. Its `name` decides whether it is an error.
    pub(super) fn new(name: &str, count: usize, problem: impl Into<String>, mend: impl Into<String>) -> Self {
        Self { name: name.into(), count, problem: problem.into(), mend: mend.into() }
    }

    /// Creates the finding that new data, of `count` links, are far from a model.
    pub fn far_from_model(count: usize, problem: impl Into<String>) -> Self {
        let mend = "check the order, units, axes and poses of the data; accept it if the room has changed";
        Self::new(FAR, count, problem, mend)
    }

    /// Returns whether it makes results meaningless, and stops a command that does not accept it.
    pub fn is_error(&self) -> bool {
        ERRORS.contains(&self.name.as_str())
    }
}

impl Display for Finding {
    /// Writes name, problem and correction: `axes: the level of the links ..; exchange x and y`.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { name, problem, mend, .. } = self;
        write!(f, "{name}: {problem}; {mend}")
    }
}

/// Returns the noun of the end that moves.
pub(super) fn moving_end(data: &Dataset) -> &'static str {
    if data.scene.moving.is_receiver() { "receiver pose" } else { "transmitter" }
}

/// Names a link in a sentence: `transmitter 17 at receiver g2`.
pub(super) fn name_link(data: &Dataset, link: usize) -> String {
    let sample = data.sample(link);
    let (end, id) = (moving_end(data), sample.id);
    match &data.scene.receivers[..] {
        [_] => format!("{end} {id}"),
        receivers => {
            format!("{end} {id} at receiver {}", pwrfgs_core::messages::strip_control(&receivers[sample.receiver].name))
        }
    }
}

/// Rejects findings that are errors, except for the names in `accepted`.
///
/// # Errors
/// [`Error::Config`] with all of them, or if a name in `accepted` is unknown.
pub fn reject_findings(findings: &[Finding], accepted: &[String]) -> Result<()> {
    if let Some(name) = accepted.iter().find(|name| !ERRORS.contains(&name.as_str())) {
        let near = did_you_mean(name, ERRORS);
        let names = ERRORS.join(", ");
        return Err(Error::Config(format!("--accept {name}: no such finding{near} (findings: {names})")));
    }
    let refused: Vec<&Finding> =
        findings.iter().filter(|finding| finding.is_error() && !accepted.contains(&finding.name)).collect();
    if refused.is_empty() {
        return Ok(());
    }
    let list: Vec<String> = refused.iter().map(|finding| format!("  {finding}")).collect();
    let names: BTreeSet<&String> = accepted.iter().chain(refused.iter().map(|finding| &finding.name)).collect();
    let options: Vec<String> = names.into_iter().map(|name| format!("--accept {name}")).collect();
    let (problem, advice) = ("the data would give meaningless results", "or, if the data are right, add");
    Err(Error::Config(format!("{problem}:\n{}\n{advice} `{}`", list.join("\n"), options.join(" "))))
}
