//! Strategies written in Python, as recorded in a pipeline: [`Python`].
//!
//! The Python package sets a [`Host`] that can run them. Programs without a host can read and report such a pipeline
//! and predict with its model; training, and splits or scores by Python classes, are errors. A network in Python is an
//! exception: it is part of the model, so only the host can read its pipeline and its model.

use pwrfgs_core::tape::{TraceScalar, TracedCloud};
use pwrfgs_core::{
    Baseline, Cache, CloudStats, Conditions, Dataset, Deformation, DeformationInputs, DeformationTraits,
    DeformationVjp, Deltas, Error, Evaluation, FittingSet, Gate, GaussianCloud, ImagePlane, Initializer,
    InitializerInput, JsonSchema, Layout, Measurement, Metric, Needs, Partition, Predict, Pruner, PrunerTraits, Real,
    Result, Scene, Split, StepContext, Task, rng::Rng,
};
use serde::{Deserialize, Serialize};
use std::sync::{Arc, OnceLock};

/// Python class used by a run, as recorded in the run folder: a pruner, initializer, split, baseline, metric or network.
/// The Python package writes this text for an object, and recreates the object from it when a run is resumed.
///
/// Folders of such runs can be reported, and their models predict, in any program; only the Python package can train
/// them, and predict with a network of this kind.
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
    /// Module to import.
    pub module: String,
    /// Name of the class in the module.
    pub class: String,
    /// Arguments of the class, as a JSON object.
    pub settings: String,
    /// SHA-256 of the class source: a run cannot be resumed after the class has changed.
    pub source: String,
}

/// Host that creates Python objects by name.
pub trait Host: Send + Sync {
    /// Returns the pruner of a class.
    ///
    /// # Errors
    /// The host has no such class; the message gives the reason.
    fn pruner(&self, which: &Python) -> Result<Arc<dyn Pruner>>;
    /// Returns the initializer of a class.
    ///
    /// # Errors
    /// Same as [`Self::pruner`].
    fn initializer(&self, which: &Python) -> Result<Arc<dyn Initializer>>;
    /// Returns the split of a class.
    ///
    /// # Errors
    /// Same as [`Self::pruner`].
    fn split(&self, which: &Python) -> Result<Arc<dyn Split>>;
    /// Returns the baseline of a class.
    ///
    /// # Errors
    /// Same as [`Self::pruner`].
    fn baseline(&self, which: &Python) -> Result<Arc<dyn Baseline>>;
    /// Returns the metric of a class.
    ///
    /// # Errors
    /// Same as [`Self::pruner`].
    fn metric(&self, which: &Python) -> Result<Arc<dyn Metric>>;
    /// Returns the network of a class.
    ///
    /// # Errors
    /// Same as [`Self::pruner`].
    fn deformation(&self, which: &Python) -> Result<Arc<dyn Deformation>>;
}

static HOST: OnceLock<Box<dyn Host>> = OnceLock::new();

/// Sets the host of all strategies; later calls have no effect.
pub fn set_host(host: Box<dyn Host>) {
    _ = HOST.set(host);
}

impl Python {
    /// Returns the host; an error if there is none.
    fn host(&self) -> Result<&'static dyn Host> {
        HOST.get().map(|host| &**host).ok_or_else(|| {
            Error::Config(format!(
                "`{}` of the module `{}` is written in Python, which this program does not run; use the Python package, \
                 pwrfgs.run(\"FOLDER\"). Reports and predictions of a trained folder work here too",
                self.class, self.module
            ))
        })
    }

    /// Creates the pruner; `None` if there is no host or no such class.
    fn as_pruner(&self) -> Option<Arc<dyn Pruner>> {
        self.host().and_then(|host| host.pruner(self)).ok()
    }

    /// Creates the network; an error if there is no host or no such class.
    fn as_deformation(&self) -> Result<Arc<dyn Deformation>> {
        self.host()?.deformation(self)
    }
}

