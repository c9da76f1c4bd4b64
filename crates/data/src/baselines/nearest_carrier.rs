//! `NearestCarrier`: the observation at the nearest carrier.

use super::{all_of, of_receivers, weighted_mean};
use pwrfgs_core::neighbours::Nearest;
use pwrfgs_core::{Baseline, Dataset, Error, FittingSet, Image, JsonSchema, Predict, Query, Result};
use serde::{Deserialize, Serialize};

/// Observation of the same transmitter at the nearest training carrier, for data with several carriers.
///
/// Carriers are compared by the logarithm of their frequency. If no training carrier was observed at the position, the
/// prediction is the observation at the nearest position of the nearest carrier. It copies: it uses no other carrier.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("NearestCarrier()").unwrap().name(), "nearest carrier");
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NearestCarrier {}

#[typetag::serde]
impl Baseline for NearestCarrier {
    fn name(&self) -> String {
        "nearest carrier".into()
    }

    fn check_data(&self, data: &Dataset) -> Result<()> {
        if data.scene.receivers.len() > 1 && data.scene.receivers.iter().all(|own| own.carrier_hz.is_some()) {
            return Ok(());
        }
        let what = "has one carrier, but NearestCarrier needs several; use NearestNeighbours(k: 1)";
        Err(Error::Config(format!("{} {what}", data.title)))
    }

    fn fit<'a>(&self, data: &'a Dataset, known: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        let lookup = |links: Vec<usize>| Nearest::new(links, 3, |i| data.sample(i).tx.to_vec());
        let own = of_receivers(data, &all_of(known)?).into_iter().enumerate();
        let known = own.filter(|(_, links)| !links.is_empty()).map(|(receiver, links)| (receiver, lookup(links)));
        Ok(Box::new(CarrierLookup { data, known: known.collect() }))
    }
}

/// Training links of each carrier that has some, by position.
struct CarrierLookup<'a> {
    data: &'a Dataset,
    known: Vec<(usize, Nearest)>,
}

impl Predict for CarrierLookup<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        let log_hz = |receiver: usize| self.data.scene.receivers[receiver].carrier_hz.unwrap_or(1.0).ln();
        let distance = |known: &&(usize, Nearest)| (log_hz(known.0) - log_hz(query.receiver)).abs();
        let mut known: Vec<_> = self.known.iter().collect();
        known.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        let mut found = known.iter().map(|(_, links)| links.find(&query.tx, 1)).peekable();
        let nearest: Vec<usize> = found.peek().into_iter().flat_map(|(_, near)| near).map(|(_, i)| *i).collect();
        let same = found.map(|(exact, _)| exact).find(|exact| !exact.is_empty());
        let weighted: Vec<(usize, f64)> = same.unwrap_or(nearest).into_iter().map(|i| (i, 1.0)).collect();
        weighted_mean(self.data, &weighted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    #[test]
    fn predicts_same_position_at_nearest_carrier() {
        // Positions 0, 1 and 2; grey values 10 c + x at carrier c; position 2 only at the first and last.
        let rows = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (2, 0), (2, 2)];
        let sample = |(i, (x, _)): (usize, &(u8, u8))| Sample::new(i as u32 + 1, [f64::from(*x), 0.0, 0.0]);
        let grey = rows.iter().map(|(x, c)| 10 * c + x).collect();
        let carriers: Vec<f64> = rows.iter().map(|(_, c)| 2e9 + 1e8 * f64::from(*c)).collect();
        let samples = rows.iter().enumerate().map(sample).collect();
        let data = Dataset::new("room", Pose::IDENTITY, vec![], samples, Spectra::grey((1, 1), grey).unwrap()).unwrap();
        assert!(NearestCarrier {}.check_data(&data).unwrap_err().to_string().contains("has one carrier"));
        let data = data.with_carriers(&carriers).unwrap();
        let predict = |train: &[usize], x: f64, receiver: usize| {
            let fitted = NearestCarrier {}.fit(&data, FittingSet::train(train)).unwrap();
            (255.0 * fitted.predict(Query::at([x, 0.0, 0.0], receiver)).pixels[0]).round()
        };
        // 2.1 GHz is left out: 2.2 GHz is nearer to it than 2 GHz on a logarithmic scale.
        assert_eq!(predict(&[0, 2, 3, 5, 6, 7], 1.0, 1), 21.0);
        assert_eq!(predict(&[0, 1, 3, 4, 6], 2.0, 2), 2.0, "position 2 is known at 2 GHz alone");
        assert_eq!(predict(&[0, 2, 3, 5, 6], 1.2, 1), 21.0, "an unknown position has the nearest one");
    }
}
