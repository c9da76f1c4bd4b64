//! NeRF2 (Zhao et al., MobiCom 2023) as a method: no Gaussians, ray marching through a network.
//!
//! ```text
//! receiver ── rays, samples ─► trunk ─► attenuation ─► path factor of each sample ──┐
//!                                └────► feature ──┐                                 ├─► Σ over samples ─► observation
//! transmitter, view ──────────────────────────────┴─► signal net ─► emission ───────┘
//! ```
//!
//! [`Nerf2`] is the method and [`RayBundle`] are the rays of a receiver. `network` holds the layers, `path` the emission of
//! samples and the attenuation along the ray, `walk` the forward and backward pass of a chunk of rays, `group` the
//! links that share rays, `totals` the sums over rays, `gpu` the network on a GPU. The trunk does not depend on the
//! transmitter: it is computed once for all transmitters of a call, and cached for predictions.

#[cfg(feature = "gpu")]
mod gpu;
#[cfg(feature = "gpu")]
#[cfg(test)]
mod gpu_tests;
mod group;
mod method;
mod network;
mod path;
mod totals;
mod walk;

#[cfg(test)]
mod oracle;

use pwrfgs_core::{JsonSchema, MeasurementSetup, PixelSubset, Real, consts};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Ray marching through a neural radiance field of attenuation and emission (NeRF2, Zhao et al., MobiCom 2023), a
/// common baseline. It has no Gaussians, so nothing is pruned, and N and Chamfer are n/a.
///
/// A trunk of `depth` layers computes the attenuation from the position of a sample. A smaller network computes the
/// emission of the sample from the direction of the ray and the transmitter position (or its `features`). Outputs per
/// data type:
///
/// - Spectrum: the pixel is the modulus of the sum along its ray.
/// - Received power: the modulus R of the sum over a coarse sky, as 100 |R| − 100 dBm.
/// - Channel: the complex sum, with a separate weight per subcarrier.
///
/// Training uses the rate `optimizer.network` and the pixels selected by `rays`. Projector, rasterizer, deformation,
/// calibration and readout are ignored.
///
/// Differences from the released code:
///
/// - The sky of powers and channels has `azimuths` and `elevations`; the released code uses only the first ring for
///   powers.
/// - Directions of pixels are those of the data, which differ by one degree from the released ones.
/// - Samples behind a remaining amplitude of 10⁻¹² are ignored, as is the infinite last sample of powers and channels.
/// - Losses are those of this program: in dB² for powers (10⁴ times the released loss) and relative for channels.
/// - The rate that falls and rises again is `Cosine` with `steps` below those of the training.
/// - Channels are normalised by training data only.
///
/// The trunk does not depend on the transmitter. It is computed once for all transmitters of a call, and cached between
/// predictions if it fits in 2,500 MiB. Training at full size needs some 10¹² multiply-adds per step;
/// `nerf2-laptop.ron` is sized for two cores.
///
/// ```
/// # use pwrfgs_core::{Method, Plugin};
/// # use pwrfgs_methods as _;
/// Plugin::<dyn Method>::parse("Nerf2(width: 128, samples: 32)")?;
/// assert!(Plugin::<dyn Method>::parse("Nerf2(samples: 1)").is_err());
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Nerf2 {
    /// Layers of the trunk; with 6 or more, the position is a second input of the sixth layer.
    pub depth: usize,
    /// Units per layer; an even number.
    pub width: usize,
    /// Samples per ray, from the receiver to the far end, both included.
    pub samples: usize,
    /// Length of a ray, metres.
    pub far_m: Real,
    /// Length of the network's unit, metres; the released settings have 60 for BLE.
    pub unit_m: Real,
    /// Number of azimuths of the rays, for powers and channels.
    pub azimuths: usize,
    /// Number of elevations of the rays above the horizon, up to the zenith, for powers and channels.
    pub elevations: usize,
    /// Frequency of the phase along a ray of powers and channels, Hz; distances count in the network's unit, as
    /// released.
    pub carrier_hz: f64,
    /// Length of the feature vector that replaces the transmitter position: 52 for the uplinks of NeRF2's channels; 0
    /// for positions.
    pub features: usize,
}

impl Default for Nerf2 {
    fn default() -> Self {
        Self {
            depth: 8,
            width: 256,
            samples: 64,
            far_m: 5.0,
            unit_m: 1.0,
            azimuths: 36,
            elevations: 9,
            carrier_hz: 2.4e9,
            features: 0,
        }
    }
}

/// Maximum of every count in the settings: layers, units, samples, azimuths, elevations and features. Larger values are
/// rejected as typing errors.
const MOST: usize = 4_096;
/// Maximum number of network weights; the released network has 0.7 million.
const LARGEST: usize = 1 << 28;

