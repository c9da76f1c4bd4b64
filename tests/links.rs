//! Powers and channels at several receivers: bits, and the code path shared with spectra.

use pwrfgs::core::{Channels, Features, FittingSet};
use pwrfgs::model::{Ensemble, Model, file};
use pwrfgs::pipeline::Pipeline;
use pwrfgs::prelude::*;
use pwrfgs::train::Trainer;
use std::path::Path;
use std::sync::OnceLock;

/// A hall with two receivers; transmitter 7 is heard by one of them alone.
fn hall(observe: impl Fn(&[Sample]) -> Observations) -> Dataset {
    let at = |name: &str, x| Receiver::new(name, Pose { position: [x, 0.0, 2.5], ..Pose::IDENTITY });
    let random = &mut rng::stream(0, "hall", 0);
    let mut samples = Vec::new();
    for id in 1..=40 {
        let tx = [(); 3].map(|()| 6.0 * f64::from(rng::uniform(random) as f32));
        samples
            .extend((0..2).filter(|r| id != 7 || *r == 1).map(|receiver| Sample { receiver, ..Sample::new(id, tx) }));
    }
    Dataset::of_links("hall", vec![at("north", -1.0), at("south", 8.0)], vec![], &samples, observe(&samples)).unwrap()
}

fn distance(sample: &Sample) -> f64 {
    let place = [[-1.0, 0.0, 2.5], [8.0, 0.0, 2.5]][sample.receiver];
    sample.position().iter().zip(place).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

fn powers() -> Dataset {
    let dbm = |s: &Sample| (-40.0 - 22.0 * distance(s).log10() - 3.0 * s.receiver as f64) as Real;
    hall(|samples| Observations::Powers(samples.iter().map(dbm).collect()))
}

/// Free space at two subcarriers, heard by the first receiver.
fn channels() -> Dataset {
    let frequencies_hz = vec![3e8, 3.1e8];
    let samples: Vec<Sample> =
        hall(|s| Observations::Powers(vec![0.0; s.len()])).samples().filter(|s| s.receiver == 0).collect();
    let gain = |s: &Sample, hz: f64| {
        let d = distance(s);
        let phase = -std::f64::consts::TAU * hz / 299_792_458.0 * d;
        [phase.cos() / d, phase.sin() / d].map(|v| v as Real)
    };
    let gains = samples.iter().flat_map(|s| frequencies_hz.iter().map(move |hz| gain(s, *hz))).collect();
    let place = Pose { position: [-1.0, 0.0, 2.5], ..Pose::IDENTITY };
    let observed = Observations::Channels(Channels { antennas: 1, frequencies_hz, gains });
    Dataset::of_links("hall", vec![Receiver::new("north", place)], vec![], &samples, observed).unwrap()
}

fn moving_array() -> Ends {
    Ends::of_moving_receivers(vec![Receiver::new("array", Pose::IDENTITY)], Some([0.4, -0.3, 2.5]))
}

/// Spectra at a receiver that moves and turns: one spot, towards a transmitter above.
fn moving() -> Dataset {
    let random = &mut rng::stream(1, "moving", 0);
    let mut uniform = || 2.0 * f64::from(rng::uniform(random) as f32) - 1.0;
    let (width, height) = (36, 9);
    let (mut samples, mut pixels) = (Vec::new(), Vec::new());
    for id in 1..=60 {
        let pose = Pose { position: [3.0 * uniform(), 3.0 * uniform(), 0.3 * uniform()], ..Pose::IDENTITY };
        let (sin, cos) = (1.5 * uniform()).sin_cos();
        let pose = Pose { orientation: [0.0, 0.0, sin, cos], ..pose };
        let sight = pose.to_receiver([0.4, -0.3, 2.5]);
        let norm = sight.iter().map(|v| v * v).sum::<f64>().sqrt();
        for pixel in 0..width * height {
            let [azimuth, elevation] = [pixel % width, pixel / width].map(|k| (10.0 * k as f64).to_radians());
            let direction = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
            let cos: f64 = direction.iter().zip(sight).map(|(a, b)| a * b / norm).sum();
            pixels.push((255.0 * (20.0 * (cos - 1.0)).exp()) as u8);
        }
        samples.push(Sample::new(id, pose));
    }
    let spectra = Spectra::grey((width, height), pixels).unwrap();
    Dataset::of_links("moving", moving_array(), vec![], &samples, spectra.into()).unwrap()
}

/// Spectra at three carriers: a spot towards the transmitter, and one opposite that fades in with the frequency.
fn carriers() -> Dataset {
    let random = &mut rng::stream(2, "carriers", 0);
    let (width, height) = (36, 9);
    let (mut samples, mut hz, mut pixels) = (Vec::new(), Vec::new(), Vec::new());
    for id in 1..=40 {
        let tx = [(); 3].map(|()| 2.0 * f64::from(rng::uniform(random) as f32) + 1.0);
        let norm = tx.iter().map(|v| v * v).sum::<f64>().sqrt();
        for carrier in 0..3 {
            for pixel in 0..width * height {
                let [azimuth, elevation] = [pixel % width, pixel / width].map(|k| (10.0 * k as f64).to_radians());
                let direction = [elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin()];
                let spot = |sign: f64| {
                    let level = direction.iter().zip([sign * tx[0], sign * tx[1], tx[2]]).map(|(a, b)| a * b / norm);
                    (8.0 * (level.sum::<f64>() - 1.0)).exp()
                };
                pixels.push((127.0 * (spot(1.0) + 0.5 * f64::from(carrier) * spot(-1.0))) as u8);
            }
            samples.push(Sample::new(3 * id + carrier, tx));
            hz.push(2e9 * 1.1_f64.powi(carrier as i32).min(1.21));
        }
    }
    let spectra = Spectra::grey((width, height), pixels).unwrap();
    Dataset::new("carriers", Pose::IDENTITY, vec![], samples, spectra).unwrap().with_carriers(&hz).unwrap()
}

fn pipeline(fields: &str) -> Pipeline {
    let text = format!("Pipeline(name: \"links\", {fields})");
    Pipeline::parse(&text, Path::new("links.ron")).unwrap()
}

const POWERS: &str = "data: Nerf2Rssi(root: \"none\"), initializer: AroundReceivers(count: 40), \
    deformation: Factored(depth: 2, width: 16, tx_encoding: Wavelengths(count: 2, longest_m: 12.0, shortest_m: 6.0)), \
    pruners: [OpacityThreshold(epsilon: 0.28)], training: (steps: 40, batch: 8, dropout: 0.1, densify_until: 5, prune_until: 20, \
    prune_every: 5, densify: (every: 0))";
const WAVES: &str = "data: Channels(root: \"none\"), initializer: MatchingPursuit(most: 2, hold_out: 0, reach: 0.2, step: 0.3), \
    method: VirtualTransmitters(order: 1), pruners: [LearnableMask()], training: (steps: 30, batch: 8, densify_until: 0, \
    prune_until: 10, prune_every: 5, densify: (every: 0), optimizer: (means: Constant(0.0001), signals: Constant(0.001)))";
const UPLINK: &str = "data: Nerf2Csi(root: \"none\"), initializer: AroundReceivers(count: 12, near: 0.0), \
    deformation: Factored(depth: 1, width: 8, tx_encoding: Features(width: 4), position_encoding: Waves(count: 8, reach: 2.0)), \
    training: (steps: 30, batch: 8, densify_until: 0, prune_until: 0, densify: (every: 0))";

const MOVING: &str = "data: Arrays(root: \"none\"), initializer: Random(count: 60, std: 2.0), \
    deformation: Factored(depth: 1, width: 8, tx_encoding: Octaves(0)), readout: Magnitude, pruners: [OpacityThreshold(epsilon: 0.01)], \
    training: (steps: 150, batch: 8, densify_until: 5, prune_until: 20, prune_every: 5, densify: (every: 0), optimizer: \
    (means: Constant(0.02), log_scales: Constant(0.02), opacity_logits: Constant(0.05), signals: Constant(0.05)))";

const CARRIERS: &str = "data: Arrays(root: \"none\"), initializer: Random(count: 60, std: 3.0), projector: Mercator(), \
    deformation: Factored(depth: 2, width: 24, tx_encoding: Octaves(0), carrier: 1.0), readout: Magnitude, \
    training: (steps: 300, batch: 4, densify_until: 0, prune_until: 0, densify: (every: 0), optimizer: \
    (means: Constant(0.02), log_scales: Constant(0.02), opacity_logits: Constant(0.05), signals: Constant(0.05), \
    network: Constant(0.01)))";

/// All that are trained here, each with its data and how they are divided: every fifth transmitter is tested.
fn cases() -> Vec<(&'static str, Pipeline, Dataset, Partition)> {
    let mut uplink = channels();
    let values = (0..uplink.len()).flat_map(|i| uplink.image(i).pixels).collect();
    uplink.features = Some(Features { width: 4, values });
    let case = |name, fields, data: Dataset| {
        let (test, train) = (0..data.len()).partition(|&i| data.links[i].location % 5 == 4);
        (name, pipeline(fields), data, Partition { train, test, ..Partition::default() })
    };
    vec![
        case("powers", POWERS, powers()),
        case("waves", WAVES, channels()),
        case("uplink", UPLINK, uplink),
        case("moving", MOVING, moving()),
        case("carriers", CARRIERS, carriers()),
    ]
}

/// The models of [`cases`], trained by one thread.
fn models() -> &'static [Model] {
    static MODELS: OnceLock<Vec<Model>> = OnceLock::new();
    let of = |(_, pipeline, data, partition): &(_, Pipeline, Dataset, Partition)| {
        trained(&mut pipeline.trainer(data, partition).unwrap())
    };
    let one = || rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    MODELS.get_or_init(|| one().install(|| cases().iter().map(of).collect()))
}