/// The trainer checks [`PrunerTraits::unavailable`] first, so a strategy exists whenever a result is used.
#[typetag::serde]
impl Pruner for Python {
    fn traits(&self) -> PrunerTraits {
        let unavailable = |why: Error| PrunerTraits { unavailable: Some(why.to_string()), ..PrunerTraits::default() };
        self.host().and_then(|host| host.pruner(self)).map_or_else(unavailable, |strategy| strategy.traits())
    }

    fn keep(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<bool> {
        self.as_pruner().map_or_else(|| vec![true; cloud.len()], |strategy| strategy.keep(cloud, stats, context))
    }

    fn needs(&self, cloud: &GaussianCloud, context: &StepContext) -> Needs {
        self.as_pruner().map_or_else(Needs::default, |strategy| strategy.needs(cloud, context))
    }

    fn gate(&self, cloud: &TracedCloud, context: &StepContext) -> Option<Gate> {
        self.as_pruner()?.gate(cloud, context)
    }

    fn penalty(&self, cloud: &TracedCloud, context: &StepContext) -> Option<TraceScalar> {
        self.as_pruner()?.penalty(cloud, context)
    }

    fn update(&self, cloud: &mut GaussianCloud, stats: &CloudStats, context: &StepContext) {
        if let Some(strategy) = self.as_pruner() {
            strategy.update(cloud, stats, context);
        }
    }

    fn score(&self, cloud: &GaussianCloud, stats: &CloudStats, context: &StepContext) -> Vec<Real> {
        self.as_pruner().map_or_else(|| cloud.opacity_logits.clone(), |strategy| strategy.score(cloud, stats, context))
    }
}

#[typetag::serde]
impl Initializer for Python {
    fn initialize(&self, scene: &Scene, plane: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud> {
        self.host()?.initializer(self)?.initialize(scene, plane, rng)
    }

    fn search(&self, input: &InitializerInput<'_>, rng: &mut Rng) -> Result<GaussianCloud> {
        self.host()?.initializer(self)?.search(input, rng)
    }
}

#[typetag::serde]
impl Split for Python {
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        self.host()?.split(self)?.split(data, rng)
    }

    fn check_ready(&self) -> Result<()> {
        self.host()?.split(self).map(|_| ())
    }
}

#[typetag::serde]
impl Baseline for Python {
    fn name(&self) -> String {
        self.class.clone()
    }

    fn name_for(&self, task: Task) -> String {
        let strategy = self.host().and_then(|host| host.baseline(self));
        strategy.map_or_else(|_| self.class.clone(), |strategy| strategy.name_for(task))
    }

    fn check_data(&self, data: &Dataset) -> Result<()> {
        self.host()?.baseline(self)?.check_data(data)
    }

    fn fit<'a>(&self, data: &'a Dataset, fitting: FittingSet<'_>) -> Result<Box<dyn Predict + 'a>> {
        self.host()?.baseline(self)?.fit(data, fitting)
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

/// [`Deformation::check`] rejects a pipeline or model whose class is unavailable, so the network exists whenever it is
/// used.
#[typetag::serde]
impl Deformation for Python {
    fn traits(&self) -> DeformationTraits {
        self.as_deformation().map(|strategy| strategy.traits()).unwrap_or_default()
    }

    fn layout(&self) -> Layout {
        self.as_deformation().map(|strategy| strategy.layout()).unwrap_or_default()
    }

    fn forward(&self, inputs: &DeformationInputs<'_>, prepared: &Cache) -> Deltas {
        self.as_deformation().map(|strategy| strategy.forward(inputs, prepared)).unwrap_or_default()
    }

    fn vjp(&self, inputs: &DeformationInputs<'_>, d: &Deltas, sums: DeformationVjp<'_>) {
        if let Ok(strategy) = self.as_deformation() {
            strategy.vjp(inputs, d, sums);
        }
    }

    fn start(&self, training: Conditions<'_>, weights: &mut [Real]) {
        if let Ok(strategy) = self.as_deformation() {
            strategy.start(training, weights);
        }
    }

    fn check(&self) -> Result<(), String> {
        // Without a module, the default value: no network.
        if self.module.is_empty() { Ok(()) } else { self.as_deformation().map(drop).map_err(|why| why.to_string()) }
    }
}
