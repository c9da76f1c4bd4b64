//! `Voxel`: whole cells of space are the test set.

use super::{DEFAULT_VALIDATION, check_test, check_validation, finish, part};
use pwrfgs_core::{
    Dataset, Error, Partition, Real, Result, Split,
    rng::{self, Rng},
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Whole cubic cells of space are held out, drawn at random until the test share is reached.
///
/// No test sample has a training sample in its own cell, so the model must say what the field is where it was not
/// measured. Cells lie on a grid through the world's origin. The last cell drawn may overshoot the share; one cell is
/// always left to train on. Validation is drawn in the same way from the cells that remain.
///
/// * `size_m`: edge of a cell, metres; 0.2 by default.
/// * `test`: share of all samples; 0.2 by default.
/// * `validation`: share of the rest that is held out, whole cells; 0.1 by default, 0 for none.
///
/// ```
/// # use pwrfgs_core::{Plugin, Split};
/// # use pwrfgs_data as _;
/// assert!(Plugin::<dyn Split>::parse("Voxel(size_m: 0.2, test: 0.2)").is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Voxel {
    /// Edge of a cell, metres, above 0; default 0.2.
    pub size_m: f64,
    /// Share of all samples in the test set, in (0, 1); default 0.2.
    pub test: f64,
    /// Share of the others held out as whole cells, in [0, 1); default 0.1.
    pub validation: f64,
}

impl Default for Voxel {
    fn default() -> Self {
        Self { size_m: 0.2, test: 0.2, validation: DEFAULT_VALIDATION }
    }
}

impl Voxel {
    /// The grid cell of a position.
    pub(super) fn cell(&self, position: [Real; 3]) -> [i64; 3] {
        position.map(|v| (v as f64 / self.size_m).floor() as i64)
    }
}

#[typetag::serde]
impl Split for Voxel {
    fn split(&self, data: &Dataset, rng: &mut Rng) -> Result<Partition> {
        let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
        for (i, sample) in data.samples.iter().enumerate() {
            cells.entry(self.cell(sample.tx)).or_default().push(i);
        }
        let mut cells: Vec<Vec<usize>> = cells.into_values().collect();
        if cells.len() < 2 {
            let what = format!(
                "all {} samples lie in one cell of {} m; lower `size_m` of Voxel",
                data.samples.len(),
                self.size_m
            );
            return Err(Error::Config(what));
        }
        rng::shuffle(rng, &mut cells);
        let count = data.samples.len();
        let test = draw(&mut cells, part(self.test, count));
        let validation = draw(&mut cells, part(self.validation, count - test.len()));
        finish(cells.concat(), validation, test)
    }

    fn about(&self) -> &'static str {
        "whole cells of space are the test set"
    }

    fn check(&self) -> Result<(), String> {
        if !(self.size_m.is_finite() && self.size_m > 0.0) {
            return Err(format!("`size_m` is {}; use an edge in metres above 0, such as 0.2", self.size_m));
        }
        check_test("test", self.test)?;
        check_validation(self.validation)
    }
}

/// Takes cells until they hold `wanted` samples; one cell stays.
fn draw(cells: &mut Vec<Vec<usize>>, wanted: usize) -> Vec<usize> {
    let mut drawn = Vec::new();
    while drawn.len() < wanted && cells.len() > 1 {
        drawn.extend(cells.pop().expect("more than one cell is left"));
    }
    drawn
}
