//! `Locator`: positions from observations.

use crate::choice::{Choice, ComparedSamples, NearestList, ValidationSample, least_misfit};
use crate::descent::descend;
use crate::fingerprints::FingerprintBuilder;
use crate::region::{Density, KERNELS};
use crate::{FingerprintFeatures, Fingerprints, MOST_SAMPLES, Region};
use pwrfgs_core::neighbours::{distance, nearest_others};
use pwrfgs_core::statistics::{evenly, mean, median};
use pwrfgs_core::{Dataset, Error, FittingSet, Image, Predict, Progress, Query, Real, Result};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Shares of the model in the fingerprints among which validation samples choose, in `locate` and in `view`.
pub const SHARES: [f32; 3] = [0.5, 1.0, 0.0];
/// Kernel widths of the mode to choose from, in units of that of the density.
const WIDER: [f64; 5] = [1.0, 2.0, 4.0, 8.0, 16.0];
/// Sharpnesses of the mode to choose from, in units of that of the density.
const SHARPNESSES: [f64; 5] = [1.0, 0.25, 0.5, 2.0, 4.0];
/// Maximum number of validation samples on which settings of the mode are compared, and descent with no descent.
const COMPARED: usize = 100;
/// Work of a validation sample for a share, in units of that of a prediction.
const EFFORT: usize = 50;
/// Level of the parts among which the most probable one is chosen, if there are too few validation samples for regions.
const LEVEL: f32 = 0.1;
/// Distance of validation samples from training samples up to which they lie between them, in units of the distance between
/// neighbouring training positions.
const BETWEEN: f64 = 1.5;

/// Validation sample with its density and region.
struct ComparedSample<'a> {
    sample: &'a ValidationSample,
    density: Density,
    region: Region,
}

/// Finds the position of a transmitter from its observations.
pub struct Locator<'a> {
    features: FingerprintFeatures,
    model: &'a dyn Predict,
    /// Model without the validation samples, if it supports this. A model that stores samples has no error at them.
    without: Option<Box<dyn Predict + 'a>>,
    fingerprints: Fingerprints,
    /// Power of a receiver that did not receive a transmitter: the weakest of the training links, dBm; −∞ unless powers are
    /// observed.
    floor: f32,
    /// Half the distance between neighbouring training positions, metres.
    half_spacing: f64,
    /// Area of [`Self::within`].
    area: Option<Box<dyn Fn([f64; 2]) -> bool + Send + Sync + 'a>>,
    /// Number of validation positions that chose the settings, at most [`MOST_SAMPLES`].
    pub validation: usize,
    /// Median distance of a validation position to the nearest training position, metres; NaN without validation samples.
    pub validation_distance: f64,
    /// Settings.
    pub choice: Choice,
    /// Density at the edge of a region, relative to the highest; `None` with fewer than 9 validation samples.
    level: Option<f32>,
}

/// Position of a transmitter.
#[derive(Clone, Debug)]
pub struct Located {
    /// Position, metres.
    pub position: [f64; 3],
    /// Misfit of the best fingerprint, relative to that of a typical sample. Far above 1, the observation resembles no
    /// known position.
    pub misfit: f64,
    /// Region that holds the transmitter with a probability of 90 %; `None` with fewer than 9 validation samples.
    pub region: Option<Region>,
}

impl Located {
    /// Returns whether the region holds a position; `None` without region.
    pub fn holds(&self, [x, y, _]: [f64; 3]) -> Option<bool> {
        self.region.as_ref().map(|region| region.holds([x, y]))
    }
}

