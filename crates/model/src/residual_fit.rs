//! Fit of residual processes to known links, and their update with new links; `share.rs` chooses the share of the model.

mod share;

use crate::ensemble::Ensemble;
use crate::residuals::{CoarseGrid, Kriged, ResidualProcess, ResidualValues, Residuals, place};
use crate::tensors::quantise;
use pwrfgs_core::kriging::{ProcessFit, ResidualTrend, fit_observations, fit_powers};
use pwrfgs_core::{Dataset, Error, FittingSet, Progress, Real, Result, check_stopped, evenly};
use std::sync::atomic::AtomicBool;

/// Share of the variance of spectra that a coarse grid may lose (also in the docs of [`Kriged::stride`]), and the
/// number of spectra that measure it.
const LOST: f64 = 1e-3;
const EXAMPLES: usize = 64;
/// Number of links per prediction call.
const CHUNK: usize = 64;

/// Known links, and which of them a member did not train on.
#[derive(Clone, Copy, Debug)]
pub struct KnownLinks<'a> {
    /// The data.
    pub data: &'a Dataset,
    /// All known links, ascending.
    pub links: &'a [usize],
    /// Part of each link, which some members left out, in the same order; `None` for a training link of all members.
    pub left_out: &'a [Option<usize>],
    /// Number of parts, at least 1: member m left out part m modulo this number.
    pub parts: usize,
    /// Block of each link, in the same order: links of a block are not independent.
    pub blocks: &'a [usize],
    /// Flag that ends the fit.
    pub stop: &'a AtomicBool,
}

impl KnownLinks<'_> {
    /// Lists the links of each receiver, as indices of the known links.
    fn by_receiver(&self) -> Vec<Vec<usize>> {
        let mut by_receiver = vec![Vec::new(); self.data.scene.receivers.len()];
        self.links.iter().enumerate().for_each(|(k, link)| by_receiver[self.data.links[*link].receiver].push(k));
        by_receiver
    }

    /// Returns the observations `[links, pixels of the grid]` on a coarse grid.
    fn sampled(&self, grid: &CoarseGrid) -> Vec<Real> {
        let sampled = |&i: &usize| grid.sampled(&self.data.image(i).pixels).collect::<Vec<_>>();
        self.links.iter().flat_map(sampled).collect()
    }
}

