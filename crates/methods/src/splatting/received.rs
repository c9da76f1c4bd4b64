//! Received power: the sky integrated over solid angle, in dB, and a path-loss term per receiver.
//!
//! P = Σ (c₀² + c₁²) Δazimuth Δsin(elevation) over the pixels; the power is 10 log₁₀ P + 10 β − 10 n log₁₀ d in dBm.
//! The solid angles sum to 4π: the first and the last row are the caps about the poles. β, in bel, is the gain of
//! antenna and cable of the receiver. n is the path-loss exponent, so that the sky models only the deviation from it. d
//! is the distance in metres, at least half a metre; without positions only β is used.

use super::Splatting;
use crate::groups::untrained_predictions;
use pwrfgs_core::{Dataset, GaussianCloud, ImagePlane, MeasurementSetup, Real, Vec3, consts, evenly};

/// Lower limit of the power of a sky without signals: -120 dB.
const FLOOR: Real = 1e-12;
/// Decibels per bel.
const BEL: Real = 10.0;
/// Smallest distance of the path-loss term, metres.
const NEAREST_M: Real = 0.5;
/// Maximum number of links for the initial fit of the path-loss term.
const FITTED: usize = 4_000;

/// Offset β and path-loss exponent n of every receiver; empty if the readout is not a power.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathLossLaws<'a> {
    pub(super) offsets: &'a [Real],
    pub(super) exponents: &'a [Real],
}

impl PathLossLaws<'_> {
    /// Returns offset and exponent of a receiver; `None` if the readout is not a power.
    pub(super) fn receiver_law(&self, receiver: usize) -> Option<[Real; 2]> {
        Some([*self.offsets.get(receiver)?, *self.exponents.get(receiver)?])
    }
}

/// Returns the decimal logarithm of the distance (metres) of link `i`; 0 without distances.
fn log_distance(distances: &[Real], i: usize) -> Real {
    distances.get(i).map_or(0.0, |d| d.max(NEAREST_M).log10())
}

/// Returns the solid angle of a pixel per row `[H]`, steradians; 1 for a plane without angles.
fn solid_angles(plane: &ImagePlane) -> Vec<Real> {
    let Some((azimuth, elevation)) = plane.angles else { return vec![1.0; plane.height] };
    // A pixel represents the direction of its centre; parts beyond the zenith have no area.
    let sin = |row: f64| (elevation.first + elevation.step * row).clamp(-90.0, 90.0).to_radians().sin();
    let ring = |row: usize| (sin(row as f64 + 0.5) - sin(row as f64 - 0.5)).abs();
    (0..plane.height).map(|row| (azimuth.step.to_radians().abs() * ring(row)) as Real).collect()
}

/// Integrates the squares of both channels `[2, H·W]` of a link over solid angle, given the `angles` of the rows; adds
/// [`FLOOR`].
fn integrate_power(angles: &[Real], width: usize, sky: &[Real]) -> Real {
    let rows = sky.chunks_exact(width).zip(angles.iter().cycle()); // two channels with equal rows
    rows.map(|(row, angle)| angle * row.iter().map(|c| c * c).sum::<Real>()).sum::<Real>() + FLOOR
}

/// Returns powers `[L]` in dBm of blended signals `[L, 2, H·W]`; `law` is offset and exponent.
pub(super) fn received_powers(plane: &ImagePlane, law: [Real; 2], distances: &[Real], blended: &[Real]) -> Vec<Real> {
    let (angles, [offset, exponent]) = (solid_angles(plane), law);
    let skies = blended.chunks_exact(2 * plane.width * plane.height).enumerate();
    let bel =
        |(i, sky)| integrate_power(&angles, plane.width, sky).log10() + offset - exponent * log_distance(distances, i);
    skies.map(|link| BEL * bel(link)).collect()
}

/// Returns the cotangents of the blended signals, given those `d` `[L]` of the powers; adds to those of offset and
/// exponent.
pub(super) fn received_powers_vjp(
    plane: &ImagePlane,
    distances: &[Real],
    blended: &[Real],
    d: &[Real],
    [d_offset, d_exponent]: &mut [Real; 2],
) -> Vec<Real> {
    let angles = solid_angles(plane);
    let mut d_blended = vec![0.0; blended.len()];
    let values = 2 * plane.width * plane.height;
    let skies = d_blended.chunks_exact_mut(values).zip(blended.chunks_exact(values));
    for (i, ((d_sky, sky), d)) in skies.zip(d).enumerate() {
        *d_offset += BEL * d;
        *d_exponent -= BEL * d * log_distance(distances, i);
        let scale = BEL * d / (consts::LN_10 * integrate_power(&angles, plane.width, sky));
        let rows = d_sky.chunks_exact_mut(plane.width).zip(sky.chunks_exact(plane.width)).zip(angles.iter().cycle());
        for ((d_row, row), angle) in rows {
            d_row.iter_mut().zip(row).for_each(|(d, c)| *d = 2.0 * scale * angle * c);
        }
    }
    d_blended
}

