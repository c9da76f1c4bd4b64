//! Reference data of WRF-GS: network inputs, weights, outputs and derivatives in double precision.

use super::Wrfgs;
use crate::linear::LayoutBuilder;
use pwrfgs_core::testing::{npy, shared};
use pwrfgs_core::{Deformation, DeformationInputs, DeformationVjp, Deltas, Pose, Real, rng};
use std::path::Path;

fn array(folder: &Path, name: &str) -> Vec<Real> {
    let bytes = std::fs::read(folder.join(format!("{name}.npy"))).unwrap();
    npy(&bytes).1.into_iter().map(|v| v as Real).collect()
}

fn rows(values: &[Real]) -> Vec<[Real; 3]> {
    values.as_chunks().0.to_vec()
}

/// Returns the largest difference, relative to the largest number.
fn error(computed: &[Real], expected: &[Real]) -> f64 {
    assert_eq!(computed.len(), expected.len());
    let largest = expected.iter().fold(0.0, |m: Real, e| m.max(e.abs())).max(1e-300 as Real);
    f64::from(computed.iter().zip(expected).fold(0.0, |m: Real, (f, e)| m.max((f - e).abs())) / largest)
}

#[test]
fn wrfgs_matches_reference_signals_and_derivatives() {
    // In single precision a coordinate of 40 m has a resolution of 2e-6 m, and an angle of 2⁹·x one of 1e-3 rad.
    let (signal_tolerance, derivative_tolerance) = if size_of::<Real>() == 8 { (1e-12, 1e-10) } else { (2e-3, 2e-2) };
    for name in ["n8", "n64", "n64_mask"] {
        let Some(folder) = shared(&format!("oracle/{name}")) else { continue };
        let wrfgs = Wrfgs::default();
        let layout = wrfgs.layout().weights;
        let weights: Vec<Real> = layout.iter().flat_map(|spec| array(&folder, &format!("net_{}", spec.name))).collect();
        let (means, txs) = (rows(&array(&folder, "in_xyz")), rows(&array(&folder, "in_tx")));
        let position: [f64; 3] = std::array::from_fn(|k| f64::from(array(&folder, "in_r_o")[k]));
        let pose = Pose { position, ..Pose::IDENTITY };

        let raw = wrfgs.plan_layers(&mut LayoutBuilder::default()).raw(&weights, &means, txs[0]);
        let computed = error(raw.as_flattened(), &array(&folder, "out_raw"));
        assert!(computed < signal_tolerance, "{name}: raw outputs: {computed}");

        let inputs = DeformationInputs::new(&weights, &means, &txs, &pose);
        let signals = wrfgs.forward(&inputs, &None).signals;
        let first: Vec<Real> = signals.iter().map(|s| s[0]).collect();
        let computed = error(&first, &array(&folder, "out_signal"));
        assert!(computed < signal_tolerance, "{name}: signal: {computed}");
        assert!(signals.iter().all(|s| s[1] == 0.0));

        let d = array(&folder, "grad_signal").into_iter().map(|d| [d, 0.0]).collect();
        let mut d_weights = vec![0.0; weights.len()];
        wrfgs.vjp(&inputs, &Deltas { signals: d, ..Deltas::default() }, DeformationVjp::of_weights(&mut d_weights));
        let mut rest = d_weights.as_slice();
        for spec in layout {
            let (these, after) = rest.split_at(spec.len());
            rest = after;
            let computed = error(these, &array(&folder, &format!("gradnet_{}", spec.name)));
            assert!(computed < derivative_tolerance, "{name}: {}: {computed}", spec.name);
        }
    }
}

#[test]
fn start_is_reproducible() {
    let wrfgs = Wrfgs::default();
    let start = || wrfgs.layout().init(&mut rng::stream(0, "init", 0));
    assert_eq!(start(), start());
}
