//! Wave of one splat at the antennas, and its derivative.

use crate::ewa::symmetric_inverse_vjp;
use pwrfgs_core::{
    ArrayGeometry, ImagePlane, JsonSchema, Real, Splats, Vec3,
    consts::{DEG, TAU},
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Variance of a splat whose conic cannot be inverted, px². Only the central antennas receive it.
const BOUNDLESS: Real = 1e9;
/// Smallest distance between a Gaussian and an antenna, wavelengths.
const CLOSEST: Real = 1e-3;

/// Wavefront of a Gaussian at the antennas.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub enum Wavefront {
    /// Plane wave: the phase depends on the direction only.
    #[default]
    Plane,
    /// Spherical wave: the phase depends on the position.
    Spherical {
        /// Carrier wavelength, metres.
        wavelength_m: Real,
    },
}

/// Antennas of a receiver, and the grid whose pixels are directions.
pub(super) struct Antennas {
    /// Antenna positions `[K]`, wavelengths, receiver frame.
    pub(super) positions: Vec<Vec3>,
    widened: bool,
    /// Carrier wavelength for spherical wavefronts, metres.
    wavelength: Option<Real>,
    /// Azimuth and elevation of pixel 0, and their increments per pixel; radians.
    first: [Real; 2],
    step: [Real; 2],
}

/// Direction of a splat, and its derivatives along column and row.
struct Aim {
    u: Vec3,
    around: Vec3,
    up: Vec3,
    /// Second derivatives: column twice, column and row, row twice.
    bends: [Vec3; 3],
    /// Covariance (a, b, c) on the image, px².
    cov: [Real; 3],
}

impl Antennas {
    /// Creates the antennas of an array for a plane whose pixels are directions.
    pub(super) fn new(
        geometry: &ArrayGeometry<'_, Real>,
        widened: bool,
        wavefront: Wavefront,
        plane: &ImagePlane,
    ) -> Self {
        let positions = geometry.element_positions(1.0).into_iter().map(|p| Vec3::from_array(p.map(|v| v as Real)));
        let (az, el) = plane.angles.expect("the plane was checked: its pixels are directions");
        Self {
            positions: positions.collect(),
            widened,
            wavelength: match wavefront {
                Wavefront::Plane => None,
                Wavefront::Spherical { wavelength_m } => Some(wavelength_m),
            },
            first: [az.first, el.first].map(|a| a.to_radians() as Real),
            step: [az.step, el.step].map(|a| a as Real / DEG),
        }
    }

    /// Returns the number of antennas K.
    pub(super) fn len(&self) -> usize {
        self.positions.len()
    }

    /// Returns whether half of an image of `width` pixels determines the beams: the antennas are in the x-y plane, and the
    /// image covers the full circle and has an even width, so that the opposite azimuth is half a width away.
    pub(super) fn has_opposite_pixels(&self, width: usize) -> bool {
        let turn = self.step[0] * width as Real / TAU;
        let is_flat = self.positions.iter().all(|p| p.z == 0.0);
        is_flat && width.is_multiple_of(2) && (turn.abs() - 1.0).abs() < 1e-6
    }

    /// Returns the waves of all splats, `[N, K]` complex numbers; zeros for splats out of view.
    pub(super) fn waves(&self, splats: &Splats) -> Vec<[Real; 2]> {
        let mut waves = vec![[0.0; 2]; splats.len() * self.len()];
        waves.par_chunks_exact_mut(self.len()).enumerate().with_min_len(64).for_each(|(i, wave)| {
            if splats.radii[i] > 0.0 {
                self.fill_wave(splats, i, wave);
            }
        });
        waves
    }

    /// Computes the wave `out` `[K]` of splat `i` with signal and opacity 1.
    fn fill_wave(&self, splats: &Splats, i: usize, out: &mut [[Real; 2]]) {
        let aim = self.splat_direction(splats, i);
        let distance = splats.depths[i];
        for (a, p) in out.iter_mut().zip(&self.positions) {
            let (sin, cos) = self.phase(*p, &aim, distance).0.sin_cos();
            let amplitude = (-self.fading(*p, &aim).0).exp();
            *a = [amplitude * cos, amplitude * sin];
        }
    }

