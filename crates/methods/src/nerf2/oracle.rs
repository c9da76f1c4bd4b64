//! Compares outputs, losses and the gradient of every weight with those of the released NeRF2 code in double precision.

use crate::nerf2::Nerf2;
use crate::nerf2::RayBundle;
use crate::nerf2::group::{GroupLinks, GroupScratch, RayGroup};
use crate::nerf2::network::Nerf2Network;
use crate::nerf2::path::PropagationLaw;
use crate::nerf2::walk::{RayWalk, Sums};
use pwrfgs_core::testing::{npy, shared};
use pwrfgs_core::{Conditions, Real, SPEED_OF_LIGHT};
use pwrfgs_networks::linear::lay_out;
use std::fs::File;
use std::io::BufReader;
use zip::ZipArchive;

struct Oracle(ZipArchive<BufReader<File>>);

impl Oracle {
    fn open(mode: &str) -> Option<Self> {
        let path = shared("oracle/nerf2")?.join(format!("{mode}.npz"));
        Some(Self(ZipArchive::new(BufReader::new(File::open(path).unwrap())).unwrap()))
    }

    fn array(&mut self, name: &str) -> Vec<Real> {
        let mut array = self.0.by_name(&format!("{name}.npy")).unwrap_or_else(|e| panic!("{name}: {e}"));
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut array, &mut bytes).unwrap();
        npy(&bytes).1.into_iter().map(|v| v as Real).collect()
    }

    /// Returns all weights, or all gradients, in the order of this implementation.
    fn weights(&mut self, kind: &str, names: &[String]) -> Vec<Real> {
        let theirs = |ours: &str| {
            let (layer, part) = ours.rsplit_once('.').unwrap();
            let layer = match layer {
                "attenuation" => "attenuation_output".to_owned(),
                "feature" => "feature_layer".to_owned(),
                "emission" => "signal_output".to_owned(),
                _ => layer.replace("trunk", "attenuation_linears").replace("signal", "signal_linears"),
            };
            format!("{kind}.{layer}.{part}")
        };
        names.iter().flat_map(|name| self.array(&theirs(name))).collect()
    }
}

fn error(actual: &[Real], expected: &[Real]) -> f64 {
    assert_eq!(actual.len(), expected.len());
    let largest = expected.iter().fold(0.0, |m: Real, e| m.max(e.abs()));
    f64::from(actual.iter().zip(expected).fold(0.0, |m: Real, (f, e)| m.max((f - e).abs())) / largest)
}

