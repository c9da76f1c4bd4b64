//! `LeaveReceiverOut` and `RandomLinks`: split links instead of transmitters.

use super::{
    DEFAULT_VALIDATION, check_test_share, check_validation_share, hold_out_links, random_partition, share_count,
    sorted_partition,
};
use pwrfgs_core::messages::quoted;
use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{Dataset, Error, JsonSchema, Partition, Result, Split, did_you_mean};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Split by receiver: the test set is all links of the named receivers; the other links are for training.
///
/// Tests prediction at a receiver position without measurements. Validation is a share of the transmitters of the other
/// receivers, with all their links there. Leave out receivers at the same position together, such as `g08` and `g09` of
/// the NeRF2 powers.
///
/// The gain of an unseen receiver is unknown. `calibration` keeps a number of random links of each named receiver in
/// the training set, so that its offset can be learned.
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// let text = r#"LeaveReceiverOut(receivers: ["g08", "g09"], calibration: 20)"#;
/// assert!(Plugin::<dyn Split>::parse(text).is_ok());
/// assert!(Plugin::<dyn Split>::parse(r#"LeaveReceiverOut(receivers: ["g08", "g08"])"#).is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LeaveReceiverOut {
    /// Names of the receivers to leave out.
    pub receivers: Vec<String>,
    /// Number of links per named receiver that stay in the training set; 0 for none.
    pub calibration: usize,
    /// Share of the training transmitters held out for validation, in [0, 1); 0 for none.
    pub validation: f64,
}

impl Default for LeaveReceiverOut {
    fn default() -> Self {
        Self { receivers: Vec::new(), calibration: 0, validation: DEFAULT_VALIDATION }
    }
}

#[typetag::serde]
impl Split for LeaveReceiverOut {
    /// Moves all links of the named receivers to the test set, except for `calibration` random links of each.
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        let receivers = self.left_out_receivers(data)?;
        let is_left_out = |i: &usize| receivers.contains(&data.links[*i].receiver);
        let (mut test, fitting): (Vec<usize>, Vec<usize>) = (0..data.len()).partition(is_left_out);
        // Drawn before validation, which must not change the test set.
        let mut calibration = Vec::new();
        for receiver in receivers {
            let (mut links, others): (Vec<usize>, Vec<usize>) =
                test.into_iter().partition(|i| data.links[*i].receiver == receiver);
            if self.calibration > 0 && links.len() <= self.calibration {
                let (name, count) = (quoted(&data.scene.receivers[receiver].name), links.len());
                let problem = format!("{name} has {count} links in all, which leaves no test link");
                let setting = format!("LeaveReceiverOut(calibration: {})", self.calibration);
                return Err(Error::Config(format!("{setting}: {problem}; lower `calibration`")));
            }
            if self.calibration > 0 {
                rng::shuffle(rng, &mut links);
                calibration.extend(links.split_off(links.len() - self.calibration));
            }
            test = [others, links].concat();
        }
        let (mut train, validation) = hold_out_links(data, fitting, self.validation, rng);
        train.extend(calibration);
        sorted_partition(Partition { train, validation, test })
    }

    fn check(&self) -> Result<(), String> {
        let twice = self.receivers.iter().enumerate().find(|(k, name)| self.receivers[..*k].contains(name));
        if let Some((_, name)) = twice {
            return Err(format!("`receivers` names {} twice; name it once", quoted(name)));
        }
        check_validation_share(self.validation)
    }
}

impl LeaveReceiverOut {
    /// Returns the indices of the named receivers. Returns an error for an unknown name, no name, or all receivers.
    fn left_out_receivers(&self, data: &Dataset) -> Result<BTreeSet<usize>> {
        let names = || data.scene.receivers.iter().map(|receiver| receiver.name.as_str());
        let refuse = |problem: String| {
            const LISTED: usize = 40; // the message stays readable
            let valid = names().take(LISTED).map(quoted).collect::<Vec<_>>().join(", ");
            Err(Error::Config(format!("LeaveReceiverOut: {problem}; the receivers of {} are {valid}", data.title)))
        };
        if self.receivers.is_empty() {
            return refuse("name at least one of `receivers`".into());
        }
        let mut indices = BTreeSet::new();
        for name in &self.receivers {
            match names().position(|receiver| receiver == name) {
                Some(i) => indices.insert(i),
                None => return refuse(format!("unknown receiver {}{}", quoted(name), did_you_mean(name, names()))),
            };
        }
        if indices.len() == data.scene.receivers.len() {
            return refuse("no receiver is left to learn from".into());
        }
        Ok(indices)
    }
}

/// Random share of all links as the test set: most transmitters are then in training and test, at different receivers.
///
/// Tests prediction at one receiver from measurements at others. With one receiver it equals [`Random`](crate::Random).
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn Split>::parse("RandomLinks(test: 0.2, validation: 0.1)").is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RandomLinks {
    /// Share of all links in the test set, in (0, 1).
    pub test: f64,
    /// Share of the remaining links held out at random, in [0, 1); 0 for none.
    pub validation: f64,
}

impl Default for RandomLinks {
    fn default() -> Self {
        Self { test: 0.2, validation: DEFAULT_VALIDATION }
    }
}

#[typetag::serde]
impl Split for RandomLinks {
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        let test = share_count(self.test, data.len());
        sorted_partition(random_partition(data.len(), test, self.validation, rng))
    }

    /// Returns one unit per link.
    fn units(&self, _: &Dataset, links: &[usize]) -> Vec<Vec<usize>> {
        links.iter().map(|&i| vec![i]).collect()
    }

    fn check(&self) -> Result<(), String> {
        check_test_share("test", self.test)?;
        check_validation_share(self.validation)
    }
}
