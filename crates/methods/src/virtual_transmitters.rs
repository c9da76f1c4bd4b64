//! Gaussians as virtual transmitters that are coherent over the room: field, derivative, gains, search and refinement.

mod cis;
mod equations;
mod field;
mod grid;
mod harmonics;
mod links;
mod pursuit;
mod solve;
mod sweep;
mod turn;
mod windows;

pub use field::{FieldVjp, field, field_vjp};
pub use harmonics::HARMONICS;
pub use links::{ChannelInputs, VirtualSources, snr_db};
pub(crate) use pursuit::expected_pursuit_seconds;
pub use pursuit::{PursuitOptions, pursue_sources};

use crate::groups::ReceiverGroup;
use crate::readout::magnitudes;
use crate::{Activation, Calibration};
use harmonics::{HIGHEST, harmonic_count};
use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{
    Activated, Cache, Call, Deltas, Error, ForwardOutput, GaussianCloud, ImagePlane, Initializer, InitializerInput,
    JsonSchema, Layout, LinkInputs, MeasurementSetup, Method, MethodTraits, MethodVjp, Misfit, Parameters, Parts, Pose,
    Real, Receiver, Requirement, Result, Scene, Task, check_compatible, gains_of, rows_of,
};
use serde::{Deserialize, Serialize};
use std::sync::atomic::Ordering;

/// Channels as sums of spherical waves from virtual transmitters: `h(p) = Σ s·exp(−j k d)/d`, eq. (1) of the paper in
/// space, coherent over the whole room.
///
/// By reciprocity, fixed and moving node change roles: each Gaussian is the fixed node (the receiver of the data), a
/// mirror image of it, or a scatterer. Its mean is its position, its signal a complex gain, and its quaternion rotates
/// the array (the mirror image of a planar array is a rotated one). Every subcarrier has its own wavenumber, so that
/// delays are modelled without further parameters. Scales and opacities are ignored and there is no network; projector,
/// rasterizer, deformation, calibration and readout are ignored too. The basin of attraction of a position is a quarter of
/// a wavelength wide, so start from `MatchingPursuit`. A rate of `means` above a hundredth of the wavelength leaves it
/// again.
///
/// The method supports one receiver with any number of antennas. It is exact for flat walls that reflect equally in all
/// directions if nothing occludes an image. Real walls, antennas and obstacles deviate from this. With an `order`, the
/// gain is a sum of spherical harmonics of the direction from the virtual transmitter. This adds (order + 1)² complex
/// numbers per Gaussian; provide about ten measured numbers per unknown.
///
/// ```
/// # use pwrfgs_core::{Method, Plugin};
/// # use pwrfgs_methods as _;
/// let method = Plugin::<dyn Method>::parse("VirtualTransmitters(order: 2)").unwrap();
/// assert_eq!(method.traits().columns, [("harmonics", 16)]);
/// assert!(Plugin::<dyn Method>::parse("VirtualTransmitters(order: 4)").is_err());
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VirtualTransmitters {
    /// Order of the spherical harmonics of a gain over direction, at most 3; 0 for a constant gain.
    pub order: usize,
}

/// Returns the order of the spherical harmonics whose gains are among the extra `columns` (name, width); 0 without such a
/// column.
pub(crate) fn harmonics_order(columns: &[(&str, usize)]) -> usize {
    let width = columns.iter().find(|(name, _)| *name == HARMONICS).map_or(0, |(_, width)| *width);
    (0..HIGHEST).find(|order| 2 * (harmonic_count(*order) - 1) >= width).unwrap_or(HIGHEST)
}

/// Returns the antenna positions of a receiver relative to its position, world axes, metres.
fn antenna_positions(receiver: &Receiver, pose: Pose) -> Vec<[Real; 3]> {
    receiver.antennas.iter().map(|antenna| pose.turned(*antenna).map(|x| x as Real)).collect()
}

/// Groups the links by carrier, each of which is a receiver of the setup. Returns each group with the positions `[L, 3]` of the
/// moving node, metres from the origin.
fn carrier_groups(links: &LinkInputs) -> Vec<(ReceiverGroup, Vec<[Real; 3]>)> {
    let txs = links.conditions().positions();
    let position = |i: &usize| txs.get(links.pairs[*i].location).copied();
    let with_positions = |group: ReceiverGroup| {
        let positions = group.links.iter().filter_map(position).collect();
        (group, positions)
    };
    ReceiverGroup::from_links(links, true).into_iter().map(with_positions).collect()
}

