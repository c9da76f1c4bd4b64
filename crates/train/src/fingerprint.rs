//! What a training follows from, as one digest: a checkpoint goes on in the very training that it comes from.

use crate::TrainingPlan;
use crate::settings::Training;
use crate::trainer::specs_of;
use pwrfgs_core::files::digest;
use pwrfgs_core::plugin::to_ron;
use pwrfgs_core::{Dataset, Real, Sample};
use rayon::prelude::*;

/// Samples whose digests are taken together.
const CHUNK: usize = 64;

/// The digest of everything in `plan` that changes a training, of the `data` and of which of them are trained on.
/// Where the data lie, how they are scored and how often one looks or saves is left out.
pub(crate) fn fingerprint(plan: &TrainingPlan, data: &Dataset, train: &[usize]) -> String {
    // In full: a new field of a plan is either part of the digest or named here as one that changes nothing.
    let TrainingPlan { name: _, seed, method, initializer, pruners, training } = plan;
    let looks = Training::default();
    let training = Training {
        checkpoint_every: looks.checkpoint_every,
        validate_every: looks.validate_every,
        validation_samples: looks.validation_samples,
        ..Training::clone(training)
    };
    let said = to_ron(&(seed, initializer, method, pruners, training));
    let columns: Vec<_> = specs_of(plan).into_iter().map(|spec| (spec.name, spec.width)).collect();
    let parts = [said, format!("{columns:?} {train:?} {}", size_of::<Real>()), of_data(data)];
    digest(parts.join("\n").as_bytes())
}

/// Receivers, size, points, and every link.
fn of_data(data: &Dataset) -> String {
    let part = |samples: &[(usize, Sample)]| {
        let mut bytes = Vec::new();
        for (i, sample) in samples {
            bytes.extend(sample.tx.iter().flat_map(|v| v.to_le_bytes()));
            bytes.extend(data.query(*i).features.iter().flat_map(|v| v.to_le_bytes()));
            bytes.extend_from_slice(&data.observations.raw(*i));
        }
        digest(&bytes)
    };
    let samples: Vec<(usize, Sample)> = data.samples().enumerate().collect();
    let parts: Vec<String> = samples.par_chunks(CHUNK).map(part).collect();
    let points: Vec<u8> = data.scene.points.as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    let scene = &data.scene;
    let frequencies = data.observations.frequencies_hz();
    let links = digest(format!("{:?}", data.links).as_bytes());
    let size = (data.width, data.height, data.elevation);
    let frame = format!("{:?} {:?} {:?} {size:?} {frequencies:?} {links}", data.task(), scene.receivers, scene.origin);
    [frame, digest(&points), parts.join(" ")].join(" ")
}
