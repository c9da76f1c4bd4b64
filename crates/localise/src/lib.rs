//! Localisation: position of a transmitter from its observations, with a region that contains it.
//!
//! ```text
//! training samples ── measured fingerprints ─┐
//! model at their positions ── predicted ─────┴► blended fingerprints [K, D]
//! observation [D] ── misfits [K] ── weights exp(-s·misfit/scale) ── density over the floor ── level ─► region, in parts
//!                                           mode of the most probable part ── descent along the model ─► position
//! ```
//! All choices use at most 1,000 samples of the validation set:
//!
//! * The density at the true positions chooses the sharpness s and the kernel width.
//! * The mean error chooses the share of the model in the fingerprints, the kernels of the mode and whether to descend.
//! * At the level, regions hold nine of ten validation samples (the rank of split conformal prediction). That is no
//!   guarantee for new samples, because the same samples choose the other settings.

mod choice;
mod descent;
mod features;
mod fingerprints;
mod locator;
mod region;

pub use choice::Choice;
pub use features::FingerprintFeatures;
pub use fingerprints::{Fingerprints, NearestFingerprints};
pub use locator::{Located, Locator, SHARES};
pub use region::Region;

use pwrfgs_core::statistics::{mean, median};

/// Maximum number of validation samples that choose settings and calibrate regions; of more, evenly spaced ones.
pub const MOST_SAMPLES: usize = 1_000;

/// Returns the mean and the median of values, such as position errors; NaN for none.
pub fn mean_and_median(values: Vec<f64>) -> [f64; 2] {
    [mean(values.iter().copied()), median(values)]
}

#[cfg(test)]
mod tests;
