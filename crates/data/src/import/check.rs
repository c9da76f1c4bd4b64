//! What values can be meant, and what to do about others.

use crate::checks::ROUNDING;
use pwrfgs_core::{Error, Result};
use std::path::Path;

/// A largest value below this is not meant: the measures of likeness take 1 for the strongest direction.
const FAINT: f64 = 0.01;

/// Smallest and largest value so far, and where.
#[derive(Debug, Default)]
pub(super) struct Range {
    low: Option<([usize; 3], f64)>,
    high: Option<([usize; 3], f64)>,
    no_number: Option<([usize; 3], f64)>,
}

impl Range {
    pub(super) fn see(&mut self, at: [usize; 3], value: f64) {
        if !value.is_finite() {
            self.no_number.get_or_insert((at, value));
        }
        if self.low.is_none_or(|(_, low)| value < low) {
            self.low = Some((at, value));
        }
        if self.high.is_none_or(|(_, high)| value > high) {
            self.high = Some((at, value));
        }
    }

    pub(super) fn ends(&self) -> (f64, f64) {
        let value = |end: Option<([usize; 3], f64)>| end.map_or(f64::NAN, |(_, v)| v);
        (value(self.low), value(self.high))
    }

    /// Whether all are from 0 to 1.
    pub(super) fn is_linear(&self) -> bool {
        let (low, high) = self.ends();
        low >= -ROUNDING && high <= 1.0 + ROUNDING
    }

    pub(super) fn refuse_what_is_no_number(&self, path: &Path) -> Result<()> {
        let Some((at, value)) = self.no_number else { return Ok(()) };
        let what = "a spectrum has a finite value in every direction; leave out what was not measured";
        Err(Error::input(path, format!("{} is {value}; {what}", place(at))))
    }

    /// Refuses values that are not from 0 to 1, given the factor that they were multiplied by.
    pub(super) fn check(&self, path: &Path, scale: Option<f64>) -> Result<()> {
        let (Some((low_at, low)), Some((high_at, high))) = (self.low, self.high) else { return Ok(()) };
        let refuse = |what: String| Err(Error::input(path, what));
        let suited = |high: f64| format!("--scale {}", scale.unwrap_or(1.0) / high);
        if low < -ROUNDING {
            let start = format!("values are from {low} ({}) to {high}", place(low_at));
            return refuse(if low < -3.0 {
                format!(
                    "{start}, as decibels are; spectra are linear, 0 to 1: save 10 ** ((s - s.max()) / 20), the \
                     amplitude, or / 10, the power"
                )
            } else {
                format!("{start}; spectra are amplitudes or powers from 0 to 1: save numpy.abs(s) or (s - s.min())")
            });
        }
        if high > 1.0 + ROUNDING {
            return refuse(format!(
                "the largest value is {high} ({}) and spectra are from 0 to 1; give {}",
                place(high_at),
                suited(high)
            ));
        }
        if high <= 0.0 {
            return refuse("every value is 0; is this the right file?".into());
        }
        if high < f64::from(f32::MIN_POSITIVE) {
            return refuse(format!(
                "the largest value becomes {high:e}, below the smallest number of 32 bits, {:e}; give {}",
                f32::MIN_POSITIVE,
                suited(high)
            ));
        }
        if high < FAINT && scale.is_none() {
            return refuse(format!(
                "the largest value is {high}, and 1 stands for the strongest direction; give {}, or --scale 1 where \
                 this is meant",
                suited(high)
            ));
        }
        Ok(())
    }
}

/// As Python writes it.
fn place([m, y, x]: [usize; 3]) -> String {
    format!("spectra[{m}, {y}, {x}]")
}
