//! `Misfit`: the messages on plugins, settings and data that do not fit together. [`check_compatible`](crate::check_compatible)
//! finds the first.

use crate::{Elevation, Error, Task};

/// Property of data, or of the method, that a plugin requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Requirement {
    /// Positions of the transmitters.
    #[error("transmitter positions, but the data have none; leave it out, or use another")]
    Positions,
    /// Positions or features of the transmitters.
    #[error("positions or features of the transmitters, but the data have neither; leave it out")]
    Inputs,
    /// Features of the links.
    #[error("link features, but the data have none; use Kriging()")]
    Features,
    /// No features in place of the positions.
    #[error("transmitter positions, but the data have features in their place; use NearestNeighbours()")]
    NoFeatures,
    /// Several carriers of one array.
    #[error("several carriers, but the data have one; use NearestNeighbours(k: 1)")]
    Carriers,
    /// One carrier.
    #[error("one carrier, but these data have several; use Splatting()")]
    OneCarrier,
    /// One receiver, or the carriers of one array.
    #[error("one receiver, but the data have several; train one model per receiver")]
    OneArray,
    /// One antenna per receiver of channels.
    #[error("one antenna per receiver, but a receiver has more; make each a receiver, as Nerf2Csi(together: false)")]
    OneAntenna,
    /// Position of the end that does not move.
    #[error("the position of the fixed end of the links, which is unknown; state it, or leave it out")]
    Distances,
    /// One antenna at the centre of a moving receiver.
    #[error("one antenna at the centre of a receiver that moves; use method: SplattedChannel()")]
    CentredAntenna,
    /// Fixed receivers.
    #[error("a fixed receiver, but that of these data moves; use Splatting()")]
    FixedReceiver,
    /// Directions of the pixels of spectra.
    #[error("the directions of pixels, which these data do not contain; use Splatting()")]
    Directions,
    /// The method of this name.
    #[error("the method {0}; add `method: {0}()`")]
    Method(&'static str),
}

/// Demands of a plugin on the other parts.
#[derive(Clone, Copy, Debug)]
pub struct Demand {
    /// Field of the pipeline.
    pub field: &'static str,
    /// Name of the plugin.
    pub plugin: &'static str,
    /// Measurement types that it supports.
    pub tasks: &'static [Task],
    /// Further requirements.
    pub requires: &'static [Requirement],
}

/// Difference between a trained model and data: the value of the model, then that of the data.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SetupDifference {
    /// Task.
    #[error("the model predicts {}, but the data are {}", .0.plural, .1.plural)]
    Task(Task, Task),
    /// Whether the receiver moves.
    #[error("the receiver of the model or of the data moves, and that of the other is fixed")]
    Moves,
    /// Task, and the size of an observation.
    #[error("the model predicts {} of {}, but the data have {}", .0.plural, .1, .2)]
    Size(Task, String, String),
    /// Camera.
    #[error("the cameras of the model and of the data differ")]
    Camera,
    /// Elevations of the rows of a spectrum, degrees.
    #[error(
        "the model draws elevations of {} to {} degrees and the spectra of the data are of {} to {}",
        .0.first, .0.last, .1.first, .1.last
    )]
    Elevations(Elevation, Elevation),
    /// Number of receivers.
    #[error("the model has {0} receivers, but the data have {1}")]
    Receivers(usize, usize),
    /// Carrier of a receiver, Hz.
    #[error("a carrier of the model is {0} Hz, but {1} Hz in the data")]
    Carrier(f64, f64),
    /// Name of a receiver.
    #[error("receiver `{0}` of the model is called `{1}` in the data")]
    Name(String, String),
    /// First subcarrier that differs, Hz.
    #[error("a subcarrier of the model is at {0} Hz, but at {1} Hz in the data")]
    Frequency(f64, f64),
}