impl<'a> Locator<'a> {
    /// Fits to the training links `links.train` of `data`. `shares` are the shares of the model among which the
    /// validation links choose; without validation links the first is taken. A model that can leave samples out
    /// ([`Predict::without`]), such as Kriging, is used without the validation links. `progress` counts predicted training
    /// links, and validation samples per share as several links each.
    ///
    /// # Errors
    /// Data without positions or with a moving receiver, no `shares`, or an observation that cannot be read.
    pub fn fit(
        data: &Dataset,
        links: FittingSet<'_>,
        model: &'a dyn Predict,
        shares: &[f32],
        progress: Progress<'_>,
    ) -> Result<Self> {
        check_locatable(data)?;
        let validation = evenly(&data.locations_of(links.validation), MOST_SAMPLES);
        let without = if validation.is_empty() { None } else { model.without(links.validation) };
        let used = without.as_deref().unwrap_or(model);
        let features = FingerprintFeatures::new(data, links.train);
        let weakest = |powers: &[Real]| links.train.iter().map(|i| powers[*i] as f32).fold(f32::INFINITY, f32::min);
        let floor = data.observations.powers().map_or(f32::NEG_INFINITY, weakest);
        let builder = FingerprintBuilder { data, features: &features, floor };
        let groups = builder.group_by_position(&data.locations_of(links.train));
        let measured = builder.measured_at(&groups);
        let is_used = |share: &f32| *share > 0.0;
        let total = links.train.len() + EFFORT * shares.len() * validation.len();
        let count = AtomicUsize::new(0);
        let work = |more: usize| progress(count.fetch_add(more, Ordering::Relaxed) + more, total);
        let predicted = shares.iter().any(is_used).then(|| builder.predicted(&groups, used, work));
        let samples = validation_samples(&builder.measured(&validation));
        let half_spacing = half_spacing(&measured.positions);
        // The share, once chosen, replaces `choice`, `fingerprints` and `level`.
        let mut locator = Self {
            features,
            model,
            without,
            choice: ComparedSamples { positions: &measured.positions, samples: &[], nearest: &[] }
                .most_likely_choice(0.0, half_spacing),
            fingerprints: measured.clone(),
            floor,
            half_spacing,
            area: None,
            validation: samples.len(),
            validation_distance: median_distance(&samples, &measured.positions),
            level: None,
        };
        let error = locator.choose_share(shares, &measured, predicted.as_ref(), &samples, &|| work(EFFORT))?;
        data.observations.check()?; // failed reads of spectra show only here
        locator.choose_descent(&samples, error);
        Ok(locator)
    }

    /// Returns, for up to [`COMPARED`] training positions, the fingerprints of least misfit at other positions. They set the
    /// scale of misfits if there are no validation samples.
    fn nearest_without_themselves(&self) -> Vec<NearestList> {
        let fingerprints = &self.fingerprints;
        let chosen = evenly(&(0..fingerprints.len()).collect::<Vec<_>>(), COMPARED);
        let nearest = |k: &usize| fingerprints.nearest(fingerprints.row(*k), KERNELS, Some(fingerprints.positions[*k]));
        chosen.par_iter().map(nearest).collect()
    }

    /// Chooses the share of the model by the mean error of validation samples, and sets its fingerprints, level and
    /// settings, without descent. Returns this error, metres, infinite without samples; an [`Error`] without `shares`.
    /// `predicted` is `None` if no share is above 0. `done` is called for every sample of a share.
    fn choose_share(
        &mut self,
        shares: &[f32],
        measured: &Fingerprints,
        predicted: Option<&Fingerprints>,
        samples: &[ValidationSample],
        done: &(dyn Fn() + Sync),
    ) -> Result<f64> {
        // Without samples nothing is chosen: the first share is taken.
        let shares = if samples.is_empty() { &shares[..shares.len().min(1)] } else { shares };
        let mut best: Option<(f64, Choice, Option<f32>, Fingerprints)> = None;
        for share in shares {
            self.fingerprints = predicted.map_or_else(|| measured.clone(), |other| measured.blended(other, *share));
            let nearest = |sample: &ValidationSample| {
                done();
                self.fingerprints.nearest(&sample.observation, KERNELS, None)
            };
            let mut nearest: Vec<NearestList> = samples.par_iter().map(nearest).collect();
            if samples.is_empty() {
                nearest = self.nearest_without_themselves();
            }
            let compared = ComparedSamples { positions: &self.fingerprints.positions, samples, nearest: &nearest };
            self.choice = compared.most_likely_choice(*share, self.half_spacing);
            self.level = compared.region_level(self.choice);
            let error = self.choose_mode(samples);
            if best.as_ref().is_none_or(|(least, ..)| error < *least) {
                best = Some((error, self.choice, self.level, self.fingerprints.clone()));
            }
        }
        let error;
        (error, self.choice, self.level, self.fingerprints) =
            best.ok_or_else(|| Error::Config("localisation needs a share of the model".into()))?;
        Ok(error)
    }

