//! `--device` and `pwrfgs devices`: selects the GPU of the process, and lists those of the machine.

use crate::output::Verbosity;
use pwrfgs::experiment::text::grouped;
use pwrfgs::model::{Ensemble, Model};
use pwrfgs_core::device::{self, DeviceChoice};
use pwrfgs_core::{Cost, Result};

/// Rows of a network per transmitter below which a GPU does not shorten predictions: two cores need less time than it takes to
/// start the passes. An estimate, not measured on a GPU.
const FEW_ROWS: usize = 1_000;
/// Rows over all transmitters below which starting the GPU takes longer than two cores need. An estimate, not measured on a GPU.
const FEW_TERMS: usize = 250_000;

/// Selects the device of `--device`, or of the environment without it.
///
/// # Errors
/// [`Error::Config`](pwrfgs_core::Error) if the environment has no valid device, there is no such GPU, or this program cannot
/// use it.
pub(crate) fn set_device(choice: Option<DeviceChoice>) -> Result<()> {
    choice.map_or_else(device::from_environment, Ok).and_then(pwrfgs::device::select)
}

/// Selects the CPU for `count` predictions per receiver if no model becomes faster on the GPU, and prints the reason.
pub(crate) fn choose_for_predictions(ensemble: &Ensemble, count: usize, verbosity: Verbosity) {
    let Some(name) = device::name() else { return };
    let reasons: Option<Vec<String>> = ensemble.members().iter().map(|model| reason_for_cpu(model, count)).collect();
    if let Some(reason) = reasons.and_then(|reasons| reasons.into_iter().next()) {
        device::leave_gpu();
        verbosity.print_note(&format!("note: the CPU predicts, not {name}: {reason}"));
    }
}

/// Returns why a GPU is not expected to shorten `count` predictions per receiver; `None` if it is.
fn reason_for_cpu(model: &Model, count: usize) -> Option<String> {
    let (setup, n) = (&model.stages.setup, model.cloud.len());
    let Cost { runs_on_gpu, network_rows, .. } = model.stages.method.cost(setup, 1, setup.value_count());
    let rows = n + network_rows;
    if !runs_on_gpu {
        return Some("the network of this model does not run on a GPU".to_owned());
    }
    let shown = |number: usize| grouped(number as i64);
    if rows < FEW_ROWS {
        return Some(format!("N = {}, and a GPU helps from about {}", shown(n), shown(FEW_ROWS)));
    }
    let least = FEW_TERMS.div_ceil(rows);
    let positions = if count == 1 { "position" } else { "positions" };
    (count < least).then(|| format!("{} {positions}, and a GPU helps from about {}", shown(count), shown(least)))
}

/// Runs `pwrfgs devices`: prints number and name of each GPU, and a note on a software GPU.
///
/// # Errors
/// [`Error::Config`](pwrfgs_core::Error) in a program without GPU support, or the output cannot be written.
pub(crate) fn print_devices() -> Result<()> {
    let cells = |(number, (name, is_software)): (usize, (String, bool))| {
        let note = if is_software { "a software GPU, slower than the CPU" } else { "" };
        vec![number.to_string(), name, note.to_owned()]
    };
    let rows: Vec<Vec<String>> = pwrfgs::device::list_gpus()?.into_iter().enumerate().map(cells).collect();
    if rows.is_empty() {
        let advice = "install a driver, on a cluster set VK_DRIVER_FILES";
        return crate::output::print_result(&format!("no GPU found (Vulkan, Metal, DX12); {advice}\n"));
    }
    crate::output::print_result(&pwrfgs::experiment::text::align_columns(&rows, 0))
}
