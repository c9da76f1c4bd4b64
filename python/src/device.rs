//! Device of the process: the CPU, or a GPU for the networks.

use crate::border::without_gil;
use pwrfgs_core::Error;
use pwrfgs_core::device::{self, DeviceChoice};
use pyo3::prelude::*;

/// GPUs of this machine, in the order of their numbers: names with interface and driver, such as
/// ``NVIDIA H100 (Vulkan, 580.159)``. Software GPUs, which are slower than the CPU, are marked.
#[pyfunction]
pub(crate) fn devices(py: Python<'_>) -> PyResult<Vec<String>> {
    let mark = |(name, is_software): (String, bool)| if is_software { name + ", a software GPU" } else { name };
    without_gil(py, || Ok(pwrfgs::device::list_gpus()?.into_iter().map(mark).collect()))
}

/// Select where the networks of this process run: ``"cpu"``, ``"gpu"``, ``"auto"``, or a number of ``devices()``. Returns the
/// name of the device.
///
/// The choice holds for all functions, and must precede the first computation. A process of an executor has its own choice:
/// ``ProcessPoolExecutor(initializer=pwrfgs.use_device, initargs=("gpu",))``.
#[pyfunction]
pub(crate) fn use_device(py: Python<'_>, device: &Bound<'_, PyAny>) -> PyResult<String> {
    let text = device.str()?.to_string();
    without_gil(py, || {
        let choice: DeviceChoice = text.parse().map_err(|why| Error::Config(format!("--device `{text}`: {why}")))?;
        pwrfgs::device::select(choice)?;
        Ok(device::name().unwrap_or("CPU").to_owned())
    })
}
