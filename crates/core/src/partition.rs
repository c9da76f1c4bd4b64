//! `Partition`: which links serve what.

/// Which links serve what; indices into [`Dataset::links`](crate::Dataset::links), each list sorted, the lists disjoint.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Partition {
    /// What the model learns from.
    pub train: Vec<usize>,
    /// What curves and choices look at.
    pub validation: Vec<usize>,
    /// Read once, at the end.
    pub test: Vec<usize>,
}

impl Partition {
    /// All but the test part.
    pub fn known(&self) -> Known<'_> {
        Known { train: &self.train, validation: &self.validation }
    }

    /// Set of a link as pages number it: 0 training, 1 validation, 2 test, 3 none of them.
    pub fn set_of(&self, link: usize) -> u8 {
        let sets = [&self.train, &self.validation, &self.test];
        sets.iter().zip(0..).find(|(set, _)| set.binary_search(&link).is_ok()).map_or(3, |(_, number)| number)
    }
}

/// The links that a baseline may learn from; indices into [`Dataset::links`](crate::Dataset::links), two disjoint lists.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Known<'a> {
    /// What a model learns from, too.
    pub train: &'a [usize],
    /// What choices are made on, where there are any to make. Then it is learned from like the rest.
    pub validation: &'a [usize],
}

impl<'a> Known<'a> {
    /// A training part without validation.
    pub fn train(train: &'a [usize]) -> Self {
        Self { train, validation: &[] }
    }

    /// Training and validation together, sorted.
    pub fn all(&self) -> Vec<usize> {
        let mut all = [self.train, self.validation].concat();
        all.sort_unstable();
        all
    }
}
