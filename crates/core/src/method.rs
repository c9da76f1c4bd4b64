//! `Method`: the interface between training and models. It maps parameters and links to observations, with a backward
//! pass.

use crate::{
    Cache, CloudStats, Dataset, Deformation, DeviceStepper, GaussianCloud, ImagePlane, Layout, LinkInputs,
    MeasurementSetup, Misfit, Needs, PassStatistics, Plugin, Primitives, Projector, Rasterizer, Real, Requirement,
    StageTimes, Task, plugin_kind, ssim::Window,
};
use std::borrow::Cow;
use std::sync::Arc;

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

/// Inputs of a method: links and their values to predict from parameters, in a measurement setup.
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
    pub fn count_per_link(&self, numbers: usize) -> usize {
        match self {
            Self::All => numbers,
            Self::Same(indices) => indices.len(),
            Self::Each(_) => 1,
        }
    }
}

/// Loss of spectra against measurements, as data, for a method that computes loss and derivative together.
#[derive(Clone, Copy, Debug)]
pub struct SpectrumLoss<'a> {
    /// Measured spectra `[L, H·W]`.
    pub truths: &'a [Real],
    /// Weight w of 1-SSIM; the mean error of the pixels has weight 1-w.
    pub ssim_weight: Real,
    /// Window of SSIM.
    pub window: Window,
    /// Whether errors are squared; otherwise absolute.
    pub is_squared: bool,
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
    /// Returns properties that do not depend on the measurement setup.
    fn traits(&self) -> MethodTraits<'_> {
        MethodTraits::default()
    }

    /// Runs forward pass, `loss` and backward pass on the device of the process; returns the loss, averaged over links, and its
    /// derivative. `None` if the method cannot: the caller then computes the loss between [`Method::forward`] and
    /// [`Method::vjp`].
    fn loss_vjp(&self, call: &Call<'_>, loss: &SpectrumLoss<'_>) -> Option<(Real, MethodVjp)> {
        None
    }

    /// Returns a stepper, which runs training steps with this `setup` on the device of the process; `None` if the device does not
    /// keep the parameters of this method.
    fn device_stepper<'a>(&'a self, setup: &MeasurementSetup) -> Option<Box<dyn DeviceStepper + 'a>> {
        None
    }

    /// Returns the memory of a step over `links` links with `pixels` values each.
    fn cost(&self, setup: &MeasurementSetup, links: usize, pixels: usize) -> Cost {
        Cost { pixels, ..Cost::default() }
    }

    /// Returns names, shapes and initial values of the weights, for a setup that [`check_compatible`](crate::check_compatible)
    /// accepts.
    fn layout(&self, setup: &MeasurementSetup) -> Layout;

    /// Returns the image plane on which the rasterizer draws: that of the setup, or a sky that is integrated.
    ///
    /// # Errors
    /// The projector does not support such a plane.
    fn plane<'a>(&self, setup: &'a MeasurementSetup) -> Result<Cow<'a, ImagePlane>, Misfit> {
        Ok(Cow::Borrowed(&setup.plane))
    }

    /// Returns the rows of the cloud that can affect observations, for any weights; [`Self::forward`] receives only
    /// these.
    fn drawable(&self, setup: &MeasurementSetup, cloud: &GaussianCloud, gate: Option<&[Real]>) -> Vec<usize> {
        (0..cloud.len()).filter(|&i| gate.is_none_or(|gate| gate[i] != 0.0)).collect()
    }

    /// Returns the observations of the links. `prepared` is the result of [`Self::prepare`] for the same
    /// parameters, or `None`; both give bit-identical results.
    fn forward(&self, call: &Call<'_>, prepared: &Cache) -> ForwardOutput;

    /// Adds the derivatives of the parameters and of the inputs that `sums` has, and the statistics, to `sums`, given the
    /// cotangents `d` of [`ForwardOutput::numbers`]. `observed` is the result of [`Self::forward`] for the same call; the
    /// caller may have taken its numbers.
    fn vjp(&self, call: &Call<'_>, observed: ForwardOutput, d: &[Real], sums: &mut MethodVjp);

    /// Returns statistics of each Gaussian's effect on the observations, with measured values `truths` `[L, numbers]`.
    fn survey(&self, call: &Call<'_>, truths: &[Real], needs: &Needs) -> PassStatistics {
        PassStatistics::zeros(needs, call.parameters.cloud.len())
    }

    /// Precomputes transmitter-independent values for many predictions. `None` without such values.
    fn prepare(&self, setup: &MeasurementSetup, parameters: &Parameters<'_>) -> Cache {
        None
    }

    /// Returns [`ForwardOutput::numbers`] of [`Self::forward`], bit-identical, from the result of [`Self::prepare`] for the
    /// same parameters; also returns the time of each stage, by default the total alone.
    fn predict(&self, call: &Call<'_>, prepared: &Cache) -> (Vec<Real>, StageTimes) {
        let start = std::time::Instant::now();
        let numbers = self.forward(call, prepared).numbers;
        (numbers, StageTimes { total: start.elapsed().as_secs_f64(), ..StageTimes::default() })
    }

    /// Initialises the parameters that depend on the training links `train` of `data`, such as the offsets of
    /// receivers; by default, there are none.
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

    /// Rejects invalid settings when the pipeline is read; the error says what is wrong and what to do.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
plugin_kind!(Method);

/// Outputs and supported features of a [`Method`].
#[derive(Clone, Debug)]
#[allow(clippy::struct_excessive_bools)] // independent properties
pub struct MethodTraits<'a> {
    /// Measurement type; `None` if it depends on the measurement setup.
    pub task: Option<Task>,
    /// Number of inputs per transmitter: 3 for its position.
    pub inputs: usize,
    /// Appearance of its Gaussians in a 3D view.
    pub appearance: Appearance,
    /// Projector of its spectra, which determines their [plane](ImagePlane); the plane of the data if `None`.
    pub projector: Option<&'a Plugin<dyn Projector>>,
    /// Rasterizer of its splats.
    pub rasterizer: Option<&'a Plugin<dyn Rasterizer>>,
    /// Deformation of its Gaussians by the transmitter.
    pub deformation: Option<&'a Plugin<dyn Deformation>>,
    /// Requirements of the data.
    pub requires: &'static [Requirement],
    /// Number of channels per splat.
    pub channels: usize,
    /// Whether it converts signals to colours.
    pub shows_colours: bool,
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
            rasterizer: None,
            deformation: None,
            requires: &[],
            channels: 2,
            shows_colours: false,
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
    /// Whether its network runs on a GPU, in programs that support one.
    pub runs_on_gpu: bool,
    /// Number of rows of its network per transmitter in addition to those of the Gaussians.
    pub network_rows: usize,
}

impl Default for Cost {
    fn default() -> Self {
        Self {
            per_gaussian: 0,
            per_term: 0,
            pixels: 0,
            bytes: 0,
            links_at_once: usize::MAX,
            runs_on_gpu: false,
            network_rows: 0,
        }
    }
}
