//! Warnings before the first step about settings without effect or with too little data, and a report of large removals.

use crate::densify::{self, SIZE_RULE, SPLIT_SHRINK, largest_scale};
use crate::settings::Densify;
use crate::trainer::Trainer;
use pwrfgs_core::plugin::title_of;
use pwrfgs_core::{AdamUpdate, Error, ImagePlane, Real, Result};

impl Trainer<'_> {
    /// Returns warnings about the initial Gaussians: a target that removes none, masks that cannot close, sizes above the limit
    /// of densification, and too few trained pixels.
    pub fn warnings(&self) -> Vec<String> {
        let masks = (0..self.plan.pruners.len()).filter_map(|k| self.slow_mask_warning(k));
        let others = [self.oversized_warning(), self.skipped_pixels_warning()];
        self.idle_target_warning().into_iter().chain(masks).chain(others.into_iter().flatten()).collect()
    }

    /// Returns what each pruner states about the number of Gaussians that it keeps of the initial ones; nothing if a target
    /// decides.
    pub fn outlook(&self) -> Vec<String> {
        let free = self.plan.pruners.iter().filter(|_| self.goal.is_none());
        free.filter_map(|pruner| pruner.outlook(self.cloud.len())).collect()
    }

    /// Returns a warning about a target that is met from the start; `None` if it is not.
    fn idle_target_warning(&self) -> Option<String> {
        let n = self.cloud.len();
        let target = self.plan.idle_target(n)?;
        Some(format!(
            "pruners: training.target_count is {target}, but training starts with {n} Gaussians, so pruning removes none; \
             lower training.target_count or raise the initial count"
        ))
    }

    /// Returns a warning about more Gaussians than trained pixels: no loss determines the pixels between fixed rows and
    /// columns. `None` if there are enough pixels, if all are trained or take turns, and for methods without blending, in which
    /// each Gaussian changes all pixels.
    fn skipped_pixels_warning(&self) -> Option<String> {
        let (training, traits) = (&self.plan.training, self.stages.method.traits());
        let pixels = |plane: &ImagePlane| plane.width * plane.height;
        let (trained, whole) = (pixels(&self.stages.setup.plane), pixels(&self.plane));
        let n = self.goal.map_or(self.cloud.len(), |goal| goal.target.min(self.cloud.len()));
        (trained < whole && !training.moving_stride && traits.blends && n > trained).then(|| {
            format!(
                "training.moving_stride: {n} Gaussians train on {trained} of {whole} pixels, which leaves the other pixels \
                 undetermined; set training.moving_stride: true"
            )
        })
    }

    /// Returns a warning about a mask of pruner `k` that cannot fall from its initial value to its threshold before
    /// pruning ends; `None` if it can, if the time is unknown, or if a target decides.
    fn slow_mask_warning(&self, k: usize) -> Option<String> {
        let (training, pruner) = (&self.plan.training, &self.plan.pruners[k]);
        let (needed, until) = (pruner.steps_to_close(AdamUpdate::BETAS)?, training.prune_until);
        (needed > until && self.goal.is_none_or(|goal| goal.pruner != k)).then(|| {
            format!(
                "pruners: a mask of `{}` needs about {needed} steps to close and pruning ends after step {until}, so it \
                 removes none; raise its `learning_rate`, or training.prune_until",
                title_of(pruner)
            )
        })
    }

    /// Returns a warning that the first size check of densification removes most Gaussians unless splits shrink them
    /// before; `None` if at most half are too large, or no size is checked.
    fn oversized_warning(&self) -> Option<String> {
        let (training, settings) = (&self.plan.training, &self.plan.training.densify);
        let step = first_size_step(settings).filter(|step| *step <= training.densify_until)?;
        if !self.stages.method.traits().blends {
            return None; // sources of waves have no size
        }
        let (n, limit) = (self.cloud.len(), settings.large_above * densify::extent(settings, self.data.scene.bounds));
        let sizes = (0..n).map(|i| largest_scale(&self.cloud, i) / limit).filter(|ratio| *ratio > 1.0);
        let (large, descendants) =
            sizes.fold((0, 0.0), |(large, sum), ratio| (large + 1, sum + count_descendants(ratio)));
        if 2 * large <= n {
            return None;
        }
        let most = settings.max_gaussians;
        let advice = if most > 0 && ((most - most.min(n - large)) as Real) < descendants {
            format!(
                "`max_gaussians` ({most}) stops the splits that would shrink them; raise `extent_m` or `max_gaussians`"
            )
        } else {
            // Three quarters shrank on s23, with 2,000 random Gaussians as dense as 200,000 at a spread of 20 m.
            let events = (step - 1).saturating_sub(settings.from) / settings.every.max(1);
            let shrunk = (3 * large / 4).min(SPLITS_PER_EVENT * events as usize);
            format!("about {shrunk} usually shrink in time; start with smaller Gaussians, or raise `extent_m`")
        };
        Some(format!(
            "training.densify: {large} of {n} Gaussians start larger than `large_above` ({limit:.2} m, {} of the extent) \
             and are removed at step {step} unless splits shrink them; {advice}, or set `large_above` to 0",
            settings.large_above
        ))
    }

    /// Returns a sentence if the learned masks have closed less than a tenth of the Gaussians; `None` without masks,
    /// before the first prune step, and if a target decides their number.
    pub fn idle_masks_warning(&self) -> Option<String> {
        let is_free = |k: &usize| self.goal.is_none_or(|goal| goal.pruner != *k);
        let is_mask = |k: &usize| self.plan.pruners[*k].traits().mask_rate().is_some();
        let pruner = &self.plan.pruners[(0..self.plan.pruners.len()).find(|k| is_mask(k) && is_free(k))?];
        let (closed, before) = self.masks.filter(|(closed, before)| 10 * closed < *before)?;
        Some(format!(
            "masks closed {closed} of {before} Gaussians, less than a tenth; raise λ, the penalty weight of \
             `{}`, or training.prune_until",
            title_of(pruner)
        ))
    }

    /// Returns a sentence if learned masks without a target have closed all Gaussians but one; otherwise `None`.
    pub fn lone_gaussian_warning(&self) -> Option<String> {
        let (_, before) =
            self.masks.filter(|_| self.cloud.len() == 1 && self.goal.is_none() && !self.is_one_requested())?;
        let rate = self.plan.pruners.iter().find_map(|pruner| pruner.traits().mask_rate()).unwrap_or_default();
        (before > 1).then(|| {
            format!(
                "masks closed all but one of {before} Gaussians: λ decides a share of the start, which also falls with the \
                 learning rate of the masks ({rate}); lower `lambda`, start with more Gaussians, or use a larger --scale"
            )
        })
    }

    /// Ends the training if the rules of densification removed nearly all of the `before` Gaussians: no later step makes
    /// up for them.
    ///
    /// # Errors
    /// More than 95 % are gone, or all but one, and the pipeline does not request a single Gaussian.
    pub(crate) fn refuse_collapse(&self, step: u64, before: usize, rules: &[(String, usize)]) -> Result<()> {
        let left = self.cloud.len();
        if self.is_one_requested() || !is_collapse(left, before) {
            return Ok(());
        }
        let is_size = rules.iter().max_by_key(|(_, count)| *count).is_some_and(|(name, _)| name.contains(SIZE_RULE));
        let advice = if is_size {
            "raise training.densify.extent_m, so that the limit fits the Gaussians, or raise training.densify.max_gaussians, \
             so that splits can shrink them"
        } else {
            "lower training.densify.opacity_floor, or raise training.densify.reset_opacity"
        };
        Err(Error::Collapsed { step, left, removed: format_removals(rules), advice })
    }

    /// Logs the rules that removed more than half of the Gaussians. `counts` are the number before the removal, and the
    /// number of closed masks among them.
    ///
    /// # Errors
    /// Only one Gaussian is left, although neither the pipeline nor the masks alone request this.
    pub(crate) fn report_removal(&self, step: u64, counts: (usize, usize), rules: &[(String, usize)]) -> Result<()> {
        let ((before, closed), left) = (counts, self.cloud.len());
        let is_by_masks = closed > 0 && before - closed <= 1;
        if left == 1 && before > 1 && !is_by_masks && !self.is_one_requested() {
            let takes_target = self.plan.pruners.iter().any(|pruner| pruner.traits().budget.is_some());
            let advice = if takes_target {
                "relax that rule, or request one Gaussian with training.target_count: 1"
            } else {
                "relax that rule, or start with one Gaussian"
            };
            return Err(Error::Collapsed { step, left, removed: format_removals(rules), advice });
        }
        if 2 * left < before {
            let (name, removed) = (&self.plan.name, before - left);
            let rules = format_counts(rules);
            let message = format!("{name}: step {step} removed {removed} of {before} Gaussians ({rules})");
            if self.is_exact() && step > self.plan.training.densify_until {
                tracing::info!("{message}"); // as requested
            } else {
                tracing::warn!("{message}");
            }
        }
        Ok(())
    }

    /// Returns whether the pipeline requests a single Gaussian.
    fn is_one_requested(&self) -> bool {
        self.plan.training.target_count == 1 || self.plan.initializer.count() == Some(1)
    }
}

