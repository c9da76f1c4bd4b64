//! `Kriging`: a Gaussian process over the transmitter position.

use super::log_distance::{fixed_end_position, log_distance, path_loss_points};
use super::pooled_kriging::{PooledKriging, format_digits};
use super::{ByReceiver, ReceiverPredictor, fitting_samples};
use pwrfgs_core::kriging::{
    Correlation, CorrelationKind, HeldOutCases, LocalKriging, Mean, PathLoss, Place, ProcessFit, SearchSpace, Solution,
    fit_correlation, fit_observations, link_place,
};
use pwrfgs_core::neighbours::{Nearest, nearest_before};
use pwrfgs_core::{
    Baseline, Dataset, FittingSet, Image, JsonSchema, Predict, Query, Real, Requirement, Result, Sampling, evenly, rng,
};
use serde::{Deserialize, Serialize};

/// Largest number of powers predicted in the fit.
const POWERS: usize = 320;
/// Number of earlier powers from which each is predicted.
const FROM_POWERS: usize = 16;

/// Ordinary kriging, a standard for radio coverage maps: best linear unbiased prediction of a Gaussian process over the
/// transmitter position.
///
/// Spectra are modelled as one Gaussian process. Its correlation over distance is exponential (Matern 1/2) or Matern 3/2,
/// with one length scale per axis, plus independent noise per spectrum. All pixels share that correlation, and so do
/// all principal components of the spectra. The prediction is a weighted sum of training spectra; weights add up to 1 and
/// may be negative.
///
/// Correlation, length scales and noise maximise the restricted likelihood of the training and validation spectra, with an
/// unknown mean per pixel; the variance follows in closed form. Spectra are fitted in compact blocks of at most 128; with more
/// than 8 blocks, 8 are chosen evenly. The prediction uses the nearest training and validation samples, in units of the length
/// scales. A note under the tables reports the fit.
///
/// Each receiver has its own process; a receiver without training links is predicted from all links.
///
/// Received powers of all receivers are fitted together: `RSSI = T + t_j - (G + g_j) log10(d) + s_j(x) + noise`. The
/// processes `s_j` of the receivers j are independent, with one variance, length scale and noise. Offsets `t_j` and slopes
/// `g_j` have normal priors of 15 dB and 8 dB per decade, T and G wide ones; without receiver positions the terms of the
/// distance are left out. Length scale and noise maximise the likelihood of at most 320 training and validation powers per
/// receiver, each given the 16 nearest before it in random order, times a prior of the length scale: log-normal about four
/// spacings of the positions, at most twice the site. The correlation is exponential or 1/(1 + distance), a long tail,
/// whichever is more probable; Matern 3/2 if this lowers the error on held-out blocks by more than its standard error. Far
/// from all measurements, and for a receiver without training links, the prediction is the path-loss model. Data with link
/// features in place of positions are an error.
///
/// ```
/// # use pwrfgs_core::{Baseline, Plugin};
/// # use pwrfgs_data as _;
/// assert_eq!(Plugin::<dyn Baseline>::parse("Kriging()").unwrap().name(), "Kriging");
/// assert_eq!(Plugin::<dyn Baseline>::parse("Kriging(time: true)").unwrap().name(), "Kriging, space and time");
/// assert!(Plugin::<dyn Baseline>::parse("Kriging(neighbours: 1)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Kriging {
    /// Number of samples per prediction, 2 to 512; time grows with its cube.
    pub neighbours: usize,
    /// Whether the process is over position and time, with ids as times: only for data with ids in order of time. A
    /// new position has no time, so this is an oracle baseline, which is not ranked: it shows how much spectra vary over time.
    pub time: bool,
}

impl Default for Kriging {
    fn default() -> Self {
        Self { neighbours: 48, time: false }
    }
}

#[typetag::serde]
impl Baseline for Kriging {
    fn name(&self) -> String {
        if self.time { "Kriging, space and time" } else { "Kriging" }.into()
    }

