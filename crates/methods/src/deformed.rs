//! What methods share whose Gaussians pass a [`Deformation`] and an [`Activation`].

use crate::{Activation, ActivationVjp};
use pwrfgs_core::{
    Activated, Asked, Conditions, Dataset, Deformation, DeformationInputs, Deltas, Frame, GaussianCloud, Method,
    MethodVjp, Parameters, Pixels, Real,
};

/// The name of what is learned of every receiver's gain.
pub(crate) const OFFSETS: &str = "receiver.offsets";

/// The rows of `cloud` that the network has to see: those whose gate is open; all, where it couples them.
pub(crate) fn rows(deformation: &dyn Deformation, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
    let all = deformation.traits().couples_gaussians;
    (0..cloud.len()).filter(|&i| all || gate.is_none_or(|gate| gate[i] != 0.0)).collect()
}

/// Adds to `sums`, given what the activation gave, and what the network gives for it.
pub(crate) fn vjp(
    deformation: &dyn Deformation,
    inputs: &DeformationInputs<'_>,
    own: &ActivationVjp,
    sums: &mut MethodVjp,
) {
    let mut d_means = vec![[0.0; 3]; inputs.means.len()];
    if !own.deltas.is_empty() {
        let d_network = &mut sums.weights[..inputs.weights.len()];
        deformation.vjp(inputs, &own.deltas, d_network, Some(&mut d_means));
    }
    for ((_, _, sum), (_, _, own)) in sums.cloud.columns_mut().zip(own.cloud.columns()) {
        sum.iter_mut().zip(own).for_each(|(sum, d)| *sum += d);
    }
    sums.cloud.means.as_flattened_mut().iter_mut().zip(d_means.as_flattened()).for_each(|(sum, d)| *sum += d);
    sums.gate.iter_mut().zip(&own.gate).for_each(|(sum, d)| *sum += d);
    sums.presence.iter_mut().zip(&own.presence).for_each(|(sum, d)| *sum += d);
}

/// The Gaussians as they are drawn for a transmitter at `tx` or without any; `p.weights` begin with those of the network.
/// `strengths` makes grey values `[N]` of signals `[N, channels]`.
pub(crate) fn gaussians(
    deformation: &dyn Deformation,
    activation: Activation,
    frame: &Frame,
    p: &Parameters<'_>,
    tx: Option<[Real; 3]>,
    strengths: impl Fn(&[Real]) -> Vec<Real>,
) -> Activated {
    let network = &p.weights[..deformation.layout().numbers()];
    let deform = |tx: [Real; 3]| {
        deformation.forward(&DeformationInputs::new(network, &p.cloud.means, &[tx], &frame.pose()), &None)
    };
    let deltas = tx.map_or_else(Deltas::default, deform);
    let signals = activation.signals(p.cloud, &deltas, 0..1);
    let is_known = tx.is_some() || !activation.replaces_signals;
    let strengths = is_known.then(|| strengths(&signals));
    Activated { primitives: activation.geometry(p.cloud, &deltas, 0, None), signals, strengths }
}

/// What `method` predicts of the links `part` before the first step, `[part, numbers]`.
pub(crate) fn untrained(
    method: &dyn Method,
    frame: &Frame,
    data: &Dataset,
    part: &[usize],
    (cloud, weights): (&GaussianCloud, &[Real]),
) -> Vec<Real> {
    let inputs = method.traits().inputs;
    let (conditions, links) = frame.conditions(inputs, part.iter().map(|&i| data.query(i)));
    let asked = Asked { conditions: Conditions::new(inputs, &conditions), links: &links, pixels: Pixels::All };
    method.forward(frame, &Parameters { cloud, gate: None, presence: None, weights }, &asked).numbers
}

/// Sets what the network can be told of the features of the training part.
pub(crate) fn start(deformation: &dyn Deformation, data: &Dataset, train: &[usize], network: &mut [Real]) {
    let inputs = deformation.traits().inputs;
    if inputs != 3 {
        let all: Vec<Real> = train.iter().flat_map(|&i| data.query(i).features).copied().collect();
        deformation.start(Conditions::new(inputs, &all), network);
    }
}

/// Refuses several receivers where the network reads the place of one.
pub(crate) fn check_receivers(deformation: &dyn Deformation, frame: &Frame) -> Result<(), String> {
    if frame.receivers.len() > 1 && deformation.traits().reads_receiver {
        return Err(format!(
            "the deformation looks at where the receiver is, and these data have {} receivers; use Factored() or Mlp()",
            frame.receivers.len()
        ));
    }
    Ok(())
}
