//! Prune steps: passes over training transmitters for statistics, edits, votes, and the exact budget.

use crate::batches::plane_of_pass;
use crate::densify::keep_best_if_none;
use crate::edit::{self, RemovalsByRule};
use crate::graph::{Batch, gate_product};
use crate::loss::Objective;
use crate::trainer::{StepStart, Trainer};
use pwrfgs_core::plugin::{Plugin, title_of};
use pwrfgs_core::{
    Budget, CloudStats, Needs, Parameters, PassStatistics, PruneTarget, Pruner, Real, Result, RowOrigin, Statistic,
    StepContext, best, prune_contexts,
};
use pwrfgs_model::Stages;
use rayon::prelude::*;

/// Pruning phase, with prune steps at the multiples of `every` after `first`, and at `last`.
#[derive(Clone, Copy)]
struct PrunePhase {
    first: u64,
    last: u64,
    every: u64,
}

impl PrunePhase {
    /// Returns the number of prune steps up to `step`.
    fn rounds_until(self, step: u64) -> u64 {
        let Self { first, last, every } = self;
        let whole = |step: u64| step / every.max(1);
        let regular = whole(step.min(last)).saturating_sub(whole(first));
        regular + u64::from(step >= last && last > first && !last.is_multiple_of(every.max(1)))
    }
}

/// Combined votes of all pruners in a prune step.
struct Votes {
    /// Whether each Gaussian is kept: all pruners agree, or the exact target decides.
    keep: Vec<bool>,
    /// Number of Gaussians that each pruner removes.
    rules: RemovalsByRule,
    /// Number of Gaussians whose learned mask has closed.
    closed: usize,
}

/// Returns the number of Gaussians with `false`.
fn count_removed(keep: &[bool]) -> usize {
    keep.iter().filter(|keep| !**keep).count()
}

