//! Fits the residual processes of a trained model, or of an ensemble.

use crate::load::{ActiveRun, SplitData};
use crate::session::run_stage;
use pwrfgs_core::{Error, Partition, Result, SiteSize, block_of};
use pwrfgs_model::{Ensemble, KnownLinks, Residuals};
use pwrfgs_pipeline::Pipeline;
use std::collections::BTreeMap;

/// Checks that residuals can be fitted to the model of a run of `pipeline`, or to the `joined` model of several runs; passes
/// without residuals.
///
/// # Errors
/// `folds` with a run of one model, or as [`check_data`](pwrfgs_model::Kriged::check_data).
pub(crate) fn check_residuals(pipeline: &Pipeline, split: &SplitData, joined: bool) -> Result<()> {
    let Some(residuals) = &pipeline.residuals else { return Ok(()) };
    let is_folded = is_folded(pipeline);
    if is_folded && !joined && pipeline.members == 1 {
        let advice = "write `Kriged()`, or give the pipeline `members: 4`";
        return Err(Error::Config(format!("residuals: `folds` needs several models; {advice}")));
    }
    residuals.check_data(&split.data, is_folded || !split.partition.validation.is_empty())
}

/// Returns the links that the models of `pipeline` train on, ascending: the training set or, if each model leaves out a part of
/// the known links, all of these.
pub(crate) fn trained_links(pipeline: &Pipeline, partition: &Partition) -> Vec<usize> {
    if is_folded(pipeline) { partition.known().all() } else { partition.train.clone() }
}

/// Returns whether each model of `pipeline` leaves out a part of the known links.
fn is_folded(pipeline: &Pipeline) -> bool {
    pipeline.members > 1 || pipeline.residuals.as_ref().is_some_and(|residuals| residuals.folds)
}

/// Lists the known links that models left out: model k did not train on list k modulo the number of lists. A pipeline with
/// several `members` has one list per part, and a joined sweep of `models` with folds one per model. Otherwise, the only
/// list is the validation set.
///
/// # Errors
/// As [`Pipeline::partition`].
pub(crate) fn left_out_links(pipeline: &Pipeline, split: &SplitData, models: usize) -> Result<Vec<Vec<usize>>> {
    let has_folds = pipeline.residuals.as_ref().is_some_and(|residuals| residuals.folds);
    let parts = if pipeline.members == 1 && has_folds { models } else { pipeline.parts() };
    if parts == 1 {
        return Ok(vec![split.partition.validation.clone()]);
    }
    (0..parts).map(|index| Ok(pipeline.folded(index, parts).partition(&split.data)?.validation)).collect()
}

/// Returns the number of the block of each of `links`, which are ascending: the block of the split, or a cube of space if all
/// blocks of the split are single locations. Links in no block of the split share one number.
fn label_blocks(pipeline: &Pipeline, SplitData { data, .. }: &SplitData, links: &[usize]) -> Vec<usize> {
    let split_blocks = pipeline.split.blocks(data, links);
    let location = |link: usize| data.links[link].location;
    if split_blocks.iter().any(|block| block.iter().any(|link| location(*link) != location(block[0]))) {
        let labels: BTreeMap<usize, usize> =
            split_blocks.iter().enumerate().flat_map(|(k, block)| block.iter().map(move |link| (*link, k))).collect();
        return links.iter().map(|link| labels.get(link).copied().unwrap_or(split_blocks.len())).collect();
    }
    let position = |link: &usize| data.sample(*link).position();
    let edge = SiteSize::new(links.iter().map(position)).block_edge();
    let mut labels = BTreeMap::new();
    let label = |link: &usize| {
        let next = labels.len();
        *labels.entry(block_of(position(link), edge)).or_insert(next)
    };
    links.iter().map(label).collect()
}

impl ActiveRun<'_, '_> {
    /// Fits residual processes of the trained ensemble to all known links, if the pipeline selects them and it has
    /// none. `models` is the number of models that the run or the joined sweep trained.
    ///
    /// # Errors
    /// A model left out a test sample; otherwise as [`Residuals::fit`].
    pub(crate) fn fit_residuals(&mut self, ensemble: Ensemble, models: usize) -> Result<Ensemble> {
        let (Some(settings), None) = (&self.pipeline.residuals, ensemble.residuals()) else { return Ok(ensemble) };
        let links = self.split.partition.known().all();
        let mut left_out = vec![None; links.len()];
        let lists = left_out_links(self.pipeline, self.split, models)?;
        for (part, list) in lists.iter().enumerate() {
            for link in list {
                let Ok(k) = links.binary_search(link) else {
                    return Err(Error::Config("residuals: a model left out a test sample; train it again".into()));
                };
                left_out[k] = Some(part);
            }
        }
        let blocks = label_blocks(self.pipeline, self.split, &links);
        let (data, parts) = (&self.split.data, lists.len());
        let stop = self.session.stop;
        let links = KnownLinks { data, links: &links, left_out: &left_out, parts, blocks: &blocks, stop };
        let fitted = run_stage(self.session.observer, "fitting residuals", |progress| {
            Residuals::fit(settings, &ensemble, links, progress)
        })?;
        Ok(ensemble.with_residuals(Some(fitted)))
    }
}
