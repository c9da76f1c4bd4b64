//! Whole training steps on the GPU against the same steps on the CPU.

use super::Splatting;
use super::gpu_tests::{COUNTS, cloud_of, compare, loss_on_cpu, random, setup, vectors};
use crate::Readout;
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::ssim::Window;
use pwrfgs_core::{
    AdamUpdate, Call, CloudStats, Deformation, DeviceStep, DeviceStepper, GaussianCloud, Method, MethodVjp, Parameters,
    PixelSubset, Real, SpectrumLoss, TrainingState, WantedInputs, rng,
};
use pwrfgs_gpu::{Gpu, for_tests};

const NETWORK: &str = "Mlp(depth: 3, width: 16, skip: Some(0), tx_hidden: 8, tx_features: 4)";
const PLAIN: &str = "Mlp(depth: 2, width: 16, skip: None)";

/// All that steps change.
#[derive(Clone)]
struct State {
    cloud: GaussianCloud,
    weights: Vec<Real>,
    cloud_moments: [GaussianCloud; 2],
    weight_moments: [Vec<Real>; 2],
    stats: CloudStats,
}

impl State {
    fn new(method: &Splatting, n: usize) -> Self {
        let mut cloud = cloud_of(n).0;
        // Every fifth is too faint to be drawn.
        cloud.opacity_logits.iter_mut().step_by(5).skip(1).for_each(|logit| *logit -= 12.0);
        let weights = method.layout(&setup()).init(&mut rng::stream(2, "weights", 0));
        let (zeros, stats) = (cloud.zeros_like(), CloudStats::zeros(n));
        let weight_moments = [(); 2].map(|()| vec![0.0; weights.len()]);
        Self { cloud, weights, cloud_moments: [zeros.clone(), zeros], weight_moments, stats }
    }

    fn borrow(&mut self) -> TrainingState<'_> {
        let Self { cloud, weights, cloud_moments, weight_moments, stats } = self;
        TrainingState { cloud, weights, cloud_moments, weight_moments, stats }
    }

    /// Columns by name.
    fn columns(&self) -> Vec<(String, Vec<Real>)> {
        let [first, second] = &self.cloud_moments;
        let of = |kind: &str, cloud: &GaussianCloud| {
            cloud.columns().map(|(name, _, x)| (format!("{kind} {name}"), x.to_vec())).collect::<Vec<_>>()
        };
        let mut all = [of("value", &self.cloud), of("first", first), of("second", second)].concat();
        all.extend(self.stats.columns().map(|(name, x)| (name.to_owned(), x.to_vec())));
        let [first, second] = &self.weight_moments;
        all.extend(
            [("weights", &self.weights), ("first", first), ("second", second)]
                .map(|(name, x)| (name.into(), x.clone())),
        );
        all
    }
}

/// Steps with some transmitters, a random measurement each, and every second pixel of every second row in the second.
fn steps_of(method: &Splatting, transmitters: usize, count: usize) -> Vec<DeviceStep> {
    let one = |k: usize| {
        let mut setup = setup();
        if k == 1 {
            setup.plane = setup.plane.strided(2, [1, 0]);
        }
        let positions: Vec<[Real; 3]> = vectors("transmitters", transmitters + k);
        let links = setup.inputs(3, positions[k..].iter().map(|p| setup.query(p.map(f64::from), 0)));
        let truths = random("truths", links.pairs.len() * setup.value_count()).iter().map(|t| t.abs()).collect();
        let power = |beta: Real| 1.0 - beta.powi(k as i32 + 1);
        // The large addend leaves the step a smooth function of the derivative.
        let update = AdamUpdate { rate: 0.05, eps: 0.1, unbias: [power(0.9), power(0.999)], l2: 0.0, decay: 0.0 };
        let decayed = AdamUpdate { l2: 0.02, decay: 0.1, ..update };
        let columns = vec![Some(update), Some(update), None, Some(decayed), Some(update)];
        let half = method.layout(&setup).weight_count() / 2;
        let weights = vec![(0..half, decayed), (half + 1..2 * half, update)];
        let ssim = (0.2, Window::default());
        DeviceStep { setup, links, truths, ssim, is_squared: k == 2, columns, weights }
    };
    (0..count).map(one).collect()
}

