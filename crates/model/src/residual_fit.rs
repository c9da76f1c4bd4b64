//! Fit of residual processes to known links, and their update with new links.

use crate::ensemble::Ensemble;
use crate::residuals::{
    CoarseGrid, Kriged, ProcessFit, ResidualProcess, ResidualTrend, ResidualValues, Residuals, place,
};
use crate::tensors::quantise;
use pwrfgs_core::kriging::{
    Correlation, CorrelationKind, HeldOutCases, Mean, PathLoss, SearchSpace, log_distance, most_likely,
};
use pwrfgs_core::neighbours::Nearest;
use pwrfgs_core::{
    Dataset, Error, FittingSet, MeasurementSetup, Progress, Query, Real, Receiver, Result, check_stopped, evenly,
};
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

/// Number of links that are predicted in the fit: of all receivers, and at least of each. Too few choose a wrong correlation
/// (docs/lab/residuals.md).
const CASES: usize = 600;
const LEAST_CASES: usize = 40;
/// Number of neighbours of such a link; half of it for received powers.
const FROM: usize = 48;
/// Shares of the prediction of the model that are compared.
const SHARES: [f64; 5] = [1.0, 0.75, 0.5, 0.25, 0.0];
/// Compared factors on the noise of the observations: what a good model leaves is mostly noise.
const NOISES: [f64; 5] = [1.0, 4.0, 16.0, 64.0, 256.0];
/// Log-likelihood by which a smaller share must be better: differences below it are noise of the search.
const CLEARLY: f64 = 0.5;
/// Smoothness 3/2 and 1/2.
const KINDS: [CorrelationKind; 2] = [CorrelationKind::Matern32, CorrelationKind::Exponential];
/// Share of the variance of spectra that a coarse grid may lose, and the number of spectra that measure it.
const LOST: f64 = 1e-3;
const EXAMPLES: usize = 64;
/// Smallest number of known links of a receiver for a path-loss model.
const LEAST_LINKS: usize = 10;
/// Number of links per prediction call.
const CHUNK: usize = 64;
/// Log-likelihood, share, variance in units of the scale, and correlation.
type Fit = (f64, f64, f64, Correlation);

/// Known links, and which of them a member did not train on.
#[derive(Clone, Copy, Debug)]
pub struct KnownLinks<'a> {
    /// The data.
    pub data: &'a Dataset,
    /// All known links, ascending.
    pub links: &'a [usize],
    /// Members that did not train on the link, in the same order.
    pub left_out_by: &'a [LeftOutBy],
}

/// Members of an ensemble that did not train on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LeftOutBy {
    /// The link is a training link of all.
    NoMember,
    /// One member, by its index.
    Member(usize),
    /// All members.
    All,
}

impl Residuals {
    /// Fits residual processes to the links that are `known`. `progress` counts predictions.
    ///
    /// # Errors
    /// [`Error::Config`] if data have no positions, or all members trained on all links; a spectrum that cannot be read;
    /// [`Error::Stopped`] once `stop` is set.
    pub fn fit(
        settings: &Kriged,
        ensemble: &Ensemble,
        known: KnownLinks<'_>,
        stop: &AtomicBool,
        progress: Progress<'_>,
    ) -> Result<Self> {
        let data = known.data;
        settings.check_data(data, known.left_out_by.iter().any(|by| *by != LeftOutBy::NoMember))?;
        let mut grid = CoarseGrid::new(ensemble.plane(), data.task().stride(settings.stride));
        let examples: Vec<Vec<Real>> = evenly(known.links, EXAMPLES).iter().map(|&i| data.image(i).pixels).collect();
        while grid.stride > 1 && grid.lost_share(&examples) > LOST {
            grid = CoarseGrid::new(ensemble.plane(), grid.stride / 2);
        }
        let samples = Samples::new(ensemble, known, &grid, stop, progress)?;
        data.observations.check()?;
        let mut by_receiver = vec![Vec::new(); data.scene.receivers.len()];
        (0..known.links.len()).for_each(|k| by_receiver[samples.receiver_of(k)].push(k));
        let fit = samples.most_likely_fit(&by_receiver, stop)?;
        let process =
            |links: &Vec<usize>| Some(samples.build_process(links, fit?)).filter(|process| !process.is_empty());
        let processes = by_receiver.iter().map(process).collect();
        Ok(Self { grid, neighbours: settings.neighbours, processes })
    }

