//! `Method`: the one seam between training and what is trained. From parameters and links to observations, and back.

use crate::{
    Cache, CloudStats, Conditions, Dataset, Deformation, Elevation, GaussianCloud, ImagePlane, Layout, Link, Needs,
    Origin, Plugin, Pose, Primitives, Projector, Query, Real, Receiver, StageTimes, Statistics, Task, plugin_kind,
};

/// Where observations are made, and what they are: all of a data set that a trained model has to know.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The place in the user's frame that everything here counts from.
    pub origin: Origin,
    /// Who listens, from the origin.
    pub receivers: Vec<Receiver>,
    /// What is observed.
    pub task: Task,
    /// The numbers of one observation: of a spectrum, its picture.
    pub plane: ImagePlane,
    /// Subcarriers of a channel, Hz; empty for anything else.
    pub frequencies_hz: Vec<f64>,
}

impl Frame {
    /// That of `data`, drawn on `plane`.
    pub fn of(data: &Dataset, plane: ImagePlane) -> Self {
        let frequencies_hz = data.observations.frequencies_hz().to_vec();
        let (origin, receivers) = (data.scene.origin, data.scene.receivers.clone());
        Self { origin, receivers, task: data.task(), plane, frequencies_hz }
    }

    /// Of spectra that one receiver sees.
    pub fn spectra(origin: Origin, pose: Pose, plane: ImagePlane) -> Self {
        let receivers = vec![Receiver::new("receiver", pose)];
        Self { origin, receivers, task: Task::default(), plane, frequencies_hz: Vec::new() }
    }

    /// Numbers of one observation.
    pub fn numbers(&self) -> usize {
        self.plane.width * self.plane.height
    }

    /// The first receiver's pose, from the origin.
    pub fn pose(&self) -> Pose {
        self.receivers.first().map_or(Pose::IDENTITY, |receiver| receiver.pose)
    }

    /// The first receiver's pose in the user's frame.
    pub fn receiver(&self) -> Pose {
        self.origin.world_pose(self.pose())
    }

    /// The elevations that rows of a spectrum are.
    pub fn elevation(&self) -> Elevation {
        self.plane.elevation().unwrap_or(Elevation::UPPER)
    }

    /// Conditions `[T, inputs]` of the transmitters of these links, and the links. Equal transmitters that follow one another are
    /// one.
    pub fn conditions<'q>(&self, inputs: usize, queries: impl Iterator<Item = Query<'q>>) -> (Vec<Real>, Vec<Link>) {
        let mut conditions: Vec<Real> = Vec::new();
        let mut links: Vec<Link> = Vec::with_capacity(queries.size_hint().0);
        let mut last: Option<Query<'_>> = None;
        for query in queries {
            if last.is_none_or(|last| (last.tx, last.features) != (query.tx, query.features)) {
                if query.features.is_empty() {
                    conditions.extend(self.origin.local(query.tx));
                } else {
                    conditions.extend_from_slice(query.features);
                }
            }
            let transmitter = conditions.len() / inputs.max(1) - 1;
            links.push(Link { transmitter, receiver: query.receiver.min(self.receivers.len() - 1) });
            last = Some(query);
        }
        (conditions, links)
    }
}

/// What is learned, as a method reads it.
#[derive(Clone, Copy, Debug)]
pub struct Parameters<'a> {
    /// The Gaussians; a method may have none.
    pub cloud: &'a GaussianCloud,
    /// What pruners multiply each Gaussian by, opacity and scale alike, `[N]`; `None`: all open.
    pub gate: Option<&'a [Real]>,
    /// What they multiply its part in the picture by, and nothing else, `[N]`; `None` without such a gate, and for a method
    /// that does not [know](MethodTraits::knows_presence) the difference.
    pub presence: Option<&'a [Real]>,
    /// Everything else, as [`Method::layout`] names it.
    pub weights: &'a [Real],
}

/// Links whose observations are wanted.
#[derive(Clone, Copy, Debug)]
pub struct Asked<'a> {
    /// Of each transmitter.
    pub conditions: Conditions<'a>,
    /// Rows of `conditions` and receivers of the frame. Links of a transmitter are next to each other.
    pub links: &'a [Link],
    /// Which numbers of each observation; a method that does not [choose](MethodTraits::chooses_pixels) is asked for all.
    pub pixels: Pixels<'a>,
}

