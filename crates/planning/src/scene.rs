//! Floor of a simulated scene: a grid of positions, and powers between receivers and transmitters on it.

use crate::ascent::{AscentResult, ascend};
use glam::DVec3;
use pwrfgs_core::{Error, Result, check_stopped, statistics};
use pwrfgs_raytrace::world::{Triangle, World};
use pwrfgs_raytrace::{ObservationKind, PreparedReceiver, SILENT_DBM, SceneFile, SimulatedObservation, Simulator};
use rayon::prelude::*;
use std::sync::atomic::AtomicBool;

/// Largest number of grid points, free or not; also in the message.
const MOST: f64 = 1e6;

/// Returns the positions on a grid of `step` metres at `height` (metres) over the floor of `scene`, half a step from
/// its bounds and outside its objects. Every second row is reversed, so that the grid is a walk.
///
/// # Errors
/// A step or height out of range, a scene that cannot be built, or no free position.
pub fn floor_grid(scene: &SceneFile, step: f64, height: f64) -> Result<Vec<[f64; 3]>> {
    free_positions(scene, &World::from_scene(scene)?, step, height)
}

/// Returns the result of [`floor_grid`] for the `world` that was built from `scene`.
fn free_positions(scene: &SceneFile, world: &World, step: f64, height: f64) -> Result<Vec<[f64; 3]>> {
    let refuse = |problem: String| Error::Config(format!("scene `{}`: {problem}", scene.name));
    if !(step.is_finite() && step > 0.0) {
        return Err(refuse(format!("a grid step of {step} m, expected more than 0, such as 0.25")));
    }
    let corners = world.triangles.iter().flat_map(Triangle::corners);
    let (low, high) =
        corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)));
    if !(low.z..=high.z).contains(&height) {
        return Err(refuse(format!("a height of {height} m is outside {} to {} m; give one inside", low.z, high.z)));
    }
    let [columns, rows] = [high.x - low.x, high.y - low.y].map(|extent| (extent / step).round().max(1.0));
    if columns * rows > MOST {
        return Err(refuse(format!(
            "a grid of {columns:.0} x {rows:.0} positions, expected at most 1,000,000; give a larger step"
        )));
    }
    let at = |row: usize, column: usize| {
        let turned = if row.is_multiple_of(2) { column } else { columns as usize - 1 - column };
        let centre = |low: f64, high: f64, k: usize, count: f64| low + (high - low) * (k as f64 + 0.5) / count;
        DVec3::new(centre(low.x, high.x, turned, columns), centre(low.y, high.y, row, rows), height)
    };
    let grid = (0..rows as usize).flat_map(|row| (0..columns as usize).map(move |column| (row, column)));
    let free: Vec<[f64; 3]> = grid
        .map(|(row, column)| at(row, column))
        .filter(|point| world.check_free(*point).is_ok())
        .map(Into::into)
        .collect();
    if free.is_empty() {
        return Err(refuse(format!(
            "no free position at a height of {height} m; give another height or a smaller step"
        )));
    }
    Ok(free)
}

/// Largest number of links of a grid; also in the message.
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
    /// Height of the receivers, metres.
    mount: f64,
}

impl SceneCoverage {
    /// Prepares `scene`: both grids have `step` metres; transmitters are at `height`, receivers at `mount` (metres; `None`: the
    /// height of the scene's receiver).
    ///
    /// # Errors
    /// A scene that cannot be built, a step or a height out of range, or no free position.
    pub fn new(scene: &SceneFile, step: f64, height: f64, mount: Option<f64>) -> Result<Self> {
        let simulator = Simulator::new(scene)?;
        let mount = mount.unwrap_or(scene.receiver.position[2]);
        let grid = |height: f64| free_positions(scene, simulator.world(), step, height);
        let (transmitters, candidates) = (grid(height)?, grid(mount)?);
        Ok(Self { simulator, transmitters, candidates, mount })
    }

    /// Checks the number of links of [`Self::grid_powers`].
    ///
    /// # Errors
    /// [`Error::Config`] for more than 4,000,000 links.
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

