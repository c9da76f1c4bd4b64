//! Derivatives of predictions by the position of the transmitter and the pose of a moving receiver, against central
//! differences: models of every method, ensembles, residual processes and baselines.

use crate::common::{cloud, plugin};
use pwrfgs::core::testing::check_vjp;
use pwrfgs::core::{FittingSet, GaussianCloud, MeasurementSetup, Origin, Projector, Query, Receiver, rng};
use pwrfgs::model::{Ensemble, KnownLinks, Kriged, Model, Prepared, Residuals, Stages};
use pwrfgs::prelude::*;
use std::sync::atomic::AtomicBool;

const AT: [Real; 3] = [0.31, -0.23, 0.72];
/// Far enough from the coordinates of the room for an origin of its own.
const ORIGIN: Origin = Origin([5_000.0, -3_000.0, 0.0]);
/// Links of the data.
const LINKS: usize = 60;
const NETWORK: &str = "Factored(depth: 2, width: 8, tx_encoding: Wavelengths(count: 2, longest_m: 9.0, shortest_m: 4.0), \
                       position_encoding: Octaves(1), near: (count: 20, length_m: 0.4))";
const MLP: &str = "Mlp(depth: 2, width: 8, skip: None, tx_hidden: 8, tx_features: 4, position_frequencies: 1, \
                   tx_frequencies: 1, head_init: 0.3)";
const WRFGS: &str = "Wrfgs(depth: 2, width: 8, frequencies: 1, skip: None)";
const POWER: &str = "ReceivedPower(sky_deg: 20, filter_deg2: 120.0)";

fn splats(deformation: &str, rest: &str) -> String {
    format!("Splatting(deformation: {deformation}, {rest})")
}

/// An untrained model of spectra, powers or channels, whose receiver may move about a transmitter.
fn model(method: &str, moving: End, seed: u64) -> Model {
    let method: Plugin<dyn Method> = plugin(method);
    let task = method.traits().task.unwrap_or_default();
    let projector: Plugin<dyn Projector> = plugin("Mercator()");
    let plain = ImagePlane::plain;
    let plane = match (task.has_pixels, task.is_complex) {
        (true, _) => projector.plane(36, 9),
        (_, true) => plain(3, 4),
        _ => plain(1, 1),
    };
    let frequencies_hz = if task.is_complex { vec![9e7, 1e8, 1.1e8] } else { vec![] };
    let pose = Pose { position: [-1.0, 0.3, -2.0], orientation: [0.1, 0.2, 0.3, 0.927_361_849_549_570_4] };
    let receiver = Receiver { antennas: vec![[0.0; 3], [0.1, -0.2, 0.05]], ..Receiver::new("one", pose) };
    let (receivers, transmitter) = match moving {
        End::Transmitter => (vec![receiver], None),
        End::Receiver => (vec![Receiver { pose: Pose::IDENTITY, ..receiver }], Some(pose.position)),
    };
    let setup = MeasurementSetup {
        origin: ORIGIN,
        moving,
        transmitter,
        receivers,
        task,
        plane,
        frequencies_hz,
        geodetic: None,
    };
    let stages = Stages { method, setup };
    stages.check().unwrap();
    let mut weights = stages.layout().init(&mut rng::stream(seed, "network", 0));
    let random = &mut rng::stream(seed, "training", 0);
    // Training positions of `near`, and weights that are zero at first.
    let of_network = stages.deformation().map_or(0, |own| own.layout().weight_count());
    let positions: Vec<[Real; 3]> = (0..40).map(|_| [(); 3].map(|()| rng::normal(random))).collect();
    if let Some(deformation) = stages.deformation().filter(|own| own.traits().inputs == 3) {
        deformation.start((&positions).into(), &mut weights[..of_network]);
    }
    weights.iter_mut().filter(|w| **w == 0.0).for_each(|w| *w = 0.3 * rng::normal(random));
    let mut cloud = cloud(6, seed);
    cloud.add_missing_columns(&stages.method.traits().columns).unwrap();
    for column in &mut cloud.extra {
        column.values.fill_with(|| 0.2 * rng::normal(random));
    }
    let has_gaussians = stages.method.traits().has_gaussians();
    Model {
        cloud: if has_gaussians { cloud } else { GaussianCloud::zeros(0) },
        stages,
        weights,
        training_positions: None,
    }
}

fn world(local: &[Real]) -> [f64; 3] {
    ORIGIN.world([local[0], local[1], local[2]])
}

