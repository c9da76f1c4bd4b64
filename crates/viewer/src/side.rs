//! `ViewPane`: one half of the page, with a model, a run in progress or a baseline.

use crate::predictor::{FittedBaseline, Predictor};
use pwrfgs_core::messages::strip_control;
use pwrfgs_core::{
    Baseline, Dataset, Error, MeasurementSetup, Partition, Plugin, Predict, Result, ShippedModel, files,
};
use pwrfgs_experiment::folder::{CHECKPOINT, MODEL_FILE, PIPELINE, SCORES};
use pwrfgs_experiment::scores::MODEL;
use pwrfgs_experiment::{
    Facts, Observer, Scores, SplitData, check_alike, load_with_findings, read_model, read_pipeline,
};
use pwrfgs_localise::{Locator, SHARES};
use pwrfgs_model::{Ensemble, file};
use pwrfgs_pipeline::Pipeline;
use pwrfgs_train::Trainer;
use self_cell::self_cell;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError, RwLock};

self_cell!(
    /// Locator with the predictor of its fingerprints.
    pub(crate) struct FittedLocator {
        owner: Arc<Predictor>,
        #[covariant]
        dependent: Locator,
    }
);

/// Data of a run, with their split and the scores per link.
pub(crate) struct LoadedData {
    pub(crate) pipeline: Pipeline,
    pub(crate) data: Arc<Dataset>,
    pub(crate) partition: Partition,
    /// Score per link; NaN if unknown.
    pub(crate) scores: Vec<f64>,
}

/// One half of the page.
pub struct ViewPane {
    pub(crate) name: String,
    /// Run folder, if there is one.
    pub(crate) folder: Option<PathBuf>,
    /// Data of the run, if its pipeline is next to the model.
    pub(crate) loaded: Option<Arc<LoadedData>>,
    /// Measurement setup of the predictions.
    pub(crate) setup: MeasurementSetup,
    /// Corners of surfaces `[T,3,3]`, metres, world frame.
    pub(crate) surfaces: Vec<[[f64; 3]; 3]>,
    predictor: RwLock<Option<Arc<Predictor>>>,
    /// Locator of one of the predictors, fitted by the first request.
    locator: Mutex<Option<(Arc<Predictor>, Arc<FittedLocator>)>>,
}

