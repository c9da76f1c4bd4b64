//! NeRF2: derivatives, single pixels and batches, prepared predictions, training.

use crate::common::{pipeline, plugin};
use pwrfgs::core::testing::check_vjp;
use pwrfgs::core::{
    Call, GaussianCloud, ImagePlane, Link, LinkInputs, MeasurementSetup, MethodVjp, Origin, Parameters, PixelSubset,
    Receiver, Task, WantedInputs, rng,
};
use pwrfgs::prelude::*;
use std::path::Path;

/// Rays enough for several chunks.
const SETTINGS: &str = "depth: 7, width: 8, samples: 20, azimuths: 7, elevations: 3";

/// A small network, and where it listens: two receivers.
struct Room {
    method: Plugin<dyn Method>,
    setup: MeasurementSetup,
    weights: Vec<Real>,
    conditions: Vec<Real>,
}

const fn link(location: usize, receiver: usize) -> Link {
    Link { location, receiver }
}

/// Not all, and not in the receivers' order.
const LINKS: [Link; 5] = [link(0, 0), link(0, 1), link(1, 1), link(2, 0), link(2, 1)];

impl Room {
    fn new(kind: Task, more: &str) -> Self {
        let method: Plugin<dyn Method> = plugin(&format!("Nerf2({SETTINGS}, {more})"));
        let at = |name: &str, position| {
            let orientation = [0.1, 0.2, 0.3, 0.927_361_849_549_570_4];
            Receiver::new(name, Pose { position, orientation })
        };
        let receivers = vec![at("left", [-1.0, 0.3, -2.0]), at("right", [2.0, -1.5, -1.0])];
        let projector: Plugin<dyn pwrfgs::core::Projector> = plugin("Mercator()");
        let frequencies_hz = if kind == Task::Channel { vec![9e7, 1e8, 1.1e8] } else { vec![] };
        let plain = |width, height| ImagePlane::plain(width, height);
        let plane = match kind {
            Task::Spectrum => projector.plane(8, 3),
            Task::Power => plain(1, 1),
            Task::Channel => plain(3, 2),
        };
        let setup = MeasurementSetup {
            receivers,
            task: kind,
            frequencies_hz,
            ..MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, plane)
        };
        let weights = method.layout(&setup).init(&mut rng::stream(3, "network", 0));
        let random = &mut rng::stream(4, "transmitters", 0);
        let conditions = (0..3 * method.traits().inputs).map(|_| rng::normal(random)).collect();
        Self { method, setup, weights, conditions }
    }

    fn links(&self, links: &[Link]) -> LinkInputs {
        let (width, values) = (self.method.traits().inputs, self.conditions.clone());
        LinkInputs { values, pairs: links.to_vec(), ..LinkInputs::of(width, &self.setup) }
    }

    fn numbers(&self, weights: &[Real], links: &[Link], pixels: &PixelSubset) -> Vec<Real> {
        let (cloud, links) = (GaussianCloud::zeros(0), &self.links(links));
        let parameters = Parameters { cloud: &cloud, gate: None, existence: None, weights };
        self.method.forward(&Call { setup: &self.setup, parameters, links, pixels }, &None).numbers
    }

    fn differentiates(&self, name: &str, pixels: &PixelSubset) {
        let (cloud, setup) = (GaussianCloud::zeros(0), &self.setup);
        let parameters = Parameters { cloud: &cloud, gate: None, existence: None, weights: &self.weights };
        let of_positions = |x: &[Real], d: Option<&[Real]>| {
            let links = &LinkInputs { values: x.to_vec(), ..self.links(&LINKS) };
            let call = Call { setup, parameters, links, pixels };
            let observed = self.method.forward(&call, &None);
            let Some(d) = d else { return observed.numbers };
            let mut sums = MethodVjp::zeros(&call, WantedInputs { positions: true, orientations: false });
            self.method.vjp(&call, observed, d, &mut sums);
            sums.positions.unwrap().into_flattened()
        };
        if self.method.traits().differentiates_positions {
            let vjp = |x: &[Real], d: &[Real]| of_positions(x, Some(d));
            // Frequencies up to 2⁹ rad per unit of length.
            check_vjp(name, &self.conditions, |x| of_positions(x, None), vjp, 1e-7, 2e-5);
        }
        // Some of every layer.
        let stride = 7;
        let all = |x: &[Real]| {
            let mut weights = self.weights.clone();
            weights.iter_mut().step_by(stride).zip(x).for_each(|(w, x)| *w = *x);
            weights
        };
        let x: Vec<Real> = self.weights.iter().copied().step_by(stride).collect();
        let vjp = |x: &[Real], d: &[Real]| {
            let weights = all(x);
            let (parameters, links) = (Parameters { weights: &weights, ..parameters }, &self.links(&LINKS));
            let call = Call { setup, parameters, links, pixels };
            let mut sums = MethodVjp::zeros(&call, WantedInputs::default());
            let observed = self.method.forward(&call, &None);
            self.method.vjp(&call, observed, d, &mut sums);
            sums.weights.into_iter().step_by(stride).collect()
        };
        check_vjp(name, &x, |x| self.numbers(&all(x), &LINKS, pixels), vjp, 1e-6, 2e-5);
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn spectra_powers_and_channels_differentiate_in_every_layer() {
    let spectrum = Room::new(Task::Spectrum, "far_m: 3");
    spectrum.differentiates("all pixels", &PixelSubset::All);
    spectrum.differentiates("the same pixels", &PixelSubset::Same([5, 0, 5, 23].into()));
    spectrum.differentiates("a pixel each", &PixelSubset::Each([5, 0, 5, 23, 7].into()));
    Room::new(Task::Power, "unit_m: 2").differentiates("powers", &PixelSubset::All);
    Room::new(Task::Channel, "features: 5").differentiates("channels", &PixelSubset::All);
}

#[test]
fn subsets_and_batches_are_bit_identical_to_whole_image() {
    let room = Room::new(Task::Spectrum, "far_m: 3");
    let (all, pixels) = (room.numbers(&room.weights, &LINKS, &PixelSubset::All), room.setup.value_count());
    let every: Vec<usize> = (0..pixels).collect();
    assert_eq!(room.numbers(&room.weights, &LINKS, &PixelSubset::Same(every.into())), all);
    let some = [11, 3, 3, 20, 0];
    let own: Vec<Real> = some.iter().enumerate().map(|(l, p)| all[l * pixels + p]).collect();
    assert_eq!(room.numbers(&room.weights, &LINKS, &PixelSubset::Each(some.into())), own);
    for kind in Task::ALL {
        let room = Room::new(kind, "far_m: 3");
        let all = room.numbers(&room.weights, &LINKS, &PixelSubset::All);
        for (l, link) in LINKS.iter().enumerate() {
            let of_link = room.setup.value_count();
            assert_eq!(
                room.numbers(&room.weights, &[*link], &PixelSubset::All),
                all[l * of_link..][..of_link],
                "{kind:?}"
            );
        }
    }
}

#[test]
fn prepared_prediction_is_bit_identical() {
    for kind in Task::ALL {
        let (room, cloud) = (Room::new(kind, "far_m: 5"), GaussianCloud::zeros(0));
        let parameters = Parameters { cloud: &cloud, gate: None, existence: None, weights: &room.weights };
        let prepared = room.method.prepare(&room.setup, &parameters);
        assert!(prepared.is_some());
        for cache in [prepared, None] {
            let (setup, links) = (&room.setup, &room.links(&LINKS));
            let found = room.method.predict(&Call { setup, parameters, links, pixels: &PixelSubset::All }, &cache).0;
            assert_eq!(found, room.numbers(&room.weights, &LINKS, &PixelSubset::All), "{kind:?}, {}", cache.is_some());
        }
    }
}

/// Weights with the attenuation's layer multiplied, so that some rays end early.
fn darker(room: &Room, factor: Real) -> Vec<Real> {
    let mut weights = room.weights.clone();
    let mut from = 0;
    for spec in room.method.layout(&room.setup).weights {
        let own = &mut weights[from..from + spec.len()];
        from += spec.len();
        if spec.name.starts_with("attenuation.") {
            own.iter_mut().for_each(|w| *w *= factor);
        }
    }
    weights
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn truncated_rays_differentiate() {
    // Powers are some hundreds, of which differences keep too few digits.
    for kind in [Task::Spectrum, Task::Channel] {
        let mut room = Room::new(kind, "far_m: 3");
        let seen = room.numbers(&room.weights, &LINKS, &PixelSubset::All);
        room.weights = darker(&room, 100.0);
        assert_ne!(room.numbers(&room.weights, &LINKS, &PixelSubset::All), seen);
        room.differentiates("rays that end early", &PixelSubset::All);
    }
}

fn small(training: &str) -> Pipeline {
    pipeline(&format!(
        "seed: 5, data: Teacher(gaussians: 6, samples: 20, width: 36, height: 9),
         method: Nerf2(depth: 3, width: 16, samples: 8),
         training: (batch: 3, densify_until: 0, prune_until: 0, {training})"
    ))
}

#[test]
fn ray_training_is_bit_identical_if_threaded_or_resumed() {
    let squared = "loss: (ssim_weight: 0, pixel: Squared)";
    let all = [
        "steps: 12, loss: (ssim_weight: 0.5)".to_owned(),
        format!("steps: 12, rays: Same(30), {squared}"),
        format!("steps: 12, rays: Each(40), stride: 3, {squared}"),
    ];
    for training in all {
        let pipeline = small(&training);
        let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
        let partition = pipeline.partition(&data).unwrap();
        let train = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut trainer = pipeline.trainer(&data, &partition).unwrap();
                let mut all = vec![trainer.checkpoint()];
                while !trainer.finished() {
                    let report = trainer.step().unwrap();
                    assert!(report.gaussians == 0 && report.loss > 0.0);
                    all.push(trainer.checkpoint());
                }
                all
            })
        };
        let (one, two) = (train(1), train(2));
        assert!(one == two, "{training}: threads show");
        let mut trainer = Trainer::restore(&pipeline.plan().unwrap(), &data, &partition, &one[7]).unwrap();
        while !trainer.finished() {
            trainer.step().unwrap();
        }
        assert!(trainer.checkpoint() == one[12], "{training}: the stop shows");
    }
}