/// Which numbers of an observation are wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pixels<'a> {
    /// All of them.
    #[default]
    All,
    /// The same of every link: places in an observation.
    Same(&'a [usize]),
    /// One of each link: `[L]` places.
    Own(&'a [usize]),
}

impl Pixels<'_> {
    /// How many of a link, of `numbers` that an observation has.
    pub fn of_link(&self, numbers: usize) -> usize {
        match self {
            Self::All => numbers,
            Self::Same(places) => places.len(),
            Self::Own(_) => 1,
        }
    }
}

/// Observations, and what the way back needs.
#[derive(Debug)]
pub struct Observed {
    /// `[L, numbers]`, an observation a link, or what [`Asked::pixels`] wants of it.
    pub numbers: Vec<Real>,
    /// Whatever the method wants to find again in [`Method::vjp`].
    pub cache: Cache,
}

/// Derivatives in everything that is learned, and what was seen of each Gaussian.
#[derive(Clone, Debug)]
pub struct MethodVjp {
    /// In the columns of the cloud; those that pruners asked for stay 0.
    pub cloud: GaussianCloud,
    /// In the gate, `[N]`.
    pub gate: Vec<Real>,
    /// In the presence, `[N]`.
    pub presence: Vec<Real>,
    /// In the weights.
    pub weights: Vec<Real>,
    /// For pruners and densification; zeros where a method draws no splats.
    pub seen: CloudStats,
}

impl MethodVjp {
    /// Zeros for parameters of this size.
    pub fn zeros(parameters: &Parameters<'_>) -> Self {
        let n = parameters.cloud.len();
        Self {
            cloud: parameters.cloud.zeros_like(),
            gate: vec![0.0; n],
            presence: vec![0.0; n],
            weights: vec![0.0; parameters.weights.len()],
            seen: CloudStats::zeros(n),
        }
    }
}

/// A way from parameters to observations. Parameters are the columns of a [`GaussianCloud`], which pruners and densification
/// change, and a flat vector of weights with names; settings live in the plugin. Trainer, checkpoint, evaluation and model
/// file know no more of a model than this.
#[typetag::serde]
pub trait Method:
    erased_serde::Serialize + crate::docs::Documented + std::any::Any + std::fmt::Debug + Send + Sync
{
    /// What does not depend on the frame.
    fn traits(&self) -> MethodTraits<'_> {
        MethodTraits::default()
    }

    /// Memory that a step over `links`, and `pixels` numbers of each, takes.
    fn cost(&self, frame: &Frame, links: usize, pixels: usize) -> Cost {
        let _ = (frame, links);
        Cost { pixels, ..Cost::default() }
    }

    /// Names, shapes and initial values of the weights.
    ///
    /// # Errors
    /// Why it cannot serve the frame: another task, receivers too many, no subcarriers.
    fn layout(&self, frame: &Frame) -> Result<Layout, String>;

    /// The rows of the cloud that can count, whatever the weights say; [`Self::forward`] gets these alone.
    fn drawable(&self, frame: &Frame, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        let _ = frame;
        (0..cloud.len()).filter(|&i| gate.is_none_or(|gate| gate[i] != 0.0)).collect()
    }

    /// Observations of the links asked for.
    fn forward(&self, frame: &Frame, parameters: &Parameters<'_>, asked: &Asked<'_>) -> Observed;

    /// Adds to `sums`, given the cotangents `d` of [`Observed::numbers`].
    fn vjp(
        &self,
        frame: &Frame,
        parameters: &Parameters<'_>,
        asked: &Asked<'_>,
        observed: Observed,
        d: &[Real],
        sums: &mut MethodVjp,
    );

    /// What each of its Gaussians has to do with the observations asked for, whose true values are `truths`
    /// `[L, numbers]`.
    fn survey(
        &self,
        frame: &Frame,
        parameters: &Parameters<'_>,
        asked: &Asked<'_>,
        truths: &[Real],
        needs: &Needs,
    ) -> Statistics {
        let _ = (frame, asked, truths);
        Statistics::zeros(needs, parameters.cloud.len())
    }

    /// What no transmitter changes, worked out once for many predictions.
    fn prepare(&self, frame: &Frame, parameters: &Parameters<'_>) -> Cache {
        let _ = (frame, parameters);
        None
    }

    /// [`Observed::numbers`] of [`Self::forward`], bit for bit, given what [`Self::prepare`] made of the same parameters,
    /// and how long each stage took.
    fn predict(
        &self,
        frame: &Frame,
        parameters: &Parameters<'_>,
        asked: &Asked<'_>,
        prepared: &Cache,
    ) -> (Vec<Real>, StageTimes) {
        let _ = prepared;
        let start = std::time::Instant::now();
        let numbers = self.forward(frame, parameters, asked).numbers;
        (numbers, StageTimes { total: start.elapsed().as_secs_f64(), ..StageTimes::default() })
    }

    /// Sets what can be told from the links `train` of `data` before the first step, such as the receivers' offsets.
    fn start(&self, frame: &Frame, data: &Dataset, train: &[usize], cloud: &mut GaussianCloud, weights: &mut [Real]) {
        let _ = (frame, data, train, cloud, weights);
    }

    /// The Gaussians as they are drawn for a transmitter at `tx` (metres from the origin), or without any; none by default.
    fn gaussians(&self, frame: &Frame, parameters: &Parameters<'_>, tx: Option<[Real; 3]>) -> Activated {
        let _ = (frame, parameters, tx);
        Activated::default()
    }

    /// Refuses settings that cannot work, when the pipeline is read.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Method);

