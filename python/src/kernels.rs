//! `project` and `rasterize`: differentiable kernels for custom methods.

use crate::arrays::{array, axis_count, check_memory, input_array, numbers, read_elevation};
use crate::border::{input_error, parse_plugin, plugin_text, reject, without_gil};
use numpy::PyUntypedArrayMethods as _;
use pwrfgs::methods::{normalise_quat, normalise_quat_vjp};
use pwrfgs_core::{ImagePlane, Plugin, Pose, Primitives, Projector, Rasterizer, Real, Render, Splats};
use pyo3::prelude::*;

/// Largest number of pixels of an image: 1 GiB per channel in single precision.
const MOST_PIXELS: usize = 1 << 28;

/// Forward pass of the rasterizer, kept for the backward pass.
#[pyclass(frozen, module = "pwrfgs._pwrfgs")]
pub(crate) struct Drawing {
    view: View,
    inputs: Primitives,
    splats: Splats,
    signals: Vec<Real>,
    channels: usize,
    render: Render,
}

/// Projector, rasterizer, pose and image plane.
struct View {
    projector: Plugin<dyn Projector>,
    rasterizer: Plugin<dyn Rasterizer>,
    pose: Pose,
    plane: ImagePlane,
}

impl View {
    /// Parses projector, rasterizer and pose, and creates the plane of an image of this size between these elevations,
    /// degrees.
    fn new(
        projector: &Bound<'_, PyAny>,
        rasterizer: &Bound<'_, PyAny>,
        pose: &Bound<'_, PyAny>,
        (height, width): (usize, usize),
        elevation: [f64; 2],
    ) -> PyResult<Self> {
        let py = pose.py();
        if height == 0 || width == 0 || height.saturating_mul(width) > MOST_PIXELS {
            return reject(py, &format!("an image of {height} by {width} pixels cannot be rendered"));
        }
        let projector = parse_plugin::<dyn Projector>(py, &plugin_text("Projector", projector, None)?)?;
        let rasterizer = parse_plugin::<dyn Rasterizer>(py, &plugin_text("Rasterizer", rasterizer, None)?)?;
        let plane = projector.plane_of(width, height, read_elevation(py, elevation)?);
        let plane = plane.map_err(|why| input_error(py, &why.to_string()))?;
        rasterizer.check_plane(&plane).map_err(|why| input_error(py, &why.to_string()))?;
        Ok(Self { projector, rasterizer, pose: read_pose(pose)?, plane })
    }
}

/// Reads the pose of a receiver: position, and orientation as x, y, z, w.
fn read_pose(pose: &Bound<'_, PyAny>) -> PyResult<Pose> {
    let (position, orientation): ([f64; 3], [f64; 4]) = pose.extract()?;
    let parsed = Pose { position, orientation };
    match parsed.fault() {
        Some((_, fault)) => reject(pose.py(), &format!("pose: {fault}")),
        None => Ok(parsed),
    }
}

/// Reads Gaussians from NumPy: finite, with scales above 0, opacities below 1 and non-zero quaternions of any length.
fn read_primitives(
    means: &Bound<'_, PyAny>,
    quats: &Bound<'_, PyAny>,
    scales: &Bound<'_, PyAny>,
    opacities: &Bound<'_, PyAny>,
) -> PyResult<Primitives> {
    let py = means.py();
    let means = numbers::<Real>("means", means, &[None, Some(3)])?;
    let n = Some(means.len() / 3);
    let quats = numbers::<Real>("quats", quats, &[n, Some(4)])?;
    let scales = numbers::<Real>("scales", scales, &[n, Some(3)])?;
    let opacities = numbers::<Real>("opacities", opacities, &[n])?;
    for (name, column) in [("means", &means), ("quats", &quats), ("scales", &scales), ("opacities", &opacities)] {
        if let Some(i) = column.iter().position(|v| !v.is_finite()) {
            return reject(py, &format!("{name} holds {}; give finite numbers", column[i]));
        }
    }
    if let Some(i) = scales.iter().position(|v| *v <= 0.0) {
        return reject(py, &format!("scales[{}] holds {}; give metres above 0", i / 3, scales[i]));
    }
    if let Some(o) = opacities.iter().find(|o| !(0.0..1.0).contains(*o)) {
        return reject(py, &format!("opacities: {o} is outside the range from 0 to below 1"));
    }
    let inputs = Primitives {
        means: means.as_chunks().0.to_vec(),
        scales: scales.as_chunks().0.to_vec(),
        quats: quats.as_chunks().0.to_vec(),
        opacities,
    };
    // As `normalise_quat`, which would replace them by the identity.
    match inputs.quats.iter().position(|q| q.iter().map(|v| v * v).sum::<Real>().sqrt() <= 1e-12) {
        Some(i) => reject(py, &format!("quats[{i}] is zero; give a rotation, such as (1, 0, 0, 0)")),
        None => Ok(inputs),
    }
}

