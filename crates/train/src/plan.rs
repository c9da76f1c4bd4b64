//! `TrainingPlan`: all inputs of a training except the data, and checks of their combination with the data.

use crate::settings::{Rays, Training};
use pwrfgs_core::plugin::{Checked, Plugin, name_of, to_ron};
use pwrfgs_core::{
    Budget, ColumnSpec, Dataset, Error, GaussianCloud, Initializer, Method, MethodTraits, Phase, Pruner, Result,
    Statistic, StepContext,
};
use pwrfgs_model::Stages;

/// All inputs of a training except the data. `pwrfgs_pipeline::Pipeline::plan` creates it from a pipeline.
#[derive(Clone, Debug)]
pub struct TrainingPlan {
    /// Name of the training in messages.
    pub name: String,
    /// Seed of all random streams.
    pub seed: u64,
    /// Method that maps Gaussians and weights to observations.
    pub method: Plugin<dyn Method>,
    /// Initialiser of the Gaussians.
    pub initializer: Plugin<dyn Initializer>,
    /// Pruners; a Gaussian is kept if all of them keep it.
    pub pruners: Vec<Plugin<dyn Pruner>>,
    /// Training settings of algorithm 1.
    pub training: Checked<Training>,
}

impl TrainingPlan {
    /// Checks the combination of pruners with each other, with the method and with the initial number of Gaussians.
    ///
    /// # Errors
    /// The message describes the conflict.
    pub fn check(&self) -> Result<(), String> {
        if let Some(why) = given_twice(&self.pruners).or_else(|| target_fault(self)) {
            return Err(why);
        }
        let (goal, training) = (PruneTarget::of(self), &self.training);
        let name = |k: usize| name_of(&self.pruners[k]);
        if let Some(goal) = goal.filter(|goal| goal.is_exact() && training.prune_until <= training.densify_until) {
            return Err(format!(
                "`{}` has a target of {} Gaussians, but there is no pruning phase; set training.prune_until above densify_until",
                name(goal.pruner),
                goal.target
            ));
        }
        if let Some(why) = self.initializer.count().and_then(|n| too_many(self, n)) {
            return Err(why);
        }
        let MethodTraits { task, blends, .. } = self.method.traits();
        let target = goal.map(|goal| goal.target);
        let moment = StepContext { round: 1, passed: 1, rounds: 1, target, ..StepContext::new(1, Phase::Prune, 0) };
        for (k, (pruner, context)) in self.pruners.iter().zip(contexts(&self.pruners, &moment)).enumerate() {
            let needs = pruner.needs(&GaussianCloud::zeros(0), &context);
            if !blends && needs.statistics.iter().any(|statistic| statistic.requires_blending()) {
                return Err(format!(
                    "`{}` needs blending weights, but this method does not blend; use {}a pruner without them, such as \
                     LearnableMask()",
                    name(k),
                    if task.is_some_and(|task| task.is_complex) { "" } else { "rasterizer: AlphaBlending(), or " }
                ));
            }
            let wants_pictures = |s: &Statistic| matches!(s, Statistic::Error { .. } | Statistic::Top { .. });
            if task.is_some_and(|task| !task.has_pixels) && needs.statistics.iter().any(wants_pictures) {
                return Err(format!("`{}` needs errors of pixels, but these data have no pixels; remove it", name(k)));
            }
        }
        Ok(())
    }
}

/// `training.target_count` and the pruner that must reach it: the first that supports a target.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PruneTarget {
    /// Index of the pruner in the list.
    pub(crate) pruner: usize,
    /// Way in which the pruner reaches the target.
    pub(crate) budget: Budget,
    /// Number of Gaussians at the end of pruning.
    pub(crate) target: usize,
}

impl PruneTarget {
    /// Returns the goal of a training; `None` without a target, or without a pruner that supports one.
    pub(crate) fn of(plan: &TrainingPlan) -> Option<Self> {
        let target = plan.training.target_count;
        let mut budgets = plan.pruners.iter().enumerate().filter_map(|(k, pruner)| Some((k, pruner.traits().budget?)));
        let (pruner, budget) = budgets.next().filter(|_| target > 0)?;
        Some(Self { pruner, budget, target })
    }

    /// Returns whether the target is exact rather than an upper limit.
    pub(crate) fn is_exact(&self) -> bool {
        self.budget != Budget::UpperBound
    }
}

/// Returns `context` for each pruner: only the first that supports a target receives it.
pub(crate) fn contexts(pruners: &[Plugin<dyn Pruner>], context: &StepContext) -> Vec<StepContext> {
    let first = pruners.iter().position(|pruner| pruner.traits().budget.is_some());
    let of = |k: usize| StepContext { target: context.target.filter(|_| first == Some(k)), ..*context };
    (0..pruners.len()).map(of).collect()
}

/// Rejects pruners that this program cannot run.
///
/// # Errors
/// [`Error::Config`] with the next step.
pub fn check_available(pruners: &[Plugin<dyn Pruner>]) -> Result<()> {
    let why = pruners.iter().find_map(|pruner| pruner.traits().unavailable);
    why.map_or(Ok(()), |why| Err(Error::Config(why)))
}

