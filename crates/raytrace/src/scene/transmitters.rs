//! Transmitter positions.

#[cfg(test)]
mod tests;

use super::room::FAR;
use glam::DVec3;
use pwrfgs_core::rng::{self, Rng};
use pwrfgs_core::{Error, Pose, Result};
use pwrfgs_data::{read_poses, read_transmitters};
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

/// Resolution of positions, metres, so that the four decimals of `tx_pos.csv` are exact.
const GRAIN: f64 = 1e-4;
/// Grains per metre.
const GRAINS: f64 = 1e4;
/// Largest number of points of a grid.
const MOST: f64 = 1e7;
/// Number of rejected positions in a row after which a draw fails.
const TRIES: usize = 1000;
/// Smallest `step_m` of a walk, metres: ten grains.
const SMALLEST_STEP: f64 = 1e-3;
/// Longest step of a walk relative to the median.
const LONGEST: f64 = 100.0;
/// Standard deviation of the heading change per step, radians.
const WANDER: f64 = 0.28;
/// Standard deviation of the yaw wobble, radians.
const WOBBLE_YAW: f64 = 0.8;
/// Standard deviation of the pitch wobble, radians.
const WOBBLE_PITCH: f64 = 0.65;
/// Steepest pitch, radians.
const STEEPEST: f64 = 1.4;
/// Correlation of the wobble between consecutive steps.
const MEMORY: f64 = 0.45;

/// Transmitter positions of a simulated scene: drawn in a box of the world frame, or stated; metres.
///
/// Drawn positions are multiples of 0.1 mm inside the box, as in measured files. Equal seeds give equal positions.
///
/// * `Uniform(low, high)`: independent positions, uniform in the free space of the box. A longer draw begins with the
///   shorter one.
/// * `Grid(low, high, step_m)`: centres of cubes of edge `step_m`, as many as fit, centred in the box; x varies fastest,
///   then y. Fewer samples than points select a random subset in that order; more are an error. A point inside an
///   object is also an error.
/// * `Walk(low, high, step_m)`: a carried transmitter, as in the measured `s23` set. Steps have a median length of
///   `step_m` and a heavy tail (a recording with gaps), the heading wanders and wobbles, walls of the box reflect, and
///   the walk turns away from obstacles. A longer draw begins with the shorter one.
/// * `Csv(file)`: the rows of a file in their order, with the columns x, y and z; for a moving receiver its poses, with the
///   columns qx, qy, qz and qw too. There are as many samples as rows.
/// * `Listed(poses)`: these poses in their order; transmitters have no orientation. There are as many samples as poses.
///
/// ```
/// # use pwrfgs_raytrace::scene::Transmitters;
/// let text = "Walk(low: (-0.9, -0.9, 0.8), high: (0.7, 0.5, 1.7), step_m: 0.0104)";
/// let walk: Transmitters = ron::from_str(text)?;
/// assert_eq!(walk.draw(200, 0, &|_| Ok(()))?.len(), 200);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Transmitters {
    /// Uniform in a box.
    Uniform {
        /// Smallest corner, metres.
        low: [f64; 3],
        /// Largest corner, metres.
        high: [f64; 3],
    },
    /// Centres of cubes, x fastest.
    Grid {
        /// Smallest corner, metres.
        low: [f64; 3],
        /// Largest corner, metres.
        high: [f64; 3],
        /// Edge of a cube, metres.
        step_m: f64,
    },
    /// Random walk.
    Walk {
        /// Smallest corner, metres.
        low: [f64; 3],
        /// Largest corner, metres.
        high: [f64; 3],
        /// Median length of a step, metres; 0.0104 in the measured `s23` set.
        step_m: f64,
    },
    /// Rows of a file, relative to the scene file; [`crate::SceneFile::read`] replaces it with `Listed`.
    Csv(PathBuf),
    /// Stated positions, with the orientations of a moving receiver.
    Listed(Vec<Pose>),
}

