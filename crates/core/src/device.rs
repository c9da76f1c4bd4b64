//! Device of the process: the CPU, or the GPU that `--device` selects for networks and drawing.
//!
//! Like the number of threads, the device is state of the process and part of no pipeline and no model. Unlike threads, it
//! changes the rounding of results, so `run.json` and checkpoints name it.

use crate::{Error, Result};
use std::str::FromStr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

/// Variable that selects the device if `--device` does not.
pub const VARIABLE: &str = "PWRFGS_DEVICE";

/// Value of `--device`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The CPU.
    #[default]
    Cpu,
    /// The first GPU.
    Gpu,
    /// The GPU with this number in the list of `pwrfgs devices`.
    Number(usize),
    /// The first GPU, or the CPU if there is none.
    Auto,
}

impl FromStr for DeviceChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "cpu" => Ok(Self::Cpu),
            "gpu" => Ok(Self::Gpu),
            "auto" => Ok(Self::Auto),
            _ => {
                let expected = || "expected cpu, gpu, auto, or a number from `pwrfgs devices`".to_owned();
                text.parse().map(Self::Number).ok().ok_or_else(expected)
            }
        }
    }
}

impl std::fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Gpu => f.write_str("gpu"),
            Self::Number(number) => write!(f, "{number}"),
            Self::Auto => f.write_str("auto"),
        }
    }
}

/// Returns the device that the environment selects; the CPU if it selects none.
///
/// # Errors
/// [`Error::Config`] if [`VARIABLE`] is none of the values of `--device`.
pub fn from_environment() -> Result<DeviceChoice> {
    let text = std::env::var_os(VARIABLE).unwrap_or_default();
    if text.is_empty() {
        return Ok(DeviceChoice::Cpu);
    }
    let text = text.to_string_lossy();
    text.parse().map_err(|why| Error::Config(format!("{VARIABLE} is `{text}`: {why}")))
}

static CHOICE: OnceLock<DeviceChoice> = OnceLock::new();
/// Name of the GPU; `None` for the CPU.
static NAME: OnceLock<Option<String>> = OnceLock::new();
/// Whether the process leaves its GPU unused.
static LEFT: AtomicBool = AtomicBool::new(false);
static CPU_PART: OnceLock<String> = OnceLock::new();
/// Whether a network or a drawing has run on the GPU.
static USED: AtomicBool = AtomicBool::new(false);
static FAILURE: FirstError = FirstError(Mutex::new(None));

/// First error that was kept since the last report; `None` if there is none.
struct FirstError(Mutex<Option<Error>>);

impl FirstError {
    fn keep(&self, error: Error) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }

    fn report(&self) -> Result<()> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), Err)
    }
}

/// Returns the choice of the process; the CPU until [`set_choice`].
pub fn choice() -> DeviceChoice {
    CHOICE.get().copied().unwrap_or_default()
}

/// Sets the choice of the process; only the first call has an effect.
pub fn set_choice(choice: DeviceChoice) {
    CHOICE.get_or_init(|| choice);
}

/// Returns the name of the GPU that the process uses, such as `NVIDIA H100 (Vulkan, 580.159)`; `None` for the CPU. Unless
/// [`set_name`] precedes the first call, the process computes on the CPU from then on.
pub fn name() -> Option<&'static str> {
    NAME.get_or_init(|| None).as_deref().filter(|_| !LEFT.load(Ordering::Relaxed))
}

/// Leaves the GPU unused although one was selected. Programs whose work a GPU does not shorten call this before they
/// compute.
pub fn leave_gpu() {
    LEFT.store(true, Ordering::Relaxed);
}

/// Sets the name of the GPU; returns whether the process uses it, which is `false` once another device is settled.
pub fn set_name(name: &str) -> bool {
    NAME.get_or_init(|| Some(name.to_owned())).as_deref() == Some(name)
}

/// Returns whether a network or a drawing has run on the GPU.
pub fn is_used() -> bool {
    USED.load(Ordering::Relaxed)
}

/// Records that a network or a drawing runs on the GPU.
pub fn mark_used() {
    USED.store(true, Ordering::Relaxed);
}

/// Returns the part of a method that has no kernels for the GPU, such as `rasterizer WrfgsCompat`; `None` if
/// there was none.
pub fn cpu_part() -> Option<&'static str> {
    CPU_PART.get().map(String::as_str)
}

/// Records that a part of a method has no kernels for the GPU; only the first call has an effect.
pub fn set_cpu_part(part: &str) {
    CPU_PART.get_or_init(|| part.to_owned());
}

/// Records an error of the GPU, for [`check`]; only the first is kept.
pub fn fail(error: Error) {
    FAILURE.keep(error);
}

/// Checks that the GPU has not failed. A failed network pass returns zeros, which callers must not use.
///
/// # Errors
/// The error of the first failure; the next call succeeds.
pub fn check() -> Result<()> {
    FAILURE.report()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_read_and_written() {
        for (text, choice) in [
            ("cpu", DeviceChoice::Cpu),
            ("gpu", DeviceChoice::Gpu),
            ("auto", DeviceChoice::Auto),
            ("1", DeviceChoice::Number(1)),
        ] {
            assert_eq!(text.parse(), Ok(choice));
            assert_eq!(choice.to_string(), text);
        }
        for text in ["GPU", "", "-1", "gpu0"] {
            assert!(text.parse::<DeviceChoice>().unwrap_err().contains("`pwrfgs devices`"), "{text}");
        }
    }

    #[test]
    fn first_failure_is_reported_once() {
        let errors = FirstError(Mutex::new(None)); // that of the process would reach other tests
        errors.keep(Error::Device("out of memory".to_owned()));
        errors.keep(Error::Device("later".to_owned()));
        assert_eq!(errors.report().unwrap_err().to_string(), "--device: out of memory");
        assert!(errors.report().is_ok());
    }
}
