//! Conversion of NumPy arrays.

use crate::border::{input_error, reject, run_stoppable};
use num_complex::Complex;
use numpy::{
    Element, IntoPyArray as _, PyArrayDyn, PyArrayMethods as _, PyReadonlyArrayDyn, PyUntypedArrayMethods as _,
};
use numpy::{PyArrayDescrMethods as _, dtype};
use pwrfgs_core::{
    AngleAxis, Dataset, Elevation, ImagePlane, Pose, Real, Spectra, Task, check_stopped, gains_of, rows_of,
};
use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};
use rayon::prelude::*;

/// Contiguous array given by a user.
pub(crate) type InputArray<'py, T> = PyReadonlyArrayDyn<'py, T>;

/// Number of observations between checks for Ctrl-C.
pub(crate) const CHUNK: usize = 64;

/// Complex number in the precision of the kernels: complex64, or complex128 in the double-precision build.
pub(crate) type Gain = Complex<Real>;

/// Converts `value` to an array of `T` in C order, without a copy if possible. `None` in `shape` accepts any length; a
/// single number counts as a vector of length 1.
///
/// # Errors
/// Not an array of numbers that `T` can hold, or another shape; `name` begins the message.
pub(crate) fn input_array<'py, T: Element>(
    name: &str,
    value: &Bound<'py, PyAny>,
    shape: &[Option<usize>],
) -> PyResult<InputArray<'py, T>> {
    let py = value.py();
    let array = match value.cast::<PyArrayDyn<T>>() {
        Ok(array) if array.is_c_contiguous() => array.clone(),
        _ => convert_array(name, value)?,
    };
    let given = array.shape();
    let is_one = given.is_empty() && matches!(shape, [None | Some(1)]);
    let fits = given.len() == shape.len() && given.iter().zip(shape).all(|(n, length)| length.is_none_or(|m| m == *n));
    if !fits && !is_one {
        let expected: Vec<String> = shape.iter().map(|n| n.map_or_else(|| "any".into(), |n| n.to_string())).collect();
        let message = format!("{name} has shape {given:?}, expected [{}]", expected.join(", "));
        return reject(py, &message);
    }
    array.try_readonly().map_err(|e| input_error(py, &format!("{name}: {e}")))
}

/// Converts a value to an array of `T` in C order through NumPy.
///
/// # Errors
/// Not an array, or of numbers that `T` cannot hold; `name` begins the message.
fn convert_array<'py, T: Element>(name: &str, value: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let py = value.py();
    let numpy = py.import("numpy")?;
    let array = numpy.call_method1("asarray", (value,));
    let array = array.map_err(|e| input_error(py, &format!("{name} is not an array: {e}")))?;
    let kind = array.getattr("dtype")?.getattr("kind")?.extract::<String>()?;
    let target = dtype::<T>(py);
    // Kinds of NumPy: float, integer, unsigned, boolean, complex.
    let accepted = match target.kind() {
        b'c' => "fiubc",
        b'b' => "b",
        b'i' => "iu",
        _ => "fiub",
    };
    let is_empty = array.getattr("size")?.extract::<usize>()? == 0; // an empty list has no kind of its own
    if !accepted.contains(kind.as_str()) && !is_empty {
        let given = array.getattr("dtype")?;
        return reject(py, &format!("{name} holds {given}, expected {target}"));
    }
    let options = PyDict::new(py);
    options.set_item("dtype", target)?;
    options.set_item("order", "C")?;
    let array = numpy.call_method("asarray", (array,), Some(&options))?;
    array.cast_into::<PyArrayDyn<T>>().map_err(Into::into)
}

/// Returns the shape of a value that NumPy can convert to an array.
pub(crate) fn array_shape(value: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
    if let Ok(array) = value.cast::<numpy::PyUntypedArray>() {
        return Ok(array.shape().to_vec());
    }
    let py = value.py();
    let shape = py.import("numpy")?.call_method1("shape", (value,));
    shape.map_err(|e| input_error(py, &format!("value is not an array: {e}")))?.extract()
}

/// Returns the number of axes of a value that NumPy can convert to an array.
pub(crate) fn axis_count(value: &Bound<'_, PyAny>) -> PyResult<usize> {
    array_shape(value).map(|shape| shape.len())
}

/// Reads one position, metres, finite.
pub(crate) fn position(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    let position = numbers::<f64>(name, value, &[Some(3)])?;
    if !position.iter().all(|v| v.is_finite()) {
        return reject(value.py(), &format!("{name} is {position:?}; give finite numbers"));
    }
    Ok([position[0], position[1], position[2]])
}

