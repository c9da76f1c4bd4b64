//! `ReceiverGroup`: links that are drawn together because they share a receiver and a geometry. Also shared code of
//! methods with a [`Deformation`] and an [`Activation`].

use crate::{Activation, ActivationVjp};
use pwrfgs_core::{
    Activated, Cache, Call, Conditions, Dataset, Deformation, DeformationInputs, DeformationVjp, Deltas, GaussianCloud,
    LinkInputs, MeasurementSetup, Method, MethodVjp, Parameters, PixelSubset, Real, ReceiverState, Vec3,
};
use std::borrow::Cow;
use std::ops::Range;

/// Links of one receiver at one pose.
#[derive(Debug)]
pub(crate) struct ReceiverGroup {
    pub(crate) state: ReceiverState,
    /// Index into [`LinkInputs::receivers`].
    pub(crate) row: usize,
    /// Indices into the list of links.
    pub(crate) links: Vec<usize>,
    /// Rows of their locations.
    rows: Vec<usize>,
}

impl ReceiverGroup {
    /// Groups all links by receiver, in the order of receivers; one group per link if links do not `share` a geometry.
    pub(crate) fn from_links(LinkInputs { receivers, pairs: links, .. }: &LinkInputs, share: bool) -> Vec<Self> {
        let mut by_receiver: Vec<Vec<usize>> = vec![Vec::new(); receivers.len()];
        links.iter().enumerate().for_each(|(i, link)| by_receiver[link.receiver].push(i));
        let mut groups: Vec<Self> = Vec::new();
        for (row, (state, receiver_links)) in receivers.iter().zip(by_receiver).enumerate() {
            let size = if share { receiver_links.len().max(1) } else { 1 };
            groups.extend(receiver_links.chunks(size).map(|part| Self {
                state: *state,
                row,
                links: part.to_vec(),
                rows: part.iter().map(|&i| links[i].location).collect(),
            }));
        }
        groups
    }