impl Transmitters {
    /// Returns an error for a box without positions, a step out of range, a grid of too many points, or an invalid
    /// list: the problem and the next step.
    pub fn check(&self) -> Result<(), String> {
        if let Self::Listed(poses) = self {
            return check_listed(poses);
        }
        let (low, high) = self.corners();
        let region = Region::new(low, high)?;
        match *self {
            Self::Uniform { .. } | Self::Csv(_) | Self::Listed(_) => Ok(()),
            Self::Grid { step_m, .. } => {
                if !(GRAIN..=FAR).contains(&step_m) {
                    return Err(format!("`step_m` of the grid is {step_m}; give a length of 0.0001 m or more"));
                }
                let points: f64 = grid_cells(low, high, step_m).iter().product();
                if points > MOST {
                    return Err(format!("the grid has {points} points, more than ten million; use a larger `step_m`"));
                }
                Ok(())
            }
            Self::Walk { step_m, .. } => {
                let longest = region.size().max_element();
                if !(step_m >= SMALLEST_STEP && step_m <= longest) {
                    let range = format!("from {SMALLEST_STEP} to the longest side of the box, {longest}");
                    return Err(format!("`step_m` of the walk is {step_m}; give a length in metres {range}"));
                }
                Ok(())
            }
        }
    }

    /// Draws `count` positions, metres, world frame; a list gives at most as many as it has. `free` returns the obstacle
    /// at a position that cannot hold a transmitter.
    ///
    /// # Errors
    /// Errors of [`Self::check`]; no free space; a grid with too few points; a point of a grid or list that is not
    /// free.
    pub fn draw(&self, count: usize, seed: u64, free: FreeSpace<'_>) -> Result<Vec<DVec3>> {
        self.check().map_err(position_error)?;
        if let Self::Listed(poses) = self {
            let checked = |(number, pose): (usize, &Pose)| check_free(number, pose.position.into(), free);
            return poses.iter().take(count).enumerate().map(checked).collect();
        }
        let (low, high) = self.corners();
        let region = Region::new(low, high).map_err(position_error)?;
        let mut sampler = Sampler { region, random: rng::stream(seed, "transmitters", 0), free };
        match *self {
            Self::Uniform { .. } => (0..count).map(|i| sampler.draw_free_position(i)).collect(),
            Self::Grid { step_m, .. } => sampler.draw_grid(grid_cells(low, high, step_m), step_m, count),
            Self::Walk { step_m, .. } => sampler.draw_walk(step_m, count),
            Self::Csv(_) | Self::Listed(_) => Err(position_error("the file of positions is not read yet")),
        }
    }

    /// Returns the smallest and largest corner of the box, or of the stated positions, metres; zero for a file.
    pub fn corners(&self) -> ([f64; 3], [f64; 3]) {
        match self {
            Self::Uniform { low, high } | Self::Grid { low, high, .. } | Self::Walk { low, high, .. } => (*low, *high),
            Self::Csv(_) => ([0.0; 3], [0.0; 3]),
            Self::Listed(poses) => {
                let positions = || poses.iter().map(|pose| DVec3::from(pose.position));
                let (low, high) = (positions().reduce(DVec3::min), positions().reduce(DVec3::max));
                (low.unwrap_or_default().to_array(), high.unwrap_or_default().to_array())
            }
        }
    }

    /// Returns the number of stated positions; `None` if they are drawn.
    pub(crate) fn listed_count(&self) -> Option<usize> {
        if let Self::Listed(poses) = self { Some(poses.len()) } else { None }
    }

    /// Replaces a file, relative to `folder`, by its rows: poses if the receiver moves (`with_poses`), else positions.
    /// Returns the errors of its reader.
    pub(super) fn read_file(&mut self, folder: &Path, with_poses: bool) -> Result<()> {
        if let Self::Csv(file) = self {
            let file = folder.join(file);
            let positions = || Ok(read_transmitters(&file)?.into_iter().map(Pose::from).collect());
            *self = Self::Listed(if with_poses { read_poses(&file)? } else { positions()? });
        }
        Ok(())
    }
}