#[typetag::serde]
impl Method for VirtualTransmitters {
    fn traits(&self) -> MethodTraits<'_> {
        let more = 2 * (harmonic_count(self.order.min(HIGHEST)) - 1);
        let columns = if more == 0 { Vec::new() } else { vec![(HARMONICS, more)] };
        let (task, requires) = (Some(Task::Channel), &[Requirement::OneArray]);
        MethodTraits { task, columns, requires, differentiates_positions: true, ..MethodTraits::default() }
    }

    /// Returns the cloud, which does not depend on the transmitter.
    fn gaussians(&self, _: &MeasurementSetup, p: &Parameters<'_>, _: Option<[Real; 3]>) -> Activated {
        let (none, calibration) = (Deltas::default(), Calibration::AsReleased); // without a lower limit of the scales
        let activation = Activation { calibration, replaces_signals: false, channels: 2 };
        let signals = &p.cloud.signals;
        Activated {
            primitives: activation.geometry(p.cloud, &none, 0, None),
            signals: signals.as_flattened().to_vec(),
            strengths: Some(magnitudes(signals.as_flattened())),
        }
    }

    fn check(&self) -> Result<(), String> {
        if self.order > HIGHEST {
            return Err(format!("`order` is {}; give 0 to {HIGHEST}, such as 2", self.order));
        }
        Ok(())
    }

    fn forward(&self, call: &Call<'_>, _: &Cache) -> ForwardOutput {
        let Call { setup, parameters: p, links, .. } = *call;
        let mut numbers = vec![0.0; links.pairs.len() * setup.value_count()];
        for (group, positions) in carrier_groups(links) {
            let antennas = antenna_positions(&setup.receivers[0], group.state.pose);
            let frequencies = setup.frequencies_of(group.state.receiver);
            let part = ChannelInputs { positions: &positions, antennas: &antennas, frequencies: &frequencies };
            let channels = rows_of(&field(p.cloud, p.gate, &part), frequencies.len());
            group.scatter_rows(&channels, setup.value_count(), &mut numbers);
        }
        ForwardOutput { numbers, cache: None as Cache }
    }

    fn vjp(&self, call: &Call<'_>, _: ForwardOutput, d: &[Real], sums: &mut MethodVjp) {
        let Call { setup, parameters: p, links, .. } = *call;
        for (group, positions) in carrier_groups(links) {
            let antennas = antenna_positions(&setup.receivers[0], group.state.pose);
            let frequencies = setup.frequencies_of(group.state.receiver);
            let d_gains = gains_of(&group.gather_rows(d, setup.value_count()), frequencies.len());
            // The field depends on distances and directions only: its derivative by a position is that by a common move
            // of all Gaussians the other way, link by link.
            let block = if sums.positions.is_none() { positions.len() } else { 1 };
            let block_gains = block * antennas.len() * frequencies.len();
            let parts = positions.chunks(block.max(1)).zip(d_gains.chunks(block_gains.max(1))).zip(&group.links);
            for ((positions, d), link) in parts {
                let part = ChannelInputs { positions, antennas: &antennas, frequencies: &frequencies };
                let d_field = field_vjp(p.cloud, p.gate, &part, d);
                for ((_, _, sum), (_, _, d)) in sums.cloud.columns_mut().zip(d_field.cloud.columns()) {
                    sum.iter_mut().zip(d).for_each(|(sum, d)| *sum += d);
                }
                sums.gate.iter_mut().zip(&d_field.gate).for_each(|(sum, d)| *sum += d);
                if let Some(d_positions) = &mut sums.positions {
                    let d_position = &mut d_positions[links.pairs[*link].location];
                    d_field.cloud.means.iter().for_each(|d| (0..3).for_each(|k| d_position[k] -= d[k]));
                }
            }
        }
        sums.stats.visible.iter_mut().for_each(|count| *count += 1.0);
        // Contribution of each Gaussian to the channel, averaged over directions, for pruners by blending weight.
        let more = p.cloud.extra(HARMONICS);
        for (i, [x, y]) in p.cloud.signals.iter().enumerate() {
            let more = more.map_or(&[][..], |c| &c.values[i * c.width..(i + 1) * c.width]);
            let square = more.iter().fold(x * x + y * y, |sum, c| sum + c * c);
            sums.stats.weight[i] += p.gate.map_or(1.0, |gate| gate[i]) * square.sqrt();
        }
    }

    fn layout(&self, _: &MeasurementSetup) -> Layout {
        Layout::default()
    }
}