fn trained(trainer: &mut Trainer<'_>) -> Model {
    while !trainer.finished() {
        trainer.step().unwrap();
    }
    trainer.model()
}

#[test]
fn link_training_is_bit_identical_if_resumed_or_threaded() {
    for ((name, pipeline, data, partition), model) in cases().into_iter().zip(models()) {
        let whole = file::to_bytes(model);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        let other = pool.install(|| trained(&mut pipeline.trainer(&data, &partition).unwrap()));
        assert!(whole == file::to_bytes(&other), "{name}: on three threads");
        let mut first = pipeline.trainer(&data, &partition).unwrap();
        (0..13).for_each(|_| {
            first.step().unwrap();
        });
        let mut second = Trainer::restore(&pipeline.plan().unwrap(), &data, &partition, &first.checkpoint()).unwrap();
        assert!(file::to_bytes(&trained(&mut second)) == whole, "{name}: resumed");
    }
}

#[test]
fn batch_predictions_equal_single_predictions_after_reload() {
    let folder = tempfile::tempdir().unwrap();
    for ((name, _, data, _), model) in cases().into_iter().zip(models()) {
        let path = folder.path().join(name);
        file::write(&path, model).unwrap();
        let read = file::read(&path).unwrap();
        assert_eq!(read.stages.setup, model.stages.setup, "{name}");
        let (ready, ensemble) = (read.prepare(), Ensemble::new(vec![model.clone(), model.clone()]).unwrap());
        let queries: Vec<Query<'_>> = (0..data.len()).map(|i| data.query(i)).collect();
        let (many, both) = (ready.predict_many(&queries), ensemble.prepare().predict_many(&queries));
        for (i, (image, both)) in many.iter().zip(&both).enumerate() {
            assert_eq!((image.width, image.height), (data.width, data.height));
            assert_eq!(*image, model.predict(data.query(i)), "{name}: link {i}");
            // The mean of two that are alike; spectra are clamped before.
            let image = data.task().shown(image.clone());
            assert_eq!(image.pixels, both.pixels, "{name}: link {i}");
        }
        for (ready, many) in [(ready, many), (ensemble.prepare(), both)] {
            let mut numbers = vec![Real::NAN; queries.len() * data.width * data.height];
            ready.predict_into(&queries, &mut numbers);
            let images: Vec<Real> = many.iter().flat_map(|image| image.pixels.clone()).collect();
            assert_eq!(numbers, images, "{name}");
        }
    }
}