/// Reads positions `[N, 3]`, metres, finite.
pub(crate) fn positions(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<[f64; 3]>> {
    let positions: Vec<[f64; 3]> = numbers(name, value, &[None, Some(3)])?.as_chunks().0.to_vec();
    match positions.iter().position(|position| !position.iter().all(|v| v.is_finite())) {
        Some(i) => reject(value.py(), &format!("{name}[{i}] is {:?}; give finite numbers", positions[i])),
        None => Ok(positions),
    }
}

/// Reads one pose `[7]` or several `[N, 7]`: x, y, z in metres, and a quaternion x, y, z, w. Also returns whether the
/// array is one pose.
pub(crate) fn poses(name: &str, value: &Bound<'_, PyAny>) -> PyResult<(Vec<Pose>, bool)> {
    let is_single = axis_count(value)? == 1;
    let shape: &[Option<usize>] = if is_single { &[Some(7)] } else { &[None, Some(7)] };
    let values = numbers::<f64>(name, value, shape)?;
    let pose = |&[x, y, z, qx, qy, qz, qw]: &[f64; 7]| Pose { position: [x, y, z], orientation: [qx, qy, qz, qw] };
    let poses: Vec<Pose> = values.as_chunks().0.iter().map(pose).collect();
    match poses.iter().enumerate().find_map(|(i, pose)| Some((i, pose.fault()?))) {
        Some((i, (_, fault))) => reject(value.py(), &format!("{name}[{i}]: {fault}")),
        None => Ok((poses, is_single)),
    }
}

/// Reads an array of numbers of this shape, in C order, which may be infinite or NaN. Raises an exception for another
/// type or shape.
pub(crate) fn numbers<T: Element + Copy>(
    name: &str,
    value: &Bound<'_, PyAny>,
    shape: &[Option<usize>],
) -> PyResult<Vec<T>> {
    let array = input_array::<T>(name, value, shape)?;
    array.as_slice().map(<[T]>::to_vec).map_err(|e| input_error(value.py(), &e.to_string()))
}

/// Reads finite numbers of exactly this shape, such as the result of a function of a user.
pub(crate) fn finite_numbers(name: &str, value: &Bound<'_, PyAny>, shape: &[usize]) -> PyResult<Vec<Real>> {
    let shape: Vec<Option<usize>> = shape.iter().copied().map(Some).collect();
    check_finite(name, value, numbers(name, value, &shape)?)
}

/// Returns `numbers`, which were read from `value`, if all are finite.
pub(crate) fn check_finite(name: &str, value: &Bound<'_, PyAny>, numbers: Vec<Real>) -> PyResult<Vec<Real>> {
    match numbers.iter().find(|v| !v.is_finite()) {
        Some(bad) => reject(value.py(), &format!("{name} holds {bad}; give finite numbers")),
        None => Ok(numbers),
    }
}

/// Returns the shape of a column of `n` Gaussians: `[n]` for one value each, otherwise `[n, width]`.
pub(crate) fn column_shape(n: usize, width: usize) -> Vec<usize> {
    if width <= 1 { vec![n] } else { vec![n, width] }
}

/// Reads complex numbers of this shape as pairs of real and imaginary part.
pub(crate) fn complex_pairs(name: &str, value: &Bound<'_, PyAny>, shape: &[Option<usize>]) -> PyResult<Vec<[Real; 2]>> {
    Ok(numbers::<Gain>(name, value, shape)?.iter().map(|gain| [gain.re, gain.im]).collect())
}

/// Shape of an array of observations, `[lead.., axes of one]`.
#[derive(Clone, Copy)]
pub(crate) struct ObservationShape<'a> {
    pub(crate) task: Task,
    /// Columns and rows of one observation.
    pub(crate) size: (usize, usize),
    /// Axes before those of an observation.
    pub(crate) lead: &'a [usize],
}

impl<'a> ObservationShape<'a> {
    /// Returns the shape of observations such as those of `data`.
    pub(crate) fn of_data(data: &Dataset, lead: &'a [usize]) -> Self {
        Self { task: data.task(), size: (data.width, data.height), lead }
    }

    /// Lists the lengths of all axes.
    fn lengths(self) -> Vec<usize> {
        [self.lead, &self.task.shape(self.size)].concat()
    }

