//! Networks on the GPU against those on the CPU, which have tests of their own: outputs, derivatives, slopes, bits.

use crate::linear::{LayoutBuilder, lay_out};
use crate::tests::{POSE, points};
use crate::{Mlp, Outputs, Wrfgs};
use pwrfgs_core::testing::check_bits_in_another_process;
use pwrfgs_core::{Conditions, DeformationInputs, DeformationVjp, Deltas, Real, rng};
use pwrfgs_gpu::{Gpu, for_tests};
use std::sync::Arc;

/// Outputs, and derivatives by weights, centres and transmitters for seeded cotangents.
type Pass = (Vec<Real>, Vec<Real>);

/// A network on both devices.
trait Twin {
    fn plan(&self, plan: &mut LayoutBuilder);
    fn on_cpu(&self, inputs: &DeformationInputs<'_>, sums: DeformationVjp<'_>) -> (Vec<Real>, f64);
    fn on_gpu(&self, gpu: &Gpu, inputs: &DeformationInputs<'_>, sums: DeformationVjp<'_>) -> (Vec<Real>, f64);
    /// Whether the centres have a derivative.
    fn along_means(&self) -> bool;
}

fn cotangents(len: usize) -> Vec<Real> {
    let mut random = rng::stream(5, "cotangent", 0);
    (0..len).map(|_| rng::normal(&mut random)).collect()
}

fn flat(deltas: &Deltas) -> Vec<Real> {
    [deltas.quats.as_flattened(), deltas.scales.as_flattened(), deltas.signals.as_flattened()].concat()
}

/// Replaces all terms by cotangents.
fn cotangent(like: &Deltas) -> Deltas {
    let mut d = like.zeros_like();
    d.columns_mut().into_iter().for_each(|column| column.copy_from_slice(&cotangents(column.len())));
    d
}

impl Twin for Mlp {
    fn plan(&self, plan: &mut LayoutBuilder) {
        self.plan_layers(plan);
    }

    fn on_cpu(&self, inputs: &DeformationInputs<'_>, sums: DeformationVjp<'_>) -> (Vec<Real>, f64) {
        let network = lay_out(|plan| self.plan_layers(plan)).0;
        let (terms, _) = network.forward(inputs, false);
        network.vjp(inputs, &cotangent(&terms), sums);
        (flat(&terms), 0.0)
    }

    fn on_gpu(&self, gpu: &Gpu, inputs: &DeformationInputs<'_>, sums: DeformationVjp<'_>) -> (Vec<Real>, f64) {
        let network = lay_out(|plan| self.plan_layers(plan)).0;
        let (predicted, _) = network.gpu_forward(gpu, inputs, false).unwrap();
        let (terms, kept) = network.gpu_forward(gpu, inputs, true).unwrap();
        assert!(terms == predicted);
        let d = cotangent(&terms);
        // Activations that are kept equal those computed again.
        let mut again = sums.weights.to_vec();
        let kept: pwrfgs_core::Cache = Some(Arc::new(kept));
        let with = DeformationInputs { kept: &kept, ..*inputs };
        network.gpu_vjp(gpu, &with, &d, DeformationVjp::of_weights(&mut again)).unwrap();
        let mut d_weights = sums.weights.to_vec();
        let positions = sums.positions;
        network.gpu_vjp(gpu, inputs, &d, DeformationVjp { weights: &mut d_weights, means: None, positions }).unwrap();
        assert!(again == d_weights);
        sums.weights.copy_from_slice(&d_weights);
        (flat(&terms), 0.0)
    }

    fn along_means(&self) -> bool {
        false
    }
}

impl Twin for Wrfgs {
    fn plan(&self, plan: &mut LayoutBuilder) {
        self.plan_layers(plan);
    }

    fn on_cpu(&self, inputs: &DeformationInputs<'_>, mut sums: DeformationVjp<'_>) -> (Vec<Real>, f64) {
        let network = lay_out(|plan| self.plan_layers(plan)).0;
        let products = network.forward(inputs.weights, inputs.means, inputs.txs.positions(), None);
        let along_gain = network.vjp(inputs, &cotangents(products.len()), &mut sums);
        (products, along_gain)
    }

    fn on_gpu(&self, gpu: &Gpu, inputs: &DeformationInputs<'_>, mut sums: DeformationVjp<'_>) -> (Vec<Real>, f64) {
        let network = lay_out(|plan| self.plan_layers(plan)).0;
        let products = network.gpu_forward(gpu, inputs, None).unwrap();
        let prepared = network.gpu_prepare(gpu, inputs.weights, inputs.means).unwrap();
        assert!(network.gpu_forward(gpu, inputs, prepared.as_ref()).unwrap() == products, "the same trunk, kept");
        // Without derivatives by positions, those by weights are the same.
        let (mut alone, d) = (sums.weights.to_vec(), cotangents(products.len()));
        network.gpu_vjp(gpu, inputs, &d, &mut DeformationVjp::of_weights(&mut alone)).unwrap();
        let along_gain = network.gpu_vjp(gpu, inputs, &d, &mut sums).unwrap();
        assert!(alone == sums.weights);
        (products, along_gain)
    }

