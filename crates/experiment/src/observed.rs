//! How much of what was observed, in words.

use crate::text::grouped;
use pwrfgs_core::Dataset;

/// `33,600 received powers at 21 receivers`, `1,000 channels of 16 antennas x 16 subcarriers`, `980 spectra of 360 x 90 pixels`.
pub fn observed(data: &Dataset) -> String {
    let (task, receivers) = (data.task(), data.scene.receivers.len());
    let of = task.size_text((data.width, data.height)).map_or_else(String::new, |size| format!(" of {size}"));
    let at = if receivers > 1 { format!(" at {receivers} receivers") } else { String::new() };
    format!("{} {}{of}{at}", grouped(data.len() as i64), task.plural)
}