impl Nerf2 {
    /// Returns the unit vectors of the rays of powers and channels, receiver frame, ring by ring from the lowest above the
    /// horizon to the zenith.
    fn sky_directions(&self) -> Vec<[Real; 3]> {
        let direction = |i: usize| {
            let (ring, column) = ((i / self.azimuths + 1) as Real, (i % self.azimuths) as Real);
            let el = consts::PI / 2.0 * ring / self.elevations as Real;
            let az = 2.0 * consts::PI * column / self.azimuths as Real;
            [el.cos() * az.cos(), el.cos() * az.sin(), el.sin()]
        };
        (0..self.elevations * self.azimuths).map(direction).collect()
    }

    /// Checks the settings; the error names the invalid one.
    fn check_settings(&self) -> Result<(), String> {
        let counts = [
            ("depth", self.depth, 1),
            ("width", self.width, 2),
            ("samples", self.samples, 2),
            ("azimuths", self.azimuths, 1),
            ("elevations", self.elevations, 1),
        ];
        if let Some((name, value, least)) = counts.iter().find(|(_, value, least)| !(*least..=MOST).contains(value)) {
            return Err(format!("`{name}` is {value}; give {least} to {MOST}"));
        }
        let weights = (self.depth + 2) * self.width * self.width; // of the square layers
        if weights > LARGEST {
            return Err(format!(
                "depth {} and width {} give {weights} weights, expected at most {LARGEST}; reduce them",
                self.depth, self.width
            ));
        }
        if self.width % 2 == 1 {
            return Err(format!(
                "`width` is {}; give an even number, because one layer has half the width",
                self.width
            ));
        }
        let lengths =
            [("far_m", f64::from(self.far_m)), ("unit_m", f64::from(self.unit_m)), ("carrier_hz", self.carrier_hz)];
        if let Some((name, value)) = lengths.iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            return Err(format!("`{name}` is {value}; give a positive number"));
        }
        // Inputs of width 3 are positions.
        if (1..=3).contains(&self.features) || self.features > MOST {
            return Err(format!("`features` is {}; give 0 for the position, or 4 to {MOST}", self.features));
        }
        Ok(())
    }
}

/// Rays from one position, with equal samples on each.
#[derive(Clone, Debug)]
pub(crate) struct RayBundle {
    /// Origin of all rays, in the network's unit of length.
    pub(crate) origin: [Real; 3],
    /// Unit vectors of the rays, world frame.
    pub(crate) directions: Vec<[Real; 3]>,
    /// Distances of the samples `[n]`, in the network's unit.
    pub(crate) samples: Vec<Real>,
}

impl RayBundle {
    /// Creates the rays of a receiver: those of `pixels` for a spectrum, otherwise those of the whole sky.
    pub(crate) fn new(method: &Nerf2, setup: &MeasurementSetup, receiver: usize, pixels: &PixelSubset) -> Self {
        let pose = &setup.receivers[receiver].pose;
        let in_world = |direction: [Real; 3]| pose.turned(direction.map(f64::from)).map(|x| x as Real);
        let directions = if setup.task.has_pixels {
            let plane = &setup.plane;
            let ray = |p: usize| {
                let (column, row) = (p % plane.width, p / plane.width);
                // `requires` rejects planes without directions.
                in_world(plane.direction(column as Real, row as Real).unwrap_or([0.0, 0.0, 1.0]))
            };
            match pixels {
                PixelSubset::All => (0..setup.value_count()).map(ray).collect(),
                PixelSubset::Same(pixels) | PixelSubset::Each(pixels) => pixels.iter().map(|&p| ray(p)).collect(),
            }
        } else {
            method.sky_directions().into_iter().map(in_world).collect()
        };
        let origin = pose.position.map(|x| x as Real / method.unit_m);
        let (far, last) = (method.far_m / method.unit_m, (method.samples - 1) as Real);
        Self { origin, directions, samples: (0..method.samples).map(|i| far * i as Real / last).collect() }
    }

    /// Returns the number of samples per ray.
    pub(crate) fn sample_count(&self) -> usize {
        self.samples.len()
    }

    /// Returns the positions of the samples of some rays, ray by ray, in the network's unit of length.
    pub(crate) fn points(&self, rays: Range<usize>) -> Vec<[Real; 3]> {
        let along = |d: &[Real; 3]| {
            let (origin, d) = (self.origin, *d);
            self.samples.iter().map(move |t| std::array::from_fn(|k| origin[k] + t * d[k]))
        };
        self.directions[rays].iter().flat_map(along).collect()
    }
}
