//! Linear least squares in double precision: normal equations `JᵀJ δ = Jᵀr`, accumulated row by row, and Cholesky.
//! [`MeasurementRows`] are the measured values to which gains and positions are fitted, one row each.

use crate::virtual_transmitters::harmonics::{CLOSEST, directional_gain};
use crate::virtual_transmitters::links::{ChannelInputs, VirtualSources};
use crate::virtual_transmitters::turn::{rotate_vector, rotation_matrix};
use pwrfgs_core::{Real, SPEED_OF_LIGHT, evenly, rng, widest};
use rayon::prelude::*;

/// Normal equations: `JᵀJ` `[P,P]` (lower half, by rows), Jᵀr `[P]`, and Σr².
#[derive(Clone, Debug)]
pub(crate) struct NormalEquations {
    pub(crate) matrix: Vec<f64>,
    pub(crate) right: Vec<f64>,
    pub(crate) square: f64,
}

impl NormalEquations {
    /// Creates zeros for P unknowns.
    pub(crate) fn new(unknowns: usize) -> Self {
        Self { matrix: vec![0.0; unknowns * unknowns], right: vec![0.0; unknowns], square: 0.0 }
    }

    /// Adds four rows of J `[4,P]`, one after the other, and their residuals r.
    pub(crate) fn add_four_rows(&mut self, rows: &[f64], r: [f64; 4]) {
        widest(AddRows { to: self, rows, r });
    }

    /// Adds the sums of other rows with the same unknowns.
    pub(crate) fn add_equations(&mut self, other: &Self) {
        self.matrix.iter_mut().zip(&other.matrix).for_each(|(a, b)| *a += b);
        self.right.iter_mut().zip(&other.right).for_each(|(a, b)| *a += b);
        self.square += other.square;
    }

    /// Returns the equations without these unknowns.
    pub(crate) fn without(&self, unknowns: std::ops::Range<usize>) -> Self {
        let p = self.unknown_count();
        let kept: Vec<usize> = (0..p).filter(|i| !unknowns.contains(i)).collect();
        Self {
            matrix: kept.iter().flat_map(|i| kept.iter().map(move |k| self.matrix[i * p + k])).collect(),
            right: kept.iter().map(|i| self.right[*i]).collect(),
            square: self.square,
        }
    }

    /// Returns the number of unknowns P.
    pub(crate) fn unknown_count(&self) -> usize {
        self.right.len()
    }

    /// Returns the solution δ `[P]` with `damping` of each unknown added to the diagonal; `None` if the matrix is then not
    /// positive definite, or the solution is not finite.
    pub(crate) fn solve(&self, damping: impl Fn(usize) -> f64) -> Option<Vec<f64>> {
        let p = self.unknown_count();
        let mut l = self.matrix.clone();
        (0..p).for_each(|i| l[i * p + i] += damping(i));
        factor_cholesky(&mut l, p)?;
        let mut x = self.right.clone();
        for i in 0..p {
            let s: f64 = (0..i).map(|k| l[i * p + k] * x[k]).sum();
            x[i] = (x[i] - s) / l[i * p + i];
        }
        for i in (0..p).rev() {
            x[i] /= l[i * p + i];
            let done = x[i];
            (0..i).for_each(|k| x[k] -= l[i * p + k] * done);
        }
        x.iter().all(|x| x.is_finite()).then_some(x)
    }
}

/// Computes the Cholesky decomposition of `a` `[P,P]` in place, row by row: the lower half becomes L. `None` if a pivot
/// is not positive and finite. Same as [`pwrfgs_core::Cholesky`] with wide vectors, because every refinement step solves.
fn factor_cholesky(a: &mut [f64], p: usize) -> Option<()> {
    for i in 0..p {
        let (above, row) = a.split_at_mut(i * p);
        for j in 0..i {
            let other = &above[j * p..=j * p + j];
            let s = widest(Dot { a: &row[..j], b: &other[..j] });
            row[j] = (row[j] - s) / other[j];
        }
        let s = widest(Dot { a: &row[..i], b: &row[..i] });
        let pivot = row[i] - s;
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        row[i] = pivot.sqrt();
    }
    Some(())
}

