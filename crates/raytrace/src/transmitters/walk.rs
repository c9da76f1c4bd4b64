//! A transmitter that is carried about, after the 6,123 positions of the measured `s23` set.
//!
//! There, a step is longer than x with a probability close to x₀/x, x₀ being half the median of 10.4 mm; the directions
//! of two steps correlate by 0.59, 0.33, 0.25 and 0.09 at 1, 3, 8 and 20 steps; and steps point up or down by 25° or
//! more half of the time. The law of the steps is drawn as it is. The direction is a slow heading, which wanders, and a
//! wobble of yaw and pitch about it, which forgets within a few steps; its four numbers were fitted to the correlations.

use super::{Region, TRIES, config, uniform};
use crate::random::normal;
use glam::DVec3;
use pwrfgs_core::Result;
use pwrfgs_core::rng::Rng;
use std::f64::consts::TAU;

/// Longest step over the median.
const LONGEST: f64 = 100.0;
/// Standard deviation of the heading's change a step, radians.
const WANDER: f64 = 0.28;
/// Standard deviation of the wobble's yaw, radians.
const WOBBLE_YAW: f64 = 0.8;
/// Standard deviation of its pitch, radians.
const WOBBLE_PITCH: f64 = 0.65;
/// Steepest pitch, radians.
const STEEPEST: f64 = 1.4;
/// What a step keeps of the wobble of the step before.
const MEMORY: f64 = 0.45;

pub(super) fn draw(
    region: &Region,
    step: f64,
    count: usize,
    random: &mut Rng,
    free: &dyn Fn(DVec3) -> Result<(), String>,
) -> Result<Vec<DVec3>> {
    let mut positions = Vec::with_capacity(count);
    if count > 0 {
        positions.push(region.draw_free(0, random, free)?);
    }
    let mut direction = Direction::new(random);
    while let Some(&position) = positions.last().filter(|_| positions.len() < count) {
        positions.push(next(region, position, step, &mut direction, random, free)?);
    }
    Ok(positions)
}

fn next(
    region: &Region,
    position: DVec3,
    step: f64,
    direction: &mut Direction,
    random: &mut Rng,
    free: &dyn Fn(DVec3) -> Result<(), String>,
) -> Result<DVec3> {
    let mut last = String::new();
    for _ in 0..TRIES {
        let mut heading = direction.clone();
        let to = region.reflect(position + length(step, random) * heading.turn(random), &mut heading);
        match free(to) {
            Ok(()) => {
                *direction = heading;
                return Ok(to);
            }
            Err(place) => last = place,
        }
        *direction = Direction::new(random);
    }
    let DVec3 { x, y, z } = position;
    let what =
        format!("the walk cannot leave ({x}, {y}, {z}): {TRIES} steps end where it is not free, the last {last}");
    Err(config(format!("{what}; move the box to where there is free space")))
}

/// Half the median at least; longer than x with the probability x₀/x, but for the longest.
fn length(median: f64, random: &mut Rng) -> f64 {
    let shortest_over_longest = 0.5 / LONGEST;
    let u = shortest_over_longest + (1.0 - shortest_over_longest) * uniform(random);
    0.5 * median / u
}

#[derive(Clone)]
struct Direction {
    /// Radians from +x.
    heading: f64,
    /// Yaw and pitch about it, radians.
    wobble: [f64; 2],
}

impl Direction {
    fn new(random: &mut Rng) -> Self {
        Self { heading: TAU * uniform(random), wobble: [WOBBLE_YAW, WOBBLE_PITCH].map(|s| s * normal(random)) }
    }

    /// The unit vector of the next step.
    fn turn(&mut self, random: &mut Rng) -> DVec3 {
        self.heading = (self.heading + WANDER * normal(random)).rem_euclid(TAU);
        for (wobble, deviation) in self.wobble.iter_mut().zip([WOBBLE_YAW, WOBBLE_PITCH]) {
            *wobble = MEMORY * *wobble + (1.0 - MEMORY * MEMORY).sqrt() * deviation * normal(random);
        }
        let (sin, cos) = (self.heading + self.wobble[0]).sin_cos();
        let (up, along) = self.wobble[1].clamp(-STEEPEST, STEEPEST).sin_cos();
        DVec3::new(along * cos, along * sin, up)
    }

    fn mirror(&mut self, axis: usize) {
        if axis == 2 {
            self.wobble[1] = -self.wobble[1];
        } else {
            self.heading = if axis == 0 { TAU / 2.0 - self.heading } else { -self.heading };
            self.wobble[0] = -self.wobble[0];
        }
    }
}

impl Region {
    /// Mirrors a position at the walls until it is inside, and the direction with it.
    fn reflect(&self, position: DVec3, direction: &mut Direction) -> DVec3 {
        let mut inside = self.nearest(position);
        let low = self.nearest(DVec3::NEG_INFINITY);
        for axis in 0..3 {
            let size = self.size()[axis];
            let way = (position[axis] - low[axis]) / size;
            if size > 0.0 && !(0.0..=1.0).contains(&way) {
                let part = way.rem_euclid(2.0);
                inside[axis] = low[axis] + size * if part > 1.0 { 2.0 - part } else { part };
                if part > 1.0 {
                    direction.mirror(axis);
                }
            }
        }
        self.nearest(inside)
    }
}