impl Residuals {
    /// Fits residual processes to the `known` links. `progress` counts predictions.
    ///
    /// # Errors
    /// [`Error::Config`] as [`Kriged::check_data`], or for a prediction that is not finite; a spectrum that cannot be read;
    /// [`Error::Stopped`] once `known.stop` is set.
    pub fn fit(settings: &Kriged, ensemble: &Ensemble, known: KnownLinks<'_>, progress: Progress<'_>) -> Result<Self> {
        let data = known.data;
        settings.check_data(data, known.left_out.iter().any(Option::is_some))?;
        let mut grid = CoarseGrid::new(ensemble.plane(), data.task().stride(settings.stride));
        let examples: Vec<Vec<Real>> = evenly(known.links, EXAMPLES).iter().map(|&i| data.image(i).pixels).collect();
        let refine = |grid: &mut CoarseGrid, is_centred: bool| {
            while grid.stride > 1 && grid.lost_share(&examples, is_centred) > LOST {
                *grid = CoarseGrid::new(ensemble.plane(), grid.stride / 2);
            }
        };
        refine(&mut grid, true);
        let mut samples = Samples::new(ensemble, known, &grid, progress)?;
        data.observations.check()?;
        let kriging = samples.fit_kriging(None)?;
        let (choice, gain) = samples.choose_share(&kriging, settings.neighbours)?;
        if choice.share == 0.0 {
            // The process stores whole observations, and not differences from predictions.
            refine(&mut grid, false);
            samples.resample(&grid);
        }
        let process = |(links, fit): (&Vec<usize>, &Option<ProcessFit>)| {
            let fit = fit.as_ref().filter(|fit| !links.is_empty() && fit.variance.is_finite())?;
            Some(samples.build_process(links, choice.apply(fit)))
        };
        let processes = known.by_receiver().iter().zip(&kriging).map(process).collect();
        Ok(Self { grid, neighbours: settings.neighbours, processes, gain })
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
    /// correlation and variance stay, since a prediction uses the nearest known links only. Links at receivers without a
    /// process are skipped.
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
        let queries = data.queries(&links);
        let predicted = queries.chunks(CHUNK).flat_map(|chunk| ready.predict_many(chunk));
        for ((&i, query), predicted) in links.iter().zip(&queries).zip(predicted) {
            let Some(process) = self.process(query.receiver) else { continue };
            let predicted = data.task().shown(predicted);
            let (observed, at) = (data.image(i), origin.local(query.position()));
            let residual = |(y, f): (&Real, &Real)| (*y as f64 - process.fit.trend.expected(*f, place(at))) as Real;
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

    /// Returns the models with residual processes of the training links of `data` alone. Known validation links would be
    /// predicted too well to choose settings by them. `None` without residual processes or validation links: the ensemble
    /// itself then suits.
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

/// Returns the mean of one or more predictions of `count` numbers each.
fn mean_of<'a>(predictions: impl Iterator<Item = &'a Vec<Real>>, count: usize) -> Vec<Real> {
    let (mut mean, mut members) = (vec![0.0; count], 0);
    for prediction in predictions {
        mean.iter_mut().zip(prediction).for_each(|(sum, v)| *sum += v);
        members += 1;
    }
    mean.iter_mut().for_each(|v| *v /= members as Real);
    mean
}

/// Observations and predictions of all known links on the coarse grid.
struct Samples<'a> {
    known: KnownLinks<'a>,
    places: Vec<[Real; 3]>,
    /// Number of values per link.
    link_values: usize,
    /// Whether residuals are stored as exact numbers.
    is_exact: bool,
    /// Observations `[links, link_values]`.
    observed: Vec<Real>,
    /// Mean predictions `[links, link_values]` of the members that left out each part.
    predicted: Vec<Vec<Real>>,
    /// Mean predictions of all members.
    mean: Vec<Real>,
}

impl<'a> Samples<'a> {
    /// Predicts all known links with each member. `progress` counts predictions.
    ///
    /// # Errors
    /// [`Error::Config`] for a prediction that is not finite; [`Error::Stopped`].
    fn new(ensemble: &Ensemble, known: KnownLinks<'a>, grid: &CoarseGrid, progress: Progress<'_>) -> Result<Self> {
        let KnownLinks { data, links, .. } = known;
        let observed = known.sampled(grid);
        let (mut predicted, total) = (Vec::new(), links.len() * ensemble.members().len());
        for (member, model) in ensemble.members().iter().enumerate() {
            let ready = model.prepare();
            let mut predictions = Vec::with_capacity(links.len() * grid.len());
            for (chunk, links) in links.chunks(CHUNK).enumerate() {
                check_stopped(known.stop)?;
                let queries = data.queries(links);
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
        let origin = ensemble.members()[0].stages.setup.origin;
        let places = links.iter().map(|&i| origin.local(data.sample(i).position())).collect();
        let mean = mean_of(predicted.iter(), observed.len());
        let part = |part: usize| mean_of(predicted.iter().skip(part).step_by(known.parts), observed.len());
        let (link_values, is_exact) = (grid.len(), grid.stride == 1);
        let predicted = (0..known.parts).map(part).collect();
        Ok(Self { known, places, link_values, is_exact, observed, predicted, mean })
    }

    /// Samples the observations on another grid. The mean predictions become 0, since a share of 0 ignores them.
    fn resample(&mut self, grid: &CoarseGrid) {
        self.observed = self.known.sampled(grid);
        (self.link_values, self.is_exact) = (grid.len(), grid.stride == 1);
        self.mean = vec![0.0; self.observed.len()];
    }

    /// Returns the residuals of known link `k` from the trend, given `predicted` values of all links.
    fn residuals(&self, k: usize, trend: &ResidualTrend, predicted: &[Real]) -> Vec<Real> {
        let (values, at) = (k * self.link_values..(k + 1) * self.link_values, place(self.places[k]));
        let pairs = self.observed[values.clone()].iter().zip(&predicted[values]);
        pairs.map(|(y, f)| (*y as f64 - trend.expected(*f, at)) as Real).collect()
    }

    /// Fits Kriging to the known links of each receiver `without` a part, or to all; `None` for a receiver without links, unless
    /// observations are powers.
    fn fit_kriging(&self, without: Option<usize>) -> Result<Vec<Option<ProcessFit>>> {
        let KnownLinks { data, links, left_out, stop, .. } = self.known;
        let is_known = |(_, part): &(&usize, &Option<usize>)| part.is_none() || **part != without;
        let links: Vec<usize> = links.iter().zip(left_out).filter(is_known).map(|(link, _)| *link).collect();
        let check = || check_stopped(stop);
        if data.task().has_path_loss {
            return Ok(fit_powers(data, &links, &check)?.into_iter().map(Some).collect());
        }
        let has_time_scale = false; // positions alone
        let fit_links = |links: &[usize]| fit_observations(data, links, has_time_scale, &check);
        let fit = |links: Vec<usize>| (!links.is_empty()).then(|| fit_links(&links)).transpose();
        data.group_by_receiver(links).into_iter().map(fit).collect()
    }

    /// Builds the process of a receiver from its known links and the fit.
    fn build_process(&self, links_of_receiver: &[usize], fit: ProcessFit) -> ResidualProcess {
        let residuals: Vec<Real> =
            links_of_receiver.iter().flat_map(|&k| self.residuals(k, &fit.trend, &self.mean)).collect();
        let values = if self.is_exact {
            ResidualValues::Exact(residuals)
        } else {
            let (short, units) = quantise(&residuals, self.link_values);
            ResidualValues::Rounded(short, units)
        };
        let places = links_of_receiver.iter().map(|&k| self.places[k]).collect();
        ResidualProcess::new(fit, places, values)
    }
}