    fn requires(&self) -> &'static [Requirement] {
        &[Requirement::NoFeatures, Requirement::Positions]
    }

    fn fit<'a>(&self, data: &'a Dataset, fitting: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.check_data(data)?;
        if data.task().has_path_loss && !self.time {
            return Ok(Box::new(PooledKriging::fit(data, fitting, self.neighbours)?));
        }
        let fit = |fitting: FittingSet<'_>| {
            let samples = fitting_samples(fitting)?;
            let trend = Trend::fit(data, &samples);
            let fitted = trend.fit_correlation(&samples, fitting, self.time)?;
            data.observations.check()?;
            Ok(Process::new(trend, fitted, samples, self.clone()))
        };
        Ok(Box::new(ByReceiver::fit(data, fitting, fit)?))
    }

    fn check(&self) -> Result<(), String> {
        if !(2..=512).contains(&self.neighbours) {
            return Err(format!("`neighbours` is {}; give a number from 2 to 512, such as 48", self.neighbours));
        }
        Ok(())
    }
}

/// Returns the links of `order` after the first, each with the `count` nearest of those before it: the conditioning
/// sets of the Vecchia approximation of a likelihood (Vecchia 1988).
pub fn vecchia_cases(data: &Dataset, order: &[usize], count: usize) -> Vec<(usize, Vec<usize>)> {
    let ranks: Vec<usize> = (1..order.len()).collect();
    let near = nearest_before(order, &ranks, count, 3, |i| data.sample(i).position());
    order.iter().copied().skip(1).zip(near).collect()
}

/// Trend that is subtracted from every observation: a path-loss model for received powers, none for others.
#[derive(Clone, Copy, Debug)]
pub struct Trend<'a> {
    data: &'a Dataset,
    path_loss: Option<PathLoss>,
}

impl<'a> Trend<'a> {
    /// Fits the path-loss model to these links by least squares; without distances or for other observations, there is none.
    pub fn fit(data: &'a Dataset, links: &[usize]) -> Self {
        let has_distances = data.task().has_path_loss && data.scene.has_distances();
        Self { data, path_loss: has_distances.then(|| PathLoss::fit(&path_loss_points(data, links))) }
    }

    /// Returns the power of the path-loss model for a link, dBm; 0 without a model.
    fn power(&self, query: Query<'_>) -> f64 {
        self.path_loss.map_or(0.0, |path_loss| path_loss.power(log_distance(self.data, query)))
    }

    /// Writes the residual of link `i` to `out`: at every `stride`-th column of every `stride`-th row of a spectrum, else its
    /// first values.
    fn write_residual(&self, i: usize, stride: usize, out: &mut [Real]) {
        self.data.observations.sampled(i, Sampling::every(stride), out);
        if self.path_loss.is_some() {
            out[0] -= self.power(self.data.query(i)) as Real;
        }
    }

    /// Returns the residual of the received power of link `i`, dB.
    fn residual_power(&self, i: usize) -> f64 {
        let mut residual = [0.0];
        self.write_residual(i, 1, &mut residual);
        f64::from(residual[0])
    }

    /// Returns the most likely correlation, with a scale of time if `time`, and its process variance per value.
    /// Without a path-loss model, fits as [`fit_observations`] does. With one, the likelihood is that of at most
    /// [`POWERS`] samples, each given the nearest of those before it in random order: the densities multiply to the joint density
    /// (Vecchia, Journal of the Royal Statistical Society B 50, 1988), and the first samples constrain long distances.
    /// Returns the errors of the search.
    fn fit_correlation(&self, samples: &[usize], fitting: FittingSet<'_>, time: bool) -> Result<(Correlation, f64)> {
        let check = || fitting.check_stopped();
        if self.path_loss.is_none() {
            let ProcessFit { correlation, variance, .. } = fit_observations(self.data, samples, time, &check)?;
            return Ok((correlation, variance));
        }
        let mut order = evenly(samples, POWERS);
        rng::shuffle(&mut rng::stream(0, "kriging", 0), &mut order);
        let cases = vecchia_cases(self.data, &order, FROM_POWERS);
        let cases =
            HeldOutCases::new(&cases, Mean::Unknown, |i| link_place(self.data, i), |_, i| self.residual_values(i, 1));
        let space = SearchSpace { kinds: &[CorrelationKind::Matern32], isotropic: true, time };
        let correlation = fit_correlation(&cases, space, &check)?;
        Ok((correlation, cases.variance(&correlation)))
    }

