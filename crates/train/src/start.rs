//! `Trainer`: creation from plan and data, initial Gaussians and weights, and Gaussians from outside between two steps.

use crate::adam::Adam;
use crate::batches::{Batches, plane_of_step};
use crate::edit::GaussianIds;
use crate::loss::create_objective;
use crate::plan::{TrainingPlan, check_available, requested_columns};
use crate::settings::Training;
use crate::trainer::Trainer;
use pwrfgs_core::{
    Checked, CloudStats, Dataset, Error, ExtraColumn, GaussianCloud, InitializerInput, Misfit, Partition, Parts, Phase,
    Progress, Real, Result, check_compatible, rng, rng::Rng,
};
use pwrfgs_model::Stages;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

impl<'a> Trainer<'a> {
    /// Creates a trainer with initial Gaussians and weights, before step 1.
    ///
    /// # Errors
    /// Plan and data do not fit together, the training set is empty, this program cannot run a pruner, or the initialiser
    /// lacks an input.
    pub fn new(plan: &TrainingPlan, data: &'a Dataset, partition: &Partition) -> Result<Self> {
        Self::begin(plan, data, partition, &|_, _| {}, &AtomicBool::new(false))
    }

    /// Creates a trainer as [`Self::new`]. The initialiser may search for a long time: it reports to `progress`, and `stop`
    /// ends it.
    ///
    /// # Errors
    /// As [`Self::new`]; [`Error::Stopped`] once `stop` is set.
    pub fn begin(
        plan: &TrainingPlan,
        data: &'a Dataset,
        partition: &Partition,
        progress: Progress<'_>,
        stop: &AtomicBool,
    ) -> Result<Self> {
        let search = |input: &InitializerInput<'_>, random: &mut Rng| plan.initializer.search(input, random);
        Self::blank(plan, data, partition)?.initialised_by(search, progress, stop)
    }

