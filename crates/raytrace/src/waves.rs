//! What surfaces and edges do to a wave: a few pure functions each, from the recommendations and papers they name, and
//! `Ray`, the electric field that they act on: a complex vector across its direction.
//!
//! Everything is in double precision, metres, hertz and radians; the time factor is e^{+jωt}.

pub mod diffraction;
pub mod fresnel;
pub mod material;
pub mod scattering;

use crate::Complex;
use crate::world::Surface;
use fresnel::Polarized;
use glam::DVec3;

/// A ray with its field, without spreading and without the phase of the way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    /// Unit vector of travel.
    pub(crate) direction: DVec3,
    /// The field, real and imaginary part.
    pub(crate) re: DVec3,
    pub(crate) im: DVec3,
}

impl Ray {
    /// A ray with a real field.
    pub(crate) fn new(direction: DVec3, field: DVec3) -> Self {
        Self { direction, re: field, im: DVec3::ZERO }
    }

    /// The component of the field along a real unit vector.
    pub(crate) fn along(&self, axis: DVec3) -> Complex {
        Complex::new(self.re.dot(axis), self.im.dot(axis))
    }

    /// |E|².
    pub(crate) fn power(&self) -> f64 {
        self.re.length_squared() + self.im.length_squared()
    }

    /// The ray that leaves along `direction` with the field a·`p` + b·`q`.
    fn made_of(direction: DVec3, (a, p): (Complex, DVec3), (b, q): (Complex, DVec3)) -> Self {
        Self { direction, re: a.re * p + b.re * q, im: a.im * p + b.im * q }
    }

    /// After a specular reflection at a plane with unit normal `normal`. Of a rough surface only √(1 - S²) of the
    /// amplitude goes this way (Degli-Esposti et al., 2007).
    pub(crate) fn reflected(&self, surface: &Surface, normal: DVec3, wavelength: f64) -> Self {
        let cosine = self.direction.dot(normal);
        let out = self.direction - 2.0 * cosine * normal;
        let r = fresnel::reflection(surface.eta, surface.thickness, cosine.abs(), wavelength);
        let smooth = (1.0 - surface.roughness * surface.roughness).sqrt();
        let s = across(self.direction, normal);
        let (te, tm) = (self.along(s), self.along(s.cross(self.direction)));
        Self::made_of(out, (r.te * te * smooth, s), (r.tm * tm * smooth, s.cross(out)))
    }

    /// After passing straight through a sheet; `None` behind a solid.
    pub(crate) fn transmitted(&self, surface: &Surface, normal: DVec3, wavelength: f64) -> Option<Self> {
        let cosine = self.direction.dot(normal).abs();
        let t = fresnel::transmission(surface.eta, surface.thickness?, cosine, wavelength);
        let s = across(self.direction, normal);
        let p = s.cross(self.direction);
        Some(Self::made_of(self.direction, (t.te * self.along(s), s), (t.tm * self.along(p), p)))
    }

    /// After diffraction at an edge along the unit vector `edge` into `out`: `−D_s β̂β̂′ − D_h φ̂φ̂′` in the ray-fixed axes
    /// of Kouyoumjian and Pathak (1974).
    pub(crate) fn diffracted(&self, edge: DVec3, out: DVec3, d: &Polarized) -> Self {
        let phi_in = across(-edge, self.direction);
        let phi_out = across(edge, out);
        let (beta_in, beta_out) = (phi_in.cross(self.direction), phi_out.cross(out));
        Self::made_of(out, (-d.te * self.along(beta_in), beta_out), (-d.tm * self.along(phi_in), phi_out))
    }

    /// After diffuse scattering into `out` with the given amplitude and phase: the polarisation is kept as far as the new
    /// direction allows. Where it allows none, nothing is sent.
    pub(crate) fn scattered(&self, out: DVec3, gain: Complex) -> Self {
        let bent = |v: DVec3| v - v.dot(out) * out;
        let (re, im) = (bent(self.re), bent(self.im));
        let left = re.length_squared() + im.length_squared();
        let scale = if left > 0.0 { (self.power() / left).sqrt() } else { 0.0 };
        let gain = gain * scale;
        Self { direction: out, re: gain.re * re - gain.im * im, im: gain.re * im + gain.im * re }
    }
}

/// The unit vector a × b / |a × b|; any unit vector across `a` where both are parallel.
fn across(a: DVec3, b: DVec3) -> DVec3 {
    let c = a.cross(b);
    let length = c.length();
    if length > 1e-12 { c / length } else { a.any_orthonormal_vector() }
}
