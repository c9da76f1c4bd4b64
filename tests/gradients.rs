//! Central differences through the whole step, from every column of the cloud and from the network to the loss.
//!
//! Gates are open. The straight-through gate is constant for small changes; its closed form is tested in its crate.

use crate::common::{MOMENT, batch, cloud, plugin, stages, with_column};
use pwrfgs::core::testing::check_vjp;
use pwrfgs::core::{
    Cache, Call, ColumnSpec, DeformationInputs, DeformationTraits, DeformationVjp, GaussianCloud, ImagePlane, Link,
    LinkInputs, MeasurementSetup, MethodVjp, Parameters, PixelSubset, Receiver, Task, WantedInputs, rng, sigmoid,
};
use pwrfgs::methods::{Readout, Splatting};
use pwrfgs::model::Stages;
use pwrfgs::prelude::*;
use pwrfgs::train::{
    Batch, ChannelLoss, LinkLoss, LossAndGradients, Objective, PixelLoss, RenderingLoss, loss_and_gradients,
};
use std::sync::Arc;

const DOUBLE: bool = size_of::<Real>() == 8;
const N: usize = 6;
/// Weights of a network that are looked at, spread over all of them.
const WEIGHTS: usize = 60;

/// A gate that is a column itself: what a learned gate multiplies, open to differences.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
struct Factor {}

#[typetag::serde]
impl Pruner for Factor {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { columns: vec![ColumnSpec::learned("factor", 1.0, 0.01)], ..PrunerTraits::default() }
    }
    fn gate(&self, cloud: &TracedCloud, _: &StepContext) -> Option<Gate> {
        Some(cloud.column("factor").into())
    }
}

/// A deformation whose weights are its terms: each Gaussian's nine, for each of two transmitters.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
struct Terms {}

#[typetag::serde]
impl Deformation for Terms {
    fn traits(&self) -> DeformationTraits {
        DeformationTraits { varies_geometry: true, ..DeformationTraits::default() }
    }
    fn forward(&self, inputs: &DeformationInputs<'_>, _: &Cache) -> Deltas {
        let terms = N * inputs.txs.len();
        let (scales, rest) = inputs.weights.split_at(3 * terms);
        let (quats, signals) = rest.split_at(4 * terms);
        Deltas {
            scales: scales.as_chunks().0.to_vec(),
            quats: quats.as_chunks().0.to_vec(),
            signals: signals.as_chunks().0.to_vec(),
        }
    }
    fn vjp(&self, _: &DeformationInputs<'_>, d: &Deltas, sums: DeformationVjp<'_>) {
        let all = [d.scales.as_flattened(), d.quats.as_flattened(), d.signals.as_flattened()].concat();
        sums.weights.iter_mut().zip(all).for_each(|(sum, d)| *sum += d);
    }
}

/// A step to be differentiated.
struct Step {
    stages: Arc<Stages>,
    cloud: GaussianCloud,
    weights: Vec<Real>,
    batch: Batch,
    objective: Box<dyn Objective>,
    pruners: Vec<Plugin<dyn Pruner>>,
}

impl Step {
    fn new(deformation: &str, readout: Readout, transmitters: usize, ssim_weight: Real, seed: u64) -> Self {
        let stages = stages(deformation, readout);
        let weights = stages.layout().init(&mut rng::stream(seed, "network", 0));
        let cloud = with_column(cloud(N, seed), "factor", (0..N).map(|i| 0.7 + 0.1 * i as Real).collect());
        let batch = batch(transmitters, &stages);
        let objective = Box::new(RenderingLoss::new(ssim_weight));
        Self { stages, cloud, weights, batch, objective, pruners: vec![plugin("Factor()")] }
    }

    fn outcome(&self, cloud: &GaussianCloud, weights: &[Real]) -> LossAndGradients {
        loss_and_gradients(
            &self.stages,
            cloud,
            &Arc::new(weights.to_vec()),
            &self.batch,
            &*self.objective,
            &self.pruners,
            &MOMENT,
        )
        .unwrap()
    }

