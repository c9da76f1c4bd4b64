//! `Method`: the interface between training and models. It maps parameters and links to observations, with a backward
//! pass.

use crate::{
    Cache, CloudStats, Conditions, Dataset, Deformation, Elevation, End, GaussianCloud, ImagePlane, Layout, Link,
    Needs, Origin, PassStatistics, Plugin, Pose, Primitives, Projector, Query, Real, Receiver, Scene, StageTimes, Task,
    Vec3, plugin_kind,
};
use std::sync::Arc;

/// Receivers and measurement type: all properties of a data set that a trained model needs.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementSetup {
    /// Origin of all positions, in the user's frame.
    pub origin: Origin,
    /// End of all links that moves.
    pub moving: End,
    /// Position of the fixed transmitter if the receivers move and it is known, metres from `origin`.
    pub transmitter: Option<[f64; 3]>,
    /// Receivers, with poses relative to `origin`.
    pub receivers: Vec<Receiver>,
    /// Measurement type.
    pub task: Task,
    /// Grid of the values of one observation; for a spectrum, its image plane.
    pub plane: ImagePlane,
    /// Subcarrier frequencies of a channel, Hz; otherwise empty.
    pub frequencies_hz: Vec<f64>,
}

impl MeasurementSetup {
    /// Creates the setup for `data` on the image plane `plane`.
    pub fn of(data: &Dataset, plane: ImagePlane) -> Self {
        let frequencies_hz = data.observations.frequencies_hz().to_vec();
        let Scene { origin, moving, transmitter, receivers, .. } = data.scene.clone();
        Self { origin, moving, transmitter, receivers, task: data.task(), plane, frequencies_hz }
    }

    /// Creates the setup for spectra at one receiver.
    pub fn spectra(origin: Origin, pose: Pose, plane: ImagePlane) -> Self {
        let receivers = vec![Receiver::new("receiver", pose)];
        let (moving, transmitter, task) = (End::Transmitter, None, Task::default());
        Self { origin, moving, transmitter, receivers, task, plane, frequencies_hz: Vec::new() }
    }

    /// Returns the number of values per observation.
    pub fn numbers(&self) -> usize {
        self.plane.width * self.plane.height
    }

    /// Returns the pose of the first receiver, relative to the origin; world axes at the origin if it moves.
    pub fn pose(&self) -> Pose {
        self.receivers.first().map_or(Pose::IDENTITY, |receiver| receiver.pose)
    }

    /// Returns the position of the fixed end of links with a receiver, metres from the origin; `None` if it is a transmitter of
    /// unknown position.
    pub fn fixed_end(&self, receiver: usize) -> Option<Vec3> {
        match self.moving {
            End::Transmitter => Some(self.receivers[receiver].pose.origin()),
            End::Receiver => self.transmitter.map(|position| Pose::from(position).origin()),
        }
    }

