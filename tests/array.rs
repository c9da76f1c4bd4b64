//! Gaussians as waves on an array: measured spectra, ensembles, and invalid combinations.

use crate::common::pipeline;
use pwrfgs::core::testing::shared;
use pwrfgs::core::{Splats, rng};
use pwrfgs::methods::{Activation, Readout, Splatting};
use pwrfgs::model::{Ensemble, Model};
use pwrfgs::prelude::*;
use std::f64::consts::TAU;
use std::path::Path;

const SPACING: f64 = 0.491;
/// Lags (m, n) of a 4 x 4 array, one of each pair ±.
const LAGS: usize = 25;

/// (m, n) of lag `l`: (0, 0) first, then half of the plane.
fn lag(l: usize) -> (i32, i32) {
    let all = (0..=3).flat_map(|m| (-3..=3).map(move |n| (m, n))).filter(|&(m, n)| m > 0 || n >= 0);
    all.into_iter().nth(l).unwrap()
}

/// The coefficients of |aᴴw|² at each lag of the array: real and imaginary part in turn.
fn autocorrelation(w: &[f64]) -> Vec<f64> {
    let at = |x: i32, y: i32| {
        let inside = (0..4).contains(&x) && (0..4).contains(&y);
        let k = (4 * y.max(0) + x.max(0)) as usize;
        if inside { (w[2 * k], w[2 * k + 1]) } else { (0.0, 0.0) }
    };
    let mut out = Vec::with_capacity(2 * LAGS);
    for (m, n) in (0..LAGS).map(lag) {
        let (mut re, mut im) = (0.0, 0.0);
        for (x, y) in (0..4).flat_map(|y| (0..4).map(move |x| (x, y))) {
            let ((a, b), (c, d)) = (at(x + m, y + n), at(x, y));
            re += a * c + b * d;
            im += b * c - a * d;
        }
        out.extend([re, im]);
    }
    out
}

/// Lags r (of an array at unit scale) and offset a of a picture g with (g + a)² = |aᴴw|², by least squares on every
/// fourth pixel: g² is linear in r and in -2a, a² being part of r₀.
fn fit_lags(plane: &ImagePlane, picture: &[Real]) -> (Vec<f64>, f64) {
    let pixels: Vec<usize> = (0..picture.len()).filter(|p| (p / 360) % 3 == 0 && p % 4 == 0).collect();
    let mut a = vec![vec![0.0; pixels.len()]; 2 * LAGS]; // by columns
    let mut b = vec![0.0; pixels.len()];
    for (row, &p) in pixels.iter().enumerate() {
        let u = plane.direction((p % 360) as Real, (p / 360) as Real).unwrap();
        for l in 0..LAGS {
            let (m, n) = lag(l);
            let phase = TAU * SPACING * (f64::from(m) * f64::from(u[0]) + f64::from(n) * f64::from(u[1]));
            (a[2 * l][row], a[2 * l + 1][row]) = (phase.cos(), phase.sin());
        }
        let g = f64::from(picture[p]);
        a[1][row] = -2.0 * g; // sin of lag 0 is nothing: its place is the offset's
        b[row] = g * g;
    }
    let (ata, atb) = normal_equations(&a, &b);
    let x = solve(ata, atb).unwrap();
    let offset = x[1];
    let mut lags: Vec<f64> = x.iter().map(|v| 0.5 * v).collect();
    (lags[0], lags[1]) = (x[0] + offset * offset, 0.0);
    (lags, offset)
}

/// Sixteen weights with the given autocorrelation, by Levenberg and Marquardt from random starts.
fn weights_of(lags: &[f64], seed: u64) -> Vec<f64> {
    let mut random = rng::stream(seed, "weights", 0);
    let scale = (lags[0] / 16.0).sqrt();
    let mut best: Option<(f64, Vec<f64>)> = None;
    for _ in 0..60 {
        let start = (0..32).map(|_| scale * f64::from(rng::normal(&mut random)) / 2f64.sqrt()).collect();
        let found = descend(lags, start);
        if best.as_ref().is_none_or(|b| found.0 < b.0) {
            best = Some(found);
        }
        if best.as_ref().is_some_and(|b| b.0 < 4e-5 * lags[0] * lags[0]) {
            break;
        }
    }
    best.unwrap().1
}

