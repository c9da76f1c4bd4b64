//! `Headline`: by which number observations of a kind are judged first, on curves, in examples and while one waits.

use pwrfgs_core::Task;

/// The first metric of a kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Headline {
    /// Its key in tables of scores.
    pub key: &'static str,
    /// As an axis or a sentence has it.
    pub name: &'static str,
    /// Whether larger is better.
    pub higher: bool,
    /// Columns of `validation.csv` after the step: mean and median of it, and one number more.
    pub columns: [&'static str; 3],
}

/// That of a kind.
pub fn headline(kind: Task) -> Headline {
    match kind {
        Task::Spectrum => {
            Headline { key: "ssim", name: "SSIM", higher: true, columns: ["ssim_mean", "ssim_median", "eta_0db"] }
        }
        Task::Power => Headline {
            key: "power_error_db",
            name: "error [dB]",
            higher: false,
            columns: ["power_error_db_mean", "power_error_db_median", "power_error_db_p90"],
        },
        Task::Channel => Headline {
            key: "snr_db",
            name: "SNR [dB]",
            higher: true,
            columns: ["snr_db_mean", "snr_db_median", "snr_all_db"],
        },
    }
}