#[test]
fn data_of_another_carrier_are_refused() {
    let case = cases().into_iter().zip(models()).find(|((name, ..), _)| *name == "carriers");
    let ((_, _, mut data, _), model) = case.unwrap();
    pwrfgs::experiment::check_alike(&model.prepare(), &data).unwrap();
    data.scene.receivers[1].carrier_hz = Some(9e9);
    let message = pwrfgs::experiment::check_alike(&model.prepare(), &data).unwrap_err().to_string();
    assert!(message.contains("9000000000 Hz in the data"), "{message}");
}

#[test]
fn training_reduces_error_for_every_task() {
    for ((name, _, data, partition), model) in cases().into_iter().zip(models()) {
        let error = |predict: &dyn Predict| -> f64 {
            let of = |&i: &usize| {
                let (p, t) = (predict.predict(data.query(i)), data.image(i));
                p.pixels.iter().zip(&t.pixels).map(|(p, t)| f64::from((p - t) as f32).powi(2)).sum::<f64>()
            };
            partition.test.iter().map(of).sum()
        };
        let floor: Plugin<dyn Baseline> = Plugin::parse("MeanSpectrum()").unwrap();
        let mean = floor.fit(&data, FittingSet::train(&partition.train)).unwrap();
        let (own, floor) = (error(model), error(&*mean));
        // One cloud for all carriers learns more slowly.
        let share = if name == "carriers" { 0.4 } else { 0.25 };
        assert!(own < share * floor, "{name}: squared error {own} against {floor} of the mean");
    }
}

