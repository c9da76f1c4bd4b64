//! Whether the pruners of a pipeline can be had together, and what they ask can be told.

use crate::TrainingPlan;
use pwrfgs_core::plugin::{Plugin, name_of, to_ron};
use pwrfgs_core::{Budget, Error, GaussianCloud, MethodTraits, Moment, Phase, Pruner, Result, Statistic};

/// `training.target`, and the pruner that has to reach it: the first that can.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Goal {
    /// Place of the pruner in the list.
    pub(crate) pruner: usize,
    /// How it reaches the number.
    pub(crate) budget: Budget,
    /// The number of Gaussians at the end of pruning.
    pub(crate) target: usize,
}

impl Goal {
    /// The goal of a training; `None` without a target, or without a pruner that can reach one.
    pub(crate) fn of(plan: &TrainingPlan) -> Option<Self> {
        let target = plan.training.target;
        let mut budgets = plan.pruners.iter().enumerate().filter_map(|(k, pruner)| Some((k, pruner.traits().budget?)));
        let (pruner, budget) = budgets.next().filter(|_| target > 0)?;
        Some(Self { pruner, budget, target })
    }

    /// Whether the number is exact, and not a limit.
    pub(crate) fn is_exact(&self) -> bool {
        self.budget != Budget::AtMost
    }

    /// `moment` for the pruner at place `k`: the one that has to reach the number knows it.
    pub(crate) fn moment(goal: Option<Self>, k: usize, moment: &Moment) -> Moment {
        Moment { target: goal.filter(|goal| goal.pruner == k).map(|goal| goal.target), ..*moment }
    }
}

/// Refuses pruners that this program cannot run.
///
/// # Errors
/// [`Error::Config`] with what to do.
pub fn check_available(pruners: &[Plugin<dyn Pruner>]) -> Result<()> {
    let why = pruners.iter().find_map(|pruner| pruner.traits().unavailable);
    why.map_or(Ok(()), |why| Err(Error::Config(why)))
}

/// A pruner with a column of its own that is given twice: the settings of the second would change nothing, and both would
/// press on one column. Different pruners may share a column.
fn given_twice(pruners: &[Plugin<dyn Pruner>]) -> Option<String> {
    // Strategies written in Python have one name and differ in their class.
    let kind = |pruner: &Plugin<dyn Pruner>| match name_of(pruner) {
        python if python == "Python" => to_ron(pruner),
        name => name,
    };
    let twice = pruners.iter().enumerate().find(|(k, pruner)| {
        !pruner.traits().columns.is_empty() && pruners[..*k].iter().any(|other| kind(other) == kind(pruner))
    });
    twice.map(|(_, pruner)| format!("`{}` is given twice; give it once", name_of(pruner)))
}

/// What is wrong with `training.target` and the pruners that are to reach it.
pub(crate) fn target_fault(plan: &TrainingPlan) -> Option<String> {
    let (goal, target) = (Goal::of(plan), plan.training.target);
    if target > 0 && goal.is_none() {
        return Some(format!(
            "training.target is {target}, and no pruner takes an exact number; add one that does, such as \
             SignalContribution()"
        ));
    }
    // A limit at each prune step does nothing without its number.
    let is_idle = |(k, pruner): &(usize, &Plugin<dyn Pruner>)| {
        pruner.traits().budget == Some(Budget::AtMost) && goal.is_none_or(|goal| goal.pruner != *k)
    };
    let (_, idle) = plan.pruners.iter().enumerate().find(is_idle)?;
    let idle = name_of(idle);
    Some(match goal {
        None => {
            format!("`{idle}` keeps at most training.target Gaussians, and that is not set; set it, such as to 157")
        }
        Some(goal) => {
            let first = name_of(&plan.pruners[goal.pruner]);
            format!("training.target goes to `{first}`, so `{idle}` removes none; put `{idle}` first, or leave it out")
        }
    })
}

/// What is wrong with the list of pruners.
pub(crate) fn contradiction(plan: &TrainingPlan) -> Option<String> {
    if let Some(why) = given_twice(&plan.pruners).or_else(|| target_fault(plan)) {
        return Some(why);
    }
    let (goal, training) = (Goal::of(plan), &plan.training);
    let name = |k: usize| name_of(&plan.pruners[k]);
    if let Some(goal) = goal.filter(|goal| goal.is_exact() && training.prune_until <= training.densify_until) {
        return Some(format!(
            "`{}` is to leave {} Gaussians, and there is no pruning phase; set training.prune_until above densify_until",
            name(goal.pruner),
            goal.target
        ));
    }
    if let Some(what) = plan.initializer.count().and_then(|n| too_many(plan, n)) {
        return Some(what);
    }
    let MethodTraits { task, blends, .. } = plan.method.traits();
    for (k, pruner) in plan.pruners.iter().enumerate() {
        let moment = Moment { round: 1, rounds: 1, ..Moment::new(1, Phase::Prune, 0) };
        let needs = pruner.needs(&GaussianCloud::zeros(0), &Goal::moment(goal, k, &moment));
        if !blends && needs.statistics.iter().any(|statistic| statistic.wants_blending()) {
            return Some(format!(
                "`{}` goes by blending weights, and nothing is blended here; use {}a pruner that needs none, such as \
                 LearnableMask()",
                name(k),
                if task.is_some_and(|task| task.is_complex) { "" } else { "rasterizer: AlphaBlending(), or " }
            ));
        }
        let wants_pictures = |s: &Statistic| matches!(s, Statistic::Error { .. } | Statistic::Top { .. });
        if task.is_some_and(|task| !task.has_pixels) && needs.statistics.iter().any(wants_pictures) {
            return Some(format!(
                "`{}` looks at the errors of pixels, and these data have none; leave it out",
                name(k)
            ));
        }
    }
    None
}

/// Whether densification or the pruner with the target may add Gaussians, up to `n` at least.
fn grows(plan: &TrainingPlan, n: usize) -> bool {
    let densify = &plan.training.densify;
    let room = densify.max_gaussians == 0 || densify.max_gaussians >= n;
    (densify.every > 0 && densify.from < plan.training.densify_until && room)
        || Goal::of(plan).is_some_and(|goal| plan.pruners[goal.pruner].traits().grows)
}

/// The target that removes none of the `n` Gaussians at the start, if none are added.
pub(crate) fn idle_target(plan: &TrainingPlan, n: usize) -> Option<usize> {
    let target = Goal::of(plan)?.target;
    (target >= n && !grows(plan, n + 1)).then_some(target)
}

/// The exact number that is asked for, where it is above the `n` Gaussians at the start and none are added.
pub(crate) fn too_many(plan: &TrainingPlan, n: usize) -> Option<String> {
    let target = Goal::of(plan).filter(Goal::is_exact)?.target;
    (target > n && !grows(plan, target)).then(|| {
        format!(
            "training.target is {target}, but training starts with {n} Gaussians; lower training.target or raise the \
             initial count"
        )
    })
}