/// Returns an error for no pose, or one that is invalid or too far away.
fn check_listed(poses: &[Pose]) -> Result<(), String> {
    let is_far = |pose: &Pose| pose.position.iter().any(|v| v.abs() > FAR);
    let fault = |pose: &Pose| pose.fault().map(|(_, fault)| fault).or(is_far(pose).then(|| "is too far away".into()));
    if let Some((pose, fault)) = poses.iter().find_map(|pose| Some((pose, fault(pose)?))) {
        return Err(format!("the position {:?} {fault}; give metres within {:.0} km", pose.position, FAR / 1e3));
    }
    if poses.is_empty() { Err("`positions` is empty; give at least one".into()) } else { Ok(()) }
}

/// Returns the position of sample `number`, counted from 0, or an error if it is not free.
fn check_free(number: usize, position: DVec3, free: FreeSpace<'_>) -> Result<DVec3> {
    free(position).map(|()| position).map_err(|obstacle| {
        let DVec3 { x, y, z } = position;
        Error::Config(format!(
            "transmitter {} at ({x}, {y}, {z}) is {obstacle}; move the positions or the object",
            number + 1
        ))
    })
}

/// Tests whether a position, metres, can hold a transmitter, and returns the obstacle otherwise, such as ``inside `desk 2` ``.
type FreeSpace<'a> = &'a dyn Fn(DVec3) -> Result<(), String>;

/// Returns the error for a problem of the positions.
fn position_error(why: impl std::fmt::Display) -> Error {
    Error::Config(format!("transmitters: {why}"))
}

/// Positions of the 0.1 mm grid inside a box.
struct Region {
    /// Smallest and largest corner, in grains.
    low: [i64; 3],
    high: [i64; 3],
}

impl Region {
    /// Creates the region between two corners, metres. Returns an error for corners that are too far or in wrong order, or
    /// if the box contains no position of the grid.
    fn new(low: [f64; 3], high: [f64; 3]) -> Result<Self, String> {
        for ((low, high), axis) in low.into_iter().zip(high).zip(["x", "y", "z"]) {
            if !(low.abs() <= FAR && high.abs() <= FAR) {
                return Err(format!("{axis} runs from {low} to {high}; give `low` and `high` in metres"));
            }
            if low > high {
                return Err(format!("{axis} runs from {low} down to {high}; swap `low` and `high`"));
            }
        }
        // Bounds such as 0.7 are whole grains, although 0.7 * 10000 is slightly less than 7000.
        let grains = |metres: f64, round: fn(f64) -> f64| {
            let nearest = (metres * GRAINS).round();
            if nearest / GRAINS == metres { nearest as i64 } else { round(metres * GRAINS) as i64 }
        };
        let region = Self { low: low.map(|v| grains(v, f64::ceil)), high: high.map(|v| grains(v, f64::floor)) };
        match (0..3).find(|&k| region.low[k] > region.high[k]) {
            Some(k) => Err(format!(
                "{} runs from {} to {}, which contains no multiple of 0.0001 m; use the same multiple for both",
                ["x", "y", "z"][k],
                low[k],
                high[k]
            )),
            None => Ok(region),
        }
    }

    /// Returns the smallest corner, metres.
    fn low_corner(&self) -> DVec3 {
        DVec3::from_array(self.low.map(|grain| grain as f64 / GRAINS))
    }

    /// Returns the sides of the box, metres.
    fn size(&self) -> DVec3 {
        DVec3::from_array([0, 1, 2].map(|k| (self.high[k] - self.low[k]) as f64 / GRAINS))
    }

    /// Returns the nearest position of the grid inside the box, metres.
    fn nearest(&self, position: DVec3) -> DVec3 {
        let position = position.to_array();
        let grain = |k: usize| ((position[k] * GRAINS).round() as i64).clamp(self.low[k], self.high[k]);
        DVec3::from_array([0, 1, 2].map(|k| grain(k) as f64 / GRAINS))
    }