impl ViewPane {
    /// Opens a model file, a shipped model or a run folder; the run may be in progress.
    ///
    /// # Errors
    /// If files are missing or damaged, or if the data do not fit the model.
    pub fn open(path: &Path, observer: &mut dyn Observer) -> Result<Self> {
        if let Some(model) = ShippedModel::find(path) {
            return Ok(Self { name: model.name.into(), ..Self::of_models(read_model(path)?) });
        }
        let folder = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new("")) }.to_owned();
        let pipeline = folder.join(PIPELINE);
        let is_unfinished = path.is_dir() && pipeline.is_file() && !path.join(MODEL_FILE).is_file();
        let ensemble = (!is_unfinished).then(|| read_model(path)).transpose()?;
        let loaded =
            pipeline.is_file().then(|| LoadedData::load(&pipeline, &folder, observer)).transpose()?.map(Arc::new);
        if let (Some(ensemble), Some(loaded)) = (&ensemble, &loaded) {
            check_alike(&ensemble.prepare(), &loaded.data)?;
        }
        let (setup, predictor) = match (ensemble, &loaded) {
            (Some(ensemble), _) => (ensemble.members()[0].stages.setup.clone(), Some(Predictor::new(ensemble))),
            (None, Some(loaded)) => (
                MeasurementSetup::of(&loaded.data, loaded.pipeline.plane(&loaded.data)?),
                loaded.read_checkpoint(&folder)?,
            ),
            (None, None) => return Err(Error::input(path, "the run was removed meanwhile; name another")),
        };
        let is_run = path.is_dir() || folder.join(PIPELINE).is_file();
        let name = if is_run { &folder } else { path };
        let name = name.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned());
        Ok(Self {
            name,
            folder: is_run.then_some(folder),
            loaded,
            setup,
            surfaces: Vec::new(),
            predictor: RwLock::new(predictor.map(Arc::new)),
            locator: Mutex::default(),
        })
    }

    /// Creates a pane with models that have no file.
    pub fn of_models(models: Ensemble) -> Self {
        Self {
            name: "model".into(),
            folder: None,
            loaded: None,
            setup: models.members()[0].stages.setup.clone(),
            surfaces: Vec::new(),
            predictor: RwLock::new(Some(Arc::new(Predictor::new(models)))),
            locator: Mutex::default(),
        }
    }

    /// Opens what `text` names beside this pane: a model file, a shipped model, a run folder, or a baseline for the data of this
    /// pane.
    ///
    /// # Errors
    /// As [`Self::open`] and [`Self::fit_baseline`]; a text that is neither a path nor a baseline.
    pub fn open_beside(&self, text: &str, observer: &mut dyn Observer) -> Result<Self> {
        let path = Path::new(text);
        if path.exists() || ShippedModel::find(path).is_some() {
            return Self::open(path, observer);
        }
        let whole = if text.contains('(') { text.to_owned() } else { format!("{text}()") };
        let baseline = Plugin::<dyn Baseline>::parse(&whole).map_err(|why| {
            Error::Config(format!(
                "{}: neither a file, a folder nor a baseline: {why}; write a baseline as NearestNeighbours(k: 5)",
                strip_control(text)
            ))
        })?;
        Self::fit_baseline(&baseline, self)
    }

    /// Adds the surfaces of the room of simulated data; panes of other data stay as they are.
    ///
    /// # Errors
    /// The scene of the data is invalid.
    #[cfg(feature = "raytrace")]
    pub(crate) fn add_surfaces(&mut self) -> Result<()> {
        let simulation = self.loaded.as_ref().and_then(|loaded| loaded.data.simulation.as_ref());
        if let Some(text) = simulation.and_then(|simulation| simulation.scene.as_deref()) {
            let scene = pwrfgs_raytrace::SceneFile::parse(text, Path::new("the scene of the data"))?;
            self.surfaces = scene.surfaces_below_ceiling()?;
        }
        Ok(())
    }

    /// Leaves the pane unchanged: surfaces need the feature `raytrace`.
    #[cfg(not(feature = "raytrace"))]
    #[allow(clippy::unnecessary_wraps, clippy::unused_self)] // same signature as above
    pub(crate) fn add_surfaces(&mut self) -> Result<()> {
        Ok(())
    }

    /// Creates a pane with a baseline that is fitted to the data of the pane `beside`.
    ///
    /// # Errors
    /// If that pane has no data, or the baseline does not support them.
    pub fn fit_baseline(baseline: &Plugin<dyn Baseline>, beside: &Self) -> Result<Self> {
        let Some(loaded) = &beside.loaded else {
            let problem = "baseline: needs the data of a run, but no pipeline is next to this model; name a run folder";
            return Err(Error::Config(problem.into()));
        };
        let task = loaded.data.task();
        let name = baseline.name_for(task);
        if !baseline.tasks().contains(&task) || baseline.is_external() {
            let input = if baseline.is_external() { "positions outside its test set" } else { task.plural };
            return Err(Error::Config(format!("baseline {name}: not available for {input}")));
        }
        let fitted =
            FittedBaseline::try_new(Arc::clone(&loaded.data), |data| baseline.fit(data, loaded.partition.known()))?;
        Ok(Self {
            name,
            folder: None,
            loaded: Some(Arc::clone(loaded)),
            setup: beside.setup.clone(),
            surfaces: Vec::new(),
            predictor: RwLock::new(Some(Arc::new(Predictor::Baseline(fitted)))),
            locator: Mutex::default(),
        })
    }

    /// Returns the current predictor; `None` before the first checkpoint of a run.
    pub(crate) fn predictor(&self) -> Option<Arc<Predictor>> {
        self.predictor.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the locator of `predictor`, whose models are used without their residuals of validation samples. The
    /// first call fits it, which takes up to minutes; meanwhile other calls wait. Returns an error if the fit fails.
    pub(crate) fn fit_locator(&self, loaded: &LoadedData, predictor: Arc<Predictor>) -> Result<Arc<FittedLocator>> {
        let mut cached = self.locator.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, locator)) = cached.as_ref().filter(|(owner, _)| Arc::ptr_eq(owner, &predictor)) {
            return Ok(Arc::clone(locator));
        }
        let unbiased =
            predictor.ensemble().map(|ensemble| ensemble.without_validation(&loaded.data, loaded.partition.known()));
        let unbiased = unbiased.transpose()?.flatten().map(|ensemble| Arc::new(Predictor::new(ensemble)));
        let unbiased = unbiased.unwrap_or_else(|| Arc::clone(&predictor));
        // Uses separate threads: predictions of other requests would wait for shared ones.
        let threads = rayon::ThreadPoolBuilder::new().num_threads(rayon::current_num_threads()).build();
        let pool = threads.map_err(|e| Error::Config(format!("no threads: {e}")))?;
        let fitted = FittedLocator::try_new(unbiased, |predictor| {
            let model: &dyn Predict = match &**predictor {
                Predictor::Model(ready) => ready.borrow_dependent(),
                Predictor::Baseline(baseline) => baseline.borrow_dependent().as_ref(),
            };
            pool.install(|| Locator::fit(&loaded.data, loaded.partition.known(), model, &SHARES, &|_, _| {}))
        })?;
        let (_, fitted) = cached.insert((predictor, Arc::new(fitted)));
        Ok(Arc::clone(fitted))
    }

    /// Reads the model or the last checkpoint of the run again. Returns whether the final model exists, or there is no run;
    /// an error for a file that cannot be read.
    pub(crate) fn reload(&self) -> Result<bool> {
        let (Some(folder), Some(loaded)) = (&self.folder, &self.loaded) else { return Ok(true) };
        let model = folder.join(MODEL_FILE);
        let is_finished = model.is_file();
        let predictor = if is_finished {
            Some(Predictor::new(file::read_ensemble(&model)?))
        } else {
            loaded.read_checkpoint(folder)?
        };
        *self.predictor.write().unwrap_or_else(PoisonError::into_inner) = predictor.map(Arc::new);
        // A locator in work is kept by its request; a finished one would keep the replaced model.
        if let Ok(mut locator) = self.locator.try_lock() {
            *locator = None;
        }
        Ok(is_finished)
    }

    /// Returns an error unless the pane predicts the same quantity, for the same receivers and in the same image size,
    /// as `other`.
    pub(crate) fn check_comparable(&self, other: &Self) -> Result<()> {
        let (a, b) = (&self.setup, &other.setup);
        let poses = |setup: &MeasurementSetup| -> Vec<_> {
            setup.receivers.iter().map(|receiver| setup.origin.world_pose(receiver.pose)).collect()
        };
        if (a.task, a.moving.is_receiver()) != (b.task, b.moving.is_receiver())
            || (a.plane.width, a.plane.height) != (b.plane.width, b.plane.height)
            || poses(a) != poses(b)
        {
            let problem = "differ in task, receivers or image size; compare models of the same data";
            return Err(Error::Config(format!("{} and {} {problem}", other.name, self.name)));
        }
        Ok(())
    }
}

