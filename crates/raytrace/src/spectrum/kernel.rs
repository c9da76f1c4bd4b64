//! aᴴh of a uniform planar array for many directions at once, by Horner's rule in two variables.

use crate::wave::Complex;
use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};
use std::f64::consts::TAU;

/// Directions are padded to a multiple of this, the widest vector of any processor.
const LANES: usize = 8;

/// Phase factors between neighbours in x and in y, one of each a direction.
#[derive(Clone, Debug)]
pub(super) struct Steering {
    x: Lanes,
    y: Lanes,
}

/// Complex numbers, parts apart.
#[derive(Clone, Debug, Default)]
struct Lanes {
    re: Vec<f64>,
    im: Vec<f64>,
}

impl Lanes {
    fn push(&mut self, value: Complex) {
        self.re.push(value.re);
        self.im.push(value.im);
    }
}

impl Steering {
    /// `directions` are unit vectors in the receiver frame, `spacing` is in wavelengths.
    pub(super) fn new(directions: impl Iterator<Item = DVec3>, spacing: f64) -> Self {
        let (mut x, mut y) = (Lanes::default(), Lanes::default());
        for direction in directions {
            x.push(Complex::cis(-TAU * spacing * direction.x));
            y.push(Complex::cis(-TAU * spacing * direction.y));
        }
        let padded = x.re.len().next_multiple_of(LANES);
        for column in [&mut x.re, &mut x.im, &mut y.re, &mut y.im] {
            column.resize(padded, 0.0);
        }
        Self { x, y }
    }

    /// |aᴴh| for every direction, with zeros or more behind up to a multiple of `LANES`. `channel` has rows of `columns`.
    pub(super) fn magnitude(&self, channel: &[Complex], columns: usize) -> Vec<f64> {
        let mut magnitude = vec![0.0; self.x.re.len()];
        Arch::new().dispatch(Horner { steering: self, channel, columns, magnitude: &mut magnitude });
        magnitude
    }
}

/// The phase of the array's corner, as against its centre, is left out: it does not change the magnitude.
struct Horner<'a> {
    steering: &'a Steering,
    channel: &'a [Complex],
    columns: usize,
    magnitude: &'a mut [f64],
}

impl WithSimd for Horner<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Steering { x, y } = self.steering;
        let x = S::as_simd_f64s(&x.re).0.iter().zip(S::as_simd_f64s(&x.im).0);
        let y = S::as_simd_f64s(&y.re).0.iter().zip(S::as_simd_f64s(&y.im).0);
        let zero = simd.splat_f64s(0.0);
        for (out, (x, y)) in S::as_mut_simd_f64s(self.magnitude).0.iter_mut().zip(x.zip(y)) {
            let mut sum = (zero, zero);
            for row in self.channel.chunks(self.columns.max(1)).rev() {
                let mut inner = (zero, zero);
                for value in row.iter().rev() {
                    let value = (simd.splat_f64s(value.re), simd.splat_f64s(value.im));
                    inner = multiply_add(simd, inner, x, value);
                }
                sum = multiply_add(simd, sum, y, inner);
            }
            let squared = simd.add_f64s(simd.mul_f64s(sum.0, sum.0), simd.mul_f64s(sum.1, sum.1));
            *out = simd.sqrt_f64s(squared);
        }
    }
}

/// a·b + c. Multiplications and additions round on their own, so that every processor computes the same bits.
#[inline(always)]
fn multiply_add<S: Simd>(
    simd: S,
    a: (S::f64s, S::f64s),
    b: (&S::f64s, &S::f64s),
    c: (S::f64s, S::f64s),
) -> (S::f64s, S::f64s) {
    let re = simd.sub_f64s(simd.mul_f64s(a.0, *b.0), simd.mul_f64s(a.1, *b.1));
    let im = simd.add_f64s(simd.mul_f64s(a.0, *b.1), simd.mul_f64s(a.1, *b.0));
    (simd.add_f64s(re, c.0), simd.add_f64s(im, c.1))
}