/// Compares with central differences; the derivative is that of the same prediction.
fn check(name: &str, ready: &Prepared<'_>, more: Query<'_>) {
    let query = |x: &[Real]| Query { pose: Pose { position: world(x), ..more.pose }, ..more };
    let vjp = |x: &[Real], d: &[Real]| {
        let (image, d_tx, _) = ready.predict_vjp(query(x), |_| d.to_vec()).unwrap();
        assert_eq!(image, ready.predict_timed(query(x)).0, "{name}");
        d_tx.map(|d| d as Real).to_vec()
    };
    check_vjp(name, &AT, |x| ready.predict_timed(query(x)).0.pixels, vjp, 1e-6, 1e-3);
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn models_of_every_method_differentiate() {
    let spherical = "rasterizer: ArrayResponse(wavefront: Spherical(wavelength_m: 0.8)), readout: Magnitude";
    for method in [
        splats(NETWORK, "readout: Magnitude"),
        splats(NETWORK, "rasterizer: ArrayResponse(), readout: MinMax"),
        splats(NETWORK, spherical),
        splats(NETWORK, &format!("readout: {POWER}")),
        splats("Fixed()", &format!("readout: {POWER}")),
        splats(MLP, "readout: Power"),
        splats(WRFGS, "readout: Real"),
        format!("SplattedChannel(deformation: {NETWORK})"),
        "Nerf2(depth: 3, width: 8, samples: 20, azimuths: 7, elevations: 3, unit_m: 30.0, carrier_hz: 1e8)".into(),
    ] {
        check(&method, &model(&method, End::Transmitter, 3).prepare(), AT.map(f64::from).into());
    }
    for order in [0, 2] {
        let method = format!("VirtualTransmitters(order: {order})");
        check(&method, &model(&method, End::Transmitter, 3).prepare(), AT.map(f64::from).into());
    }
    let turned = Pose { position: AT.map(f64::from), orientation: [0.2, -0.1, 0.3, 0.927_361_849_549_570_4] };
    for method in [
        splats(NETWORK, spherical),
        splats(NETWORK, "readout: Magnitude"),
        splats(MLP, "readout: Magnitude"),
        splats(NETWORK, &format!("readout: {POWER}")),
        splats("Fixed()", &format!("readout: {POWER}")),
        format!("SplattedChannel(deformation: {NETWORK})"),
    ] {
        let moving = model(&method, End::Receiver, 3);
        check(&format!("{method}, moving"), &moving.prepare(), turned.into());
        check_pose(&method, &moving.prepare());
    }
    let waves = model("VirtualTransmitters(order: 1)", End::Receiver, 3);
    check("virtual transmitters, moving", &waves.prepare(), turned.into());
    assert!(!waves.prepare().has_orientation_derivative());
    let released = model(&splats(MLP, "readout: Magnitude, calibration: AsReleased"), End::Receiver, 3);
    assert!(!released.prepare().has_orientation_derivative());
}

/// Compares the derivative by position and orientation of a moving receiver with central differences.
fn check_pose(name: &str, ready: &Prepared<'_>) {
    let query = |x: &[Real]| {
        let orientation = [3, 4, 5, 6].map(|k| f64::from(x[k]));
        Query::from(Pose { position: world(x), orientation })
    };
    let vjp = |x: &[Real], d: &[Real]| {
        let (_, d_position, d_orientation) = ready.predict_vjp(query(x), |_| d.to_vec()).unwrap();
        d_position.iter().chain(&d_orientation.unwrap()).map(|d| *d as Real).collect()
    };
    let pose = [&AT[..], &[0.2, -0.1, 0.3, 0.927_361_85]].concat();
    check_vjp(&format!("{name}, pose"), &pose, |x| ready.predict_timed(query(x)).0.pixels, vjp, 1e-6, 1e-3);
}

/// Links at random positions: what a model predicts and a smooth remainder, or powers over distance.
fn data(task: Task, base: &Ensemble) -> Dataset {
    let random = &mut rng::stream(5, "positions", 0);
    let positions: Vec<[Real; 3]> = (0..LINKS).map(|_| [(); 3].map(|()| rng::uniform(random))).collect();
    let samples: Vec<Sample> = (0..).zip(&positions).map(|(id, at)| Sample::new(id, world(at))).collect();
    let receivers = vec![Receiver::new("one", base.members()[0].stages.setup.world_pose())];
    let ready = base.prepare();
    let value = |at: &[Real; 3]| (3.0 * at[0]).sin() * (2.0 * at[1]).cos();
    let observations = if task.has_pixels {
        let pixel = |at: &[Real; 3], k: usize, p: Real| (p + 0.3 * value(at) * (0.2 * k as Real).cos()) as f32;
        let image = |at: &[Real; 3]| ready.predict_timed(world(at)).0.clamped().pixels;
        let all: Vec<f32> =
            positions.iter().flat_map(|at| image(at).into_iter().enumerate().map(|(k, p)| pixel(at, k, p))).collect();
        Spectra::float((36, 9), &all).unwrap().into()
    } else {
        Observations::Powers(positions.iter().map(|at| -60.0 + 5.0 * value(at) + 3.0 * at[2]).collect())
    };
    Dataset::of_links("room", receivers, vec![], &samples, observations).unwrap()
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn ensembles_and_residual_processes_differentiate() {
    for (rest, task) in [("readout: Magnitude", Task::Spectrum), (&format!("readout: {POWER}"), Task::Power)] {
        let mut members: Vec<Model> =
            (1..3).map(|seed| model(&splats(NETWORK, rest), End::Transmitter, seed)).collect();
        members[0].cloud.signals.as_flattened_mut().iter_mut().for_each(|s| *s *= 20.0);
        let pixels = members[0].predict(world(&AT)).pixels;
        assert!(!task.has_pixels || pixels.iter().any(|p| *p > 1.0), "some pixels are clamped");
        let base = Ensemble::new(members).unwrap();
        check(&format!("mean, {rest}"), &base.prepare(), AT.map(f64::from).into());
        let (data, links) = (data(task, &base), (0..LINKS).collect::<Vec<_>>());
        let left_out: Vec<Option<usize>> = links.iter().map(|i| (i % 4 != 0).then_some(0)).collect();
        let stop = &AtomicBool::new(false);
        let known = KnownLinks { data: &data, links: &links, left_out: &left_out, parts: 2, blocks: &links, stop };
        let strides = if task.has_pixels { &[4, 1][..] } else { &[1] };
        for settings in strides.iter().map(|&stride| Kriged { stride, ..Kriged::default() }) {
            let found = Residuals::fit(&settings, &base, known, &|_, _| {}).unwrap();
            let corrected = base.clone().with_residuals(Some(found));
            check(&format!("{settings:?}, {rest}"), &corrected.prepare(), AT.map(f64::from).into());
        }
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn baselines_differentiate_except_nearest_neighbours() {
    for (rest, task) in [("readout: Magnitude", Task::Spectrum), (&format!("readout: {POWER}"), Task::Power)] {
        let data = data(task, &Ensemble::of(model(&splats(NETWORK, rest), End::Transmitter, 1)));
        let links: Vec<usize> = (0..LINKS).collect();
        for name in ["Kriging()", "Kriging(neighbours: 7)", "MeanSpectrum()", "LogDistance()", "NearestNeighbours()"] {
            let baseline: Plugin<dyn Baseline> = plugin(name);
            if !baseline.tasks().contains(&task) {
                continue;
            }
            let fitted = baseline.fit(&data, FittingSet::train(&links)).unwrap();
            let predict = |x: &[Real]| fitted.predict(world(x).into()).pixels;
            let vjp = |x: &[Real], d: &[Real]| {
                let (image, d_tx) = fitted.predict_vjp(world(x).into(), &|_| d.to_vec()).unwrap();
                assert_eq!(image.pixels, predict(x), "{name}");
                d_tx.map(|d| d as Real).to_vec()
            };
            if name.starts_with("NearestNeighbours") {
                assert!(fitted.predict_vjp(world(&AT).into(), &|_| Vec::new()).is_none());
                continue;
            }
            check_vjp(&format!("{name}, {rest}"), &AT, predict, vjp, 1e-5, 1e-3);
        }
    }
}

#[test]
fn model_of_features_has_no_derivative_by_position() {
    let network = "Factored(depth: 1, width: 8, tx_encoding: Features(width: 4), position_encoding: Octaves(1))";
    let model = model(&format!("SplattedChannel(deformation: {network})"), End::Transmitter, 1);
    let query = Query { features: Some(&[0.1, 0.2, 0.3, 0.4]), ..[0.0; 3].into() };
    assert!(!model.prepare().has_derivative());
    assert!(model.prepare().predict_vjp(query, |image| image.pixels.clone()).is_none());
}