/// The projector does not count, not even where every third pixel is looked at.
#[test]
fn ray_stride_ignores_projector() {
    let first = |projector: &str| {
        let rays = "rays: Same(9), stride: 3, loss: (ssim_weight: 0)";
        let mut pipeline = small(rays);
        pipeline.set(&format!("projector={projector}")).unwrap();
        let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
        let partition = pipeline.partition(&data).unwrap();
        pipeline.trainer(&data, &partition).unwrap().step().unwrap().loss
    };
    assert_eq!(first("Mercator()"), first("WrfgsCompat()"));
}

#[test]
fn ray_training_reduces_loss() {
    let pipeline = small(
        "steps: 150, rays: Same(60), loss: (ssim_weight: 0, pixel: Squared), optimizer: (network: Constant(0.003))",
    );
    let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
    let partition = pipeline.partition(&data).unwrap();
    let mut trainer = pipeline.trainer(&data, &partition).unwrap();
    let mut losses = Vec::new();
    while !trainer.finished() {
        losses.push(trainer.step().unwrap().loss);
    }
    let mean = |part: &[f64]| part.iter().sum::<f64>() / part.len() as f64;
    let (first, last) = (mean(&losses[..10]), mean(&losses[140..]));
    assert!(last < 0.5 * first, "from {first} to {last}");
}

#[test]
fn reports_position_of_unsupported_ray_settings() {
    let refused = |fields: &str, expected: &str| {
        let text = format!("Pipeline(name: \"a\", data: Teacher(),\n{fields})");
        let message = Pipeline::parse(&text, Path::new("a.ron")).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
        assert!(message.starts_with("a.ron:2:"), "{message}");
    };
    let plain = "loss: (ssim_weight: 0)";
    refused("method: Nerf2(width: 7)", "even");
    refused("method: Nerf2(samples: 1)", "`samples` is 1");
    refused("method: Nerf2(features: 2)", "`features` is 2");
    refused("method: Nerf2(far_m: 0)", "`far_m` is 0");
    refused("method: Nerf2(), pruners: [OpacityThreshold()]", "has no Gaussians to prune");
    refused("initializer: Random(), training: (rays: Same(9), loss: (ssim_weight: 0))", "Nerf2");
    refused("method: Nerf2(), training: (rays: Same(9))", "SSIM needs whole spectra");
    refused(&format!("method: Nerf2(), training: (rays: Each(0), {plain})"), "at least 1");
}