/// Returns the error for a pruner with a column that is listed twice: the settings of the second would have no effect,
/// and both would penalise one column. Different pruners may share a column.
fn given_twice(pruners: &[Plugin<dyn Pruner>]) -> Option<String> {
    // Pruners written in Python share one name and differ in their class.
    let kind = |pruner: &Plugin<dyn Pruner>| match name_of(pruner) {
        python if python == "Python" => to_ron(pruner),
        name => name,
    };
    let twice = pruners.iter().enumerate().find(|(k, pruner)| {
        !pruner.traits().columns.is_empty() && pruners[..*k].iter().any(|other| kind(other) == kind(pruner))
    });
    twice.map(|(_, pruner)| format!("`{}` is listed twice; list it once", name_of(pruner)))
}

/// Returns the error in `training.target_count` and its pruners.
pub(crate) fn target_fault(plan: &TrainingPlan) -> Option<String> {
    let (goal, target) = (PruneTarget::of(plan), plan.training.target_count);
    if target > 0 && goal.is_none() {
        return Some(format!(
            "training.target_count is {target}, but no pruner supports a target; add one that does, such as \
             SignalContribution()"
        ));
    }
    let is_idle = |(k, pruner): &(usize, &Plugin<dyn Pruner>)| {
        pruner.traits().requires_target && goal.is_none_or(|goal| goal.pruner != *k)
    };
    let (_, idle) = plan.pruners.iter().enumerate().find(is_idle)?;
    let idle = name_of(idle);
    Some(match goal {
        None => {
            format!("`{idle}` needs training.target_count, which is not set; set it, for example to 157")
        }
        Some(goal) => {
            let first = name_of(&plan.pruners[goal.pruner]);
            format!(
                "training.target_count applies to `{first}`, so `{idle}` removes none; list `{idle}` first, or remove it"
            )
        }
    })
}

/// Returns the columns that the pruners request, each once; none without a pruning phase.
pub(crate) fn specs_of(plan: &TrainingPlan) -> Vec<ColumnSpec> {
    let mut specs: Vec<ColumnSpec> = Vec::new();
    if plan.training.prune_until > 0 {
        for spec in plan.pruners.iter().flat_map(|pruner| pruner.traits().columns) {
            if specs.iter().all(|s| s.name != spec.name) {
                specs.push(spec);
            }
        }
    }
    specs
}

/// Returns whether densification or the pruner with the target may add Gaussians up to at least `n`.
fn grows(plan: &TrainingPlan, n: usize) -> bool {
    let densify = &plan.training.densify;
    let room = densify.max_gaussians == 0 || densify.max_gaussians >= n;
    (densify.every > 0 && densify.from < plan.training.densify_until && room)
        || PruneTarget::of(plan).is_some_and(|goal| plan.pruners[goal.pruner].traits().grows)
}

/// Returns a target that removes none of the `n` initial Gaussians, if none are added.
pub(crate) fn idle_target(plan: &TrainingPlan, n: usize) -> Option<usize> {
    let target = PruneTarget::of(plan)?.target;
    (target >= n && !grows(plan, n + 1)).then_some(target)
}

/// Returns the error for an exact target above the `n` initial Gaussians, if none are added.
pub(crate) fn too_many(plan: &TrainingPlan, n: usize) -> Option<String> {
    let target = PruneTarget::of(plan).filter(PruneTarget::is_exact)?.target;
    (target > n && !grows(plan, target)).then(|| {
        format!(
            "training.target_count is {target}, but training starts with {n} Gaussians; lower training.target_count or raise the \
             initial count"
        )
    })
}

/// Rejects rays for data without pixels, and too many rays per step.
pub(crate) fn check_rays(rays: Rays, stages: &Stages) -> Result<()> {
    let (count, most) = match rays {
        Rays::All => return Ok(()),
        Rays::Same(count) => (count, stages.setup.numbers()),
        Rays::Each(count) => (count, MOST_PAIRS),
    };
    if !stages.setup.task.has_pixels {
        let observations = stages.setup.task.plural;
        return Err(Error::Config(format!(
            "training.rays selects pixels of spectra, but the data are {observations}; remove it"
        )));
    }
    if count > most {
        return Err(Error::Config(format!("training.rays is {count}; give at most {most}")));
    }
    Ok(())
}

/// Maximum number of pairs of spectrum and pixel per step.
const MOST_PAIRS: usize = 1 << 22;

/// Rejects data whose transmitter inputs do not match the method.
pub(crate) fn check_inputs(stages: &Stages, data: &Dataset) -> Result<()> {
    let without_deformation = stages.deformation().is_none();
    let (wants, has) = (stages.method.traits().inputs, data.features.as_ref().map_or(3, |features| features.width));
    if data.features.is_none() && !data.placed {
        return Err(Error::Config("the data have neither positions nor features of the transmitters".into()));
    }
    if has == 3 && data.features.is_some() {
        return Err(Error::Config(
            "3 features are ambiguous with a 3D position; provide a different number of features, or positions".into(),
        ));
    }
    if wants == has {
        return Ok(());
    }
    let inputs = |n: usize, features: bool| if features { format!("{n} features") } else { "a position".to_owned() };
    Err(Error::Config(format!(
        "the method needs {} per transmitter, but the data have {}; {}",
        inputs(wants, wants != 3),
        inputs(has, data.features.is_some()),
        match (without_deformation, data.features.is_some()) {
            (true, true) => format!("set it in the method, such as Nerf2(features: {has})"),
            (true, false) => "remove `features` of the method".into(),
            (false, true) => format!("use deformation: Factored(tx_encoding: Features(width: {has}))"),
            (false, false) => "remove `Features`".into(),
        }
    )))
}