    /// Returns the cotangents of mean, conic and depth of splat `i`, given its wave and the cotangent of the wave.
    pub(super) fn wave_vjp(
        &self,
        splats: &Splats,
        i: usize,
        wave: &[[Real; 2]],
        d_wave: &[[Real; 2]],
    ) -> ([Real; 2], [Real; 3], Real) {
        let aim = self.splat_direction(splats, i);
        let [a, b, c] = aim.cov;
        let (mut d_u, mut d_around, mut d_up) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
        let (mut d_cov, mut d_depth) = ([0.0; 3], 0.0);
        for ((p, [re, im]), [d_re, d_im]) in self.positions.iter().zip(wave).zip(d_wave) {
            let d_phase = re * d_im - im * d_re;
            let (_, by_direction, by_depth) = self.phase(*p, &aim, splats.depths[i]);
            d_u += by_direction * d_phase;
            d_depth += by_depth * d_phase;
            if self.widened {
                let (_, [w, v]) = self.fading(*p, &aim);
                let d = -TAU * TAU * (re * d_re + im * d_im);
                d_around += *p * (d * (a * w + b * v));
                d_up += *p * (d * (b * w + c * v));
                d_cov = [d_cov[0] + 0.5 * d * w * w, d_cov[1] + d * w * v, d_cov[2] + 0.5 * d * v * v];
            }
        }
        let [twice_around, both, twice_up] = aim.bends;
        let d_mean = [
            aim.around.dot(d_u) + twice_around.dot(d_around) + both.dot(d_up),
            aim.up.dot(d_u) + both.dot(d_around) + twice_up.dot(d_up),
        ];
        let bounded = a < BOUNDLESS || c < BOUNDLESS;
        // The conic is the inverse of the covariance, and vice versa.
        let d_conic = if self.widened && bounded { symmetric_inverse_vjp(aim.cov, d_cov) } else { [0.0; 3] };
        (d_mean, d_conic, d_depth)
    }

    /// Returns the direction of splat `i`, its derivatives, and the covariance.
    fn splat_direction(&self, splats: &Splats, i: usize) -> Aim {
        let [column, row] = splats.means2d[i];
        let [by_column, by_row] = self.step;
        let (sin_az, cos_az) = (self.first[0] + by_column * column).sin_cos();
        let (sin_el, cos_el) = (self.first[1] + by_row * row).sin_cos();
        let ahead = Vec3::new(cos_az, sin_az, 0.0);
        let aside = Vec3::new(-sin_az, cos_az, 0.0);
        let u = ahead * cos_el + Vec3::Z * sin_el;
        Aim {
            u,
            around: aside * (cos_el * by_column),
            up: (Vec3::Z * cos_el - ahead * sin_el) * by_row,
            bends: [
                ahead * (-cos_el * by_column * by_column),
                aside * (-sin_el * by_column * by_row),
                u * (-by_row * by_row),
            ],
            cov: invert_conic(splats.conics[i]),
        }
    }

    /// Returns the phase at an antenna `p` (wavelengths) relative to the centre, radians, and its derivatives by the
    /// direction and by the distance (metres).
    fn phase(&self, p: Vec3, aim: &Aim, distance: Real) -> (Real, Vec3, Real) {
        let along = p.dot(aim.u);
        let Some(wavelength) = self.wavelength else { return (TAU * along, p * TAU, 0.0) };
        let r = distance / wavelength;
        let square = p.length_squared();
        let to_antenna = (r * r - 2.0 * r * along + square).max(CLOSEST * CLOSEST).sqrt(); // wavelengths, as `r`
        // Computes `to_antenna - r` without cancellation.
        let extra = (square - 2.0 * r * along) / (to_antenna + r);
        (-TAU * extra, p * (TAU * r / to_antenna), TAU * (extra + along) / (to_antenna * wavelength))
    }

    /// Returns x of the factor exp(−x) by which width attenuates the wave at an antenna, and (p·∂u/∂column, p·∂u/∂row).
    fn fading(&self, p: Vec3, aim: &Aim) -> (Real, [Real; 2]) {
        if !self.widened {
            return (0.0, [0.0; 2]);
        }
        let [a, b, c] = aim.cov;
        let (w, v) = (p.dot(aim.around), p.dot(aim.up));
        ((0.5 * TAU * TAU * (a * w * w + 2.0 * b * w * v + c * v * v)).max(0.0), [w, v])
    }
}

/// Returns the covariance (a, b, c) whose inverse is the conic; variances of [`BOUNDLESS`] if it is lost to rounding.
fn invert_conic([a, b, c]: [Real; 3]) -> [Real; 3] {
    let det = a * c - b * b;
    let cov = [c / det, -b / det, a / det];
    if det > 0.0 && cov.iter().all(|v| v.is_finite()) { cov } else { [BOUNDLESS, 0.0, BOUNDLESS] }
}