    /// Reads an array of observations as rows, the inverse of [`Self::array`].
    pub(crate) fn read(self, name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<Real>> {
        let shape: Vec<Option<usize>> = self.lengths().into_iter().map(Some).collect();
        if self.task.is_complex {
            return complex_pairs(name, value, &shape).map(|gains| rows_of(&gains, self.size.0));
        }
        numbers(name, value, &shape)
    }

    /// Creates the array of observations, complex if needed, or a number without axes; `rows` holds the observations in
    /// order.
    pub(crate) fn array(self, py: Python<'_>, rows: Vec<Real>) -> PyResult<Bound<'_, PyAny>> {
        let shape = self.lengths();
        if shape.is_empty() {
            return Ok(rows[0].into_pyobject(py)?.into_any());
        }
        if self.task.is_complex {
            let gains = gains_of(&rows, self.size.0.max(1)).into_iter().map(|[re, im]| Gain::new(re, im)).collect();
            return array(py, gains, &shape).map(Bound::into_any);
        }
        array(py, rows, &shape).map(Bound::into_any)
    }
}

/// Reads the elevations of the upper edge of the top row and the lower edge of the bottom row of a spectrum, degrees.
/// Raises an exception for invalid ones.
pub(crate) fn read_elevation(py: Python<'_>, [first, last]: [f64; 2]) -> PyResult<Elevation> {
    let elevation = Elevation { first, last };
    elevation.fault().map_or(Ok(elevation), |fault| reject(py, &format!("elevation_deg {fault}")))
}

/// Creates an array with one axis.
pub(crate) fn vector<T: Element>(py: Python<'_>, values: Vec<T>) -> PyResult<Bound<'_, PyArrayDyn<T>>> {
    let count = values.len();
    array(py, values, &[count])
}

/// Creates an array of this shape.
///
/// # Errors
/// NumPy rejects the array.
pub(crate) fn array<'py, T: Element>(
    py: Python<'py>,
    values: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    values.into_pyarray(py).reshape(shape.to_vec())
}

/// Checks that there is enough memory for an array of this shape.
///
/// # Errors
/// `MemoryError` if there is too little.
pub(crate) fn check_memory<T>(shape: &[usize]) -> PyResult<()> {
    let count = shape.iter().try_fold(1_usize, |count, n| count.checked_mul(*n));
    if count.is_some_and(|count| Vec::<T>::new().try_reserve_exact(count).is_ok()) {
        return Ok(());
    }
    Err(PyMemoryError::new_err(format!("not enough memory for numbers of shape {shape:?}; request fewer at a time")))
}

/// Reads link indices in their order, or those of a mask `[count]`. Raises an exception for a negative index, or one of
/// `count` or more.
pub(crate) fn link_indices(name: &str, links: &Bound<'_, PyAny>, count: usize) -> PyResult<Vec<usize>> {
    if let Ok(mask) = numbers::<bool>(name, links, &[Some(count)]) {
        return Ok((0..count).filter(|&i| mask[i]).collect());
    }
    let index = |i: i64| {
        let index = usize::try_from(i).ok().filter(|i| *i < count);
        let message = || format!("{name}: invalid link index {i} (expected 0 to below {count})");
        index.ok_or_else(|| input_error(links.py(), &message()))
    };
    numbers::<i64>(name, links, &[None])?.into_iter().map(index).collect()
}

/// Converts the observations of `links` (indices) to an array `[links, axes of one]`; Ctrl-C interrupts it. Raises an
/// exception for too little memory, or a spectrum that cannot be read.
pub(crate) fn observation_array<'py>(py: Python<'py>, data: &Dataset, links: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    let values_per_link = data.width * data.height;
    check_memory::<Real>(&[links.len(), values_per_link])?;
    let rows = run_stoppable(py, |stop| {
        let mut rows = vec![0.0; links.len() * values_per_link];
        let copy = |(row, &i): (&mut [Real], &usize)| row.copy_from_slice(&data.image(i).pixels);
        for (rows, links) in rows.chunks_mut(CHUNK * values_per_link).zip(links.chunks(CHUNK)) {
            check_stopped(stop)?;
            rows.par_chunks_exact_mut(values_per_link).zip(links).for_each(copy);
        }
        data.observations.spectra().map_or(Ok(()), Spectra::check).map(|()| rows)
    })?;
    ObservationShape::of_data(data, &[links.len()]).array(py, rows)
}

/// Returns the angles of rows `[H]` and columns `[W]` of a plane, degrees; `None` for a plane without angles.
pub(crate) fn plane_angles<'py>(py: Python<'py>, plane: &ImagePlane) -> PyResult<Option<Bound<'py, PyTuple>>> {
    let Some((azimuth, elevation)) = plane.angles else { return Ok(None) };
    let degrees = |axis: AngleAxis, n: usize| (0..n).map(|i| axis.first + i as f64 * axis.step).collect();
    let rows = vector::<f64>(py, degrees(elevation, plane.height))?;
    let columns = vector::<f64>(py, degrees(azimuth, plane.width))?;
    PyTuple::new(py, [rows, columns]).map(Some)
}
