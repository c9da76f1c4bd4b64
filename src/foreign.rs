//! Strategies that are written in Python, as a pipeline names them: [`Python`].
//!
//! The Python package sets a [`Host`] that can run them. A program without one reads such a pipeline, reports it and
//! predicts with its model; to train it, or to divide and score data by a class of Python's, it refuses.

use pwrfgs_core::tape::{TraceScalar, Traced};
use pwrfgs_core::{
    Baseline, CloudStats, Dataset, Error, Evaluation, Gate, GaussianCloud, ImagePlane, Initializer, JsonSchema, Known,
    Measurement, Metric, Moment, Needs, Partition, Predict, Pruner, PrunerTraits, Real, Result, Scene, Seen, Split,
    Task, rng::Rng,
};
use serde::{Deserialize, Serialize};
use std::sync::{Arc, OnceLock};

/// A class of Python's that takes part in a run, as the run folder records it: as a pruner it says which Gaussians stay, and
/// so on for initializers, splits, baselines and metrics. The Python package writes this text when an object is given to it,
/// and makes the object anew from it when a run is resumed.
///
/// A folder with one can be reported, and its model predicts, anywhere; it is trained by the Python package alone.
///
/// ```
/// # use pwrfgs_core::{Plugin, Pruner};
/// # use pwrfgs as _;
/// let text = r#"Python(module: "strategies", class: "Thin", settings: "{\"share\": 0.1}", source: "5f1c")"#;
/// let pruner = Plugin::<dyn Pruner>::parse(text).unwrap();
/// assert!(pruner.traits().unavailable.unwrap().contains("Thin"));
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Python {
    /// The module that it is imported from.
    pub module: String,
    /// The class in it.
    pub class: String,
    /// What the class is called with, as a JSON object.
    pub settings: String,
    /// SHA-256 of its source: a strategy that has changed since does not go on with a run of the old one.
    pub source: String,
}

/// Who makes objects of Python from their names.
pub trait Host: Send + Sync {
    /// # Errors
    /// Why there is no such strategy.
    fn pruner(&self, which: &Python) -> Result<Arc<dyn Pruner>>;
    /// # Errors
    /// As [`Self::pruner`].
    fn initializer(&self, which: &Python) -> Result<Arc<dyn Initializer>>;
    /// # Errors
    /// As [`Self::pruner`].
    fn split(&self, which: &Python) -> Result<Arc<dyn Split>>;
    /// # Errors
    /// As [`Self::pruner`].
    fn baseline(&self, which: &Python) -> Result<Arc<dyn Baseline>>;
    /// # Errors
    /// As [`Self::pruner`].
    fn metric(&self, which: &Python) -> Result<Arc<dyn Metric>>;
}

static HOST: OnceLock<Box<dyn Host>> = OnceLock::new();

/// From now on strategies are made by `host`; the first one stays.
pub fn set_host(host: Box<dyn Host>) {
    _ = HOST.set(host);
}

impl Python {
    /// The host, or why there is none.
    fn host(&self) -> Result<&'static dyn Host> {
        HOST.get().map(|host| &**host).ok_or_else(|| {
            Error::Config(format!(
                "`{}` of the module `{}` is written in Python, which this program does not run; use the Python package, \
                 pwrfgs.run(\"FOLDER\"). Reports and predictions of a trained folder work here too",
                self.class, self.module
            ))
        })
    }

    fn as_pruner(&self) -> Option<Arc<dyn Pruner>> {
        self.host().and_then(|host| host.pruner(self)).ok()
    }
}

/// The trainer looks at [`PrunerTraits::unavailable`] first, so there is a strategy whenever one is asked anything that counts.
#[typetag::serde]
impl Pruner for Python {
    fn traits(&self) -> PrunerTraits {
        let unavailable = |why: Error| PrunerTraits { unavailable: Some(why.to_string()), ..PrunerTraits::default() };
        self.host().and_then(|host| host.pruner(self)).map_or_else(unavailable, |own| own.traits())
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<bool> {
        self.as_pruner().map_or_else(|| vec![true; cloud.len()], |own| own.keep(cloud, stats, moment))
    }

    fn needs(&self, cloud: &GaussianCloud, moment: &Moment) -> Needs {
        self.as_pruner().map_or_else(Needs::nothing, |own| own.needs(cloud, moment))
    }

    fn gate(&self, cloud: &Traced, moment: &Moment) -> Option<Gate> {
        self.as_pruner()?.gate(cloud, moment)
    }

    fn penalty(&self, cloud: &Traced, moment: &Moment) -> Option<TraceScalar> {
        self.as_pruner()?.penalty(cloud, moment)
    }

    fn update(&self, cloud: &mut GaussianCloud, stats: &CloudStats, moment: &Moment) {
        if let Some(own) = self.as_pruner() {
            own.update(cloud, stats, moment);
        }
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, moment: &Moment) -> Vec<Real> {
        self.as_pruner().map_or_else(|| cloud.opacity_logits.clone(), |own| own.score(cloud, stats, moment))
    }
}

#[typetag::serde]
impl Initializer for Python {
    fn initialize(&self, scene: &Scene, plane: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud> {
        self.host()?.initializer(self)?.initialize(scene, plane, rng)
    }

    fn search(&self, seen: &Seen<'_>, rng: &mut Rng) -> Result<GaussianCloud> {
        self.host()?.initializer(self)?.search(seen, rng)
    }
}

#[typetag::serde]
impl Split for Python {
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        self.host()?.split(self)?.split(data, rng)
    }

    fn ready(&self) -> Result<()> {
        self.host()?.split(self).map(|_| ())
    }
}

#[typetag::serde]
impl Baseline for Python {
    fn name(&self) -> String {
        self.class.clone()
    }

    fn name_for(&self, task: Task) -> String {
        let own = self.host().and_then(|host| host.baseline(self));
        own.map_or_else(|_| self.class.clone(), |own| own.name_for(task))
    }

    fn check_data(&self, data: &Dataset) -> Result<()> {
        self.host()?.baseline(self)?.check_data(data)
    }

    fn fit<'a>(&self, data: &'a Dataset, known: Known<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.host()?.baseline(self)?.fit(data, known)
    }
}

#[typetag::serde]
impl Metric for Python {
    fn check_data(&self, data: &Dataset) -> Result<()> {
        self.host()?.metric(self)?.check_data(data)
    }

    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        self.host()?.metric(self)?.evaluate(evaluation)
    }
}
