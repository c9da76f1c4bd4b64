//! Options and progress reports of the search for virtual transmitters.

use crate::virtual_transmitters::harmonics::HIGHEST;

/// Maximum number of sources.
const MOST: usize = 1_000;

/// Options of [`crate::virtual_transmitters::pursue`].
#[derive(Clone, Debug, PartialEq)]
pub struct PursuitOptions {
    /// Extension of the grid beyond the positions of the moving node in every direction, relative to the longest side
    /// of their bounding box.
    pub reach: f64,
    /// Grid spacing near those positions, in units of the shortest wavelength; a quarter or less finds every maximum.
    pub step: f64,
    /// Maximum number of virtual transmitters.
    pub most: usize,
    /// The search stops after this number of additions without a better score on the held-out items.
    pub patience: usize,
    /// One of this number of items is held out to choose the number of sources. With 0 or 1, none is held out and all
    /// `most` are kept.
    pub hold_out: usize,
    /// Maximum number of values for the scores of the grid, and for the refinement of positions.
    pub rows: [usize; 2],
    /// Weight of the ridge penalty on |s|², relative to the noise-to-signal ratio estimated by the fit; 1 is the
    /// Bayesian choice.
    pub ridge: f64,
    /// Refinement steps after every addition.
    pub steps: usize,
    /// Number of rounds that remove sources and add others.
    pub rounds: usize,
    /// Log odds above which a candidate is accepted without a new sweep of the whole grid.
    pub beyond_doubt: f64,
    /// Number of grid peaks that are refined before the best is selected.
    pub peaks: usize,
    /// Position of the fixed node, metres, if known: a candidate that needs little evidence.
    pub node: Option<[f64; 3]>,
    /// Whether mirror images of sources already found are candidates; they need less evidence, because they are few.
    pub images: bool,
    /// Order of the harmonics of gains over direction, at most 3; 0 for gains that are equal in all directions.
    pub order: usize,
    /// Seed of the held-out items and of the rows.
    pub seed: u64,
}

impl Default for PursuitOptions {
    fn default() -> Self {
        Self {
            reach: 2.0,
            step: 0.25,
            most: 64,
            patience: 8,
            hold_out: 5,
            rows: [2048, 16_384],
            ridge: 1.0,
            steps: 10,
            rounds: 2,
            beyond_doubt: 10.0,
            peaks: 256,
            node: None,
            images: true,
            order: 0,
            seed: 0,
        }
    }
}

/// Progress of a search, reported after every addition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchProgress {
    /// Whether the number of sources is fixed and all items are fitted; otherwise some items are held out.
    pub last_pass: bool,
    /// Current number of sources.
    pub sources: usize,
    /// SNR on the fitted items, dB.
    pub fitted: f64,
    /// SNR on the held-out items, dB; equal to `fitted` without held-out items.
    pub held_out: f64,
    /// Log odds that the last source is not an accident among all candidates.
    pub proof: f64,
    /// Whether the last source was the mirror image of another.
    pub image: bool,
}

impl PursuitOptions {
    /// Checks the values; the error is a message for users.
    pub fn check(&self) -> Result<(), String> {
        if !(0.0..=100.0).contains(&self.reach) {
            return Err(format!("`reach` is {}; give 0 to 100, such as 2", self.reach));
        }
        if !(0.01..=1.0).contains(&self.step) {
            return Err(format!("`step` is {}; give 0.01 to 1 wavelength, such as 0.25", self.step));
        }
        if !(self.ridge >= 0.0 && self.ridge.is_finite()) {
            return Err(format!("`ridge` is {}; give 0 or more, such as 1", self.ridge));
        }
        if self.order > HIGHEST {
            return Err(format!("`order` is {}; give 0 to {HIGHEST}, such as 2", self.order));
        }
        if !(1..=MOST).contains(&self.most) {
            return Err(format!("`most` is {}; give 1 to {MOST}, such as 32", self.most));
        }
        if self.patience == 0 || self.peaks == 0 || self.rows.contains(&0) {
            return Err("`patience`, `peaks` and `rows` must each be 1 or more".into());
        }
        Ok(())
    }
}
