use super::*;
use crate::array::ArrayWavefront;
use glam::{DMat3, DVec3};
use pwrfgs_core::{Projector as _, rng};
use std::f64::consts::TAU;

/// Spacing of the measured array, 0.16 m at 920 MHz.
const MEASURED: f64 = 0.16 * 920e6 / crate::SPEED_OF_LIGHT;

/// Sample phases of the published script.
const PHASES: [f64; 16] = [
    -1.886, -1.923, -2.832, -1.743, -1.751, -1.899, -2.370, -3.113, -2.394, -2.464, 2.964, -2.904, -1.573, -2.525,
    -3.039, -2.839,
];

fn measured_array() -> Array {
    Array { spacing_wavelengths: MEASURED, ..Array::default() }
}

fn sample_channel() -> Vec<Complex> {
    PHASES.iter().map(|phase| Complex::cis(-phase)).collect()
}

fn direction(azimuth: f64, elevation: f64) -> DVec3 {
    let ((sa, ca), (se, ce)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
    DVec3::new(ce * ca, ce * sa, se)
}

fn argmax(values: &[f64]) -> usize {
    (0..values.len()).fold(0, |best, i| if values[i] > values[best] { i } else { best })
}

fn argmin(values: &[f64]) -> usize {
    (0..values.len()).fold(0, |best, i| if values[i] < values[best] { i } else { best })
}

fn normalised(values: &[f64]) -> Vec<f64> {
    let (low, high) = value_range(values);
    values.iter().map(|v| (v - low) / (high - low)).collect()
}

/// Asserts equality within the printed digits.
fn assert_close(value: f64, expected: f64) {
    assert!((value - expected).abs() < 1e-6, "{value} is not {expected}");
}

#[test]
fn spectrum_matches_published_script_on_its_grid() {
    let degrees = |first: f64| AngleAxis { first, step: 1.0 };
    let beamformer = Beamformer::on_grid(&measured_array(), (360, degrees(0.0)), (90, degrees(1.0)));
    let raw = beamformer.amplitude(&sample_channel());
    let (low, high) = value_range(&raw);
    assert_close(low, 0.001_327);
    assert_close(high, 0.927_321);
    let values = normalised(&raw);
    assert_close(values.iter().sum::<f64>() / 32_400.0, 0.290_455);
    assert_eq!((argmax(&values), argmin(&values)), (83 * 360 + 29, 2 * 360 + 183));
    let cases = [
        (0, 0, 0.053_406),
        (0, 180, 0.021_497),
        (29, 45, 0.097_874),
        (44, 90, 0.163_584),
        (59, 270, 0.156_502),
        (89, 0, 0.926_409),
        (10, 359, 0.074_595),
    ];
    for (row, column, value) in cases {
        assert_close(values[row * 360 + column], value);
    }
}

#[test]
fn spectrum_matches_reference_on_measured_grid() {
    let beamformer = Beamformer::new(&measured_array(), 360, 90);
    let values = normalised(&beamformer.amplitude(&sample_channel()));
    assert_close(values.iter().sum::<f64>() / 32_400.0, 0.281_255);
    assert_eq!((argmax(&values), argmin(&values)), (84 * 360 + 29, 3 * 360 + 183));
    for (row, column, value) in [(0, 0, 0.053_221), (29, 45, 0.100_195), (89, 0, 0.944_564), (10, 359, 0.070_717)] {
        assert_close(values[row * 360 + column], value);
    }
}

#[test]
fn pixel_directions_match_projector() {
    for (width, height) in [(360, 90), (90, 24), (7, 5)] {
        let plane = pwrfgs_raster::Mercator::default().plane(width, height);
        let array = Array { spacing_wavelengths: 0.3, ..Array::default() };
        let beamformer = Beamformer::new(&array, width, height);
        let random = &mut rng::stream(1, "test pixels", 0);
        for _ in 0..50 {
            let (row, column) = (rng::below(random, height), rng::below(random, width));
            let u = DVec3::from(plane.direction(column as _, row as _).unwrap().map(|v| v as f64));
            let h: Vec<Complex> = array.offsets(1.0).iter().map(|p| Complex::cis(TAU * p.dot(u))).collect();
            let amplitude = beamformer.amplitude(&h)[row * width + column];
            assert!((amplitude - 1.0).abs() < 1e-9, "{width} x {height}, ({row}, {column}): {amplitude}");
        }
    }
}

/// Returns the angle between a plane wave's direction and the strongest pixel, degrees.
fn peak_error(array: &Array, beamformer: &Beamformer, azimuth: f64, elevation: f64) -> f64 {
    let u = direction(azimuth, elevation);
    let h: Vec<Complex> = array.offsets(1.0).iter().map(|p| Complex::cis(TAU * p.dot(u))).collect();
    let peak = argmax(&beamformer.amplitude(&h));
    direction((peak % 360) as f64, (peak / 360) as f64).angle_between(u).to_degrees()
}

#[test]
fn plane_wave_peak_is_within_one_degree() {
    let array = measured_array();
    let beamformer = Beamformer::new(&array, 360, 90);
    let random = &mut rng::stream(2, "test hemisphere", 0);
    let mut worst: f64 = 0.0;
    let drawn = (0..400).map(|_| {
        // Uniform on the hemisphere.
        (360.0 * rng::uniform(random) as f64, (rng::uniform(random) as f64).asin().to_degrees())
    });
    // And in the hardest cases: along the axes of the array, at the horizon and off pixel centres.
    let horizon = (0..72).flat_map(|k| [0.0, 0.3, 0.5, 1.5, 2.5].map(|el| (5.0 * f64::from(k) + 0.5, el)));
    let axes = [0.0, 90.0, 180.0, 270.0].into_iter().flat_map(|az| [0.0, 0.5, 1.0, 3.5, 10.0].map(|el| (az, el)));
    for (azimuth, elevation) in drawn.chain(horizon).chain(axes).chain([(12.5, 89.9), (0.0, 90.0)]) {
        let error = peak_error(&array, &beamformer, azimuth, elevation);
        assert!(error <= 1.0 + 1e-9, "({azimuth}, {elevation}): {error}");
        worst = worst.max(error);
    }
    println!("worst error of a peak: {worst} degrees");
}

#[test]
fn half_wavelength_array_is_ambiguous_on_axes_only() {
    let array = Array::default();
    let beamformer = Beamformer::new(&array, 360, 90);
    let h: Vec<Complex> = array.offsets(1.0).iter().map(|p| Complex::cis(TAU * p.x)).collect();
    let amplitude = beamformer.amplitude(&h);
    assert!((amplitude[0] - amplitude[180]).abs() < 1e-12, "a wave along x is received from both sides");
    for azimuth in [0.0, 45.0, 90.0, 133.3, 270.0] {
        for elevation in [5.0, 10.0, 40.0, 80.0] {
            assert!(peak_error(&array, &beamformer, azimuth, elevation) <= 1.0, "({azimuth}, {elevation})");
        }
    }
}

#[test]
fn beamformer_matches_definition_for_any_array_shape() {
    for (rows, columns) in [(1, 1), (1, 5), (3, 1), (2, 3), (8, 7)] {
        let array = Array { rows, columns, spacing_wavelengths: 0.4, ..Array::default() };
        let random = &mut rng::stream(3, "test channel", rows as u64);
        let mut draw = || rng::normal(random) as f64;
        let h: Vec<Complex> = (0..rows * columns).map(|_| Complex::new(draw(), draw())).collect();
        let amplitudes = Beamformer::new(&array, 11, 3).amplitude(&h);
        assert_eq!(amplitudes.len(), 33);
        for (pixel, amplitude) in amplitudes.iter().enumerate() {
            let u = direction((pixel % 11) as f64 * 360.0 / 11.0, (pixel / 11) as f64 * 30.0);
            let steered = array.offsets(1.0).into_iter().zip(&h).map(|(p, h)| Complex::cis(-TAU * p.dot(u)) * h);
            let expected = steered.sum::<Complex>().norm() / (rows * columns) as f64;
            assert!((amplitude - expected).abs() < 1e-13, "{rows} x {columns}, pixel {pixel}: {amplitude} {expected}");
        }
    }
}

#[test]
fn given_positions_equal_grid_and_plane_wave_formula() {
    let grid = Array { rows: 3, columns: 4, spacing_wavelengths: 0.4, ..Array::default() };
    let given = |positions_wavelengths| Array { positions_wavelengths, ..Array::default() };
    let same = given(grid.offsets(1.0).iter().map(DVec3::to_array).collect());
    let h: Vec<Complex> = PHASES[..12].iter().map(|phase| Complex::cis(*phase)).collect();
    let (one, other) = (Beamformer::new(&grid, 36, 9).amplitude(&h), Beamformer::new(&same, 36, 9).amplitude(&h));
    assert!(one.iter().zip(&other).all(|(a, b)| (a - b).abs() < 1e-13));

    // A plane wave from w on a ring of K antennas of radius r gives J₀ as K grows: |Σ exp(j2π pₖ·(w - u))|/K → |J₀(2πr|w - u|)|.
    let ring = |k: usize| TAU * k as f64 / 24.0;
    let circle = given((0..24).map(|k| [0.6 * ring(k).cos(), 0.6 * ring(k).sin(), 0.0]).collect());
    let beamformer = Beamformer::new(&circle, 360, 90);
    let w = direction(100.0, 40.0);
    let wave: Vec<Complex> = circle.offsets(1.0).iter().map(|p| Complex::cis(TAU * p.dot(w))).collect();
    let amplitude = beamformer.amplitude(&wave);
    for (azimuth, elevation) in [(100.0, 40.0), (90.0, 40.0), (130.0, 60.0), (80.0, 20.0)] {
        let u = direction(azimuth, elevation);
        let x = TAU * 0.6 * (w - u).truncate().length();
        let bessel = (0..1000).map(|i| (x * ((f64::from(i) + 0.5) * TAU / 2000.0).sin()).cos()).sum::<f64>() / 1000.0;
        let found = amplitude[elevation as usize * 360 + azimuth as usize];
        assert!((found - bessel.abs()).abs() < 1e-6, "({azimuth}, {elevation}): {found} is not {bessel}");
    }
    // Antennas above each other distinguish elevations on the boresight side, also at the zenith.
    let mast = given(vec![[0.0; 3], [0.0, 0.0, 0.25]]);
    let up = Beamformer::new(&mast, 4, 9).amplitude(&[Complex::ONE, Complex::cis(TAU * 0.25)]);
    for (pixel, amplitude) in up.iter().enumerate() {
        let phase = TAU * 0.25 * (1.0 - direction(0.0, (pixel / 4) as f64 * 10.0).z);
        assert!((amplitude - (0.5 * phase).cos()).abs() < 1e-12, "pixel {pixel}");
    }
}

#[test]
fn spectrum_ignores_channel_scale_and_phase() {
    let beamformer = Beamformer::new(&measured_array(), 360, 90);
    let channel = sample_channel();
    for kind in [SpectrumKind::Amplitude, SpectrumKind::Power] {
        let one = beamformer.spectrum(&channel, kind);
        // A power of two changes no bit but the exponent; j swaps parts.
        let other: Vec<Complex> = channel.iter().map(|h| h * Complex::new(0.0, 0.25)).collect();
        let other = beamformer.spectrum(&other, kind);
        assert_eq!(one.pixels, other.pixels);
        assert!((one.power - 1.0).abs() < 1e-12 && (other.power - 0.0625).abs() < 1e-12);
        let scale: f64 = if kind == SpectrumKind::Amplitude { 0.25 } else { 0.0625 };
        assert!((other.high / one.high / scale - 1.0).abs() < 1e-12);
        let turned: Vec<Complex> = channel.iter().map(|h| h * Complex::cis(1.234)).collect();
        let turned = beamformer.spectrum(&turned, kind);
        assert!(one.pixels.iter().zip(&turned.pixels).all(|(a, b)| a.abs_diff(*b) <= 1));
    }
}

#[test]
fn amplitude_is_min_max_and_power_is_max_normalised() {
    let beamformer = Beamformer::new(&measured_array(), 360, 90);
    let channel = sample_channel();
    let raw = beamformer.amplitude(&channel);
    let amplitude = beamformer.spectrum(&channel, SpectrumKind::Amplitude);
    assert_eq!(value_range(&raw), (amplitude.low, amplitude.high));
    assert_eq!(amplitude.pixels.iter().min(), Some(&0));
    assert_eq!(amplitude.pixels.iter().max(), Some(&255));
    let power = beamformer.spectrum(&channel, SpectrumKind::Power);
    assert!((power.high - 16.0 * amplitude.high.powi(2)).abs() < 1e-12);
    assert!((power.low - 16.0 * amplitude.low.powi(2)).abs() < 1e-12);
    for (pixel, value) in power.pixels.iter().zip(&raw) {
        let expected = 255.0 * (value / amplitude.high).powi(2);
        assert!((f64::from(*pixel) - (expected - 0.5)).abs() < 0.5 + 1e-9, "{pixel} {expected}");
    }
}

#[test]
fn zero_and_constant_spectra_are_black() {
    let beamformer = Beamformer::new(&measured_array(), 36, 9);
    for kind in [SpectrumKind::Amplitude, SpectrumKind::Power] {
        let silent = beamformer.spectrum(&[Complex::ZERO; 16], kind);
        assert_eq!((silent.low, silent.high, silent.power), (0.0, 0.0, 0.0));
        assert!(silent.pixels.iter().all(|p| *p == 0) && silent.pixels.len() == 36 * 9);
        let broken = beamformer.spectrum(&[Complex::new(f64::NAN, 0.0); 16], kind);
        assert!(broken.pixels.iter().all(|p| *p == 0));
    }
    // A single element of sixteen receives all directions equally, except for rounding.
    let mut single = [Complex::ZERO; 16];
    single[10] = Complex::new(0.3, -0.4);
    assert!(beamformer.spectrum(&single, SpectrumKind::Amplitude).pixels.iter().all(|p| *p == 0));
    assert!(beamformer.spectrum(&single, SpectrumKind::Power).pixels.iter().all(|p| *p >= 254));
}

#[test]
fn rotated_receiver_observes_inversely_rotated_wave() {
    let array = Array { wavefront: ArrayWavefront::Plane, ..measured_array() };
    let beamformer = Beamformer::new(&array, 360, 90);
    let turn = DMat3::from_euler(glam::EulerRot::ZYX, 0.4, -1.1, 2.0);
    let arrival = turn * direction(211.0, 37.0);
    let path = crate::path::PropagationPath {
        gain: Complex::ONE,
        length: 10.0,
        departure: -arrival,
        arrival,
        source: 10.0 * arrival,
        before: 0.0,
        interactions: vec![],
    };
    let elements: Vec<DVec3> = array.offsets(0.3).iter().map(|offset| turn * *offset).collect();
    let channel = crate::array::array_channel(&[path], &elements, DVec3::ZERO, &[0.3], array.wavefront);
    assert_eq!(argmax(&beamformer.amplitude(&channel)), 37 * 360 + 211);
}
