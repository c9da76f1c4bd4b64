//! Training settings, with the values of the paper for every constant of the method.

use pwrfgs_core::{JsonSchema, Real, plugin::Check};
use serde::{Deserialize, Serialize};

/// Pixel or power loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum PixelLoss {
    /// Absolute error |Δ|; robust to outliers.
    #[default]
    Absolute,
    /// Squared error Δ².
    Squared,
}

/// Pixels of the spectra used in a training step, for methods that can predict single pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Rays {
    /// All pixels of the strided spectra.
    #[default]
    All,
    /// This number of pixels, drawn anew in each step and equal for all spectra of the batch. Computations that do not
    /// depend on the transmitter are shared.
    Same(usize),
    /// This number of random pairs of spectrum and pixel, in place of a batch, as in NeRF2.
    Each(usize),
}

/// Step whose model a training returns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Keep {
    /// The last step.
    #[default]
    Last,
    /// The step after pruning whose model was best on the validation set. A set of a few positions cannot choose: use it with
    /// a hundred or more.
    Best,
}

/// Settings of a training of `scale` times the steps.
trait Scaled {
    /// Multiplies the numbers of steps.
    fn scaled(&self, scale: f64) -> Self;
}

/// Every `u64` of the settings is a number of steps; a value above 0 stays at least 1.
impl Scaled for u64 {
    fn scaled(&self, scale: f64) -> Self {
        if *self == 0 { 0 } else { ((*self as f64 * scale).round() as Self).max(1) }
    }
}

/// Types without numbers of steps.
macro_rules! unscaled {
    ($($ty:ty)*) => { $(impl Scaled for $ty { fn scaled(&self, _: f64) -> Self { *self } })* };
}
unscaled! { usize f32 f64 bool PixelLoss Rays Keep }

/// Declares settings structs with default values.
macro_rules! settings {
    ($(#[$meta:meta])* $name:ident {
        $($(#[$doc:meta])* $field:ident : $ty:ty = $default:expr,)*
    }) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(default, deny_unknown_fields)]
        pub struct $name {
            $($(#[$doc])* pub $field: $ty,)*
        }
        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }
        impl Scaled for $name {
            fn scaled(&self, scale: f64) -> Self {
                Self { $($field: self.$field.scaled(scale),)* }
            }
        }
    };
}

/// A learning rate as a function of the step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub enum Schedule {
    /// Constant rate.
    Constant(Real),
    /// Decays exponentially from `first` to `last` over `steps` steps, then stays constant; 0 steps means the whole
    /// training.
    LogLinear {
        /// Rate at step 1.
        first: Real,
        /// Rate after `steps` steps.
        last: Real,
        /// Number of steps of the decay; 0 for `training.steps`.
        #[serde(default)]
        steps: u64,
    },
    /// Cosine decay from `first` to `last` over `steps` steps; afterwards the rate continues periodically, as in the
    /// released code.
    Cosine {
        /// Rate at step 1.
        first: Real,
        /// Rate after `steps` steps.
        last: Real,
        /// Steps of half a period; 0 for `training.steps`.
        #[serde(default)]
        steps: u64,
    },
}

impl Schedule {
    /// Returns the rate at `step` (from 1) of a training of `total` steps.
    pub fn rate(&self, step: u64, total: u64) -> Real {
        let part =
            |steps: u64| (step.saturating_sub(1)) as f64 / (if steps == 0 { total } else { steps }).max(1) as f64;
        match *self {
            Self::Constant(rate) => rate,
            Self::LogLinear { first, last, steps } => {
                let t = part(steps).min(1.0);
                (f64::from(first as f32).ln() * (1.0 - t) + f64::from(last as f32).ln() * t).exp() as Real
            }
            Self::Cosine { first, last, steps } => {
                let wave = 0.5 * (1.0 + (std::f64::consts::PI * part(steps)).cos());
                last + (first - last) * wave as Real
            }
        }
    }