impl Trainer<'_> {
    /// Returns the context of `step` for the pruners.
    pub(crate) fn context(&self, step: u64) -> StepContext {
        let t = &self.plan.training;
        let pruning = PrunePhase { first: t.densify_until, last: t.prune_until, every: t.prune_every };
        let (phase, rounds) = (self.phase(step), pruning.rounds_until(t.prune_until));
        let passed = pruning.rounds_until(step);
        let round = if passed > pruning.rounds_until(step.saturating_sub(1)) { passed } else { 0 };
        let target = self.goal.map(|goal| goal.target);
        StepContext { round, passed, rounds, target, ..StepContext::new(step, phase, self.plan.seed) }
    }

    /// Runs a prune step: edits and votes of all pruners. Returns Gaussians and IDs before it; `None` if N did not fall.
    ///
    /// # Errors
    /// Too few Gaussians are left, or a spectrum cannot be read for statistics.
    pub(crate) fn prune(&mut self, context: &StepContext) -> Result<Option<StepStart>> {
        let pruners = self.plan.pruners.clone();
        let Some(first) = pruners.first() else { return Ok(None) };
        let (before, n) = (self.step_start(), self.cloud.len());
        let stats = self.apply_edits(&pruners, context)?;
        let Votes { mut keep, rules, closed } = self.collect_votes(&stats, context);
        keep_best_if_none(&mut keep, &first.score(&self.cloud, &stats[0], context), "pruning");
        self.retain_rows(&keep);
        self.count_masks(closed, keep.len());
        self.report_removal(context.step, (keep.len(), closed), &rules)?;
        if let Some(PruneTarget { target, .. }) = self.goal.filter(PruneTarget::is_exact) {
            let left = self.cloud.len();
            if context.round > 0 && context.round == context.rounds && left != target {
                tracing::warn!("pruning ended with {left} Gaussians, expected {target}");
            }
        }
        Ok((self.cloud.len() < n).then_some(before))
    }

    /// Collects from every pruner which Gaussians to keep, given its statistics, and applies an exact target.
    fn collect_votes(&self, stats: &[CloudStats], context: &StepContext) -> Votes {
        let (pruners, cloud, goal) = (&self.plan.pruners, &self.cloud, self.goal);
        let mut rules = RemovalsByRule::new();
        let (mut keep, mut open) = (vec![true; cloud.len()], vec![true; cloud.len()]);
        let with_contexts = pruners.iter().zip(stats).zip(prune_contexts(pruners, context));
        for (k, ((pruner, stats), context)) in with_contexts.enumerate() {
            if goal.is_some_and(|goal| goal.pruner == k && goal.budget == Budget::Gradual) {
                continue;
            }
            let votes = pruner.keep(cloud, stats, &context);
            assert_eq!(votes.len(), keep.len(), "a pruner answers for every Gaussian");
            rules.push((format!("`{}`", title_of(pruner)), count_removed(&votes)));
            if pruner.traits().mask_rate().is_some() {
                open.iter_mut().zip(&votes).for_each(|(open, vote)| *open &= *vote);
            }
            keep.iter_mut().zip(votes).for_each(|(keep, vote)| *keep &= vote);
        }
        let closed = count_removed(&open);
        let Some(goal) = goal.filter(PruneTarget::is_exact) else { return Votes { keep, rules, closed } };
        let count = match goal.budget {
            Budget::Gradual => context.quota(keep.len(), goal.target),
            Budget::FinalStep if context.round == context.rounds => goal.target,
            Budget::FinalStep => (keep.len() - count_removed(&keep)).max(goal.target),
            Budget::PrunerManaged | Budget::UpperBound => keep.len(),
        };
        // Gaussians that a pruner rejects rank after all others.
        let keep = best(count, &pruners[goal.pruner].score(cloud, &stats[goal.pruner], context), |i| keep[i]);
        let rules = vec![(format!("the target of {}", goal.target), count_removed(&keep))];
        Votes { keep, rules, closed }
    }

    /// Lets every pruner edit rows, and returns its statistics of the Gaussians afterwards. Errors are those of
    /// [`Self::survey`].
    fn apply_edits(&mut self, pruners: &[Plugin<dyn Pruner>], context: &StepContext) -> Result<Vec<CloudStats>> {
        let mut computed = vec![None; pruners.len()];
        let contexts = prune_contexts(pruners, context);
        for (k, (pruner, context)) in pruners.iter().zip(&contexts).enumerate() {
            let stats = self.requested_stats(pruner, context)?;
            match pruner.edit(&self.cloud, &stats, context) {
                Some(edit) => {
                    // If only columns change, the statistics remain valid.
                    let keeps_rows = edit.rows.iter().enumerate().all(|(i, row)| *row == RowOrigin::Kept(i))
                        && edit.rows.len() == self.cloud.len();
                    edit::replace(edit, &mut self.per_gaussian());
                    if keeps_rows {
                        computed[k] = Some(stats);
                    } else {
                        computed.fill(None);
                    }
                }
                None => computed[k] = Some(stats),
            }
        }
        let complete = |(stats, (pruner, context)): (Option<CloudStats>, (_, &StepContext))| {
            stats.map_or_else(|| self.requested_stats(pruner, context), Ok)
        };
        computed.into_iter().zip(pruners.iter().zip(&contexts)).map(complete).collect()
    }

    /// Adds the `closed` masks of a prune step to those of the training, and stores the largest number of Gaussians `before`
    /// such a step.
    pub(crate) fn count_masks(&mut self, closed: usize, before: usize) {
        let (sum, most) = self.masks.unwrap_or_default();
        self.masks = Some((sum + closed, most.max(before)));
    }

    /// Keeps the rows with `true` in all state per Gaussian.
    pub(crate) fn retain_rows(&mut self, keep: &[bool]) {
        edit::retain(keep, &mut self.per_gaussian());
    }

    /// Returns the statistics of the Gaussians, including those that the pruner requests at a prune step. Errors are those
    /// of [`Self::survey`].
    fn requested_stats(&self, pruner: &Plugin<dyn Pruner>, context: &StepContext) -> Result<CloudStats> {
        let needs = pruner.needs(&self.cloud, context).resolve_blending(self.stages.method.traits().blends);
        let mut stats = self.stats.clone();
        if !needs.is_empty() && context.round > 0 {
            stats.requested = self.survey(&needs, context)?;
        }
        Ok(stats)
    }

    /// Computes the statistics in `needs` in a pass over training transmitters. Gaussians that cannot be visible, for
    /// example with a closed gate, are skipped: they have zeros, and come first in the order of elimination.
    ///
    /// # Errors
    /// A spectrum cannot be read.
    fn survey(&self, needs: &Needs, context: &StepContext) -> Result<PassStatistics> {
        let gate = gate_product(&self.cloud, &self.plan, context);
        let mut sums = PassStatistics::zeros(needs, self.cloud.len());
        let rows = self.stages.drawable(&self.cloud, gate.as_deref());
        let open = self.cloud.select(&rows);
        let gate: Option<Vec<Real>> = gate.map(|gate| rows.iter().map(|&i| gate[i]).collect());
        let parameters = Parameters { cloud: &open, gate: gate.as_deref(), existence: None, weights: &self.weights };
        let eliminates = needs
            .statistics
            .iter()
            .any(|statistic| matches!(statistic, Statistic::Elimination { most } if self.cloud.len() <= *most));
        let draws = needs.statistics.iter().any(|statistic| statistic.requires_blending());
        let mut surveyed = Vec::new();
        let stages_of = |part: u64| {
            let mut stages = Stages::clone(&self.stages);
            stages.setup.plane = plane_of_pass(&self.plane, &self.plan, self.data.task(), (context.step, part));
            stages
        };
        let transmitters = needs.draw_transmitters(self.batches.transmitter_count(), context.seed, context.step);
        for batch in self.batches.pass_batches(transmitters, self.data, stages_of) {
            let (stages, batch) = batch?;
            if draws {
                let Stages { method, setup } = &stages;
                sums.merge(&rows, &method.survey(&batch.call(setup, parameters), &batch.truths, needs));
            }
            if eliminates {
                surveyed.push((stages, batch));
            }
        }
        if eliminates {
            sums.elimination = self.elimination_order(&parameters, &rows, &surveyed);
        }
        sums.finish_means();
        Ok(sums)
    }

    /// Returns the rank of every Gaussian `[N]` in the order of elimination, from 0; `parameters` are those of the drawn
    /// `rows`. Undrawn Gaussians come first. The next Gaussian is always the one whose removal gives the smallest loss of
    /// `batches`; of equal ones, the last.
    fn elimination_order(&self, parameters: &Parameters<'_>, rows: &[usize], batches: &[(Stages, Batch)]) -> Vec<Real> {
        let n = self.cloud.len();
        let mut ranks = vec![Real::NAN; n];
        let mut drawn = vec![false; n];
        rows.iter().for_each(|&i| drawn[i] = true);
        let mut next = 0;
        let mut rank_next = |i: usize| {
            ranks[i] = next as Real;
            next += 1;
        };
        (0..n).rev().filter(|&i| !drawn[i]).for_each(&mut rank_next);
        let mut remaining: Vec<usize> = (0..rows.len()).collect();
        while remaining.len() > 1 {
            let loss_without = |k: usize| {
                let others: Vec<usize> = remaining.iter().copied().filter(|&i| i != remaining[k]).collect();
                mean_loss(&*self.objective, parameters, &others, batches)
            };
            let count = remaining.len();
            let losses: Vec<Real> = (0..count).into_par_iter().map(loss_without).collect();
            let best = (0..count).rev().min_by(|&a, &b| losses[a].total_cmp(&losses[b])).expect("two or more");
            rank_next(rows[remaining.remove(best)]);
        }
        remaining.into_iter().for_each(|k| rank_next(rows[k]));
        ranks
    }
}

