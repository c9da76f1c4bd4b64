//! Kriging of received powers: path loss and process of all receivers, fitted together.

use super::fitting_samples;
use super::log_distance::{fixed_end_position, log_distance};
use pwrfgs_core::kriging::{LocalKriging, Mean, PathLoss, PooledFit, PowerLink, Solution, fit_pooled, in_space};
use pwrfgs_core::messages::strip_control;
use pwrfgs_core::{Dataset, FittingSet, Image, Predict, Query, Real, Result};

/// Pooled Kriging of the powers of all receivers.
pub(super) struct PooledKriging<'a> {
    data: &'a Dataset,
    fit: PooledFit,
    processes: Vec<Process>,
    neighbours: usize,
}

/// Known links of one receiver.
struct Process {
    links: Vec<usize>,
    /// Differences of their powers from the path-loss model, dB.
    residuals: Vec<f64>,
    kriging: LocalKriging,
}

impl<'a> PooledKriging<'a> {
    /// Fits path loss and process to the known powers.
    pub(super) fn fit(data: &'a Dataset, fitting: FittingSet<'_>, neighbours: usize) -> Result<Self> {
        let known = fitting_samples(fitting)?;
        let has_distances = data.scene.has_distances();
        let link = |&i: &usize| PowerLink {
            receiver: data.links[i].receiver,
            place: in_space(data.sample(i).position()),
            log_distance: has_distances.then(|| log_distance(data, data.query(i))),
            value: data.image(i).pixels[0] as f64,
        };
        let links: Vec<PowerLink> = known.iter().map(link).collect();
        data.observations.check()?;
        let fit = fit_pooled(&links, data.scene.receivers.len(), &|| fitting.check_stopped())?;
        Ok(Self::new(data, fit, data.group_by_receiver(known), neighbours))
    }

    /// Creates the predictor of a fit from the known links of each receiver.
    fn new(data: &'a Dataset, fit: PooledFit, known: Vec<Vec<usize>>, neighbours: usize) -> Self {
        let process = |(links, law): (Vec<usize>, &PathLoss)| Process {
            kriging: LocalKriging::new(
                fit.correlation,
                Mean::Zero,
                links.iter().map(|&i| in_space(data.sample(i).position())),
            ),
            residuals: links
                .iter()
                .map(|&i| data.image(i).pixels[0] as f64 - power(data, law, data.query(i)))
                .collect(),
            links,
        };
        let processes = known.into_iter().zip(&fit.laws).map(process).collect();
        Self { data, fit, processes, neighbours }
    }

    /// Returns the path-loss model of the receiver of a query, or of the first one for an unknown receiver.
    fn law(&self, query: Query<'_>) -> PathLoss {
        *self.fit.laws.get(query.receiver).or(self.fit.laws.first()).expect("data have a receiver")
    }

    /// Returns the known links of the receiver of a query; `None` without any.
    fn process(&self, query: Query<'_>) -> Option<&Process> {
        self.processes.get(query.receiver).filter(|process| !process.links.is_empty())
    }
}

/// Returns the power of a path-loss model, dBm.
fn power(data: &Dataset, law: &PathLoss, query: Query<'_>) -> f64 {
    law.power(log_distance(data, query))
}

impl Predict for PooledKriging<'_> {
    fn predict(&self, query: Query<'_>) -> Image {
        let residual = |process: &Process| {
            let (near, Solution { weights, .. }) = process.kriging.solve(in_space(query.position()), self.neighbours);
            near.into_iter().zip(weights).map(|(k, weight)| weight * process.residuals[k]).sum::<f64>()
        };
        let dbm = power(self.data, &self.law(query), query) + self.process(query).map_or(0.0, residual);
        Image { width: 1, height: 1, pixels: vec![dbm as Real] }
    }

    fn predict_vjp(&self, query: Query<'_>, cotangent: &dyn Fn(&Image) -> Vec<Real>) -> Option<(Image, [f64; 3])> {
        let image = self.predict(query);
        let d = f64::from(cotangent(&image)[0]);
        let slope = self.law(query).power_gradient(query.position(), fixed_end_position(self.data, query));
        let residual = |process: &Process| {
            process.kriging.solve_vjp(in_space(query.position()), self.neighbours, |k| process.residuals[k])
        };
        let gradient = self.process(query).map_or([0.0; 3], residual);
        Some((image, [0, 1, 2].map(|k| d * (slope[k] + gradient[k]))))
    }

    fn deviation(&self, query: Query<'_>) -> Option<f64> {
        let relative = self.process(query).map_or(1.0 + self.fit.correlation.noise, |process| {
            process.kriging.solve(in_space(query.position()), self.neighbours).1.variance
        });
        Some((self.fit.variance * relative).sqrt())
    }

    fn without(&self, links: &[usize]) -> Option<Box<dyn Predict + '_>> {
        let others = |process: &Process| {
            process.links.iter().copied().filter(|link| links.binary_search(link).is_err()).collect::<Vec<usize>>()
        };
        let known: Vec<Vec<usize>> = self.processes.iter().map(others).collect();
        let is_known = known.iter().any(|links| !links.is_empty());
        is_known.then(|| Box::new(Self::new(self.data, self.fit.clone(), known, self.neighbours)) as Box<dyn Predict>)
    }

    fn note(&self) -> Option<String> {
        let PooledFit { laws, correlation, variance } = &self.fit;
        let names: Vec<String> = self.data.scene.receivers.iter().map(|r| strip_control(&r.name)).collect();
        let has_distances = self.data.scene.has_distances();
        let law = |(law, name): (&PathLoss, &String)| {
            let slope = if has_distances { format!(", {}", format_digits(law.slope)) } else { String::new() };
            let name = if names.len() > 1 { format!("{name}: ") } else { String::new() };
            format!("{name}{}{slope}", format_digits(law.level))
        };
        let list: Vec<String> = laws.iter().zip(&names).map(law).collect();
        let trend = if has_distances { "path loss in dBm at 1 m and dB per decade" } else { "mean in dBm" };
        let found = format!(
            "Kriging found one correlation for all receivers, {} with a length scale of {} m, a variance of {} dB² and noise of \
             {} of the variance, {trend} ({})",
            correlation.kind.words(),
            format_digits(correlation.scales[0]),
            format_digits(*variance),
            format_digits(correlation.noise),
            list.join("; "),
        );
        let deaf: Vec<&str> =
            names.iter().zip(&self.processes).filter(|(_, p)| p.links.is_empty()).map(|(n, _)| n.as_str()).collect();
        let deaf = (!deaf.is_empty())
            .then(|| format!("; {} has no training link and shares the mean path loss", deaf.join(", ")));
        Some(found + &deaf.unwrap_or_default())
    }
}

/// Formats a number with four significant digits, enough to reproduce a score.
pub(super) fn format_digits(value: f64) -> String {
    let decimals = if value == 0.0 { 0.0 } else { (3.0 - value.abs().log10().floor()).clamp(0.0, 9.0) };
    format!("{value:.0$}", decimals as usize)
}

#[cfg(test)]
mod tests;