/// Reason why plugins, settings and data do not fit together. The message begins with the object, which is a field of
/// the pipeline if one can be changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Misfit {
    /// Field of the method, its task, and that of the data.
    #[error("{}: it predicts {}, but the data are {}; use {}", .0, .1.plural, .2.plural, .2.method)]
    MethodTask(&'static str, Task, Task),
    /// Field and name of a plugin that does not support the task of the data.
    #[error("{}: `{}` does not support {}; use another", .0, .1, .2.plural)]
    PluginTask(&'static str, &'static str, Task),
    /// Field and name of a plugin, and its requirement that is not met.
    #[error("{0}: `{1}` needs {2}")]
    Unmet(&'static str, &'static str, Requirement),
    /// Field with a value that the method of these data ignores.
    #[error("{}: the method of {} does not use it; remove it", .0, .1.plural)]
    Unused(&'static str, Task),

    /// Pruner that is listed again: its settings would have no effect.
    #[error("pruners: `{0}` is listed twice; list it once")]
    ListedTwice(String),
    /// Method without Gaussians.
    #[error("pruners: {0} has no Gaussians to prune; remove the pruners")]
    NothingToPrune(&'static str),
    /// Pruner, and the advice for a rasterizer if the method has one.
    #[error("pruners: `{0}` needs blending weights, but this method does not blend; use {1}LearnableMask()")]
    NeedsBlending(String, &'static str),
    /// Pruner by errors of pixels.
    #[error("pruners: `{0}` needs errors of pixels, but these data have no pixels; remove it")]
    NeedsPixels(String),
    /// Target without a pruner that supports one.
    #[error(
        "pruners: training.target_count is {0}, but no pruner supports a target; add SignalContribution(), or in Python give a pruner `score` and no `keep`"
    )]
    TargetUnsupported(usize),
    /// Pruner that requires a target.
    #[error("pruners: `{0}` needs training.target_count, which is not set; set it, for example to 157")]
    TargetMissing(String),
    /// Pruner with the target, and a later one that requires it.
    #[error("pruners: training.target_count applies to `{0}`, so `{1}` removes none; list `{1}` first, or remove it")]
    TargetTaken(String, String),
    /// Pruner and target, without a prune step that could reach it.
    #[error(
        "pruners: `{0}` has a target of {1}, but no prune step; set training.prune_until above densify_until, or a larger scale"
    )]
    NoPruneStep(String, usize),
    /// Target above the initial number of Gaussians.
    #[error("pruners: training.target_count is {0}, but training starts with {1} Gaussians; lower it or add some")]
    TargetAboveStart(usize, usize),

    /// Selected pixels, and data without pixels or a method that renders whole images.
    #[error("training: `rays` needs spectra and a method that renders single pixels, such as Nerf2; remove it")]
    SelectedPixels,
    /// Number of selected pixels and of trained pixels.
    #[error("training: `rays` is {0}; give at most {1}")]
    TooManyPixels(usize, usize),
    /// Stride, columns, rows, and the strides that divide both.
    #[error("training.stride {0} does not divide {1} columns and {2} rows of the spectra; use one of {3}")]
    Stride(usize, usize, usize, String),

    /// Readout of one channel, and a rasterizer that adds waves.
    #[error("readout: this rasterizer adds waves, and Real takes one channel of each; use MinMax, Magnitude or Power")]
    HalfWaves,
    /// Conversion to colours, and data without pixels or a rasterizer that adds waves.
    #[error("calibration: AsReleased converts signals to colours, and only blends spectra; use Physical")]
    Colours,
    /// Projector of a part of the sky, and a received power.
    #[error("readout: ReceivedPower needs the whole sky, which the projector does not draw; use projector: Mercator()")]
    PartOfSky,
    /// Rasterizer of directions, and pixels that have none.
    #[error("rasterizer: ArrayResponse needs the direction of every pixel; use projector: Mercator()")]
    PixelsWithoutDirection,
    /// Tiles that end at the seam of a full circle.
    #[error("rasterizer: support: TileSquares cannot draw across the seam; use support: Exact, or WrfgsCompat()")]
    TilesAtSeam,
    /// Tiles of a strided image.
    #[error("rasterizer: TileSquares draws whole tiles; use support: Exact, or training.stride: 1")]
    TilesOfStride,
    /// Rasterizer of one wavelength, and several carriers.
    #[error("rasterizer: Spherical has one wavelength, but the data have several; use wavefront: Plane")]
    OneWavelength,
    /// Number of carriers, which the deformation ignores.
    #[error(
        "the data have {0} carriers, but the deformation ignores them; use Factored(carrier: 2) or Mlp(carrier: 2)"
    )]
    CarriersIgnored(usize),
    /// Deformation that depends on the position of one receiver, and the receivers in words.
    #[error("the deformation depends on the receiver position, but {0}; use Factored() or Mlp()")]
    ReceiverRead(String),
    /// Projector of fixed directions, and a receiver that moves.
    #[error("the receiver moves, but the projector has a fixed centre; use projector: Mercator()")]
    FixedCentre,
    /// Upper and lower elevation of spectra, degrees.
    #[error("the projector does not support the elevations of these spectra, {0} to {1} degrees; use Mercator()")]
    Elevations(f64, f64),
    /// Projector of angles, and images of a camera.
    #[error("the projector draws angles, but the data are images of a camera; use projector: Pinhole()")]
    CameraImages,
    /// Projector of a camera, and spectra over angles.
    #[error("the projector draws images of a camera, but the data have no camera; use projector: Mercator()")]
    NoCamera,
    /// Image plane, such as that of a file, which the projector does not have.
    #[error("plane: the projector does not support its angles")]
    Plane,
    /// Width and height of an observation that differ from subcarriers and antennas.
    #[error("plane: {} x {} numbers do not match a {}", .0, .1, .2.singular)]
    Numbers(usize, usize, Task),

    /// Data without positions and features.
    #[error("the data have neither positions nor features of the transmitters")]
    NoInputs,
    /// Features that could be a position.
    #[error("3 features are ambiguous with a 3D position; provide a different number of features, or positions")]
    ThreeFeatures,
    /// Inputs of the method and of the data, and advice.
    #[error("the method needs {0} per transmitter, but the data have {1}; {2}")]
    Inputs(String, String, String),

    /// Difference between a trained model and data.
    #[error("{0}; use data of the same kind as the training data")]
    OtherData(SetupDifference),
    /// Initial model with another origin.
    #[error("the model has another origin than the data; give a model trained on these data")]
    OtherOrigin,
    /// Initial model of another method, or of other receivers.
    #[error(
        "its method or its receivers are others than those of the pipeline; copy projector, rasterizer, deformation, \
         calibration and readout from the run that made it"
    )]
    OtherMethod,
    /// Message of a plugin.
    #[error("{0}")]
    Plugin(String),
}

impl Demand {
    /// Creates the demands of a plugin that supports every task.
    pub fn of(field: &'static str, plugin: &'static str, requires: &'static [Requirement]) -> Self {
        Self { field, plugin, tasks: &Task::ALL, requires }
    }
}

impl Misfit {
    /// Returns [`Error::Config`] with this message.
    pub fn error(self) -> Error {
        Error::Config(self.to_string())
    }

    /// Returns the start of the message up to `:` or `.`: the field of the pipeline to change, if it names one.
    pub fn field(&self) -> String {
        self.to_string().split([':', '.']).next().unwrap_or_default().to_owned()
    }
}
