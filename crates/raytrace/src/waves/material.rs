//! Materials: permittivity and conductivity over frequency, ITU-R P.2040-3.

#[cfg(test)]
mod tests;

use crate::Complex;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Electric constant ε₀, F/m, CODATA 2018.
pub const ELECTRIC_CONSTANT: f64 = 8.854_187_812_8e-12;
/// Conductivity of `perfect_conductor`, S/m: the TM coefficient differs from 1 by about 10⁻²⁴, without overflow.
const PERFECT: f64 = 1e40;
/// Largest |b| and |d|: larger powers of the frequency may overflow.
const STEEPEST: f64 = 10.0;
/// Frequency range of a material without a stated range.
const EVERYWHERE: (f64, f64) = (0.0, f64::INFINITY);

/// Material with the four parameters of ITU-R P.2040-3 (08/2023), section 3 and Table 3: εᵣ = a·f^b and σ = c·f^d, f in
/// GHz and σ in S/m.
///
/// ```
/// # use pwrfgs_raytrace::material::Material;
/// let concrete: Material = ron::from_str("(a: 5.24, c: 0.0462, d: 0.7822, range_ghz: (1, 100))").unwrap();
/// assert_eq!(Some(concrete), pwrfgs_raytrace::material::itu_material("concrete"));
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Relative permittivity at 1 GHz.
    pub a: f64,
    /// Exponent of the frequency for the permittivity; 0 by default.
    #[serde(default)]
    pub b: f64,
    /// Conductivity at 1 GHz, S/m.
    pub c: f64,
    /// Exponent of the frequency for the conductivity; 0 by default.
    #[serde(default)]
    pub d: f64,
    /// Lowest and highest frequency of validity, GHz; unlimited by default.
    #[serde(default = "everywhere", skip_serializing_if = "is_everywhere")] // JSON has no infinity
    pub range_ghz: (f64, f64),
}

/// Returns the default range of validity, GHz.
fn everywhere() -> (f64, f64) {
    EVERYWHERE
}

/// Returns whether a range is the default.
fn is_everywhere(range: &(f64, f64)) -> bool {
    *range == EVERYWHERE
}

impl Material {
    /// Returns the complex relative permittivity η = εᵣ - jσ/(2πf ε₀) for the time factor e^{+jωt}. `frequency_hz` is
    /// above 0; outside the range of validity it is extrapolated.
    pub fn permittivity(&self, frequency_hz: f64) -> Complex {
        let (permittivity, conductivity) = self.constants(frequency_hz);
        Complex::new(permittivity, -conductivity / (TAU * frequency_hz * ELECTRIC_CONSTANT))
    }

    /// Returns the relative permittivity and conductivity, S/m.
    pub fn constants(&self, frequency_hz: f64) -> (f64, f64) {
        let ghz = frequency_hz / 1e9;
        (self.a * ghz.powf(self.b), self.c * ghz.powf(self.d))
    }

    /// Returns whether the frequency lies in the range of validity.
    pub fn is_in_valid_range(&self, frequency_hz: f64) -> bool {
        let (low, high) = self.range_ghz;
        (low..=high).contains(&(frequency_hz / 1e9))
    }

    /// Returns an error for a parameter out of range: the problem and the next step.
    pub fn check(&self) -> Result<(), String> {
        let Self { a, b, c, d, range_ghz: (low, high) } = *self;
        if !(a > 0.0 && a <= PERFECT) {
            return Err(format!("`a` is {a}; a relative permittivity is above 0, 1 for metal"));
        }
        if !(0.0..=PERFECT).contains(&c) {
            return Err(format!("`c` is {c}; give a conductivity in S/m from 0 to {PERFECT:e}"));
        }
        for (name, power) in [("b", b), ("d", d)] {
            if !(-STEEPEST..=STEEPEST).contains(&power) {
                return Err(format!(
                    "`{name}` is {power}; give a power of the frequency from -{STEEPEST} to {STEEPEST}"
                ));
            }
        }
        if !(low >= 0.0 && low <= high) {
            return Err(format!("`range_ghz` is {low} to {high}; give two frequencies in GHz, the lower first"));
        }
        Ok(())
    }
}

/// Row of Table 3 of ITU-R P.2040-3: name, (a, b, c, d), range in GHz. Two of its materials have a second row.
type Row = (&'static str, (f64, f64, f64, f64), (f64, f64));
const TABLE: [Row; 18] = [
    ("vacuum", (1.0, 0.0, 0.0, 0.0), (0.001, 100.0)),
    ("concrete", (5.24, 0.0, 0.0462, 0.7822), (1.0, 100.0)),
    ("brick", (3.91, 0.0, 0.0238, 0.16), (1.0, 40.0)),
    ("plasterboard", (2.73, 0.0, 0.0085, 0.9395), (1.0, 100.0)),
    ("wood", (1.99, 0.0, 0.0047, 1.0718), (0.001, 100.0)),
    ("glass", (6.31, 0.0, 0.0036, 1.3394), (0.1, 100.0)),
    ("glass_above_220_ghz", (5.79, 0.0, 0.0004, 1.658), (220.0, 450.0)),
    ("ceiling_board", (1.48, 0.0, 0.0011, 1.0750), (1.0, 100.0)),
    ("ceiling_board_above_220_ghz", (1.52, 0.0, 0.0029, 1.029), (220.0, 450.0)),
    ("chipboard", (2.58, 0.0, 0.0217, 0.7800), (1.0, 100.0)),
    ("plywood", (2.71, 0.0, 0.33, 0.0), (1.0, 40.0)),
    ("marble", (7.074, 0.0, 0.0055, 0.9262), (1.0, 60.0)),
    ("floorboard", (3.66, 0.0, 0.0044, 1.3515), (50.0, 100.0)),
    ("metal", (1.0, 0.0, 1e7, 0.0), (1.0, 100.0)),
    ("very_dry_ground", (3.0, 0.0, 0.00015, 2.52), (1.0, 10.0)),
    ("medium_dry_ground", (15.0, -0.1, 0.035, 1.63), (1.0, 10.0)),
    ("wet_ground", (30.0, -0.4, 0.15, 1.30), (1.0, 10.0)),
    ("perfect_conductor", (1.0, 0.0, PERFECT, 0.0), EVERYWHERE), // not in the table
];

/// Names that other programs do not use.
pub(crate) const ONLY_HERE: [&str; 3] = ["perfect_conductor", "glass_above_220_ghz", "ceiling_board_above_220_ghz"];

/// Returns the material `name` of Table 3 of ITU-R P.2040-3, or `perfect_conductor`; `None` for other names.
pub fn itu_material(name: &str) -> Option<Material> {
    let (_, (a, b, c, d), range_ghz) = TABLE.into_iter().find(|row| row.0 == name)?;
    Some(Material { a, b, c, d, range_ghz })
}

/// Returns the names accepted by [`itu_material`], in the order of the table.
pub fn itu_material_names() -> Vec<&'static str> {
    TABLE.iter().map(|row| row.0).collect()
}
