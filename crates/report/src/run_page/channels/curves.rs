//! Magnitude and phase over subcarriers, or over antennas where there is one subcarrier.

use pwrfgs_core::{Image, gains_of};

/// Weaker than this below the strongest is drawn as this, dB.
const FLOOR_DB: f64 = -60.0;

/// Channel gains `[A, F]`.
pub(super) struct Gains {
    pub(super) antennas: usize,
    pub(super) subcarriers: usize,
    values: Vec<[f64; 2]>,
}

/// A line through what was measured, and one through what is predicted.
pub(super) type Pair = (Vec<(f64, f64)>, Vec<(f64, f64)>);

impl Gains {
    pub(super) fn of(rows: &Image) -> Self {
        let values = gains_of(&rows.pixels, rows.width).into_iter().map(|gain| gain.map(|v| v as f64)).collect();
        Self { antennas: rows.height / 2, subcarriers: rows.width, values }
    }

    /// Those of an antenna over the subcarriers.
    pub(super) fn antenna(&self, a: usize) -> &[[f64; 2]] {
        &self.values[a * self.subcarriers..][..self.subcarriers]
    }

    /// The antenna that hears most.
    fn strongest(&self) -> usize {
        let energy = |a: usize| self.antenna(a).iter().map(square).sum::<f64>();
        (0..self.antennas).max_by(|a, b| energy(*a).total_cmp(&energy(*b)).then(b.cmp(a))).unwrap_or(0)
    }
}

/// |h|².
pub(super) fn square([re, im]: &[f64; 2]) -> f64 {
    re * re + im * im
}

/// Magnitude and phase of both, what runs across, and which antenna it is where one of several is shown.
pub(super) fn lines(measured: &Gains, predicted: &Gains, frequencies: &[f64]) -> ([Pair; 2], String, Option<usize>) {
    let over_antennas = measured.subcarriers == 1;
    let k = if over_antennas { 0 } else { measured.strongest() };
    let pick = |gains: &Gains| if over_antennas { gains.values.clone() } else { gains.antenna(k).to_vec() };
    let (a, b) = (pick(measured), pick(predicted));
    let middle = frequencies.iter().sum::<f64>() / frequencies.len().max(1) as f64;
    let span = frequencies.iter().map(|f| (f - middle).abs()).fold(0.0, f64::max);
    let (unit, name) = if span < 1e6 { (1e3, "kHz") } else { (1e6, "MHz") };
    let (across, words): (Vec<f64>, String) = if over_antennas {
        ((1..=a.len()).map(|n| n as f64).collect(), "antenna".into())
    } else {
        let from = format!("{name} from {:.3} MHz", middle / 1e6);
        (frequencies.iter().map(|f| (f - middle) / unit).collect(), from)
    };
    let peak = a.iter().map(square).fold(0.0, f64::max);
    let level = |gains: &[[f64; 2]]| gains.iter().map(|gain| decibels(square(gain), peak)).collect::<Vec<_>>();
    let (phase_a, phase_b) = (unwrapped(&a, None), unwrapped(&b, a.first().map(angle)));
    let on = |values: Vec<f64>| across.iter().copied().zip(values).collect::<Vec<_>>();
    (
        [(on(level(&a)), on(level(&b))), (on(phase_a), on(phase_b))],
        words,
        (!over_antennas && measured.antennas > 1).then_some(k),
    )
}

/// 10 log₁₀ of a share, cut where it is nothing.
pub(super) fn decibels(power: f64, of: f64) -> f64 {
    if of > 0.0 { (10.0 * (power / of).log10()).max(FLOOR_DB) } else { FLOOR_DB }
}

fn angle([re, im]: &[f64; 2]) -> f64 {
    im.atan2(*re).to_degrees()
}

/// Phases that never jump by more than half a turn, the first of them as near to `from` as whole turns allow.
fn unwrapped(gains: &[[f64; 2]], from: Option<f64>) -> Vec<f64> {
    let mut last = from.unwrap_or(0.0);
    let near = |phase: f64, last: f64| phase + 360.0 * ((last - phase) / 360.0).round();
    let of_each = |gain| {
        last = near(angle(gain), last);
        last
    };
    gains.iter().map(of_each).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phases_are_unwrapped_and_nothing_is_cut_at_the_floor() {
        let turning: Vec<[f64; 2]> =
            (0..5).map(|k| f64::from(150 * k).to_radians().sin_cos()).map(|(sin, cos)| [cos, sin]).collect();
        let found = unwrapped(&turning, None);
        assert!(found.iter().zip([0.0, 150.0, 300.0, 450.0, 600.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        assert!((unwrapped(&turning, Some(350.0))[0] - 360.0).abs() < 1e-9);
        assert_eq!((decibels(0.0, 1.0), decibels(1.0, 0.0)), (FLOOR_DB, FLOOR_DB));
    }

    #[test]
    fn one_subcarrier_is_drawn_over_antennas() {
        let rows = |v: f32| Image { width: 1, height: 4, pixels: [v, 0.0, 0.0, 2.0 * v].map(|v| v as _).to_vec() };
        let (lines, along, antenna) = lines(&Gains::of(&rows(1.0)), &Gains::of(&rows(0.0)), &[1e9]);
        assert_eq!((along.as_str(), antenna, lines[0].0.len()), ("antenna", None, 2));
        assert_eq!(lines[0].0[1], (2.0, 0.0));
    }
}
