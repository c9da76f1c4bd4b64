//! `Edit`: a cloud with other rows, and where each comes from.

use crate::GaussianCloud;

/// Where a row of the new cloud comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Row {
    /// The same Gaussian: it keeps the optimiser's moments and its statistics.
    Kept(usize),
    /// A copy of that Gaussian, or one made of several: its moments start at 0.
    Copied(usize),
}

impl Row {
    /// The row of the old cloud.
    pub fn source(self) -> usize {
        match self {
            Self::Kept(i) | Self::Copied(i) => i,
        }
    }
}

/// What [`crate::Pruner::edit`] makes of a cloud: some Gaussians moved onto others, or merged.
#[derive(Clone, Debug, PartialEq)]
pub struct Edit {
    /// The Gaussians as they shall be, with all columns.
    pub cloud: GaussianCloud,
    /// For each of them the row of the old cloud that it continues.
    pub rows: Vec<Row>,
}
