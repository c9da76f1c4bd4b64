//! Laws of every built-in plugin of a kind; `registry.rs` checks that all parse and are written as the same text.

use crate::common::{built_in, cloud, plugin, stages};
use pwrfgs::core::plugin::PluginKind;
use pwrfgs::core::{DeformationInputs, DeformationVjp, rng};
use pwrfgs::experiment::paired::is_custom;
use pwrfgs::methods::{Readout, Splatting};
use pwrfgs::prelude::*;
use std::path::Path;

/// Every built-in plugin of a kind with its defaults.
fn all<T: ?Sized + PluginKind>() -> Vec<(&'static str, Plugin<T>)>
where
    Box<T>: for<'de> Deserialize<'de>,
{
    let names = built_in::<T>();
    assert!(!names.is_empty(), "no {} is linked", T::KIND);
    names.into_iter().map(|name| (name, plugin(&format!("{name}()")))).collect()
}

fn finite(values: &[Real]) -> bool {
    values.iter().all(|v| v.is_finite())
}

fn data() -> Dataset {
    plugin::<dyn DataSource>("Teacher(gaussians: 5, samples: 260, width: 60, height: 15)")
        .load(Path::new("."), &|_, _| {})
        .unwrap()
}

#[test]
fn initializers_are_deterministic_and_finite() {
    let data = data();
    for projector in ["Mercator()", "WrfgsCompat()"] {
        let plane = plugin::<dyn Projector>(projector).plane(data.width, data.height);
        // Trained reads a file.
        for (name, initializer) in all::<dyn Initializer>().into_iter().filter(|(name, _)| *name != "Trained") {
            let start = |seed| initializer.initialize(&data.scene, &plane, &mut rng::stream(seed, "init", 0)).unwrap();
            let cloud = start(1);
            assert_eq!(cloud.is_empty(), name == "NoGaussians", "{name}");
            assert!(cloud.columns().all(|(_, _, values)| finite(values)), "{name}");
            assert!(cloud.columns().all(|(_, width, values)| values.len() == width * cloud.len()), "{name}");
            assert!(cloud.extra.is_empty(), "{name}: columns of pruners are not the initializer's to add");
            assert_eq!(cloud, start(1), "{name}");
        }
    }
}

#[test]
fn splits_are_deterministic_disjoint_and_sorted() {
    let data = data();
    // LeaveReceiverOut has nobody to leave out here, and says so.
    for (name, split) in all::<dyn Split>().into_iter().filter(|(name, _)| *name != "LeaveReceiverOut") {
        let part = |seed| split.split(&data, &mut rng::stream(seed, "split", 0)).unwrap();
        let Partition { train, validation, test } = part(1);
        assert!(!train.is_empty() && !test.is_empty(), "{name}");
        let lists = [&train, &validation, &test];
        assert!(lists.iter().all(|list| list.is_sorted_by(|a, b| a < b)), "{name}");
        let mut all: Vec<usize> = lists.into_iter().flatten().copied().collect();
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        assert!(all.len() == count && all.iter().all(|&i| i < data.len()), "{name}");
        assert_eq!(part(1), Partition { train, validation, test }, "{name}");
    }
}

#[test]
fn deformations_return_declared_shapes() {
    for (name, deformation) in all::<dyn Deformation>() {
        let weights = deformation.layout().init(&mut rng::stream(1, "network", 0));
        assert_eq!(weights, deformation.layout().init(&mut rng::stream(1, "network", 0)), "{name}");
        let txs = [[0.1, 0.2, 1.0], [-0.5, 0.3, 0.8]];
        for n in [0, 1, 5] {
            let means = cloud(n, 4).means;
            let inputs = DeformationInputs::new(&weights, &means, &txs, &Pose::IDENTITY);
            let deltas = deformation.forward(&inputs, &None);
            let rows = [deltas.scales.len(), deltas.quats.len(), deltas.signals.len()];
            assert!(rows.iter().all(|rows| [0, 2 * n].contains(rows)), "{name}: {rows:?} rows");
            let varies = deformation.traits().varies_geometry;
            assert!(varies || rows[..2] == [0, 0], "{name} varies geometry and does not say so");
            let flat = [deltas.scales.as_flattened(), deltas.quats.as_flattened(), deltas.signals.as_flattened()];
            assert!(flat.into_iter().all(finite), "{name}");
            let prepared = deformation.prepare(&weights, &means, &Pose::IDENTITY);
            for _ in 0..2 {
                assert_eq!(deformation.forward(&inputs, &prepared), deltas, "{name}, prepared");
            }
            let (mut d_weights, mut d_means) = (vec![0.0; weights.len()], vec![[0.0; 3]; n]);
            let mut d_txs = deformation.traits().differentiates_positions.then(|| vec![[0.0; 3]; txs.len()]);
            let (means, positions) = (Some(&mut d_means[..]), d_txs.as_deref_mut());
            deformation.vjp(&inputs, &deltas, DeformationVjp { weights: &mut d_weights, means, positions });
            assert!(finite(&d_weights) && finite(d_means.as_flattened()), "{name}");
            assert!(d_txs.is_none_or(|d_txs| finite(d_txs.as_flattened())), "{name}");
        }
    }
}

#[test]
fn projectors_and_rasterizers_return_one_row_per_gaussian() {
    let stages = stages("Fixed()", Readout::Real);
    let geometry =
        stages.settings::<Splatting>().unwrap().activation().geometry(&cloud(7, 5), &Deltas::default(), 0, None);
    for (name, projector) in all::<dyn Projector>() {
        let plane = projector.plane(90, 24);
        assert_eq!((plane.width, plane.height), (90, 24), "{name}");
        let splats = projector.project(&geometry, &Pose::IDENTITY, &plane);
        assert!(splats.len() == 7 && splats.radii.iter().all(|r| *r >= 0.0), "{name}");
        let seen = projector.sees(&geometry.means, &Pose::IDENTITY, &plane);
        assert!(splats.radii.iter().zip(seen).all(|(r, seen)| *r == 0.0 || seen), "{name} draws what it does not see");
        let raised = splats.opacities.iter().zip(&geometry.opacities).any(|(splat, own)| splat > own);
        assert!(!raised, "{name}: what is too faint to pass the network stays too faint");
        for (kind, rasterizer) in all::<dyn Rasterizer>() {
            if rasterizer.check_plane(&plane).is_err() {
                assert!(kind == "ArrayResponse" && name != "Mercator", "{kind} on {name} must know what a pixel means");
                continue;
            }
            let render = rasterizer.forward(splats.with_signals(&[0.5; 14], 2, &plane));
            assert!(render.pixels.len() == 2 * 90 * 24 && finite(&render.pixels), "{kind} on {name}");
            let prepared = rasterizer.prepare(&splats, &plane);
            for _ in 0..2 {
                let again = rasterizer.forward_prepared(splats.with_signals(&[0.5; 14], 2, &plane), &prepared);
                assert_eq!(again.pixels, render.pixels, "{kind} on {name}, prepared");
            }
            let light = |t: &Real| (0.0..=1.0).contains(t);
            let seen = &render.transmittance;
            assert!([0, 90 * 24].contains(&seen.len()) && seen.iter().all(light), "{kind}");
            let d = rasterizer.backward(splats.with_signals(&[0.5; 14], 2, &plane), &render, &render.pixels);
            assert!(d.signals.len() == 14 && d.weights.len() == 7 && finite(&d.signals), "{kind} on {name}");
            let d = projector.project_vjp(&geometry, &Pose::IDENTITY, &plane, &splats, &d.splats);
            assert!(d.len() == 7 && finite(d.means.as_flattened()) && finite(d.quats.as_flattened()), "{name}");
        }
    }
}

#[test]
fn baselines_predict_images_of_correct_size() {
    let data = data();
    let train: Vec<usize> = (0..30).collect();
    for (name, baseline) in all::<dyn Baseline>() {
        let fitted = match baseline.fit(&data, FittingSet::train(&train)) {
            Ok(fitted) => fitted,
            Err(e)
                if ["LogDistance", "NearestCarrier", "Predictions", "RayTracing", "Ridge", "Zero"].contains(&name) =>
            {
                assert!(
                    e.is_input(),
                    "they need powers, carriers, a folder, spectra of a known room, features, channels: {e}"
                );
                continue;
            }
            Err(e) => panic!("{name}: {e}"),
        };
        let picture = fitted.predict(data.query(35));
        assert!((picture.width, picture.height) == (60, 15) && finite(&picture.pixels), "{name}");
        assert!(!baseline.name().is_empty());
    }
}

#[test]
fn metrics_return_values_per_sample_or_one_total() {
    let data = data();
    let pictures: Vec<Image> = (0..4).map(|i| data.image(i)).collect();
    for projector in ["Mercator()", "WrfgsCompat()"] {
        let plane = plugin::<dyn Projector>(projector).plane(60, 15);
        let evaluation = Evaluation { predictions: &pictures, truths: &pictures, ..Evaluation::of(&data, &plane) };
        for (name, metric) in all::<dyn Metric>() {
            let measurements = metric.evaluate(&evaluation).unwrap();
            assert!(!measurements.is_empty(), "{name}");
            let energies = metric.energies(&evaluation).unwrap();
            // What it says it need not see changes nothing.
            let alone = match metric.scope() {
                Scope::Model => Some(Evaluation { predictions: &[], truths: &[], ..evaluation }),
                Scope::Sample => Some(Evaluation { predictions: &pictures[3..], truths: &pictures[3..], ..evaluation }),
                Scope::Energies => {
                    Some(Evaluation { predictions: &[], truths: &[], energies: &energies, ..evaluation })
                }
                Scope::All => None,
            };
            let alone = alone.map_or_else(Vec::new, |alone| metric.evaluate(&alone).unwrap());
            for (m, alone) in measurements.iter().zip(alone) {
                match (&m.values, alone.values) {
                    (Values::PerSample(all), Values::PerSample(one)) => assert_eq!(all[3..], one, "{name}"),
                    (all, one) => assert_eq!(*all, one, "{name}"),
                }
            }
            for m in measurements {
                assert!(!m.key.is_empty() && !is_custom(&m.key), "{name}");
                match m.values {
                    Values::PerSample(values) => assert_eq!(values.len(), 4, "{name}"),
                    Values::Whole(value) => assert!(!value.is_nan(), "{name}"),
                    Values::NotApplicable(why) => assert!(!why.is_empty(), "{name}"),
                }
            }
        }
    }
}