    /// Restricts fingerprints and estimates to positions that satisfy `is_possible`, a convex area of the floor: modes are
    /// weighted means of positions inside. Regions may reach beyond.
    ///
    /// # Errors
    /// No training position satisfies `is_possible`.
    pub fn within(mut self, is_possible: impl Fn([f64; 2]) -> bool + Send + Sync + 'a) -> Result<Self> {
        self.fingerprints = self.fingerprints.filtered(|[x, y, _]| is_possible([x, y]));
        self.area = Some(Box::new(is_possible));
        if self.fingerprints.is_empty() {
            return Err(Error::Config("no training position is inside; give an area around some of them".into()));
        }
        Ok(self)
    }

    /// Returns the features in which observations are compared.
    pub fn features(&self) -> &FingerprintFeatures {
        &self.features
    }

    /// Returns the power of a receiver that did not receive a transmitter, dBm; −∞ unless powers are observed.
    pub fn floor(&self) -> f32 {
        self.floor
    }

    /// Returns the training positions that are compared, metres.
    pub fn positions(&self) -> &[[f64; 3]] {
        &self.fingerprints.positions
    }

    /// Returns whether validation samples are about as close to training positions as these are to each other; `false`
    /// without validation samples. Regions then hold 90 % of such samples; those of another day, device or area may
    /// resemble the training samples less.
    pub fn validates_between_training(&self) -> bool {
        self.validation_distance <= 2.0 * BETWEEN * self.half_spacing
    }

