//! A pass over training transmitters: what pruners asked for, of each Gaussian.

use crate::graph::Batch;
use crate::loss::Objective;
use pwrfgs_core::{GaussianCloud, Needs, Parameters, Real, Result, Statistic, Statistics};
use pwrfgs_model::Stages;
use rayon::prelude::*;

/// What stays as it is during a pass.
pub(crate) struct Scene<'a> {
    pub(crate) stages: &'a Stages,
    pub(crate) weights: &'a [Real],
    pub(crate) objective: &'a dyn Objective,
}

/// What `needs` names, over all `batches`. Gaussians whose `gate` is 0 are not looked at, and have zeros.
pub(crate) fn survey(
    scene: &Scene<'_>,
    cloud: &GaussianCloud,
    gate: Option<&[Real]>,
    needs: &Needs,
    batches: impl Iterator<Item = Result<(Stages, Batch)>>,
) -> Result<Statistics> {
    let mut sums = Statistics::zeros(needs, cloud.len());
    let rows = scene.stages.drawable(cloud, gate);
    let open = cloud.select(&rows);
    let gate: Option<Vec<Real>> = gate.map(|gate| rows.iter().map(|&i| gate[i]).collect());
    let parameters = Parameters { cloud: &open, gate: gate.as_deref(), presence: None, weights: scene.weights };
    let most = needs.statistics.iter().find_map(|statistic| match statistic {
        Statistic::Elimination { most } if cloud.len() <= *most => Some(*most),
        _ => None,
    });
    let draws = needs.statistics.iter().any(|statistic| statistic.wants_blending());
    let mut seen = Vec::new();
    for batch in batches {
        let (stages, batch) = batch?;
        if draws {
            let Stages { method, frame } = &stages;
            sums.add(&rows, &method.survey(frame, &parameters, &batch.asked(), &batch.truths, needs));
        }
        if most.is_some() {
            seen.push((stages, batch));
        }
    }
    if most.is_some() {
        sums.elimination = elimination(scene, &parameters, &rows, cloud.len(), &seen);
    }
    sums.finish();
    Ok(sums)
}

/// The place at which each of `n` Gaussians is taken: those that are not drawn first, then in turn the one without which
/// the loss of `batches` is smallest, of equals the last.
fn elimination(
    scene: &Scene<'_>,
    p: &Parameters<'_>,
    rows: &[usize],
    n: usize,
    batches: &[(Stages, Batch)],
) -> Vec<Real> {
    let mut places = vec![Real::NAN; n];
    let mut drawn = vec![false; n];
    rows.iter().for_each(|&i| drawn[i] = true);
    let mut next = 0;
    let mut take = |i: usize| {
        places[i] = next as Real;
        next += 1;
    };
    (0..n).rev().filter(|&i| !drawn[i]).for_each(&mut take);
    let mut left: Vec<usize> = (0..rows.len()).collect();
    while left.len() > 1 {
        let without = |k: usize| {
            let others: Vec<usize> = left.iter().copied().filter(|&i| i != left[k]).collect();
            loss_of(scene, p, &others, batches)
        };
        let losses: Vec<Real> = (0..left.len()).into_par_iter().map(without).collect();
        let best = (0..left.len()).rev().min_by(|&a, &b| losses[a].total_cmp(&losses[b])).expect("two or more");
        take(rows[left.remove(best)]);
    }
    left.into_iter().for_each(|k| take(rows[k]));
    places
}

/// Mean loss of the Gaussians `some`.
fn loss_of(scene: &Scene<'_>, p: &Parameters<'_>, some: &[usize], batches: &[(Stages, Batch)]) -> Real {
    let cloud = p.cloud.select(some);
    let gate: Option<Vec<Real>> = p.gate.map(|gate| some.iter().map(|&i| gate[i]).collect());
    let parameters = Parameters { cloud: &cloud, gate: gate.as_deref(), ..*p };
    let loss = |(Stages { method, frame }, batch): &(Stages, Batch)| {
        let size = (frame.plane.width, frame.plane.height);
        let numbers = method.forward(frame, &parameters, &batch.asked()).numbers;
        scene.objective.evaluate(&numbers, &batch.truths, size).0 * batch.links.len() as Real
    };
    let links: usize = batches.iter().map(|(_, batch)| batch.links.len()).sum();
    batches.iter().map(loss).sum::<Real>() / links.max(1) as Real
}