/// Greedy search for the virtual transmitters of the training channels (orthogonal matching pursuit).
///
/// Each step adds the virtual transmitter that explains most of the residual, recomputes all gains by least squares,
/// and refines all positions. Held-out training links select the number. Candidates are the receiver itself, positions
/// of a grid about the transmitters, coarser with distance, and mirror images of the virtual transmitters so far. It
/// uses training data only, and the final fit includes the held-out links. For `method: VirtualTransmitters()`, with
/// gains of its `order`. If only the scene is needed (`pwrfgs check`), it places `most` of them arbitrarily.
///
/// The search of the grid goes from coarse to fine, so that its time grows with the logarithm of the site in
/// wavelengths. The score of a coarse cell is the energy that it explains in windows of neighbouring positions and
/// subcarriers, each with a separate gain. The band of a window resolves ranges, and its antennas resolve directions.
/// Each level divides the best 4,096 cells into eight and doubles the width of the windows; the last level is coherent
/// over all positions, on a subset of the links. No position explains more coherently than in windows, so a cell is
/// skipped only if 4,096 others explain more in windows of the same width. A grid of at most 131,072 cells is
/// searched completely.
///
/// ```
/// # use pwrfgs_core::{Initializer, Plugin};
/// # use pwrfgs_methods as _;
/// assert!(Plugin::<dyn Initializer>::parse("MatchingPursuit(most: 32, reach: 2.0)").is_ok());
/// assert!(Plugin::<dyn Initializer>::parse("MatchingPursuit(step: 2.0)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MatchingPursuit {
    /// Maximum number of virtual transmitters per search.
    pub most: usize,
    /// Extension of the grid beyond the positions of the transmitters in every direction, relative to the longest side
    /// of their bounding box.
    pub reach: f64,
    /// Grid spacing near the transmitter positions, in units of the shortest wavelength; a quarter or less finds every
    /// maximum.
    pub step: f64,
    /// The search stops after this number of additions without a better score on the held-out links.
    pub patience: usize,
    /// One of this number of training links is held out to choose the number of virtual transmitters. With 0 or 1, none
    /// is held out and all `most` are kept.
    pub hold_out: usize,
    /// Number of rounds that remove the least important virtual transmitters and search for replacements.
    pub rounds: usize,
    /// Weight of the ridge penalty on gains, relative to the noise-to-signal ratio estimated by the fit.
    pub ridge: f64,
    /// Whether mirror images of the virtual transmitters so far are candidates.
    pub images: bool,
    /// Number of searches, each with other held-out links. The initial model is their average, with the Gaussians of
    /// all searches. Averaging suppresses spurious sources.
    pub searches: usize,
}

impl Default for MatchingPursuit {
    fn default() -> Self {
        Self {
            most: 64,
            reach: 2.0,
            step: 0.25,
            patience: 8,
            hold_out: 5,
            rounds: 2,
            ridge: 1.0,
            images: true,
            searches: 1,
        }
    }
}

/// Maximum number of virtual transmitters per search, of `patience` and of `rounds`.
const MOST: usize = 1_000;

impl MatchingPursuit {
    /// Returns the largest number of additions and removals of one search.
    pub fn most_changes(&self) -> usize {
        let replaced = self.most_removals();
        let removed = if self.hold_out < 2 { 0 } else { replaced };
        self.most + removed + self.rounds * (replaced + removed)
    }

    /// Returns the largest number of sources that one round removes and the next replaces.
    fn most_removals(&self) -> usize {
        self.most.div_ceil(2)
    }

    /// Returns the training channels at the lowest carrier, which the search reads; an error if data or method do not
    /// fit the search.
    fn training_channels<'a>(&self, input: &InitializerInput<'a>) -> Result<ObservedChannels<'a>> {
        let (data, demands) = (input.data, &[self.demand()]);
        check_compatible(&Parts { data: Some(data), method: Some(input.method), demands, ..Parts::default() })
            .map_err(Misfit::error)?;
        let (channels, scene) = (data.observations.channels().expect("the method predicts channels"), &data.scene);
        // Carriers ascend; the longest wavelength has the fewest local maxima.
        let receiver_of = |i: &usize| input.data.links[*i].receiver;
        let lowest = input.train.iter().map(receiver_of).min().unwrap_or(0);
        let train: Vec<usize> = input.train.iter().copied().filter(|i| receiver_of(i) == lowest).collect();
        Ok(ObservedChannels {
            positions: train.iter().map(|&i| scene.origin.local(input.data.sample(i).position())).collect(),
            antennas: antenna_positions(&scene.receivers[0], scene.pose()),
            frequencies: MeasurementSetup::of(input.data, input.data.plane()).frequencies_of(lowest),
            channel: train.iter().map(|&i| channels.of(i)).collect(),
        })
    }

    /// Returns the options of a search, with the fixed node as a candidate if its position is known, and the harmonics of the
    /// method.
    fn pursuit_options(&self, input: &InitializerInput<'_>, seed: u64) -> PursuitOptions {
        let scene = &input.data.scene;
        let node = scene.has_distances().then(|| scene.pose().position);
        let order = harmonics_order(&input.method.traits().columns);
        PursuitOptions { settings: self.clone(), node, order, seed, ..PursuitOptions::default() }
    }
}