    fn along_means(&self) -> bool {
        true
    }
}

/// Runs a pass for N centres and B transmitters, on the GPU if there is one; moves the inputs by `shift` along seeded
/// directions.
fn run(twin: &dyn Twin, gpu: Option<&Gpu>, (n, batch): (usize, usize), shift: Real) -> (Pass, f64) {
    let ((), plan) = lay_out(|plan| twin.plan(plan));
    let layout = plan.layout();
    let mut weights = layout.init(&mut rng::stream(2, "gpu", 0));
    let (mut means, mut txs) = (points(n, "means"), points(batch, "txs"));
    let directions = directions(weights.len(), n, batch, twin.along_means());
    let numbers = weights.iter_mut().chain(txs.as_flattened_mut());
    let numbers = numbers.chain(if twin.along_means() { means.as_flattened_mut() } else { &mut [] });
    numbers.zip(&directions).for_each(|(x, direction)| *x += shift * direction);
    let inputs = DeformationInputs::new(&weights, &means, Conditions::from(&txs), &POSE);
    // Derivatives are added; few numbers would lose digits.
    let start = if n > 157 { 1.0 } else { 0.0 };
    let mut d_weights = vec![start; weights.len()];
    let (mut d_txs, mut d_means) = (vec![[start; 3]; batch], vec![[start; 3]; n]);
    let (positions, along_means) = (Some(&mut d_txs[..]), twin.along_means().then_some(&mut d_means[..]));
    let sums = DeformationVjp { weights: &mut d_weights, means: along_means, positions };
    let (outputs, along_gain) = match gpu {
        Some(gpu) => twin.on_gpu(gpu, &inputs, sums),
        None => twin.on_cpu(&inputs, sums),
    };
    d_weights.extend(d_txs.as_flattened());
    d_weights.extend(if twin.along_means() { d_means.as_flattened() } else { &[] });
    d_weights.iter_mut().for_each(|d| *d -= start);
    ((outputs, d_weights), along_gain)
}

/// Returns seeded directions of all inputs, small enough that few units change sign.
fn directions(weights: usize, n: usize, batch: usize, along_means: bool) -> Vec<Real> {
    let mut random = rng::stream(8, "directions", 0);
    let positions = 3 * (batch + if along_means { n } else { 0 });
    (0..weights + positions).map(|_| rng::normal(&mut random)).collect()
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}

/// Compares outputs to 1e-6 and derivatives to 1e-5 as norms; to 1e-3 where so many units are added up that some change
/// their sign by rounding.
fn compare(name: &str, twin: &dyn Twin, gpu: &Gpu) {
    for n in [0, 1, 63, 64, 65, 157, 1000] {
        for batch in [1, 3] {
            let ((expected, expected_d), expected_gain) = run(twin, None, (n, batch), 0.0);
            let ((found, found_d), gain) = run(twin, Some(gpu), (n, batch), 0.0);
            assert_eq!(found.len(), expected.len());
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() <= 1e-6 * expected.abs().max(1.0), "{name}, {n}: {found}, {expected}");
            }
            let size = norm(expected_d.iter().map(|&d| d.into()));
            let off = norm(expected_d.iter().zip(&found_d).map(|(a, b)| f64::from(a - b)));
            let limit = if n > 157 { 1e-3 } else { 1e-5 };
            assert!(off <= limit * size, "{name}, {n}, {batch}: derivatives differ by {off:e} of {size:e}");
            assert!((gain - expected_gain).abs() <= 1e-4 * expected_gain.abs().max(1.0), "{gain}, {expected_gain}");
            if n == 157 {
                let again = run(twin, Some(gpu), (n, batch), 0.0).0;
                assert!(again == (found, found_d), "{name}, {batch}: equal bits");
            }
        }
    }
}

/// Compares the slope of Σ cotangent · output along a direction with differences.
fn compare_slopes(name: &str, twin: &dyn Twin, gpu: &Gpu) {
    let (n, batch, step) = (65, 2, 1e-4);
    let value = |shift: Real| -> f64 {
        let outputs = run(twin, Some(gpu), (n, batch), shift).0.0;
        let weights = if twin.along_means() { cotangents(outputs.len()) } else { flat_cotangents(n * batch, &outputs) };
        outputs.iter().zip(weights).map(|(a, b)| f64::from(*a) * f64::from(b)).sum()
    };
    let difference = (value(step) - value(-step)) / f64::from(2.0 * step);
    let d = run(twin, Some(gpu), (n, batch), 0.0).0.1;
    let ((), plan) = lay_out(|plan| twin.plan(plan));
    let directions = directions(plan.weight_count(), n, batch, twin.along_means());
    let slope: f64 = d.iter().zip(directions).map(|(a, b)| f64::from(*a) * f64::from(b)).sum();
    let size = norm(d.iter().map(|&d| d.into())); // the slope along a direction may be zero by chance
    assert!((slope - difference).abs() <= 0.03 * size, "{name}: {slope} of {size}, by differences {difference}");
}