    /// Returns the processes of `ensemble` with only `links` of `data` as known links. Share, correlation and variance
    /// stay. A receiver without any of these links has no process.
    ///
    /// # Errors
    /// As [`Self::updated`].
    fn restricted_to(&self, ensemble: &Ensemble, data: &Dataset, links: &[usize]) -> Result<Self> {
        let empty =
            |process: &ResidualProcess| ResidualProcess::new(process.fit, Vec::new(), process.values.empty_like());
        let processes = self.processes.iter().map(|process| process.as_ref().map(empty)).collect();
        let (mut residuals, _) = Self { processes, ..self.clone() }.with_links(ensemble, data, links)?;
        for process in &mut residuals.processes {
            process.take_if(|process| process.is_empty());
        }
        Ok(residuals)
    }

    /// Returns the processes of `ensemble` with the links of new `data` added, and the number of added links. Share,
    /// correlation and variance stay. A prediction uses the nearest known links only, so nothing else changes: links at
    /// receivers without a process are skipped.
    ///
    /// # Errors
    /// A spectrum that cannot be read, or [`Error::Config`] for a prediction that is not finite.
    pub fn updated(&self, ensemble: &Ensemble, data: &Dataset) -> Result<(Self, usize)> {
        self.with_links(ensemble, data, &(0..data.len()).collect::<Vec<_>>())
    }

    /// Returns the processes with some `links` of new `data` added, and the number of added links, as
    /// [`Self::updated`].
    fn with_links(&self, ensemble: &Ensemble, data: &Dataset, links: &[usize]) -> Result<(Self, usize)> {
        let base = ensemble.clone().with_residuals(None);
        let (ready, origin) = (base.prepare(), base.members()[0].stages.origin);
        let mut places: Vec<Vec<[Real; 3]>> = self.processes.iter().map(|_| Vec::new()).collect();
        let mut values: Vec<Vec<Real>> = vec![Vec::new(); places.len()];
        let has_process = |i: &usize| self.process(data.links[*i].receiver).is_some();
        let links: Vec<usize> = links.iter().copied().filter(has_process).collect();
        let queries: Vec<Query<'_>> = links.iter().map(|&i| data.query(i)).collect();
        let predicted = queries.chunks(CHUNK).flat_map(|chunk| ready.predict_many(chunk));
        for ((&i, query), predicted) in links.iter().zip(&queries).zip(predicted) {
            let Some(process) = self.process(query.receiver) else { continue };
            let predicted = data.task().shown(predicted);
            let (observed, at) = (data.image(i), origin.local(query.position()));
            let residual = |(y, f): (&Real, &Real)| y - process.fit.trend.expected(*f, at);
            let residuals: Vec<Real> = observed.pixels.iter().zip(&predicted.pixels).map(residual).collect();
            if residuals.iter().any(|v| !v.is_finite()) {
                let problem = format!("the prediction at {:?} is not finite; leave this link out", query.position());
                return Err(Error::Config(problem));
            }
            places[query.receiver].push(at);
            values[query.receiver].extend(self.grid.sampled(&residuals));
        }
        data.observations.check()?;
        let added = places.iter().map(Vec::len).sum();
        let extended = |(receiver, process): (usize, &Option<ResidualProcess>)| {
            let ResidualProcess { fit, places: positions, values: residuals, .. } = process.as_ref()?;
            let mut residuals = residuals.clone();
            residuals.extend(&values[receiver], self.grid.len());
            let places = [&positions[..], &places[receiver]].concat();
            Some(ResidualProcess::new(*fit, places, residuals))
        };
        let processes = self.processes.iter().enumerate().map(extended).collect();
        Ok((Self { processes, ..self.clone() }, added))
    }
}