impl LoadedData {
    /// Loads the data and the split of the pipeline `file`, with the scores in `folder`.
    fn load(file: &Path, folder: &Path, observer: &mut dyn Observer) -> Result<Self> {
        let pipeline = read_pipeline(file, &[])?;
        let (SplitData { data, partition }, _) = load_with_findings(&pipeline, None, observer)?;
        let scores = read_link_scores(folder, &data);
        Ok(Self { pipeline, data: Arc::new(data), partition, scores })
    }

    /// Reads the model of the last checkpoint in `folder`; `None` before the first one.
    fn read_checkpoint(&self, folder: &Path) -> Result<Option<Predictor>> {
        let path = folder.join(CHECKPOINT);
        let Some(bytes) = files::if_found(&path, files::read(&path))? else { return Ok(None) };
        let trainer = Trainer::restore(&self.pipeline.plan()?, &self.data, &self.partition, &bytes);
        let trainer = trainer.map_err(|why| Error::input(&path, why.to_string()))?;
        Ok(Some(Predictor::new(Ensemble::of(trainer.model()))))
    }
}

/// Reads the main metric of the model per link from the run folder; NaN for links without a score, all if unreadable.
fn read_link_scores(folder: &Path, data: &Dataset) -> Vec<f64> {
    let table = Facts::read(folder).ok().flatten().and_then(|facts| facts.scores);
    let read = table.and_then(|table| Scores::read(&folder.join(SCORES), table).ok());
    let by_label = read.and_then(|scores| scores.values_by_id(MODEL, data.task().headline.key)).unwrap_or_default();
    (0..data.len()).map(|i| by_label.get(&data.label(i)).copied().unwrap_or(f64::NAN)).collect()
}