/// Returns the cotangents of terms in the order of [`flat`].
fn flat_cotangents(terms: usize, outputs: &[Real]) -> Vec<Real> {
    let parts: &[usize] = if outputs.len() == 9 * terms { &[4, 3, 2] } else { &[2] };
    parts.iter().flat_map(|part| cotangents(part * terms)).collect()
}

fn networks() -> Vec<(&'static str, Box<dyn Twin>)> {
    let small = Mlp {
        depth: 4,
        width: 18,
        position_frequencies: 3,
        tx_frequencies: 2,
        tx_hidden: 6,
        tx_features: 5,
        skip: Some(1),
        ..Mlp::default()
    };
    let signals = Mlp { outputs: Outputs::Signals, skip: None, depth: 2, width: 66, ..small.clone() };
    let one = Mlp { depth: 1, skip: None, ..small.clone() };
    let wrfgs = Wrfgs { depth: 4, width: 18, frequencies: 3, skip: Some(1), gain: Some(1.0) };
    let plain = Wrfgs { depth: 1, skip: None, width: 67, ..wrfgs.clone() };
    vec![
        ("Mlp", Box::new(small)),
        ("Mlp of signals", Box::new(signals)),
        ("Mlp of one layer", Box::new(one)),
        ("Wrfgs", Box::new(wrfgs)),
        ("Wrfgs of one layer", Box::new(plain)),
    ]
}

#[test]
fn networks_on_the_gpu_match_those_on_the_cpu() {
    let Some(gpu) = for_tests() else { return };
    networks().iter().for_each(|(name, twin)| compare(name, &**twin, gpu));
}

#[test]
fn slopes_match_differences() {
    let Some(gpu) = for_tests() else { return };
    networks().iter().for_each(|(name, twin)| compare_slopes(name, &**twin, gpu));
}

#[test]
fn networks_of_the_papers_match() {
    let Some(gpu) = for_tests() else { return };
    let networks: [(&str, Box<dyn Twin>); 2] =
        [("Mlp()", Box::new(Mlp::default())), ("Wrfgs()", Box::new(Wrfgs::default()))];
    for (name, twin) in networks {
        let ((expected, expected_d), _) = run(&*twin, None, (70, 2), 0.0);
        let ((found, found_d), _) = run(&*twin, Some(gpu), (70, 2), 0.0);
        let off = expected.iter().zip(&found).fold(0.0, |most: Real, (a, b)| most.max((a - b).abs()));
        assert!(off <= 1e-6, "{name}: {off:e}");
        let off = norm(expected_d.iter().zip(&found_d).map(|(a, b)| f64::from(a - b)));
        assert!(off <= 1e-3 * norm(expected_d.iter().map(|&d| d.into())), "{name}: {off:e}");
    }
}

#[test]
fn bits_repeat_in_another_process() {
    let Some(gpu) = for_tests() else { return };
    let results = networks().into_iter().flat_map(|(_, twin)| {
        let ((outputs, d), _) = run(&*twin, Some(gpu), (157, 3), 0.0);
        [outputs, d].concat()
    });
    check_bits_in_another_process("gpu_tests::bits_repeat_in_another_process", results);
}

#[test]
fn chunks_add_up() {
    let Some(gpu) = for_tests() else { return };
    // More rows than a chunk has, for narrow networks.
    let narrow = Mlp {
        depth: 2,
        width: 2,
        position_frequencies: 0,
        tx_frequencies: 0,
        tx_hidden: 2,
        tx_features: 2,
        skip: None,
        ..Mlp::default()
    };
    let wrfgs = Wrfgs { depth: 1, width: 2, frequencies: 0, skip: None, gain: Some(1.0) };
    for (name, twin) in [("Mlp", &narrow as &dyn Twin), ("Wrfgs", &wrfgs)] {
        let ((expected, expected_d), _) = run(twin, None, (65_600, 2), 0.0);
        let ((found, found_d), _) = run(twin, Some(gpu), (65_600, 2), 0.0);
        let off = expected.iter().zip(&found).fold(0.0, |most: Real, (a, b)| most.max((a - b).abs()));
        assert!(off <= 2e-6, "{name}: {off:e}");
        let off = norm(expected_d.iter().zip(&found_d).map(|(a, b)| f64::from(a - b)));
        let size = norm(expected_d.iter().map(|&d| d.into()));
        assert!(off <= 1e-3 * size, "{name}: {off:e} of {size:e}");
    }
}