/// Dot product in eight partial sums.
struct Dot<'a> {
    a: &'a [f64],
    b: &'a [f64],
}

impl pulp::WithSimd for Dot<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> f64 {
        let mut sums = [0.0; 8];
        let (a, a_rest) = self.a.as_chunks::<8>();
        let (b, b_rest) = self.b.as_chunks::<8>();
        for i in 0..a.len() {
            for l in 0..8 {
                sums[l] += a[i][l] * b[i][l];
            }
        }
        let mut total = 0.0;
        for l in 0..8 {
            total += sums[l];
        }
        for i in 0..a_rest.len() {
            total += a_rest[i] * b_rest[i];
        }
        total
    }
}

/// Addition of four rows of J, one after the other, and of r to the equations.
struct AddRows<'a> {
    to: &'a mut NormalEquations,
    rows: &'a [f64],
    r: [f64; 4],
}

impl pulp::WithSimd for AddRows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let NormalEquations { matrix, right, square } = self.to;
        let p = right.len();
        let (j0, rest) = self.rows.split_at(p);
        let (j1, rest) = rest.split_at(p);
        let (j2, j3) = rest.split_at(p);
        for i in 0..p {
            let (a, b, c, d) = (j0[i], j1[i], j2[i], j3[i]);
            let row = &mut matrix[i * p..=i * p + i];
            let (j0, j1, j2, j3) = (&j0[..row.len()], &j1[..row.len()], &j2[..row.len()], &j3[..row.len()]);
            for k in 0..row.len() {
                row[k] = a.mul_add(j0[k], b.mul_add(j1[k], c.mul_add(j2[k], d.mul_add(j3[k], row[k]))));
            }
            right[i] += (a * self.r[0] + b * self.r[1]) + (c * self.r[2] + d * self.r[3]);
        }
        for r in self.r {
            *square += r * r;
        }
    }
}

/// K measured values, one column per quantity.
#[derive(Clone, Debug, Default)]
pub(crate) struct MeasurementRows {
    /// Positions of the moving node `[K,3]`, metres.
    pub(crate) p: Vec<[f64; 3]>,
    /// Antenna positions in the frame of the fixed node `[K,3]`, metres.
    pub(crate) r: Vec<[f64; 3]>,
    /// Wavelengths per metre `[K]`.
    pub(crate) per_metre: Vec<f64>,
    /// Channel h `[K]`.
    pub(crate) h: Vec<[f64; 2]>,
}

impl MeasurementRows {
    /// Creates the rows of the channel `h`, `[A,F]` per position, for the positions `items` and the `values`, indices below A·F.
    /// Above `most` rows, it keeps at most `most` items, evenly, and draws an equal number of values per item at random.
    pub(crate) fn new(
        links: &ChannelInputs<'_>,
        h: &[&[[Real; 2]]],
        (items, values): (&[usize], &[usize]),
        most: usize,
        seed: u64,
    ) -> Self {
        let subcarriers = links.frequencies.len();
        let per_item = (most / items.len().max(1)).clamp(1, values.len());
        let items = evenly(items, most);
        let mut order = values.to_vec();
        let mut out = Self::default();
        for m in items {
            if per_item < values.len() {
                rng::shuffle(&mut rng::stream(seed, "rows", m as u64), &mut order);
            }
            for &k in &order[..per_item] {
                out.p.push(links.positions[m].map(f64::from));
                out.r.push(links.antennas[k / subcarriers].map(f64::from));
                out.per_metre.push(links.frequencies[k % subcarriers] / SPEED_OF_LIGHT);
                out.h.push(h[m][k].map(f64::from));
            }
        }
        out
    }

