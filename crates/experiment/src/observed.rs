//! How much of what was observed, in words.

use crate::text::grouped;
use pwrfgs_core::{Dataset, Observations, Task};

/// `33,600 received powers at 21 receivers`, `1,000 channels of 16 antennas x 16 subcarriers`, `980 spectra of 360 x 90 pixels`.
pub fn observed(data: &Dataset) -> String {
    let receivers = data.scene.receivers.len();
    let of = match &data.observations {
        Observations::Channels(c) => format!(" of {} antennas x {} subcarriers", c.antennas, c.frequencies_hz.len()),
        _ if data.task() == Task::Power => String::new(),
        _ => format!(" of {} x {} pixels", data.width, data.height),
    };
    let what = if data.task() == Task::Power { data.task().plural } else { data.task().counted[1] };
    let at = if receivers > 1 { format!(" at {receivers} receivers") } else { String::new() };
    format!("{} {what}{of}{at}", grouped(data.len() as i64))
}
