//! Dense products and elementwise passes on chunks of Gaussians: the arithmetic of every layer.
//!
//! A chunk of R Gaussians with F features is feature-major, `[F, R]`: the Gaussians are contiguous. A weight `[out,
//! in]` therefore multiplies from the left without a transposition (row-major chunks need one per chunk: 54 instead of
//! 115 GFLOP/s at 40 rows and width 256). A bias is one number per row, and every elementwise pass runs along the SIMD
//! lanes.
#![allow(unsafe_code)] // the one call into `gemm`, which takes raw pointers

use pwrfgs_core::Real;
use rayon::prelude::*;
use std::cell::Cell;
use std::ops::Range;

/// Matrix inside a slice: element (i, j) has index `i · strides.0 + j · strides.1`.
#[derive(Clone, Copy, Debug)]
pub struct Matrix<'a> {
    data: &'a [Real],
    shape: (usize, usize),
    strides: (usize, usize),
}

/// Mutable [`Matrix`].
#[derive(Debug)]
pub struct MatrixMut<'a> {
    data: &'a mut [Real],
    shape: (usize, usize),
    strides: (usize, usize),
}

/// Returns whether the last element of a matrix is inside its slice; `true` for an empty matrix. Strides whose products
/// overflow do not fit.
fn is_inside_slice(len: usize, (rows, columns): (usize, usize), (down, right): (usize, usize)) -> bool {
    let last = || (rows - 1).checked_mul(down)?.checked_add((columns - 1).checked_mul(right)?);
    rows == 0 || columns == 0 || last().is_some_and(|last| last < len)
}

impl<'a> Matrix<'a> {
    /// Creates a `rows` × `columns` matrix, row-major.
    pub fn new(data: &'a [Real], rows: usize, columns: usize) -> Self {
        Self::strided(data, (rows, columns), (columns, 1))
    }

    /// Creates a matrix with any strides.
    ///
    /// # Panics
    /// If the last element is outside `data`.
    pub fn strided(data: &'a [Real], shape: (usize, usize), strides: (usize, usize)) -> Self {
        assert!(is_inside_slice(data.len(), shape, strides), "a matrix lies inside its slice");
        Self { data, shape, strides }
    }

    /// Returns the transpose.
    pub fn t(self) -> Self {
        Self { shape: (self.shape.1, self.shape.0), strides: (self.strides.1, self.strides.0), ..self }
    }

    /// Splits the matrix after `rows` rows.
    fn split_rows(self, rows: usize) -> (Self, Self) {
        let (m, n) = self.shape;
        let below = &self.data[rows * self.strides.0..];
        (Self { shape: (rows, n), ..self }, Self { data: below, shape: (m - rows, n), ..self })
    }

    /// Returns the columns of `range`.
    pub fn columns(self, range: Range<usize>) -> Self {
        assert!(range.end <= self.shape.1, "columns of the matrix");
        // No columns may begin beyond the slice.
        let data = &self.data[range.start.saturating_mul(self.strides.1).min(self.data.len())..];
        Self { data, shape: (self.shape.0, range.len()), strides: self.strides }
    }
}

impl<'a> MatrixMut<'a> {
    /// Creates a `rows` × `columns` matrix, row-major.
    pub fn new(data: &'a mut [Real], rows: usize, columns: usize) -> Self {
        Self::strided(data, (rows, columns), (columns, 1))
    }

    /// Creates a matrix with any strides.
    ///
    /// # Panics
    /// If the last element is outside `data`.
    pub fn strided(data: &'a mut [Real], shape: (usize, usize), strides: (usize, usize)) -> Self {
        assert!(is_inside_slice(data.len(), shape, strides), "a matrix lies inside its slice");
        Self { data, shape, strides }
    }

    /// Returns the columns of `range`.
    pub fn columns(self, range: Range<usize>) -> Self {
        assert!(range.end <= self.shape.1, "columns of the matrix");
        let start = range.start.saturating_mul(self.strides.1).min(self.data.len()); // as [`Matrix::columns`]
        Self { data: &mut self.data[start..], shape: (self.shape.0, range.len()), strides: self.strides }
    }

    /// Splits the matrix after `rows` rows; requires [`Self::has_contiguous_rows`].
    fn split_rows(self, rows: usize) -> (Self, Self) {
        let (m, n) = self.shape;
        let (above, below) = self.data.split_at_mut(rows * self.strides.0);
        let part = |data, rows| MatrixMut { data, shape: (rows, n), strides: self.strides };
        (part(above, rows), part(below, m - rows))
    }

