//! The network on the GPU against that on the CPU, which has tests of its own: sums along the rays, derivatives, slopes, bits.

use crate::nerf2::gpu::GpuNerf2;
use crate::nerf2::group::{GroupLinks, GroupScratch, RayGroup};
use crate::nerf2::network::Nerf2Network;
use crate::nerf2::path::PropagationLaw;
use crate::nerf2::walk::{RayWalk, Sums};
use crate::nerf2::{Nerf2, RayBundle};
use pwrfgs_core::testing::check_bits_in_another_process;
use pwrfgs_core::{Conditions, Real, rng};
use pwrfgs_gpu::{Gpu, for_tests};
use pwrfgs_networks::linear::lay_out;

/// Rays, transmitters, bands, and whether every ray has a transmitter of its own.
#[derive(Clone, Copy, Debug)]
struct Case {
    rays: usize,
    batch: usize,
    bands: usize,
    is_own: bool,
}

/// Sums along the rays, and derivatives by weights and transmitters for seeded cotangents.
type Pass = (Vec<Real>, Vec<Real>);

fn random(name: &str, len: usize) -> Vec<Real> {
    let mut random = rng::stream(5, name, len as u64);
    (0..len).map(|_| rng::normal(&mut random)).collect()
}

/// Seeded cotangents of the sums.
fn cotangent([pass, ray, band]: [usize; 3]) -> [Real; 2] {
    let phase = (1 + 7 * pass + 3 * ray + 5 * band) as Real;
    [phase.sin(), phase.cos()]
}

/// Returns seeded directions of weights and transmitters.
fn directions(weights: usize, batch: usize) -> Vec<Real> {
    random("directions", weights + 3 * batch)
}

/// Runs forward and backward pass, on the GPU if there is one, from inputs moved by `shift` along [`directions`].
fn run(method: &Nerf2, gpu: Option<&Gpu>, case: Case, shift: Real) -> Pass {
    let Case { rays, batch, bands, is_own } = case;
    let (network, plan) = lay_out(|plan| Nerf2Network::new(method, bands, plan));
    let mut weights = plan.layout().init(&mut rng::stream(2, "gpu", 0));
    let mut txs: Vec<[Real; 3]> = random("txs", 3 * batch).as_chunks().0.to_vec();
    let moved = weights.iter_mut().chain(txs.as_flattened_mut());
    moved.zip(directions(plan_len(method, bands), batch)).for_each(|(x, direction)| *x += shift * direction);
    let conditions = Conditions::from(&txs);
    let transmitter_terms = network.transmitter_terms(&weights, &conditions, 1.0);
    let unit = |d: &[Real; 3]| {
        let length = d.iter().map(|x| x * x).sum::<Real>().sqrt();
        d.map(|x| x / length)
    };
    let law = if bands == 1 { PropagationLaw::Spectrum } else { PropagationLaw::Wave { wavenumber: 5.0 } };
    let directions: Vec<[Real; 3]> = random("rays", 3 * rays).as_chunks().0.iter().map(unit).collect();
    let samples = (0..method.samples).map(|i| 3.0 * i as Real / (method.samples - 1) as Real).collect();
    let rays = RayBundle { origin: [0.1, 0.2, 0.3], directions, samples };
    let links = if is_own {
        GroupLinks::OnePerRay((0..rays.directions.len()).map(|ray| (ray, ray * 5 % batch)).collect())
    } else {
        GroupLinks::All((0..batch).map(|b| (b, b)).collect())
    };
    let walk = RayWalk { network: &network, weights: &weights, rays, law, transmitter_terms: &transmitter_terms };
    let groups = [RayGroup { receiver: 0, walk, links }];
    let mut d_weights = vec![0.0; weights.len()];
    let (sums, d_terms) = match gpu {
        Some(gpu) => {
            let on = GpuNerf2 { gpu, network: &network, weights: &weights, samples: method.samples };
            on_gpu(on, &groups, &mut d_weights)
        }
        None => on_cpu(&groups[0], &mut d_weights),
    };
    let mut d_txs = vec![[0.0; 3]; batch];
    network.transmitter_terms_vjp(&weights, &conditions, 1.0, &d_terms, (&mut d_weights, Some(&mut d_txs)));
    d_weights.extend(d_txs.as_flattened());
    (sums, d_weights)
}