/// Returns the Gaussians with normalised quaternions.
fn with_unit_quats(inputs: &Primitives) -> Primitives {
    Primitives { quats: inputs.quats.iter().map(|q| normalise_quat(*q)).collect(), ..inputs.clone() }
}

/// Project Gaussians to ellipses on the image plane of a receiver. Returns the named tuple `Splats`: means2d [N, 2]
/// (column, row, px), conics [N, 3] (inverse covariances, px⁻²), depths [N] (metres), radii [N] (px; 0 outside the
/// image) and opacities [N].
///
/// means [N, 3] in metres, quats [N, 4] as w, x, y, z (any non-zero length), scales [N, 3] in metres, opacities [N]
/// below 1; `pose` is the receiver pose (position, orientation as x, y, z, w).
#[pyfunction]
#[pyo3(signature = (means, quats, scales, opacities, pose, height, width, projector, elevation_deg))]
#[allow(clippy::too_many_arguments)] // columns with names, as Python has them
pub(crate) fn project<'py>(
    py: Python<'py>,
    means: &Bound<'py, PyAny>,
    quats: &Bound<'py, PyAny>,
    scales: &Bound<'py, PyAny>,
    opacities: &Bound<'py, PyAny>,
    pose: &Bound<'py, PyAny>,
    height: usize,
    width: usize,
    projector: &Bound<'py, PyAny>,
    elevation_deg: [f64; 2],
) -> PyResult<Bound<'py, PyAny>> {
    // Only the check of the image plane uses the rasterizer.
    let alpha = "AlphaBlending()".into_pyobject(py)?.into_any();
    let view = View::new(projector, &alpha, pose, (height, width), elevation_deg)?;
    let inputs = read_primitives(means, quats, scales, opacities)?;
    let splats = without_gil(py, || Ok(view.projector.project(&with_unit_quats(&inputs), &view.pose, &view.plane)))?;
    let n = splats.len();
    let fields = (
        array(py, splats.means2d.into_flattened(), &[n, 2])?,
        array(py, splats.conics.into_flattened(), &[n, 3])?,
        array(py, splats.depths, &[n])?,
        array(py, splats.radii, &[n])?,
        array(py, splats.opacities, &[n])?,
    );
    py.import("pwrfgs._types")?.getattr("Splats")?.call1(fields)
}

