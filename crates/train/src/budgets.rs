//! Whether the pruners of a pipeline can be had together, and what they ask can be told.

use crate::TrainingPlan;
use pwrfgs_core::plugin::{Plugin, name_of, to_ron};
use pwrfgs_core::{Budget, Error, GaussianCloud, MethodTraits, Moment, Phase, Pruner, Result, Statistic};

/// The pruners, and `training.target` given to the first that takes one.
///
/// # Errors
/// Where none does.
pub(crate) fn targeted(plan: &TrainingPlan) -> std::result::Result<Vec<Plugin<dyn Pruner>>, String> {
    let (mut pruners, target) = (plan.pruners.clone(), plan.training.target);
    if target == 0
        || pruners
            .iter()
            .any(|pruner| is_exact(pruner) && pruner.traits().budget.is_some_and(|own| own.target() == target))
    {
        return Ok(pruners);
    }
    let own = pruners.iter_mut().find_map(|pruner| Some((pruner.with_target(target)?, pruner)));
    let Some((asked, pruner)) = own else {
        return Err(format!(
            "training.target is {target}, and no pruner takes an exact number; add one that does, such as \
             SignalContribution()"
        ));
    };
    if let Some(own) = pruner.traits().budget {
        return Err(format!("training.target is {target}, and a pruner's own is {}; give one number", own.target()));
    }
    *pruner = Plugin::from(asked);
    Ok(pruners)
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

/// Whether a pruner comes to an exact number.
pub(crate) fn is_exact(pruner: &Plugin<dyn Pruner>) -> bool {
    pruner.traits().budget.is_some_and(|budget| !matches!(budget, Budget::AtMost(_)))
}

/// What is wrong with the list of pruners.
pub(crate) fn contradiction(plan: &TrainingPlan) -> Option<String> {
    if let Some(why) = given_twice(&plan.pruners) {
        return Some(why);
    }
    let pruners = match targeted(plan) {
        Ok(pruners) => pruners,
        Err(why) => return Some(why),
    };
    let plan = &TrainingPlan { pruners, ..plan.clone() };
    let name = |k: usize| name_of(&plan.pruners[k]);
    let exact: Vec<usize> = (0..plan.pruners.len()).filter(|&k| is_exact(&plan.pruners[k])).collect();
    let mut budgets = plan.pruners.iter().enumerate().filter_map(|(k, p)| Some((k, p.traits().budget?.target())));
    if let Some((first, target)) = budgets.next() {
        if let Some((other, another)) = budgets.find(|(_, another)| *another != target) {
            return Some(format!(
                "`{}` wants {target} Gaussians at the end and `{}` {another}; give one number",
                name(first),
                name(other)
            ));
        }
        if let [first, second, ..] = exact[..] {
            let (first, second) = (name(first), name(second));
            return Some(format!("`{first}` and `{second}` both come to an exact number; give one of them a `target`"));
        }
        let training = &plan.training;
        if training.prune_until <= training.densify_until && !exact.is_empty() {
            return Some(format!(
                "`{}` wants {target} Gaussians, and there is no pruning phase; set training.prune_until above \
                 densify_until",
                name(first)
            ));
        }
    }
    if let Some(what) = plan.initializer.count().and_then(|n| too_many(plan, n)) {
        return Some(what);
    }
    let MethodTraits { task, blends, .. } = plan.method.traits();
    for (k, pruner) in plan.pruners.iter().enumerate() {
        let moment = Moment { round: 1, rounds: 1, ..Moment::new(1, Phase::Prune, 0) };
        let needs = pruner.needs(&GaussianCloud::zeros(0), &moment);
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

/// Whether densification or a pruner may add Gaussians, up to `n` at least.
fn grows(plan: &TrainingPlan, n: usize) -> bool {
    let densify = &plan.training.densify;
    let room = densify.max_gaussians == 0 || densify.max_gaussians >= n;
    (densify.every > 0 && densify.from < plan.training.densify_until && room)
        || plan.pruners.iter().any(|pruner| pruner.traits().grows)
}

/// The target that removes none of the `n` Gaussians at the start, if none are added.
pub(crate) fn idle_target(plan: &TrainingPlan, n: usize) -> Option<usize> {
    let target = plan.pruners.iter().find_map(|pruner| pruner.traits().budget)?.target();
    (target >= n && !grows(plan, n + 1)).then_some(target)
}

/// The exact number that is asked for, where it is above the `n` Gaussians at the start and none are added.
pub(crate) fn too_many(plan: &TrainingPlan, n: usize) -> Option<String> {
    let target = plan.pruners.iter().find(|pruner| is_exact(pruner))?.traits().budget?.target();
    (target > n && !grows(plan, target)).then(|| {
        format!("{target} Gaussians are wanted at the end, and there are {n} at the start; start with more, or ask for fewer")
    })
}