    /// Returns why there are no regions, with advice; `None` if there are regions.
    pub fn missing_regions(&self) -> Option<&'static str> {
        match (self.level, self.validation) {
            (Some(_), _) => None,
            (None, 0) => Some(
                "no validation samples, so nothing is chosen and there are no regions; train with validation samples, such as \
                 --set split.validation=0.1",
            ),
            (None, _) => {
                Some("fewer than 9 validation samples: no regions; train with more, such as --set split.validation=0.3")
            }
        }
    }

    /// Returns the features of each of `transmitters` of `data` at all receivers, as [`Self::locate`] needs them. A missing
    /// link has the power [`Self::floor`], or NaN for spectra and channels.
    pub fn observations(&self, data: &Dataset, transmitters: &[usize]) -> Vec<Vec<f32>> {
        let measured = FingerprintBuilder { data, features: &self.features, floor: self.floor }.measured(transmitters);
        (0..measured.len()).map(|k| measured.row(k).to_vec()).collect()
    }

    /// Locates a transmitter from its features at all receivers, `[receivers, count]`; NaN for unknown values. Powers below
    /// [`Self::floor`] count as this: the receiver did not receive the transmitter.
    pub fn locate(&self, observation: &[f32]) -> Located {
        self.locate_without(observation, None)
    }

    /// Locates a transmitter as [`Self::locate`] does, without the training samples at the position `left_out`, if any.
    pub fn locate_without(&self, observation: &[f32], left_out: Option<[f64; 3]>) -> Located {
        let raised = |v: &f32| if *v < self.floor { self.floor } else { *v };
        let observation = &observation.iter().map(raised).collect::<Vec<f32>>()[..];
        let near = self.fingerprints.nearest(observation, KERNELS, left_out);
        let (density, region) = self.density_and_region(&near);
        let position = self.estimate(observation, &density, &region);
        let region = self.level.map(|_| region);
        Located { position, misfit: least_misfit(&near) / self.choice.scale, region }
    }

    /// Returns the density over the floor and its region, given the fingerprints of least misfit; the region of [`LEVEL`]
    /// if too few validation samples set none.
    fn density_and_region(&self, near: &[(u32, f32)]) -> (Density, Region) {
        let density = self.choice.density(near, &self.fingerprints.positions);
        let region = density.grid().region(self.level.unwrap_or(LEVEL));
        (density, region)
    }

    /// Returns the mode of the most probable part of the region, improved by descent if that was chosen and ends at a
    /// possible position in this part.
    fn estimate(&self, observation: &[f32], density: &Density, region: &Region) -> [f64; 3] {
        let (part, mode) = region.most_probable_mode(density, self.choice.mode_bandwidth, self.choice.mode_sharpness);
        if !self.choice.descends {
            return mode;
        }
        let is_in_part = |[x, y, _]: &[f64; 3]| region.part_at([*x, *y]) == part;
        let is_possible = |[x, y, _]: &[f64; 3]| self.area.as_ref().is_none_or(|holds| holds([*x, *y]));
        let refined = self.refined_position(observation, density.spread(mode, is_in_part), mode);
        refined.filter(|position| is_in_part(position) && is_possible(position)).unwrap_or(mode)
    }

    /// Returns the position of least misfit of the model near `start`, by descent. Half the squared distance from `start`, in
    /// units of `spread` and the half spacing (both metres), adds to the misfit and keeps the position close. `None` if
    /// the model has no derivative by the position.
    fn refined_position(&self, observation: &[f32], spread: [f64; 3], start: [f64; 3]) -> Option<[f64; 3]> {
        let scales = spread.map(|deviation| deviation.hypot(self.half_spacing));
        let gain = self.choice.sharpness / self.choice.scale;
        let function = |at: [f64; 3]| {
            let (misfit, gradient) = self.misfit_and_gradient(observation, at)?;
            let offset = [0, 1, 2].map(|k| (at[k] - start[k]) / scales[k]);
            let value = gain * misfit + 0.5 * offset.iter().map(|a| a * a).sum::<f64>();
            Some((value, [0, 1, 2].map(|k| gain * gradient[k] + offset[k] / scales[k])))
        };
        descend(start, scales, function).map(|(position, _)| position)
    }

    /// Returns the mean squared difference of the received features of `observation` from the prediction for a transmitter at
    /// `at`, metres, and its derivative by `at`; `None` if the model has no derivative.
    fn misfit_and_gradient(&self, observation: &[f32], at: [f64; 3]) -> Option<(f64, [f64; 3])> {
        let count = self.features.count();
        let is_received = |v: &&f32| **v > self.floor; // false for NaN and a missing link
        let received = observation.iter().filter(is_received).count().max(1) as f64;
        let (mut sum, mut gradient) = (0.0, [0.0; 3]);
        for (receiver, features) in observation.chunks_exact(count).enumerate() {
            if !features.iter().any(|v| is_received(&v)) {
                continue;
            }
            let differences = |image: &Image| {
                let predicted = self.features.extract(image);
                predicted.iter().zip(features).map(|(f, o)| if o.is_nan() { 0.0 } else { f - o }).collect::<Vec<f32>>()
            };
            let cotangent = |image: &Image| -> Vec<Real> {
                let d: Vec<f32> = differences(image).iter().map(|d| 2.0 * d / received as f32).collect();
                self.features.vjp(image, &d)
            };
            let model = self.without.as_deref().unwrap_or(self.model);
            let (image, d) = model.predict_vjp(Query::at(at, receiver), &cotangent)?;
            sum += differences(&image).iter().map(|d| f64::from(*d).powi(2)).sum::<f64>() / received;
            (0..3).for_each(|k| gradient[k] += d[k]);
        }
        Some((sum, gradient))
    }

    /// Chooses the kernel width and the sharpness of the mode by the mean error of up to [`COMPARED`] validation samples.
    /// Returns this error, metres; infinite without samples.
    fn choose_mode(&mut self, samples: &[ValidationSample]) -> f64 {
        let compared = self.compared_samples(samples);
        let chosen = self.choice;
        let choices = SHARPNESSES.into_iter().flat_map(|mode_sharpness| {
            WIDER.map(|factor| Choice { mode_bandwidth: factor * chosen.bandwidth, mode_sharpness, ..chosen })
        });
        let mut best = (f64::INFINITY, chosen);
        for choice in choices {
            self.choice = choice;
            let error = self.mean_error(&compared);
            best = if error < best.0 { (error, choice) } else { best };
        }
        self.choice = best.1;
        best.0
    }

    /// Turns descent on if it lowers the mean error of validation samples below `error`, metres, that without descent.
    fn choose_descent(&mut self, samples: &[ValidationSample], error: f64) {
        self.choice.descends = true;
        self.choice.descends = self.mean_error(&self.compared_samples(samples)) < error;
    }

    /// Returns at most [`COMPARED`] evenly chosen validation samples with their densities and regions.
    fn compared_samples<'t>(&self, samples: &'t [ValidationSample]) -> Vec<ComparedSample<'t>> {
        let selected: Vec<&ValidationSample> =
            samples.iter().step_by(samples.len().div_ceil(COMPARED).max(1)).collect();
        let with_density = |sample: &'t ValidationSample| {
            let (density, region) =
                self.density_and_region(&self.fingerprints.nearest(&sample.observation, KERNELS, None));
            ComparedSample { sample, density, region }
        };
        selected.into_par_iter().map(with_density).collect()
    }

    /// Returns the mean error of estimates, metres; NaN without samples.
    fn mean_error(&self, compared: &[ComparedSample<'_>]) -> f64 {
        let error = |ComparedSample { sample, density, region }: &ComparedSample<'_>| {
            distance(self.estimate(&sample.observation, density, region), sample.position)
        };
        mean(compared.par_iter().map(error).collect::<Vec<f64>>())
    }
}

