//! `paths.csv`: every path of a transmitter as a row.

use crate::listener::Listener;
use crate::path::{Interaction, Path};
use crate::world::World;
use glam::{DMat3, DVec3};
use pwrfgs_core::words::cell;
use std::fmt::Write as _;

/// Names and frames that rows need.
pub(crate) struct PathTable {
    receiver_from_world: DMat3,
    faces: Vec<String>,
    edges: Vec<String>,
}

impl PathTable {
    /// `interactions` has a letter each: R reflection, T transmission, D diffraction, S diffuse scattering. Angles are in
    /// degrees; departure and arrival in the world, `spectrum_*` where the path shows in the spectrum. `gain_*` is without
    /// the phase of the delay.
    pub(crate) const HEADER: &str = "id,path,interactions,gain_re,gain_im,gain_db,delay_ns,length_m,\
        departure_azimuth_deg,departure_elevation_deg,arrival_azimuth_deg,arrival_elevation_deg,spectrum_azimuth_deg,\
        spectrum_elevation_deg,surfaces";

    /// Of the paths to `listener`.
    pub(crate) fn new(world: &World, listener: &Listener) -> Self {
        let faces: Vec<String> = world.faces.iter().map(|f| f.name.clone()).collect();
        let edge = |[a, b]: [u32; 2]| match (&faces[a as usize], &faces[b as usize]) {
            (a, b) if a == b => format!("rim of {a}"),
            (a, b) => format!("edge of {a} and {b}"),
        };
        let edges = world.edges.iter().map(|e| edge(e.faces)).collect();
        Self { receiver_from_world: listener.world_from_receiver().transpose(), faces, edges }
    }

    /// The rows of transmitter `id`.
    pub(crate) fn rows(&self, id: usize, paths: &[Path]) -> String {
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
fn angles(direction: DVec3) -> (f64, f64) {
    let azimuth = direction.y.atan2(direction.x).to_degrees();
    let elevation = direction.z.clamp(-1.0, 1.0).asin().to_degrees();
    (if azimuth < 0.0 { azimuth + 360.0 } else { azimuth }, elevation)
}
