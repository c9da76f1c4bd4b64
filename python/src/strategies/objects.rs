//! Arguments of strategies: columns of the toolkit as records of `pwrfgs._types`.

use crate::arrays::{array, array_shape, column_shape, finite_numbers, vector};
use pwrfgs_core::tape::TracedCloud;
use pwrfgs_core::{COLUMN_NAMES, CloudStats, Dataset, ExtraColumn, GaussianCloud, Origin, Real, StepContext, rng};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Converts Gaussians to the Python class `Cloud`: new arrays, which a strategy may keep, read-only unless `writable`.
pub(crate) fn cloud_object<'py>(py: Python<'py>, cloud: &GaussianCloud, writable: bool) -> PyResult<Bound<'py, PyAny>> {
    let columns = cloud.columns().map(|(name, _, values)| (name, values.to_vec()));
    columns_object(py, cloud.len(), columns, writable)
}

/// Converts Gaussians on the tape to the Python class `Cloud`, read-only.
pub(super) fn traced_object<'py>(py: Python<'py>, cloud: &TracedCloud) -> PyResult<Bound<'py, PyAny>> {
    let columns = cloud.names().map(|name| (name, pwrfgs_core::tape::values(cloud.leaf(name))));
    columns_object(py, cloud.len(), columns, false)
}

/// Converts columns of `n` Gaussians to the Python class `Cloud`, read-only unless `writable`.
fn columns_object<'py, 'a>(
    py: Python<'py>,
    n: usize,
    columns: impl Iterator<Item = (&'a str, Vec<Real>)>,
    writable: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let object = PyDict::new(py);
    for (name, values) in columns {
        let width = values.len().checked_div(n).unwrap_or(1);
        let column = array(py, values, &column_shape(n, width))?;
        if !writable {
            column.getattr("flags")?.setattr("writeable", false)?;
        }
        object.set_item(name, column)?;
    }
    py.import("pwrfgs._types")?.getattr("Cloud")?.call1((object,))
}

/// Reads Gaussians from unconstrained columns by name; converts `means` from the world frame to that of `origin`.
/// Columns with other names become extra columns.
pub(crate) fn read_cloud(columns: &Bound<'_, PyDict>, origin: Origin) -> PyResult<GaussianCloud> {
    let need = |name: &str| columns.as_any().get_item(name);
    let means = crate::arrays::positions("means", &need("means")?)?;
    let n = means.len();
    let mut cloud = GaussianCloud::zeros(n);
    cloud.means = means.iter().map(|mean| origin.local(*mean)).collect();
    // All but the first, the means.
    for (name, width, values) in cloud.columns_mut().skip(1) {
        values.copy_from_slice(&finite_numbers(name, &need(name)?, &column_shape(n, width))?);
    }
    for (name, values) in columns {
        let name: String = name.extract()?;
        if !COLUMN_NAMES.contains(&name.as_str()) {
            let width = array_shape(&values)?.get(1).copied().unwrap_or(1);
            let values = finite_numbers(&name, &values, &column_shape(n, width))?;
            cloud.extra.push(ExtraColumn { name, width, values });
        }
    }
    Ok(cloud)
}

/// Converts the statistics of the Gaussians to the Python class `Stats`.
pub(crate) fn stats_object<'py>(py: Python<'py>, stats: &CloudStats) -> PyResult<Bound<'py, PyAny>> {
    let column = |values: &[Real]| vector(py, values.to_vec());
    let columns = PyDict::new(py);
    let requested = &stats.requested;
    for (name, values) in [
        ("weight", &requested.weight),
        ("largest_weight", &requested.largest_weight),
        ("weight_per_area", &requested.weight_per_area),
        ("signal_mean", &requested.signal_mean),
        ("signal_max", &requested.signal_max),
        ("error", &requested.error),
        ("high_error", &requested.high_error),
        ("sensitivity", &requested.sensitivity),
        ("elimination", &requested.elimination),
    ] {
        if !values.is_empty() {
            columns.set_item(name, column(values)?)?;
        }
    }
    if !requested.top.is_empty() {
        columns.set_item("top", vector(py, requested.top.clone())?)?;
    }
    if !requested.fisher.is_empty() {
        let all: Vec<Real> = requested.fisher.as_flattened().to_vec();
        columns.set_item("fisher", array(py, all, &[requested.fisher.len(), requested.fisher[0].len()])?)?;
    }
    let fields =
        (column(&stats.visible)?, column(&stats.gradient)?, column(&stats.radius)?, column(&stats.weight)?, columns);
    py.import("pwrfgs._types")?.getattr("Stats")?.call1(fields)
}

/// Converts the context of a step to the Python class `StepContext`.
pub(super) fn context_object<'py>(py: Python<'py>, context: &StepContext) -> PyResult<Bound<'py, PyAny>> {
    let StepContext { step, phase, seed, round, rounds, target, .. } = *context;
    py.import("pwrfgs._types")?.getattr("StepContext")?.call1((step, phase.name(), seed, round, rounds, target))
}

/// Converts links without observations to the Python class `Links`.
pub(super) fn links_object<'py>(py: Python<'py>, data: &Dataset, links: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    let rows: Vec<_> = links.iter().map(|&i| data.sample(i)).collect();
    let fields = (
        array(py, rows.iter().flat_map(pwrfgs_core::Sample::position).collect::<Vec<f64>>(), &[rows.len(), 3])?,
        vector(py, rows.iter().map(|s| i64::from(s.id)).collect::<Vec<i64>>())?,
        vector(py, rows.iter().map(|s| s.receiver as i64).collect::<Vec<i64>>())?,
    );
    py.import("pwrfgs._types")?.getattr("Links")?.call1(fields)
}

/// Returns a NumPy random generator, with a seed of 62 bits drawn from `random`.
pub(super) fn numpy_generator<'py>(py: Python<'py>, random: &mut rng::Rng) -> PyResult<Bound<'py, PyAny>> {
    py.import("numpy.random")?.call_method1("default_rng", (rng::below(random, 1 << 62),))
}
