//! `LogDistance`: path-loss model, in which power falls by 10 gamma decibels per decade of distance.

use super::fitting_samples;
use pwrfgs_core::kriging::{self, PathLoss};
use pwrfgs_core::messages::strip_control;
use pwrfgs_core::{Baseline, Dataset, FittingSet, Image, JsonSchema, Predict, Query, Real, Requirement, Result, Task};
use serde::{Deserialize, Serialize};

/// Number of links that a receiver needs for a fit of T and gamma.
const FEW: usize = 3;

/// Path-loss model fitted by least squares: RSSI = T - 10 gamma log10(d), d in metres from transmitter to receiver.
///
/// One T and one gamma for all receivers is called MRI in NeRF2. `offset` fits one T per receiver, its gain, and a
/// shared gamma; `per_receiver` fits T and gamma per receiver. A receiver with fewer than three training links uses the
/// shared gamma and an offset from its links; a receiver without any uses the T of all training links. A note under the
/// table lists such receivers. For received powers only.
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
    /// Whether to fit T and gamma per receiver.
    pub per_receiver: bool,
    /// Whether to fit T per receiver; `per_receiver` includes this.
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

    fn requires(&self) -> &'static [Requirement] {
        &[Requirement::Positions, Requirement::Distances]
    }

    fn fit<'a>(&self, data: &'a Dataset, fitting: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        let links_by_receiver = data.group_by_receiver(fitting_samples(fitting)?);
        let points: Vec<_> = links_by_receiver.iter().map(|links| path_loss_points(data, links)).collect();
        let groups: Vec<&[(f64, f64)]> = points.iter().map(Vec::as_slice).collect();
        let (shared, levels) = PathLoss::fit_groups(&groups);
        let pooled = PathLoss::fit(&groups.concat());
        let fit = |(points, level): (&&[(f64, f64)], f64)| match points.len() {
            FEW.. if self.per_receiver => PathLoss::fit(points),
            _ if self.per_receiver || self.offset => PathLoss { level, ..shared },
            _ => pooled,
        };
        let by_receiver = groups.iter().zip(levels).map(fit).collect();
        // An offset needs one link; without either setting, no receiver needs any.
        let enough = if self.per_receiver { FEW } else { usize::from(self.offset) };
        let names = data.scene.receivers.iter().map(|receiver| strip_control(&receiver.name));
        let borrowed = names.zip(&groups).filter(|(_, points)| points.len() < enough).map(|(name, _)| name).collect();
        Ok(Box::new(PathLosses { data, by_receiver, borrowed }))
    }

    fn tasks(&self) -> &'static [Task] {
        &[Task::Power]
    }
}

/// Path-loss model of each receiver.
struct PathLosses<'a> {
    data: &'a Dataset,
    by_receiver: Vec<PathLoss>,
    /// Names of the receivers with too few links for their own fit.
    borrowed: Vec<String>,
}

impl PathLosses<'_> {
    /// Returns the model of the receiver of a query, or of the first receiver for an unknown one.
    fn path_loss_for(&self, query: Query<'_>) -> PathLoss {
        *self.by_receiver.get(query.receiver).or(self.by_receiver.first()).expect("data have a receiver")
    }
}

impl Predict for PathLosses<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        let dbm = self.path_loss_for(query).power(log_distance(self.data, query));
        Image { width: 1, height: 1, pixels: vec![dbm as Real] }
    }

    fn predict_vjp(&self, query: Query<'_>, cotangent: &dyn Fn(&Image) -> Vec<Real>) -> Option<(Image, [f64; 3])> {
        let image = self.predict(query);
        let d = f64::from(cotangent(&image)[0]);
        let slope = self.path_loss_for(query).power_gradient(query.position(), fixed_end_position(self.data, query));
        Some((image, slope.map(|slope| d * slope)))
    }

    fn note(&self) -> Option<String> {
        let names = self.borrowed.join(", ");
        (!names.is_empty()).then(|| {
            format!(
                "{names} has too few training links for its own path-loss model and shares parameters of the others"
            )
        })
    }
}

/// Returns log10 of the distance from transmitter to receiver, metres.
pub(super) fn log_distance(data: &Dataset, query: Query<'_>) -> f64 {
    kriging::log_distance(query.position(), fixed_end_position(data, query))
}

/// Returns the position of the fixed end of a link, metres, world frame: its receiver, or the transmitter if receivers
/// move.
pub(super) fn fixed_end_position(data: &Dataset, query: Query<'_>) -> [f64; 3] {
    data.scene.origin.world_pose(data.scene.fixed_end(query.receiver)).position
}

/// Returns the points to fit a path-loss model to, one per power link: log10 of the distance in metres, and dBm.
pub(super) fn path_loss_points(data: &Dataset, links: &[usize]) -> Vec<(f64, f64)> {
    let point = |&i: &usize| (log_distance(data, data.query(i)), data.image(i).pixels[0] as f64);
    links.iter().map(point).collect()
}
