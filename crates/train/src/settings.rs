//! The plain settings of a training: every constant of the method with the paper's value.

use pwrfgs_core::{JsonSchema, Real, plugin::Check};
use serde::{Deserialize, Serialize};

/// How errors count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Errors {
    /// |Δ|: deaf to outliers.
    #[default]
    Absolute,
    /// Δ².
    Squared,
}

/// Which pixels of the spectra a step looks at, for a method that can draw some alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Rays {
    /// All that `stride` leaves.
    #[default]
    All,
    /// So many, drawn anew at each step, the same of all spectra of the batch: what does not depend on the transmitter is
    /// then worked out once.
    Same(usize),
    /// In place of a batch so many pairs of a spectrum and a pixel, as NeRF2 draws them.
    Each(usize),
}

/// Declares settings with their defaults.
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
    };
}

/// A learning rate as a function of the step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub enum Schedule {
    /// The same at every step.
    Constant(Real),
    /// Falls geometrically from `first` to `last` over `steps` steps, then stays; 0 steps means the whole training.
    LogLinear {
        /// Rate at step 1.
        first: Real,
        /// Rate from step `steps` on.
        last: Real,
        /// Steps the fall takes; 0 for `training.steps`.
        #[serde(default)]
        steps: u64,
    },
    /// Falls along half a cosine from `first` to `last` over `steps` steps, and periodically on, as released.
    Cosine {
        /// Rate at step 1.
        first: Real,
        /// Rate at step `steps`.
        last: Real,
        /// Half a period; 0 for `training.steps`.
        #[serde(default)]
        steps: u64,
    },
}

impl Schedule {
    /// The rate at `step` (from 1) of a training of `total` steps.
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

    /// With its steps multiplied.
    fn scaled(self, scale: f64) -> Self {
        match self {
            Self::Constant(rate) => Self::Constant(rate),
            Self::LogLinear { first, last, steps } => Self::LogLinear { first, last, steps: scaled(steps, scale) },
            Self::Cosine { first, last, steps } => Self::Cosine { first, last, steps: scaled(steps, scale) },
        }
    }

    fn check(&self, name: &str) -> Result<(), String> {
        let ok = match *self {
            Self::Constant(rate) => rate >= 0.0 && rate.is_finite(),
            Self::LogLinear { first, last, .. } => first > 0.0 && last > 0.0 && (first + last).is_finite(),
            Self::Cosine { first, last, .. } => first >= 0.0 && last >= 0.0 && (first + last).is_finite(),
        };
        if ok {
            Ok(())
        } else {
            Err(format!("`{name}` needs finite rates that are not negative (LogLinear: positive)"))
        }
    }
}

settings! {
    /// What training makes small: of spectra the rendering loss (1-w)·L1 + w·(1-SSIM), of powers an error in dB, of channels
    /// the squared error over the mean squared channel of the training part.
    Loss {
        /// w of eq. (9), between 0 and 1; spectra only, and 0 with `rays` other than `All`.
        ssim_weight: Real = 0.2,
        /// How errors of a pixel count, beside SSIM.
        pixel: Errors = Errors::Absolute,
        /// How errors of a received power count.
        power: Errors = Errors::Absolute,
    }
}

settings! {
    /// Adam with a rate for each column.
    Optimizer {
        /// Rate of the centres, metres a step, as WRF-GS+ has it.
        means: Schedule = Schedule::LogLinear { first: 8e-4, last: 8e-6, steps: 30_000 },
        /// Rate of the logarithmic scales.
        log_scales: Schedule = Schedule::Constant(0.005),
        /// Rate of the quaternions.
        quats: Schedule = Schedule::Constant(0.001),
        /// Rate of the opacity logits.
        opacity_logits: Schedule = Schedule::Constant(0.025),
        /// Rate of the signals.
        signals: Schedule = Schedule::Constant(0.0025),
        /// Rate of the deformation network.
        network: Schedule = Schedule::LogLinear { first: 8e-4, last: 1.6e-6, steps: 0 },
        /// Steps over which the network's rate rises from 0 to what its schedule says.
        network_warmup: u64 = 0,
        /// Floor of the denominator, Gaussians.
        eps: Real = 1e-15,
        /// Floor of the denominator, network.
        network_eps: Real = 1e-15,
        /// L2 weight decay of the network, added to the gradient (as WRF-GS does it: 5e-5).
        network_l2: Real = 0.0,
        /// Decoupled weight decay of the network (AdamW): each step takes rate · decay · weight away.
        network_decay: Real = 0.0,
    }
}

