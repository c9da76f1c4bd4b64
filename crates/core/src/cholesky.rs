//! `Cholesky`: linear systems with a symmetric positive definite matrix, in double precision.

/// Cholesky factor L of a matrix A = L Lᵀ.
#[derive(Clone, Debug)]
pub struct Cholesky {
    /// Elements `[n,n]`, by rows; values above the diagonal are those of A.
    lower: Vec<f64>,
    n: usize,
}

impl Cholesky {
    /// Factors the matrix `a` `[n,n]`, of which the lower triangle is read; `None` if it is not positive definite.
    pub fn new(a: Vec<f64>, n: usize) -> Option<Self> {
        Self::factor_with(a, n, |pivot| (pivot > 0.0 && pivot.is_finite()).then_some(pivot))
    }

    /// Factors the matrix `a` `[n,n]`, which is positive definite up to rounding: smaller pivots than `least` become
    /// `least`.
    pub fn floored(a: Vec<f64>, n: usize, least: f64) -> Self {
        Self::factor_with(a, n, |pivot| Some(pivot.max(least))).expect("every pivot is taken")
    }

    /// Factors the matrix `a` `[n,n]`, row by row; `pivot` accepts, replaces or rejects the pivots. `None` if it
    /// rejects one.
    fn factor_with(mut a: Vec<f64>, n: usize, pivot: impl Fn(f64) -> Option<f64>) -> Option<Self> {
        for i in 0..n {
            for j in 0..=i {
                let (row, other) = (&a[i * n..i * n + j], &a[j * n..j * n + j]);
                let remainder = a[i * n + j] - row.iter().zip(other).map(|(x, y)| x * y).sum::<f64>();
                a[i * n + j] = if i == j { pivot(remainder)?.sqrt() } else { remainder / a[j * n + j] };
            }
        }
        Some(Self { lower: a, n })
    }

    /// Replaces `b` `[n]` by the solution x of A x = b.
    pub fn solve(&self, b: &mut [f64]) {
        let (l, n) = (&self.lower, self.n);
        for i in 0..n {
            let solved: f64 = (0..i).map(|j| l[i * n + j] * b[j]).sum();
            b[i] = (b[i] - solved) / l[i * n + i];
        }
        for i in (0..n).rev() {
            let solved: f64 = (i + 1..n).map(|j| l[j * n + i] * b[j]).sum();
            b[i] = (b[i] - solved) / l[i * n + i];
        }
    }

    /// Returns L `[n,n]`; values above the diagonal are those of A.
    pub fn into_factor(self) -> Vec<f64> {
        self.lower
    }

    /// Returns L⁻¹ `[n,n]`, zero above the diagonal.
    pub fn inverse_of_factor(&self) -> Vec<f64> {
        let (l, n) = (&self.lower, self.n);
        let mut inverse = vec![0.0; n * n];
        for c in 0..n {
            for i in c..n {
                let unit = if i == c { 1.0 } else { 0.0 };
                let sum: f64 = (c..i).map(|k| l[i * n + k] * inverse[k * n + c]).sum();
                inverse[i * n + c] = (unit - sum) / l[i * n + i];
            }
        }
        inverse
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cholesky_solves_system_and_inverts_factor() {
        let factor = Cholesky::new(vec![4.0, f64::NAN, 2.0, 3.0], 2).unwrap();
        let mut x = [8.0, 7.0];
        factor.solve(&mut x);
        assert!((x[0] - 1.25).abs() < 1e-15 && (x[1] - 1.5).abs() < 1e-15, "{x:?}");
        let inverse = factor.inverse_of_factor();
        // L = [[2, 0], [1, √2]].
        assert!((inverse[0] - 0.5).abs() < 1e-15 && inverse[1] == 0.0);
        assert!((inverse[2] + 0.5 / 2f64.sqrt()).abs() < 1e-15 && (inverse[3] - 0.5f64.sqrt()).abs() < 1e-15);
        assert!(Cholesky::new(vec![1.0, 2.0, 2.0, 1.0], 2).is_none(), "not positive");
        assert!(Cholesky::new(vec![f64::NAN], 1).is_none());
        let mut x = [1.0, 1.0];
        Cholesky::floored(vec![1.0, 1.0, 1.0, 1.0], 2, 1e-12).solve(&mut x);
        assert!(x.iter().all(|x| x.is_finite()));
    }
}
