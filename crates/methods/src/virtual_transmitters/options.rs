//! How the search for virtual transmitters goes, and what it tells of itself.

use crate::virtual_transmitters::harmonics::HIGHEST;

/// Sources at most.
const MOST: usize = 1_000;

/// How [`crate::virtual_transmitters::pursue`] searches.
#[derive(Clone, Debug, PartialEq)]
pub struct Pursuit {
    /// How far beyond the positions of the moving end the grid reaches in every direction, in the longest side of their box.
    pub reach: f64,
    /// Distance of the places of the grid near those positions, in the shortest wavelength; a quarter or less finds every
    /// hill.
    pub step: f64,
    /// Virtual transmitters at most.
    pub most: usize,
    /// Additions without a better score on the held-out part after which the search stops.
    pub patience: usize,
    /// One of so many items is held out while the number of sources is chosen; 0 or 1: none, all `most` are kept.
    pub hold_out: usize,
    /// Numbers that the grid is scored on, and that places are refined on, at most.
    pub rows: [usize; 2],
    /// Weight of the ridge on |s|², in the share of noise to signal that the fit itself shows; 1 is the Bayesian choice.
    pub ridge: f64,
    /// Steps of refinement after every addition.
    pub steps: usize,
    /// Times that sources are taken away and added again.
    pub rounds: usize,
    /// ln of the odds from which a candidate is taken without another look at the whole grid.
    pub beyond_doubt: f64,
    /// Peaks of the grid that are refined before the best is taken.
    pub peaks: usize,
    /// Where the fixed node is, metres, where that is known: a candidate that needs little proof.
    pub node: Option<[f64; 3]>,
    /// Whether mirror images of what was found are tried, with the smaller proof that few candidates need.
    pub images: bool,
    /// Order of the harmonics of gains over direction, at most 3; 0: gains are the same in all directions.
    pub order: usize,
    /// Seed of the held-out part and of the rows.
    pub seed: u64,
}

impl Default for Pursuit {
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

/// What a search tells of itself after every addition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Whether all items are fitted to, the number being known, or a part is held out.
    pub last_pass: bool,
    /// Sources so far.
    pub sources: usize,
    /// SNR on what is fitted to, dB.
    pub fitted: f64,
    /// SNR on the held-out part, dB; that of `fitted` where there is none.
    pub held_out: f64,
    /// ln of the odds that the last one is no accident among all candidates.
    pub proof: f64,
    /// Whether it was the mirror image of another.
    pub image: bool,
}

impl Pursuit {
    /// What is wrong with the numbers, in words for a user.
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
