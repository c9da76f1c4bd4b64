//! Interactions of waves with surfaces and edges, as pure functions from the cited recommendations and papers, and
//! `Ray`, the electric field: a complex vector perpendicular to its direction.
//!
//! Everything is in double precision, metres, hertz and radians; the time factor is e^{+jωt}.

pub mod diffraction;
pub mod fresnel;
pub mod material;
pub mod scattering;

use crate::Complex;
use fresnel::Polarized;
use glam::DVec3;
use scattering::Lobe;

/// Surface properties of a face.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Name of its object, such as `desk 2`.
    pub object: String,
    /// Complex relative permittivity at the carrier.
    pub eta: Complex,
    /// Thickness of the sheet, metres; `None` for an opaque solid.
    pub thickness: Option<f64>,
    /// Share of the reflected amplitude that is scattered diffusely, in [0, 1].
    pub roughness: f64,
    /// Shape of the diffuse lobe.
    pub lobe: Lobe,
}

impl Surface {
    /// Returns whether another surface has the same properties; names of objects may differ.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        let properties = |s: &Self| (s.eta, s.thickness, s.roughness, s.lobe);
        properties(self) == properties(other)
    }
}

/// Ray with its field, without spreading and without propagation phase.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    /// Unit vector of travel.
    pub(crate) direction: DVec3,
    /// Real and imaginary part of the field.
    pub(crate) re: DVec3,
    pub(crate) im: DVec3,
}

impl Ray {
    /// Creates a ray along the unit vector `direction` with a real field.
    pub(crate) fn new(direction: DVec3, field: DVec3) -> Self {
        Self { direction, re: field, im: DVec3::ZERO }
    }

    /// Returns the scalar product of the field and a real vector: for a unit vector, the component along it.
    pub(crate) fn component(&self, axis: DVec3) -> Complex {
        Complex::new(self.re.dot(axis), self.im.dot(axis))
    }

    /// Returns the power |E|².
    pub(crate) fn power(&self) -> f64 {
        self.re.length_squared() + self.im.length_squared()
    }

    /// Returns the ray along `direction` with the field a·`p` + b·`q`.
    fn from_components(direction: DVec3, (a, p): (Complex, DVec3), (b, q): (Complex, DVec3)) -> Self {
        Self { direction, re: a.re * p + b.re * q, im: a.im * p + b.im * q }
    }

    /// Returns the ray after a specular reflection at a plane with unit normal `normal`. Rough surfaces reflect only
    /// √(1 - S²) of the amplitude specularly (Degli-Esposti et al., 2007).
    pub(crate) fn reflected(&self, surface: &Surface, normal: DVec3, wavelength: f64) -> Self {
        let cosine = self.direction.dot(normal);
        let out = self.direction - 2.0 * cosine * normal;
        let r = fresnel::reflection(surface.eta, surface.thickness, cosine.abs(), wavelength);
        let smooth = (1.0 - surface.roughness * surface.roughness).sqrt();
        let s = unit_cross(self.direction, normal);
        let (te, tm) = (self.component(s), self.component(s.cross(self.direction)));
        Self::from_components(out, (r.te * te * smooth, s), (r.tm * tm * smooth, s.cross(out)))
    }

    /// Returns the ray after straight transmission through a sheet with unit normal `normal`; `None` for a solid.
    pub(crate) fn transmitted(&self, surface: &Surface, normal: DVec3, wavelength: f64) -> Option<Self> {
        let cosine = self.direction.dot(normal).abs();
        let t = fresnel::transmission(surface.eta, surface.thickness?, cosine, wavelength);
        let s = unit_cross(self.direction, normal);
        let p = s.cross(self.direction);
        Some(Self::from_components(self.direction, (t.te * self.component(s), s), (t.tm * self.component(p), p)))
    }

    /// Returns the ray after diffraction at an edge along the unit vector `edge` into `out`: `−D_s β̂β̂′ − D_h φ̂φ̂′`
    /// in the ray-fixed axes of Kouyoumjian and Pathak (1974), where `d` has `D_s` as `te` and `D_h` as `tm`.
    pub(crate) fn diffracted(&self, edge: DVec3, out: DVec3, d: &Polarized) -> Self {
        let phi_in = unit_cross(-edge, self.direction);
        let phi_out = unit_cross(edge, out);
        let (beta_in, beta_out) = (phi_in.cross(self.direction), phi_out.cross(out));
        Self::from_components(
            out,
            (-d.te * self.component(beta_in), beta_out),
            (-d.tm * self.component(phi_in), phi_out),
        )
    }

    /// Returns the ray after diffuse scattering into `out` with the given complex gain. The polarisation is projected
    /// onto the new transverse plane, without loss of power; the field is zero if nothing remains.
    pub(crate) fn scattered(&self, out: DVec3, gain: Complex) -> Self {
        let transverse = |v: DVec3| v - v.dot(out) * out;
        let (re, im) = (transverse(self.re), transverse(self.im));
        let remaining = re.length_squared() + im.length_squared();
        let scale = if remaining > 0.0 { (self.power() / remaining).sqrt() } else { 0.0 };
        let gain = gain * scale;
        Self { direction: out, re: gain.re * re - gain.im * im, im: gain.re * im + gain.im * re }
    }
}

/// Returns the unit vector a × b / |a × b|; an arbitrary unit vector perpendicular to `a` if both are parallel.
fn unit_cross(a: DVec3, b: DVec3) -> DVec3 {
    let c = a.cross(b);
    let length = c.length();
    if length > 1e-12 { c / length } else { a.any_orthonormal_vector() }
}
