//! `Conditions`: what a network is told of each transmitter.

use crate::Real;
use std::ops::Range;

/// A vector for each of B transmitters, `[B, width]`: its position as a rule, metres from the origin; whatever stands in
/// its place otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions<'a> {
    width: usize,
    values: &'a [Real],
}

impl<'a> Conditions<'a> {
    /// Rows of `width` numbers; half a row at the end is left out.
    pub fn new(width: usize, values: &'a [Real]) -> Self {
        let whole = values.len() - values.len() % width.max(1);
        Self { width, values: &values[..whole] }
    }

    /// B, transmitters.
    pub fn len(&self) -> usize {
        self.values.len() / self.width.max(1)
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// Numbers of each.
    pub fn width(&self) -> usize {
        self.width
    }

    /// All numbers, row by row.
    pub fn values(&self) -> &'a [Real] {
        self.values
    }

    /// Some of the transmitters.
    pub fn rows(&self, range: Range<usize>) -> Self {
        Self { width: self.width, values: &self.values[range.start * self.width..range.end * self.width] }
    }

    /// The positions `[B,3]`; nothing where they are something else. A deformation that asks for positions says so by
    /// [`DeformationTraits::inputs`](crate::DeformationTraits::inputs), and is given nothing else.
    pub fn positions(&self) -> &'a [[Real; 3]] {
        if self.width == 3 { self.values.as_chunks().0 } else { &[] }
    }
}

impl<'a> From<&'a [[Real; 3]]> for Conditions<'a> {
    fn from(positions: &'a [[Real; 3]]) -> Self {
        Self { width: 3, values: positions.as_flattened() }
    }
}

impl<'a> From<&'a Vec<[Real; 3]>> for Conditions<'a> {
    fn from(positions: &'a Vec<[Real; 3]>) -> Self {
        positions.as_slice().into()
    }
}

impl<'a, const B: usize> From<&'a [[Real; 3]; B]> for Conditions<'a> {
    fn from(positions: &'a [[Real; 3]; B]) -> Self {
        positions.as_slice().into()
    }
}
