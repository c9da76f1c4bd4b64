//! Power delay profile: the inverse Fourier transform over subcarriers, its power summed over antennas.

use super::curves::{Gains, decibels, square};
use std::f64::consts::TAU;

/// With fewer subcarriers there is nothing to see.
const FEWEST: usize = 4;
/// Places along a delay, a subcarrier.
const FINE: usize = 4;
/// This part of all delays is drawn before 0.
const BEFORE: usize = 6;
/// Most places along a delay.
const PLACES: usize = 2_048;

/// Hz between subcarriers; nothing where there are too few, or they are not equally far apart.
pub(super) fn spacing(frequencies: &[f64]) -> Option<f64> {
    let step = (frequencies.last()? - frequencies.first()?) / (frequencies.len().max(2) - 1) as f64;
    let is_even = frequencies.windows(2).all(|pair| (pair[1] - pair[0] - step).abs() < 1e-3 * step.abs());
    (frequencies.len() >= FEWEST && is_even && step.is_finite() && step != 0.0).then_some(step.abs())
}

/// Delay in ns and power in dB over the measured peak: measured, then predicted.
pub(super) fn profiles(measured: &Gains, predicted: &Gains, frequencies: &[f64]) -> Option<[Vec<(f64, f64)>; 2]> {
    let step = spacing(frequencies)?;
    let forward = frequencies.first() <= frequencies.last();
    let places = (FINE * frequencies.len()).min(PLACES);
    let power = |gains: &Gains| -> Vec<f64> {
        let at = |place: usize| (0..gains.antennas).map(|a| tap(gains.antenna(a), place, places, forward)).sum();
        (0..places).map(at).collect()
    };
    let (measured, predicted) = (power(measured), power(predicted));
    let peak = measured.iter().copied().fold(0.0, f64::max);
    // What came round stands before 0, so that a first path there is whole.
    let before = places / BEFORE;
    let line = |powers: Vec<f64>| {
        let delay = |k: usize| 1e9 * (k as f64 - before as f64) / (places as f64 * step);
        (0..places).map(|k| (delay(k), decibels(powers[(k + places - before) % places], peak))).collect()
    };
    Some([line(measured), line(predicted)])
}

/// |Σ h w exp(j 2π k place/places)|² with a raised cosine w, which keeps one path from hiding all others.
fn tap(gains: &[[f64; 2]], place: usize, places: usize, forward: bool) -> f64 {
    let count = gains.len() as f64;
    let sum = gains.iter().enumerate().fold([0.0; 2], |[x, y], (k, [re, im])| {
        let weight = 0.5 - 0.5 * (TAU * (k as f64 + 0.5) / count).cos();
        let turn = TAU * (k * place % places) as f64 / places as f64;
        let (sin, cos) = (if forward { turn } else { -turn }).sin_cos();
        [x + weight * (re * cos - im * sin), y + weight * (re * sin + im * cos)]
    });
    square(&sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::Image;

    #[test]
    fn one_path_peaks_at_its_delay() {
        let delay_s = 100e-9;
        let frequencies: Vec<f64> = (0..16).map(|k| 2.4e9 + 1.25e6 * f64::from(k)).collect();
        let phases: Vec<f64> = frequencies.iter().map(|f| -TAU * f * delay_s).collect();
        let parts = phases.iter().map(|p| p.cos()).chain(phases.iter().map(|p| p.sin()));
        let gains = Gains::of(&Image { width: 16, height: 2, pixels: parts.map(|v| v as _).collect() });
        let [profile, same] = profiles(&gains, &gains, &frequencies).unwrap();
        let peak = profile.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!((peak.0 - 100.0).abs() < 13.0 && peak.1.abs() < 1e-9, "{peak:?}");
        assert_eq!(profile, same);
    }

    #[test]
    fn uneven_and_few_subcarriers_have_no_profile() {
        assert_eq!(spacing(&[1e9, 2e9, 3e9, 4e9]), Some(1e9));
        for none in [&[][..], &[1e9], &[1e9, 2e9, 3e9], &[1e9, 2e9, 3e9, 9e9], &[1e9; 5]] {
            assert_eq!(spacing(none), None, "{none:?}");
        }
    }
}
