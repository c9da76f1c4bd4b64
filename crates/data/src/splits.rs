//! Splits: which samples are learned from, looked at while choosing, and read once at the end.
//!
//! On this kind of data neighbours are millimetres apart, so a random split asks for interpolation over millimetres;
//! [`TimeBlock`], [`Voxel`] and [`Sparse`] ask for more. Every split can hold out a `validation` share of its training
//! part by its own rule.

mod official;
mod random;
mod sparse;
#[cfg(test)]
pub(crate) mod testing;
mod time_block;
mod voxel;

pub use official::Official;
pub use random::Random;
pub use sparse::Sparse;
pub use time_block::TimeBlock;
pub use voxel::Voxel;

use pwrfgs_core::{
    Error, Partition, Result,
    rng::{self, Rng},
};

/// Share of the training part that a split holds out unless told otherwise.
const DEFAULT_VALIDATION: f64 = 0.1;

/// `share` of `n`, rounded, but at least one where the share is positive, and never all.
fn part(share: f64, n: usize) -> usize {
    let wanted = (share * n as f64).round() as usize;
    wanted.max(usize::from(share > 0.0)).min(n.saturating_sub(1))
}

/// Moves a random `share` of `train` to a list of its own: (train, validation).
fn hold_out(mut train: Vec<usize>, share: f64, rng: &mut Rng) -> (Vec<usize>, Vec<usize>) {
    if share == 0.0 {
        return (train, Vec::new());
    }
    rng::shuffle(rng, &mut train);
    let validation = train.split_off(train.len() - part(share, train.len()));
    (train, validation)
}

/// The partition with its lists sorted; refuses one without training or test samples.
fn finish(mut train: Vec<usize>, mut validation: Vec<usize>, mut test: Vec<usize>) -> Result<Partition> {
    for (name, list) in [("training", &train), ("test", &test)] {
        if list.is_empty() {
            return Err(Error::Config(format!(
                "the split leaves no {name} sample of {} in all; change its shares or give more samples",
                train.len() + validation.len() + test.len()
            )));
        }
    }
    train.sort_unstable();
    validation.sort_unstable();
    test.sort_unstable();
    Ok(Partition { train, validation, test })
}

/// Refuses a validation share outside [0, 1).
fn check_validation(share: f64) -> Result<(), String> {
    if (0.0..1.0).contains(&share) {
        return Ok(());
    }
    Err(format!("`validation` is {share}; it is a share of the training part: use 0 for none, or a number below 1"))
}

/// Refuses a test share outside (0, 1).
fn check_test(name: &str, share: f64) -> Result<(), String> {
    if share > 0.0 && share < 1.0 {
        return Ok(());
    }
    Err(format!("`{name}` is {share}; it is a share of all samples: use a number between 0 and 1, such as 0.2"))
}
