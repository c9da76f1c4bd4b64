//! Gates and prune steps: closed Gaussians have no effect, open gates change nothing, and one Gaussian remains.

use crate::common::{MOMENT, batch, cloud, pipeline, plugin, stages, with_column};
use pwrfgs::core::{DeformationInputs, rng};
use pwrfgs::methods::{Readout, Splatting};
use pwrfgs::model::tensors::Tensors;
use pwrfgs::prelude::*;
use pwrfgs::train::{RenderingLoss, loss_and_gradients};
use std::path::Path;
use std::sync::Arc;

const N: usize = 8;

#[test]
fn closed_gate_equals_absent_gaussian() {
    let deformations = [
        "Fixed()",
        "Mlp(depth: 2, width: 8, skip: None, tx_hidden: 8, tx_features: 4)",
        "Mlp(depth: 2, width: 8, skip: None, tx_hidden: 8, tx_features: 4, outputs: Signals)",
        "Wrfgs(depth: 2, width: 8, skip: None, gain: 2)",
    ];
    for deformation in deformations {
        let stages = stages(deformation, Readout::Magnitude);
        let weights = stages.layout().init(&mut rng::stream(2, "network", 0));
        let batch = batch(2, &stages);
        let outcome = |cloud: &GaussianCloud| {
            let pruners = [plugin("LearnableMask(lambda: 0)")];
            loss_and_gradients(
                &stages,
                cloud,
                &Arc::new(weights.clone()),
                &batch,
                &RenderingLoss::new(0.2),
                &pruners,
                &MOMENT,
            )
            .unwrap()
        };
        for closed in 0..N {
            let mut masks = vec![1.0; N];
            masks[closed] = -20.0;
            let whole = with_column(cloud(N, 11), "mask_logits", masks);
            let others: Vec<usize> = (0..N).filter(|&i| i != closed).collect();
            let (gated, without) = (outcome(&whole), outcome(&whole.select(&others)));
            assert_eq!(gated.loss, without.loss, "{deformation}");
            assert_eq!(gated.d_cloud.select(&others), without.d_cloud, "{deformation}");
            assert_eq!(gated.d_weights, without.d_weights, "{deformation}");
            let row = gated.d_cloud.select(&[closed]);
            assert_eq!(row, row.zeros_like(), "{deformation}: what is not drawn has no derivative");
            assert_eq!(gated.stats.visible[closed], 0.0);
        }
    }
}

#[test]
fn invisible_gaussians_change_neither_image_nor_derivative() {
    for deformation in ["Mlp(depth: 2, width: 8, skip: None, tx_hidden: 8, tx_features: 4)", "Factored(width: 16)"] {
        let stages = stages(deformation, Readout::Magnitude);
        let weights = Arc::new(stages.layout().init(&mut rng::stream(2, "network", 0)));
        let few = cloud(N, 11);
        let mut more = few.select(&[0, 0, 1, 2, 2, 3, 4, 5, 6, 7]);
        more.means[1] = [0.4, -0.3, -2.0]; // behind the receiver
        more.opacity_logits[4] = -6.0; // γ below 1/255 even in the middle
        let kept = [0, 2, 3, 5, 6, 7, 8, 9];
        assert_eq!(stages.drawable(&more, None), kept);
        let picture = |cloud: &GaussianCloud| {
            let model = Model {
                stages: Stages::clone(&stages),
                cloud: cloud.clone(),
                weights: weights.to_vec(),
                training_positions: None,
            };
            model.predict([0.3, 0.2, 0.9])
        };
        assert_eq!(picture(&few), picture(&more), "{deformation}");
        // The stages themselves, with every Gaussian, agree that those are not seen.
        let splatting = stages.settings::<Splatting>().unwrap();
        let txs = [[0.3, 0.2, 0.9]];
        let deltas =
            splatting.deformation.forward(&DeformationInputs::new(&weights, &more.means, &txs, &stages.pose()), &None);
        let activation = splatting.activation();
        let geometry = activation.geometry(&more, &deltas, 0, None);
        let splats = splatting.projector.project(&geometry, &stages.pose(), &stages.plane);
        let signals = activation.signals(&more, &deltas, 0..1);
        let render = splatting.rasterizer.forward(splats.with_signals(&signals, activation.channels, &stages.plane));
        let whole = splatting.readout.forward(&render.pixels, stages.plane.width * stages.plane.height);
        assert!(whole.iter().zip(picture(&few).pixels).all(|(a, b)| (a - b).abs() < 1e-6), "{deformation}");
        let objective = RenderingLoss::new(0.2);
        let outcome =
            |cloud| loss_and_gradients(&stages, cloud, &weights, &batch(2, &stages), &objective, &[], &MOMENT).unwrap();
        let (a, b) = (outcome(&few), outcome(&more));
        assert_eq!((a.loss, a.d_weights), (b.loss, b.d_weights), "{deformation}");
        assert_eq!(a.d_cloud, b.d_cloud.select(&kept), "{deformation}");
        let rest = b.d_cloud.select(&[1, 4]);
        assert_eq!(rest, rest.zeros_like(), "{deformation}");
    }
}

