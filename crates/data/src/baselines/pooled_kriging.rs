//! Kriging of received powers: path loss and process of all receivers, fitted together.

use super::{LISTED, fitting_samples};
use pwrfgs_core::kriging::{
    Correlation, LocalKriging, PathLoss, Place, ProcessFit, fit_powers, link_place, spatial_place,
};
use pwrfgs_core::messages::{join_names, strip_control};
use pwrfgs_core::{Dataset, FittingSet, Image, Predict, Query, Real, Result};

/// Pooled Kriging of the powers of all receivers.
pub(super) struct PooledKriging<'a> {
    data: &'a Dataset,
    /// Fits of the receivers, with a common correlation and variance.
    fits: Vec<ProcessFit>,
    processes: Vec<Process>,
    neighbours: usize,
}

/// Links of one receiver that predictions use.
struct Process {
    links: Vec<usize>,
    /// Differences of their powers from the path-loss model, dB.
    residuals: Vec<Real>,
    kriging: LocalKriging,
}

impl<'a> PooledKriging<'a> {
    /// Fits path loss and process to the training and validation powers. Returns an error if there are none, or if the flag of
    /// `fitting` ends the fit.
    pub(super) fn fit(data: &'a Dataset, fitting: FittingSet<'_>, neighbours: usize) -> Result<Self> {
        let samples = fitting_samples(fitting)?;
        let fits = fit_powers(data, &samples, &|| fitting.check_stopped())?;
        data.observations.check()?;
        Ok(Self::new(data, fits, data.group_by_receiver(samples), neighbours))
    }

    /// Creates the predictor from the fit and the links of each receiver; `neighbours` is the number of links per prediction.
    fn new(data: &'a Dataset, fits: Vec<ProcessFit>, links: Vec<Vec<usize>>, neighbours: usize) -> Self {
        let process = |(links, fit): (Vec<usize>, &ProcessFit)| {
            let residual =
                |&i: &usize| (data.image(i).pixels[0] as f64 - fit.trend.expected(0.0, link_place(data, i))) as Real;
            let kriging = fit.process(links.iter().map(|&i| link_place(data, i)));
            Process { residuals: links.iter().map(residual).collect(), links, kriging }
        };
        let processes = links.into_iter().zip(&fits).map(process).collect();
        Self { data, fits, processes, neighbours }
    }

    /// Returns the fit of the receiver of a query, or of the first one for an unknown receiver.
    fn fit_for(&self, query: Query<'_>) -> &ProcessFit {
        self.fits.get(query.receiver).or(self.fits.first()).expect("data have a receiver")
    }

    /// Returns the position of a query, metres from the origin, at time 0.
    fn place(&self, query: Query<'_>) -> Place {
        spatial_place(self.data.scene.origin.local(query.position()).map(|v| v as f64))
    }

    /// Returns the process of the receiver of a query; `None` if it has no links.
    fn process(&self, query: Query<'_>) -> Option<&Process> {
        self.processes.get(query.receiver).filter(|process| !process.links.is_empty())
    }
}

impl Predict for PooledKriging<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        let (trend, at) = (&self.fit_for(query).trend, self.place(query));
        let residual = |process: &Process| {
            let add = |k: usize, weight: f64, sum: &mut [f64]| sum[0] += weight * process.residuals[k] as f64;
            process.kriging.weighted_sum(at, self.neighbours, 1, add)[0]
        };
        let dbm = trend.expected(0.0, at) + self.process(query).map_or(0.0, residual);
        Image { width: 1, height: 1, pixels: vec![dbm as Real] }
    }

    fn predict_vjp(&self, query: Query<'_>, cotangent: &dyn Fn(&Image) -> Vec<Real>) -> Option<(Image, [f64; 3])> {
        let (image, at) = (self.predict(query), self.place(query));
        let d = f64::from(cotangent(&image)[0]);
        let slope = self.fit_for(query).trend.path_loss_vjp(d, at);
        let residual =
            |process: &Process| process.kriging.solve_vjp(at, self.neighbours, |k| d * process.residuals[k] as f64);
        let gradient = self.process(query).map_or([0.0; 3], residual);
        Some((image, [0, 1, 2].map(|k| slope[k] + gradient[k])))
    }

    fn deviation(&self, query: Query<'_>) -> Option<f64> {
        let fit = self.fit_for(query);
        let relative = self.process(query).map_or(1.0 + fit.correlation.noise, |process| {
            process.kriging.solve(self.place(query), self.neighbours).1.variance
        });
        Some((fit.variance * relative).sqrt())
    }

    fn without(&self, links: &[usize]) -> Option<Box<dyn Predict + '_>> {
        let others = |process: &Process| {
            process.links.iter().copied().filter(|link| links.binary_search(link).is_err()).collect::<Vec<usize>>()
        };
        let links_left: Vec<Vec<usize>> = self.processes.iter().map(others).collect();
        let is_fitted = links_left.iter().any(|links| !links.is_empty());
        is_fitted
            .then(|| Box::new(Self::new(self.data, self.fits.clone(), links_left, self.neighbours)) as Box<dyn Predict>)
    }

    fn note(&self) -> Option<String> {
        let ProcessFit { correlation: Correlation { kind, scales, noise }, variance, .. } = self.fits.first()?;
        let path_losses: Vec<PathLoss> = self.fits.iter().filter_map(|fit| Some(fit.trend.path_loss?.0)).collect();
        let names: Vec<String> = self.data.scene.receivers.iter().map(|r| strip_control(&r.name)).collect();
        let has_distances = self.data.scene.has_distances();
        let describe = |(path_loss, name): (&PathLoss, &String)| {
            let slope = if has_distances { format!(", {}", format_digits(path_loss.slope)) } else { String::new() };
            let name = if names.len() > 1 { format!("{name}: ") } else { String::new() };
            format!("{name}{}{slope}", format_digits(path_loss.level))
        };
        let mut list: Vec<String> = path_losses.iter().zip(&names).take(LISTED).map(describe).collect();
        list.extend((path_losses.len() > LISTED).then(|| format!("and {} more", path_losses.len() - LISTED)));
        let trend = if has_distances { "path loss in dBm at 1 m and dB per decade" } else { "mean in dBm" };
        let text = format!(
            "Kriging found one correlation for all receivers, {} with a length scale of {} m, a variance of {} dB² and noise of \
             {} of the variance, {trend} ({})",
            kind.words(),
            format_digits(scales[0]),
            format_digits(*variance),
            format_digits(*noise),
            list.join("; "),
        );
        let unlinked: Vec<&str> =
            names.iter().zip(&self.processes).filter(|(_, p)| p.links.is_empty()).map(|(n, _)| n.as_str()).collect();
        let names = join_names(unlinked.iter(), LISTED);
        let unlinked =
            (!unlinked.is_empty()).then(|| format!("; {names} has no training link and shares the mean path loss"));
        Some(text + &unlinked.unwrap_or_default())
    }
}

/// Formats a number with four significant digits or more, enough to reproduce a score; with at most nine decimals.
pub(super) fn format_digits(value: f64) -> String {
    let decimals = if value == 0.0 { 0.0 } else { (3.0 - value.abs().log10().floor()).clamp(0.0, 9.0) };
    format!("{value:.0$}", decimals as usize)
}

#[cfg(test)]
mod tests;