    /// Creates a trainer whose initial Gaussians depend on the scene only, without a search: the model has the size of the
    /// real one, for estimates of cost.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn sketch(plan: &TrainingPlan, data: &'a Dataset, partition: &Partition) -> Result<Self> {
        let initialize = |input: &InitializerInput<'_>, random: &mut Rng| {
            plan.initializer.initialize(&data.scene, input.plane, random)
        };
        Self::blank(plan, data, partition)?.initialised_by(initialize, &|_, _| {}, &AtomicBool::new(false))
    }

    /// Sets the parameters of a blank trainer: the Gaussians that `create_cloud` returns, if the method has Gaussians,
    /// and the weights. Errors are those of the initialiser and of [`Self::set_initial`].
    fn initialised_by(
        mut self,
        create_cloud: impl FnOnce(&InitializerInput<'_>, &mut Rng) -> Result<GaussianCloud>,
        progress: Progress<'_>,
        stop: &AtomicBool,
    ) -> Result<Self> {
        let (train, method) = (self.batches.train(), &*self.stages.method);
        let input = InitializerInput { data: self.data, train, plane: &self.plane, method, progress, stop };
        let cloud = if method.traits().has_gaussians() {
            create_cloud(&input, &mut rng::stream(self.plan.seed, "init", 0))?
        } else {
            GaussianCloud::zeros(0)
        };
        let weights = self.plan.initializer.weights(&input)?;
        self.set_initial(cloud, weights)?;
        Ok(self)
    }

    /// Checks the plan against the data, and creates the trainer without parameters.
    ///
    /// # Errors
    /// Plan and data do not fit together, the training set is empty, or this program cannot run a pruner.
    pub(crate) fn blank(plan: &TrainingPlan, data: &'a Dataset, partition: &Partition) -> Result<Self> {
        let mut plan = plan.clone();
        check_available(&plan.pruners)?;
        let whole = Stages::of(plan.method.clone(), data)?;
        if partition.train.is_empty() {
            return Err(Error::Config("the training set is empty; use another split".into()));
        }
        let batches = Batches::new(data, partition.train.clone());
        let batch = plan.training.batch.min(batches.transmitter_count());
        plan.training = Checked::new(Training { batch, ..Training::clone(&plan.training) }).map_err(Error::Config)?;
        let (parts, demands) = (plan.parts(None), &[plan.initializer.demand()]);
        let parts = Parts { setup: Some(&whole.setup), data: Some(data), demands, ..parts };
        check_compatible(&parts).map_err(Misfit::error)?;
        whole.check().map_err(Error::Config)?;
        let (plane, mut stages) = (whole.plane.clone(), whole);
        stages.setup.plane = plane_of_step(&plane, &plan, data.task(), 1);
        let groups = stages.layout().groups();
        let cloud = GaussianCloud::zeros(0);
        Ok(Self {
            adam: Adam::new(&cloud, &[]),
            stats: CloudStats::zeros(0),
            gaussian_ids: GaussianIds::default(),
            data,
            objective: create_objective(&plan.training, data, &partition.train),
            batches,
            stages: Arc::new(stages),
            plane,
            specs: requested_columns(&plan),
            goal: plan.goal(),
            plan,
            cloud,
            weights: Arc::default(),
            groups,
            masks: None,
            device: pwrfgs_core::device::name().map(str::to_owned),
            before_reset: None,
            done: 0,
            fingerprint: OnceLock::new(),
            training_positions: OnceLock::new(),
        })
    }

    /// Replaces the Gaussians; means are metres from [`Self::origin`]. Extra columns may be absent: with the same number of
    /// Gaussians, they keep their values, otherwise they start anew. Moments, statistics and IDs also start anew if the
    /// number differs.
    ///
    /// # Errors
    /// [`Error::Config`] without Gaussians, for a number that is not finite, for an unknown column or another width, and
    /// before fine-tuning for fewer Gaussians than an exact target.
    pub fn set_cloud(&mut self, mut cloud: GaussianCloud) -> Result<()> {
        self.check_cloud(&cloud).map_err(|why| Error::Config(format!("cloud: {why}")))?;
        let (n, is_same) = (cloud.len(), cloud.len() == self.cloud.len());
        if self.phase(self.done + 1) != Phase::Finetune {
            check_compatible(&self.plan.parts(Some(n))).map_err(Misfit::error)?;
        }
        let initial = |name: &str| self.specs.iter().find(|spec| spec.name == name).map_or(0.0, |spec| spec.init);
        let completed = |present: &ExtraColumn| match cloud.extra(&present.name) {
            Some(column) => column.clone(),
            None if is_same => present.clone(),
            None => ExtraColumn { values: vec![initial(&present.name); n * present.width], ..present.clone() },
        };
        cloud.extra = self.cloud.extra.iter().map(completed).collect();
        if !is_same {
            self.adam.cloud = Adam::new(&cloud, &[]).cloud;
            self.stats = CloudStats::zeros(n);
            let next = self.gaussian_ids.next;
            self.gaussian_ids = GaussianIds { rows: (next..next + n as u32).collect(), next: next + n as u32 };
        }
        self.cloud = cloud;
        Ok(())
    }

    /// Returns an error unless `cloud` has Gaussians, finite numbers, and no column or width that the present cloud lacks.
    fn check_cloud(&self, cloud: &GaussianCloud) -> Result<(), String> {
        if !self.stages.method.traits().has_gaussians() {
            return Err("the method has no Gaussians; do not set them".into());
        }
        if cloud.is_empty() {
            return Err("0 Gaussians; give at least one".into());
        }
        if let Some((name, ..)) = cloud.columns().find(|(_, _, values)| !values.iter().all(|v| v.is_finite())) {
            return Err(format!("column `{name}` has a number that is not finite; give finite numbers"));
        }
        let fault = |ExtraColumn { name, width, .. }: &ExtraColumn| match self.cloud.extra(name) {
            None => Some(format!("unknown column `{name}`; leave it out")),
            Some(present) if present.width != *width => {
                Some(format!("column `{name}` has width {width}, expected {}", present.width))
            }
            Some(_) => None,
        };
        cloud.extra.iter().find_map(fault).map_or(Ok(()), Err)
    }

    /// Sets the initial Gaussians, and `trained` weights or else those that the method draws and initialises.
    ///
    /// # Errors
    /// [`Error::Config`] without Gaussians, for a number of them that does not fit the plan, for a column of another width,
    /// or for another number of weights.
    fn set_initial(&mut self, mut cloud: GaussianCloud, trained: Option<Vec<Real>>) -> Result<()> {
        if cloud.is_empty() && self.stages.method.traits().has_gaussians() {
            return Err(Error::Config("the initializer created no Gaussian; raise its count, or use Random()".into()));
        }
        check_compatible(&self.plan.parts(Some(cloud.len()))).map_err(Misfit::error)?;
        let Stages { method, setup } = &*self.stages;
        cloud.add_missing_columns(&method.traits().columns).map_err(Error::Config)?;
        for spec in &self.specs {
            let values = vec![spec.init; cloud.len() * spec.width];
            cloud.extra.push(ExtraColumn { name: spec.name.into(), width: spec.width, values });
        }
        let mut weights = self.stages.layout().init(&mut rng::stream(self.plan.seed, "network", 0));
        match trained {
            Some(trained) if trained.len() == weights.len() => weights = trained,
            Some(trained) => {
                let (has, wants) = (trained.len(), weights.len());
                return Err(Error::Config(format!("initializer: {has} weights, expected {wants}")));
            }
            None => method.start(setup, self.data, self.batches.train(), &mut cloud, &mut weights),
        }
        self.adam = Adam::new(&cloud, &weights);
        self.stats = CloudStats::zeros(cloud.len());
        self.gaussian_ids = GaussianIds::first(cloud.len());
        (self.cloud, self.weights) = (cloud, Arc::new(weights));
        Ok(())
    }
}
