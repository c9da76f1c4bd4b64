//! Diffraction at edges: uniform theory of diffraction, with a heuristic for finite conductivity.

#[cfg(test)]
mod tests;

use crate::Complex;
use crate::waves::fresnel::Polarized;
use glam::DVec3;
use std::f64::consts::{FRAC_PI_4, PI};

/// Angle to a face below which an incoming ray is grazing, radians.
const GRAZING: f64 = 1e-9;
/// Number of nodes of the trapezium rule for the transition function.
const NODES: u32 = 12;

/// Edge of two faces with their reflection and transmission coefficients (te soft, tm hard), at angles chosen by the
/// caller. With cos θ = sin β sin α, where α is min(φ, φ′) at face 0 and nπ - max(φ, φ′) at face n, the reflected rays are
/// continuous at the boundaries and the diffraction coefficients are reciprocal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wedge {
    /// Exterior angle over π, in (1, 2].
    pub n: f64,
    /// Reflection at face 0; [`Polarized::PERFECT_CONDUCTOR`] for metal.
    pub r0: Polarized,
    /// Reflection at face n.
    pub rn: Polarized,
    /// Transmission T of the sheets on a straight path close behind the edge: the shadow is weaker, so the terms of its
    /// boundary are scaled by 1 - T (Burnside and Burgener, 1983). An edge with T = 1 and no reflection has no effect.
    pub through: Polarized,
}

impl Wedge {
    /// Returns the diffraction coefficients Dₛ (`te`) and Dₕ (`tm`), √m: Kouyoumjian and Pathak, Proc. IEEE 62 (1974), pp.
    /// 1448-1461, the reflection terms multiplied by coefficients of reflection as in Luebbers, IEEE TAP 32 (1984), pp.
    /// 70-76.
    ///
    /// * `k`: wave number 2π/λ, rad/m.
    /// * `distances`: s′ from the source to the edge and s from the edge to the receiver, metres.
    /// * `angles`: φ′ of the source and φ of the receiver about the edge, radians, from face 0 through air, in [0, nπ].
    /// * `sin_beta`: sine of the angle between ray and edge.
    ///
    /// The gain of the path is λ/(4π)·D/√(ss′(s + s′)), without the phase e^{-jk(s + s′)}. With ê along the edge so that φ
    /// turns by the right hand about it, k̂′ and k̂ along the ray before and after, φ̂′ = -ê×k̂′/sin β, φ̂ = ê×k̂/sin β,
    /// β̂′ = φ̂′×k̂′ and β̂ = φ̂×k̂ the field becomes -Dₛ(E·β̂′)β̂ - Dₕ(E·φ̂′)φ̂.
    ///
    /// On a shadow or reflection boundary it is the limit from the lit side. At grazing incidence (φ′ of 0 or nπ) the
    /// incident and the reflected ray coincide, and the coefficient is halved as in Kouyoumjian and Pathak: the direct ray
    /// counts once, the reflected one not at all. A receiver on a face is not treated this way. Zero if the ray runs along
    /// the edge or an end lies on it.
    pub fn diffraction_coefficients(&self, k: f64, distances: [f64; 2], angles: [f64; 2], sin_beta: f64) -> Polarized {
        let Self { n, r0, rn, through } = *self;
        let [before, after] = distances;
        let [phi_in, phi] = angles;
        if !(before > 0.0 && after > 0.0 && sin_beta > 0.0) {
            return Polarized::NOTHING;
        }
        let spreading = (before * after / (before + after)).sqrt(); // √L / sin β
        let scale = (2.0 * k).sqrt() * spreading * sin_beta;
        let side = |angle| boundary_term(n, angle, scale);
        let incident = side(PI + (phi - phi_in)) + side(PI - (phi - phi_in));
        let reflected_0 = side(PI - (phi + phi_in));
        let reflected_n = side(PI + (phi + phi_in));
        let grazing_share = if phi_in < GRAZING || phi_in > n * PI - GRAZING { 0.5 } else { 1.0 };
        // √L cancels the 1/√(2πk) of the coefficient except for 1/√π: see `boundary_term`.
        let front = Complex::cis(-FRAC_PI_4) * (-grazing_share * spreading / (2.0 * n * PI.sqrt()));
        let coefficient = |r0: Complex, rn: Complex, through: Complex| {
            front * ((1.0 - through) * incident + r0 * reflected_0 + rn * reflected_n)
        };
        Polarized { te: coefficient(r0.te, rn.te, through.te), tm: coefficient(r0.tm, rn.tm, through.tm) }
    }
}

/// Returns the boundary term cot(δ/2n) F(2kL sin²(δ/2)) / √(2kL), where `scale` is √(2kL) and δ is `angle` reduced to
/// [-nπ, nπ]: the boundary is at δ = 0 with the lit side above. There the cotangent is infinite and F is zero. The
/// product is finite and is computed as ±cos(δ/2n)·[sin(|δ|/2)/sin(|δ|/2n)]·F(v²)/v with v = √(2kL) sin(|δ|/2).
fn boundary_term(n: f64, angle: f64, scale: f64) -> Complex {
    let turn = 2.0 * PI * n;
    let delta = angle - turn * (angle / turn).round();
    let (wide, narrow) = (0.5 * delta.abs(), 0.5 * delta.abs() / n);
    let ratio = if narrow > 0.0 { wide.sin() / narrow.sin() } else { n };
    let sign = if delta < 0.0 { -1.0 } else { 1.0 };
    transition_over_root(scale * wide.sin()) * (sign * narrow.cos() * ratio)
}

/// Returns the transition function F(v²)/v, smooth down to √π e^{jπ/4} at v = 0; v ≥ 0 and finite. F(x) = 2j√x e^{jx} ∫
/// e^{-jt²} dt from √x to ∞, Kouyoumjian and Pathak (1974). Relative error below 10⁻¹⁴.
///
/// The Fresnel integral uses the trapezium rule with a correction for its pole, Alazah, Chandler-Wilde and La Porte,
/// Numerische Mathematik 128 (2014): errors fall like e^{-πN} for all v.
fn transition_over_root(v: f64) -> Complex {
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

/// Returns the parameter t of the diffraction point on the line a + t(b - a) for the path from `tx` to `rx`: the shortest
/// path, with equal angles before and after the edge (Keller's cone). t may lie outside [0, 1]. If `tx` and `rx` lie
/// on the line, the point is midway between them. 0 for an edge of zero length.
pub fn edge_parameter(a: DVec3, b: DVec3, tx: DVec3, rx: DVec3) -> f64 {
    let edge = b - a;
    let length = edge.length();
    if length == 0.0 {
        return 0.0;
    }
    let along = edge / length;
    let foot = |p: DVec3| {
        let t = (p - a).dot(along);
        (t, (p - a - t * along).length())
    };
    let ((from, near), (to, far)) = (foot(tx), foot(rx));
    // Unfolded into one plane the path is straight.
    let share = if near + far > 0.0 { near / (near + far) } else { 0.5 };
    (from + share * (to - from)) / length
}
