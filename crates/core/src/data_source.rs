//! `DataSource`, `Split`, `Baseline`: data, their division into sets, and reference predictors.

use crate::plugin::{Plugin, registered};
use crate::{
    Dataset, Demand, Image, Misfit, Parts, Query, Real, Requirement, Result, Task, check_compatible, check_stopped,
    plugin_kind, rng::Rng,
};
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// Progress callback (done, total) of a long operation, called from any thread and in any order.
pub type Progress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// Loads or generates a data set.
///
/// In every plugin, mark fields that hold a path with `#[schemars(extend("format" = "path"))]`: pipelines resolve them
/// relative to their own folder.
#[typetag::serde]
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait DataSource: crate::plugin::PluginObject {
    /// Loads the data; large spectra stay in their file. Relative paths are relative to `base`, the folder of the pipeline
    /// file. `progress` counts links, transmitters or files; pass `&|_, _| {}` to ignore it.
    ///
    /// # Errors
    /// The files are missing, damaged or invalid; the message has the file and, for text, line and column.
    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset>;

    /// Returns the measurement type if it is known before loading, otherwise `None`. Unsuitable pipelines are then
    /// rejected when they are read, with the position.
    fn task(&self) -> Option<Task> {
        None
    }

    /// Returns a source for the data in `folder`; `None` unless it holds files of this layout. See [`recognise`].
    fn recognise(&self, folder: &Path) -> Option<Box<dyn DataSource>> {
        None
    }

    /// Rejects invalid settings when the pipeline is read; the error says what is wrong and what to do.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(DataSource);

/// Returns the source for `folder`: the first linked source, by name, that recognises its layout; `None` if none does.
/// Sources that require a setting are skipped.
pub fn recognise(folder: &Path) -> Option<Plugin<dyn DataSource>> {
    let source = |name| Plugin::<dyn DataSource>::parse(&format!("{name}()")).ok()?.recognise(folder);
    registered::<dyn DataSource>().into_iter().find_map(source).map(Plugin::from)
}

/// Divides links into training, validation and test sets.
#[typetag::serde]
pub trait Split: crate::plugin::PluginObject {
    /// Returns three disjoint sorted lists; training and test set are not empty.
    ///
    /// # Errors
    /// The data do not suit the split, or leave its training or test set empty; the message names the setting to
    /// change.
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition>;

    /// Divides `links`, in ascending order, into the units that the split holds out together, in order; a fold of a
    /// cross-validation holds some of them. By default, the links of one location are a unit.
    fn units(&self, data: &Dataset, links: &[usize]) -> Vec<Vec<usize>> {
        links.chunk_by(|a, b| data.links[*a].location == data.links[*b].location).map(<[usize]>::to_vec).collect()
    }

    /// Divides `links`, in ascending order, into the blocks that are assumed exchangeable in the calibration of prediction
    /// intervals: units, unless these are too small.
    fn blocks(&self, data: &Dataset, links: &[usize]) -> Vec<Vec<usize>> {
        self.units(data, links)
    }

    /// Returns whether a fold holds consecutive units, and not units at random.
    fn is_in_order(&self) -> bool {
        false
    }

    /// Returns whether the training set is deliberately small, so that a larger test set is accepted.
    fn is_sparse(&self) -> bool {
        false
    }

    /// Checks that the split can run here, for example that its Python class exists.
    ///
    /// # Errors
    /// The split cannot run; the message states the reason and the next step.
    fn check_ready(&self) -> Result<()> {
        Ok(())
    }

    /// Rejects invalid settings when the pipeline is read; the error says what is wrong and what to do.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Split);

/// Reference predictor that is scored next to the model in every table.
#[typetag::serde]
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait Baseline: crate::plugin::PluginObject {
    /// Returns its name in tables, such as `3-NN`.
    fn name(&self) -> String;

    /// Returns its name for a measurement type.
    fn name_for(&self, task: Task) -> String {
        self.name()
    }

    /// Returns the measurement types that it predicts.
    fn tasks(&self) -> &'static [Task] {
        &Task::ALL
    }

    /// Returns its requirements of the data beside the task.
    fn requires(&self) -> &'static [Requirement] {
        &[]
    }

    /// Returns its demands, for [`check_compatible`].
    fn demand(&self) -> Demand {
        Demand { field: "baselines", plugin: self.typetag_name(), tasks: self.tasks(), requires: self.requires() }
    }

    /// Checks whether the baseline supports the observations of `data`: its demands, by default. Commands call this before
    /// the first training step. It must be cheap: sweeps call it once per combination.
    ///
    /// # Errors
    /// The baseline does not support `data`; the message names the setting to change.
    fn check_data(&self, data: &Dataset) -> Result<()> {
        check_compatible(&Parts { data: Some(data), demands: &[self.demand()], ..Parts::default() })
            .map_err(Misfit::error)
    }

    /// Fits the baseline to the links of `fitting` and returns its predictor. Choices, such as the k of k-NN, are made on the
    /// validation set or on other held-out links of `fitting`.
    ///
    /// # Errors
    /// The data do not suit the baseline, an observation cannot be read, or the [flag](FittingSet::stop) ends the fit.
    fn fit<'a>(&self, data: &'a Dataset, fitting: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>>;

    /// Returns whether its predictions come from another program and are for the test set alone.
    fn is_external(&self) -> bool {
        false
    }

    /// Checks that predictions of exactly the links `test` exist. Commands call this before the first training step.
    ///
    /// # Errors
    /// Missing or invalid predictions of an external baseline.
    fn check_test(&self, data: &Dataset, test: &[usize]) -> Result<()> {
        Ok(())
    }

    /// Rejects invalid settings when the pipeline is read; the error says what is wrong and what to do.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Baseline);

/// Predicts the observation of a link.
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait Predict: Send + Sync {
    /// Returns the observation with the size of the data ([`Observations`](crate::Observations) describes powers and
    /// channels as arrays); spectra are not clamped. NaN if the prediction of another program cannot be read. A predictor
    /// fitted to one receiver ignores `query.receiver`.
    fn predict(&self, query: Query<'_>) -> Image;

    /// Returns the observations of many links, in their order: those of [`Self::predict`] to the bit.
    fn predict_many(&self, queries: &[Query<'_>]) -> Vec<Image> {
        queries.par_iter().map(|query| self.predict(*query)).collect()
    }

    /// Returns the standard deviation of a value of a measurement about the prediction, up to a constant factor; `None` if
    /// the predictor has no estimate.
    fn deviation(&self, query: Query<'_>) -> Option<f64> {
        None
    }

    /// Returns the observation of a link, and the derivative of Σ d·observation by the position of the transmitter
    /// (metres, world frame; for a moving receiver by the position of the receiver). `cotangent` returns d from the
    /// observation, which is not clamped. `None` if the prediction has no derivative, as that of nearest neighbours.
    fn predict_vjp(&self, query: Query<'_>, cotangent: &dyn Fn(&Image) -> Vec<Real>) -> Option<(Image, [f64; 3])> {
        None
    }

    /// Returns the predictor with the same parameters and without the samples `links` (ascending); `None` if it
    /// cannot leave samples out.
    fn without(&self, links: &[usize]) -> Option<Box<dyn Predict + '_>> {
        None
    }

    /// Returns a note below tables of scores, for predictors whose scores are not directly comparable; `None` for
    /// others.
    fn note(&self) -> Option<String> {
        None
    }

    /// Returns whether it uses information that a model lacks: the simulated scene (exact or with errors), as ray tracing
    /// does, or the time of a measurement. It is then an oracle baseline and not ranked.
    fn is_oracle(&self) -> bool {
        false
    }
}

/// Training, validation and test links: sorted, disjoint indices into [`Dataset::links`](crate::Dataset::links).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Partition {
    /// Training links.
    pub train: Vec<usize>,
    /// Validation links, for curves and choices.
    pub validation: Vec<usize>,
    /// Test links, read once at the end.
    pub test: Vec<usize>,
}

impl Partition {
    /// Returns training and validation set, all but the test set, without a flag that ends the fit.
    pub fn known(&self) -> FittingSet<'_> {
        FittingSet { train: &self.train, validation: &self.validation, stop: None }
    }

    /// Returns the sizes of training, validation and test set.
    pub fn sizes(&self) -> [usize; 3] {
        [&self.train, &self.validation, &self.test].map(Vec::len)
    }

    /// Returns the set that holds a link; [`LinkSet::Unused`] if none does.
    pub fn set_of(&self, link: usize) -> LinkSet {
        let sets =
            [(&self.train, LinkSet::Training), (&self.validation, LinkSet::Validation), (&self.test, LinkSet::Test)];
        let holder = sets.into_iter().find(|(links, _)| links.binary_search(&link).is_ok());
        holder.map_or(LinkSet::Unused, |(_, set)| set)
    }
}