fn plan_len(method: &Nerf2, bands: usize) -> usize {
    lay_out(|plan| Nerf2Network::new(method, bands, plan)).1.weight_count()
}

fn on_cpu(group: &RayGroup<'_>, d_weights: &mut [Real]) -> (Vec<Real>, Vec<Real>) {
    let (mut sums, mut scratch) = (vec![Vec::new(); group.links.pass_count()], GroupScratch::default());
    let mut into = Sums { weights: d_weights, transmitter_terms: vec![0.0; group.walk.transmitter_terms.len()] };
    for chunk in group.walk.chunks() {
        let of_chunk = group.forward(&chunk, None, &mut scratch);
        sums.iter_mut().zip(of_chunk).for_each(|(all, sums)| all.extend(sums));
        group.backward(&chunk, None, |pass, ray, band| cotangent([pass, ray, band]), &mut scratch, &mut into);
    }
    (sums.into_iter().flatten().flatten().collect(), into.transmitter_terms)
}

fn on_gpu(on: GpuNerf2<'_>, groups: &[RayGroup<'_>], d_weights: &mut [Real]) -> (Vec<Real>, Vec<Real>) {
    let passes = groups[0].links.pass_count();
    let sums_of = |ready: Option<&[_]>| {
        let results = on.forward(groups, &on.items(groups, ready), |activations| activations).unwrap();
        let (chunks, of_chunks): (Vec<_>, Vec<_>) = results.into_iter().unzip();
        let of_pass = |pass: usize| of_chunks.iter().flat_map(move |sums| sums[pass].iter().flatten().copied());
        let sums: Vec<Real> = (0..passes).flat_map(of_pass).collect();
        (chunks, sums)
    };
    let (chunks, sums) = sums_of(None);
    let ready = [on.prepare(&groups[0]).unwrap().unwrap()];
    assert!(sums_of(Some(&ready)).1 == sums, "the same trunk, kept");
    let d_terms = on.backward(groups, &chunks, |_, sum| cotangent(sum), d_weights).unwrap();
    (sums, d_terms)
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}