/// Powers or channels of two antennas at the receiver of [`moving`].
fn moving_links(observations: Observations) -> Dataset {
    let mut ends = moving_array();
    if let Observations::Channels(channels) = &observations {
        ends.receivers[0].antennas = (0..channels.antennas).map(|k| [0.3 * k as f64, 0.0, 0.0]).collect();
    }
    let samples: Vec<Sample> = moving().samples().collect();
    Dataset::of_links("walk", ends, vec![], &samples, observations).unwrap()
}

/// The settings of powers for so many steps, without pruning.
fn unpruned(steps: usize) -> String {
    POWERS
        .replace("pruners: [OpacityThreshold(epsilon: 0.28)], ", "")
        .replace("steps: 40", &format!("steps: {steps}"))
        .replace("densify_until: 5, prune_until: 20, prune_every: 5", "densify_until: 0, prune_until: 0")
}

/// Models of a moving receiver, one per task and method, each with data.
fn moving_models() -> Vec<(&'static str, Dataset, Model)> {
    let random = &mut rng::stream(4, "walk", 0);
    let dbm = moving().samples().map(|s| (-50.0 - s.position()[0]) as Real).collect::<Vec<Real>>();
    let mut channels = |antennas| {
        let frequencies_hz = vec![3e8, 3.1e8];
        let gains = (0..60 * antennas * 2).map(|_| [(); 2].map(|()| rng::normal(random))).collect();
        Observations::Channels(Channels { antennas, frequencies_hz, gains })
    };
    let splatted = UPLINK.replace("Features(width: 4)", "Octaves(1)").replace("Nerf2Csi", "Channels");
    let short = unpruned(8);
    let [one, two] = [1, 2].map(&mut channels);
    let case = |name, fields: &str, observations| {
        let data = moving_links(observations);
        let partition = Partition { train: (0..50).collect(), test: (50..60).collect(), ..Partition::default() };
        let model = trained(&mut pipeline(fields).trainer(&data, &partition).unwrap());
        (name, data, model)
    };
    vec![
        case("powers", &short, dbm.into()),
        case("channels", &splatted, two),
        case("waves", WAVES, one),
        ("spectra", moving(), models()[3].clone()),
    ]
}