    /// Returns the position, metres, mirrored at the walls until it is inside, and mirrors the direction with it.
    fn reflect(&self, position: DVec3, direction: &mut Direction) -> DVec3 {
        let mut inside = self.nearest(position);
        let (low, sides) = (self.low_corner(), self.size());
        // A side of length 0 mirrors nothing.
        for axis in (0..3).filter(|&axis| sides[axis] > 0.0) {
            let size = sides[axis];
            let offset = (position[axis] - low[axis]) / size;
            if !(0.0..=1.0).contains(&offset) {
                let part = offset.rem_euclid(2.0); // mirrored positions repeat every two sides
                inside[axis] = low[axis] + size * part.min(2.0 - part);
                if part > 1.0 {
                    direction.mirror(axis);
                }
            }
        }
        self.nearest(inside)
    }
}

/// Returns the number of cubes along each axis; one if the box is thinner than a cube.
fn grid_cells(low: [f64; 3], high: [f64; 3], step: f64) -> [f64; 3] {
    // A box of 3 m holds 30 cubes of 0.1 m, although 3.0 / 0.1 may be slightly less than 30.
    [0, 1, 2].map(|k| ((high[k] - low[k]) / step * (1.0 + 1e-12) + 1e-9).floor().max(1.0))
}

/// Random positions in the free space of a region.
struct Sampler<'a> {
    region: Region,
    random: Rng,
    free: FreeSpace<'a>,
}

impl Sampler<'_> {
    /// Draws sample `number`, counted from 0: uniform in free space. Returns an error after too many positions that are not free.
    fn draw_free_position(&mut self, number: usize) -> Result<DVec3> {
        let Region { low, high } = self.region;
        let mut last = String::new();
        for _ in 0..TRIES {
            let grains =
                [0, 1, 2].map(|k| low[k] + rng::below(&mut self.random, (high[k] - low[k]) as usize + 1) as i64);
            let position = DVec3::from_array(grains.map(|grain| grain as f64 / GRAINS));
            match (self.free)(position) {
                Ok(()) => return Ok(position),
                Err(obstacle) => last = obstacle,
            }
        }
        let problem = format!("after {number} found, {TRIES} positions in a row are not free, the last is {last}");
        Err(position_error(format!("{problem}; move the box to where there is free space")))
    }

    /// Draws `count` points of the grid of cubes, in the order of the grid. Returns an error if the grid has fewer points or
    /// a point is not free.
    fn draw_grid(&mut self, cells: [f64; 3], step: f64, count: usize) -> Result<Vec<DVec3>> {
        let (cells, region) = (cells.map(|n| n as usize), &self.region);
        let points: usize = cells.iter().product();
        if count > points {
            let advice = "use a smaller `step_m`, a larger box or fewer samples";
            let problem = format!("the grid has {points} points, but {count} samples are requested; {advice}");
            return Err(position_error(problem));
        }
        let mut chosen: Vec<usize> = (0..points).collect();
        if count < points {
            rng::shuffle(&mut self.random, &mut chosen);
            chosen.truncate(count);
            chosen.sort_unstable();
        }
        let low = region.low_corner();
        let first = low + region.size() / 2.0 - step / 2.0 * DVec3::from_array(cells.map(|n| n as f64 - 1.0));
        let position_at = |(number, index): (usize, usize)| {
            let cell = [index % cells[0], index / cells[0] % cells[1], index / cells[0] / cells[1]];
            let position = region.nearest(first + step * DVec3::from_array(cell.map(|i| i as f64)));
            check_free(number, position, self.free)
        };
        chosen.into_iter().enumerate().map(position_at).collect()
    }

    /// Draws the walk of a carried transmitter with a median step of `step` metres, modelled on the 6,123 positions of the
    /// measured `s23` set.
    ///
    /// In `s23`, a step is longer than x with a probability close to x₀/x, x₀ being half the median of 10.4 mm; the
    /// directions of two steps correlate by 0.59, 0.33, 0.25 and 0.09 at lags of 1, 3, 8 and 20 steps; and half of the
    /// steps point up or down by 25° or more. Step lengths are drawn from that distribution. The direction is a slowly
    /// wandering heading plus a wobble of yaw and pitch with a memory of a few steps; its four parameters were fitted to
    /// the correlations. Returns an error if the walk finds no free position.
    fn draw_walk(&mut self, step: f64, count: usize) -> Result<Vec<DVec3>> {
        let mut positions = Vec::with_capacity(count);
        if count > 0 {
            positions.push(self.draw_free_position(0)?);
        }
        let mut direction = Direction::new(&mut self.random);
        while let Some(&position) = positions.last().filter(|_| positions.len() < count) {
            positions.push(self.draw_next_position(position, step, &mut direction)?);
        }
        Ok(positions)
    }

    /// Draws the position after `position` on a walk with a median step of `step` metres, and advances the direction. A
    /// blocked step draws a new direction; returns an error after too many of them.
    fn draw_next_position(&mut self, position: DVec3, step: f64, direction: &mut Direction) -> Result<DVec3> {
        let random = &mut self.random;
        let mut last = String::new();
        for _ in 0..TRIES {
            let mut heading = direction.clone();
            let span = draw_step_length(step, random) * heading.advance(random);
            let next = self.region.reflect(position + span, &mut heading);
            match (self.free)(next) {
                Ok(()) => {
                    *direction = heading;
                    return Ok(next);
                }
                Err(obstacle) => last = obstacle,
            }
            *direction = Direction::new(random);
        }
        let DVec3 { x, y, z } = position;
        let problem =
            format!("the walk cannot leave ({x}, {y}, {z}): {TRIES} steps end where it is not free, the last {last}");
        Err(position_error(format!("{problem}; move the box to where there is free space")))
    }
}