    /// Returns the query for the moving end at a position in the user's frame; a receiver has its usual orientation.
    pub fn query(&self, position: [f64; 3], receiver: usize) -> Query<'static> {
        let orientation = match self.moving {
            End::Transmitter => Pose::IDENTITY.orientation,
            End::Receiver => self.receivers[receiver].pose.orientation,
        };
        Query::at(Pose { position, orientation }, receiver)
    }

    /// Returns the pose of the first receiver in the user's frame.
    pub fn receiver(&self) -> Pose {
        self.origin.world_pose(self.pose())
    }

    /// Returns the elevations of the rows of a spectrum.
    pub fn elevation(&self) -> Elevation {
        self.plane.elevation().unwrap_or(Elevation::UPPER)
    }

    /// Returns the carrier of each receiver as a network input: the logarithm of its frequency, scaled to the range -1 to
    /// 1 over all receivers. Empty unless all receivers state a carrier and at least two differ.
    pub fn carriers(&self) -> Vec<Real> {
        let logs: Option<Vec<f64>> = self.receivers.iter().map(|receiver| Some(receiver.carrier_hz?.ln())).collect();
        let logs = logs.unwrap_or_default();
        let (low, high) = logs.iter().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(*v), high.max(*v)));
        if low >= high {
            return Vec::new();
        }
        logs.iter().map(|v| (2.0 * (v - low) / (high - low) - 1.0) as Real).collect()
    }

    /// Returns the subcarrier frequencies of a receiver, Hz: `frequencies_hz`, moved to its carrier if it has one.
    pub fn frequencies_of(&self, receiver: usize) -> Vec<f64> {
        let (all, carrier) = (&self.frequencies_hz, self.receivers[receiver].carrier_hz);
        let middle = all.iter().sum::<f64>() / all.len().max(1) as f64;
        let moved = |hz: &f64| carrier.map_or(*hz, |carrier| carrier + (hz - middle));
        all.iter().map(moved).collect()
    }

    /// Returns the inputs of these links, of width `width`. Consecutive equal transmitters are merged.
    ///
    /// # Panics
    /// If there is no receiver of the index of a query.
    pub fn inputs<'q>(&self, width: usize, queries: impl Iterator<Item = Query<'q>>) -> LinkInputs {
        let (mut all, carriers, mut last) = (LinkInputs::of(width, self), self.carriers(), None);
        for query in queries {
            let receiver = query.receiver;
            assert!(receiver < self.receivers.len(), "receiver {receiver} of {}", self.receivers.len());
            let carrier = carriers.get(receiver);
            let input = (query.pose, query.features, carrier);
            let pose = self.origin.local_pose(query.pose);
            if last != Some(input) {
                all.carriers.extend(carrier);
                all.values.extend_from_slice(query.features.unwrap_or(&pose.origin().to_array()));
            }
            all.link(self, receiver, pose);
            last = Some(input);
        }
        all
    }
}

/// Links with the network inputs of their locations and the poses of their receivers, from
/// [`MeasurementSetup::inputs`].
#[derive(Clone, Debug, Default)]
pub struct LinkInputs {
    /// Number of network inputs per location.
    pub width: usize,
    /// Network inputs `[T, width]`: the position of the moving end, metres from the origin, or features.
    pub values: Vec<Real>,
    /// Carriers `[T]` ([`MeasurementSetup::carriers`]); empty for one carrier.
    pub carriers: Vec<Real>,
    /// Receivers: all of the setup, or moving ones at one pose after another.
    pub receivers: Vec<ReceiverState>,
    /// Links: pairs of a row of `values` and a row of `receivers`.
    pub pairs: Vec<Link>,
}

/// A receiver at a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReceiverState {
    /// Index of the receiver in the setup.
    pub receiver: usize,
    /// Its pose, relative to the origin.
    pub pose: Pose,
}

impl LinkInputs {
    /// Creates the inputs of no links, at the fixed receivers of `setup`.
    pub fn of(width: usize, setup: &MeasurementSetup) -> Self {
        let fixed = setup.receivers.iter().enumerate().filter(|_| setup.moving == End::Transmitter);
        let receivers = fixed.map(|(receiver, state)| ReceiverState { receiver, pose: state.pose }).collect();
        Self { width, receivers, ..Self::default() }
    }

    /// Adds the link of the last network inputs with a receiver of `setup`, which stands at `pose` if it moves (metres from
    /// the origin).
    pub fn link(&mut self, setup: &MeasurementSetup, receiver: usize, pose: Pose) {
        let mut row = receiver;
        if setup.moving.is_receiver() {
            let state = ReceiverState { receiver, pose };
            if self.receivers.last() != Some(&state) {
                self.receivers.push(state);
            }
            row = self.receivers.len() - 1;
        }
        self.pairs.push(Link { location: self.values.len() / self.width.max(1) - 1, receiver: row });
    }

    /// Borrows the network inputs.
    pub fn conditions(&self) -> Conditions<'_> {
        Conditions::new(self.width, &self.values).at_carriers(&self.carriers)
    }
}

/// Learned parameters in the form that a method reads.
#[derive(Clone, Copy, Debug)]
pub struct Parameters<'a> {
    /// Gaussians; a method may have none.
    pub cloud: &'a GaussianCloud,
    /// Factors of the pruners on opacity and scale of each Gaussian, `[N]`; `None` if all are 1.
    pub gate: Option<&'a [Real]>,
    /// Factors on the blending weight only, `[N]`; `None` without such a gate, and for methods that do not
    /// [support](MethodTraits::supports_existence_gate) it.
    pub existence: Option<&'a [Real]>,
    /// Weights, in the layout of [`Method::layout`].
    pub weights: &'a [Real],
}