#[test]
fn moving_receiver_predicts_as_fixed_receiver_at_its_pose() {
    for (name, data, mut model) in moving_models() {
        assert!(model.stages.setup.moving.is_receiver(), "{name}");
        if name == "powers" {
            // The fixed receiver here stands at its transmitter: without the path-loss exponent, distances have no effect.
            *model.weights.last_mut().unwrap() = 0.0;
        }
        for i in 0..10 {
            let Query { pose, .. } = data.query(i);
            let mut fixed = model.clone();
            let MeasurementSetup { moving, transmitter, receivers, .. } = &mut fixed.stages.setup;
            (*moving, *transmitter, receivers[0].pose) = (End::Transmitter, None, pose);
            fixed.stages.check().unwrap();
            assert_eq!(model.predict(pose), fixed.predict(pose.position), "{name}, pose {i}");
            let folder = tempfile::tempdir().unwrap();
            file::write(&folder.path().join("m"), &model).unwrap();
            let read = file::read(&folder.path().join("m")).unwrap();
            assert_eq!(
                (read.stages.setup == model.stages.setup, read.predict(pose)),
                (true, model.predict(pose)),
                "{name}"
            );
        }
        if name == "spectra" || name == "channels" {
            assert_ne!(
                model.predict(data.query(0).pose),
                model.predict(Pose::from(data.query(0).position())),
                "{name}"
            );
        }
        // A part keeps the poses of its links.
        assert_eq!(data.subset(&[3, 8]).unwrap().query(1).pose, data.query(8).pose);
    }
}

#[test]
fn file_in_which_transmitter_was_stored_as_receiver_is_refused() {
    let model = &models()[3];
    // The note is JSON in JSON.
    let (new, old) = (br#"version\":8"#, br#"version\":6"#);
    let mut bytes = file::to_bytes(model);
    let start = bytes.windows(new.len()).position(|part| part == new).unwrap();
    bytes[start..start + old.len()].copy_from_slice(old);
    let message = file::from_bytes(&bytes).unwrap_err();
    assert_eq!(message, "a `pwrfgs-model` of version 6, expected `pwrfgs-model` of version 5, 7 or 8; train it again");
}

#[test]
fn power_at_moving_receiver_falls_with_distance_from_transmitter() {
    let network = unpruned(1).replace(
        "deformation: Factored(depth: 2, width: 16, tx_encoding: Wavelengths(count: 2, longest_m: 12.0, \
    shortest_m: 6.0))",
        "deformation: Fixed()",
    );
    let data = moving_links(vec![-50.0; 60].into());
    let partition = Partition { train: (0..50).collect(), test: (50..60).collect(), ..Partition::default() };
    let mut model = trained(&mut pipeline(&network).trainer(&data, &partition).unwrap());
    *model.weights.last_mut().unwrap() = 2.5;
    let transmitter = model.stages.setup.transmitter.unwrap();
    let mut fixed = model.clone();
    fixed.stages.setup.moving = End::Transmitter;
    for i in 0..10 {
        let Query { pose, .. } = data.query(i);
        fixed.stages.setup.receivers[0].pose = pose;
        assert_eq!(model.predict(pose), fixed.predict(transmitter), "pose {i}");
    }
    let mut unknown = model.clone();
    unknown.stages.setup.transmitter = None;
    assert_ne!(unknown.predict(data.query(0)), model.predict(data.query(0)), "the distance has an effect");
}

#[test]
fn left_out_carrier_is_predicted() {
    let data = carriers();
    assert_eq!((data.locations.len(), data.len()), (40, 120));
    let (test, train) = (0..data.len()).partition(|&i| data.links[i].receiver == 1);
    let partition = Partition { train, test, ..Partition::default() };
    // The mean of four: the error of a single one varies by a factor of three with the seed.
    let seeded = |seed| pipeline(&format!("seed: {seed}, {CARRIERS}"));
    let models: Vec<Model> =
        (0..4).map(|seed| trained(&mut seeded(seed).trainer(&data, &partition).unwrap())).collect();
    let fit = |text: &str| Plugin::<dyn Baseline>::parse(text).unwrap().fit(&data, FittingSet::train(&partition.train));
    let error = |predict: &dyn Fn(usize) -> Image| -> f64 {
        let square = |i: &usize| {
            let pairs = predict(*i).pixels.into_iter().zip(data.image(*i).pixels);
            pairs.map(|(a, b)| f64::from((a - b) as f32).powi(2)).sum::<f64>()
        };
        partition.test.iter().map(square).sum()
    };
    let [mean, nearest] = ["MeanSpectrum()", "NearestCarrier()"].map(|text| {
        let fitted = fit(text).unwrap();
        error(&|i| fitted.predict(data.query(i)))
    });
    let predict = |query: Query<'_>| {
        let mut sum = Image::zeros(36, 9);
        for model in &models {
            sum.pixels.iter_mut().zip(model.predict(query).pixels).for_each(|(sum, pixel)| *sum += pixel / 4.0);
        }
        sum
    };
    let own = error(&|i| predict(data.query(i)));
    assert!(own < 0.5 * mean && own < nearest, "squared error {own}, mean {mean}, nearest carrier {nearest}");
    let query = data.query(1);
    assert_ne!(predict(query), predict(Query { receiver: 2, ..query }), "the carrier has an effect");
}

