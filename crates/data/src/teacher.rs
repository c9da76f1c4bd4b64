//! `Teacher`: *simulated* spectra, rendered from random Gaussians that are known.

#[cfg(test)]
mod tests;

use pwrfgs_core::consts::{DEG, TAU};
use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{
    DataSource, Dataset, Error, GaussianCloud, ImagePlane, JsonSchema, Origin, Plugin, Pose, Primitives, Progress,
    Projector, Rasterizer, Real, Result, Sample, Simulation, Spectra, Vec3, logit, position_fault, sigmoid,
};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Transmitters rendered together; they share one geometry.
const BATCH: usize = 8;
/// Every n-th sample belongs to the test list.
const TEST_EVERY: usize = 5;
/// Largest number of Gaussians, of spectra, and of their rows or columns.
const MOST: usize = 1_000_000;
/// Largest number of pixels of all spectra together.
const MAX_PIXELS: usize = 1 << 32;

/// *Simulated* spectra of a few random Gaussians, for tests with known ground truth and runs without a download.
///
/// The Gaussians lie 2 to 6 m from the receiver at elevations of 10° to 75°. They are nearly round, with standard
/// deviations of 5° to 12° as seen from the receiver and opacities of 0.5 to 0.9. Only the signals depend on the
/// transmitter position p, as plane waves of random direction n and wavelength λ of 1 to 2 m: sᵢ(p) = aᵢ·(0.55 + 0.45·cos(2π
/// nᵢ·p/λᵢ + φᵢ)) on the channels (cos θᵢ, sin θᵢ) with θᵢ in the first quadrant. The spectrum is the magnitude of the
/// blended signal, divided by the maximum of all spectra and rounded to 8 bits.
///
/// Transmitters are uniform in a box. `scene.points` are the centres of the Gaussians. Every fifth sample belongs to
/// the test list of [`Official`](crate::Official). [`Teacher::cloud`] and [`Teacher::signals`] return the ground truth.
///
/// Reference scores of unchanged settings on the official test list: mean SSIM 0.847 for the mean spectrum, 0.980 for
/// 3-NN.
///
/// ```
/// # use pwrfgs_core::{DataSource, Plugin};
/// # use pwrfgs_data as _;
/// let teacher = Plugin::<dyn DataSource>::parse("Teacher(gaussians: 12, samples: 200, width: 90, height: 24)");
/// assert!(teacher.is_ok());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Teacher {
    /// Number of true Gaussians.
    pub gaussians: usize,
    /// Number of spectra.
    pub samples: usize,
    /// Random seed of the scene, independent of the seed of the pipeline.
    pub seed: u64,
    /// Columns of a spectrum.
    pub width: usize,
    /// Rows of a spectrum.
    pub height: usize,
    /// Box of the transmitters: smallest and largest corner, metres, world frame.
    pub tx_box: ([f64; 3], [f64; 3]),
    /// Pose of the receiver.
    pub receiver: Pose,
    /// Projector of the true spectra; `None` for `Mercator()`.
    pub projector: Option<Plugin<dyn Projector>>,
}

impl Default for Teacher {
    fn default() -> Self {
        Self {
            gaussians: 12,
            samples: 200,
            seed: 0,
            width: 360,
            height: 90,
            tx_box: ([-0.8, -0.65, 0.5], [0.8, 0.65, 1.4]),
            receiver: Pose::IDENTITY,
            projector: None,
        }
    }
}

impl Teacher {
    /// Returns the true Gaussians, relative to the origin of the data set; signals are means over all positions, before
    /// normalisation.
    pub fn cloud(&self) -> GaussianCloud {
        self.draw_truth().cloud
    }

    /// Returns the true signals `[N,2]` for a transmitter at `tx` (metres), before normalisation.
    pub fn signals(&self, tx: [f64; 3]) -> Vec<[Real; 2]> {
        self.draw_truth().signals(self.origin().local(tx))
    }

    /// Returns the origin of the true positions.
    fn origin(&self) -> Origin {
        Origin::for_receiver(self.receiver.position, [self.tx_box.0, self.tx_box.1])
    }

    /// Draws the true Gaussians and their signals; equal seeds give equal draws.
    fn draw_truth(&self) -> Truth {
        Truth::new(self.seed, self.gaussians, &self.origin().local_pose(self.receiver))
    }

    /// Draws the transmitter positions, metres, uniform in the box.
    fn draw_transmitters(&self) -> Vec<[f64; 3]> {
        let mut random = rng::stream(self.seed, "teacher transmitters", 0);
        let (low, high) = self.tx_box;
        let mut position = || [0, 1, 2].map(|k| low[k] + (high[k] - low[k]) * rng::uniform(&mut random) as f64);
        (0..self.samples).map(|_| position()).collect()
    }