/// What a method evaluates: links and their values, from parameters, in a measurement setup.
#[derive(Clone, Copy, Debug)]
pub struct Call<'a> {
    /// Receivers and measurement type.
    pub setup: &'a MeasurementSetup,
    /// Gaussians and weights.
    pub parameters: Parameters<'a>,
    /// Links with their network inputs, grouped by location.
    pub links: &'a LinkInputs,
    /// Selected values of each observation; always all, if the method does not [support](MethodTraits::supports_pixel_subset)
    /// a selection.
    pub pixels: &'a PixelSubset,
}

/// Selected values of an observation.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum PixelSubset {
    /// All values.
    #[default]
    All,
    /// The same values for every link: indices into an observation.
    Same(Arc<[usize]>),
    /// One value per link: `[L]` indices.
    Each(Arc<[usize]>),
}

impl PixelSubset {
    /// Returns the number of selected values per link, of `numbers` per observation.
    pub fn of_link(&self, numbers: usize) -> usize {
        match self {
            Self::All => numbers,
            Self::Same(indices) => indices.len(),
            Self::Each(_) => 1,
        }
    }
}

/// Observations, with the state for the backward pass.
#[derive(Debug)]
pub struct ForwardOutput {
    /// Observations `[L, numbers]`, or the values selected by [`Call::pixels`].
    pub numbers: Vec<Real>,
    /// State of the forward pass for [`Method::vjp`].
    pub cache: Cache,
}

/// Derivatives with respect to all learned parameters, with statistics of each Gaussian.
#[derive(Clone, Debug)]
pub struct MethodVjp {
    /// Derivative with respect to the columns of the cloud; those of pruners stay 0.
    pub cloud: GaussianCloud,
    /// Derivative with respect to the gate, `[N]`.
    pub gate: Vec<Real>,
    /// Derivative with respect to the existence factor, `[N]`.
    pub existence: Vec<Real>,
    /// Derivative with respect to the weights.
    pub weights: Vec<Real>,
    /// Statistics for pruners and densification; zeros if the method draws no splats.
    pub stats: CloudStats,
    /// Derivative with respect to the positions in the [links](Call::links) `[T, 3]`; `None` unless wanted. The position
    /// of a moving receiver also changes the geometry, which this includes.
    pub positions: Option<Vec<[Real; 3]>>,
    /// Derivative with respect to the orientations of the [receivers](LinkInputs::receivers) `[R, 4]`; `None` unless wanted.
    pub orientations: Option<Vec<[f64; 4]>>,
}

impl MethodVjp {
    /// Creates zeros for the parameters of `call`, and for those derivatives by its inputs that are `wanted`.
    pub fn zeros(call: &Call<'_>, wanted: WantedInputs) -> Self {
        let (n, links) = (call.parameters.cloud.len(), call.links);
        Self {
            cloud: call.parameters.cloud.zeros_like(),
            gate: vec![0.0; n],
            existence: vec![0.0; n],
            weights: vec![0.0; call.parameters.weights.len()],
            stats: CloudStats::zeros(n),
            positions: wanted.positions.then(|| vec![[0.0; 3]; links.conditions().len()]),
            orientations: wanted.orientations.then(|| vec![[0.0; 4]; links.receivers.len()]),
        }
    }
}

/// Inputs by which a derivative is wanted; training wants none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WantedInputs {
    /// Positions, from a method that [differentiates](MethodTraits::differentiates_positions) them.
    pub positions: bool,
    /// Orientations of the receivers, from a method that [differentiates](MethodTraits::differentiates_orientations)
    /// them; together with the positions.
    pub orientations: bool,
}