    /// Returns whether each row is contiguous and ends before the next.
    fn has_contiguous_rows(&self) -> bool {
        self.strides.1 == 1 && self.shape.1 <= self.strides.0
    }

    /// Borrows the matrix again, for the first of two uses.
    fn reborrow(&mut self) -> MatrixMut<'_> {
        MatrixMut { data: self.data, shape: self.shape, strides: self.strides }
    }
}

/// Treatment of previous values in the destination.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreMode {
    /// Values are overwritten.
    Set,
    /// The product is added.
    Add,
}

thread_local! {
    /// Number of threads that share the products of this thread.
    static PRODUCT_THREADS: Cell<usize> = const { Cell::new(1) };
}

/// Runs `run` with each product divided among up to `threads` threads; 0 and 1 mean the calling thread. The result does not
/// depend on their number.
pub(crate) fn run_with_product_threads<R>(threads: usize, run: impl FnOnce() -> R) -> R {
    let before = PRODUCT_THREADS.replace(threads);
    let result = run();
    PRODUCT_THREADS.set(before);
    result
}

/// Computes the matrix product `c = a·b` or `c += a·b`, on the calling thread or on those of
/// `run_with_product_threads`.
pub fn product(c: MatrixMut<'_>, store: StoreMode, a: Matrix<'_>, b: Matrix<'_>) {
    assert!(a.shape.0 == c.shape.0 && b.shape == (a.shape.1, c.shape.1), "inner and outer sizes of a product agree");
    multiply_rows(c, store, a, b, PRODUCT_THREADS.get());
}

/// Number of rows of `a` that `gemm` processes at a time.
const ROW_GROUP: usize = 6;

/// Computes a product with its rows divided among `threads` threads. Every part has so many rows that `gemm` adds up an
/// element in the same order as without the division.
fn multiply_rows(c: MatrixMut<'_>, store: StoreMode, a: Matrix<'_>, b: Matrix<'_>, threads: usize) {
    let ((m, n), k) = (c.shape, a.shape.1);
    let least = if k <= 512 { 32 } else { 80 }; // rows of a part; more for long sums, which `gemm` divides
    // Products of fewer than 16 columns or terms are too little work to share.
    if threads < 2 || n < 16 || k < 16 || m < 2 * (least + ROW_GROUP) || !c.has_contiguous_rows() {
        return multiply_columns(c, store, a, b);
    }
    let above = m / 2 / ROW_GROUP * ROW_GROUP;
    let (half, (c1, c2), (a1, a2)) = (threads / 2, c.split_rows(above), a.split_rows(above));
    rayon::join(|| multiply_rows(c1, store, a1, b, threads - half), || multiply_rows(c2, store, a2, b, half));
}

/// Computes a product on the calling thread.
///
/// With AVX-512, `gemm` processes 64 columns at a time (four vectors, six rows of `a` each). It is half as fast on a
/// remainder of up to 16 columns, which has too few sums to fill the pipeline. A second call of `gemm` therefore computes
/// such a remainder with the 16 columns before it. On other processors this has no disadvantage.
fn multiply_columns(mut c: MatrixMut<'_>, store: StoreMode, a: Matrix<'_>, b: Matrix<'_>) {
    let n = c.shape.1;
    let is_slow = n > 64 && (1..=16).contains(&(n % 64));
    let cut = if is_slow { n / 64 * 64 - 16 } else { n };
    call_gemm(c.reborrow().columns(0..cut), store, a, b.columns(0..cut));
    if cut < n {
        call_gemm(c.columns(cut..n), store, a, b.columns(cut..n));
    }
}

/// Computes `c = a·b` or `c += a·b` by one call of `gemm`, which takes the stride of columns before that of rows.
#[allow(clippy::needless_pass_by_value)] // a mutable borrow ends here; by reference every call would need `&mut`
fn call_gemm(c: MatrixMut<'_>, store: StoreMode, a: Matrix<'_>, b: Matrix<'_>) {
    let ((m, n), k) = (c.shape, a.shape.1);
    let add = store == StoreMode::Add;
    if m == 0 || n == 0 || (k == 0 && add) {
        return;
    }
    // SAFETY: the constructors checked that element (m-1, n-1) of `c`, and likewise the last ones of `a` and `b`, are
    // inside their slices, and strides are not negative, so every accessed element is inside; `product` checked that
    // the sizes agree. `c` is borrowed mutably and cannot overlap `a` or `b`. Slices are shorter than `isize::MAX`, so
    // the relevant strides fit an `isize`.
    unsafe {
        gemm::gemm(
            m,
            n,
            k,
            c.data.as_mut_ptr(),
            c.strides.1 as isize,
            c.strides.0 as isize,
            add,
            a.data.as_ptr(),
            a.strides.1 as isize,
            a.strides.0 as isize,
            b.data.as_ptr(),
            b.strides.1 as isize,
            b.strides.0 as isize,
            Real::from(u8::from(add)),
            1.0,
            false,
            false,
            false,
            gemm::Parallelism::None,
        );
    }
}