    /// Observations, and the derivative of Σ d·observations by the positions and, if `alone`, without it.
    fn by_positions(&self, conditions: &[Real], d: Option<&[Real]>, alone: bool) -> (Vec<Real>, MethodVjp) {
        let Stages { method, setup } = &*self.stages;
        let (cloud, weights) = (&self.cloud, &self.weights);
        let parameters = Parameters { cloud, gate: None, existence: None, weights };
        let mut links = LinkInputs { values: conditions.to_vec(), ..self.batch.inputs.clone() };
        if setup.moving.is_receiver() {
            let poses = links.receivers.iter_mut().map(|state| &mut state.pose);
            poses.zip(conditions.as_chunks().0).for_each(|(pose, at)| pose.position = at.map(f64::from));
        }
        let call = Call { setup, parameters, links: &links, pixels: &PixelSubset::All };
        let observed = method.forward(&call, &None);
        let numbers = observed.numbers.clone();
        let mut sums = MethodVjp::zeros(&call, WantedInputs { positions: !alone, orientations: false });
        if let Some(d) = d {
            method.vjp(&call, observed, d, &mut sums);
        }
        (numbers, sums)
    }

    /// Every position of the transmitters, or of a moving receiver, against differences.
    fn check_positions(&self, name: &str) {
        if !self.stages.method.traits().differentiates_positions {
            return;
        }
        let vjp = |x: &[Real], d: &[Real]| {
            let (sums, alone) = (self.by_positions(x, Some(d), false).1, self.by_positions(x, Some(d), true).1);
            assert!(alone.positions.is_none() && alone.weights == sums.weights, "{name}");
            sums.positions.unwrap().into_flattened()
        };
        let name = format!("{name}, by the positions");
        check_vjp(&name, &self.batch.inputs.values, |x| self.by_positions(x, None, true).0, vjp, 1e-7, 1e-3);
    }