/// Set of a link. Web pages receive its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum LinkSet {
    /// Training set.
    Training = 0,
    /// Validation set.
    Validation = 1,
    /// Test set.
    Test = 2,
    /// No set.
    Unused = 3,
}

/// Links for the fit of a baseline: two disjoint lists of indices into [`Dataset::links`](crate::Dataset::links).
#[derive(Clone, Copy, Debug, Default)]
pub struct FittingSet<'a> {
    /// Training links, as for models.
    pub train: &'a [usize],
    /// Validation links. Baselines may use them for choices, and then fit them like training links.
    pub validation: &'a [usize],
    /// Flag that ends the fit; `None` if it cannot be interrupted.
    pub stop: Option<&'a AtomicBool>,
}

impl<'a> FittingSet<'a> {
    /// Creates a set without validation links and without a flag that ends the fit.
    pub fn train(train: &'a [usize]) -> Self {
        Self { train, ..Self::default() }
    }

    /// Returns the set with a flag that ends the fit.
    #[must_use]
    pub fn stopped_by(self, stop: &'a AtomicBool) -> Self {
        Self { stop: Some(stop), ..self }
    }

    /// Checks the flag; a long fit calls this several times per second.
    ///
    /// # Errors
    /// [`Error::Stopped`](crate::Error::Stopped) once the flag is set.
    pub fn check_stopped(&self) -> Result<()> {
        self.stop.map_or(Ok(()), check_stopped)
    }

    /// Returns training and validation links together, sorted.
    pub fn all(&self) -> Vec<usize> {
        let mut links = [self.train, self.validation].concat();
        links.sort_unstable();
        links
    }
}