/// Returns the mean loss over the links of `batches`, with only the Gaussians `rows` of the parameters.
fn mean_loss(
    objective: &dyn Objective,
    parameters: &Parameters<'_>,
    rows: &[usize],
    batches: &[(Stages, Batch)],
) -> Real {
    let cloud = parameters.cloud.select(rows);
    let gate: Option<Vec<Real>> = parameters.gate.map(|gate| rows.iter().map(|&i| gate[i]).collect());
    let parameters = Parameters { cloud: &cloud, gate: gate.as_deref(), ..*parameters };
    let loss = |(Stages { method, setup }, batch): &(Stages, Batch)| {
        let size = (setup.plane.width, setup.plane.height);
        let numbers = method.forward(&batch.call(setup, parameters), &None).numbers;
        objective.evaluate(&numbers, &batch.truths, size).0 * batch.inputs.pairs.len() as Real
    };
    let links: usize = batches.iter().map(|(_, batch)| batch.inputs.pairs.len()).sum();
    batches.iter().map(loss).sum::<Real>() / links.max(1) as Real
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prune_steps_are_counted() {
        let phase = |first, last, every| PrunePhase { first, last, every };
        let rounds = |step| phase(100, 1000, 300).rounds_until(step);
        assert_eq!([100, 299, 300, 600, 900, 999, 1000, 2000].map(rounds), [0, 0, 1, 2, 3, 3, 4, 4]);
        assert_eq!(phase(300, 900, 300).rounds_until(900), 2, "the last step of densification is none");
        assert_eq!(phase(50, 50, 10).rounds_until(50), 0, "no phase, no round");
    }
}