    /// Returns the links of the group, each as a separate group.
    pub(crate) fn split_links(&self) -> impl Iterator<Item = Self> + '_ {
        let (state, row) = (self.state, self.row);
        let one = move |(link, tx): (&usize, &usize)| Self { state, row, links: vec![*link], rows: vec![*tx] };
        self.links.iter().zip(&self.rows).map(one)
    }

    /// Returns the index of the first link of the group in the list of links.
    pub(crate) fn first_link(&self) -> usize {
        self.links[0]
    }

    /// Adds the cotangents of the pose of a moving receiver to those requested in `sums`. `pose_vjp` returns them, by position
    /// (metres) and by quaternion (x, y, z, w).
    pub(crate) fn add_pose_vjp(&self, sums: &mut MethodVjp, pose_vjp: impl FnOnce() -> ([f64; 3], [f64; 4])) {
        let Some(positions) = &mut sums.positions else { return };
        let (d_position, d_orientation) = pose_vjp();
        (0..3).for_each(|k| positions[self.rows[0]][k] += d_position[k] as Real);
        if let Some(orientations) = &mut sums.orientations {
            (0..4).for_each(|k| orientations[self.row][k] += d_orientation[k]);
        }
    }

    /// Returns the distance between both ends per link, metres; empty if the inputs are features or the fixed end is unknown.
    pub(crate) fn distances(&self, call: &Call<'_>) -> Vec<Real> {
        let Some(fixed) = call.setup.fixed_end(self.state.receiver) else { return Vec::new() };
        let moving = call.links.conditions().positions();
        let distance = |row: &usize| moving.get(*row).map(|position| (Vec3::from_array(*position) - fixed).length());
        self.rows.iter().filter_map(distance).collect()
    }

    /// Adds to the cotangents of the positions of the moving end, given those `d` of [`Self::distances`].
    pub(crate) fn distances_vjp(&self, call: &Call<'_>, d: impl Iterator<Item = Real>, d_positions: &mut [[Real; 3]]) {
        let Some(fixed) = call.setup.fixed_end(self.state.receiver) else { return };
        let moving = call.links.conditions().positions();
        for (row, d) in self.rows.iter().zip(d) {
            let offset = Vec3::from_array(moving[*row]) - fixed;
            let d_offset = offset.normalize_or_zero() * d;
            d_positions[*row].iter_mut().zip(d_offset.to_array()).for_each(|(sum, d)| *sum += d);
        }
    }

    /// Returns the rows of `all` `[L, numbers]` that belong to the links of the group, borrowed if they are contiguous.
    pub(crate) fn gather_rows<'a>(&self, all: &'a [Real], numbers: usize) -> Cow<'a, [Real]> {
        if self.links.windows(2).all(|pair| pair[1] == pair[0] + 1) {
            return Cow::Borrowed(&all[self.links[0] * numbers..][..self.links.len() * numbers]);
        }
        Cow::Owned(self.links.iter().flat_map(|link| &all[link * numbers..][..numbers]).copied().collect())
    }

    /// Writes `values` `[links of the group, numbers]` to the rows of these links in `all` `[L, numbers]`.
    pub(crate) fn scatter_rows(&self, values: &[Real], numbers: usize, all: &mut [Real]) {
        for (values, link) in values.chunks_exact(numbers).zip(&self.links) {
            all[link * numbers..][..numbers].copy_from_slice(values);
        }
    }

    /// Returns deformation terms with `n` rows per transmitter, and the range of the transmitters of the group in them. The terms
    /// are `deltas` itself if this range is contiguous there, otherwise a copy for the group alone.
    pub(crate) fn gather_terms<'a>(&self, deltas: &'a Deltas, n: usize) -> (Cow<'a, Deltas>, Range<usize>) {
        let first = self.rows[0];
        if self.rows.iter().enumerate().all(|(k, row)| *row == first + k) {
            return (Cow::Borrowed(deltas), first..first + self.rows.len());
        }
        (Cow::Owned(self.copy_terms(deltas, n)), 0..self.rows.len())
    }

    /// Calls `vjp` with the terms of [`Self::gather_terms`]; adds the cotangents of these terms to the rows of origin in
    /// `grads`.
    pub(crate) fn gather_terms_vjp(
        &self,
        deltas: &Deltas,
        grads: &mut ActivationVjp,
        vjp: impl FnOnce(&Deltas, Range<usize>, &mut ActivationVjp),
    ) {
        let n = grads.gate.len();
        let (terms, batch) = self.gather_terms(deltas, n);
        // Copied terms have their own derivative, which is then added to the rows of origin.
        let copied = matches!(terms, Cow::Owned(_));
        let sums = copied.then(|| std::mem::replace(&mut grads.deltas, terms.zeros_like()));
        vjp(&terms, batch, grads);
        if let Some(sums) = sums {
            let part = std::mem::replace(&mut grads.deltas, sums);
            self.add_copied_terms(&part, &mut grads.deltas, n);
        }
    }

    /// Copies the terms of the transmitters of the group, `n` rows each.
    fn copy_terms(&self, deltas: &Deltas, n: usize) -> Deltas {
        fn copy_rows<T: Copy>(column: &[T], rows: &[usize], n: usize) -> Vec<T> {
            if column.is_empty() {
                return Vec::new();
            }
            rows.iter().flat_map(|b| column[b * n..][..n].iter().copied()).collect()
        }
        let Deltas { scales, quats, signals } = deltas;
        Deltas {
            scales: copy_rows(scales, &self.rows, n),
            quats: copy_rows(quats, &self.rows, n),
            signals: copy_rows(signals, &self.rows, n),
        }
    }

    /// Adds the derivatives of copied terms to the rows of origin in `all`.
    fn add_copied_terms(&self, copied: &Deltas, all: &mut Deltas, n: usize) {
        for (copied, all) in copied.columns().into_iter().zip(all.columns_mut()) {
            let width = copied.len() / (self.rows.len() * n).max(1);
            for (k, b) in self.rows.iter().enumerate() {
                let into = all.iter_mut().skip(b * n * width).take(n * width);
                into.zip(&copied[k * n * width..]).for_each(|(sum, d): (&mut Real, &Real)| *sum += d);
            }
        }
    }
}

/// Name of the tensor of learned receiver gains.
pub(crate) const OFFSETS: &str = "receiver.offsets";

/// Returns the rows of `cloud` that pass through the network: those with an open gate; all if the network couples them.
pub(crate) fn network_rows(deformation: &dyn Deformation, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
    let couples_all = deformation.traits().couples_gaussians;
    (0..cloud.len()).filter(|&i| couples_all || gate.is_none_or(|gate| gate[i] != 0.0)).collect()
}

