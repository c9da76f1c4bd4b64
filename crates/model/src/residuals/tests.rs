//! Fits to a model that does not depend on the transmitter, and the file.

use super::*;
use crate::tensors::Tensors;
use crate::{Ensemble, HeldOutScores, IntervalCalibration, KnownLinks, Model, Stages, TrainingPositions, file};
use pwrfgs_core::kriging::{Correlation, CorrelationKind, PathLoss, ResidualTrend, fit_observations};
use pwrfgs_core::{
    Dataset, Error, FittingSet, GaussianCloud, ImagePlane, MeasurementSetup, Method, Plugin, Pose, Predict as _,
    Sample, Spectra, rng,
};
use pwrfgs_methods as _;
use std::sync::atomic::AtomicBool;

const SIZE: (usize, usize) = (64, 8);

/// A few Gaussians without a network.
fn model(shift: Real) -> Model {
    let text = "Splatting(deformation: Fixed(), projector: Mercator(), rasterizer: AlphaBlending(), \
                calibration: Physical, readout: Magnitude)";
    let method = Plugin::<dyn Method>::parse(text).unwrap();
    let plane = method.traits().projector.unwrap().plane(SIZE.0, SIZE.1);
    let stages = Stages { method, setup: MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, plane) };
    let weights = vec![0.0; stages.layout().weight_count()];
    let mut cloud = GaussianCloud::zeros(2);
    cloud.means = vec![[1.0 + shift, 0.5, 1.0], [-1.0, 1.0, 1.5]];
    cloud.quats = vec![[1.0, 0.0, 0.0, 0.0]; 2];
    cloud.signals = vec![[0.5, 0.2]; 2];
    Model { stages, cloud, weights, training_positions: None }
}