/// Training channels at the lowest carrier.
struct ObservedChannels<'a> {
    positions: Vec<[Real; 3]>,
    antennas: Vec<[Real; 3]>,
    frequencies: Vec<f64>,
    /// Gains `[A,F]` per position, those of the data.
    channel: Vec<&'a [[Real; 2]]>,
}

impl ObservedChannels<'_> {
    /// Returns positions, antennas and subcarriers of the channels.
    fn inputs(&self) -> ChannelInputs<'_> {
        let Self { positions, antennas, frequencies, .. } = self;
        ChannelInputs { positions, antennas, frequencies }
    }
}

#[typetag::serde]
impl Initializer for MatchingPursuit {
    /// Places the Gaussians at random in the bounds of the scene: there are no data to search.
    fn initialize(&self, scene: &Scene, _: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud> {
        let (low, high) = scene.bounds;
        let mut cloud = GaussianCloud::zeros(self.searches * self.most);
        for (mean, signal) in cloud.means.iter_mut().zip(&mut cloud.signals) {
            *mean = std::array::from_fn(|k| low[k] + (high[k] - low[k]) * rng::uniform(rng));
            *signal = [0.1 * rng::normal(rng), 0.1 * rng::normal(rng)];
        }
        cloud.quats.iter_mut().for_each(|quat| *quat = [1.0, 0.0, 0.0, 0.0]);
        Ok(cloud)
    }

    fn search(&self, input: &InitializerInput<'_>, rng: &mut Rng) -> Result<GaussianCloud> {
        let observed = self.training_channels(input)?;
        let mut average = VirtualSources::new(harmonics_order(&input.method.traits().columns));
        // Hundred units per addition or removal, and for the refinement after the last one.
        let total = 100 * (self.searches * self.most_changes() + 1);
        (input.progress)(0, total);
        for search in 0..self.searches {
            let seed = (0..4).fold(0, |seed, _| seed << 16 | rng::below(rng, 1 << 16) as u64); // 64 bits
            let options = self.pursuit_options(input, seed);
            let report_progress = &mut |changes: f64| {
                let done = 100.0 * ((search * self.most_changes()) as f64 + changes);
                (input.progress)(done as usize, total);
            };
            let sources = pursue_sources(&observed.inputs(), &observed.channel, &options, input.stop, report_progress);
            if input.stop.load(Ordering::Relaxed) {
                return Err(Error::Stopped);
            }
            average.extend(sources.map_err(|why| Error::Config(format!("initializer: MatchingPursuit: {why}")))?);
        }
        average.gains.as_flattened_mut().iter_mut().for_each(|x| *x /= self.searches as f64);
        Ok(average.to_cloud())
    }

    fn search_seconds(&self, input: &InitializerInput<'_>) -> Result<[f64; 2]> {
        let observed = self.training_channels(input)?;
        let one = expected_pursuit_seconds(&observed.inputs(), &observed.channel, &self.pursuit_options(input, 0));
        Ok(one.map(|seconds| seconds * self.searches as f64))
    }

    fn tasks(&self) -> &'static [Task] {
        &[Task::Channel]
    }

    fn requires(&self) -> &'static [Requirement] {
        &[Requirement::Method("VirtualTransmitters"), Requirement::Positions, Requirement::CentredAntenna]
    }

    fn check(&self) -> Result<(), String> {
        if !(1..=100).contains(&self.searches) {
            return Err(format!("`searches` is {}; give 1 to 100", self.searches));
        }
        if !(0.0..=100.0).contains(&self.reach) {
            return Err(format!("`reach` is {}; give 0 to 100, such as 2", self.reach));
        }
        if !(0.01..=1.0).contains(&self.step) {
            return Err(format!("`step` is {}; give 0.01 to 1 wavelength, such as 0.25", self.step));
        }
        if !(self.ridge >= 0.0 && self.ridge.is_finite()) {
            return Err(format!("`ridge` is {}; give 0 or more, such as 1", self.ridge));
        }
        if !(1..=MOST).contains(&self.most) {
            return Err(format!("`most` is {}; give 1 to {MOST}, such as 32", self.most));
        }
        if !(1..=MOST).contains(&self.patience) {
            return Err(format!("`patience` is {}; give 1 to {MOST}, such as 8", self.patience));
        }
        if self.rounds > MOST {
            return Err(format!("`rounds` is {}; give 0 to {MOST}, such as 2", self.rounds));
        }
        Ok(())
    }
}