/// Returns the terms of the network, and its state for the backward pass if `is_training` and there is no `prepared` cache.
pub(crate) fn network_terms(
    deformation: &dyn Deformation,
    inputs: &DeformationInputs<'_>,
    prepared: &Cache,
    is_training: bool,
) -> (Deltas, Cache) {
    if is_training && prepared.is_none() {
        deformation.forward_for_vjp(inputs)
    } else {
        (deformation.forward(inputs, prepared), None)
    }
}

/// Runs the backward pass of the network, given the cotangents `grads` of the activation. Adds the cotangents of network and
/// activation to `sums`, whose weights begin with those of the network.
pub(crate) fn network_vjp(
    deformation: &dyn Deformation,
    inputs: &DeformationInputs<'_>,
    grads: &ActivationVjp,
    sums: &mut MethodVjp,
) {
    let mut d_means = vec![[0.0; 3]; inputs.means.len()];
    if !grads.deltas.is_empty() {
        let weights = &mut sums.weights[..inputs.weights.len()];
        let (means, positions) = (Some(&mut d_means[..]), sums.positions.as_deref_mut());
        deformation.vjp(inputs, &grads.deltas, DeformationVjp { weights, means, positions });
    }
    for ((_, _, sum), (_, _, column)) in sums.cloud.columns_mut().zip(grads.cloud.columns()) {
        sum.iter_mut().zip(column).for_each(|(sum, d)| *sum += d);
    }
    sums.cloud.means.as_flattened_mut().iter_mut().zip(d_means.as_flattened()).for_each(|(sum, d)| *sum += d);
    sums.gate.iter_mut().zip(&grads.gate).for_each(|(sum, d)| *sum += d);
}

/// Returns the Gaussians as drawn for a transmitter at `tx`, or without transmitter; `p.weights` begin with those of
/// the network. Pose and carrier are those of the first receiver. `strengths` computes pixel values `[N]` from signals
/// `[N, channels]`.
pub(crate) fn activated_gaussians(
    deformation: &dyn Deformation,
    activation: Activation,
    setup: &MeasurementSetup,
    p: &Parameters<'_>,
    tx: Option<[Real; 3]>,
    strengths: impl Fn(&[Real]) -> Vec<Real>,
) -> Activated {
    let network = &p.weights[..deformation.layout().weight_count()];
    let carriers = setup.carriers();
    let deform = |tx: [Real; 3]| {
        let tx = [tx];
        let txs = Conditions::from(&tx).at_carriers(carriers.get(..1).unwrap_or_default());
        deformation.forward(&DeformationInputs::new(network, &p.cloud.means, txs, &setup.pose()), &None)
    };
    let deltas = tx.map_or_else(Deltas::default, deform);
    let signals = activation.signals(p.cloud, &deltas, 0..1);
    // A network that replaces the signals gives none without a transmitter.
    let has_signals = tx.is_some() || !activation.replaces_signals;
    let strengths = has_signals.then(|| strengths(&signals));
    Activated { primitives: activation.geometry(p.cloud, &deltas, 0, None), signals, strengths }
}

/// Returns the predictions of `method` for the links `part` before the first training step, `[part, numbers]`.
pub(crate) fn untrained_predictions(
    method: &dyn Method,
    setup: &MeasurementSetup,
    data: &Dataset,
    part: &[usize],
    (cloud, weights): (&GaussianCloud, &[Real]),
) -> Vec<Real> {
    let links = &setup.inputs(method.traits().inputs, part.iter().map(|&i| data.query(i)));
    let parameters = Parameters { cloud, gate: None, existence: None, weights };
    method.forward(&Call { setup, parameters, links, pixels: &PixelSubset::All }, &None).numbers
}

/// Initialises those of the weights `network` of the deformation that depend on the features or positions of the training set.
pub(crate) fn start_network(deformation: &dyn Deformation, data: &Dataset, train: &[usize], network: &mut [Real]) {
    if data.features.is_some() {
        let features: Vec<Real> = train.iter().filter_map(|&i| data.query(i).features).flatten().copied().collect();
        return deformation.start(Conditions::new(deformation.traits().inputs, &features), network);
    }
    let mut locations: Vec<usize> = train.iter().map(|&i| data.links[i].location).collect();
    locations.dedup(); // links are in the order of their locations
    let position = |i: usize| data.scene.origin.local(data.locations[i].position());
    deformation.start(Conditions::from(&locations.into_iter().map(position).collect::<Vec<_>>()), network);
}