    /// Rejects a rate that is negative or not finite; `name` is the field.
    fn check(&self, name: &str) -> Result<(), String> {
        let is_valid = match *self {
            Self::Constant(rate) => rate >= 0.0 && rate.is_finite(),
            Self::LogLinear { first, last, .. } => first > 0.0 && last > 0.0 && (first + last).is_finite(),
            Self::Cosine { first, last, .. } => first >= 0.0 && last >= 0.0 && (first + last).is_finite(),
        };
        let sentence = format!("`{name}` has an invalid rate; give finite rates of 0 or more (LogLinear: above 0)");
        require(is_valid, &sentence)
    }
}

impl Scaled for Schedule {
    fn scaled(&self, scale: f64) -> Self {
        match *self {
            Self::Constant(rate) => Self::Constant(rate),
            Self::LogLinear { first, last, steps } => Self::LogLinear { first, last, steps: steps.scaled(scale) },
            Self::Cosine { first, last, steps } => Self::Cosine { first, last, steps: steps.scaled(scale) },
        }
    }
}

settings! {
    /// Loss function. Spectra: rendering loss (1-w)·L1 + w·(1-SSIM). Powers: error in dB. Channels: squared error over
    /// the mean squared channel of the training set.
    Loss {
        /// Weight w of 1-SSIM, eq. (9), between 0 and 1. Only for spectra; must be 0 if `rays` is not `All`.
        ssim_weight: Real = 0.2,
        /// Loss of a pixel of a spectrum, in addition to SSIM.
        pixel: PixelLoss = PixelLoss::Absolute,
        /// Loss of a received power.
        power: PixelLoss = PixelLoss::Absolute,
    }
}

settings! {
    /// Adam optimizer with one learning rate per parameter.
    Optimizer {
        /// Learning rate of the Gaussian centres, metres per step, as in WRF-GS+.
        means: Schedule = Schedule::LogLinear { first: 8e-4, last: 8e-6, steps: 30_000 },
        /// Learning rate of the logarithmic scales.
        log_scales: Schedule = Schedule::Constant(0.005),
        /// Learning rate of the quaternions.
        quats: Schedule = Schedule::Constant(0.001),
        /// Learning rate of the opacity logits.
        opacity_logits: Schedule = Schedule::Constant(0.025),
        /// Learning rate of the signals.
        signals: Schedule = Schedule::Constant(0.0025),
        /// Learning rate of the network weights.
        network: Schedule = Schedule::LogLinear { first: 8e-4, last: 1.6e-6, steps: 0 },
        /// Warm-up steps: the learning rate of the network rises from 0 to its schedule.
        network_warmup: u64 = 0,
        /// ε in the denominator of Adam, for the Gaussians.
        eps: Real = 1e-15,
        /// ε in the denominator of Adam, for the network.
        network_eps: Real = 1e-15,
        /// L2 weight decay of the network, added to the gradient. WRF-GS uses 5e-5.
        network_l2: Real = 0.0,
        /// Decoupled weight decay of the network (AdamW): each step subtracts rate · decay · weight.
        network_decay: Real = 0.0,
    }
}

settings! {
    /// Densification as in 3DGS (algorithm 1, line 9): clone, split and remove Gaussians.
    Densify {
        /// Densification starts after this step.
        from: u64 = 500,
        /// Steps between two densifications; 0 disables densification.
        every: u64 = 100,
        /// Gaussians with at least this mean norm of the 2-D gradient are densified, in normalised device coordinates.
        gradient_threshold: Real = 0.0002,
        /// Size of the scene, metres; 0 for half the diagonal of its bounds. The released code has 2.
        extent_m: Real = 0.0,
        /// Gaussians up to this share of the extent are cloned, larger ones are split.
        clone_below: Real = 0.01,
        /// Densification removes Gaussians with a lower opacity.
        opacity_floor: Real = 0.005,
        /// After `large_after` steps, Gaussians larger than this share of the extent are removed; 0 disables this.
        large_above: Real = 0.1,
        /// Step after which `large_above` applies.
        large_after: u64 = 3_000,
        /// Steps between two opacity resets; 0 disables resets.
        reset_every: u64 = 3_000,
        /// Largest opacity after a reset.
        reset_opacity: Real = 0.01,
        /// Maximum number of Gaussians during densification; those with the largest gradients are densified first. 0
        /// for no limit.
        max_gaussians: usize = 0,
    }
}

