//! Diffuse scattering of rough surfaces: effective roughness.

#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Largest accepted exponent: a lobe of 6° to half power.
const NARROWEST: u32 = 256;

/// Directions of the scattered power: Degli-Esposti, Fuschini, Vitucci and Falciasecca, IEEE TAP 55 (2007), pp.
/// 143-153.
///
/// ```
/// # use pwrfgs_raytrace::scattering::Lobe;
/// assert_eq!(ron::from_str("Directive(exponent: 4)"), Ok(Lobe::Directive { exponent: 4 }));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Lobe {
    /// Proportional to the cosine from the normal, for all directions of incidence.
    #[default]
    Lambertian,
    /// Proportional to ((1 + cos ψ)/2)^exponent, with ψ the angle from the specular direction.
    Directive {
        /// Exponent; larger values give a narrower lobe, 0 scatters equally in all directions.
        exponent: u32,
    },
}

impl Lobe {
    /// Returns the share of the scattered power per steradian, 1/sr; its integral over the hemisphere is 1.
    ///
    /// The cosines of the incoming and outgoing direction are from the normal, in [0, 1]; `cos_psi` is the cosine
    /// between the specular and the outgoing direction.
    pub fn density(&self, cos_incidence: f64, cos_scattered: f64, cos_psi: f64) -> f64 {
        match *self {
            Self::Lambertian => cos_scattered / PI,
            Self::Directive { exponent } => {
                // `as` is exact up to the largest exponent that `check` accepts.
                (0.5 * (1.0 + cos_psi)).powi(exponent as i32) / lobe_integral(exponent, cos_incidence)
            }
        }
    }

    /// Returns an error for an exponent that is too large: the problem and the next step.
    pub fn check(&self) -> Result<(), String> {
        match *self {
            Self::Directive { exponent } if exponent > NARROWEST => {
                Err(format!("`exponent` of the lobe is {exponent}; use 0 to {NARROWEST}"))
            }
            _ => Ok(()),
        }
    }
}

/// Returns the integral of a directive lobe, ((1 + cos ψ)/2)^α with α = `exponent`, over the hemisphere, sr.
///
/// F = 2^-α Σⱼ C(α,j) Iⱼ over j = 0..α, with Iⱼ = 2π/(j + 1) for even j, and that times
/// cos θ Σ C(2w,w) (sin²θ/4)^w over w = 0..(j - 1)/2 for odd j. All terms are positive.
fn lobe_integral(exponent: u32, cos_incidence: f64) -> f64 {
    let cos = cos_incidence.clamp(0.0, 1.0);
    let quarter = 0.25 * (1.0 - cos * cos);
    let (mut sum, mut binomial) = (0.0, 0.5_f64.powi(exponent as i32));
    let (mut odd, mut term) = (0.0, 1.0);
    for j in 0..=exponent {
        let (power, left) = (f64::from(j), f64::from(exponent - j));
        let mut part = TAU / (power + 1.0);
        if j % 2 == 1 {
            odd += term;
            part *= cos * odd;
            // C(2w+2,w+1)/C(2w,w) = 2(2w + 1)/(w + 1) with 2w + 1 = j.
            term *= 4.0 * power / (power + 1.0) * quarter;
        }
        sum += binomial * part;
        binomial *= left / (power + 1.0);
    }
    sum
}

/// Returns the amplitude of the path by one patch of a rough surface between isotropic antennas: |gain|² is the path
/// gain.
///
/// λ/4π · √(S²|Γ|² `density` dA cos θ)/(r₁r₂): the patch receives cos θ dA/(4πr₁²) of the power, scatters S²|Γ|² of it
/// with `density` per steradian, and the receiver has the aperture λ²/4π. The remaining specular amplitude is √(1 - S²)
/// of Γ.
///
/// * `scattering`: S, in [0, 1]; `reflection`: |Γ| of the smooth surface.
/// * `density`: result of [`Lobe::density`], 1/sr; `area`: dA, m²; `cos_incidence`: cos θ from the normal.
/// * `distances`: r₁ from the transmitter to the patch and r₂ on to the receiver, metres, large against the patch.
/// * `wavelength`: λ, metres.
pub fn patch_amplitude(
    scattering: f64,
    reflection: f64,
    density: f64,
    area: f64,
    cos_incidence: f64,
    distances: (f64, f64),
    wavelength: f64,
) -> f64 {
    let spreading = wavelength / (2.0 * TAU * distances.0 * distances.1);
    scattering * reflection * spreading * (density * area * cos_incidence).max(0.0).sqrt()
}