impl Ensemble {
    /// Returns the ensemble of some members, with the same residual processes except that only `links` are known, and
    /// without calibration: if the members did not train on the others, it predicts those as new links.
    ///
    /// # Errors
    /// As [`Residuals::updated`].
    pub fn held_out(&self, members: &[usize], data: &Dataset, links: &[usize]) -> Result<Self> {
        let member = |&k: &usize| (self.names()[k].clone(), self.members()[k].clone());
        let base = Self::named(members.iter().map(member).collect()).map_err(Error::Config)?;
        let residuals = self.residuals().map(|residuals| residuals.restricted_to(&base, data, links)).transpose()?;
        Ok(base.with_residuals(residuals))
    }

    /// Returns the models with residual processes that know only the training links of `data`, since validation links that they
    /// know cannot choose settings. `None` if they know none.
    ///
    /// # Errors
    /// As [`Residuals::updated`].
    pub fn without_validation(&self, data: &Dataset, fitting: FittingSet<'_>) -> Result<Option<Self>> {
        if self.residuals().is_none() || fitting.validation.is_empty() {
            return Ok(None);
        }
        self.held_out(&(0..self.members().len()).collect::<Vec<_>>(), data, fitting.train).map(Some)
    }
}

/// Observations and predictions of all known links on the coarse grid.
struct Samples<'a> {
    known: KnownLinks<'a>,
    receivers: &'a [Receiver],
    places: Vec<[Real; 3]>,
    /// Number of values per link.
    link_values: usize,
    /// Whether residuals are stored as exact numbers.
    is_exact: bool,
    /// Observations `[links, link_values]`.
    observed: Vec<Real>,
    /// Predictions `[links, link_values]` of each member.
    predicted: Vec<Vec<Real>>,
    /// Their mean.
    mean: Vec<Real>,
}

impl<'a> Samples<'a> {
    /// Predicts all known links with each member. `progress` counts predictions.
    ///
    /// # Errors
    /// [`Error::Config`] for a prediction that is not finite; [`Error::Stopped`] once `stop` is set.
    fn new(
        ensemble: &'a Ensemble,
        known: KnownLinks<'a>,
        grid: &CoarseGrid,
        stop: &AtomicBool,
        progress: Progress<'_>,
    ) -> Result<Self> {
        let KnownLinks { data, links, .. } = known;
        let observed: Vec<Real> =
            links.iter().flat_map(|&i| grid.sampled(&data.image(i).pixels).collect::<Vec<_>>()).collect();
        let (mut predicted, total) = (Vec::new(), links.len() * ensemble.members().len());
        for (member, model) in ensemble.members().iter().enumerate() {
            let ready = model.prepare();
            let mut predictions = Vec::with_capacity(links.len() * grid.len());
            for (chunk, links) in links.chunks(CHUNK).enumerate() {
                check_stopped(stop)?;
                let queries: Vec<Query<'_>> = links.iter().map(|&i| data.query(i)).collect();
                let shown = ready.predict_many(&queries).into_iter().map(|image| data.task().shown(image));
                shown.for_each(|image| predictions.extend(grid.sampled(&image.pixels)));
                progress(member * known.links.len() + chunk * CHUNK + links.len(), total);
            }
            predicted.push(predictions);
        }
        if let Some(member) =
            predicted.iter().position(|predictions: &Vec<Real>| predictions.iter().any(|v| !v.is_finite()))
        {
            let problem = "predicts numbers that are not finite; train it again with lower learning rates";
            return Err(Error::Config(format!("residuals: model {} {problem}", member + 1)));
        }
        let MeasurementSetup { origin, receivers, .. } = &ensemble.members()[0].stages.setup;
        let places = links.iter().map(|&i| origin.local(data.sample(i).position())).collect();
        let mut mean = vec![0.0; observed.len()];
        predicted.iter().for_each(|predictions| mean.iter_mut().zip(predictions).for_each(|(sum, v)| *sum += v));
        mean.iter_mut().for_each(|v| *v /= predicted.len() as Real);
        let (link_values, is_exact) = (grid.len(), grid.stride == 1);
        Ok(Self { known, receivers, places, link_values, is_exact, observed, predicted, mean })
    }

    /// Returns the predictions of all links by the members that `left_out` a link: the mean of all, or one.
    fn predictions(&self, left_out: LeftOutBy) -> &[Real] {
        if let LeftOutBy::Member(member) = left_out { &self.predicted[member] } else { &self.mean }
    }

