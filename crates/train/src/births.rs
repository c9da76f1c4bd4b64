//! `Births`: who a Gaussian is, whatever row it stands in.

use pwrfgs_core::Row;

/// A number for each Gaussian, in the order in which they came to be; it stays while rows move.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Births {
    /// Of each row.
    pub(crate) of: Vec<u32>,
    /// The next number.
    pub(crate) next: u32,
}

impl Births {
    /// Of the first `n`.
    pub(crate) fn of(n: usize) -> Self {
        Self { of: (0..n as u32).collect(), next: n as u32 }
    }

    /// Row k becomes what `rows[k]` says: the same Gaussian, or a new one.
    pub(crate) fn rewrite(&mut self, rows: &[Row]) {
        let old = std::mem::take(&mut self.of);
        let number = |row: &Row| match row {
            Row::Kept(i) => old[*i],
            Row::Copied(_) => {
                self.next += 1;
                self.next - 1
            }
        };
        self.of = rows.iter().map(number).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gaussian_keeps_its_number_and_a_copy_gets_a_new_one() {
        let mut births = Births::of(4);
        births.rewrite(&[Row::Kept(1), Row::Kept(3), Row::Copied(1)]);
        assert_eq!(births, Births { of: vec![1, 3, 4], next: 5 });
        births.rewrite(&[Row::Kept(2), Row::Copied(0)]);
        assert_eq!(births, Births { of: vec![4, 5], next: 6 });
    }
}