/// Returns the derivative of a power by the distance, dB per metre; 0 up to [`NEAREST_M`].
pub(super) fn distance_slope(exponent: Real, distance: Real) -> Real {
    if distance > NEAREST_M { -BEL * exponent / (consts::LN_10 * distance) } else { 0.0 }
}

impl Splatting {
    /// Sets all signals to 1 and fits the path-loss term of the resulting sky to the training set: an offset per receiver and one
    /// common exponent. A receiver without links in the fit has the mean offset.
    pub(super) fn start_law(
        &self,
        setup: &MeasurementSetup,
        data: &Dataset,
        train: &[usize],
        cloud: &mut GaussianCloud,
        weights: &mut [Real],
    ) {
        cloud.signals.iter_mut().for_each(|signal| *signal = [1.0, 0.0]);
        let Some(powers) = data.observations.powers() else { return };
        let part = evenly(train, FITTED);
        let sky = untrained_predictions(self, setup, data, &part, (cloud, weights));
        let receivers = &setup.receivers;
        let row = |(&i, sky): (&usize, Real)| {
            let query = data.query(i);
            let fixed = setup.fixed_end(query.receiver).filter(|_| query.features.is_none());
            // Without positions only the offset is used.
            let x = fixed.map_or(0.0, |fixed| {
                let length = (fixed - Vec3::from_array(setup.origin.local(query.position()))).length();
                f64::from(length.max(NEAREST_M) as f32).log10()
            });
            (query.receiver, [x, f64::from((powers[i] - sky) as f32) / BEL as f64])
        };
        let rows: Vec<(usize, [f64; 2])> = part.iter().zip(sky).map(row).collect();
        let (fitted, exponent) = fit_path_loss(&rows, receivers.len());
        let network = self.split_weights(setup, weights).0.len();
        let (offsets, exponents) = weights[network..].split_at_mut(receivers.len());
        offsets.iter_mut().zip(fitted).for_each(|(offset, fitted)| *offset += fitted as Real);
        exponents.fill(exponent as Real);
    }
}

/// Returns offsets and n of the least-squares fit of y = offset(receiver) − n x over `rows` (receiver, [x, y]). n is the
/// negative slope of the residuals after subtraction of the means per receiver; 0 if x is constant per receiver.
fn fit_path_loss(rows: &[(usize, [f64; 2])], receivers: usize) -> (Vec<f64>, f64) {
    let mut sums = vec![[0.0; 3]; receivers];
    for (receiver, [x, y]) in rows {
        let [n, sx, sy] = &mut sums[*receiver];
        (*n, *sx, *sy) = (*n + 1.0, *sx + x, *sy + y);
    }
    let means: Vec<Option<[f64; 2]>> = sums.iter().map(|[n, x, y]| (*n > 0.0).then(|| [x / n, y / n])).collect();
    let (mut xx, mut xy) = (0.0, 0.0);
    for (receiver, [x, y]) in rows {
        if let Some([mx, my]) = means[*receiver] {
            xx += (x - mx) * (x - mx);
            xy += (x - mx) * (y - my);
        }
    }
    let exponent = if xx > 0.0 { -xy / xx } else { 0.0 };
    let offsets: Vec<Option<f64>> = means.iter().map(|m| m.map(|[x, y]| y + exponent * x)).collect();
    let fitted: Vec<f64> = offsets.iter().flatten().copied().collect();
    let mean = fitted.iter().sum::<f64>() / fitted.len().max(1) as f64;
    (offsets.into_iter().map(|offset| offset.unwrap_or(mean)).collect(), exponent)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::AngleAxis;

    #[test]
    fn solid_angles_sum_to_full_sphere() {
        for side in [1, 6, 10, 30, 60] {
            let axis = |first| AngleAxis { first, step: f64::from(side) };
            let (width, height) = (360 / side as usize, 180 / side as usize + 1);
            let angles = Some((axis(0.0), axis(-90.0)));
            let plane = ImagePlane { wraps: true, angles, ..ImagePlane::plain(width, height) };
            let sum: f64 = solid_angles(&plane).iter().map(|ring| width as f64 * f64::from(*ring as f32)).sum();
            assert!((sum / (4.0 * std::f64::consts::PI) - 1.0).abs() < 1e-6, "{side} degrees: {sum}");
        }
    }
}