/// Adds `bias[f]` to feature f of `h` `[F, R]` and clips at zero. NaN stays NaN, so that the loss reports it.
pub fn add_bias_relu(h: &mut [Real], bias: &[Real]) {
    let rows = h.len() / bias.len().max(1);
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            for (row, &b) in h.chunks_exact_mut(rows.max(1)).zip(bias) {
                for x in row {
                    let z = *x + b;
                    *x = if z < 0.0 { 0.0 } else { z };
                }
            }
        },
    );
}

/// Adds `bias[f]` to feature f of `h` `[F, R]`.
pub fn add_bias(h: &mut [Real], bias: &[Real]) {
    let rows = h.len() / bias.len().max(1);
    for (row, &b) in h.chunks_exact_mut(rows.max(1)).zip(bias) {
        for x in row {
            *x += b;
        }
    }
}

/// Runs the backward pass of [`add_bias_relu`]: `d` becomes zero where the output `h` is not positive; its sum over the
/// Gaussians is added to `d_bias`.
pub fn add_bias_relu_vjp(d: &mut [Real], h: &[Real], d_bias: &mut [Real]) {
    let rows = (d.len() / d_bias.len().max(1)).max(1);
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            for ((d, h), sum) in d.chunks_exact_mut(rows).zip(h.chunks_exact(rows)).zip(d_bias.iter_mut()) {
                for (d, &h) in d.iter_mut().zip(h) {
                    *d = if h > 0.0 { *d } else { 0.0 };
                }
                *sum += lane_sum(d);
            }
        },
    );
}

/// Runs the backward pass of [`add_bias`]: adds the sums of `d` over the Gaussians to `d_bias`.
pub fn add_bias_vjp(d: &[Real], d_bias: &mut [Real]) {
    let rows = (d.len() / d_bias.len().max(1)).max(1);
    for (d, sum) in d.chunks_exact(rows).zip(d_bias) {
        *sum += lane_sum(d);
    }
}

/// Slope of the leaky ReLU below 0: PyTorch's default, which the released networks use. Also in `kernels.wgsl`.
const LEAK: Real = 0.01;

/// Returns |lrelu(z)|, the magnitude of a leaky ReLU.
#[inline]
pub fn amplitude(z: Real) -> Real {
    if z < 0.0 { -LEAK * z } else { z }
}

/// Returns the derivative of [`amplitude`]; 0 at 0.
#[inline]
pub fn amplitude_slope(z: Real) -> Real {
    if z > 0.0 {
        1.0
    } else if z < 0.0 {
        -LEAK
    } else {
        0.0
    }
}

/// Returns the sum of values, in fixed lanes: one order of additions on every machine, and vectorised.
#[inline(always)]
fn lane_sum(values: &[Real]) -> Real {
    const LANES: usize = 16;
    let mut lanes: [Real; LANES] = [0.0; LANES];
    let (whole, remainder) = values.as_chunks::<LANES>();
    for chunk in whole {
        for lane in 0..LANES {
            lanes[lane] += chunk[lane];
        }
    }
    for (lane, v) in remainder.iter().enumerate() {
        lanes[lane] += v;
    }
    lanes.iter().sum()
}

/// Computes `a += b`.
pub fn add_assign(a: &mut [Real], b: &[Real]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || a.iter_mut().zip(b).for_each(|(a, b)| *a += b),
    );
}

/// Adds the `rows`, each times its scale, to `sum`, one after the other.
pub fn add_scaled_rows<'a>(sum: &mut [Real], rows: &(impl Iterator<Item = (Real, &'a [Real])> + Clone)) {
    const LANES: usize = 64; // they stay in registers
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            let (blocks, rest) = sum.as_chunks_mut::<LANES>();
            let first = blocks.len() * LANES;
            for (k, block) in blocks.iter_mut().enumerate() {
                let mut lanes = *block;
                for (scale, row) in rows.clone() {
                    let row = &row[k * LANES..][..LANES];
                    for i in 0..LANES {
                        lanes[i] += scale * row[i];
                    }
                }
                *block = lanes;
            }
            for (scale, row) in rows.clone() {
                rest.iter_mut().zip(&row[first..]).for_each(|(sum, x)| *sum += scale * x);
            }
        },
    );
}