/// Maps parameters to observations. Parameters are the columns of a [`GaussianCloud`], which pruners and densification
/// change, and a flat vector of named weights; settings are stored in the plugin. Trainer, checkpoint, evaluation and
/// model file use a model only through this trait.
#[typetag::serde]
#[expect(unused_variables, reason = "the defaults ignore parameters")]
pub trait Method: crate::plugin::PluginObject {
    /// Returns properties that do not depend on the frame.
    fn traits(&self) -> MethodTraits<'_> {
        MethodTraits::default()
    }

    /// Returns the memory of a step over `links` with `pixels` values each.
    fn cost(&self, setup: &MeasurementSetup, links: usize, pixels: usize) -> Cost {
        Cost { pixels, ..Cost::default() }
    }

    /// Returns names, shapes and initial values of the weights.
    ///
    /// # Errors
    /// The method does not support the frame: another measurement type, too many receivers, or no subcarriers.
    fn layout(&self, setup: &MeasurementSetup) -> Result<Layout, String>;

    /// Returns the rows of the cloud that can affect observations, for any weights; [`Self::forward`] receives only
    /// these.
    fn drawable(&self, setup: &MeasurementSetup, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        (0..cloud.len()).filter(|&i| gate.is_none_or(|gate| gate[i] != 0.0)).collect()
    }

    /// Returns the observations of the links. `prepared` is the result of [`Self::prepare`] for the same
    /// parameters, or `None`; both give bit-identical results.
    fn forward(&self, call: &Call<'_>, prepared: &Cache) -> ForwardOutput;

    /// Adds to `sums`, given the cotangents `d` of [`ForwardOutput::numbers`].
    fn vjp(&self, call: &Call<'_>, observed: ForwardOutput, d: &[Real], sums: &mut MethodVjp);

    /// Returns statistics of each Gaussian's effect on the observations, with measured values `truths` `[L, numbers]`.
    fn survey(&self, call: &Call<'_>, truths: &[Real], needs: &Needs) -> PassStatistics {
        PassStatistics::zeros(needs, call.parameters.cloud.len())
    }

    /// Precomputes transmitter-independent values for many predictions.
    fn prepare(&self, setup: &MeasurementSetup, parameters: &Parameters<'_>) -> Cache {
        None
    }

    /// Returns [`ForwardOutput::numbers`] of [`Self::forward`], bit-identical, from the result of [`Self::prepare`] for the
    /// same parameters; also returns the time of each stage.
    fn predict(&self, call: &Call<'_>, prepared: &Cache) -> (Vec<Real>, StageTimes) {
        let start = std::time::Instant::now();
        let numbers = self.forward(call, prepared).numbers;
        (numbers, StageTimes { total: start.elapsed().as_secs_f64(), ..StageTimes::default() })
    }

    /// Initialises the parameters that depend on the training links `train` of `data`, such as the offsets of
    /// receivers.
    fn start(
        &self,
        setup: &MeasurementSetup,
        data: &Dataset,
        train: &[usize],
        cloud: &mut GaussianCloud,
        weights: &mut [Real],
    ) {
    }

    /// Returns the Gaussians as drawn for a transmitter at `tx` (metres from the origin), or without transmitter; none
    /// by default.
    fn gaussians(&self, setup: &MeasurementSetup, parameters: &Parameters<'_>, tx: Option<[Real; 3]>) -> Activated {
        Activated::default()
    }

    /// Rejects invalid settings when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Method);

/// Outputs and supported features of a [`Method`].
#[derive(Clone, Debug)]
#[allow(clippy::struct_excessive_bools)] // independent properties
pub struct MethodTraits<'a> {
    /// Measurement type, if it does not depend on the frame.
    pub task: Option<Task>,
    /// Number of inputs per transmitter: 3 for its position.
    pub inputs: usize,
    /// Appearance of its Gaussians in a 3D view.
    pub appearance: Appearance,
    /// Projector of its spectra, which determines their [plane](ImagePlane); the plane of the data if `None`.
    pub projector: Option<&'a Plugin<dyn Projector>>,
    /// Deformation of its Gaussians by the transmitter.
    pub deformation: Option<&'a Plugin<dyn Deformation>>,
    /// Further columns of the cloud that it reads, by name and width. Their initial value is zero; they are learned at
    /// the rate of `signals` and saved with the model.
    pub columns: Vec<(&'static str, usize)>,
    /// Whether it supports selected [pixels](Call::pixels).
    pub supports_pixel_subset: bool,
    /// Whether it supports [`Parameters::existence`]; if not, such gates are multiplied into the other gate.
    pub supports_existence_gate: bool,
    /// Whether it provides statistics that [require blending](crate::Statistic::requires_blending).
    pub blends: bool,
    /// Whether its spectra are scaled from 0 to 1 over the drawn pixels, so that the sampled pixels of a measured
    /// spectrum must be scaled in the same way.
    pub stretches: bool,
    /// Whether [`Method::vjp`] supports the derivative by the [positions](MethodVjp::positions).
    pub differentiates_positions: bool,
    /// Whether [`Method::vjp`] supports the derivative by the [orientations](MethodVjp::orientations).
    pub differentiates_orientations: bool,
}

impl MethodTraits<'_> {
    /// Returns whether the method has Gaussians. If not, there is no initialiser and no pruning, and clouds are empty.
    pub fn has_gaussians(&self) -> bool {
        self.appearance != Appearance::Nothing
    }
}

impl Default for MethodTraits<'_> {
    /// Returns the properties of a method that reads positions and whose Gaussians are points.
    fn default() -> Self {
        Self {
            task: None,
            inputs: 3,
            appearance: Appearance::Points,
            projector: None,
            deformation: None,
            columns: Vec::new(),
            supports_pixel_subset: false,
            supports_existence_gate: false,
            blends: false,
            stretches: false,
            differentiates_positions: false,
            differentiates_orientations: false,
        }
    }
}