settings! {
    /// Densification of 3DGS, algorithm 1 line 9.
    Densify {
        /// First step after which Gaussians may be cloned or split.
        from: u64 = 500,
        /// Steps between two densifications; 0 for none at all.
        every: u64 = 100,
        /// Mean norm of the 2-D gradient, in normalised device coordinates, from which on a Gaussian is densified.
        gradient_threshold: Real = 0.0002,
        /// Size of the scene, metres; 0 for half the diagonal of its bounds. The released code has 2.
        extent_m: Real = 0.0,
        /// Up to this share of the extent a Gaussian is cloned, above it is split.
        clone_below: Real = 0.01,
        /// A Gaussian less opaque than this is removed while densifying.
        opacity_floor: Real = 0.005,
        /// After `large_after` steps, a Gaussian larger than this share of the extent is removed; 0 for never.
        large_above: Real = 0.1,
        /// See `large_above`.
        large_after: u64 = 3_000,
        /// Steps between two opacity resets; 0 for none.
        reset_every: u64 = 3_000,
        /// Largest opacity after a reset.
        reset_opacity: Real = 0.01,
        /// No densification beyond this many Gaussians (the largest gradients go first); 0 for no limit.
        max_gaussians: usize = 0,
    }
}

settings! {
    /// Algorithm 1 with every constant a field.
    Training {
        /// M, the number of steps.
        steps: u64 = 200_000,
        /// Multiplies every count of steps here, in `densify` and in the schedules of `optimizer`, as the last thing that
        /// is done to them: 0.25 for a quarter of the training in the same proportions. Counts are rounded, and those
        /// above 0 stay at least 1. Below 1 it also divides the learning rates of masks, up to 0.1 (without Adam: ten times
        /// the rate), so that they close within the shorter training.
        scale: f64 = 1.0,
        /// Transmitters a step.
        batch: usize = 1,
        /// `M_d`: densification ends after this step.
        densify_until: u64 = 20_000,
        /// `M_p`: pruning ends with this step.
        prune_until: u64 = 40_000,
        /// `I_p`: steps between two prunes.
        prune_every: u64 = 1_000,
        /// The exact number of Gaussians at the end of pruning, as the `target` of the first pruner that takes one; 0 to
        /// leave it to the pruners.
        target: usize = 0,
        /// Training looks at every `stride`-th row and column of the spectra, and draws these only; a divisor of both
        /// sides. Spectra of a small array are smooth: with 3 a step is nine times cheaper and learns as much. The
        /// projector's filter and the window of SSIM stay those of the whole image. Scores are of whole images always.
        stride: usize = 1,
        /// Whether each step draws a new first row and column for the stride, so that every pixel is trained. Gaussians
        /// narrower than the stride need it; for a few wide ones `false` has less noise.
        moving_stride: bool = true,
        /// Which of the pixels that are left a step looks at.
        rays: Rays = Rays::All,
        /// Standard deviation of a random shift of the transmitters in training, metres.
        tx_jitter_m: Real = 0.0,
        /// Share of the network's hidden units that a step does without, drawn anew each step; 0 for none. Against
        /// memorising, where few transmitters are noisy; of `Factored`.
        dropout: Real = 0.0,
        /// Steps between two looks at the validation part; 0 for none.
        validate_every: u64 = 1_000,
        /// Validation samples looked at, spread evenly over the part.
        validation_samples: usize = 100,
        /// Steps between two checkpoints.
        checkpoint_every: u64 = 1_000,
        /// What is made small.
        loss: Loss = Loss::default(),
        /// Learning rates.
        optimizer: Optimizer = Optimizer::default(),
        /// Clone, split, remove.
        densify: Densify = Densify::default(),
    }
}

/// A count of steps, multiplied: what happens at all still happens.
fn scaled(steps: u64, scale: f64) -> u64 {
    if steps == 0 { 0 } else { ((steps as f64 * scale).round() as u64).max(1) }
}