fn residual(lags: &[f64], w: &[f64]) -> Vec<f64> {
    difference(&autocorrelation(w), lags)
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// aᵀa and aᵀb, from the columns of a.
fn normal_equations(a: &[Vec<f64>], b: &[f64]) -> (Vec<Vec<f64>>, Vec<f64>) {
    let with = |other: &[f64]| a.iter().map(|column| dot(column, other)).collect::<Vec<f64>>();
    (a.iter().map(|column| with(column)).collect(), with(b))
}

/// x with ax = b, from the rows of a, by elimination; `None` where a is singular.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Option<Vec<f64>> {
    let n = b.len();
    for k in 0..n {
        let pivot = (k..n).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs()))?;
        a.swap(k, pivot);
        b.swap(k, pivot);
        for i in k + 1..n {
            let (above, below) = a.split_at_mut(i);
            let factor = below[0][k] / above[k][k];
            below[0].iter_mut().zip(&above[k]).for_each(|(x, y)| *x -= factor * y);
            b[i] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        b[k] = (b[k] - dot(&a[k][k + 1..], &b[k + 1..])) / a[k][k];
    }
    b.iter().all(|x| x.is_finite()).then_some(b)
}

fn descend(lags: &[f64], mut w: Vec<f64>) -> (f64, Vec<f64>) {
    let (mut r, mut damping) = (residual(lags, &w), 1e-2);
    for _ in 0..80 {
        // The autocorrelation is quadratic: differences over a wide step are exact.
        let column = |k: usize| {
            let [up, down] = [0.5, -0.5].map(|h| {
                let mut moved = w.clone();
                moved[k] += h;
                residual(lags, &moved)
            });
            difference(&up, &down)
        };
        let (mut damped, gradient) = normal_equations(&(0..32).map(column).collect::<Vec<_>>(), &r);
        (0..32).for_each(|k| damped[k][k] += damping * (damped[k][k] + 1e-9));
        let Some(step) = solve(damped, gradient) else { return (f64::MAX, w) };
        let moved = difference(&w, &step);
        let next = residual(lags, &moved);
        if dot(&next, &next) < dot(&r, &r) {
            let small = dot(&step, &step) < 1e-16 * lags[0];
            (w, r, damping) = (moved, next, damping * 0.3);
            if small {
                break;
            }
        } else {
            damping *= 4.0;
        }
    }
    (dot(&r, &r), w)
}

/// Signals of sixteen waves from well spread directions that give the field `w`, and these directions as splats.
fn sixteen_waves(plane: &ImagePlane, w: &[f64]) -> (Splats, Vec<Real>) {
    let mut splats = Splats::zeros(16);
    let mut a = vec![vec![0.0; 32]; 32];
    for i in 0..16 {
        // A sunflower over the disc of (u_x, u_y).
        let (radius, turn) = (0.97 * ((i as f64 + 0.5) / 16.0).sqrt(), 2.399_963 * i as f64);
        splats.means2d[i] = [(turn.to_degrees() % 360.0) as Real, radius.acos().to_degrees() as Real];
        let u = plane.direction(splats.means2d[i][0], splats.means2d[i][1]).unwrap();
        for k in 0..16 {
            let place = |i: usize| SPACING * (i as f64 - 1.5);
            let phase = TAU * (place(k % 4) * f64::from(u[0]) + place(k / 4) * f64::from(u[1]));
            let (sin, cos) = phase.sin_cos();
            (a[2 * k][2 * i], a[2 * k][2 * i + 1]) = (cos, -sin);
            (a[2 * k + 1][2 * i], a[2 * k + 1][2 * i + 1]) = (sin, cos);
        }
    }
    splats.radii.fill(1.0);
    splats.opacities.fill(1.0);
    splats.conics.fill([1.0, 0.0, 1.0]);
    // The picture is aᴴh/K.
    let signals = solve(a, w.iter().map(|w| 16.0 * w).collect()).unwrap();
    (splats, signals.iter().map(|s| *s as Real).collect())
}

