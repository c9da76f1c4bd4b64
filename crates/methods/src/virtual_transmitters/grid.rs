//! Grid of the search: a cube in shells about the links, and its cells.

/// Maximum number of cells at which a sweep starts.
pub(crate) const START: usize = 1 << 17;

/// Cube in shells, metres, and the rotations that are evaluated at each position.
#[derive(Clone, Debug)]
pub(crate) struct SearchGrid {
    /// Centre of the links.
    pub(crate) centre: [f64; 3],
    /// Longest side of the bounding box of the links.
    pub(crate) side: f64,
    /// Half an edge of the cube.
    pub(crate) half: f64,
    /// Grid spacing in the innermost shell, which extends a `side` in every direction.
    pub(crate) step: f64,
    pub(crate) quats: Vec<[f64; 4]>,
}

/// Candidate position of a source: a cell of the grid, for one rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cell {
    pub(crate) centre: [f64; 3],
    /// Edge, metres.
    pub(crate) size: f64,
    /// Index of the rotation.
    pub(crate) q: usize,
    /// Energy that it explains with its best gain per window.
    pub(crate) explains: f64,
}

/// Cells between two cubes, with the spacing `step`.
#[derive(Clone, Copy, Debug)]
struct Shell {
    /// Half an edge of the inner and of the outer cube.
    hollow: f64,
    half: f64,
    step: f64,
}

impl SearchGrid {
    /// Returns the width of maxima at `position`, relative to that inside the cube of edge `side`: it grows with the distance
    /// from the centre. Maximum moves and the distance between distinct positions scale with it.
    pub(crate) fn peak_width(&self, position: [f64; 3]) -> f64 {
        let off = [0, 1, 2].map(|k| (position[k] - self.centre[k]).abs());
        (2.0 * off.into_iter().fold(0.0, f64::max) / self.side).max(1.0)
    }

    /// Returns whether a position is inside the cube.
    pub(crate) fn contains(&self, position: [f64; 3]) -> bool {
        (0..3).all(|k| (position[k] - self.centre[k]).abs() <= self.half)
    }

    /// Returns the shells from the inside out, each twice as large and as coarse as the one before; `step` is the spacing
    /// in the innermost shell.
    fn shells(&self, step: f64) -> Vec<Shell> {
        let mut shells = vec![Shell { hollow: 0.0, half: self.half.min(self.side), step }];
        while let Some(last) = shells.last().copied().filter(|last| last.half < self.half) {
            shells.push(Shell { hollow: last.half, half: self.half.min(2.0 * last.half), step: 2.0 * last.step });
        }
        shells
    }

    /// Returns the largest spacing if that in the innermost shell is `step`, metres.
    pub(crate) fn widest_step(&self, step: f64) -> f64 {
        self.shells(step).last().map_or(step, |shell| shell.step)
    }

    /// Returns the approximate number of cells with the spacing `step` in the innermost shell: positions times rotations.
    pub(crate) fn cell_count(&self, step: f64) -> usize {
        let cube = |edge: f64, step: f64| (edge / step).powi(3);
        let positions = |s: &Shell| cube(2.0 * s.half, s.step) - cube(2.0 * s.hollow, s.step);
        (self.shells(step).iter().map(positions).sum::<f64>() as usize).max(1) * self.quats.len()
    }

    /// Iterates over the cells with the spacing `step` in the innermost shell, rotation by rotation.
    pub(crate) fn cells(&self, step: f64) -> impl Iterator<Item = Cell> {
        let shells = self.shells(step);
        (0..self.quats.len() * shells.len()).flat_map(move |i| {
            let (q, shell) = (i / shells.len(), shells[i % shells.len()]);
            let count = (2.0 * shell.half / shell.step).ceil() as usize + 1;
            let cell = move |i: usize| {
                let by =
                    [i % count, i / count % count, i / (count * count)].map(|i| i as f64 * shell.step - shell.half);
                let centre = [0, 1, 2].map(|k| self.centre[k] + by[k]);
                let outside = shell.hollow == 0.0 || by.iter().any(|x| x.abs() >= shell.hollow);
                outside.then_some(Cell { centre, size: shell.step, q, explains: 0.0 })
            };
            (0..count * count * count).filter_map(cell)
        })
    }

    /// Returns a candidate per rotation at each of `positions`.
    pub(crate) fn candidates(&self, positions: &[[f64; 3]]) -> Vec<Cell> {
        let cell = |q: usize| move |centre: &[f64; 3]| Cell { centre: *centre, size: self.step, q, explains: 0.0 };
        (0..self.quats.len()).flat_map(|q| positions.iter().map(cell(q))).collect()
    }
}

/// Returns the distance of two positions, metres.
pub(crate) fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}