    /// Renders the magnitudes of the spectra of all transmitters `txs` in order, `[T,H,W]`, before normalisation. Returns an
    /// error if projector or rasterizer are not linked.
    fn render_magnitudes(&self, truth: &Truth, txs: &[[f64; 3]], progress: Progress<'_>) -> Result<Vec<Real>> {
        let projector = self.projector.clone().map_or_else(|| linked_plugin("Mercator"), Ok)?;
        let rasterizer: Plugin<dyn Rasterizer> = linked_plugin("AlphaBlending")?;
        let plane: ImagePlane = projector.plane(self.width, self.height);
        let splats = projector.project(&activate(&truth.cloud), &self.origin().local_pose(self.receiver), &plane);
        let mut spectra = Vec::with_capacity(txs.len() * self.width * self.height);
        for batch in txs.chunks(BATCH) {
            let signals: Vec<Vec<[Real; 2]>> = batch.iter().map(|tx| truth.signals(self.origin().local(*tx))).collect();
            // Row i: both channels of Gaussian i, transmitter by transmitter.
            let rows = (0..self.gaussians).flat_map(|i| signals.iter().flat_map(move |signals| signals[i]));
            let render = rasterizer.forward(splats.with_signals(&rows.collect::<Vec<Real>>(), 2 * batch.len(), &plane));
            for pair in render.pixels.chunks_exact(2 * self.width * self.height) {
                let (c0, c1) = pair.split_at(pair.len() / 2);
                spectra.extend(c0.iter().zip(c1).map(|(a, b)| a.hypot(*b)));
            }
            progress(spectra.len() / (self.width * self.height), txs.len());
        }
        Ok(spectra)
    }
}

#[typetag::serde]
impl DataSource for Teacher {
    fn task(&self) -> Option<pwrfgs_core::Task> {
        Some(pwrfgs_core::Task::Spectrum)
    }

    /// Renders the spectra, scaled so that the largest value of all becomes 255.
    fn load(&self, _: &Path, progress: Progress<'_>) -> Result<Dataset> {
        DataSource::check(self).map_err(|fault| Error::Config(format!("Teacher: {fault}")))?;
        let truth = self.draw_truth();
        let txs = self.draw_transmitters();
        let spectra = self.render_magnitudes(&truth, &txs, progress)?;
        let largest = spectra.iter().copied().fold(0.0, Real::max);
        if !(largest.is_finite() && largest > 0.0) {
            let advice = "use another seed, or a projector that shows elevations of 10 to 75 degrees";
            return Err(Error::Config(format!("the spectra of Teacher are black; {advice}")));
        }
        let to_byte = |value: &Real| (value / largest * 255.0).round() as u8;
        let samples = txs.iter().zip(1..).map(|(&tx, id)| Sample::new(id, tx)).collect();
        let spectra = Spectra::grey((self.width, self.height), spectra.iter().map(to_byte).collect())?;
        let (test, train): (Vec<usize>, Vec<usize>) =
            (0..self.samples).partition(|&i: &usize| (i + 1).is_multiple_of(TEST_EVERY));
        let official = (!test.is_empty()).then_some((train, test));
        let Self { samples: count, gaussians, seed, .. } = self;
        let title = format!("{count} simulated spectra of {gaussians} Gaussians (Teacher, seed {seed})");
        let points = truth.cloud.means.iter().map(|mean| self.origin().world(*mean)).collect();
        let data = Dataset::new(title, self.receiver, points, samples, spectra)?;
        Ok(Dataset { official, simulation: Some(Simulation::default()), ..data })
    }

    fn check(&self) -> Result<(), String> {
        for (name, value) in
            [("gaussians", self.gaussians), ("samples", self.samples), ("width", self.width), ("height", self.height)]
        {
            if value == 0 || value > MOST {
                return Err(format!("`{name}` is {value}; use 1 to {MOST}"));
            }
        }
        if self.samples * self.width > MAX_PIXELS / self.height {
            return Err(format!(
                "the spectra have more than {MAX_PIXELS} pixels in all; lower `samples`, `width` or `height`"
            ));
        }
        let (low, high) = self.tx_box;
        if [low, high].into_iter().any(|corner| position_fault(corner).is_some())
            || low.iter().zip(&high).any(|(l, h)| l > h)
        {
            return Err(format!(
                "`tx_box` is {low:?} to {high:?}; give its smallest corner first, then its largest, in metres of at most 1e8"
            ));
        }
        self.receiver.fault().map_or(Ok(()), |(_, fault)| Err(format!("`receiver`: {fault}")))
    }
}

/// Creates the plugin `name` with default settings. Returns an error if it is not linked.
fn linked_plugin<T: ?Sized + pwrfgs_core::plugin::PluginKind>(name: &str) -> Result<Plugin<T>>
where
    Box<T>: for<'de> Deserialize<'de>,
{
    Plugin::parse(&format!("{name}()")).ok().ok_or_else(|| {
        Error::Config(format!("Teacher draws with {name}, which is not linked into this program; link pwrfgs-raster"))
    })
}