    /// Returns the residuals of known link `k` from the trend, given `predicted` values of all links.
    fn residuals(&self, k: usize, trend: &ResidualTrend, predicted: &[Real]) -> Vec<Real> {
        let values = k * self.link_values..(k + 1) * self.link_values;
        let pairs = self.observed[values.clone()].iter().zip(&predicted[values]);
        pairs.map(|(y, f)| y - trend.expected(*f, self.places[k])).collect()
    }

    /// Fits a path-loss model to `links_of_receiver` without those `left_out`; returns it with the position of the
    /// receiver. `None` for observations without path loss, and for fewer than [`LEAST_LINKS`] links.
    fn fit_path_loss(&self, links_of_receiver: &[usize], left_out: Option<LeftOutBy>) -> Option<(PathLoss, [f64; 3])> {
        let KnownLinks { data, links, left_out_by } = self.known;
        let receiver = self.receivers[data.links[links[*links_of_receiver.first()?]].receiver].pose.position;
        let links_of_receiver: Vec<usize> =
            links_of_receiver.iter().copied().filter(|&k| Some(left_out_by[k]) != left_out).collect();
        let point = |&k: &usize| (log_distance(self.places[k].map(|v| v as f64), receiver), self.observed[k] as f64);
        let is_fitted = data.task().has_path_loss && links_of_receiver.len() >= LEAST_LINKS;
        is_fitted.then(|| (PathLoss::fit(&links_of_receiver.iter().map(point).collect::<Vec<_>>()), receiver))
    }

    /// Returns the links to predict, evenly from those that a member left out, each with the nearest links
    /// that the same members trained on. If `is_observed`, all links with their nearest others.
    fn select_cases(&self, links_of_receiver: &[usize], is_observed: bool) -> Vec<(usize, Vec<usize>)> {
        let left_out_by = |k: usize| if is_observed { LeftOutBy::NoMember } else { self.known.left_out_by[k] };
        let is_case = |k: &usize| is_observed || left_out_by(*k) != LeftOutBy::NoMember;
        let held_out: Vec<usize> = links_of_receiver.iter().copied().filter(is_case).collect();
        let mut trained: BTreeMap<LeftOutBy, Nearest> = BTreeMap::new();
        for group in held_out.iter().map(|&k| left_out_by(k)) {
            trained.entry(group).or_insert_with(|| {
                let is_trained = |k: &usize| is_observed || left_out_by(*k) != group;
                let others = links_of_receiver.iter().copied().filter(is_trained).collect();
                Nearest::new(others, 4, |k| place(self.places[k]))
            });
        }
        let count = (CASES / self.known.data.scene.receivers.len()).max(LEAST_CASES);
        let count_near = if self.link_values == 1 { FROM / 2 } else { FROM };
        let case = |k: usize| {
            let near =
                trained[&left_out_by(k)].find(&place(self.places[k]), count_near + 1).1.into_iter().map(|(_, j)| j);
            let near: Vec<usize> = near.filter(|j| *j != k).take(count_near).collect();
            (!near.is_empty()).then_some((k, near))
        };
        evenly(&held_out, count).into_iter().filter_map(case).collect()
    }

    /// Returns the scale of the observations of a receiver with these known links: their root mean square about the
    /// path-loss model, or 1 if there is one receiver.
    fn observation_scale(&self, links_of_receiver: &[usize]) -> Real {
        let trend = ResidualTrend { share: 0.0, path_loss: self.fit_path_loss(links_of_receiver, None) };
        let squares = |&k: &usize| self.residuals(k, &trend, &self.mean).iter().map(|v| v * v).sum::<Real>();
        let mean = links_of_receiver.iter().map(squares).sum::<Real>()
            / (links_of_receiver.len() * self.link_values).max(1) as Real;
        if self.receivers.len() == 1 || mean == 0.0 { 1.0 } else { mean.sqrt() }
    }