    /// Returns at most about `most` values, at least one, of the residual of link `i`: every n-th column of every n-th row of a
    /// spectrum, the first values of a channel.
    pub fn residual_values(&self, i: usize, most: usize) -> Vec<Real> {
        let Dataset { width, height, .. } = *self.data;
        let stride = ((width * height) as f64 / most as f64).sqrt().ceil().max(1.0) as usize;
        let mut pixels = vec![0.0; width.div_ceil(stride) * height.div_ceil(stride)];
        self.write_residual(i, stride, &mut pixels);
        pixels
    }
}

/// Process of one receiver, conditioned on its samples.
struct Process<'a> {
    trend: Trend<'a>,
    /// Samples that predictions use.
    samples: Vec<usize>,
    kriging: LocalKriging,
    /// Samples by position alone, for a process over time.
    in_space: Option<Nearest>,
    /// Process variance per value; NaN if no sample could be predicted from others.
    variance: f64,
    settings: Kriging,
}

impl Predict for Process<'_> {
    /// Returns the weighted sum of the nearest samples; with a path-loss model, that of their residuals added to its power.
    fn predict(&self, query: Query<'_>) -> Image {
        let Dataset { width, height, .. } = *self.trend.data;
        if self.trend.path_loss.is_none() {
            let mut values = vec![0.0; width * height];
            let add = |k: usize, weight: f64, sum: &mut [f64]| {
                self.trend.write_residual(self.samples[k], 1, &mut values);
                sum.iter_mut().zip(&values).for_each(|(sum, v)| *sum += weight * *v as f64);
            };
            let sum = self.kriging.weighted_sum(self.query_place(query), self.settings.neighbours, width * height, add);
            return Image { width, height, pixels: sum.into_iter().map(|v| v as Real).collect() };
        }
        let (near, Solution { weights, .. }) = self.solve_weights(query);
        let weighted = near.into_iter().map(|k| self.samples[k]).zip(weights);
        let residual = |(i, weight): (usize, f64)| weight * self.trend.residual_power(i);
        let dbm = self.trend.power(query) + weighted.map(residual).sum::<f64>();
        Image { width: 1, height: 1, pixels: vec![dbm as Real] }
    }

    fn predict_vjp(&self, query: Query<'_>, cotangent: &dyn Fn(&Image) -> Vec<Real>) -> Option<(Image, [f64; 3])> {
        let image = self.predict(query);
        let (d, data) = (cotangent(&image), self.trend.data);
        let along = |k: usize| {
            if self.trend.path_loss.is_some() {
                return f64::from(d[0]) * self.trend.residual_power(self.samples[k]);
            }
            let sample = data.image(self.samples[k]);
            sample.pixels.iter().zip(&d).map(|(v, d)| f64::from(*v) * f64::from(*d)).sum()
        };
        let mut d_tx = self.kriging.solve_vjp(self.query_place(query), self.settings.neighbours, along);
        if let Some(path_loss) = self.trend.path_loss {
            let slope = path_loss.power_gradient(query.position(), fixed_end_position(data, query));
            (0..3).for_each(|k| d_tx[k] += f64::from(d[0]) * slope[k]);
        }
        Some((image, d_tx))
    }

    fn deviation(&self, query: Query<'_>) -> Option<f64> {
        self.variance.is_finite().then(|| (self.variance * self.solve_weights(query).1.variance).sqrt())
    }

    fn is_oracle(&self) -> bool {
        self.settings.time // it uses the time of the test sample, which a new position does not have
    }
}

impl<'a> Process<'a> {
    /// Creates the process of `samples` with a fitted correlation and its process variance.
    fn new(trend: Trend<'a>, fitted: (Correlation, f64), samples: Vec<usize>, settings: Kriging) -> Self {
        let (data, (correlation, variance)) = (trend.data, fitted);
        let in_space = settings.time.then(|| Nearest::new(&samples, 3, |i| data.sample(i).position()));
        let mean = if trend.path_loss.is_some() { Mean::Zero } else { Mean::Unknown };
        let kriging = LocalKriging::new(correlation, mean, samples.iter().map(|&i| link_place(data, i)));
        Self { trend, samples, kriging, in_space, variance, settings }
    }

