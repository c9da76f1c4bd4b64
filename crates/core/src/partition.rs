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

    /// Numbers of training, validation and test links.
    pub fn sizes(&self) -> [usize; 3] {
        [&self.train, &self.validation, &self.test].map(Vec::len)
    }

    /// Returns the set that holds a link.
    pub fn set_of(&self, link: usize) -> LinkSet {
        let sets =
            [(&self.train, LinkSet::Training), (&self.validation, LinkSet::Validation), (&self.test, LinkSet::Test)];
        let found = sets.into_iter().find(|(links, _)| links.binary_search(&link).is_ok());
        found.map_or(LinkSet::Unused, |(_, set)| set)
    }
}

/// Set of a link. Pages receive its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum LinkSet {
    /// Training set.
    Training = 0,
    /// Validation set.
    Validation = 1,
    /// Test set.
    Test = 2,
    /// No set.
    Unused = 3,
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
