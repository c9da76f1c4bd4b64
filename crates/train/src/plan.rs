//! `TrainingPlan`: what a training follows from besides the data, and whether its parts and the data go together.

use crate::settings::{Rays, Training};
use pwrfgs_core::plugin::{Checked, Plugin, name_of, to_ron};
use pwrfgs_core::{
    Budget, ColumnSpec, Dataset, Error, GaussianCloud, Initializer, Method, MethodTraits, Moment, Phase, Pruner,
    Result, Statistic,
};
use pwrfgs_model::Stages;

/// What a training follows from, besides the data. `pwrfgs_pipeline::Pipeline::plan` makes it of a pipeline.
#[derive(Clone, Debug)]
pub struct TrainingPlan {
    /// Name of the training in messages.
    pub name: String,
    /// Seed of all random streams.
    pub seed: u64,
    /// From Gaussians and weights to observations.
    pub method: Plugin<dyn Method>,
    /// Where the Gaussians start.
    pub initializer: Plugin<dyn Initializer>,
    /// Who decides which Gaussians stay; all must agree.
    pub pruners: Vec<Plugin<dyn Pruner>>,
    /// Algorithm 1.
    pub training: Checked<Training>,
}

impl TrainingPlan {
    /// Checks whether the pruners go together, with the method and with the number of Gaussians at the start.
    ///
    /// # Errors
    /// What is wrong with the list of pruners.
    pub fn check(&self) -> Result<(), String> {
        contradiction(self).map_or(Ok(()), Err)
    }
}

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

/// The columns that the pruners ask for, each once; none where there is no phase in which they count.
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

/// Refuses rays where there are no pixels to choose, and more than a step can be meant to have.
pub(crate) fn check_rays(rays: Rays, stages: &Stages) -> Result<()> {
    let most = match rays {
        Rays::All => return Ok(()),
        Rays::Same(_) => stages.frame.numbers(),
        Rays::Each(_) => MOST_PAIRS,
    };
    if !stages.frame.task.has_pixels {
        let what = stages.frame.task.plural;
        return Err(Error::Config(format!(
            "training.rays chooses pixels of spectra, and the data are {what}; leave it out"
        )));
    }
    match rays {
        Rays::Same(count) | Rays::Each(count) if count > most => {
            Err(Error::Config(format!("training.rays has {count}; give at most {most}")))
        }
        _ => Ok(()),
    }
}

/// Pairs of a spectrum and a pixel a step.
const MOST_PAIRS: usize = 1 << 22;

/// Refuses data that describe a transmitter by other numbers than the method wants.
pub(crate) fn check_inputs(stages: &Stages, data: &Dataset) -> Result<()> {
    let own = stages.deformation().is_none();
    let (wants, has) = (stages.method.traits().inputs, data.features.as_ref().map_or(3, |features| features.width));
    if data.features.is_none() && !data.placed {
        return Err(Error::Config("the data have neither positions nor features of the transmitters".into()));
    }
    if has == 3 && data.features.is_some() {
        return Err(Error::Config(
            "3 features look like a position, and are taken for one; give more, or positions".into(),
        ));
    }
    if wants == has {
        return Ok(());
    }
    let what = |n: usize, features: bool| if features { format!("{n} features") } else { "a position".to_owned() };
    Err(Error::Config(format!(
        "the method wants {} of a transmitter, and the data give {}; {}",
        what(wants, wants != 3),
        what(has, data.features.is_some()),
        match (own, data.features.is_some()) {
            (true, true) => format!("give the method that many, such as Nerf2(features: {has})"),
            (true, false) => "leave `features` of the method out".into(),
            (false, true) => format!("give deformation: Factored(tx_encoding: Features(width: {has}))"),
            (false, false) => "leave `Features` out".into(),
        }
    )))
}