    /// Returns the indices in `samples` of the nearest samples of a query, and their weights with the variance.
    fn solve_weights(&self, query: Query<'_>) -> (Vec<usize>, Solution) {
        self.kriging.solve(self.query_place(query), self.settings.neighbours)
    }

    /// Returns the position of a query, metres from the origin, and its time, which is its id; without an id, the time of the
    /// nearest sample in space. The time is 0 for a process over position alone.
    fn query_place(&self, query: Query<'_>) -> Place {
        let [x, y, z] = self.trend.data.scene.origin.local(query.position()).map(|v| v as f64);
        let Some(in_space) = &self.in_space else { return [x, y, z, 0.0] };
        let nearest = || in_space.find(&query.position(), 1).1.first().map(|(_, i)| self.trend.data.sample(*i).id);
        [x, y, z, query.id.or_else(nearest).map_or(0.0, f64::from)]
    }
}

impl ReceiverPredictor for Process<'_> {
    fn combined_note(predictors: &[(&str, &Self)]) -> Option<String> {
        match predictors {
            [] => None,
            [(_, process)] => Some(process.describe_fit()),
            processes => Some(describe_fits(processes)),
        }
    }

    fn leaving_out(&self, links: &[usize]) -> Option<Self> {
        let samples: Vec<usize> =
            self.samples.iter().copied().filter(|sample| links.binary_search(sample).is_err()).collect();
        let fitted = (self.kriging.correlation, self.variance);
        (!samples.is_empty()).then(|| Self::new(self.trend, fitted, samples, self.settings.clone()))
    }
}

impl Process<'_> {
    /// Describes the fit of a single receiver.
    fn describe_fit(&self) -> String {
        let Correlation { kind, scales, noise } = &self.kriging.correlation;
        let [x, y, z, time] = scales.map(format_digits);
        let time = if self.settings.time { format!(", a time scale of {time} samples") } else { String::new() };
        let path_loss = self.trend.path_loss.map_or_else(String::new, |path_loss| {
            let (level, slope) = (format_digits(path_loss.level), format_digits(path_loss.slope));
            format!(", path loss of {level} dBm at 1 m and {slope} dB per decade")
        });
        format!(
            "Kriging found a correlation that is {} with length scales of {x}, {y} and {z} m{time}, and noise of {} of the \
             variance{path_loss}",
            kind.words(),
            format_digits(*noise)
        )
    }

    /// Describes the fit of one of several receivers in short, in the order of the header of [`describe_fits`].
    fn summarise_fit(&self) -> String {
        let Correlation { kind, scales, noise } = &self.kriging.correlation;
        let [x, y, z, _] = scales.map(format_digits);
        let scales = if x == y && y == z { x } else { format!("{x} x {y} x {z}") };
        let path_loss =
            self.trend.path_loss.map(|path_loss| [format_digits(path_loss.level), format_digits(path_loss.slope)]);
        let numbers =
            [kind.words().to_owned(), scales, format_digits(*noise)].into_iter().chain(path_loss.into_iter().flatten());
        numbers.collect::<Vec<_>>().join(", ")
    }
}

/// Describes the fits of several receivers, with every number, so that scores can be reproduced.
fn describe_fits(processes: &[(&str, &Process<'_>)]) -> String {
    let path_loss = if processes.iter().any(|(_, process)| process.trend.path_loss.is_some()) {
        ", path loss in dBm at 1 m and dB per decade"
    } else {
        ""
    };
    let list: Vec<String> =
        processes.iter().map(|(name, process)| format!("{name}: {}", process.summarise_fit())).collect();
    format!(
        "Kriging found, of {} receivers, correlations (length scales in m, noise in parts of the variance{path_loss}): {}",
        processes.len(),
        list.join("; ")
    )
}

#[cfg(test)]
mod tests;
