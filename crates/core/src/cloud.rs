//! `GaussianCloud`: learned parameters before activation, one column per quantity.

use crate::Real;
use serde::{Deserialize, Serialize};

/// N Gaussians before activation. Gradients and moments of Adam have the same type: a cloud is a vector space.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussianCloud {
    /// Centres μ `[N,3]`, metres from the origin of the data set, world axes.
    pub means: Vec<[Real; 3]>,
    /// Natural logarithms of the scales `[N,3]`, scales in metres.
    pub log_scales: Vec<[Real; 3]>,
    /// Rotations `[N,4]` as w, x, y, z; normalised on use.
    pub quats: Vec<[Real; 4]>,
    /// Opacity logits `[N]`; opacity o = σ(logit).
    pub opacity_logits: Vec<Real>,
    /// Complex signals s as two real channels `[N,2]`.
    pub signals: Vec<[Real; 2]>,
    /// Columns that the method requests, such as `harmonics`, and that pruners request, such as `mask_logits`. Saved
    /// models do not contain the latter.
    pub extra: Vec<ExtraColumn>,
}

/// Named column `[N, width]` of a method or a pruner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExtraColumn {
    /// Name of the column.
    pub name: String,
    /// Number of values per Gaussian.
    pub width: usize,
    /// Row-major values, `[len · width]`.
    pub values: Vec<Real>,
}

/// Names of the five fixed columns, in the order of [`GaussianCloud::columns`].
pub const COLUMN_NAMES: [&str; 5] = ["means", "log_scales", "quats", "opacity_logits", "signals"];

impl GaussianCloud {
    /// Creates N rows of zeros without extra columns.
    pub fn zeros(n: usize) -> Self {
        Self {
            means: vec![[0.0; 3]; n],
            log_scales: vec![[0.0; 3]; n],
            quats: vec![[0.0; 4]; n],
            opacity_logits: vec![0.0; n],
            signals: vec![[0.0; 2]; n],
            extra: Vec::new(),
        }
    }

    /// Returns the number of Gaussians N.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Returns whether N = 0.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Returns every column as (name, width, row-major values): those of [`COLUMN_NAMES`], then the extra ones.
    pub fn columns(&self) -> impl Iterator<Item = (&str, usize, &[Real])> {
        let fixed = [
            (COLUMN_NAMES[0], 3, self.means.as_flattened()),
            (COLUMN_NAMES[1], 3, self.log_scales.as_flattened()),
            (COLUMN_NAMES[2], 4, self.quats.as_flattened()),
            (COLUMN_NAMES[3], 1, self.opacity_logits.as_slice()),
            (COLUMN_NAMES[4], 2, self.signals.as_flattened()),
        ];
        fixed.into_iter().chain(self.extra.iter().map(|c| (c.name.as_str(), c.width, c.values.as_slice())))
    }

    /// Returns every column, mutable, in the order of [`Self::columns`].
    pub fn columns_mut(&mut self) -> impl Iterator<Item = (&str, usize, &mut [Real])> {
        let fixed = [
            (COLUMN_NAMES[0], 3, self.means.as_flattened_mut()),
            (COLUMN_NAMES[1], 3, self.log_scales.as_flattened_mut()),
            (COLUMN_NAMES[2], 4, self.quats.as_flattened_mut()),
            (COLUMN_NAMES[3], 1, self.opacity_logits.as_mut_slice()),
            (COLUMN_NAMES[4], 2, self.signals.as_flattened_mut()),
        ];
        fixed.into_iter().chain(self.extra.iter_mut().map(|c| (c.name.as_str(), c.width, c.values.as_mut_slice())))
    }

    /// Adds a column of zeros for each missing entry of `expected` (name and width).
    ///
    /// # Errors
    /// A column has another width; entries before it are then added.
    pub fn add_missing_columns(&mut self, expected: &[(&str, usize)]) -> Result<(), String> {
        for &(name, width) in expected {
            match self.extra(name) {
                Some(column) if column.width == width => {}
                Some(column) => return Err(format!("column `{name}` has width {}, expected {width}", column.width)),
                None => {
                    let values = vec![0.0; self.len() * width];
                    self.extra.push(ExtraColumn { name: name.into(), width, values });
                }
            }
        }
        Ok(())
    }

    /// Returns the extra column `name`; `None` if there is none.
    pub fn extra(&self, name: &str) -> Option<&ExtraColumn> {
        self.extra.iter().find(|c| c.name == name)
    }

    /// Creates a cloud of the same columns and length, all zero.
    pub fn zeros_like(&self) -> Self {
        let mut zeros = self.clone();
        zeros.columns_mut().for_each(|(_, _, values)| values.fill(0.0));
        zeros
    }

    /// Returns the listed rows, in that order; rows may repeat.
    pub fn select(&self, rows: &[usize]) -> Self {
        fn pick<T: Copy>(column: &[T], rows: &[usize]) -> Vec<T> {
            rows.iter().map(|&i| column[i]).collect()
        }
        Self {
            means: pick(&self.means, rows),
            log_scales: pick(&self.log_scales, rows),
            quats: pick(&self.quats, rows),
            opacity_logits: pick(&self.opacity_logits, rows),
            signals: pick(&self.signals, rows),
            extra: self
                .extra
                .iter()
                .map(|c| ExtraColumn {
                    name: c.name.clone(),
                    width: c.width,
                    values: rows.iter().flat_map(|&i| &c.values[i * c.width..(i + 1) * c.width]).copied().collect(),
                })
                .collect(),
        }
    }
}

/// Origin of a row of a new cloud.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowOrigin {
    /// The same Gaussian: it keeps the moments of the optimiser and its statistics.
    Kept(usize),
    /// A copy of that Gaussian, or one merged from several: its moments start at 0.
    Copied(usize),
}

impl RowOrigin {
    /// Returns the row of the old cloud.
    pub fn source(self) -> usize {
        match self {
            Self::Kept(i) | Self::Copied(i) => i,
        }
    }
}

/// Result of [`crate::Pruner::edit`]: a cloud with moved or merged Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub struct CloudEdit {
    /// New Gaussians, with all columns.
    pub cloud: GaussianCloud,
    /// Row of the old cloud that each of them continues.
    pub rows: Vec<RowOrigin>,
}
