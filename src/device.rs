//! Device of the process, as `--device` and Python's `use_device` select it: the CPU, or a GPU for the networks.

use pwrfgs_core::device::{self, DeviceChoice};
use pwrfgs_core::{Error, Real, Result};

/// Selects the device of the process.
///
/// # Errors
/// [`Error::Config`] if there is no such GPU, this build cannot use it, or the process computes on another device.
pub fn select(choice: DeviceChoice) -> Result<()> {
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

/// Returns the names of the GPUs of this machine in the order of their numbers, each with whether it is a software GPU,
/// which is slower than the CPU.
///
/// # Errors
/// [`Error::Config`] in a program without GPU support.
#[cfg(feature = "gpu")]
pub fn list_gpus() -> Result<Vec<(String, bool)>> {
    Ok(pwrfgs_gpu::list().into_iter().map(|line| (line.name, line.is_software)).collect())
}

/// Refuses to list the GPUs of this machine, since this program was compiled without GPU support.
///
/// # Errors
/// Always [`Error::Config`].
#[cfg(not(feature = "gpu"))]
pub fn list_gpus() -> Result<Vec<(String, bool)>> {
    Err(no_gpu_support("devices"))
}

/// Creates the error for `subject` in a program that was compiled without the feature `gpu`.
#[cfg(not(feature = "gpu"))]
fn no_gpu_support(subject: &str) -> Error {
    Error::Config(format!(
        "{subject}: this program was compiled without GPU support; compile it with `cargo build --release --features gpu`, or \
         use the CPU"
    ))
}

#[cfg(any(feature = "f64", not(feature = "gpu")))]
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gpu_is_refused_with_the_reason() {
        let is_double = size_of::<Real>() == size_of::<f64>();
        let why = if is_double {
            "this program computes in double precision, which is for the CPU; leave --device out"
        } else {
            "this program was compiled without GPU support; compile it with `cargo build --release --features gpu`, or use \
             the CPU"
        };
        for choice in [DeviceChoice::Gpu, DeviceChoice::Number(0)] {
            assert_eq!(select(choice).unwrap_err().to_string(), format!("--device {choice}: {why}"));
        }
        assert!(select(DeviceChoice::Cpu).is_ok() && select(DeviceChoice::Auto).is_ok());
        assert_eq!(device::name(), None);
    }
}
