//! What a page calls the things that were observed.

use pwrfgs_core::{Dataset, Task};

/// Words of a kind, in the plural and the singular.
pub(super) struct Words {
    /// As a reader counts them.
    pub(super) plural: &'static str,
    /// One of them.
    pub(super) singular: &'static str,
    /// What one is made of, `None` where it is a single number.
    pub(super) size: Option<String>,
}

/// Those of these data.
pub(super) fn words(data: &Dataset) -> Words {
    let several = |n: usize, what: &str| format!("{n} {what}{}", if n == 1 { "" } else { "s" });
    let (width, height) = (data.width, data.height);
    match data.task() {
        Task::Spectrum => {
            Words { plural: "spectra", singular: "spectrum", size: Some(format!("{width} × {height} pixels")) }
        }
        Task::Power => Words { plural: "links", singular: "link", size: None },
        Task::Channel => {
            let size = format!("{} × {}", several(height / 2, "antenna"), several(width, "subcarrier"));
            Words { plural: "channels", singular: "channel", size: Some(size) }
        }
    }
}