fn methods() -> [(&'static str, Nerf2); 3] {
    let small = Nerf2 { depth: 3, width: 18, samples: 5, ..Nerf2::default() };
    [
        ("small", small.clone()),
        ("joined again", Nerf2 { depth: 6, width: 34, samples: 7, ..small.clone() }),
        ("one layer", Nerf2 { depth: 1, width: 66, samples: 2, ..small }),
    ]
}

/// Compares sums to 1e-6 and derivatives to 1e-5 as norms; to 1e-3 where so many units are added up that some change their sign by
/// rounding.
#[test]
fn network_on_the_gpu_matches_the_cpu() {
    let Some(gpu) = for_tests() else { return };
    for (name, method) in methods() {
        for rays in [0, 1, 12, 13, 63, 64, 65, 157] {
            for (batch, bands, is_own) in [(1, 1, false), (3, 1, false), (3, 1, true), (3, 3, false)] {
                let case = Case { rays, batch, bands, is_own };
                let ((expected, expected_d), (found, found_d)) =
                    (run(&method, None, case, 0.0), run(&method, Some(gpu), case, 0.0));
                assert_eq!(found.len(), expected.len());
                for (found, expected) in found.iter().zip(&expected) {
                    let off = (found - expected).abs();
                    assert!(off <= 1e-6 * expected.abs().max(1.0), "{name}, {case:?}: {found}, {expected}");
                }
                let size = norm(expected_d.iter().map(|&d| d.into()));
                let off = norm(expected_d.iter().zip(&found_d).map(|(a, b)| f64::from(a - b)));
                let limit = if rays > 65 { 1e-3 } else { 1e-5 };
                assert!(off <= limit * size, "{name}, {case:?}: derivatives differ by {off:e} of {size:e}");
                if rays == 65 {
                    assert!(run(&method, Some(gpu), case, 0.0) == (found, found_d), "{name}, {case:?}: equal bits");
                }
            }
        }
    }
}

/// Compares the slope of Σ cotangent · sum along a direction with differences.
#[test]
fn slopes_match_differences() {
    let Some(gpu) = for_tests() else { return };
    for (name, method) in methods() {
        let (case, step) = (Case { rays: 33, batch: 2, bands: 3, is_own: false }, 1e-5);
        let value = |shift: Real| -> f64 {
            let sums = run(&method, Some(gpu), case, shift).0;
            let d = (0..2).flat_map(|pass| (0..99).flat_map(move |i| cotangent([pass, i / 3, i % 3])));
            sums.iter().zip(d).map(|(a, b)| f64::from(*a) * f64::from(b)).sum()
        };
        let difference = (value(step) - value(-step)) / f64::from(2.0 * step);
        let d = run(&method, Some(gpu), case, 0.0).1;
        let directions = directions(plan_len(&method, 3), 2);
        let slope: f64 = d.iter().zip(directions).map(|(a, b)| f64::from(*a) * f64::from(b)).sum();
        let size = norm(d.iter().map(|&d| d.into()));
        assert!((slope - difference).abs() <= 0.03 * size, "{name}: {slope} of {size}, by differences {difference}");
    }
}

#[test]
fn network_of_the_paper_matches() {
    let Some(gpu) = for_tests() else { return };
    let (method, case) =
        (Nerf2 { samples: 8, ..Nerf2::default() }, Case { rays: 9, batch: 2, bands: 1, is_own: false });
    let ((expected, expected_d), (found, found_d)) =
        (run(&method, None, case, 0.0), run(&method, Some(gpu), case, 0.0));
    let off = expected.iter().zip(&found).fold(0.0, |most: Real, (a, b)| most.max((a - b).abs()));
    assert!(off <= 1e-6, "{off:e}");
    let off = norm(expected_d.iter().zip(&found_d).map(|(a, b)| f64::from(a - b)));
    assert!(off <= 1e-3 * norm(expected_d.iter().map(|&d| d.into())), "{off:e}");
}

#[test]
fn bits_repeat_in_another_process() {
    let Some(gpu) = for_tests() else { return };
    let case = Case { rays: 65, batch: 3, bands: 3, is_own: false };
    let results = methods().into_iter().flat_map(|(_, method)| {
        let (sums, d) = run(&method, Some(gpu), case, 0.0);
        [sums, d].concat()
    });
    check_bits_in_another_process("nerf2::gpu_tests::bits_repeat_in_another_process", results);
}

#[test]
fn chunks_add_up() {
    let Some(gpu) = for_tests() else { return };
    // More samples than a chunk has rows.
    let method = Nerf2 { depth: 1, width: 2, samples: 400, ..Nerf2::default() };
    for is_own in [false, true] {
        let case = Case { rays: 170, batch: 2, bands: 1, is_own };
        let ((expected, expected_d), (found, found_d)) =
            (run(&method, None, case, 0.0), run(&method, Some(gpu), case, 0.0));
        let off = expected.iter().zip(&found).fold(0.0, |most: Real, (a, b)| most.max((a - b).abs()));
        assert!(off <= 1e-5, "{off:e}");
        let off = norm(expected_d.iter().zip(&found_d).map(|(a, b)| f64::from(a - b)));
        let size = norm(expected_d.iter().map(|&d| d.into()));
        assert!(off <= 1e-3 * size, "{off:e} of {size:e}");
    }
}
