//! The Gaussians of a model on their way to a page: as they are, or as a transmitter makes them.

use crate::live::Pack;
use pwrfgs_core::{
    Activated, Asked, Conditions, Link, MethodTraits, Needs, Origin, Parameters, Pixels, Real, Statistic,
};
use pwrfgs_model::Snapshot;
use pwrfgs_model::{Ensemble, Model};
use serde_json::json;

/// Means, scales, rotations, opacities and strengths `[N]` of all members, metres from `origin`; with `tx` (metres, world
/// frame) as they are drawn for a transmitter there. A strength is the grey value that a Gaussian would give alone, were it
/// opaque.
pub fn gaussians(ensemble: &Ensemble, origin: Origin, tx: Option<[f64; 3]>) -> Pack {
    let mut pack = Pack::new(json!({ "gaussians": ensemble.gaussians() }));
    let n = ensemble.gaussians();
    let all: Vec<_> = ensemble.members().iter().map(|model| model.gaussians(tx)).collect();
    let put = |pack: &mut Pack, name: &str, width: usize, values: Vec<Real>| pack.put(name, &[n, width], values);
    put(&mut pack, "means", 3, ensemble.means_from(origin).into_flattened());
    put(&mut pack, "scales", 3, all.iter().flat_map(|own| own.primitives.scales.as_flattened().to_vec()).collect());
    put(&mut pack, "quats", 4, all.iter().flat_map(|own| own.primitives.quats.as_flattened().to_vec()).collect());
    put(&mut pack, "opacities", 1, all.iter().flat_map(|own| own.primitives.opacities.clone()).collect());
    put(&mut pack, "strengths", 1, all.iter().flat_map(strengths).collect());
    pack
}

/// What each Gaussian of all members adds to what `receiver` observes of a transmitter at `tx`: the sum of its blending
/// weights times its strength where Gaussians are blended, opacity times strength elsewhere.
pub fn contributions(ensemble: &Ensemble, tx: [f64; 3], receiver: usize) -> Vec<Real> {
    ensemble.members().iter().flat_map(|model| contributions_of(model, tx, receiver)).collect()
}

fn contributions_of(model: &Model, tx: [f64; 3], receiver: usize) -> Vec<Real> {
    let own = model.gaussians(Some(tx));
    let (primitives, strengths) = (&own.primitives, strengths(&own));
    let stages = &model.stages;
    let MethodTraits { blends, inputs, .. } = stages.method.traits();
    if !blends {
        return strengths.iter().zip(&primitives.opacities).map(|(s, o)| s * o).collect();
    }
    let condition = stages.origin.local(tx);
    let asked = Asked {
        conditions: Conditions::new(inputs, &condition),
        links: &[Link { transmitter: 0, receiver }],
        pixels: Pixels::All,
    };
    let parameters = Parameters { cloud: &model.cloud, gate: None, presence: None, weights: &model.weights };
    let truth = vec![0.0; stages.frame.numbers()];
    let needs = Needs::of(&[Statistic::Weight], 0);
    let seen = stages.method.survey(&stages.frame, &parameters, &asked, &truth, &needs);
    strengths.iter().zip(&seen.weight).map(|(s, w)| s * w).collect()
}

fn strengths(own: &Activated) -> Vec<Real> {
    own.strengths.clone().unwrap_or_else(|| vec![0.0; own.primitives.len()])
}

/// The Gaussians of a snapshot, metres from `origin`: means and opacities, and where the file knows them scales, rotations,
/// gates, and who they are.
pub fn moment(snapshot: &Snapshot, origin: Origin) -> Pack {
    let n = snapshot.means.len();
    let mut pack = Pack::new(json!({ "gaussians": n, "step": snapshot.step }));
    pack.put("means", &[n, 3], (0..n).flat_map(|i| origin.local(snapshot.place(i))));
    pack.put("opacities", &[n], snapshot.opacities.iter().copied());
    if snapshot.scales.len() == n {
        pack.put("scales", &[n, 3], snapshot.scales.as_flattened().iter().copied());
        pack.put("quats", &[n, 4], snapshot.quats.as_flattened().iter().copied());
    }
    if snapshot.births.len() == n {
        pack.put("births", &[n], snapshot.births.iter().map(|birth| *birth as Real));
    }
    if snapshot.gates.len() == n {
        pack.put("gates", &[n], snapshot.gates.iter().copied());
    }
    pack
}
