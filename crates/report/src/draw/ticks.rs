//! Round numbers on axes.
//!
//! They are ours, not plotters': a logarithmic axis over less than a decade (N from 60 to 12) still needs numbers.

use pwrfgs_experiment::text::grouped;

/// A place on the axis (the logarithm where it is logarithmic) and its label.
pub(crate) type Tick = (f64, String);

/// Ticks between two places, as many as `fits` lets stand beside each other.
pub(crate) fn ticks((low, high): (f64, f64), log: bool, fits: &dyn Fn(&[Tick]) -> bool) -> Vec<Tick> {
    let decades = high - low;
    let all: Vec<Vec<Tick>> = if log && decades >= 0.5 {
        let digits: [&[f64]; 4] = [&[1.0, 1.5, 2.0, 3.0, 5.0, 7.0], &[1.0, 2.0, 5.0], &[1.0, 3.0], &[1.0]];
        let densest = if decades > 3.5 { 3 } else { usize::from(decades > 1.5) };
        digits[densest..].iter().map(|digits| powers((low, high), digits)).collect()
    } else {
        let (from, to) = if log { (10f64.powf(low), 10f64.powf(high)) } else { (low, high) };
        let place = |v: f64| (if log { v.log10() } else { v }, label(v));
        [6.0, 4.0, 2.0].iter().map(|&n| multiples(from, to, n).into_iter().map(place).collect()).collect()
    };
    let sparsest = all.last().cloned().unwrap_or_default();
    all.into_iter().find(|ticks| fits(ticks)).unwrap_or(sparsest)
}

/// Powers of ten times each of `digits`, within logarithms.
fn powers((low, high): (f64, f64), digits: &[f64]) -> Vec<Tick> {
    let stride = if high - low > 8.0 { 2 } else { 1 };
    (low.floor() as i32..=high.ceil() as i32)
        .filter(|power| power.rem_euclid(stride) == 0)
        .flat_map(|power| digits.iter().map(move |d| d * 10f64.powi(power)))
        .map(|v| (v.log10(), label(v)))
        .filter(|(place, _)| (low..=high).contains(place))
        .collect()
}

/// Multiples of 1, 2 or 5 times a power of ten, four to nine of them.
pub(crate) fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    multiples(low, high, 6.0)
}

/// The same, `wanted` or less.
fn multiples(low: f64, high: f64, wanted: f64) -> Vec<f64> {
    let rough = (high - low) / wanted;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|d| d * power).find(|s| *s >= rough).unwrap_or(power);
    let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
    (first..=last).map(|k| k as f64 * step).collect()
}

/// A short number.
pub(crate) fn label(value: f64) -> String {
    let text = match value.abs() {
        0.0 => "0".into(),
        s if s >= 1e6 => format!("{}M", (value / 1e4).round() / 100.0),
        s if s >= 1e4 => format!("{}k", (value / 10.0).round() / 100.0),
        s if s >= 1e3 => grouped(value.round() as i64),
        s if s >= 1e-4 => format!("{}", (value * 1e6).round() / 1e6),
        _ => format!("{value:.0e}"),
    };
    text.replace('-', "−")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(range: (f64, f64), log: bool, most: usize) -> Vec<String> {
        ticks(range, log, &|ticks| ticks.len() <= most).into_iter().map(|t| t.1).collect()
    }

    #[test]
    fn ticks_are_round_numbers() {
        assert_eq!(labels((0.0, 1.0), false, 99), ["0", "0.2", "0.4", "0.6", "0.8", "1"]);
        assert_eq!(labels((0.0, 200_000.0), false, 99), ["0", "50k", "100k", "150k", "200k"]);
        assert_eq!(labels((1.0, 3.0), true, 99), ["10", "20", "50", "100", "200", "500", "1,000"]);
        assert_eq!(labels((-20.0, 30.0), false, 99), ["−20", "−10", "0", "10", "20", "30"]);
        assert!(labels((1.1, 1.3), true, 99).len() >= 3);
    }

    #[test]
    fn where_room_is_short_there_are_fewer() {
        assert_eq!(labels((1.0, 3.0), true, 6), ["10", "30", "100", "300", "1,000"]);
        assert_eq!(labels((1.0, 3.0), true, 3), ["10", "100", "1,000"]);
        assert_eq!(labels((1.0, 3.0), true, 0), ["10", "100", "1,000"], "the sparsest rather than none");
        assert_eq!(labels((0.0, 1.0), false, 4), ["0", "0.5", "1"]);
    }
}