#[test]
fn network_without_carrier_is_reported() {
    let (_, _, data, partition) = cases().remove(4);
    let told = |fields: &str| pipeline(fields).trainer(&data, &partition).unwrap_err().to_string();
    let deaf = told(&CARRIERS.replace(", carrier: 1.0", ""));
    assert!(
        deaf.contains("the data have 3 carriers, but the deformation ignores them; use Factored(carrier: 2)"),
        "{deaf}"
    );
    let ray = told(
        "data: Arrays(root: \"none\"), method: Nerf2(), training: (steps: 1, rays: Each(8), loss: (ssim_weight: 0.0))",
    );
    assert!(ray.contains("`Nerf2` needs one carrier, but these data have several"), "{ray}");
    let array = "rasterizer: ArrayResponse(wavefront: Spherical(wavelength_m: 0.1)), readout: MinMax";
    let sphere = told(&CARRIERS.replace("readout: Magnitude", array));
    assert!(sphere.contains("Spherical has one wavelength"), "{sphere}");
}

#[test]
fn invalid_use_of_a_moving_receiver_is_reported() {
    let spectra = || moving().observations;
    let refused = |poses: Vec<Pose>| {
        let samples: Vec<Sample> = (1..).zip(poses).map(|(id, pose)| Sample::new(id, pose)).collect();
        Dataset::of_links("walk", moving_array(), vec![], &samples, spectra()).unwrap_err().to_string()
    };
    assert!(refused(vec![Pose::IDENTITY; 3]).contains("60 spectra for 3 receiver poses; give as many of each"));
    let zero = Pose { orientation: [0.0; 4], ..Pose::IDENTITY };
    assert!(refused(vec![zero; 60]).contains("the receiver of id 1 at [0.0, 0.0, 0.0]: the quaternion is zero"));
    let data = moving();
    let partition = Partition { train: (0..50).collect(), test: (50..60).collect(), ..Partition::default() };
    let told = |fields: &str| pipeline(fields).trainer(&data, &partition).unwrap_err().to_string();
    let ray = told(
        "data: Arrays(root: \"none\"), method: Nerf2(), training: (steps: 1, rays: Each(8), loss: (ssim_weight: 0.0))",
    );
    assert!(ray.contains("that of these data moves; use Splatting()"), "{ray}");
}