    /// Adds the rows of `other`.
    pub(crate) fn extend(&mut self, other: Self) {
        self.p.extend(other.p);
        self.r.extend(other.r);
        self.per_metre.extend(other.per_metre);
        self.h.extend(other.h);
    }

    /// Returns the number of rows K.
    pub(crate) fn len(&self) -> usize {
        self.h.len()
    }

    /// Returns Σ|h|².
    pub(crate) fn energy(&self) -> f64 {
        self.h.iter().map(|[re, im]| re * re + im * im).sum()
    }

    /// Returns the mean of |s|² over the directions of all rows and over all sources.
    pub(crate) fn mean_signal_power(&self, sources: &VirtualSources) -> f64 {
        let power = |g: usize| {
            let received = |p: &[f64; 3]| directional_gain(sources.source_gains(g), sources.positions[g], *p);
            self.p.iter().map(|p| received(p).iter().map(|x| x * x).sum::<f64>()).sum::<f64>()
                / self.len().max(1) as f64
        };
        let each: Vec<f64> = (0..sources.len()).into_par_iter().map(power).collect();
        each.iter().sum::<f64>() / sources.len().max(1) as f64
    }

    /// Returns the rows with the residual instead of h: h minus the field of `sources`.
    pub(crate) fn residual(&self, sources: &VirtualSources) -> Self {
        let rotations: Vec<_> = sources.quats.iter().map(|q| rotation_matrix(*q)).collect();
        let residual_of_row = |i: usize| {
            let mut residual = self.h[i];
            for g in 0..sources.len() {
                let e = self.wave(i, sources.positions[g], rotate_vector(&rotations[g], self.r[i])).e;
                let [x, y] = directional_gain(sources.source_gains(g), sources.positions[g], self.p[i]);
                residual = [residual[0] - (x * e[0] - y * e[1]), residual[1] - (x * e[1] + y * e[0])];
            }
            residual
        };
        let h = (0..self.len()).into_par_iter().with_min_len(1024).map(residual_of_row).collect();
        Self { h, ..self.clone() }
    }

    /// Returns the wave in row `i` of a transmitter at `v` with signal 1 and the rotated antenna `turned`.
    #[inline(always)]
    pub(crate) fn wave(&self, i: usize, v: [f64; 3], turned: [f64; 3]) -> SphericalWave {
        let by = [0, 1, 2].map(|k| v[k] + turned[k] - self.p[i][k]);
        let d = (by[0] * by[0] + by[1] * by[1] + by[2] * by[2]).sqrt().max(CLOSEST);
        let cycles = d * self.per_metre[i];
        let (sin, cos) = ((cycles - cycles.round()) * std::f64::consts::TAU).sin_cos();
        SphericalWave { by, d, e: [cos / d, -sin / d] }
    }
}

/// Wave exp(-jkd)/d, the distance d and the vector from the moving node to the antenna, metres.
pub(crate) struct SphericalWave {
    pub(crate) by: [f64; 3],
    pub(crate) d: f64,
    pub(crate) e: [f64; 2],
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_least_squares() {
        let truth = [1.0, -2.0, 0.5];
        let mut normal = NormalEquations::new(3);
        for n in 0..5 {
            let rows: Vec<f64> = (0..12).map(|k| f64::from((7 * k + 5 * n * n + k * k * n) % 11) - 5.0).collect();
            let r = std::array::from_fn(|i| (0..3).map(|k| rows[3 * i + k] * truth[k]).sum());
            normal.add_four_rows(&rows, r);
        }
        let solution = normal.solve(|_| 0.0).unwrap();
        assert!(solution.iter().zip(truth).all(|(a, b)| (a - b).abs() < 1e-10), "{solution:?}");
        assert!(NormalEquations::new(2).solve(|_| 0.0).is_none(), "no equations, no solution");
    }
}