#[test]
fn sixteen_gaussians_fit_measured_spectra_to_rounding() {
    let Some(root) = shared("data/s23") else { return };
    let data = pwrfgs_data::Nerf2Spectrum { root, ..Default::default() }.load(Path::new("."), &|_, _| {}).unwrap();
    let plane = pwrfgs_raster::Mercator::default().plane(360, 90);
    let array = pwrfgs_raster::ArrayResponse { widened: false, ..Default::default() };
    for sample in (0..2).map(|i| 37 + 1440 * i) {
        let picture = data.image(sample);
        let (lags, offset) = fit_lags(&plane, &picture.pixels);
        let w = weights_of(&lags, sample as u64);
        let rms_of = |w: &[f64]| {
            let (splats, signals) = sixteen_waves(&plane, w);
            let received =
                Readout::Magnitude.forward(&array.forward(splats.with_signals(&signals, 2, &plane)).pixels, 360 * 90);
            let errors =
                received.iter().zip(&picture.pixels).map(|(h, g)| (f64::from(*h) - offset - f64::from(*g)).powi(2));
            (errors.sum::<f64>() / picture.pixels.len() as f64).sqrt()
        };
        // The other solution: conjugate and reverse.
        let mirrored: Vec<f64> = w.chunks_exact(2).rev().flat_map(|z| [z[0], -z[1]]).collect();
        let (rms, rms_mirrored) = (rms_of(&w), rms_of(&mirrored));
        println!("spectrum {}: RMS {rms:.5}, mirrored {rms_mirrored:.5}", data.sample(sample).id);
        assert!(rms < 0.002, "spectrum {}: RMS {rms}, rounding to 8 bits alone is 0.0011", data.sample(sample).id);
        assert!((rms - rms_mirrored).abs() < 1e-4, "a field and its conjugate reverse give one picture");
    }
}

const FIELDS: &str = "data: Teacher(gaussians: 3, samples: 40, width: 72, height: 18), split: Random(test: 0.2), \
    initializer: Grid(count: 20, overlap: 0.3, opacity: 0.5), rasterizer: ArrayResponse(), readout: MinMax, \
    deformation: Factored(depth: 2, width: 16), baselines: [], metrics: [Ssim()]";

fn train(more: &str, steps: u64) -> Model {
    let pipeline = pipeline(&format!("{FIELDS}, training: (steps: {steps}, batch: 4, {more})"));
    let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
    let partition = pipeline.split.split(&data, &mut rng::stream(0, "split", 0)).unwrap();
    let mut trainer = pipeline.trainer(&data, &partition).unwrap_or_else(|e| panic!("{e}"));
    (0..steps).for_each(|_| _ = trainer.step().unwrap());
    trainer.model()
}

#[test]
fn strided_training_predicts_whole_images_and_reduces_loss() {
    let loss = |steps| {
        let pipeline = pipeline(&format!(
            "{FIELDS}, training: (steps: 60, batch: 8, stride: 3, densify_until: 0, prune_until: 0)"
        ));
        let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
        let partition = pipeline.split.split(&data, &mut rng::stream(0, "split", 0)).unwrap();
        let mut trainer = pipeline.trainer(&data, &partition).unwrap();
        let losses: Vec<f64> = (0..steps).map(|_| trainer.step().unwrap().loss).collect();
        assert_eq!(trainer.model().stages.plane, pipeline.projector.plane(72, 18));
        losses
    };
    let losses = loss(60);
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    assert!(mean(&losses[50..]) < 0.8 * mean(&losses[..5]), "{losses:?}");
}

