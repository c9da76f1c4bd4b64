//! `Trainer`: the loop of algorithm 1, step by step.

use crate::adam::{Adam, Rates};
use crate::batches::{Batches, plane_of_step};
use crate::densify;
use crate::edit::{self, GaussianIds, PerGaussianState};
use crate::graph::{drawn_mask, gate_product};
use crate::loss::Objective;
use crate::plan::TrainingPlan;
use crate::stepper::Stepper;
use pwrfgs_core::{
    AdamUpdate, CloudStats, ColumnSpec, Dataset, Error, GaussianCloud, ImagePlane, Origin, Phase, Plugin, PruneTarget,
    Pruner, Real, Result, StepContext, WeightGroup, device, prune_contexts, rng,
};
use pwrfgs_model::{Model, Stages, TrainingPositions};
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// Results of one training step.
#[derive(Clone, Debug, PartialEq)]
pub struct StepReport {
    /// Step number, from 1.
    pub step: u64,
    /// Phase of algorithm 1.
    pub phase: Phase,
    /// Loss before the update.
    pub loss: f64,
    /// Sum of the penalties of the pruners before the update.
    pub penalty: f64,
    /// Number of Gaussians N after the step.
    pub gaussians: usize,
    /// Gaussians removed by pruners, if any.
    pub pruned: Option<PruneStepState>,
}

/// Snapshot of a step at which pruners removed Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub struct PruneStepState {
    /// Gaussians before the removal.
    pub cloud: GaussianCloud,
    /// Persistent ID per Gaussian, `[N]`.
    pub gaussian_ids: Vec<u32>,
    /// Gates `[N]` of [`Trainer::gates`] before the removal.
    pub gates: Option<Vec<Real>>,
    /// Number of this prune step, from 1, and number of all prune steps; 0 if masks are removed without a prune step.
    pub round: (u64, u64),
}

/// Gaussians before a removal, and their IDs.
pub(crate) type StepStart = (GaussianCloud, Vec<u32>);

/// Training in progress. The same plan and data give bit-identical results for any number of threads, interrupted or
/// not.
#[derive(Debug)]
pub struct Trainer<'a> {
    pub(crate) plan: TrainingPlan,
    pub(crate) goal: Option<PruneTarget>,
    pub(crate) data: &'a Dataset,
    pub(crate) batches: Batches,
    pub(crate) objective: Box<dyn Objective>,
    /// Stages in use; their image plane is that of the current step, every `stride`-th row and column.
    pub(crate) stages: Arc<Stages>,
    /// Image plane of the whole image.
    pub(crate) plane: ImagePlane,
    pub(crate) specs: Vec<ColumnSpec>,
    pub(crate) cloud: GaussianCloud,
    pub(crate) weights: Arc<Vec<Real>>,
    /// Weights that learn.
    pub(crate) groups: Vec<WeightGroup>,
    pub(crate) adam: Adam,
    pub(crate) stats: CloudStats,
    pub(crate) gaussian_ids: GaussianIds,
    /// Numbers of closed masks and of Gaussians before pruning, from the first prune step on.
    pub(crate) masks: Option<(usize, usize)>,
    pub(crate) done: u64,
    /// Name of the GPU that trains; `None` for the CPU.
    pub(crate) device: Option<String>,
    /// Opacity logits before the reset of the last step, if it had one.
    pub(crate) before_reset: Option<Vec<Real>>,
    /// Fingerprint (see `checkpoint.rs`), computed when the first checkpoint is written or read.
    pub(crate) fingerprint: OnceLock<String>,
    /// Thinned positions of the training set, computed for the first model; `None` if the data have no positions.
    pub(crate) training_positions: OnceLock<Option<TrainingPositions>>,
}

