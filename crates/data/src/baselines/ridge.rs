//! `Ridge`: linear regression from features to observations.

use super::{ByReceiver, ReceiverPredictor, fitting_samples};
use pwrfgs_core::{
    Baseline, Cholesky, Dataset, Error, FittingSet, Image, JsonSchema, Predict, Query, Real, Requirement, Result,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Ridge regression from link features, such as the uplink channel, to observations, per receiver.
///
/// y = ȳ + B (x − x̄) with B the minimum of Σ|y − ŷ|² + λ|B|² over the training links; λ is `weight` times the mean of
/// Σ(x − x̄)² over the features. With few paths, the downlink is a nearly linear function of the uplink, so this is the
/// reference baseline of that task.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("Ridge()").unwrap().name(), "ridge");
/// assert!(Plugin::<dyn Baseline>::parse("Ridge(weight: 0)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Ridge {
    /// Ridge weight, relative to the mean square of the features.
    pub weight: f64,
}

impl Default for Ridge {
    fn default() -> Self {
        Self { weight: 1e-3 }
    }
}

#[typetag::serde]
impl Baseline for Ridge {
    fn name(&self) -> String {
        "ridge".into()
    }

    fn requires(&self) -> &'static [Requirement] {
        &[Requirement::Features]
    }

    fn fit<'a>(&self, data: &'a Dataset, fitting: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        let fit = |fitting: FittingSet<'_>| LinearMap::fit(data, fitting, self.weight);
        Ok(Box::new(ByReceiver::fit(data, fitting, fit)?))
    }

    fn check(&self) -> Result<(), String> {
        if self.weight > 0.0 && self.weight.is_finite() {
            return Ok(());
        }
        Err(format!("`weight` is {}; give a number above 0, such as 1e-3", self.weight))
    }
}

/// Linear map of one receiver.
struct LinearMap {
    /// Means of features `[D]` and of observations `[M]`.
    means: [Vec<f64>; 2],
    /// Regression matrix `[M,D]`.
    slopes: Vec<f64>,
    /// Width and height of an observation.
    size: [usize; 2],
}

impl LinearMap {
    /// Fits the map to links by ridge regression, a system of D x D equations: see [`Ridge`]. Returns an error if there
    /// are no links, if the features are too large, or if the flag of `fitting` ends the fit.
    fn fit(data: &Dataset, fitting: FittingSet<'_>, weight: f64) -> Result<Self> {
        let links = fitting_samples(fitting)?;
        let xs: Vec<&[Real]> = links.iter().filter_map(|&i| data.query(i).features).collect();
        let ys: Vec<Vec<Real>> = links.iter().map(|&i| data.image(i).pixels).collect();
        let (x_mean, y_mean) = (mean_row(&xs), mean_row(&ys));
        let (d, m) = (x_mean.len(), y_mean.len());
        let mut gram = vec![0.0; d * d];
        gram.par_chunks_exact_mut(d).enumerate().try_for_each(|(i, sums)| {
            fitting.check_stopped()?;
            for row in &xs {
                let x = row[i] as f64 - x_mean[i];
                (0..=i).for_each(|j| sums[j] += x * (row[j] as f64 - x_mean[j]));
            }
            Result::Ok(())
        })?;
        // Above 0 even if all features are constant.
        let ridge = weight * (0..d).map(|k| gram[k * d + k]).sum::<f64>() / d as f64 + f64::MIN_POSITIVE;
        (0..d).for_each(|k| gram[k * d + k] += ridge);
        let too_large = || Error::Config("Ridge(): features are too large for a linear map; scale them".into());
        let factor = Cholesky::new(gram, d).ok_or_else(too_large)?;
        let mut slopes = vec![0.0; m * d];
        slopes.par_chunks_exact_mut(d).enumerate().try_for_each(|(n, slope)| {
            fitting.check_stopped()?;
            for (x, y) in xs.iter().zip(&ys) {
                let y = y[n] as f64 - y_mean[n];
                slope.iter_mut().zip(*x).zip(&x_mean).for_each(|((sum, x), mean)| *sum += y * (*x as f64 - mean));
            }
            factor.solve(slope);
            Result::Ok(())
        })?;
        Ok(Self { means: [x_mean, y_mean], slopes, size: [data.width, data.height] })
    }
}

/// Returns the mean of `rows`, at least one, column by column.
fn mean_row(rows: &[impl AsRef<[Real]>]) -> Vec<f64> {
    let mut sum = vec![0.0; rows[0].as_ref().len()];
    for row in rows {
        sum.iter_mut().zip(row.as_ref()).for_each(|(sum, v)| *sum += *v as f64);
    }
    sum.into_iter().map(|v| v / rows.len() as f64).collect()
}

impl Predict for LinearMap {
    fn predict(&self, query: Query<'_>) -> Image {
        let [x_mean, y_mean] = &self.means;
        let x: Vec<f64> =
            query.features.unwrap_or_default().iter().zip(x_mean).map(|(x, mean)| *x as f64 - mean).collect();
        let along = |slope: &[f64]| slope.iter().zip(&x).map(|(b, x)| b * x).sum::<f64>();
        let rows = self.slopes.chunks_exact(x.len().max(1)).zip(y_mean);
        let pixels = rows.map(|(slope, mean)| (mean + along(slope)) as Real).collect();
        Image { width: self.size[0], height: self.size[1], pixels }
    }
}

impl ReceiverPredictor for LinearMap {
    fn combined_note(_: &[(&str, &Self)]) -> Option<String> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Features, Observations, Pose, Receiver, Sample, rng};

    /// Powers are 3 − x₀ + 2x₁ at the first receiver and 5 x₀ at the second, as functions of two features.
    #[test]
    fn ridge_recovers_linear_map_per_receiver() {
        let receivers = ["a", "b"].map(|name| Receiver::new(name, Pose::IDENTITY)).to_vec();
        let random = &mut rng::stream(0, "ridge", 0);
        let x: Vec<[Real; 2]> = (0..30).map(|_| [rng::normal(random), rng::normal(random)]).collect();
        let power = |k: usize, receiver: usize| match receiver {
            0 => 3.0 - x[k][0] + 2.0 * x[k][1],
            _ => 5.0 * x[k][0],
        };
        let at = |k: u32, receiver| Sample { receiver, ..Sample::new(k, [0.0; 3]) };
        let samples: Vec<Sample> = (0..30).flat_map(|k| [at(k, 0), at(k, 1)]).collect();
        let powers = samples.iter().map(|s| power(s.id as usize, s.receiver)).collect();
        let data = Dataset::of_links("x", receivers, vec![], &samples, Observations::Powers(powers)).unwrap();
        assert!(
            Ridge::default().fit(&data, FittingSet::train(&[0])).err().unwrap().to_string().contains("data have none")
        );
        let values = samples.iter().flat_map(|s| x[s.id as usize]).collect();
        let features = Some(Features { width: 2, values });
        let data = Dataset { features, ..data };
        let train: Vec<usize> = (0..40).collect();
        let fitted = Ridge { weight: 1e-9 }.fit(&data, FittingSet::train(&train)).unwrap();
        for i in 40..60 {
            let (found, truth) = (fitted.predict(data.query(i)).pixels[0], data.image(i).pixels[0]);
            assert!((found - truth).abs() < 1e-4, "{found} {truth}");
        }
        let first: Vec<usize> = (0..40).step_by(2).collect();
        let one = Ridge { weight: 1e-9 }.fit(&data, FittingSet::train(&first)).unwrap();
        assert!(one.note().unwrap().starts_with("b has no training link"));
    }
}