/// Checks that transmitters of `data` can be located.
///
/// # Errors
/// Data without positions, or with a moving receiver.
fn check_locatable(data: &Dataset) -> Result<()> {
    let problem = if !data.placed || data.features.is_some() {
        "they have no transmitter positions; localisation compares with known positions"
    } else if data.scene.moving.is_receiver() {
        "the receiver moves; localisation needs fixed receivers"
    } else {
        return Ok(());
    };
    Err(Error::Config(format!("{}: {problem}", data.title)))
}

/// Returns the validation samples with these `fingerprints`.
fn validation_samples(fingerprints: &Fingerprints) -> Vec<ValidationSample> {
    let rows = fingerprints.positions.iter().enumerate();
    rows.map(|(k, &position)| ValidationSample { observation: fingerprints.row(k).to_vec(), position }).collect()
}

/// Returns the median distance of a sample to the nearest of `positions`, metres; NaN without samples.
fn median_distance(samples: &[ValidationSample], positions: &[[f64; 3]]) -> f64 {
    let nearest = |sample: &ValidationSample| {
        positions.iter().map(|position| distance(*position, sample.position)).fold(f64::INFINITY, f64::min)
    };
    median(samples.iter().map(nearest))
}

/// Returns half the median distance of a position to its nearest neighbour, metres, leaving out duplicates; at least
/// 0.1 mm, since kernels need a width.
fn half_spacing(positions: &[[f64; 3]]) -> f64 {
    let distances = nearest_others(positions).into_iter().flatten().map(|other| other.0);
    let typical = median(distances.filter(|distance| *distance > 0.0));
    if typical.is_finite() { (typical / 2.0).max(1e-4) } else { 1e-4 }
}