/// Eight members of a run share most positions: each is one measurement.
#[test]
fn training_positions_of_an_ensemble_are_distinct() {
    let member =
        |positions: &[[Real; 3]]| Model { training_positions: TrainingPositions::thinned(positions), ..model(0.0) };
    let (a, b, c) = ([0.0, 1.0, 2.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let mut positions = Ensemble::new(vec![member(&[a, b]), member(&[b, c])]).unwrap().training_positions();
    positions.sort_by(|a, b| a.partial_cmp(b).unwrap());
    assert_eq!(positions, [c, a, b].map(|position| position.map(f64::from)));
}

/// A model that depends on the transmitter.
fn varying_model() -> Model {
    let mut varying = model(0.0);
    let text = "Splatting(deformation: Factored(depth: 1, width: 8, tx_encoding: Octaves(1)), projector: Mercator(), \
                rasterizer: AlphaBlending(), calibration: Physical, readout: Magnitude)";
    varying.stages.method = Plugin::parse(text).unwrap();
    let random = &mut rng::stream(7, "weights", 0);
    varying.weights = (0..varying.stages.layout().weight_count()).map(|_| 0.5 * rng::normal(random)).collect();
    varying
}

/// Transmitters at random positions in a cube of 1 m; `left` is what the prediction of `base` lacks at a position.
fn data(base: &Ensemble, left: impl Fn(usize, [f64; 3]) -> Real) -> Dataset {
    let mut random = rng::stream(5, "positions", 0);
    let position = |_| [(); 3].map(|()| f64::from(rng::uniform(&mut random) as f32));
    let places: Vec<[f64; 3]> = (0..240).map(position).collect();
    let ready = base.prepare();
    let image = |(i, tx): (usize, &[f64; 3])| -> Vec<f32> {
        let plane = base.plane().clone();
        let pattern = |k: usize| (k % plane.width) as Real * std::f64::consts::TAU as Real / plane.width as Real;
        let pixels = ready.predict_timed(*tx).0.clamped().pixels;
        pixels.iter().enumerate().map(|(k, p)| (p + left(i, *tx) * pattern(k).cos()) as f32).collect()
    };
    let pixels: Vec<f32> = places.iter().enumerate().flat_map(image).collect();
    let samples = places.iter().enumerate().map(|(i, tx)| Sample::new(i as u32, *tx)).collect();
    Dataset::new("room", Pose::IDENTITY, vec![], samples, Spectra::float(SIZE, &pixels).unwrap()).unwrap()
}

/// Fit to the first 200 links, of which every fourth was left out.
fn fit(settings: &Kriged, base: &Ensemble, data: &Dataset) -> pwrfgs_core::Result<Residuals> {
    let links: Vec<usize> = (0..200).collect();
    let left_out: Vec<Option<usize>> = links.iter().map(|i| i.is_multiple_of(4).then_some(0)).collect();
    let (parts, stop) = (base.members().len(), &AtomicBool::new(false));
    let known = KnownLinks { data, links: &links, left_out: &left_out, parts, blocks: &links, stop };
    Residuals::fit(settings, base, known, &|_, _| {})
}

fn smooth(_: usize, [x, y, _]: [f64; 3]) -> Real {
    (0.3 * (3.0 * x).sin() * (2.0 * y).cos()) as Real
}

/// Root mean square error at the links that are unknown to the fit.
fn error(predictor: &Ensemble, data: &Dataset) -> f64 {
    let ready = predictor.prepare();
    let squared = |i: usize| {
        let (predicted, truth) = (ready.predict_timed(data.query(i)).0, data.image(i));
        predicted.pixels.iter().zip(&truth.pixels).map(|(f, t)| (*f as f64 - *t as f64).powi(2)).sum::<f64>()
    };
    ((200..240).map(squared).sum::<f64>() / (40 * SIZE.0 * SIZE.1) as f64).sqrt()
}

#[test]
fn kriged_residuals_predict_what_the_model_lacks() {
    let base = Ensemble::new(vec![model(0.0), model(0.1)]).unwrap();
    let data = data(&base, smooth);
    let alone = error(&base, &data);
    for stride in [1, 4] {
        let settings = Kriged { stride, ..Kriged::default() };
        let whole = base.clone().with_residuals(Some(fit(&settings, &base, &data).unwrap()));
        let actual = error(&whole, &data);
        assert!(actual < 0.15 * alone, "stride {stride}: {actual} instead of {alone}");
        let queries: Vec<Query<'_>> = (200..240).map(|i| data.query(i)).collect();
        let ready = whole.prepare();
        let mut numbers = vec![0.0; 40 * SIZE.0 * SIZE.1];
        ready.predict_into(&queries, &mut numbers);
        let one: Vec<Real> = queries.iter().flat_map(|query| ready.predict_timed(*query).0.pixels).collect();
        assert!(numbers == one && ready.predict_with_deviation(queries[39]).0.pixels == one[39 * SIZE.0 * SIZE.1..]);
    }
}

/// A model that ignores the transmitter changes nothing in Kriging, so every share ties.
#[test]
fn tie_goes_to_kriging() {
    let base = Ensemble::of(model(0.0));
    let data = data(&base, smooth);
    let fitted = fit(&Kriged { stride: 1, ..Kriged::default() }, &base, &data).unwrap();
    let links: Vec<usize> = (0..200).collect();
    let kriging = fit_observations(&data, &links, false, &|| Ok(())).unwrap();
    assert_eq!(fitted.processes()[0].as_ref().unwrap().fit, kriging);
    let sentence = fitted.describe_share(Task::Spectrum).unwrap();
    assert_eq!(sentence, "share 0: the network adds nothing here; this is Kriging");
    let coarse = Residuals { grid: CoarseGrid::new(base.plane(), 2), ..fitted };
    let expected = sentence + " at one pixel per 2 by 2, interpolated";
    assert_eq!(coarse.describe_share(Task::Spectrum).unwrap(), expected);
}

/// Files hold what the model gains; earlier ones did not.
#[test]
fn useful_model_is_kept_and_file_holds_its_gain() {
    let base = Ensemble::of(varying_model());
    let data = data(&base, |i, _| 0.02 * rng::normal(&mut rng::stream(8, "noise", i as u64)));
    let whole = base.clone().with_residuals(Some(fit(&Kriged::default(), &base, &data).unwrap()));
    let sentence = |ensemble: &Ensemble| ensemble.residuals().unwrap().describe_share(Task::Spectrum).unwrap();
    let text = sentence(&whole);
    assert!(text.contains(": the network lowers the error by 0.") && text.ends_with("(50 held-out blocks)"), "{text}");
    let bytes = file::ensemble_to_bytes(&whole);
    assert_eq!(sentence(&file::from_bytes(&bytes).unwrap()), text);
    let mut tensors = Tensors::from_bytes(&bytes).unwrap();
    let last = "\"blocks\":50}";
    let (start, end) = (tensors.note.find(",\"gain\":{").unwrap(), tensors.note.find(last).unwrap() + last.len());
    tensors.note.replace_range(start..end, "");
    let old = file::from_bytes(&tensors.to_bytes()).unwrap();
    assert_eq!(error(&old, &data).to_bits(), error(&whole, &data).to_bits());
    let share = old.residuals().unwrap().share().unwrap();
    assert!(share > 0.0);
    assert_eq!(sentence(&old), format!("share {share}: the part of the network in the prediction"));
}

#[test]
fn gain_is_mean_with_standard_error_over_blocks() {
    let gain = ShareGain::of(&[1.0, 2.0, 3.0, 6.0]);
    assert_eq!((gain.mean, gain.blocks), (3.0, 4));
    assert!((gain.standard_error - (14.0f64 / 12.0).sqrt()).abs() < 1e-12);
    assert!(ShareGain::of(&[]).mean.is_nan());
}

/// With a path-loss model, a power is the measured one at a known link, and b f + (1 − b) path loss far away.
#[test]
fn power_far_from_known_links_is_the_trend() {
    let law = PathLoss { level: -40.0, slope: 20.0 };
    let trend = ResidualTrend { share: 0.25, path_loss: Some((law, [0.0; 3])) };
    let correlation =
        Correlation { kind: CorrelationKind::Matern32, scales: [1.0, 1.0, 1.0, f64::INFINITY], noise: 1e-6 };
    let (known, measured, predicted) = ([10.0, 0.0, 0.0], -50.0, -70.0);
    let left = measured - trend.expected(predicted, place(known)) as Real;
    let fit = ProcessFit { trend, variance: 1.0, correlation };
    let process = ResidualProcess::new(fit, vec![known], ResidualValues::Exact(vec![left]));
    let plane = ImagePlane::plain(1, 1);
    let residuals =
        Residuals { grid: CoarseGrid::new(&plane, 1), neighbours: 4, processes: vec![Some(process)], gain: None };
    let power = |x: f64| {
        let mut image = Image { width: 1, height: 1, pixels: vec![predicted] };
        residuals.correct(&mut image, [x, 0.0, 0.0].into(), Origin::ZERO);
        image.pixels[0]
    };
    assert!((power(10.0) - measured).abs() < 1e-3, "{}", power(10.0));
    let far = 0.25 * predicted + 0.75 * (-40.0 - 20.0 * 3.0);
    assert!((power(1000.0) - far).abs() < 1e-3, "{} instead of {far}", power(1000.0));
}

/// The model has memorised three quarters of the links: their residuals are zero. At the others it is wrong by 0.2 at
/// random; a process fitted to the residuals of all links alike would be nearly certain.
#[test]
fn memorised_links_do_not_lower_the_variance() {
    let base = Ensemble::of(varying_model());
    let amplitude = 0.02;
    let noise = |i: usize, _: [f64; 3]| {
        let sign = if rng::uniform(&mut rng::stream(1, "sign", i as u64)) < 0.5 { -1.0 } else { 1.0 };
        if i.is_multiple_of(4) { sign * amplitude } else { 0.0 }
    };
    let data = data(&base, noise);
    let fitted = fit(&Kriged::default(), &base, &data).unwrap();
    // The pattern is a cosine, with mean square 1/2.
    let truth = f64::from(amplitude as f32).powi(2) / 2.0;
    for tx in [[0.5; 3], [0.2, 0.8, 0.4]] {
        let variance = fitted.deviation(tx.into(), Origin::ZERO).powi(2);
        assert!((0.7 * truth..1.5 * truth).contains(&variance), "{variance} instead of {truth}");
    }
}

/// A model that varies with the transmitter as the observations do leaves white noise. With the noise of the observations,
/// the process would add the noise of neighbours to its predictions.
#[test]
fn residuals_of_good_model_are_noisier_than_observations() {
    let base = Ensemble::of(varying_model());
    let data = data(&base, |i, _| 0.02 * rng::normal(&mut rng::stream(8, "noise", i as u64)));
    let residuals = fit(&Kriged { stride: 1, ..Kriged::default() }, &base, &data).unwrap();
    let ProcessFit { trend, correlation, .. } = residuals.processes()[0].as_ref().unwrap().fit;
    let links: Vec<usize> = (0..200).collect();
    let kriging = fit_observations(&data, &links, false, &|| Ok(())).unwrap().correlation;
    assert!(trend.share >= 0.75 && correlation.noise > 3.0 * kriging.noise, "{trend:?}, {correlation:?}, {kriging:?}");
    let whole = base.clone().with_residuals(Some(residuals));
    assert!(error(&whole, &data) < 1.1 * error(&base, &data), "{} {}", error(&whole, &data), error(&base, &data));
}

/// As above: intervals are calibrated on links that the model did not train on, and have the width of their errors.
#[test]
fn memorised_links_do_not_narrow_intervals() {
    let (base, amplitude) = (Ensemble::of(model(0.0)), 0.2);
    let sign = |i: usize| if rng::uniform(&mut rng::stream(1, "sign", i as u64)) < 0.5 { -1.0 } else { 1.0 };
    let data = data(&base, |i, _| if i.is_multiple_of(4) { sign(i) * amplitude } else { 0.0 });
    let whole = base.clone().with_residuals(Some(fit(&Kriged::default(), &base, &data).unwrap()));
    let calibrated = calibrated(&whole, &data);
    let factors = calibrated.calibration().unwrap().factors(0.9).unwrap();
    let half = factors.half_width * calibrated.prepare().deviation(data.query(220)).unwrap();
    // 90 % of the values of a cosine are below 0.988 times its amplitude.
    let truth = 0.988 * f64::from(amplitude as f32);
    assert!((0.8 * truth..1.5 * truth).contains(&half), "{half} instead of {truth}");
}

/// Calibration by the links that were left out in [`fit`], each a block.
fn calibrated(whole: &Ensemble, data: &Dataset) -> Ensemble {
    let (held, trained): (Vec<usize>, Vec<usize>) = (0..200).partition(|i: &usize| i.is_multiple_of(4));
    let held_out = whole.held_out(&[0], data, &trained).unwrap();
    assert!(held_out.residuals().is_none_or(|residuals| residuals.processes()[0].as_ref().unwrap().len() == 150));
    let ready = held_out.prepare();
    let score = |&i: &usize| {
        let query = data.query(i);
        let shown = ready.predict(query).clamped();
        vec![HeldOutScores::of(data.task(), &shown, ready.deviation(query).unwrap_or(1.0), &data.image(i))]
    };
    whole.clone().with_calibration(IntervalCalibration::new(&held.iter().map(score).collect::<Vec<_>>()))
}

#[test]
fn validation_links_are_unknown_to_models_that_choose_by_them() {
    let base = Ensemble::of(model(0.0));
    let data = data(&base, smooth);
    let whole = base.clone().with_residuals(Some(fit(&Kriged::default(), &base, &data).unwrap()));
    let (validation, train): (Vec<usize>, Vec<usize>) = (0..200).partition(|i: &usize| i.is_multiple_of(4));
    let known = FittingSet { train: &train, validation: &validation, ..FittingSet::default() };
    let links = |ensemble: &Ensemble| ensemble.residuals().unwrap().processes()[0].as_ref().unwrap().len();
    let fair = whole.without_validation(&data, known).unwrap().unwrap();
    assert_eq!((links(&whole), links(&fair)), (200, 150));
    assert!(base.without_validation(&data, known).unwrap().is_none());
    assert!(whole.without_validation(&data, FittingSet { validation: &[], ..known }).unwrap().is_none());
}

#[test]
fn invalid_calibration_of_a_file_is_refused() {
    let base = Ensemble::of(model(0.0));
    let data = data(&base, smooth);
    let whole = calibrated(&base, &data);
    let bytes = file::ensemble_to_bytes(&whole);
    let again = file::from_bytes(&bytes).unwrap();
    assert!(again.calibration() == whole.calibration() && file::ensemble_to_bytes(&again) == bytes);
    assert!(file::ensemble_to_bytes(&again.with_residuals(None)) == file::ensemble_to_bytes(&base));
    let refused = |name: &str, shape: &[usize], values: &[Real]| {
        let mut tensors = Tensors::from_bytes(&bytes).unwrap();
        tensors.put(name, shape.to_vec(), values.to_vec());
        let message = file::from_bytes(&tensors.to_bytes()).unwrap_err();
        assert!(message.contains(name), "{message}");
    };
    for blocks in [0.0, -1.0, 0.5, 1e9, Real::NAN, Real::INFINITY] {
        refused("calibration.blocks", &[1], &[blocks]);
    }
    for name in ["calibration.values", "calibration.ssim"] {
        refused(name, &[0, 2], &[]);
        refused(name, &[1], &[1.0]);
        refused(name, &[2, 2], &[2.0, 0.5, 1.0, 1.0]);
        refused(name, &[2, 2], &[1.0, 0.5, 2.0, 0.4]);
        refused(name, &[1, 2], &[1.0, 0.9]);
        refused(name, &[1, 2], &[-1.0, 1.0]);
        refused(name, &[1, 2], &[Real::INFINITY, 1.0]);
    }
}

/// New measurements where the field has changed replace what was known there, as a fit to all of them would.
#[test]
fn update_adds_new_links_without_a_fit() {
    let base = Ensemble::of(model(0.0));
    let (before, after) =
        (data(&base, smooth), data(&base, |i, tx| smooth(i, tx) + if tx[0] > 0.5 { 0.2 } else { 0.0 }));
    for stride in [1, 4] {
        let residuals = fit(&Kriged { stride, ..Kriged::default() }, &base, &before).unwrap();
        let whole = base.clone().with_residuals(Some(residuals));
        let (updated, added) = whole.residuals().unwrap().updated(&whole, &after).unwrap();
        assert_eq!((added, updated.processes()[0].as_ref().unwrap().len()), (240, 440));
        let updated = base.clone().with_residuals(Some(updated));
        let [old, new] = [&whole, &updated].map(|ensemble| error(ensemble, &after));
        assert!(new < 0.7 * old, "stride {stride}: {new} after the update, {old} before");
    }
}

#[test]
fn fit_needs_left_out_links_and_positions_and_can_stop() {
    let base = Ensemble::of(model(0.0));
    let mut data = data(&base, smooth);
    let links = [0, 1, 2];
    let try_fit = |data: &Dataset, left_out: &[Option<usize>], stop| {
        let stop = &AtomicBool::new(stop);
        let known = KnownLinks { data, links: &links, left_out, parts: 1, blocks: &links, stop };
        Residuals::fit(&Kriged::default(), &base, known, &|_, _| {}).unwrap_err()
    };
    assert!(try_fit(&data, &[None; 3], false).to_string().contains("`validation` share"));
    assert!(matches!(try_fit(&data, &[Some(0), None, None], true), Error::Stopped));
    data.placed = false;
    let error = try_fit(&data, &[Some(0), None, None], false).to_string();
    assert!(error.contains("`Kriged` needs transmitter positions"));
}

#[test]
fn residuals_are_the_same_bytes_at_any_number_of_threads_and_from_the_file() {
    let base = Ensemble::new(vec![model(0.0), model(0.1)]).unwrap();
    let data = data(&base, smooth);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.safetensors");
    for stride in [1, 4] {
        let settings = Kriged { stride, ..Kriged::default() };
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            base.clone().with_residuals(Some(pool.install(|| fit(&settings, &base, &data)).unwrap()))
        };
        let whole = on(1);
        file::write_ensemble(&path, &whole).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(bytes == file::ensemble_to_bytes(&on(3)), "stride {stride}");
        let again = file::read_ensemble(&path).unwrap();
        assert!(bytes == file::ensemble_to_bytes(&again));
        assert_eq!(error(&whole, &data).to_bits(), error(&again, &data).to_bits());
    }
}

#[test]
fn invalid_residuals_of_a_file_are_refused() {
    let base = Ensemble::of(model(0.0));
    let full = data(&base, smooth);
    let grey = base.prepare().predict_timed([0.5; 3]).0.clamped();
    // Smooth spectra, of which a coarse grid loses little.
    let smooth = |i: usize| {
        let pixels = full.image(i).pixels;
        pixels.iter().zip(&grey.pixels).map(|(v, grey)| (0.5 + v - grey) as f32).collect::<Vec<_>>()
    };
    let pixels: Vec<f32> = (0..240).flat_map(smooth).collect();
    let samples = (0..240).map(|i| Sample::new(i as u32, full.sample(i).position())).collect();
    let data = Dataset::new("room", Pose::IDENTITY, vec![], samples, Spectra::float(SIZE, &pixels).unwrap()).unwrap();
    let whole =
        file::ensemble_to_bytes(&base.clone().with_residuals(Some(fit(&Kriged::default(), &base, &data).unwrap())));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.safetensors");
    let refused = |change: &dyn Fn(&mut Tensors)| {
        let mut tensors = Tensors::from_bytes(&whole).unwrap();
        change(&mut tensors);
        std::fs::write(&path, tensors.to_bytes()).unwrap();
        file::read_ensemble(&path).unwrap_err().to_string()
    };
    let edited = |from: &str, to: &str, word: &str| {
        let message = refused(&|tensors| {
            assert!(tensors.note.contains(from), "{}", tensors.note);
            tensors.note = tensors.note.replacen(from, to, 1);
        });
        assert!(message.contains(word), "{to}: {message}");
    };
    edited("\"stride\":4", "\"stride\":0", "`stride` is 0");
    edited("\"stride\":4", "\"stride\":3", "residuals.values");
    edited("\"stride\":4", "\"stride\":1", "residuals.values");
    edited("\"neighbours\":48", "\"neighbours\":100000", "`neighbours` is 100000");
    edited("\"links\":200", "\"links\":0", "needs a link");
    edited("\"links\":200", "\"links\":18446744073709551615", "expected [18446744073709551615, 3]");
    edited("\"share\":", "\"share\":2", "a share of");
    edited("\"noise\":", "\"noise\":-", "noise of");
    edited("\"noise\":", "\"path_loss\":[-40,20],\"noise\":", "a path loss of");
    edited("\"version\":3", "\"version\":2", "version 3");
    edited("\"receivers\":[{\"links\"", "\"receivers\":[null,{\"links\"", "residuals of 2 receivers");
    let message = refused(&|tensors| tensors.put("residuals.places", vec![200, 3], vec![Real::INFINITY; 600]));
    assert!(message.contains("residuals.places"), "{message}");
    let message = refused(&|tensors| tensors.put_i8("residuals.values", vec![1], vec![0]));
    assert!(message.contains("residuals.values"), "{message}");
}