    /// Returns the cases of all receivers with their `values`, in units of the scales. `values` returns those of a
    /// link, given the number of the case and the link.
    fn held_out_cases(
        &self,
        cases: &[(usize, Vec<usize>)],
        scales: &[Real],
        values: impl Fn(usize, usize) -> Vec<Real> + Sync,
    ) -> HeldOutCases {
        let scaled = |c: usize, k: usize| values(c, k).into_iter().map(|v| v / scales[self.receiver_of(k)]).collect();
        let mean = if self.known.data.task().has_path_loss { Mean::Zero } else { Mean::Unknown };
        HeldOutCases::new(cases, mean, |k| place(self.places[k]), scaled)
    }

    /// Returns the receiver of known link `k`.
    fn receiver_of(&self, k: usize) -> usize {
        self.known.data.links[self.known.links[k]].receiver
    }

    /// Returns the most likely share, variance and correlation for the known links of each receiver, for observations
    /// in units of their scales; `None` if no link was left out. All receivers share them, since one receiver may have
    /// few links.
    ///
    /// Kind and length scales of the correlation are those of the observations: of residuals of left-out links, there are
    /// too few.
    fn most_likely_fit(&self, by_receiver: &[Vec<usize>], stop: &AtomicBool) -> Result<Option<Fit>> {
        let cases_of = |is_observed| {
            by_receiver.iter().flat_map(|links| self.select_cases(links, is_observed)).collect::<Vec<_>>()
        };
        let cases = cases_of(false);
        if cases.is_empty() {
            return Ok(None);
        }
        let scales: Vec<Real> = by_receiver.iter().map(|links| self.observation_scale(links)).collect();
        let law = |receiver: usize, left_out| self.fit_path_loss(&by_receiver[receiver], left_out);
        let laws: Vec<_> = (0..by_receiver.len()).map(|receiver| law(receiver, None)).collect();
        let observed =
            |_, k| self.residuals(k, &ResidualTrend { share: 0.0, path_loss: laws[self.receiver_of(k)] }, &self.mean);
        let space = SearchSpace { kinds: &KINDS, isotropic: self.link_values == 1, time: false };
        let observed = self.held_out_cases(&cases_of(true), &scales, observed);
        let correlation = most_likely(&observed, space, &|| check_stopped(stop))?.1;
        // The path-loss model that decides about a left-out link is not fitted to it.
        let group = |c: usize| (self.receiver_of(cases[c].0), self.known.left_out_by[cases[c].0]);
        let laws: BTreeMap<_, _> = (0..cases.len()).map(|c| (group(c), law(group(c).0, Some(group(c).1)))).collect();
        let fit = |share: f64| {
            let values = |c: usize, k: usize| {
                self.residuals(k, &ResidualTrend { share, path_loss: laws[&group(c)] }, self.predictions(group(c).1))
            };
            let held_out = self.held_out_cases(&cases, &scales, values);
            let with_noise = |factor: f64| {
                let noisy = Correlation { noise: factor * correlation.noise, ..correlation };
                (held_out.log_likelihood(&noisy), share, held_out.variance(&noisy) / self.link_values as f64, noisy)
            };
            NOISES.map(with_noise).into_iter().reduce(|best, next| if next.0 > best.0 { next } else { best })
        };
        // Links of one transmitter are not independent: all of its receivers count as one case.
        let least_gain = by_receiver.len() as f64 * CLEARLY;
        let choose = |best: Fit, next: Fit| if next.0 > best.0 + least_gain { next } else { best };
        Ok(SHARES.into_iter().filter_map(fit).reduce(choose))
    }

    /// Builds the process of a receiver from its known links and the common fit.
    fn build_process(&self, links_of_receiver: &[usize], fit: Fit) -> ResidualProcess {
        let (_, share, variance, correlation) = fit;
        let trend = ResidualTrend { share, path_loss: self.fit_path_loss(links_of_receiver, None) };
        let variance = variance * f64::from(self.observation_scale(links_of_receiver) as f32).powi(2);
        let residuals: Vec<Real> =
            links_of_receiver.iter().flat_map(|&k| self.residuals(k, &trend, &self.mean)).collect();
        let values = if self.is_exact {
            ResidualValues::Exact(residuals)
        } else {
            let (short, units) = quantise(&residuals, self.link_values);
            ResidualValues::Short(short, units)
        };
        let places = links_of_receiver.iter().map(|&k| self.places[k]).collect();
        ResidualProcess::new(ProcessFit { trend, variance, correlation }, places, values)
    }
}
