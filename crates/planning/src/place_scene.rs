//! `SceneCoverage`: simulated powers between receivers and transmitters over the floor of a scene.

use crate::floor::floor_grid;
use crate::place_ascent::{Ascent, AscentResult, ascend};
use glam::DVec3;
use pwrfgs_core::{Error, Result};
use pwrfgs_raytrace::{ObservationKind, PreparedReceiver, SILENT_DBM, SceneFile, SimulatedObservation, Simulator};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

/// Largest number of links of a grid.
const MOST_LINKS: usize = 4_000_000;
/// Receivers traced between two reports of progress.
const CHUNK: usize = 8;
/// Distance below which a transmitter is at the receiver, metres.
const TOUCHING: f64 = 1e-3;

/// Scene with a grid of transmitters and a grid of receiver positions.
#[derive(Debug)]
pub struct SceneCoverage {
    simulator: Simulator,
    /// Transmitters `[T]`, metres.
    pub transmitters: Vec<[f64; 3]>,
    /// Receiver positions on the grid `[R]`, metres.
    pub candidates: Vec<[f64; 3]>,
    mount: f64,
}

impl SceneCoverage {
    /// Prepares `scene`: both grids have `step` metres; transmitters are at `height`, receivers at `mount` (metres; `None`: the
    /// height of the scene's receiver).
    ///
    /// # Errors
    /// A scene that cannot be built, a step or a height out of range.
    pub fn new(scene: &SceneFile, step: f64, height: f64, mount: Option<f64>) -> Result<Self> {
        let simulator = Simulator::new(scene)?;
        let mount = mount.unwrap_or(scene.receiver.position[2]);
        let (transmitters, candidates) = (floor_grid(scene, step, height)?, floor_grid(scene, step, mount)?);
        Ok(Self { simulator, transmitters, candidates, mount })
    }

    /// Checks the number of links of [`Self::grid`].
    ///
    /// # Errors
    /// More than 4,000,000.
    pub fn check_grid(&self) -> Result<()> {
        let (transmitters, receivers) = (self.transmitters.len(), self.candidates.len());
        if transmitters.saturating_mul(receivers) <= MOST_LINKS {
            return Ok(());
        }
        Err(Error::Config(format!(
            "scene `{}`: {transmitters} transmitters and {receivers} receiver positions, expected at most 4,000,000 pairs; give \
             a larger --step, or --no-grid",
            self.simulator.scene().name
        )))
    }

    /// Powers in dBm of a receiver from these transmitters, without receiver errors.
    fn powers(&self, receiver: &PreparedReceiver, transmitters: impl ParallelIterator<Item = usize>) -> Vec<f64> {
        let sent = self.simulator.scene().transmitter.power_dbm;
        let (center, what) = (DVec3::from(receiver.pose().position), ObservationKind::Power { noise_db: 0.0 });
        let power = |t: usize| {
            let tx = DVec3::from(self.transmitters[t]);
            if tx.distance(center) < TOUCHING {
                return sent;
            }
            match receiver.observe(tx, &what, None).observed {
                SimulatedObservation::Power(dbm) if dbm.is_finite() => dbm,
                _ => sent, // a transmitter at an antenna
            }
        };
        transmitters.map(power).collect()
    }

    /// Powers of a receiver of the grid; those of no signal if one of its antennas is in an object.
    fn traced(&self, place: [f64; 3]) -> Vec<f64> {
        let receiver = self.simulator.receiver_at(place);
        let all = (0..self.transmitters.len()).into_par_iter();
        receiver.map_or_else(|_in_object| vec![SILENT_DBM; all.len()], |receiver| self.powers(&receiver, all.clone()))
    }

    /// Powers in dBm `[T]` per receiver of the grid. `progress` gets the number of traced receivers and their total.
    ///
    /// # Errors
    /// [`Error::Stopped`] if `stop` is set.
    pub fn grid(&self, stop: &AtomicBool, progress: impl Fn(usize, usize)) -> Result<Vec<Vec<f64>>> {
        let mut powers = Vec::with_capacity(self.candidates.len());
        for chunk in self.candidates.chunks(CHUNK) {
            if stop.load(Ordering::Relaxed) {
                return Err(Error::Stopped);
            }
            progress(powers.len(), self.candidates.len());
            let all: Vec<Vec<f64>> = chunk.par_iter().map(|place| self.traced(*place)).collect();
            powers.extend(all);
        }
        Ok(powers)
    }

    /// Searches receiver positions with the largest coverage.
    ///
    /// # Errors
    /// No free position, or [`Error::Stopped`] if `stop` is set.
    pub fn ascend(&self, settings: &Ascent, stop: &AtomicBool) -> Result<AscentResult> {
        let ends = |k: usize| {
            let all = self.candidates.iter().map(|place| place[k]);
            all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
        };
        let [x, y] = [0, 1].map(ends);
        let found = ascend(settings, [[x.0, y.0], [x.1, y.1]], self.transmitters.len(), |[x, y], which| {
            if stop.load(Ordering::Relaxed) {
                return Err(Error::Stopped);
            }
            let receiver = self.simulator.receiver_at([x, y, self.mount]).ok();
            Ok(receiver.map(|receiver| self.powers(&receiver, which.par_iter().copied())))
        })?;
        let none = || {
            let what = "not enough free receiver positions; give another --mount height or fewer receivers";
            Error::Config(format!("scene `{}`: {what}", self.simulator.scene().name))
        };
        found.ok_or_else(none)
    }

    /// Height of the receivers, metres.
    pub fn mount(&self) -> f64 {
        self.mount
    }
}
