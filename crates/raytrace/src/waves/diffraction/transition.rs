//! The transition function of the uniform theory of diffraction.

use crate::waves::wave::Complex;
use std::f64::consts::{FRAC_PI_4, PI};

/// Nodes of the trapezium rule.
const NODES: u32 = 12;

/// F(v²)/v, smooth down to √π e^{jπ/4} at v = 0; v ≥ 0 and finite. F(x) = 2j√x e^{jx} ∫ e^{-jt²} dt from √x to ∞,
/// Kouyoumjian and Pathak (1974). Relative error below 10⁻¹⁴.
///
/// The Fresnel integral by the trapezium rule with a correction for its pole, Alazah, Chandler-Wilde and La Porte,
/// Numerische Mathematik 128 (2014): errors fall like e^{-πN}, whatever v.
pub(super) fn over_root(v: f64) -> Complex {
    let eighth = Complex::cis(FRAC_PI_4);
    let a = ((f64::from(NODES) + 0.5) * PI).sqrt();
    let mut sum = Complex::ZERO;
    for k in 1..=NODES {
        let node = (f64::from(k) - 0.5) * PI / a;
        let square = node * node;
        sum += (-square).exp() / Complex::new(v * v, square);
    }
    let pole = (eighth.conj() * (-2.0 * a * v)).exp();
    let integral = eighth * (v / a) * sum + Complex::cis(-v * v) * pole / (1.0 + pole);
    2.0 * PI.sqrt() * eighth * integral.conj()
}