/// Returns the activated parameters of a cloud, the inputs of the projector, without deformation or gate.
fn activate(cloud: &GaussianCloud) -> Primitives {
    Primitives {
        means: cloud.means.clone(),
        scales: cloud.log_scales.iter().map(|s| s.map(Real::exp)).collect(),
        quats: cloud.quats.clone(),
        opacities: cloud.opacity_logits.iter().copied().map(sigmoid).collect(),
    }
}

/// Gaussians with mean signals, and the variation of each signal.
pub(super) struct Truth {
    pub(super) cloud: GaussianCloud,
    waves: Vec<Wave>,
}

/// Signal of one Gaussian: amplitude · (MEAN + SWING · cos(k · p + phase)) on two channels, k in radians per metre.
struct Wave {
    /// Amplitude of both channels, aᵢ (cos θᵢ, sin θᵢ).
    amplitude: [Real; 2],
    /// Wave vector 2π nᵢ/λᵢ, radians per metre.
    radians_per_metre: Vec3,
    phase: Real,
}

/// Mean of a signal, in parts of its amplitude.
const MEAN: Real = 0.55;
/// Largest deviation from the mean, in parts of the amplitude: signals are from 0.1 to 1.
const SWING: Real = 0.45;

impl Truth {
    /// Draws `count` Gaussians around `receiver`, with one plane wave each as signal, from the ranges that [`Teacher`] states.
    pub(super) fn new(seed: u64, count: usize, receiver: &Pose) -> Self {
        let random = &mut rng::stream(seed, "teacher", 0);
        let mut cloud = GaussianCloud::default();
        let mut waves = Vec::with_capacity(count);
        let (world_from_receiver, origin) = (receiver.world_from_receiver(), receiver.position_vec());
        for _ in 0..count {
            let (azimuth, elevation) = (TAU * rng::uniform(random), uniform_between(random, 10.0, 75.0) / DEG);
            let distance = uniform_between(random, 2.0, 6.0);
            let direction =
                Vec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            cloud.means.push((origin + world_from_receiver * (direction * distance)).to_array());
            let scale = distance * (uniform_between(random, 5.0, 12.0) / DEG).tan();
            // Nearly round: each axis deviates by about 20 %.
            cloud.log_scales.push([0; 3].map(|_| scale.ln() + 0.2 * rng::normal(random)));
            cloud.quats.push(normalised([0; 4].map(|_| rng::normal(random))));
            cloud.opacity_logits.push(logit(uniform_between(random, 0.5, 0.9)));
            let wave = Wave::random(random);
            cloud.signals.push(wave.amplitude.map(|a| MEAN * a));
            waves.push(wave);
        }
        Self { cloud, waves }
    }

    /// Returns the signals `[N,2]` for a transmitter at `tx`, metres from the origin.
    pub(super) fn signals(&self, tx: [Real; 3]) -> Vec<[Real; 2]> {
        self.waves.iter().map(|wave| wave.signal_at(Vec3::from_array(tx))).collect()
    }
}

impl Wave {
    /// Draws a wave: amplitude from 0.4 to 1, wavelength from 1 to 2 m, any direction and phase.
    fn random(random: &mut Rng) -> Self {
        let strength = uniform_between(random, 0.4, 1.0);
        let angle = uniform_between(random, 0.0, TAU / 4.0);
        let direction = Vec3::from_array(normalised([0; 3].map(|_| rng::normal(random))));
        let wavelength = uniform_between(random, 1.0, 2.0);
        let phase = TAU * rng::uniform(random);
        Self {
            amplitude: [strength * angle.cos(), strength * angle.sin()],
            radians_per_metre: direction * (TAU / wavelength),
            phase,
        }
    }

    /// Returns the signal on both channels for a transmitter at `tx`, metres from the origin.
    fn signal_at(&self, tx: Vec3) -> [Real; 2] {
        let level = MEAN + SWING * (self.radians_per_metre.dot(tx) + self.phase).cos();
        self.amplitude.map(|a| a * level)
    }
}

/// Draws a uniform number from `low` to `high`.
fn uniform_between(random: &mut Rng, low: Real, high: Real) -> Real {
    low + (high - low) * rng::uniform(random)
}

/// Returns the unit vector along `vector`; the first axis for a zero vector.
fn normalised<const N: usize>(vector: [Real; N]) -> [Real; N] {
    let length = vector.iter().map(|v| v * v).sum::<Real>().sqrt();
    if length > 0.0 { vector.map(|v| v / length) } else { std::array::from_fn(|i| Real::from(u8::from(i == 0))) }
}
