//! Models from arrays.

use super::Model;
use crate::arrays::{numbers, positions, read_elevation};
use crate::border::{parse_plugin, reject, without_gil};
use crate::strategies::{check_keys, read_cloud};
use pwrfgs::model::{Ensemble, MAX_PIXELS, Stages, TrainingPositions};
use pwrfgs_core::{
    Conditions, Dataset as Data, Error, MeasurementSetup, Method, Origin, Pose, Real, Receiver, Sample, Spectra, rng,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Returns weights in the layout of the method: initial values, replaced by those of `given` by name. Raises an
/// exception for a name without a tensor, or another shape.
fn initial_weights(stages: &Stages, given: Option<&Bound<'_, PyDict>>) -> PyResult<Vec<Real>> {
    let layout = stages.layout();
    let mut weights = layout.init(&mut rng::stream(0, "network", 0)); // a fixed seed: equal arrays give equal models
    if let Some(deformation) = stages.deformation() {
        // Without training positions (of three coordinates): the given weights replace what would follow from them.
        deformation.start(Conditions::new(3, &[]), &mut weights);
    }
    let Some(given) = given else { return Ok(weights) };
    let mut remaining = weights.as_mut_slice();
    for spec in &layout.weights {
        let (tensor, tail) = remaining.split_at_mut(spec.len());
        if let Some(values) = given.get_item(&spec.name)? {
            let shape: Vec<Option<usize>> = spec.shape.iter().copied().map(Some).collect();
            tensor.copy_from_slice(&numbers::<Real>(&format!("weights: `{}`", spec.name), &values, &shape)?);
        }
        remaining = tail;
    }
    check_keys("weights: the network has no tensor", given, layout.weights.iter().map(|spec| spec.name.as_str()))?;
    Ok(weights)
}

/// Creates the model of `Model.from_arrays` from converted arguments: `cloud` are columns as in `Trainer.set_cloud`,
/// `method` is RON text, `weights` are arrays by name, `receiver` is name, position and orientation, `size` is height and
/// width, `tx` are the training positions.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // arguments with names, as Python has them
pub(crate) fn model_of(
    py: Python<'_>,
    cloud: &Bound<'_, PyDict>,
    method: &str,
    weights: Option<&Bound<'_, PyDict>>,
    receiver: (String, [f64; 3], [f64; 4]),
    size: (usize, usize),
    elevation_deg: [f64; 2],
    tx: Option<&Bound<'_, PyAny>>,
) -> PyResult<Model> {
    let method = parse_plugin::<dyn Method>(py, method)?;
    let (height, width) = size;
    let (name, position, orientation) = receiver;
    let trained = tx.map_or(Ok(Vec::new()), |tx| positions("tx", tx))?;
    let all_positions = trained.iter().copied().chain(positions("means", &cloud.as_any().get_item("means")?)?);
    let origin = Origin::for_receiver(position, all_positions);
    let cloud = read_cloud(cloud, origin)?;
    let elevation = read_elevation(py, elevation_deg)?;
    if !(1..=MAX_PIXELS).contains(&height.saturating_mul(width)) {
        return reject(py, &format!("an image of {height} by {width} pixels cannot be rendered"));
    }
    let stages = without_gil(py, || {
        // Stages need data: one empty spectrum. Their origin is replaced, since that of the data ignores the Gaussians.
        let receiver = Receiver::new(name, Pose { position, orientation });
        let spectra = Spectra::grey((width, height), vec![0; width * height])?;
        let data = Data::of_links("arrays", vec![receiver], vec![], &[Sample::new(1, position)], spectra.into())?;
        let stages = Stages::of(method, &Data { elevation, ..data })?;
        let pose = origin.local_pose(Pose { position, orientation });
        let receivers = vec![Receiver { pose, ..stages.setup.receivers[0].clone() }];
        let stages = Stages { setup: MeasurementSetup { origin, receivers, ..stages.setup }, ..stages };
        stages.check().map_err(Error::Config).map(|()| stages)
    })?;
    let weights = initial_weights(&stages, weights)?;
    let positions: Vec<[Real; 3]> = trained.iter().map(|tx| origin.local(*tx)).collect();
    let training_positions = TrainingPositions::thinned(&positions);
    Ok(Model::new(Ensemble::of(pwrfgs::model::Model { stages, cloud, weights, training_positions })))
}
