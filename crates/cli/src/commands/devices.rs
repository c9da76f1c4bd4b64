//! `--device` and `pwrfgs devices`: selects the GPU of the process, and lists those of the machine.

use pwrfgs_core::device::{self, DeviceChoice};
use pwrfgs_core::{Error, Real, Result};

/// Selects the device of `--device`, or of the environment without it.
///
/// # Errors
/// [`Error::Config`] if there is no such GPU, or this program cannot use it.
pub(crate) fn set_device(choice: Option<DeviceChoice>) -> Result<()> {
    let choice = choice.map_or_else(device::from_environment, Ok)?;
    device::set_choice(choice);
    let needs_gpu = !matches!(choice, DeviceChoice::Cpu | DeviceChoice::Auto);
    if size_of::<Real>() != size_of::<f32>() {
        let why = "this program computes in double precision, which is for the CPU; leave --device out";
        return if needs_gpu { Err(Error::Config(format!("--device {choice}: {why}"))) } else { Ok(()) };
    }
    #[cfg(feature = "gpu")]
    return pwrfgs_gpu::select(choice);
    #[cfg(not(feature = "gpu"))]
    if needs_gpu { Err(no_gpu_support(&format!("--device {choice}"))) } else { Ok(()) }
}

/// Returns the error of a program that was compiled without the feature `gpu`.
#[cfg(not(feature = "gpu"))]
fn no_gpu_support(what: &str) -> Error {
    Error::Config(format!(
        "{what}: this program was compiled without GPU support; compile it with `cargo build --release --features gpu`, or use \
         the CPU"
    ))
}

/// Runs `pwrfgs devices`: prints number and name of each GPU.
///
/// # Errors
/// [`Error::Config`] in a program without GPU support; [`Error::Write`] to the output.
#[cfg(feature = "gpu")]
pub(crate) fn print_devices() -> Result<()> {
    let number = |(number, line): (usize, pwrfgs_gpu::GpuLine)| {
        let note = if line.is_software { "a software GPU, slower than the CPU" } else { "" };
        vec![number.to_string(), line.name, note.to_owned()]
    };
    let rows: Vec<Vec<String>> = pwrfgs_gpu::list().into_iter().enumerate().map(number).collect();
    if rows.is_empty() {
        let advice = "install a driver, on a cluster set VK_DRIVER_FILES";
        return crate::output::print_result(&format!("no GPU found (Vulkan, Metal, DX12); {advice}\n"));
    }
    crate::output::print_result(&pwrfgs::experiment::text::align_columns(&rows, 0))
}

/// Runs `pwrfgs devices` without GPU support: refuses.
#[cfg(not(feature = "gpu"))]
pub(crate) fn print_devices() -> Result<()> {
    Err(no_gpu_support("devices"))
}
