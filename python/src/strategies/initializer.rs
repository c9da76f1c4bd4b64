//! Python classes as initialisers.

use super::objects::numpy_generator;
use super::{Strategy, check_keys};
use crate::arrays::{array, axis_count, complex_pairs, finite_numbers};
use crate::border::{input_error, reject};
use pwrfgs_core::{ExtraColumn, GaussianCloud, ImagePlane, Initializer, Real, Result, Scene, logit, rng};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Opacity of Gaussians without `opacities`, as of the shipped initialisers.
const DEFAULT_OPACITY: Real = 0.1;

impl Initializer for Strategy {
    named_python!();

    fn initialize(&self, scene: &Scene, _: &ImagePlane, random: &mut rng::Rng) -> Result<GaussianCloud> {
        self.try_with(|py, instance| {
            let world = |position: &[Real; 3]| scene.origin.world(*position);
            let points: Vec<f64> = scene.points.iter().flat_map(world).collect();
            let ends = scene.fixed_ends();
            let count = ends.len();
            let fixed: Vec<f64> = ends.into_iter().flat_map(|pose| scene.origin.world_pose(pose).position).collect();
            let arguments = (
                array(py, points, &[scene.points.len(), 3])?,
                array(py, [world(&scene.bounds.0), world(&scene.bounds.1)].concat(), &[2, 3])?,
                array(py, fixed, &[count, 3])?,
            );
            let room = py.import("pwrfgs._types")?.getattr("Room")?.call1(arguments)?;
            let columns = instance.call_method1("initialize", (room, numpy_generator(py, random)?))?;
            let Ok(columns) = columns.cast_into::<PyDict>() else {
                return reject(py, "initialize returned no dict; give a dict with means [N, 3] and scales");
            };
            cloud_from_result(&columns, scene)
        })
    }
}

/// Reads the scales of `n` Gaussians, metres: one number, `[n]` or `[n, 3]`, above 0.
fn read_scales(value: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<[Real; 3]>> {
    let scales: Vec<[Real; 3]> = match axis_count(value)? {
        0 => vec![[value.extract()?; 3]; n],
        1 => finite_numbers("scales", value, &[n])?.into_iter().map(|s| [s; 3]).collect(),
        _ => finite_numbers("scales", value, &[n, 3])?.as_chunks().0.to_vec(),
    };
    if !scales.as_flattened().iter().all(|s| s.is_finite() && *s > 0.0) {
        return reject(value.py(), "scales: give metres above 0");
    }
    Ok(scales)
}

/// Creates a cloud from the result of `initialize`: means (world frame), scales and optional columns.
fn cloud_from_result(columns: &Bound<'_, PyDict>, scene: &Scene) -> PyResult<GaussianCloud> {
    let py = columns.py();
    let need = |name: &str| {
        columns.get_item(name)?.ok_or_else(|| {
            input_error(py, &format!("initialize returned no `{name}`; means [N, 3] and scales are required"))
        })
    };
    check_keys("initialize: unknown entry", columns, ["means", "scales", "opacities", "quats", "signals"])?;
    let means = crate::arrays::positions("means", &need("means")?)?;
    let n = means.len();
    let scales = read_scales(&need("scales")?, n)?;
    let opacities = match columns.get_item("opacities")? {
        None => vec![DEFAULT_OPACITY; n],
        Some(value) if axis_count(&value)? == 0 => vec![value.extract()?; n],
        Some(value) => finite_numbers("opacities", &value, &[n])?,
    };
    if !opacities.iter().all(|o| *o > 0.0 && *o < 1.0) {
        return reject(py, "opacities: give numbers between 0 and 1");
    }
    let quats = match columns.get_item("quats")? {
        None => vec![[1.0, 0.0, 0.0, 0.0]; n],
        Some(value) => finite_numbers("quats", &value, &[n, 4])?.as_chunks().0.to_vec(),
    };
    let signals = match columns.get_item("signals")? {
        None => vec![[0.0; 2]; n],
        Some(value) => complex_pairs("signals", &value, &[Some(n)])?,
    };
    if let Some(i) = quats.iter().position(|quat| *quat == [0.0; 4]) {
        return reject(py, &format!("quats[{i}] is zero; give a rotation, such as (1, 0, 0, 0)"));
    }
    Ok(GaussianCloud {
        means: means.iter().map(|mean| scene.origin.local(*mean)).collect(),
        log_scales: scales.iter().map(|s| s.map(Real::ln)).collect(),
        quats,
        opacity_logits: opacities.into_iter().map(logit).collect(),
        signals,
        extra: Vec::<ExtraColumn>::new(),
    })
}