    /// Every column but `left_out`, then some of the weights, against differences; then the positions.
    fn check(&self, name: &str, left_out: Option<&str>) {
        self.check_positions(name);
        let stride = self.weights.len().div_ceil(WEIGHTS).max(1);
        let pack = |cloud: &GaussianCloud, weights: &[Real]| -> Vec<Real> {
            let columns = cloud.columns().filter(|(name, ..)| Some(*name) != left_out);
            columns.flat_map(|(_, _, v)| v.to_vec()).chain(weights.iter().copied().step_by(stride)).collect()
        };
        let unpack = |x: &[Real]| {
            let (mut cloud, mut weights, mut x) = (self.cloud.clone(), self.weights.clone(), x.iter().copied());
            for (_, _, values) in cloud.columns_mut().filter(|(name, ..)| Some(*name) != left_out) {
                values.iter_mut().for_each(|v| *v = x.next().unwrap());
            }
            weights.iter_mut().step_by(stride).for_each(|w| *w = x.next().unwrap());
            (cloud, weights)
        };
        check_vjp(
            name,
            &pack(&self.cloud, &self.weights),
            |x| {
                let (cloud, weights) = unpack(x);
                vec![self.outcome(&cloud, &weights).loss]
            },
            |x, d| {
                let (cloud, weights) = unpack(x);
                let outcome = self.outcome(&cloud, &weights);
                pack(&outcome.d_cloud, &outcome.d_weights).into_iter().map(|g| d[0] * g).collect()
            },
            1e-7,
            1e-3,
        );
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn every_column_differentiates_in_every_readout() {
    for readout in [Readout::Magnitude, Readout::Power, Readout::Real] {
        for (seed, ssim_weight) in [(1, 0.0), (2, 0.2), (3, 1.0)] {
            let name = format!("Fixed, {readout:?}, SSIM {ssim_weight}");
            Step::new("Fixed()", readout, 2, ssim_weight, seed).check(&name, None);
        }
    }
}

/// The network detaches the centres, as released: their own derivative is checked with the other deformations.
#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn network_that_moves_geometry_differentiates() {
    let mlp = "Mlp(depth: 3, width: 16, skip: 0, tx_hidden: 16, tx_features: 8, position_frequencies: 3, \
               tx_frequencies: 2, head_init: 0.3)";
    for (readout, ssim_weight) in [(Readout::Magnitude, 0.2), (Readout::Power, 1.0), (Readout::Real, 0.2)] {
        Step::new(mlp, readout, 2, ssim_weight, 4).check(&format!("Mlp All, {readout:?}"), Some("means"));
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn network_that_changes_batch_signals_differentiates() {
    let mlp = "Mlp(depth: 2, width: 16, skip: None, tx_hidden: 16, tx_features: 8, position_frequencies: 3, \
               tx_frequencies: 2, outputs: Signals)";
    for (readout, ssim_weight) in [(Readout::Magnitude, 0.2), (Readout::Power, 0.2), (Readout::Real, 1.0)] {
        Step::new(mlp, readout, 2, ssim_weight, 5).check(&format!("Mlp Signals, {readout:?}"), Some("means"));
    }
}

/// Two receivers that look at one cloud from different places, each with two antennas.
fn receivers() -> Vec<Receiver> {
    let at = |name: &str, position| {
        let pose = Pose { position, orientation: [0.1, 0.2, 0.3, 0.927_361_849_549_570_4] };
        Receiver { antennas: vec![[0.0; 3], [0.1, -0.2, 0.05]], ..Receiver::new(name, pose) }
    };
    vec![at("left", [-1.0, 0.3, -2.0]), at("right", [2.0, -1.5, -1.0])]
}

/// Links of three transmitters with them, not all and not in the receivers' order: terms are copied to be drawn together.
const LINKS: [Link; 5] = [link(0, 0), link(0, 1), link(1, 1), link(2, 0), link(2, 1)];

const fn link(location: usize, receiver: usize) -> Link {
    Link { location, receiver }
}

/// A step over these links: `size` is columns and rows of an observation.
fn links(method: &str, size: (usize, usize), objective: Box<dyn Objective>) -> Step {
    let mut step = Step::new("Fixed()", Readout::Magnitude, 1, 0.0, 11);
    let method: Plugin<dyn Method> = plugin(method);
    let kind = method.traits().task.unwrap();
    let base = Stages { method, setup: step.stages.setup.clone() };
    let plane = if kind == Task::Spectrum { base.setup.plane.clone() } else { ImagePlane::plain(size.0, size.1) };
    let frequencies_hz = if kind == Task::Channel { vec![9e7, 1e8, 1.1e8] } else { vec![] };
    let setup = MeasurementSetup { receivers: receivers(), task: kind, plane, frequencies_hz, ..base.setup.clone() };
    let stages = Stages { setup, ..base };
    step.weights = stages.layout().init(&mut rng::stream(12, "network", 0));
    let (width, random) = (stages.method.traits().inputs, &mut rng::stream(13, "links", 0));
    let conditions = (0..3 * width).map(|_| rng::normal(random)).collect();
    let numbers = LINKS.len() * stages.setup.value_count();
    let truths = (0..numbers).map(|_| rng::normal(random)).collect();
    let inputs = LinkInputs { values: conditions, pairs: LINKS.to_vec(), ..LinkInputs::of(width, &stages.setup) };
    step.batch = Batch { inputs, truths, ..Batch::default() };
    step.stages = Arc::new(stages);
    step.objective = objective;
    step
}

fn splats(deformation: &str, readout: &str) -> String {
    format!("Splatting(deformation: {deformation}, readout: {readout})")
}

fn splatted_channel(deformation: &str) -> String {
    format!("SplattedChannel(deformation: {deformation})")
}

const NETWORK: &str = "Factored(depth: 2, width: 8, tx_encoding: Wavelengths(count: 2, longest_m: 9.0, shortest_m: 4.0), \
                       position_encoding: Octaves(1))";

/// A power is the sky over solid angle, with a law of distance for each receiver.
#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn powers_differentiate_in_every_column_and_path_loss() {
    for power in [PixelLoss::Absolute, PixelLoss::Squared] {
        let mut step = links(
            &splats(NETWORK, "ReceivedPower(sky_deg: 20, filter_deg2: 120.0)"),
            (1, 1),
            Box::new(LinkLoss { power }),
        );
        let offsets = step.weights.len() - 4;
        step.weights[offsets..].copy_from_slice(&[0.3, -0.2, 1.8, 2.2]);
        step.check(&format!("Received, {power:?}"), None);
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn spectra_at_two_receivers_differentiate() {
    let objective = || Box::new(RenderingLoss::new(0.2));
    links(&splats(NETWORK, "Magnitude"), (90, 24), objective()).check("spectra at two receivers", None);
    let moving = "Mlp(depth: 2, width: 8, skip: None, tx_hidden: 8, tx_features: 4, position_frequencies: 1, \
                  tx_frequencies: 1, head_init: 0.3)";
    links(&splats(moving, "Magnitude"), (90, 24), objective())
        .check("geometry of its own for each link", Some("means"));
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn spectra_at_moving_receiver_differentiate() {
    let mut step = links(&splats(NETWORK, "Magnitude"), (90, 24), Box::new(RenderingLoss::new(0.2)));
    let poses = receivers().into_iter().map(|receiver| receiver.pose).chain([Pose::IDENTITY]);
    let mut stages = (*step.stages).clone();
    stages.setup = MeasurementSetup { receivers: receivers()[..1].to_vec(), moving: End::Receiver, ..stages.setup };
    let mut inputs = LinkInputs::of(3, &stages.setup);
    for pose in poses {
        inputs.values.extend(pose.position.map(|v| v as Real));
        inputs.add_link(&stages.setup, 0, pose);
    }
    step.batch.inputs = inputs;
    step.batch.truths.truncate(3 * stages.setup.value_count());
    step.stages = Arc::new(stages);
    step.check("spectra at a moving receiver", None);
}

/// Gaussians as waves on the antennas, their signals decided by features of the data.
#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn channels_of_features_differentiate() {
    let of = |encoding| format!("Factored(depth: 2, width: 6, tx_encoding: {encoding}, position_encoding: Octaves(1))");
    let features = [of("Features(width: 5, gain: 0.7)"), of("PseudoPosition(width: 5, gain: 0.5, octaves: 2)")];
    for network in [NETWORK, &features[0], &features[1]] {
        let step = links(&splatted_channel(network), (3, 4), Box::new(ChannelLoss { mean_energy: 1.7 }));
        step.check(&format!("SplattedChannel, {network}"), None);
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn waves_of_two_carriers_differentiate() {
    for method in [splatted_channel(NETWORK), "VirtualTransmitters(order: 0)".into()] {
        let mut step = links(&splatted_channel(NETWORK), (3, 4), Box::new(ChannelLoss { mean_energy: 1.7 }));
        let mut stages = Stages::clone(&step.stages);
        stages.method = plugin(&method);
        let receivers = &mut stages.setup.receivers;
        receivers[1] = Receiver { name: "right".into(), ..receivers[0].clone() };
        receivers.iter_mut().zip([1e8, 1.7e8]).for_each(|(receiver, hz)| receiver.carrier_hz = Some(hz));
        if method.starts_with("Virtual") {
            step.weights = Vec::new();
        }
        step.stages = Arc::new(stages);
        step.check(&format!("two carriers, {method}"), None);
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn virtual_transmitters_differentiate() {
    for order in [0, 2] {
        let mut step = links(&splatted_channel(NETWORK), (3, 4), Box::new(ChannelLoss { mean_energy: 1.7 }));
        let mut stages = Stages::clone(&step.stages);
        stages.method = plugin(&format!("VirtualTransmitters(order: {order})"));
        stages.setup.receivers.truncate(1);
        step.weights = Vec::new();
        step.batch.inputs.pairs = (0..3).map(|location| Link { location, receiver: 0 }).collect();
        step.batch.truths.truncate(3 * stages.setup.value_count());
        step.cloud.add_missing_columns(&stages.method.traits().columns).unwrap();
        let random = &mut rng::stream(3, "harmonics", 0);
        let own = step.cloud.extra.iter_mut().filter(|column| column.name == "harmonics");
        own.for_each(|column| column.values.fill_with(|| 0.2 * rng::normal(random)));
        step.stages = Arc::new(stages);
        step.check(&format!("VirtualTransmitters, order {order}"), None);
    }
}

/// Waves on an array, down to scales and centres, through a network that sees the centres.
#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn array_waves_differentiate_in_every_column() {
    let factored = "Factored(depth: 2, width: 8, tx_encoding: Octaves(2), position_encoding: Octaves(1))";
    let spherical = "ArrayResponse(rows: 3, columns: 4, wavefront: Spherical(wavelength_m: 0.8))";
    for (rasterizer, readout) in [("ArrayResponse()", Readout::MinMax), (spherical, Readout::Magnitude)] {
        let mut step = Step::new(factored, readout, 2, 0.2, 10);
        step.stages = Arc::new(step.stages.with(|splatting: &mut Splatting| splatting.rasterizer = plugin(rasterizer)));
        step.check(rasterizer, None);
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn every_per_transmitter_term_differentiates() {
    let mut step = Step::new("Terms()", Readout::Magnitude, 2, 0.2, 6);
    let random = &mut rng::stream(6, "terms", 0);
    step.weights = (0..9 * N * 2).map(|_| 0.05 * rng::normal(random)).collect();
    step.check("Terms", None);
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn released_network_differentiates_to_centres() {
    for gain in ["1.5", "None"] {
        let wrfgs = format!("Wrfgs(depth: 3, width: 16, frequencies: 2, skip: Some(0), gain: {gain})");
        Step::new(&wrfgs, Readout::Real, 2, 0.2, 8).check(&wrfgs, None);
    }
}

#[test]
fn traced_straight_through_gate_has_closed_form() {
    let lambda: Real = 0.03;
    let base = cloud(N, 9);
    let step = |column: &str, values: Vec<Real>, pruner: &str| {
        let step = Step {
            pruners: vec![plugin(pruner)],
            cloud: with_column(base.clone(), column, values),
            ..Step::new("Fixed()", Readout::Magnitude, 2, 0.2, 9)
        };
        step.outcome(&step.cloud, &[])
    };
    let logits: Vec<Real> = (0..N).map(|i| i as Real - 3.0).collect();
    let factor = step("factor", vec![1.0; N], "Factor()");
    let masked = step("mask_logits", logits.clone(), &format!("LearnableMask(lambda: {lambda})"));
    assert_eq!(masked.loss, factor.loss, "open gates change nothing");

    // ∂L/∂o·o + Σ ∂L/∂s·s, from the derivatives in the logit of o and in log s.
    let d = &masked.d_cloud;
    let gates: Vec<Real> = (0..N)
        .map(|i| d.opacity_logits[i] / (1.0 - sigmoid(base.opacity_logits[i])) + d.log_scales[i].iter().sum::<Real>())
        .collect();
    let size = gates.iter().fold(0.0, |m: Real, g| m.max(g.abs()));
    assert!(size > 0.0);
    let tolerance: Real = if DOUBLE { 1e-12 } else { 1e-5 };
    let near = |found: Real, expected: Real, what: &str| {
        assert!((found - expected).abs() < tolerance * (size + lambda), "{what}: {found}, not {expected}");
    };
    for i in 0..N {
        let slope = sigmoid(logits[i]) * (1.0 - sigmoid(logits[i]));
        near(factor.d_cloud.extra[0].values[i], gates[i], "gate");
        near(d.extra[0].values[i], slope * (gates[i] + lambda / N as Real), "mask");
    }
    near(masked.penalty, lambda * logits.iter().map(|m| sigmoid(*m)).sum::<Real>() / N as Real, "penalty");
}
