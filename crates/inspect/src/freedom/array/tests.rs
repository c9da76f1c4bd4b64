//! Arrays whose signals are known.

use super::*;
use pwrfgs_core::{Pose, Sample, Spectra, rng};

/// `count` pictures of 72 x 18 pixels that an array of `rows` x `columns` hears of random signals.
fn heard(rows: usize, columns: usize, spacing: f64, kind: Kind, count: usize) -> Dataset {
    let (width, height) = (72, 18);
    let mut random = rng::stream(3, "array", 0);
    let mut pixels = Vec::new();
    for _ in 0..count {
        let signals: Vec<[f64; 2]> =
            (0..rows * columns).map(|_| [(); 2].map(|()| rng::normal(&mut random) as f64)).collect();
        let amplitude = |p: usize| {
            let (az, el) = (5.0 * (p % width) as f64, 5.0 * (p / width) as f64);
            let (az, el) = (az.to_radians(), el.to_radians());
            let (x, y) = (el.cos() * az.cos(), el.cos() * az.sin());
            let mut sum = [0.0; 2];
            for (k, [re, im]) in signals.iter().enumerate() {
                let (sin, cos) = (TAU * spacing * (x * (k % columns) as f64 + y * (k / columns) as f64)).sin_cos();
                sum = [sum[0] + cos * re + sin * im, sum[1] + cos * im - sin * re];
            }
            sum[0].hypot(sum[1])
        };
        let of_one: Vec<f64> = (0..width * height).map(amplitude).collect();
        let high = of_one.iter().fold(0.0, |m: f64, v| m.max(*v));
        let low = of_one.iter().fold(high, |m, v| m.min(*v));
        let grey = |v: f64| match kind {
            Kind::Stretched => (v - low) / (high - low),
            Kind::Amplitude => v / high,
            Kind::Power => (v / high).powi(2),
        };
        pixels.extend(of_one.into_iter().map(|v| (255.0 * grey(v)).round() as u8));
    }
    let samples = (1..=count as u32).map(|id| Sample::new(id, [f64::from(id); 3])).collect();
    Dataset::new("heard", Pose::IDENTITY, vec![], samples, Spectra::grey((width, height), pixels).unwrap()).unwrap()
}

fn found(data: &Dataset) -> Array {
    let all: Vec<usize> = (0..data.len()).collect();
    array(data, &all, 1.0 / 255.0 / 12f64.sqrt()).unwrap()
}

#[test]
fn the_array_that_heard_the_pictures_is_found() {
    for (rows, columns, spacing, kind) in [
        (4, 4, 0.491, Kind::Stretched),
        (2, 3, 0.5, Kind::Amplitude),
        (3, 3, 0.35, Kind::Power),
        (1, 4, 0.5, Kind::Stretched),
    ] {
        let found = found(&heard(rows, columns, spacing, kind, 12));
        assert_eq!((found.rows, found.columns, found.kind), (rows, columns, kind), "{found:?}");
        assert!((found.spacing - spacing).abs() < 0.004 && found.explains() && found.residual > 0.7, "{found:?}");
    }
}

#[test]
fn pictures_of_no_array_are_not_explained() {
    let mut random = rng::stream(4, "noise", 0);
    let pixels = (0..12 * 72 * 18).map(|_| rng::below(&mut random, 256) as u8).collect();
    let samples = (1..=12).map(|id| Sample::new(id, [f64::from(id); 3])).collect();
    let data =
        Dataset::new("noise", Pose::IDENTITY, vec![], samples, Spectra::grey((72, 18), pixels).unwrap()).unwrap();
    assert!(!found(&data).explains());
}

#[test]
fn numbers_are_counted_as_documented() {
    let array = Array { rows: 4, columns: 4, spacing: 0.491, kind: Kind::Stretched, residual: 1.0 };
    assert_eq!((array.lags(), array.signals()), (49, 31));
}
