//! One way by which a wave reaches the receiver.

use crate::wave::{Complex, SPEED_OF_LIGHT};
use glam::DVec3;

/// What a wave meets on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Interaction {
    /// Specular reflection on a face.
    Reflection {
        /// Index of the face.
        face: u32,
        /// Where, metres, world frame.
        point: DVec3,
    },
    /// Straight through a thin sheet.
    Transmission {
        /// Index of the face.
        face: u32,
        /// Where, metres, world frame.
        point: DVec3,
    },
    /// Around an edge.
    Diffraction {
        /// Index of the edge.
        edge: u32,
        /// Where, metres, world frame.
        point: DVec3,
    },
    /// Diffusely, off a patch of a rough face.
    Scattering {
        /// Index of the face.
        face: u32,
        /// Where, metres, world frame.
        point: DVec3,
    },
}

/// A propagation path from transmitter to receiver: one summand of eq. (1).
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Complex gain without the phase of the carrier's delay: |gain|² is the path gain between the two antennas. The
    /// line of sight between isotropic antennas has λ/(4πd), real and positive.
    pub gain: Complex,
    /// Length in all, metres.
    pub length: f64,
    /// Unit vector along which the wave leaves the transmitter, world frame.
    pub departure: DVec3,
    /// Unit vector from the receiver towards the wave that comes in, world frame.
    pub arrival: DVec3,
    /// Whence the last spherical wave spreads: the transmitter, mirrored for reflections, or the edge or patch that was
    /// met last; metres, world frame. `|receiver - source| + before == length`.
    pub source: DVec3,
    /// Length of the path before `source`, metres; zero without diffraction or scattering.
    pub before: f64,
    /// What it meets, in the order of travel.
    pub interactions: Vec<Interaction>,
}

impl Path {
    /// Delay, seconds.
    pub fn delay(&self) -> f64 {
        self.length / SPEED_OF_LIGHT
    }

    /// Gain with the phase of the carrier's delay: what adds up at the receiver. `wavelength` in metres.
    pub fn baseband(&self, wavelength: f64) -> Complex {
        self.gain * Complex::cis(-std::f64::consts::TAU * self.length / wavelength)
    }

    /// Length of the path to a point near the receiver, the interactions kept: metres.
    pub fn length_to(&self, point: DVec3) -> f64 {
        self.before + point.distance(self.source)
    }
}
