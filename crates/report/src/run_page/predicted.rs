//! What the model predicts of test links, a bounded number of them at a time.

use pwrfgs_core::{Image, Query};
use pwrfgs_experiment::LoadedRun;

/// Links that are predicted together.
const CHUNK: usize = 512;

/// Shows `look` every one of these links with its measurement and its prediction, in order.
pub(super) fn each(run: &LoadedRun<'_>, links: &[usize], mut look: impl FnMut(usize, &Image, &Image)) {
    let (model, data) = (run.model.prepare(), run.data);
    for chunk in links.chunks(CHUNK) {
        let queries: Vec<Query<'_>> = chunk.iter().map(|&i| data.query(i)).collect();
        for (&i, predicted) in chunk.iter().zip(model.predict_many(&queries)) {
            look(i, &data.image(i), &predicted);
        }
    }
}