/// A source of waves has no size, whatever its columns say: densification leaves it alone.
#[test]
fn virtual_transmitters_are_not_densified() {
    let fields = WAVES
        .replace("densify_until: 0", "densify_until: 40")
        .replace("steps: 30", "steps: 40")
        .replace("prune_until: 10", "prune_until: 40")
        .replace("densify: (every: 0)", "densify: (every: 5, from: 5, large_after: 1, reset_every: 10)")
        .replace("pruners: [LearnableMask()], ", "");
    let (_, _, data, partition) = cases().remove(1);
    let pipeline = pipeline(&fields);
    let mut trainer = pipeline.trainer(&data, &partition).unwrap();
    let before = trainer.cloud().opacity_logits.clone();
    let model = trained(&mut trainer);
    assert_eq!(model.cloud.opacity_logits, before, "no source is gone, and none is fainter");
    let harmonics = &model.cloud.extra("harmonics").unwrap().values;
    assert!(harmonics.iter().any(|c| *c != 0.0), "gains over direction are learned");
}

/// The law of distance is in closed form from the first step.
#[test]
fn power_model_starts_with_fitted_path_loss() {
    let (_, pipeline, data, partition) = cases().remove(0);
    let model = pipeline.trainer(&data, &partition).unwrap().model();
    let exponents = &model.weights[model.weights.len() - 2..];
    assert!(exponents.iter().all(|n| (n - 2.2).abs() < 0.5), "{exponents:?}");
}

#[test]
fn reports_position_of_parts_for_other_task() {
    let message = |text: &str| Pipeline::parse(text, Path::new("a.ron")).unwrap_err().to_string();
    let mixed = "Pipeline(\n    name: \"a\",\n    data: Nerf2Rssi(),\n    initializer: AroundReceivers(),\n    readout: Magnitude,\n)";
    assert!(message(mixed).starts_with("a.ron:5:14: readout: it predicts spectra, but the data are received powers"));
    let metric = mixed.replace("readout: Magnitude", "metrics: [PowerError(), Ssim()]");
    assert!(
        message(&metric).starts_with("a.ron:5:14: metrics: `Ssim` does not support received powers; use another"),
        "{}",
        message(&metric)
    );
    let floor = mixed.replace("readout: Magnitude", "baselines: [MeanSpectrum(), Zero()]");
    assert!(
        message(&floor).starts_with("a.ron:5:16: baselines: `Zero` does not support received powers; use another"),
        "{}",
        message(&floor)
    );
    let search = mixed.replace("AroundReceivers()", "MatchingPursuit()").replace("    readout: Magnitude,\n", "");
    assert!(
        message(&search).starts_with("a.ron:4:18: initializer: `MatchingPursuit` does not support received powers"),
        "{}",
        message(&search)
    );
    let channels = "Channels(root: \"x\", carrier_hz: 3e8, spacing_hz: 1e7, receiver: ())";
    let waves = message(&search.replace("Nerf2Rssi()", channels));
    assert!(
        waves.starts_with("a.ron:4:18: initializer: `MatchingPursuit` needs the method VirtualTransmitters"),
        "{waves}"
    );
    let method = mixed.replace("readout: Magnitude", "method: VirtualTransmitters()");
    assert!(message(&method).starts_with("a.ron:5:13: method: it predicts channels"), "{}", message(&method));
    let pictures = mixed.replace("Nerf2Rssi()", "Teacher()").replace("Magnitude", "ReceivedPower()");
    assert!(
        message(&pictures).contains("it predicts received powers, but the data are spectra"),
        "{}",
        message(&pictures)
    );
    let fits = mixed.replace("    readout: Magnitude,\n", "");
    let metrics = Pipeline::parse(&fits, Path::new("a.ron")).unwrap().metrics;
    assert!(pwrfgs::core::plugin::to_ron(&metrics[0]).starts_with("PowerError"));
}