/// Adds all `sums` to `total`, in the order of the list for each element; elements are divided among threads.
pub fn add_in_order(total: &mut [Real], sums: &[&[Real]]) {
    const PIECE: usize = 8192; // elements per task
    total.par_chunks_mut(PIECE).enumerate().for_each(|(k, total)| {
        for sum in sums {
            add_assign(total, &sum[k * PIECE..][..total.len()]);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::rng;

    #[test]
    fn products_match_naive_multiplication_in_every_layout() {
        let mut random = rng::stream(7, "product", 0);
        let (m, k, n) = (5, 7, 3);
        let a: Vec<Real> = (0..m * k).map(|_| rng::normal(&mut random)).collect();
        let b: Vec<Real> = (0..k * n).map(|_| rng::normal(&mut random)).collect();
        let expected = |i: usize, j: usize| -> Real { (0..k).map(|l| a[i * k + l] * b[l * n + j]).sum() };
        let mut c = vec![1.0; m * n];
        product(MatrixMut::new(&mut c, m, n), StoreMode::Add, Matrix::new(&a, m, k), Matrix::new(&b, k, n));
        let mut turned = vec![0.0; m * n];
        let (bt, at) = (Matrix::new(&b, k, n).t(), Matrix::new(&a, m, k).t());
        product(MatrixMut::new(&mut turned, n, m), StoreMode::Set, bt, at);
        let mut part = vec![0.0; m];
        let last = Matrix::new(&b, k, n).columns(2..3);
        product(MatrixMut::new(&mut part, m, 1), StoreMode::Set, Matrix::new(&a, m, k), last);
        for i in 0..m {
            for j in 0..n {
                assert!((c[i * n + j] - 1.0 - expected(i, j)).abs() < 1e-5);
                assert!((turned[j * m + i] - expected(i, j)).abs() < 1e-5);
            }
            assert!((part[i] - expected(i, 2)).abs() < 1e-5);
        }
    }

    #[test]
    fn split_products_equal_whole_products() {
        let mut random = rng::stream(8, "product", 0);
        let (m, k) = (5, 7);
        for n in [64, 65, 80, 81, 144, 192] {
            let a: Vec<Real> = (0..m * k).map(|_| rng::normal(&mut random)).collect();
            let b: Vec<Real> = (0..k * n).map(|_| rng::normal(&mut random)).collect();
            let mut c = vec![1.0; m * n];
            product(MatrixMut::new(&mut c, m, n), StoreMode::Add, Matrix::new(&a, m, k), Matrix::new(&b, k, n));
            // Computed column by column from the transposed matrices, without a split.
            let turned: Vec<Real> = (0..n * k).map(|i| b[i % k * n + i / k]).collect();
            for j in 0..n {
                let mut column = vec![1.0; m];
                let of_b = Matrix::new(&turned[j * k..(j + 1) * k], 1, k).t();
                product(MatrixMut::new(&mut column, m, 1), StoreMode::Add, Matrix::new(&a, m, k), of_b);
                (0..m).for_each(|i| assert!((column[i] - c[i * n + j]).abs() < 1e-5, "{n}: {i}, {j}"));
            }
            product(MatrixMut::new(&mut c, m, n), StoreMode::Set, Matrix::new(&[], m, 0), Matrix::new(&[], 0, n));
            assert!(c.iter().all(|&c| c == 0.0), "an empty sum");
        }
    }

    #[test]
    #[should_panic(expected = "a matrix lies inside its slice")]
    fn rejects_overflowing_stride() {
        let _ = Matrix::strided(&[0.0], (3, 1), (1 << 63, 1)); // 2 · 2^63 wraps around to 0
    }

    #[test]
    fn relu_keeps_nan_and_its_vjp_is_zero_at_zero() {
        let mut h = [-2.0, 1.0, Real::NAN, 0.5];
        add_bias_relu(&mut h, &[1.0, 0.5]);
        assert_eq!(h[..2], [0.0, 2.0]);
        assert!(h[2].is_nan() && h[3] == 1.0);
        let (mut d, mut d_bias) = ([3.0, 4.0], [10.0]);
        add_bias_relu_vjp(&mut d, &[0.0, 2.0], &mut d_bias);
        assert_eq!((d, d_bias), ([0.0, 4.0], [14.0]));
    }
}