settings! {
    /// Training settings: all constants of algorithm 1.
    Training {
        /// Number of training steps M.
        steps: u64 = 200_000,
        /// Factor on all numbers of steps: here, in `densify` and in the schedules of `optimizer`. It is applied last:
        /// 0.25 gives a quarter of the training in the same proportions. Results are rounded; values above 0 stay at
        /// least 1. A factor below 1 also multiplies `validation_samples`, not below 50, validates at most ten times, and
        /// divides the learning rates of masks, up to 0.1 (without Adam: ten times the rate), so that masks close within the
        /// shorter training.
        scale: f64 = 1.0,
        /// Batch size: transmitters per step, at most those of the training set.
        batch: usize = 1,
        /// Densification ends after this step (`M_d`).
        densify_until: u64 = 20_000,
        /// Pruning ends with this step (`M_p`).
        prune_until: u64 = 40_000,
        /// Steps between two prune steps (`I_p`).
        prune_every: u64 = 1_000,
        /// Number of Gaussians at the end of pruning, reached by the first pruner that supports a target; 0 leaves the
        /// number to the pruners.
        target_count: usize = 0,
        /// Training uses every `stride`-th row and column of the spectra; must divide both sides. Spectra of a small
        /// array are smooth: with 3, a step is nine times cheaper and learns as much. The projector's filter and the
        /// window of SSIM stay those of the whole image. Scores always use whole images.
        stride: usize = 1,
        /// Whether each step draws a new first row and column for `stride`, so that every pixel is trained. Narrow
        /// Gaussians, or more Gaussians than trained pixels, need it; for a few wide ones, `false` has less noise.
        moving_stride: bool = true,
        /// Pixels of the strided spectra used in a step.
        rays: Rays = Rays::All,
        /// Standard deviation of a random shift of the training transmitters, metres. Reduces overfitting.
        tx_jitter_m: Real = 0.0,
        /// Dropout: share of hidden units switched off in a step, drawn again in each step; 0 disables it. Reduces
        /// overfitting if there are few, noisy transmitters. Only for `Factored`.
        dropout: Real = 0.0,
        /// Steps between two evaluations on the validation set; 0 disables them.
        validate_every: u64 = 1_000,
        /// Validation samples per evaluation, spread evenly over the validation set.
        validation_samples: usize = 100,
        /// Step whose model is returned.
        keep: Keep = Keep::Last,
        /// Steps between two checkpoints.
        checkpoint_every: u64 = 1_000,
        /// Loss function.
        loss: Loss = Loss::default(),
        /// Optimizer and learning rates.
        optimizer: Optimizer = Optimizer::default(),
        /// Densification.
        densify: Densify = Densify::default(),
    }
}

/// Least number of validation samples of a shorter training, unless the pipeline has fewer.
const LEAST_VALIDATED: usize = 50;
/// Largest number of validations of a shorter training.
const MOST_VALIDATIONS: u64 = 10;
/// Largest number of pairs of spectrum and pixel per step.
const MOST_PAIRS: usize = 4_194_304;

impl Training {
    /// Returns the settings with `scale` applied to all numbers of steps, and `scale` set to 1. A scale below 1 also
    /// reduces validation, as the field states.
    pub fn resolved(&self) -> Self {
        if self.scale == 1.0 {
            return self.clone(); // numbers of steps beyond 2^53 would be rounded
        }
        let mut resolved = Self { scale: 1.0, ..self.scaled(self.scale) };
        if self.scale < 1.0 {
            let samples = (self.validation_samples as f64 * self.scale).round() as usize;
            resolved.validation_samples = samples.max(self.validation_samples.min(LEAST_VALIDATED));
            let interval = if self.validate_every > 0 { resolved.steps.div_ceil(MOST_VALIDATIONS) } else { 0 };
            resolved.validate_every = resolved.validate_every.max(interval);
        }
        resolved
    }

    /// Returns the settings that affect a run folder: not the interval of checkpoints, which has its default.
    #[must_use]
    pub fn of_run(&self) -> Self {
        Self { checkpoint_every: Self::default().checkpoint_every, ..self.clone() }
    }

