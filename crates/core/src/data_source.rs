//! `DataSource`, `Split`, `Baseline`: what is known, how it is divided, and what must be beaten.

use crate::plugin::{Plugin, registered};
use crate::{Dataset, Image, Query, Result, Task, plugin_kind, rng::Rng};
use std::path::Path;

/// Told (done, of how many) while something long is under way, from any thread and in any order.
pub type Progress<'a> = &'a (dyn Fn(usize, usize) + Sync);

/// Loads or makes a data set.
///
/// Of any plugin, a field that holds a path has the attribute `#[schemars(extend("format" = "path"))]`: a pipeline file
/// takes it from its own folder.
#[typetag::serde]
pub trait DataSource:
    erased_serde::Serialize + crate::docs::Documented + std::any::Any + std::fmt::Debug + Send + Sync
{
    /// Everything, in memory. Relative paths are relative to `base`, the folder of the pipeline file. `progress` counts
    /// links; `&|_, _| {}` where nobody wants to know.
    fn load(&self, base: &Path, progress: Progress<'_>) -> Result<Dataset>;

    /// What it observes, if that is known before it is loaded: a pipeline that does not fit is then refused when it is read,
    /// at its place.
    fn task(&self) -> Option<Task> {
        None
    }

    /// This source for the data in `folder`, if the folder holds files of its layout. See [`recognise`].
    fn recognise(&self, folder: &Path) -> Option<Box<dyn DataSource>> {
        let _ = folder;
        None
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(DataSource);

/// The source that reads `folder`: the first by name, of all that are linked, that recognises its layout.
pub fn recognise(folder: &Path) -> Option<Plugin<dyn DataSource>> {
    let source = |name| Plugin::<dyn DataSource>::parse(&format!("{name}()")).ok()?.recognise(folder);
    registered::<dyn DataSource>().into_iter().find_map(source).map(Plugin::from)
}

/// Divides links into training, validation and test.
#[typetag::serde]
pub trait Split:
    erased_serde::Serialize + crate::docs::Documented + std::any::Any + std::fmt::Debug + Send + Sync
{
    /// Three disjoint sorted lists; train and test are not empty.
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition>;

    /// Whether the training set is small on purpose, so that a larger test set is no mistake.
    fn is_sparse(&self) -> bool {
        false
    }

    /// Checks that the split can run here, for example that its Python class exists.
    ///
    /// # Errors
    /// Why not, and what to do.
    fn ready(&self) -> Result<()> {
        Ok(())
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Split);

/// A predictor without Gaussians, scored beside the model in every table.
#[typetag::serde]
pub trait Baseline:
    erased_serde::Serialize + crate::docs::Documented + std::any::Any + std::fmt::Debug + Send + Sync
{
    /// Its name in tables, such as `3-NN`.
    fn name(&self) -> String;

    /// The same where it depends on what is observed.
    fn name_for(&self, task: Task) -> String {
        let _ = task;
        self.name()
    }

    /// Whether it predicts observations of `task`.
    fn supports(&self, task: Task) -> bool {
        let _ = task;
        true
    }

    /// Checks whether the baseline supports the observations of `data`. Commands call this before the first training step.
    /// It must be cheap: sweeps call it once per combination.
    ///
    /// # Errors
    /// The baseline does not support `data`; the message names the setting to change.
    fn check_data(&self, data: &Dataset) -> Result<()> {
        let _ = data;
        Ok(())
    }

    /// Learns from all `known` links, and makes its choices, if it has any, on their validation part; where that is
    /// empty, on samples of the training part that it leaves out meanwhile.
    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>>;

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Baseline);

/// Predicts what would be observed of a link.
pub trait Predict: Send + Sync {
    /// The observation, as large as the data's ([`Observations`](crate::Observations) says how powers and channels are
    /// arrays); spectra are not clamped. A predictor that learned from one receiver looks at `query.tx` alone.
    fn predict(&self, query: Query<'_>) -> Image;

    /// A sentence that tables of scores print under themselves, for a predictor whose numbers mean something else than
    /// those beside it.
    fn note(&self) -> Option<String> {
        None
    }

    /// Whether it was given the scene that made the data, exactly or with errors, instead of learning from spectra: ray
    /// tracing in that scene, say. It is then a bound, and in no ranking.
    fn knows_scene(&self) -> bool {
        false
    }
}

/// Which links serve what; indices into [`Dataset::links`](crate::Dataset::links), each list sorted, the lists disjoint.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Partition {
    /// What the model learns from.
    pub train: Vec<usize>,
    /// What curves and choices look at.
    pub validation: Vec<usize>,
    /// Read once, at the end.
    pub test: Vec<usize>,
}

impl Partition {
    /// All but the test part.
    pub fn known(&self) -> Known<'_> {
        Known { train: &self.train, validation: &self.validation }
    }

    /// Numbers of training, validation and test links.
    pub fn sizes(&self) -> [usize; 3] {
        [&self.train, &self.validation, &self.test].map(Vec::len)
    }

    /// Returns the set that holds a link.
    pub fn set_of(&self, link: usize) -> LinkSet {
        let sets =
            [(&self.train, LinkSet::Training), (&self.validation, LinkSet::Validation), (&self.test, LinkSet::Test)];
        let found = sets.into_iter().find(|(links, _)| links.binary_search(&link).is_ok());
        found.map_or(LinkSet::Unused, |(_, set)| set)
    }
}

/// Set of a link. Pages receive its number.
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

/// The links that a baseline may learn from; indices into [`Dataset::links`](crate::Dataset::links), two disjoint lists.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Known<'a> {
    /// What a model learns from, too.
    pub train: &'a [usize],
    /// What choices are made on, where there are any to make. Then it is learned from like the rest.
    pub validation: &'a [usize],
}

impl<'a> Known<'a> {
    /// A training part without validation.
    pub fn train(train: &'a [usize]) -> Self {
        Self { train, validation: &[] }
    }

    /// Training and validation together, sorted.
    pub fn all(&self) -> Vec<usize> {
        let mut all = [self.train, self.validation].concat();
        all.sort_unstable();
        all
    }
}