impl Trainer<'_> {
    /// Returns the number of completed steps.
    pub fn done(&self) -> u64 {
        self.done
    }

    /// Checks that the process uses the device that trained so far: another one rounds differently.
    ///
    /// # Errors
    /// [`Error::Config`] with the name of that device.
    pub fn check_device(&self) -> Result<()> {
        if self.device.as_deref() == device::name() {
            return Ok(());
        }
        let trained = self.device.as_deref().unwrap_or("the CPU");
        Err(Error::Config(format!("this run was trained on {trained}; resume there, or start again")))
    }

    /// Returns the number of weights of the method, besides the Gaussians.
    pub fn weight_count(&self) -> usize {
        self.weights.len()
    }

    /// Returns whether all steps are completed.
    pub fn finished(&self) -> bool {
        self.done >= self.plan.training.steps
    }

    /// Returns the current Gaussians.
    pub fn cloud(&self) -> &GaussianCloud {
        &self.cloud
    }

    /// Returns the origin of the positions of the Gaussians, in the user's frame.
    pub fn origin(&self) -> Origin {
        self.stages.origin
    }

    /// Returns the persistent ID per Gaussian, `[N]`. A copy has a new ID.
    pub fn gaussian_ids(&self) -> &[u32] {
        &self.gaussian_ids.rows
    }

    /// Returns the current product `[N]` of the pruners' [whole gates](pwrfgs_core::Gate::Whole), from 0 (closed) to 1;
    /// `None` without such a gate, and in fine-tuning.
    pub fn gates(&self) -> Option<Vec<Real>> {
        self.gates_of(&self.cloud, &self.context(self.done.max(1)))
    }

    /// Returns [`Self::gates`] for a cloud; `None` also after the columns of pruners are dropped.
    fn gates_of(&self, cloud: &GaussianCloud, context: &StepContext) -> Option<Vec<Real>> {
        self.has_pruner_columns(cloud).then(|| gate_product(cloud, &self.plan, context)).flatten()
    }

    /// Borrows all state with a row per Gaussian.
    pub(crate) fn per_gaussian(&mut self) -> PerGaussianState<'_> {
        let Self { cloud, adam, stats, gaussian_ids, .. } = self;
        PerGaussianState { cloud, adam, stats, gaussian_ids }
    }

    /// Copies the Gaussians and their IDs before a removal.
    pub(crate) fn step_start(&self) -> StepStart {
        (self.cloud.clone(), self.gaussian_ids.rows.clone())
    }

    /// Returns the statistics of the Gaussians since the last densification.
    pub fn stats(&self) -> &CloudStats {
        &self.stats
    }

    /// Keeps the Gaussians with `true`, as a prune step does: parameters, moments of Adam and statistics.
    ///
    /// # Errors
    /// [`Error::Config`] if `keep` has another length or would remove all Gaussians.
    pub fn keep(&mut self, keep: &[bool]) -> Result<()> {
        let n = self.cloud.len();
        if keep.len() != n {
            return Err(Error::Config(format!("keep: {} values, expected {n}; give one per Gaussian", keep.len())));
        }
        if !keep.contains(&true) {
            return Err(Error::Config("keep: all Gaussians would be removed; keep at least one".into()));
        }
        self.retain_rows(keep);
        Ok(())
    }

    /// Replaces the loss of the pipeline. Checkpoints do not contain it.
    pub fn set_objective(&mut self, objective: Box<dyn Objective>) {
        self.objective = objective;
    }

    /// Returns the phase of algorithm 1 at `step`.
    pub fn phase(&self, step: u64) -> Phase {
        let t = &self.plan.training;
        if step <= t.densify_until {
            Phase::Densify
        } else if step <= t.prune_until {
            Phase::Prune
        } else {
            Phase::Finetune
        }
    }

    /// Runs one step: batch, gradients, Adam, then densification or pruning if due.
    ///
    /// # Errors
    /// [`Error::NonFinite`] with step and tensor, [`Error::Collapsed`] if a removal leaves too few Gaussians,
    /// [`Error::Device`] of the GPU, [`Error::Read`] of a spectrum. The trainer cannot be used afterwards.
    pub fn step(&mut self) -> Result<StepReport> {
        Ok(self.run_steps(1)?.remove(0))
    }

    /// Runs one step on the calling thread and those of its pool: batch, [`Stepper`], edit. Errors are those of
    /// [`Self::step`].
    pub(crate) fn run_step(&mut self) -> Result<StepReport> {
        let step = self.done + 1;
        self.before_reset = None;
        let context = self.context(step);
        self.set_plane(step);
        let batch = self.batches.draw_batch(step, &self.plan, self.data, &self.stages)?;
        let pruners = self.pruners_of(&context);
        let dropout = self.draw_dropout(step);
        let (loss, penalty) = self.stepper().step(&batch, &pruners, dropout.as_deref(), &context)?;
        let pruned = self.edit(&pruners, &context)?;
        device::check()?;
        self.done = step;
        let (loss, penalty, gaussians) = (loss as f64, penalty as f64, self.cloud.len());
        Ok(StepReport { step, phase: context.phase, loss, penalty, gaussians, pruned })
    }

    /// Returns the pruners that act in a step: none in fine-tuning.
    pub(crate) fn pruners_of(&self, context: &StepContext) -> Vec<Plugin<dyn Pruner>> {
        if context.phase == Phase::Finetune { Vec::new() } else { self.plan.pruners.clone() }
    }

    /// Returns the update of each column of the cloud in a step; `None` for those that are not learned, or have rate 0.
    pub(crate) fn column_updates(&self, step: u64) -> Vec<Option<AdamUpdate>> {
        let rates = Rates { training: &self.plan.training, step };
        self.cloud.columns().map(|(name, ..)| rates.column_update(&self.specs, name)).collect()
    }

    /// Returns the ranges of the learned weights with their updates in a step.
    pub(crate) fn weight_updates(&self, step: u64) -> Vec<(Range<usize>, AdamUpdate)> {
        let rates = Rates { training: &self.plan.training, step };
        self.groups.iter().map(|group| (group.range.clone(), rates.weight_update(group))).collect()
    }

    /// Borrows what [`Stepper`] needs.
    fn stepper(&mut self) -> Stepper<'_> {
        let Self { plan, stages, objective, specs, groups, cloud, weights, adam, stats, .. } = self;
        Stepper {
            training: &plan.training,
            stages,
            objective: &**objective,
            specs,
            groups,
            cloud,
            weights,
            adam,
            stats,
        }
    }

    /// Changes state and number of the Gaussians as pruners and algorithm 1 prescribe. Returns the state before a removal by
    /// pruners, `None` without one, or an error as [`Self::change_cloud`].
    pub(crate) fn edit(
        &mut self,
        pruners: &[Plugin<dyn Pruner>],
        context: &StepContext,
    ) -> Result<Option<PruneStepState>> {
        for (pruner, context) in pruners.iter().zip(prune_contexts(pruners, context)) {
            pruner.update(&mut self.cloud, &self.stats, &context);
        }
        Ok(self.change_cloud(context)?.map(|(cloud, gaussian_ids)| {
            let gates = self.gates_of(&cloud, context);
            PruneStepState { cloud, gaussian_ids, gates, round: (context.round, context.rounds) }
        }))
    }

    /// Sets the image plane of `step`: every `stride`-th row and column.
    pub(crate) fn set_plane(&mut self, step: u64) {
        let plane = plane_of_step(&self.plane, &self.plan, self.data.task(), step);
        if plane != self.stages.plane {
            Arc::make_mut(&mut self.stages).setup.plane = plane;
        }
    }

    /// Returns the current model, without closed Gaussians and masks.
    pub fn model(&self) -> Model {
        self.model_of(self.cloud.clone())
    }

    /// Returns the model to validate: the current one, or if the last step reset opacities, the one before the reset. The
    /// scores after a reset are those of nearly transparent Gaussians.
    pub fn validated_model(&self) -> Model {
        let mut cloud = self.cloud.clone();
        if let Some(logits) = &self.before_reset {
            cloud.opacity_logits.clone_from(logits);
        }
        self.model_of(cloud)
    }

    /// Returns the model with a cloud, of which it drops closed Gaussians and masks.
    fn model_of(&self, mut cloud: GaussianCloud) -> Model {
        let context = self.context(self.done.max(1));
        let drawn = self.has_pruner_columns(&cloud).then(|| drawn_mask(&cloud, &self.plan, &context)).flatten();
        if let Some(drawn) = drawn {
            let rows: Vec<usize> = (0..drawn.len()).filter(|&i| drawn[i]).collect();
            cloud = cloud.select(&rows);
        }
        edit::drop_pruner_columns(&mut cloud, &self.stages.method.traits().columns);
        let mut stages = Stages::clone(&self.stages);
        stages.setup.plane = self.plane.clone();
        let training_positions = self.training_positions.get_or_init(|| self.thinned_positions()).clone();
        Model { stages, cloud, weights: self.weights.to_vec(), training_positions }
    }

    /// Returns the thinned positions of the training set; `None` if the data have no positions.
    fn thinned_positions(&self) -> Option<TrainingPositions> {
        let Dataset { placed, locations, scene, .. } = self.data;
        let trained = self.data.locations_of(self.batches.train()).into_iter();
        let positions: Vec<[Real; 3]> = trained.map(|i| scene.origin.local(locations[i].position())).collect();
        TrainingPositions::thinned(&positions).filter(|_| *placed)
    }

    /// Draws the dropout factors on the weights in this step; `None` without dropout.
    fn draw_dropout(&self, step: u64) -> Option<Vec<Real>> {
        let rate = self.plan.training.dropout;
        let random = &mut rng::stream(self.plan.seed, "dropout", step);
        if rate == 0.0 { None } else { self.stages.layout().draw_dropout(rate, random) }
    }

    /// Returns whether algorithm 1 may change the cloud after a step.
    pub(crate) fn is_change_due(&self, context: &StepContext) -> bool {
        let (settings, step) = (&self.plan.training, context.step);
        let is_densified = densify::is_due(&settings.densify, step) || densify::is_reset_due(&settings.densify, step);
        let is_due = match context.phase {
            Phase::Densify => is_densified,
            Phase::Prune => context.round > 0,
            Phase::Finetune => false,
        };
        is_due || step == settings.prune_until
    }

    /// Densifies, resets opacities, prunes or removes masks as algorithm 1 prescribes. Returns Gaussians and IDs before a
    /// removal by pruners; `None` without one.
    ///
    /// # Errors
    /// Too few Gaussians are left, or a spectrum cannot be read for statistics.
    fn change_cloud(&mut self, context: &StepContext) -> Result<Option<StepStart>> {
        if !self.is_change_due(context) {
            return Ok(None);
        }
        let mut unpruned = None;
        match context.phase {
            // Gaussians of methods that do not draw have no radius and no 2-D gradient, and are not densified.
            Phase::Densify if self.stats.radius.iter().any(|radius| *radius > 0.0) => self.densify(context.step)?,
            Phase::Prune if context.round > 0 => unpruned = self.prune(context)?,
            _ => {}
        }
        if context.step == self.plan.training.prune_until {
            let closed = self.remove_masks(context)?;
            unpruned = unpruned.or(closed);
        }
        Ok(unpruned)
    }

    /// Densifies and resets opacities after `step`, if due; the last step of the phase resets none. Returns an error if too
    /// few Gaussians are left.
    fn densify(&mut self, step: u64) -> Result<()> {
        let training = self.plan.training.clone();
        let settings = &training.densify;
        if densify::is_due(settings, step) {
            let (extent, seed) = (densify::extent(settings, self.data.scene.bounds), self.plan.seed);
            let (before, rules) = densify::densify(settings, extent, (seed, step), &mut self.per_gaussian());
            self.refuse_collapse(step, before, &rules)?;
            self.report_removal(step, (before, 0), &rules)?;
        }
        if densify::is_reset_due(settings, step) && step < training.densify_until {
            self.before_reset = Some(self.cloud.opacity_logits.clone());
            densify::reset_opacities(settings.reset_opacity, &mut self.cloud, &mut self.adam);
        }
        Ok(())
    }

    /// Begins fine-tuning with M = 1 everywhere. Removes closed Gaussians, if no exact target has set N, and the columns of
    /// pruners. Returns Gaussians and IDs before the removal, `None` if no Gaussian is removed, or an error if too few are
    /// left.
    fn remove_masks(&mut self, context: &StepContext) -> Result<Option<StepStart>> {
        let mut unpruned = None;
        if let Some(gates) = self.gates_of(&self.cloud, context).filter(|_| !self.is_exact()) {
            let mut open: Vec<bool> = gates.into_iter().map(|m| m != 0.0).collect();
            densify::keep_best_if_none(&mut open, &self.cloud.opacity_logits, "closing the gates");
            unpruned = open.contains(&false).then(|| self.step_start());
            self.retain_rows(&open);
            let count = open.len() - self.cloud.len();
            self.count_masks(count, open.len());
            self.report_removal(context.step, (open.len(), count), &[("closed gates".into(), count)])?;
        }
        let lasting = self.stages.method.traits().columns;
        edit::drop_pruner_columns(&mut self.cloud, &lasting);
        self.adam.cloud.iter_mut().for_each(|moments| edit::drop_pruner_columns(moments, &lasting));
        Ok(unpruned)
    }

    /// Returns whether pruning ends with an exact number of Gaussians.
    pub(crate) fn is_exact(&self) -> bool {
        self.goal.is_some_and(|goal| goal.is_exact())
    }

    /// Returns whether a cloud has columns of pruners.
    fn has_pruner_columns(&self, cloud: &GaussianCloud) -> bool {
        cloud.extra.len() > self.stages.method.traits().columns.len()
    }
}
