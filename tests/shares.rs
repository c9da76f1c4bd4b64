//! With a share of 0, a model with residuals predicts the bits of the Kriging baseline.

use pwrfgs::core::kriging::log_distance;
use pwrfgs::core::{
    Baseline, Dataset, FittingSet, GaussianCloud, Method, Observations, Plugin, Pose, Predict, Real, Receiver, Sample,
    Spectra, rng,
};
use pwrfgs::data::Kriging;
use pwrfgs::model::{Ensemble, KnownLinks, Kriged, Model, Residuals, Stages, file};
use std::sync::atomic::AtomicBool;

/// Spectra that vary smoothly with the transmitter, 16 x 8 pixels.
fn spectra() -> Dataset {
    let mut random = rng::stream(3, "places", 0);
    let places: Vec<[f64; 3]> = (0..90).map(|_| [(); 3].map(|()| 4.0 * rng::uniform_f64(&mut random))).collect();
    let mut value = |[x, y, _]: [f64; 3], k: usize| {
        let noise = 0.05 * rng::uniform_f64(&mut random);
        (0.5 + 0.3 * (x + 0.3 * k as f64).sin() * y.cos() + noise) as f32
    };
    let pixels: Vec<f32> = places.iter().flat_map(|at| (0..128).map(|k| value(*at, k)).collect::<Vec<_>>()).collect();
    let samples = places.iter().enumerate().map(|(i, at)| Sample::new(i as u32, *at)).collect();
    Dataset::new("smooth", Pose::IDENTITY, vec![], samples, Spectra::float((16, 8), &pixels).unwrap()).unwrap()
}

/// Powers at two receivers with path loss, a wave and noise.
fn powers() -> Dataset {
    let ends = [[-3.0, 0.0, 2.0], [12.0, 3.0, 2.0]];
    let mut random = rng::stream(4, "places", 0);
    let place = |i: u32| [f64::from(i % 10) + 0.1, f64::from(i / 10), 0.3];
    let samples: Vec<Sample> =
        (0..80).flat_map(|i| (0..2).map(move |receiver| Sample { receiver, ..Sample::new(i, place(i)) })).collect();
    let power = |s: &Sample| {
        let at = s.position();
        let wave = 3.0 * (0.8 * at[0] + s.receiver as f64).sin() + rng::uniform_f64(&mut random);
        (-40.0 - 20.0 * log_distance(at, ends[s.receiver]) + wave) as Real
    };
    let powers = samples.iter().map(power).collect();
    let receiver = |k: usize| Receiver::new(["a", "b"][k], Pose { position: ends[k], ..Pose::IDENTITY });
    let receivers: Vec<Receiver> = (0..2).map(receiver).collect();
    Dataset::of_links("grid", receivers, vec![], &samples, Observations::Powers(powers)).unwrap()
}

/// A model that ignores the transmitter.
fn constant_model(data: &Dataset, readout: &str) -> Ensemble {
    let text = format!(
        "Splatting(deformation: Fixed(), projector: Mercator(), rasterizer: AlphaBlending(), \
                calibration: Physical, readout: {readout})"
    );
    let stages = Stages::of(Plugin::<dyn Method>::parse(&text).unwrap(), data).unwrap();
    let mut cloud = GaussianCloud::zeros(2);
    cloud.means = vec![[1.0, 0.5, 1.0], [-1.0, 1.0, 1.5]];
    cloud.quats = vec![[1.0, 0.0, 0.0, 0.0]; 2];
    cloud.signals = vec![[0.5, 0.2]; 2];
    let weights = vec![0.0; stages.layout().weight_count()];
    Ensemble::of(Model { stages, cloud, weights, training_positions: None })
}

/// Fits residuals of all links but the last 20, of which every fifth transmitter was left out, and compares predictions of
/// the others.
fn check(data: &Dataset, base: &Ensemble) {
    let links: Vec<usize> = (0..data.len() - 20).collect();
    let blocks: Vec<usize> = links.iter().map(|&k| data.links[k].location).collect();
    let left_out: Vec<Option<usize>> = blocks.iter().map(|k| (k % 5 == 0).then_some(0)).collect();
    let stop = &AtomicBool::new(false);
    let known = KnownLinks { data, links: &links, left_out: &left_out, parts: 1, blocks: &blocks, stop };
    let settings = Kriged { stride: 1, ..Kriged::default() };
    let residuals = Residuals::fit(&settings, base, known, &|_, _| {}).unwrap();
    assert_eq!(residuals.share(), Some(0.0));
    let whole = file::from_bytes(&file::ensemble_to_bytes(&base.clone().with_residuals(Some(residuals)))).unwrap();
    let (ready, kriging) = (whole.prepare(), Kriging::default().fit(data, FittingSet::train(&links)).unwrap());
    for i in links.len()..data.len() {
        let query = data.query(i);
        let bits = |pixels: &[Real]| pixels.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&ready.predict(query).pixels), bits(&kriging.predict(query).pixels), "{i}");
        assert_eq!(ready.deviation(query).map(f64::to_bits), kriging.deviation(query).map(f64::to_bits), "{i}");
        let weigh = |image: &pwrfgs::core::Image| (0..image.pixels.len()).map(|k| (k as Real).cos()).collect();
        let [(_, a), (_, b)] = [&ready as &dyn Predict, &*kriging].map(|p| p.predict_vjp(query, &weigh).unwrap());
        (0..3).for_each(|k| assert!((a[k] - b[k]).abs() < 1e-6 * b[k].abs().max(1.0), "{a:?} and {b:?}"));
    }
}

#[test]
fn share_of_zero_is_kriging_to_the_bit() {
    let (spectra, powers) = (spectra(), powers());
    check(&spectra, &constant_model(&spectra, "Magnitude"));
    check(&powers, &constant_model(&powers, "ReceivedPower()"));
}