/// Appearance of a model in a 3D view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Appearance {
    /// Gaussians as ellipsoids, with scales, rotations and opacities.
    Ellipsoids,
    /// Points without a size: sources of waves.
    Points,
    /// Empty, because there are no Gaussians.
    Nothing,
}

/// Gaussians as drawn.
#[derive(Clone, Debug, Default)]
pub struct Activated {
    /// Gaussians in space.
    pub primitives: Primitives,
    /// Signals `[N, channels]`.
    pub signals: Vec<Real>,
    /// Pixel value that each Gaussian would give alone if it were opaque, `[N]`; `None` if signals exist only for a
    /// given transmitter.
    pub strengths: Option<Vec<Real>>,
}

/// Memory of a training step, in addition to that of the Gaussians and weights of every method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cost {
    /// Number of stored values per Gaussian.
    pub per_gaussian: usize,
    /// Number of stored values per Gaussian and transmitter, up to [`KEPT_BYTES`](crate::KEPT_BYTES).
    pub per_term: usize,
    /// Number of drawn values per link.
    pub pixels: usize,
    /// Memory for the backward pass that does not depend on the Gaussians, bytes.
    pub bytes: u64,
    /// Maximum number of links with [a pixel each](PixelSubset::Each) per call, so that the backward pass fits in memory.
    /// Larger steps are split.
    pub links_at_once: usize,
}

impl Default for Cost {
    fn default() -> Self {
        Self { per_gaussian: 0, per_term: 0, pixels: 0, bytes: 0, links_at_once: usize::MAX }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[should_panic(expected = "receiver 1 of 1")]
    fn receiver_out_of_range_is_not_replaced_by_another() {
        let setup = MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, ImagePlane::plain(1, 1));
        setup.inputs(3, std::iter::once(Query::at([0.0; 3], 1)));
    }

    #[test]
    fn moving_receiver_has_a_pose_in_links_with_features_too() {
        let plane = ImagePlane::plain(1, 1);
        let fixed = MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, plane);
        let setup = MeasurementSetup { moving: End::Receiver, ..fixed };
        for features in [None, Some(&[0.5, 1.0, 2.0][..])] {
            let links = setup.inputs(3, std::iter::once(Query { features, ..Query::at([1.0; 3], 0) }));
            let pose = Pose { position: [1.0; 3], ..Pose::IDENTITY };
            assert_eq!(links.receivers, [ReceiverState { receiver: 0, pose }]);
            assert_eq!(links.pairs, [Link { location: 0, receiver: 0 }]);
        }
    }
}
