//! A received power: the sky summed over solid angle, in dB, with an offset a receiver.
//!
//! P = Σ_pixels (c₀² + c₁²) cos(elevation) Δazimuth Δelevation, and 10 log₁₀ P + 10 β in dBm. β, in bel, is what the
//! receiver's antenna and cable add; so a step of the optimiser moves it by a decibel in about a hundred.

use pwrfgs_core::{ImagePlane, Real, consts};

/// What is left of a sky without any signal: -120 dB.
const FLOOR: Real = 1e-12;
/// Decibels of a bel.
const BEL: Real = 10.0;

/// Solid angle of a pixel in each row.
fn solid_angles(plane: &ImagePlane) -> Vec<Real> {
    let Some((azimuth, elevation)) = plane.angles else { return vec![1.0; plane.height] };
    let area = (azimuth.step * elevation.step).abs() / f64::from(consts::DEG as f32).powi(2);
    let middle = |row: usize| (elevation.first + elevation.step * (row as f64 + 0.5)).to_radians();
    (0..plane.height).map(|row| (area * middle(row).cos()) as Real).collect()
}

/// The two channels of a link, row by row with the rows' solid angles.
fn power(angles: &[Real], width: usize, sky: &[Real]) -> Real {
    let rows = sky.chunks_exact(width).zip(angles.iter().cycle());
    rows.map(|(row, angle)| angle * row.iter().map(|c| c * c).sum::<Real>()).sum::<Real>() + FLOOR
}

/// Powers `[L]` in dBm of blended signals `[L, 2, H·W]`.
pub(super) fn forward(plane: &ImagePlane, offset: Real, blended: &[Real]) -> Vec<Real> {
    let angles = solid_angles(plane);
    let skies = blended.chunks_exact(2 * plane.width * plane.height);
    skies.map(|sky| BEL * (power(&angles, plane.width, sky).log10() + offset)).collect()
}

/// Cotangents of the blended signals, given those of the powers; adds to that of the offset.
pub(super) fn vjp(plane: &ImagePlane, blended: &[Real], d: &[Real], d_offset: &mut Real) -> Vec<Real> {
    let angles = solid_angles(plane);
    let mut d_blended = vec![0.0; blended.len()];
    let of_one = 2 * plane.width * plane.height;
    for ((d_sky, sky), d) in d_blended.chunks_exact_mut(of_one).zip(blended.chunks_exact(of_one)).zip(d) {
        *d_offset += BEL * d;
        let scale = BEL * d / (consts::LN_10 * power(&angles, plane.width, sky));
        let rows = d_sky.chunks_exact_mut(plane.width).zip(sky.chunks_exact(plane.width)).zip(angles.iter().cycle());
        for ((d_row, row), angle) in rows {
            d_row.iter_mut().zip(row).for_each(|(d, c)| *d = 2.0 * scale * angle * c);
        }
    }
    d_blended
}
