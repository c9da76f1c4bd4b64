//! Propagation path to the receiver, and its row in `paths.csv`.

use crate::world::World;
use crate::{Complex, SPEED_OF_LIGHT};
use glam::{DMat3, DVec3};
use pwrfgs_core::messages::cell;
use std::fmt::Write as _;

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
    /// Position, metres, world frame.
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
    /// Delay, seconds.
    pub fn delay(&self) -> f64 {
        self.length / SPEED_OF_LIGHT
    }

    /// Gain including the phase of the carrier delay: the contribution at the receiver. `wavelength` in metres.
    pub fn baseband(&self, wavelength: f64) -> Complex {
        self.gain * Complex::cis(-std::f64::consts::TAU * self.length / wavelength)
    }

    /// Length of the path to a point near the receiver with the same interactions, metres.
    pub fn length_to(&self, point: DVec3) -> f64 {
        self.before + point.distance(self.source)
    }
}

/// Names and frames for the rows of a path table.
pub(crate) struct PathTable {
    receiver_from_world: DMat3,
    faces: Vec<String>,
    edges: Vec<String>,
}

impl PathTable {
    /// Header of `paths.csv`. `interactions` has one letter each: R reflection, T transmission, D diffraction, S
    /// diffuse scattering. Angles are in degrees; departure and arrival in the world frame, `spectrum_*` as pixel
    /// coordinates of the spectrum. `gain_*` excludes the phase of the delay.
    pub(crate) const HEADER: &str = "id,path,interactions,gain_re,gain_im,gain_db,delay_ns,length_m,\
        departure_azimuth_deg,departure_elevation_deg,arrival_azimuth_deg,arrival_elevation_deg,spectrum_azimuth_deg,\
        spectrum_elevation_deg,surfaces";

    /// Creates the table for a receiver with these axes.
    pub(crate) fn new(world: &World, world_from_receiver: DMat3) -> Self {
        let faces: Vec<String> = world.faces.iter().map(|f| f.name.clone()).collect();
        let edge = |[a, b]: [u32; 2]| match (&faces[a as usize], &faces[b as usize]) {
            (a, b) if a == b => format!("rim of {a}"),
            (a, b) => format!("edge of {a} and {b}"),
        };
        let edges = world.edges.iter().map(|e| edge(e.faces)).collect();
        Self { receiver_from_world: world_from_receiver.transpose(), faces, edges }
    }

    /// Rows of transmitter `id`.
    pub(crate) fn rows(&self, id: usize, paths: &[PropagationPath]) -> String {
        let mut text = String::new();
        for (i, path) in paths.iter().enumerate() {
            let letters: String = path.interactions.iter().map(letter).collect();
            let letters = if letters.is_empty() { "LOS" } else { &letters };
            let names: Vec<&str> = path.interactions.iter().map(|met| self.name(met)).collect();
            let [departure, arrival] = [path.departure, path.arrival].map(angles);
            let shown = angles(self.receiver_from_world * path.arrival);
            writeln!(
                text,
                "{id},{},{letters},{:.6e},{:.6e},{:.3},{:.5},{:.6},{:.4},{:.4},{:.4},{:.4},{:.4},{:.4},\"{}\"",
                i + 1,
                path.gain.re,
                path.gain.im,
                20.0 * path.gain.norm().log10(),
                path.delay() * 1e9,
                path.length,
                departure.0,
                departure.1,
                arrival.0,
                arrival.1,
                shown.0,
                shown.1,
                cell(&names.join(">")).replace('"', "\"\"")
            )
            .expect("text grows");
        }
        text
    }

    fn name(&self, interaction: &Interaction) -> &str {
        match *interaction {
            Interaction::Reflection { face, .. }
            | Interaction::Transmission { face, .. }
            | Interaction::Scattering { face, .. } => &self.faces[face as usize],
            Interaction::Diffraction { edge, .. } => &self.edges[edge as usize],
        }
    }
}

fn letter(interaction: &Interaction) -> char {
    match interaction {
        Interaction::Reflection { .. } => 'R',
        Interaction::Transmission { .. } => 'T',
        Interaction::Diffraction { .. } => 'D',
        Interaction::Scattering { .. } => 'S',
    }
}

/// Azimuth and elevation of a unit vector, degrees; azimuth from 0 to 360 as in a spectrum.
pub(crate) fn angles(direction: DVec3) -> (f64, f64) {
    let azimuth = direction.y.atan2(direction.x).to_degrees();
    let elevation = direction.z.clamp(-1.0, 1.0).asin().to_degrees();
    (if azimuth < 0.0 { azimuth + 360.0 } else { azimuth }, elevation)
}