    /// Returns the settings that affect the trained model: those of [`Self::of_run`], and not the validation unless it chooses
    /// the step.
    #[must_use]
    pub fn of_model(&self) -> Self {
        if self.keep == Keep::Best {
            return self.of_run();
        }
        let Self { validate_every, validation_samples, .. } = Self::default();
        Self { validate_every, validation_samples, ..self.of_run() }
    }
}

/// Returns the sentence as an error unless the value `is_valid`.
fn require(is_valid: bool, sentence: &str) -> Result<(), String> {
    if is_valid { Ok(()) } else { Err(sentence.into()) }
}

impl Check for Training {
    fn check(&self) -> Result<(), String> {
        require(self.steps >= 1, "`steps` is 0; give at least 1")?;
        require(self.scale > 0.0 && self.scale <= 1e6, "`scale` must be positive, such as 0.25, and at most 1e6")?;
        require(self.batch >= 1, "`batch` is 0; give at least 1")?;
        require(
            self.prune_until >= self.densify_until,
            "`prune_until` is below `densify_until`; raise it, because pruning follows densification",
        )?;
        require(self.stride >= 1, "`stride` is 0; give 1 for every pixel")?;
        let is_valid = match self.rays {
            Rays::All => true,
            Rays::Same(pixels) => pixels >= 1,
            Rays::Each(pairs) => (1..=MOST_PAIRS).contains(&pairs),
        };
        require(is_valid, &format!("`rays` is 0, or more than {MOST_PAIRS} pairs; give at least 1, or All"))?;
        require(
            self.rays == Rays::All || self.loss.ssim_weight == 0.0,
            "SSIM needs whole spectra, but `rays` selects single pixels; set loss.ssim_weight to 0, or rays to All",
        )?;
        require(self.prune_every >= 1, "`prune_every` is 0; give at least 1")?;
        let is_validated = self.keep == Keep::Last || self.validate_every > 0;
        require(is_validated, "`keep: Best` chooses by validation; give a `validate_every` above 0")?;
        require(self.checkpoint_every >= 1, "`checkpoint_every` is 0; give at least 1")?;
        require(
            self.tx_jitter_m >= 0.0 && self.tx_jitter_m.is_finite(),
            "`tx_jitter_m` must be 0 or a positive length",
        )?;
        require((0.0..0.95).contains(&self.dropout), "`dropout` must lie from 0 to below 0.95")?;
        require((0.0..=1.0).contains(&self.loss.ssim_weight), "`ssim_weight` must lie between 0 and 1")?;
        self.optimizer.check()?;
        self.densify.check()
    }
}

impl Optimizer {
    /// Rejects invalid learning rates, ε and decay.
    fn check(&self) -> Result<(), String> {
        self.means.check("means")?;
        self.log_scales.check("log_scales")?;
        self.quats.check("quats")?;
        self.opacity_logits.check("opacity_logits")?;
        self.signals.check("signals")?;
        self.network.check("network")?;
        require(self.eps > 0.0 && self.network_eps > 0.0, "`eps` and `network_eps` must be positive")?;
        let is_decay = |x: Real| x >= 0.0 && x.is_finite();
        require(is_decay(self.network_l2) && is_decay(self.network_decay), "weight decay must not be negative")
    }
}

impl Densify {
    /// Rejects negative thresholds and opacities out of range.
    fn check(&self) -> Result<(), String> {
        let is_valid = |x: Real| x >= 0.0 && x.is_finite();
        require(is_valid(self.gradient_threshold), "`gradient_threshold` must not be negative")?;
        require(is_valid(self.extent_m), "`extent_m` must be 0 (automatic) or a positive length")?;
        require(
            is_valid(self.clone_below) && is_valid(self.large_above),
            "`clone_below` and `large_above` must not be negative",
        )?;
        require((0.0..1.0).contains(&self.opacity_floor), "`opacity_floor` must lie in [0, 1)")?;
        require(self.reset_opacity > 0.0 && self.reset_opacity < 1.0, "`reset_opacity` must lie between 0 and 1")
    }
}