#[test]
fn rejects_unsupported_stride_and_lists_valid_strides() {
    let refused = |more: &str| {
        let pipeline = pipeline(&format!(
            "data: Teacher(samples: 20, width: 72, height: 18), split: Random(test: 0.2), \
            initializer: Grid(count: 20), {more}"
        ));
        let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
        let partition = pipeline.split.split(&data, &mut rng::stream(0, "split", 0)).unwrap();
        pipeline.trainer(&data, &partition).unwrap_err().to_string()
    };
    assert!(refused("training: (stride: 4)").contains("use one of 1, 2, 3, 6, 9, 18"));
    let tiles = "projector: WrfgsCompat(), rasterizer: AlphaBlending(support: TileSquares), training: (stride: 2)";
    assert!(refused(tiles).contains("training.stride: 1"));
}

#[test]
fn array_response_requires_complex_signals_and_angles() {
    let refused = |fields: &str| {
        let text = format!("Pipeline(name: \"x\", data: Teacher(), initializer: Grid(), {fields})");
        Pipeline::parse(&text, Path::new("x.ron")).unwrap_err().to_string()
    };
    assert!(refused("rasterizer: ArrayResponse(), readout: Real").contains("MinMax"));
    assert!(refused("rasterizer: ArrayResponse(), projector: WrfgsCompat()").contains("Mercator"));
    assert!(refused("rasterizer: ArrayResponse(), calibration: AsReleased").contains("Physical"));
}

#[test]
fn ensemble_is_mean_of_members_with_deviation() {
    let models = vec![train("", 1), train("", 3)];
    let tx = [0.3, 0.1, 0.7];
    let pictures: Vec<Image> = models.iter().map(|m| m.predict(tx).clamped()).collect();
    let ensemble = Ensemble::new(models.clone()).unwrap();
    let ensemble = ensemble.prepare();
    let (mean, deviation, _) = ensemble.predict_with_deviation(tx);
    assert_eq!(mean, ensemble.predict(tx.into()));
    for p in 0..mean.pixels.len() {
        let (a, b) = (pictures[0].pixels[p], pictures[1].pixels[p]);
        assert!(
            (mean.pixels[p] - 0.5 * (a + b)).abs() < 1e-6 && (deviation.pixels[p] - 0.5 * (a - b).abs()).abs() < 1e-6
        );
    }
    assert_eq!(ensemble.predict_many(&[tx.into(), tx.into()]), vec![mean.clone(), mean.clone()]);
    let mut numbers = vec![0.0; mean.pixels.len()];
    ensemble.predict_into(&[tx.into()], &mut numbers);
    assert_eq!(numbers, mean.pixels);
    assert!(Ensemble::new(Vec::new()).is_err());
    let mut turned = models;
    turned[1].stages.receivers[0].pose.position = [1.0, 0.0, 0.0];
    assert!(Ensemble::new(turned).unwrap_err().contains("model 2"));
}

#[test]
fn closed_gate_removes_gaussian_and_open_gate_keeps_field() {
    let model = train("", 1);
    let splatting = model.stages.settings::<Splatting>().unwrap();
    let (Splatting { projector, rasterizer, .. }, pose, plane) = (splatting, &model.stages.pose(), &model.stages.plane);
    let activation: Activation = splatting.activation();
    let (cloud, deltas) = (&model.cloud, Deltas::default());
    let gated = |gate: &[Real]| {
        let geometry = activation.geometry(cloud, &deltas, 0, Some(gate));
        let signals = activation.signals(cloud, &deltas, 0..1);
        rasterizer.forward(projector.project(&geometry, pose, plane).with_signals(&signals, 2, plane)).pixels
    };
    let (mut gate, all) = (vec![1.0; cloud.len()], gated(&vec![1.0; cloud.len()]));
    gate[3] = 0.0;
    let rows: Vec<usize> = (0..cloud.len()).filter(|i| *i != 3).collect();
    let without = Model { cloud: cloud.select(&rows), ..model.clone() };
    let geometry = activation.geometry(&without.cloud, &deltas, 0, None);
    let signals = activation.signals(&without.cloud, &deltas, 0..1);
    assert_eq!(
        gated(&gate),
        rasterizer.forward(projector.project(&geometry, pose, plane).with_signals(&signals, 2, plane)).pixels
    );
    assert_ne!(gated(&gate), all);
}