/// Splits per densification on s23, from 2,000 to 5,000 Gaussians (`docs/lab/paper.md`).
const SPLITS_PER_EVENT: usize = 1_000;

/// Returns whether a step leaves less than a twentieth of `before` Gaussians, or one of several.
fn is_collapse(left: usize, before: usize) -> bool {
    20 * left < before || (left == 1 && before > 1)
}

/// Returns the number of Gaussians into which splits divide one of `ratio` times the limit until none is above it.
fn count_descendants(ratio: Real) -> Real {
    (2.0 as Real).powf((ratio.ln() / SPLIT_SHRINK.ln()).ceil())
}

/// Lists the rules that removed Gaussians, with their numbers.
fn format_counts(rules: &[(String, usize)]) -> String {
    let rule = |(name, count): &(String, usize)| format!("{name}: {count}");
    rules.iter().filter(|(_, count)| *count > 0).map(rule).collect::<Vec<_>>().join("; ")
}

/// Returns the text `, removed by` with these counts; empty if no rule removed any.
fn format_removals(rules: &[(String, usize)]) -> String {
    let counts = format_counts(rules);
    if counts.is_empty() { counts } else { format!(", removed by {counts}") }
}

/// Returns the first step at which densification checks sizes; `None` if it never does.
fn first_size_step(settings: &Densify) -> Option<u64> {
    let after = settings.from.max(settings.large_after);
    let step = settings.every.checked_mul(after.checked_div(settings.every)?.checked_add(1)?)?;
    (settings.large_above > 0.0 && densify::is_due(settings, step)).then_some(step)
}

#[cfg(test)]
mod tests {
    use super::{Densify, count_descendants, first_size_step, is_collapse};

    #[test]
    fn collapse_leaves_less_than_a_twentieth() {
        let cases =
            [(6, 3_000, true), (149, 3_000, true), (150, 3_000, false), (1, 2, true), (2, 4, false), (1, 1, false)];
        for (left, before, expected) in cases {
            assert_eq!(is_collapse(left, before), expected, "{left} of {before}");
        }
    }

    #[test]
    fn sizes_are_first_checked_after_the_set_step() {
        let first = |large_after| first_size_step(&Densify { large_after, ..Densify::default() });
        assert_eq!([3_000, 3_050, u64::MAX].map(first), [Some(3_100), Some(3_100), None]);
    }

    #[test]
    fn splits_halve_by_1_6() {
        assert_eq!([1.5, 1.7, 2.5, 2.6].map(count_descendants), [2.0, 4.0, 4.0, 8.0]);
    }
}