/// Runs all links of a mode along their rays, and the backward pass: outputs `[L, numbers]` and gradients.
fn reproduce(mode: &str, bands: usize, law: PropagationLaw) {
    let Some(mut oracle) = Oracle::open(mode) else { return };
    let (tx, label) = (oracle.array("tx"), oracle.array("label"));
    let (origins, directions) = (oracle.array("rays_o"), oracle.array("rays_d"));
    let links = origins.len() / 3;
    let features = if mode == "csi" { tx.len() / links } else { 0 };
    let samples = if mode == "spectrum" { 64 } else { 32 };
    let far_m = if mode == "rssi" { 1.0 } else { 5.0 };
    let method = Nerf2 { width: 32, samples, far_m, features, ..Nerf2::default() };
    let (network, plan) = lay_out(|plan| Nerf2Network::new(&method, bands, plan));
    let names: Vec<String> = plan.layout().weights.into_iter().map(|spec| spec.name).collect();
    let weights = oracle.weights("w", &names);
    let conditions = Conditions::new(method_inputs(&method), &tx);
    let transmitter_terms = network.transmitter_terms(&weights, &conditions, 1.0);
    let groups: Vec<RayGroup<'_>> = (0..links)
        .map(|link| {
            let all: Vec<[Real; 3]> = directions.as_chunks().0.to_vec();
            let of_link = all.len() / links;
            // The released renderer uses only the first ring for powers, because of an error in its number of chunks.
            let used = if mode == "rssi" { method.azimuths } else { of_link };
            let rays = RayBundle {
                origin: origins[3 * link..3 * link + 3].try_into().unwrap(),
                directions: all[link * of_link..][..used].to_vec(),
                samples: (0..samples).map(|i| far_m * i as Real / (samples - 1) as Real).collect(),
            };
            if mode != "spectrum" {
                let sky = method.sky_directions();
                let off =
                    rays.directions.iter().zip(&sky).map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).abs()).sum::<Real>());
                assert!(off.fold(0.0, Real::max) < 1e-6, "the sky is the released one");
            }
            let walk =
                RayWalk { network: &network, weights: &weights, rays, law, transmitter_terms: &transmitter_terms };
            RayGroup { receiver: 0, walk, links: GroupLinks::All(vec![(link, link)]) }
        })
        .collect();

    let mut totals = vec![[0.0; 2]; links * bands];
    for (link, group) in groups.iter().enumerate() {
        for chunk in group.walk.chunks() {
            let sums = group.forward(&chunk, None, &mut GroupScratch::default());
            assert_eq!(group.forward_keeping(&chunk).1, sums, "what is kept is what passes");
            for (i, sum) in sums[0].iter().enumerate() {
                let total = &mut totals[link * bands + i % bands];
                *total = [total[0] + sum[0], total[1] + sum[1]];
            }
        }
    }
    let output: Vec<Real> = if mode == "csi" {
        pwrfgs_core::rows_of(&totals, bands)
    } else {
        totals.iter().map(|[re, im]| re.hypot(*im)).collect()
    };
    let exact = size_of::<Real>() == 8;
    let off = error(&output, &oracle.array("output"));
    assert!(off < if exact { 1e-10 } else { 2e-3 }, "{mode}: outputs: {off:e}");
    let mse = output.iter().zip(&label).map(|(o, l)| (o - l) * (o - l)).sum::<Real>() / output.len() as Real;
    let off = error(&[mse], &oracle.array("loss"));
    assert!(off < if exact { 1e-10 } else { 2e-3 }, "{mode}: loss: {off:e}");

    let d: Vec<Real> = output.iter().zip(&label).map(|(o, l)| 2.0 * (o - l) / output.len() as Real).collect();
    let d_totals: Vec<[Real; 2]> = if mode == "csi" {
        pwrfgs_core::gains_of(&d, bands)
    } else {
        totals.iter().zip(&d).map(|([re, im], d)| [d * re / re.hypot(*im), d * im / re.hypot(*im)]).collect()
    };
    let back = |activations: bool| {
        let mut d_weights = vec![0.0; weights.len()];
        let mut into = Sums { weights: &mut d_weights, transmitter_terms: vec![0.0; transmitter_terms.len()] };
        for (link, group) in groups.iter().enumerate() {
            for chunk in group.walk.chunks() {
                let results = activations.then(|| group.forward_keeping(&chunk).0);
                let d = |_, _, band| d_totals[link * bands + band];
                group.backward(&chunk, results.as_ref(), d, &mut GroupScratch::default(), &mut into);
            }
        }
        network.transmitter_terms_vjp(&weights, &conditions, 1.0, &into.transmitter_terms, (into.weights, None));
        d_weights
    };
    let actual = back(true);
    assert!(back(false) == actual, "what is worked out again is what was kept");
    let mut from = 0;
    for name in &names {
        let expected = oracle.weights("g", std::slice::from_ref(name));
        let off = error(&actual[from..from + expected.len()], &expected);
        assert!(off < if exact { 1e-10 } else { 2e-2 }, "{mode}: {name}: {off:e}");
        from += expected.len();
    }
}

fn method_inputs(method: &Nerf2) -> usize {
    pwrfgs_core::Method::traits(method).inputs
}

#[test]
fn spectrum_matches_released_code() {
    reproduce("spectrum", 1, PropagationLaw::Spectrum);
}

#[test]
fn power_matches_released_code() {
    reproduce("rssi", 1, released_wave());
}

#[test]
fn channel_matches_released_code() {
    reproduce("csi", 26, released_wave());
}

fn released_wave() -> PropagationLaw {
    PropagationLaw::Wave { wavenumber: (2.0 * std::f64::consts::PI * 2.4e9 / SPEED_OF_LIGHT) as Real }
}