/// Runs a step on the CPU; returns the loss.
fn step_on_cpu(method: &Splatting, state: &mut State, step: &DeviceStep) -> Real {
    let DeviceStep { setup, links, truths, ssim, is_squared, .. } = step;
    let rows = method.drawable(setup, &state.cloud, None);
    let drawn = state.cloud.select(&rows);
    let parameters = Parameters { cloud: &drawn, gate: None, existence: None, weights: &state.weights };
    let call = Call { setup, parameters, links, pixels: &PixelSubset::All };
    let observed = method.forward(&call, &None);
    let loss = SpectrumLoss { truths, ssim_weight: ssim.0, window: ssim.1, is_squared: *is_squared };
    let (loss, d) = loss_on_cpu(&observed.numbers, &loss, (setup.plane.width, setup.plane.height));
    let mut sums = MethodVjp::zeros(&call, WantedInputs::default());
    method.vjp(&call, observed, &d, &mut sums);
    let (mut d_cloud, mut stats) = (state.cloud.zeros_like(), CloudStats::zeros(state.cloud.len()));
    let scatter = |width: usize, all: &mut [Real], drawn: &[Real]| {
        for (row, values) in rows.iter().zip(drawn.chunks_exact(width)) {
            all[row * width..][..width].copy_from_slice(values);
        }
    };
    let columns = d_cloud.columns_mut().zip(sums.cloud.columns());
    columns.for_each(|((_, width, all), (.., drawn))| scatter(width, all, drawn));
    let columns = stats.columns_mut().into_iter().zip(sums.stats.columns());
    columns.for_each(|((_, all), (_, drawn))| scatter(1, all, drawn));
    state.stats.merge(&stats);
    let [first, second] = &mut state.cloud_moments;
    let moments = first.columns_mut().zip(second.columns_mut());
    for (((update, (.., x)), (.., d)), ((.., m), (.., v))) in
        step.columns.iter().zip(state.cloud.columns_mut()).zip(d_cloud.columns()).zip(moments)
    {
        update.iter().for_each(|update| assert!(update.apply(x, d, m, v)));
    }
    let [first, second] = &mut state.weight_moments;
    for (range, update) in &step.weights {
        let [range, a, b, c] = [(); 4].map(|()| range.clone());
        assert!(update.apply(&mut state.weights[range], &sums.weights[a], &mut first[b], &mut second[c]));
    }
    loss
}

fn method(network: &str, readout: Readout) -> Splatting {
    Splatting { deformation: Plugin::<dyn Deformation>::parse(network).unwrap(), readout, ..Splatting::default() }
}

fn run(method: &Splatting, gpu: &Gpu, state: &mut State, steps: &[DeviceStep]) -> Vec<Real> {
    method.resident_on(gpu, &setup()).unwrap().run(state.borrow(), steps).unwrap()
}

#[test]
fn steps_match_the_cpu() {
    let Some(gpu) = for_tests() else { return };
    for (n, transmitters) in COUNTS.into_iter().filter(|n| *n > 0).flat_map(|n| [(n, 1), (n, 3)]) {
        let (network, readout) =
            if transmitters == 1 { (PLAIN, Readout::Magnitude) } else { (NETWORK, Readout::MinMax) };
        let method = method(network, readout);
        let steps = steps_of(&method, transmitters, 3);
        let mut expected = State::new(&method, n);
        let mut found = expected.clone();
        let losses = run(&method, gpu, &mut found, &steps);
        for (k, (step, loss)) in steps.iter().zip(losses).enumerate() {
            let name = format!("{n} x {transmitters}, loss {k}");
            compare(&name, &[loss], &[step_on_cpu(&method, &mut expected, step)], 1e-5);
        }
        // As in `whole_drawings_match`: a pixel of many may change sides of the limit 1/255, and units that of their ReLU.
        let limit = if n > 65 { 1e-3 } else { 1e-4 };
        for ((name, found), (_, expected)) in found.columns().iter().zip(expected.columns()) {
            // A derivative that is zero but for rounding has no relative error: that of one Gaussian between smallest and largest.
            let floor = [&expected[..], &[1e-5]].concat();
            compare(&format!("{n} x {transmitters}, {name}"), &[&found[..], &[1e-5]].concat(), &floor, limit);
        }
    }
}

/// The same bits in one call as in several; chunks of Gaussians change rounding only.
#[test]
fn steps_do_not_depend_on_calls() {
    let Some(gpu) = for_tests() else { return };
    let method = method(NETWORK, Readout::Magnitude);
    let steps = steps_of(&method, 2, 3);
    let (mut whole, mut parts) = (State::new(&method, 157), State::new(&method, 157));
    let mut losses = run(&method, gpu, &mut whole, &steps);
    for part in [&steps[..1], &steps[1..]] {
        losses.drain(..part.len()).zip(run(&method, gpu, &mut parts, part)).for_each(|(a, b)| assert_eq!(a, b));
    }
    whole.columns().iter().zip(parts.columns()).for_each(|(a, b)| assert_eq!(*a, b));

    let mut chunked = State::new(&method, 157);
    let on_gpu = super::resident::ResidentSplatting { most: 64, ..method.resident_on(gpu, &setup()).unwrap() };
    on_gpu.run(chunked.borrow(), &steps).unwrap();
    for ((name, found), (_, expected)) in chunked.columns().iter().zip(whole.columns()) {
        compare(name, found, &expected, 1e-4);
    }
}