/// A small training: 40 Gaussians where six are needed, pruned from step 6 on.
fn training(pruners: &str, training: &str) -> Pipeline {
    pipeline(&format!(
        "data: Teacher(gaussians: 6, samples: 20, width: 60, height: 15), initializer: Grid(count: 40),
         deformation: Mlp(depth: 2, width: 8, skip: None, tx_hidden: 8, tx_features: 4, outputs: Signals),
         pruners: [{pruners}],
         training: (steps: 30, densify_until: 6, prune_until: 24, densify: (every: 0), {training})"
    ))
}

fn data_of(pipeline: &Pipeline) -> (Dataset, Partition) {
    let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
    let partition = pipeline.split.split(&data, &mut rng::stream(0, "split", 0)).unwrap();
    (data, partition)
}

#[test]
fn pruning_open_gates_is_identity() {
    let checkpoints = |every: u64| {
        let pipeline = training("LearnableMask(), OpacityThreshold()", &format!("prune_every: {every}"));
        let (data, partition) = data_of(&pipeline);
        let mut trainer = pipeline.trainer(&data, &partition).unwrap();
        // All but the note, which says what training this is.
        let state = |trainer: &Trainer<'_>| {
            let mut state = Tensors::from_bytes(&trainer.checkpoint()).unwrap();
            state.note.clear();
            state
        };
        (1..24).map(|_| (trainer.step().unwrap(), state(&trainer))).collect::<Vec<_>>()
    };
    let (pruned, not_pruned) = (checkpoints(1), checkpoints(1000));
    assert!(pruned == not_pruned, "asking the pruners at every step changed bits though every gate was open");
}

#[test]
fn pruning_to_zero_stops_unless_target_is_one() {
    let masks = "LearnableMask(lambda: 1, learning_rate: 3)";
    let (rule, both) = ("OpacityThreshold(epsilon: 0.99)", format!("{masks}, OpacityThreshold(epsilon: 0.99)"));
    // Open masks and a rule that removes all; closed masks are a result, with or without that rule.
    let open = "LearnableMask(), OpacityThreshold(epsilon: 0.99)";
    for (pruners, is_result) in [(rule, false), (open, false), (masks, true), (&both, true)] {
        let pipeline = training(pruners, "prune_every: 6");
        let (data, partition) = data_of(&pipeline);
        let mut trainer = pipeline.trainer(&data, &partition).unwrap();
        let failed = (0..30).find_map(|_| trainer.step().err());
        if is_result {
            assert!(failed.is_none() && trainer.model().cloud.len() == 1, "{pruners}: {failed:?}");
            assert_eq!(trainer.idle_masks_warning(), None, "{pruners}");
        } else {
            assert!(matches!(failed, Some(Error::Collapsed { step: 12, .. })), "{pruners}: {failed:?}");
        }

        let pipeline = training(&format!("TopK(), {pruners}"), "prune_every: 6, target_count: 1");
        let mut trainer = pipeline.trainer(&data, &partition).unwrap();
        let mut counts = Vec::new();
        while !trainer.finished() {
            counts.push(trainer.step().unwrap_or_else(|e| panic!("{pruners}: {e}")).gaussians);
            let picture = trainer.model().predict([0.1, 0.2, 0.9]);
            assert!(picture.pixels.iter().all(|p| p.is_finite()), "{pruners}");
        }
        assert_eq!((counts[10], counts[11], counts[29]), (40, 1, 1), "{pruners}: {counts:?}");
        assert_eq!(trainer.model().cloud.len(), 1, "{pruners}");
        assert!(trainer.model().cloud.extra.is_empty());
    }
}

#[test]
fn resumed_training_counts_closed_masks() {
    for (rate, said) in [("0.01", Some("masks closed 0 of 40 Gaussians")), ("3", None)] {
        let pipeline = training(&format!("LearnableMask(lambda: 1, learning_rate: {rate})"), "prune_every: 6");
        let (data, partition) = data_of(&pipeline);
        let mut trainer = pipeline.trainer(&data, &partition).unwrap();
        (0..18).for_each(|_| drop(trainer.step().unwrap()));
        let plan = pipeline.plan().unwrap();
        let mut resumed = Trainer::restore(&plan, &data, &partition, &trainer.checkpoint()).unwrap();
        while !resumed.finished() {
            resumed.step().unwrap();
        }
        let found = resumed.idle_masks_warning();
        assert!(found.as_deref().is_some_and(|text| text.contains("λ")) == said.is_some(), "{found:?}");
        assert!(said.is_none_or(|said| found.is_some_and(|text| text.starts_with(said))), "rate {rate}");
    }
}

#[test]
fn last_kept_gaussian_has_highest_score() {
    let pipeline = training("TopK(score: Opacity), OpacityThreshold(epsilon: 0.99)", "prune_every: 6, target_count: 1");
    let (data, partition) = data_of(&pipeline);
    let mut trainer = pipeline.trainer(&data, &partition).unwrap();
    let mut before = trainer.model().cloud;
    while trainer.done() < 12 {
        before = trainer.model().cloud;
        trainer.step().unwrap();
    }
    // One step of Adam lies between: the survivor is the most opaque one within that.
    let survivor = trainer.model().cloud.opacity_logits[0];
    let most = before.opacity_logits.iter().copied().fold(Real::MIN, Real::max);
    assert!((survivor - most).abs() < 0.06, "{survivor} stays, {most} was the best");
}