    /// Returns the powers in dBm of a receiver from these transmitters, without receiver errors; the transmit power for a
    /// transmitter at the receiver.
    fn powers(&self, receiver: &PreparedReceiver, transmitters: impl ParallelIterator<Item = usize>) -> Vec<f64> {
        let sent = self.simulator.scene().transmitter.power_dbm;
        let (centre, kind) = (DVec3::from(receiver.pose().position), ObservationKind::Power { noise_db: 0.0 });
        let power = |t: usize| {
            let tx = DVec3::from(self.transmitters[t]);
            if tx.distance(centre) < TOUCHING {
                return sent;
            }
            match receiver.observe(tx, &kind, None).observed {
                SimulatedObservation::Power(dbm) if dbm.is_finite() => dbm,
                _ => sent, // a transmitter at an antenna
            }
        };
        transmitters.map(power).collect()
    }

    /// Returns the powers in dBm `[T]` of a receiver at `position`; [`SILENT_DBM`] if it cannot be prepared, as with an antenna
    /// in an object.
    fn powers_at(&self, position: [f64; 3]) -> Vec<f64> {
        let receiver = self.simulator.receiver_at(position);
        let count = self.transmitters.len();
        let powers = |receiver: PreparedReceiver| self.powers(&receiver, (0..count).into_par_iter());
        receiver.map_or_else(|_| vec![SILENT_DBM; count], powers)
    }

    /// Returns the powers in dBm `[T]` per receiver of the grid. `progress` gets the number of traced receivers and
    /// their total.
    ///
    /// # Errors
    /// [`Error::Stopped`] if `stop` is set.
    pub fn grid_powers(&self, stop: &AtomicBool, progress: impl Fn(usize, usize)) -> Result<Vec<Vec<f64>>> {
        let mut powers = Vec::with_capacity(self.candidates.len());
        for chunk in self.candidates.chunks(CHUNK) {
            check_stopped(stop)?;
            powers.par_extend(chunk.par_iter().map(|position| self.powers_at(*position)));
            progress(powers.len(), self.candidates.len());
        }
        Ok(powers)
    }

    /// Searches positions of `count` receivers with the largest coverage, as [`ascend`].
    ///
    /// # Errors
    /// Too few free positions, more than four receivers, or [`Error::Stopped`] if `stop` is set.
    pub fn ascend(&self, count: usize, seed: u64, stop: &AtomicBool) -> Result<AscentResult> {
        let [x, y] = [0, 1].map(|k| statistics::bounds(self.candidates.iter().map(|position| position[k])));
        let result = ascend(count, seed, [[x.0, y.0], [x.1, y.1]], self.transmitters.len(), |[x, y], transmitters| {
            check_stopped(stop)?;
            let receiver = self.simulator.receiver_at([x, y, self.mount]).ok();
            Ok(receiver.map(|receiver| self.powers(&receiver, transmitters.par_iter().copied())))
        })?;
        let none = || {
            let problem = "not enough free receiver positions; give another --mount height or fewer receivers";
            Error::Config(format!("scene `{}`: {problem}", self.simulator.scene().name))
        };
        result.ok_or_else(none)
    }

    /// Returns the height of the receivers, metres.
    pub fn mount(&self) -> f64 {
        self.mount
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn grid_covers_office_without_objects_as_a_walk() {
        let office = SceneFile::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/office.ron")).unwrap();
        let grid = floor_grid(&office, 0.5, 1.0).unwrap();
        assert!((170..192).contains(&grid.len()), "{}", grid.len());
        assert_eq!((grid[0], grid[1]), ([0.25, 0.25, 1.0], [0.75, 0.25, 1.0]));
        let is_in_copier = |[x, y, _]: &[f64; 3]| (7.2..7.9).contains(x) && (2.4..3.1).contains(y);
        assert!(!grid.iter().any(is_in_copier));
        assert!(floor_grid(&office, 0.0, 1.0).is_err() && floor_grid(&office, 1e-4, 1.0).is_err());
        let message = floor_grid(&office, 0.5, 9.0).unwrap_err().to_string();
        assert!(message.contains("outside") && message.contains("give one inside"), "{message}");
    }
}
