//! Propagation path to the receiver.

use crate::{Complex, SPEED_OF_LIGHT};
use glam::DVec3;

/// Interaction of a wave on its path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Interaction {
    /// Specular reflection on a face.
    Reflection {
        /// Index of the face.
        face: u32,
        /// Position, metres, world frame.
        point: DVec3,
    },
    /// Transmission through a thin sheet.
    Transmission {
        /// Index of the face.
        face: u32,
        /// Position, metres, world frame.
        point: DVec3,
    },
    /// Diffraction at an edge.
    Diffraction {
        /// Index of the edge.
        edge: u32,
        /// Position, metres, world frame.
        point: DVec3,
    },
    /// Diffuse scattering at a patch of a rough face.
    Scattering {
        /// Index of the face.
        face: u32,
        /// Position, metres, world frame.
        point: DVec3,
    },
}

impl Interaction {
    /// Returns the position, metres, world frame.
    pub fn point(&self) -> DVec3 {
        match *self {
            Self::Reflection { point, .. }
            | Self::Transmission { point, .. }
            | Self::Diffraction { point, .. }
            | Self::Scattering { point, .. } => point,
        }
    }
}

/// A propagation path from transmitter to receiver: one summand of eq. (1).
#[derive(Clone, Debug, PartialEq)]
pub struct PropagationPath {
    /// Complex gain without the phase of the carrier delay: |gain|² is the path gain between the two antennas. For the
    /// line of sight between isotropic antennas it is λ/(4πd), real and positive.
    pub gain: Complex,
    /// Total length, metres.
    pub length: f64,
    /// Unit vector along which the wave leaves the transmitter, world frame.
    pub departure: DVec3,
    /// Unit vector from the receiver towards the incoming wave, world frame.
    pub arrival: DVec3,
    /// Origin of the last spherical wave: the transmitter mirrored by reflections, or the last edge or patch; metres,
    /// world frame. `|receiver - source| + before == length`.
    pub source: DVec3,
    /// Length of the path before `source`, metres; zero without diffraction or scattering.
    pub before: f64,
    /// Interactions, in order of travel.
    pub interactions: Vec<Interaction>,
}

impl PropagationPath {
    /// Returns the delay, seconds.
    pub fn delay(&self) -> f64 {
        self.length / SPEED_OF_LIGHT
    }

    /// Returns the gain including the phase of the carrier delay: the contribution at the receiver. `wavelength` in
    /// metres.
    pub fn baseband_gain(&self, wavelength: f64) -> Complex {
        self.gain * Complex::cis(-std::f64::consts::TAU * self.length / wavelength)
    }

    /// Returns the length of the path to a point near the receiver with the same interactions, metres.
    pub fn length_to(&self, point: DVec3) -> f64 {
        self.before + point.distance(self.source)
    }
}

/// Returns the azimuth, from 0 to 360, and elevation of a unit vector, degrees, as in a spectrum.
pub(crate) fn azimuth_elevation_deg(direction: DVec3) -> (f64, f64) {
    let azimuth = direction.y.atan2(direction.x).to_degrees();
    let elevation = direction.z.clamp(-1.0, 1.0).asin().to_degrees();
    (if azimuth < 0.0 { azimuth + 360.0 } else { azimuth }, elevation)
}