/// Renders Gaussians with the real `signals` [N, C], and keeps the state of the backward pass; see `pwrfgs.rasterize`.
#[pyfunction]
#[pyo3(signature = (means, quats, scales, opacities, signals, pose, height, width, projector, rasterizer, elevation_deg))]
#[allow(clippy::too_many_arguments)] // columns with names, as Python has them
pub(crate) fn draw<'py>(
    py: Python<'py>,
    means: &Bound<'py, PyAny>,
    quats: &Bound<'py, PyAny>,
    scales: &Bound<'py, PyAny>,
    opacities: &Bound<'py, PyAny>,
    signals: &Bound<'py, PyAny>,
    pose: &Bound<'py, PyAny>,
    height: usize,
    width: usize,
    projector: &Bound<'py, PyAny>,
    rasterizer: &Bound<'py, PyAny>,
    elevation_deg: [f64; 2],
) -> PyResult<Drawing> {
    let view = View::new(projector, rasterizer, pose, (height, width), elevation_deg)?;
    let columns = read_primitives(means, quats, scales, opacities)?;
    if axis_count(signals)? == 1 {
        return reject(py, "signals has one axis of real numbers; give complex ones [N], or real ones [N, C]");
    }
    let signals = input_array::<Real>("signals", signals, &[Some(columns.len()), None])?;
    let channels = signals.shape()[1];
    if channels == 0 {
        return reject(py, "signals has no channel; give [N, C] with C of 1 at least");
    }
    check_memory::<Real>(&[channels, height, width])?;
    let signals = signals.as_slice().map_err(|e| input_error(py, &e.to_string()))?.to_vec();
    if view.rasterizer.is_coherent() && channels % 2 == 1 {
        return reject(py, "signals: waves have two numbers each, a real and an imaginary part");
    }
    if !signals.iter().all(|v| v.is_finite()) {
        return reject(py, "signals holds a number that is not finite");
    }
    without_gil(py, move || {
        let splats = view.projector.project(&with_unit_quats(&columns), &view.pose, &view.plane);
        let render = view.rasterizer.forward(splats.with_signals(&signals, channels, &view.plane));
        Ok(Drawing { view, inputs: columns, splats, signals, channels, render })
    })
}

#[pymethods]
impl Drawing {
    /// Blended signals [channels, H, W].
    #[getter]
    fn image<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let ImagePlane { width, height, .. } = self.view.plane;
        array(py, self.render.pixels.clone(), &[self.channels, height, width]).map(Bound::into_any)
    }

    /// Transmittance behind the last splat [H, W]; None without occlusion.
    #[getter]
    fn transmittance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let ImagePlane { width, height, .. } = self.view.plane;
        let values = &self.render.transmittance;
        (!values.is_empty()).then(|| array(py, values.clone(), &[height, width]).map(Bound::into_any)).transpose()
    }

    /// Gradients for (means, quats, scales, opacities, signals) and for position and orientation of the receiver, given the
    /// gradient `d_image` of the image. Those of the receiver hold for the projector `Mercator`.
    fn backward<'py>(&self, py: Python<'py>, d_image: &Bound<'py, PyAny>) -> PyResult<Vec<Bound<'py, PyAny>>> {
        let View { projector, rasterizer, pose, plane } = &self.view;
        let shape = [Some(self.channels), Some(plane.height), Some(plane.width)];
        let d_pixels = numbers::<Real>("d_image", d_image, &shape)?;
        let (d, d_signals, (d_position, d_orientation)) = without_gil(py, || {
            let splats = self.splats.with_signals(&self.signals, self.channels, plane);
            let vjp = rasterizer.backward(splats, &self.render, &d_pixels);
            let primitives = with_unit_quats(&self.inputs);
            let mut d = projector.project_vjp(&primitives, pose, plane, &self.splats, &vjp.splats);
            let d_pose = primitives.pose_vjp(pose, &d);
            d.quats.iter_mut().zip(&self.inputs.quats).for_each(|(d, q)| *d = normalise_quat_vjp(*q, *d));
            Ok((d, vjp.signals, d_pose))
        })?;
        let n = self.inputs.len();
        Ok(vec![
            array(py, d.means.into_flattened(), &[n, 3])?.into_any(),
            array(py, d.quats.into_flattened(), &[n, 4])?.into_any(),
            array(py, d.scales.into_flattened(), &[n, 3])?.into_any(),
            array(py, d.opacities, &[n])?.into_any(),
            array(py, d_signals, &[n, self.channels])?.into_any(),
            array(py, d_position.to_vec(), &[3])?.into_any(),
            array(py, d_orientation.to_vec(), &[4])?.into_any(),
        ])
    }
}