/// Draws a random step length, metres, between half of `median` and [`LONGEST`] times `median`. It exceeds x with a
/// probability of about `median` / 2x.
fn draw_step_length(median: f64, random: &mut Rng) -> f64 {
    let shortest_over_longest = 0.5 / LONGEST;
    let u = shortest_over_longest + (1.0 - shortest_over_longest) * rng::uniform_f64(random);
    0.5 * median / u
}

/// Direction of a walk.
#[derive(Clone)]
struct Direction {
    /// Angle from +x, radians.
    heading: f64,
    /// Yaw and pitch relative to the heading, radians.
    wobble: [f64; 2],
}

impl Direction {
    /// Draws a random direction: uniform heading, normally distributed wobble.
    fn new(random: &mut Rng) -> Self {
        Self {
            heading: TAU * rng::uniform_f64(random),
            wobble: [WOBBLE_YAW, WOBBLE_PITCH].map(|s| s * rng::normal_f64(random)),
        }
    }

    /// Changes heading and wobble at random, and returns the unit vector of the next step.
    fn advance(&mut self, random: &mut Rng) -> DVec3 {
        self.heading = (self.heading + WANDER * rng::normal_f64(random)).rem_euclid(TAU);
        for (wobble, deviation) in self.wobble.iter_mut().zip([WOBBLE_YAW, WOBBLE_PITCH]) {
            *wobble = MEMORY * *wobble + (1.0 - MEMORY * MEMORY).sqrt() * deviation * rng::normal_f64(random);
        }
        let (sin, cos) = (self.heading + self.wobble[0]).sin_cos();
        let (up, along) = self.wobble[1].clamp(-STEEPEST, STEEPEST).sin_cos();
        DVec3::new(along * cos, along * sin, up)
    }

    /// Mirrors the direction at a wall perpendicular to `axis`.
    fn mirror(&mut self, axis: usize) {
        if axis == 2 {
            self.wobble[1] = -self.wobble[1];
        } else {
            self.heading = if axis == 0 { TAU / 2.0 - self.heading } else { -self.heading };
            self.wobble[0] = -self.wobble[0];
        }
    }
}
