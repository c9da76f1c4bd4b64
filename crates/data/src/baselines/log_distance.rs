//! `LogDistance`: power falls with distance, and nothing else is known.

use super::all_of;
use super::law::{Law, log_distance, points};
use pwrfgs_core::words::clean;
use pwrfgs_core::{Baseline, Dataset, Error, Image, JsonSchema, Known, Predict, Query, Real, Result, Task};
use serde::{Deserialize, Serialize};

/// Links that a receiver needs to have a law of its own.
const FEW: usize = 3;

/// A law of distance by least squares: RSSI = T - 10 gamma log10(d), with d in metres from transmitter to receiver.
///
/// One T and one gamma for all receivers is what NeRF2 calls MRI. With `offset` each receiver has a T of its own, its
/// gain, and gamma is shared; with `per_receiver` each has T and gamma of its own. A receiver with fewer than
/// three training links has the shared gamma and an offset from the links it has; one without any has the T of all
/// training links together. A note under the table names such receivers. It is for received powers alone.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("LogDistance()").unwrap().name(), "log-distance");
/// let text = "LogDistance(per_receiver: true)";
/// assert_eq!(Plugin::<dyn Baseline>::parse(text).unwrap().name(), "log-distance, per receiver");
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LogDistance {
    /// Whether T and gamma are fitted for each receiver.
    pub per_receiver: bool,
    /// Whether T alone is fitted for each receiver; `per_receiver` does that too.
    pub offset: bool,
}

#[typetag::serde]
impl Baseline for LogDistance {
    fn name(&self) -> String {
        match (self.per_receiver, self.offset) {
            (true, _) => "log-distance, per receiver".into(),
            (_, true) => "log-distance, offset".into(),
            _ => "log-distance".into(),
        }
    }

    fn check_data(&self, data: &Dataset) -> Result<()> {
        if data.task().is_scalar && data.placed {
            return Ok(());
        }
        let holds = if data.placed { data.task().plural } else { "no places of transmitters" };
        let what =
            format!("LogDistance() is a law of received powers at known places, and {} holds {holds}", data.title);
        Err(Error::Config(format!("{what}; remove it from `baselines`")))
    }

    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        let mut own = vec![Vec::new(); data.scene.receivers.len()];
        all_of(known)?.into_iter().for_each(|i| own[data.links[i].receiver].push(i));
        let own: Vec<Vec<(f64, f64)>> = own.iter().map(|links| points(data, links)).collect();
        let groups: Vec<&[(f64, f64)]> = own.iter().map(Vec::as_slice).collect();
        let (shared, levels) = Law::with_offsets(&groups);
        let one = Law::fit(&groups.concat());
        let law = |(points, level): (&&[(f64, f64)], f64)| match points.len() {
            FEW.. if self.per_receiver => Law::fit(points),
            _ if self.per_receiver || self.offset => Law { level, ..shared },
            _ => one,
        };
        let of_each = groups.iter().zip(levels).map(law).collect();
        let enough = if self.per_receiver { FEW } else { usize::from(self.offset) };
        let names = data.scene.receivers.iter().map(|receiver| clean(&receiver.name));
        let borrowed = names.zip(&groups).filter(|(_, own)| own.len() < enough).map(|(name, _)| name).collect();
        Ok(Box::new(Laws { data, of_each, borrowed }))
    }

    fn supports(&self, task: Task) -> bool {
        task.is_scalar
    }
}

struct Laws<'a> {
    data: &'a Dataset,
    of_each: Vec<Law>,
    /// Receivers with too few links for a law of their own.
    borrowed: Vec<String>,
}

impl Predict for Laws<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        let law = self.of_each.get(query.receiver).or(self.of_each.first()).expect("data have a receiver");
        let dbm = law.at(log_distance(self.data, query));
        Image { width: 1, height: 1, pixels: vec![dbm as Real] }
    }

    fn note(&self) -> Option<String> {
        let names = self.borrowed.join(", ");
        (!names.is_empty()).then(|| {
            format!("{names} has too few training links for a law of distance of its own and shares that of the others")
        })
    }
}
