//! The answer of a `Teacher`: Gaussians, and the plane waves that are their signals.

use pwrfgs_core::{
    GaussianCloud, Pose, Real, Vec3,
    consts::{DEG, TAU},
    logit,
    rng::{self, Rng},
};

/// Gaussians with their mean signals, and how each signal varies.
pub(super) struct Truth {
    pub(super) cloud: GaussianCloud,
    waves: Vec<Wave>,
}

/// amplitude · (MEAN + SWING · cos(k · p + phase)) on two channels, k in radians a metre.
struct Wave {
    /// aᵢ (cos θᵢ, sin θᵢ).
    amplitude: [Real; 2],
    /// 2π nᵢ/λᵢ, radians a metre.
    radians_per_metre: Vec3,
    phase: Real,
}

const MEAN: Real = 0.55;
const SWING: Real = 0.45;

impl Truth {
    /// `count` Gaussians, seen by `receiver`, with signals of wavelengths from the shortest to the longest in metres.
    pub(super) fn new(seed: u64, count: usize, wavelength_m: (f64, f64), receiver: &Pose) -> Self {
        let random = &mut rng::stream(seed, "teacher", 0);
        let mut cloud = GaussianCloud::default();
        let mut waves = Vec::with_capacity(count);
        let (world_from_receiver, origin) = (receiver.world_from_receiver(), receiver.origin());
        for _ in 0..count {
            let (azimuth, elevation) = (TAU * rng::uniform(random), between(random, 10.0, 75.0) / DEG);
            let distance = between(random, 2.0, 6.0);
            let direction =
                Vec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            cloud.means.push((origin + world_from_receiver * (direction * distance)).to_array());
            let scale = distance * (between(random, 5.0, 12.0) / DEG).tan();
            cloud.log_scales.push([0; 3].map(|_| scale.ln() + 0.2 * rng::normal(random)));
            cloud.quats.push(unit([0; 4].map(|_| rng::normal(random))));
            cloud.opacity_logits.push(logit(between(random, 0.5, 0.9)));
            let wave = Wave::random(random, wavelength_m);
            cloud.signals.push(wave.amplitude.map(|a| MEAN * a));
            waves.push(wave);
        }
        Self { cloud, waves }
    }

    /// The signals `[N,2]` for a transmitter at `tx`.
    pub(super) fn signals(&self, tx: [Real; 3]) -> Vec<[Real; 2]> {
        self.waves.iter().map(|wave| wave.at(Vec3::from_array(tx))).collect()
    }
}

impl Wave {
    fn random(random: &mut Rng, (short, long): (f64, f64)) -> Self {
        let strength = between(random, 0.4, 1.0);
        let angle = between(random, 0.0, TAU / 4.0);
        let direction = Vec3::from_array(unit([0; 3].map(|_| rng::normal(random))));
        let wavelength = between(random, short as Real, long as Real);
        let phase = TAU * rng::uniform(random);
        Self {
            amplitude: [strength * angle.cos(), strength * angle.sin()],
            radians_per_metre: direction * (TAU / wavelength),
            phase,
        }
    }

    fn at(&self, tx: Vec3) -> [Real; 2] {
        let level = MEAN + SWING * (self.radians_per_metre.dot(tx) + self.phase).cos();
        self.amplitude.map(|a| a * level)
    }
}

fn between(random: &mut Rng, low: Real, high: Real) -> Real {
    low + (high - low) * rng::uniform(random)
}

/// Divided by its length, which a normal draw leaves above 0 but with probability 0; then the first axis.
fn unit<const N: usize>(vector: [Real; N]) -> [Real; N] {
    let length = vector.iter().map(|v| v * v).sum::<Real>().sqrt();
    if length > 0.0 { vector.map(|v| v / length) } else { std::array::from_fn(|i| Real::from(u8::from(i == 0))) }
}
