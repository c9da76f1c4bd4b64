//! Reflection and transmission of plane waves at flat surfaces: half-space and slab, ITU-R P.2040-3.

#[cfg(test)]
mod tests;

use crate::Complex;
use std::f64::consts::TAU;

/// Pair of coefficients, one per polarisation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Polarized {
    /// Electric field perpendicular to the plane of incidence (for an edge: parallel to it, soft).
    pub te: Complex,
    /// Electric field in the plane of incidence (for an edge: perpendicular to it, hard).
    pub tm: Complex,
}

impl Polarized {
    /// Total reflection: -1 and 1.
    pub const PERFECT_CONDUCTOR: Self = Self { te: Complex::new(-1.0, 0.0), tm: Complex::new(1.0, 0.0) };
    /// Zero coefficients.
    pub const NOTHING: Self = Self { te: Complex::ZERO, tm: Complex::ZERO };

    /// Returns the coefficients of this interaction followed by `next`.
    pub fn times(self, next: Self) -> Self {
        Self { te: self.te * next.te, tm: self.tm * next.tm }
    }
}

/// Returns the reflection coefficients of a slab of `thickness` metres, or of a half-space if `None`; ITU-R P.2040-3,
/// section 2.2.
///
/// `eta` is the complex relative permittivity, `cos_incidence` the cosine from the normal (its sign does not matter),
/// `wavelength` that in free space, metres. With c = cos θ, s = √(η - 1 + c²) and q = 2πds/λ a face reflects
/// r = (x - s)/(x + s), where x is c for `te` and ηc for `tm`, and a slab R = r(1 - e^{-2jq})/(1 - r²e^{-2jq}).
///
/// With ŝ = k̂×n̂/|k̂×n̂|, p̂ᵢ = ŝ×k̂ᵢ, p̂ₒ = ŝ×k̂ₒ the reflected field is `te`·(E·ŝ)ŝ + `tm`·(E·p̂ᵢ)p̂ₒ; its phase is that at
/// the front face.
pub fn reflection(eta: Complex, thickness: Option<f64>, cos_incidence: f64, wavelength: f64) -> Polarized {
    let face = FaceOptics::new(eta, cos_incidence);
    let Some(depth) = thickness else { return face.per_polarisation(Interface::reflection) };
    let path = face.phase(depth, wavelength);
    let echo = -exp_m1(Complex::new(2.0 * path.im, -2.0 * path.re));
    face.per_polarisation(|interface| {
        let r = interface.reflection();
        interface.divide_by_echoes(r * echo, echo, Complex::ZERO)
    })
}

/// Returns the transmission coefficients of a slab of `thickness` metres, relative to free space along the same straight
/// line: T of ITU-R P.2040-3, section 2.2, times e^{jkd cos θ}, so that a slab of air has no effect.
///
/// T = (1 - r²)e^{-jq}/(1 - r²e^{-2jq}). The field becomes `te`·(E·ŝ)ŝ + `tm`·(E·p̂)p̂, p̂ the same before and after.
/// Arguments as in [`reflection`]. The lateral displacement of the ray in the slab is not modelled.
pub fn transmission(eta: Complex, thickness: f64, cos_incidence: f64, wavelength: f64) -> Polarized {
    let face = FaceOptics::new(eta, cos_incidence);
    let path = face.phase(thickness, wavelength);
    let echo = -exp_m1(Complex::new(2.0 * path.im, -2.0 * path.re));
    let free = TAU * thickness / wavelength * cos_incidence.abs();
    let through = Complex::new(path.im, free - path.re).exp();
    face.per_polarisation(|interface| {
        interface.divide_by_echoes(interface.double_transmission() * through, echo, Complex::ONE)
    })
}

/// Quantities common to both polarisations: cos θ outside, η and s = √(η - sin²θ) inside.
struct FaceOptics {
    eta: Complex,
    cos: f64,
    root: Complex,
}

impl FaceOptics {
    /// Computes the quantities of a face with the complex relative permittivity `eta`.
    fn new(eta: Complex, cos_incidence: f64) -> Self {
        let cos = cos_incidence.abs();
        let root = (eta - 1.0 + cos * cos).sqrt();
        // The root that decays inwards; the roots differ only for a real root of a negative number.
        Self { eta, cos, root: if root.im > 0.0 { root.conj() } else { root } }
    }

    /// Returns the complex phase q = 2πds/λ of one passage through a slab of `thickness` d, metres.
    fn phase(&self, thickness: f64, wavelength: f64) -> Complex {
        self.root * (TAU * thickness / wavelength)
    }

    /// Returns the pair of `coefficient` for the interfaces of both polarisations.
    fn per_polarisation(&self, coefficient: impl Fn(Interface) -> Complex) -> Polarized {
        let (cos, root) = (self.cos, self.root);
        Polarized {
            te: coefficient(Interface(Complex::from(cos), root)),
            tm: coefficient(Interface(self.eta * cos, root)),
        }
    }
}

/// Interface for one polarisation: r = (x - s)/(x + s), stored as x and s.
#[derive(Clone, Copy)]
struct Interface(Complex, Complex);

impl Interface {
    /// Returns the reflection coefficient r of the interface.
    fn reflection(self) -> Complex {
        let (x, s) = (self.0, self.1);
        if x == s { Complex::ZERO } else { (x - s) / (x + s) }
    }

    /// Returns the transmission through both interfaces of a slab, 1 - r², without cancellation if |r| is near 1.
    fn double_transmission(self) -> Complex {
        let (x, s) = (self.0, self.1);
        if x == s { Complex::ONE } else { (2.0 * x / (x + s)) * (2.0 * s / (x + s)) }
    }

    /// Returns `amplitude` divided by 1 - r²e^{-2jq}, the sum over all echoes in a slab, with `echo` = 1 - e^{-2jq}; `none`
    /// if the wave does not interact: the slab has no thickness and the wave does not enter.
    fn divide_by_echoes(self, amplitude: Complex, echo: Complex, none: Complex) -> Complex {
        let r = self.reflection();
        let denominator = self.double_transmission() + r * r * echo;
        if denominator == Complex::ZERO { none } else { amplitude / denominator }
    }
}

/// Returns e^z - 1 without cancellation for small z.
fn exp_m1(z: Complex) -> Complex {
    let half = (0.5 * z.im).sin();
    Complex::new(z.re.exp_m1() * z.im.cos() - 2.0 * half * half, z.re.exp() * z.im.sin())
}