/// What a [`Method`] gives, and what it can be asked for.
#[derive(Clone, Debug)]
#[allow(clippy::struct_excessive_bools)] // independent properties
pub struct MethodTraits<'a> {
    /// What it gives, where that does not depend on the frame.
    pub task: Option<Task>,
    /// Numbers that it reads of a transmitter: 3 for its position.
    pub inputs: usize,
    /// What its parameters look like in a room.
    pub appearance: Appearance,
    /// What draws its spectra and so gives them their [plane](ImagePlane); the plane of the data by default.
    pub projector: Option<&'a Plugin<dyn Projector>>,
    /// What changes its Gaussians with the transmitter.
    pub deformation: Option<&'a Plugin<dyn Deformation>>,
    /// More columns of the cloud that it reads, by name and width: zero until something sets them, learned at the rate of
    /// `signals`, and saved with the model.
    pub columns: Vec<(&'static str, usize)>,
    /// Whether it can be asked for some [pixels](Asked::pixels) alone.
    pub chooses_pixels: bool,
    /// Whether it reads [`Parameters::presence`]; if not, such gates are multiplied into the other.
    pub knows_presence: bool,
    /// Whether it can tell what [wants blending](crate::Statistic::wants_blending) of its Gaussians.
    pub blends: bool,
    /// Whether its spectra reach from 0 to 1 over the pixels that are drawn, so that a part of a measured spectrum has to be
    /// stretched over these alone.
    pub stretches: bool,
}

impl MethodTraits<'_> {
    /// Whether there are Gaussians. If not, there is no initializer, nothing is pruned, and clouds are empty.
    pub fn has_gaussians(&self) -> bool {
        self.appearance != Appearance::Nothing
    }
}

impl Default for MethodTraits<'_> {
    /// Those of a method that reads positions and whose Gaussians are points.
    fn default() -> Self {
        Self {
            task: None,
            inputs: 3,
            appearance: Appearance::Points,
            projector: None,
            deformation: None,
            columns: Vec::new(),
            chooses_pixels: false,
            knows_presence: false,
            blends: false,
            stretches: false,
        }
    }
}

/// What a model looks like in a room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Appearance {
    /// Gaussians as ellipsoids, with scales, rotations and opacities.
    Ellipsoids,
    /// Places without a size: sources of waves.
    Points,
    /// Nothing, because there are no Gaussians.
    Nothing,
}

/// Gaussians as they are drawn.
#[derive(Clone, Debug, Default)]
pub struct Activated {
    /// In space.
    pub primitives: Primitives,
    /// Signals `[N, channels]`.
    pub signals: Vec<Real>,
    /// The grey value that each would give alone, were it opaque, `[N]`; `None` where signals exist for a transmitter only.
    pub strengths: Option<Vec<Real>>,
}

/// Memory of a training step, beside what every method takes for its Gaussians and weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cost {
    /// Numbers kept of each Gaussian.
    pub per_gaussian: usize,
    /// Numbers drawn for each link.
    pub pixels: usize,
    /// Bytes kept for the way back that do not go with the Gaussians.
    pub bytes: u64,
    /// How many links of [a pixel each](Pixels::Own) it had better be asked for at a time: what it keeps for the way back
    /// then fits in memory. A step of more is taken in parts.
    pub links_at_once: usize,
}

impl Default for Cost {
    fn default() -> Self {
        Self { per_gaussian: 0, pixels: 0, bytes: 0, links_at_once: usize::MAX }
    }
}