impl Training {
    /// The same with `scale` multiplied in, and 1 from then on.
    pub fn resolved(&self) -> Self {
        let mut own = self.clone();
        if self.scale == 1.0 {
            return own; // counts beyond 2^53 would be rounded
        }
        let (densify, o) = (&mut own.densify, &mut own.optimizer);
        let counts = [
            &mut own.steps,
            &mut own.densify_until,
            &mut own.prune_until,
            &mut own.prune_every,
            &mut own.validate_every,
            &mut own.checkpoint_every,
            &mut densify.from,
            &mut densify.every,
            &mut densify.large_after,
            &mut densify.reset_every,
            &mut o.network_warmup,
        ];
        counts.into_iter().for_each(|count| *count = scaled(*count, self.scale));
        let schedules =
            [&mut o.means, &mut o.log_scales, &mut o.quats, &mut o.opacity_logits, &mut o.signals, &mut o.network];
        schedules.into_iter().for_each(|schedule| *schedule = schedule.scaled(self.scale));
        own.scale = 1.0;
        own
    }
}

/// Ok, or the sentence.
fn need(ok: bool, sentence: &str) -> Result<(), String> {
    if ok { Ok(()) } else { Err(sentence.into()) }
}

impl Check for Training {
    fn check(&self) -> Result<(), String> {
        need(self.steps >= 1, "`steps` is 0; give at least 1")?;
        need(self.scale > 0.0 && self.scale <= 1e6, "`scale` must be positive, such as 0.25, and at most 1e6")?;
        need(self.batch >= 1, "`batch` is 0; give at least 1")?;
        need(
            self.prune_until >= self.densify_until,
            "`prune_until` comes before `densify_until`; algorithm 1 densifies first, then prunes",
        )?;
        need(self.stride >= 1, "`stride` is 0; give 1 for every pixel")?;
        need(!matches!(self.rays, Rays::Same(0) | Rays::Each(0)), "`rays` is none; give at least 1, or All")?;
        need(
            self.rays == Rays::All || self.loss.ssim_weight == 0.0,
            "SSIM wants whole pictures, and `rays` gives single pixels; set loss.ssim_weight to 0, or rays to All",
        )?;
        need(self.prune_every >= 1, "`prune_every` is 0; give at least 1")?;
        need(self.checkpoint_every >= 1, "`checkpoint_every` is 0; give at least 1")?;
        need(self.tx_jitter_m >= 0.0 && self.tx_jitter_m.is_finite(), "`tx_jitter_m` must be 0 or a positive length")?;
        need((0.0..0.95).contains(&self.dropout), "`dropout` must lie from 0 to below 0.95")?;
        need((0.0..=1.0).contains(&self.loss.ssim_weight), "`ssim_weight` must lie between 0 and 1")?;
        self.optimizer.check()?;
        self.densify.check()
    }
}

impl Optimizer {
    fn check(&self) -> Result<(), String> {
        self.means.check("means")?;
        self.log_scales.check("log_scales")?;
        self.quats.check("quats")?;
        self.opacity_logits.check("opacity_logits")?;
        self.signals.check("signals")?;
        self.network.check("network")?;
        need(self.eps > 0.0 && self.network_eps > 0.0, "`eps` and `network_eps` must be positive")?;
        let decay = |x: Real| x >= 0.0 && x.is_finite();
        need(decay(self.network_l2) && decay(self.network_decay), "weight decay must not be negative")
    }
}

impl Densify {
    fn check(&self) -> Result<(), String> {
        let known = |x: Real| x >= 0.0 && x.is_finite();
        need(known(self.gradient_threshold), "`gradient_threshold` must not be negative")?;
        need(known(self.extent_m), "`extent_m` must be 0 (automatic) or a positive length")?;
        need(
            known(self.clone_below) && known(self.large_above),
            "`clone_below` and `large_above` must not be negative",
        )?;
        need((0.0..1.0).contains(&self.opacity_floor), "`opacity_floor` must lie in [0, 1)")?;
        need(self.reset_opacity > 0.0 && self.reset_opacity < 1.0, "`reset_opacity` must lie between 0 and 1")
    }
}
