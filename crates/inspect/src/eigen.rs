//! Eigenvalues of small symmetric matrices, by Jacobi's rotations: slow for large ones, exact for all.

/// Sweeps over all pairs; less than ten are enough.
const SWEEPS: usize = 30;

/// Eigenvalues in descending order, and their unit eigenvectors, of a symmetric matrix `[n,n]`.
pub(crate) fn symmetric(mut a: Vec<f64>, n: usize) -> (Vec<f64>, Vec<Vec<f64>>) {
    assert_eq!(a.len(), n * n, "a square matrix");
    // Row k is the k-th eigenvector.
    let mut v: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|k| f64::from(u8::from(i == k))).collect()).collect();
    let size: f64 = a.iter().map(|x| x * x).sum();
    for _ in 0..SWEEPS {
        let off: f64 = (0..n).flat_map(|p| (0..p).map(move |q| (p, q))).map(|(p, q)| a[p * n + q].powi(2)).sum();
        if off <= 1e-26 * size {
            break;
        }
        for p in 0..n {
            for q in p + 1..n {
                rotate(&mut a, &mut v, n, (p, q));
            }
        }
    }
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|i, k| a[k * n + k].total_cmp(&a[i * n + i]));
    (order.iter().map(|&i| a[i * n + i]).collect(), order.iter().map(|&i| std::mem::take(&mut v[i])).collect())
}

/// Makes the element (p, q) zero.
fn rotate(a: &mut [f64], v: &mut [Vec<f64>], n: usize, (p, q): (usize, usize)) {
    let between = a[p * n + q];
    if between == 0.0 {
        return;
    }
    let theta = (a[q * n + q] - a[p * n + p]) / (2.0 * between);
    let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
    let c = 1.0 / t.hypot(1.0);
    let s = t * c;
    let turned = |x: f64, y: f64| (c * x - s * y, s * x + c * y);
    for k in 0..n {
        (a[k * n + p], a[k * n + q]) = turned(a[k * n + p], a[k * n + q]);
    }
    for k in 0..n {
        (a[p * n + k], a[q * n + k]) = turned(a[p * n + k], a[q * n + k]);
    }
    let (below, above) = v.split_at_mut(q);
    for (x, y) in below[p].iter_mut().zip(&mut above[0]) {
        (*x, *y) = turned(*x, *y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_matrix_comes_back_from_its_eigenvectors() {
        let n = 12;
        let a: Vec<f64> =
            (0..n * n).map(|i| ((i / n + i % n) as f64).sin() + f64::from(u8::from(i / n == i % n))).collect();
        let (values, vectors) = symmetric(a.clone(), n);
        assert!(values.windows(2).all(|w| w[0] >= w[1]));
        for i in 0..n {
            for k in 0..n {
                let again: f64 = (0..n).map(|e| values[e] * vectors[e][i] * vectors[e][k]).sum();
                assert!((again - a[i * n + k]).abs() < 1e-10);
            }
        }
        assert!((values.iter().sum::<f64>() - (0..n).map(|i| a[i * n + i]).sum::<f64>()).abs() < 1e-10);
    }
}
