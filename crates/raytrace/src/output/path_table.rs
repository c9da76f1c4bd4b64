//! Rows of `paths.csv`.

use crate::path::{Interaction, PropagationPath, azimuth_elevation_deg};
use crate::world::World;
use glam::DMat3;
use pwrfgs_core::messages::cell;
use std::fmt::Write as _;

/// Names and frames for the rows of a path table.
pub(crate) struct PathTable {
    receiver_from_world: DMat3,
    faces: Vec<String>,
    edges: Vec<String>,
}

impl PathTable {
    /// Header of `paths.csv`. `interactions` has one letter each: R reflection, T transmission, D diffraction, S
    /// diffuse scattering; `LOS` without interactions. Angles are in degrees; departure and arrival in the world frame,
    /// `spectrum_*` as pixel coordinates of the spectrum. `gain_*` excludes the phase of the delay.
    pub(crate) const HEADER: &str = "id,path,interactions,gain_re,gain_im,gain_db,delay_ns,length_m,\
        departure_azimuth_deg,departure_elevation_deg,arrival_azimuth_deg,arrival_elevation_deg,spectrum_azimuth_deg,\
        spectrum_elevation_deg,surfaces";

    /// Creates the table of a receiver with these axes, with the names of the faces and edges of `world`.
    pub(crate) fn new(world: &World, world_from_receiver: DMat3) -> Self {
        let faces: Vec<String> = world.faces.iter().map(|f| f.name.clone()).collect();
        let edge = |[a, b]: [u32; 2]| match (&faces[a as usize], &faces[b as usize]) {
            (a, b) if a == b => format!("rim of {a}"),
            (a, b) => format!("edge of {a} and {b}"),
        };
        let edges = world.edges.iter().map(|e| edge(e.faces)).collect();
        Self { receiver_from_world: world_from_receiver.transpose(), faces, edges }
    }

    /// Formats the rows of transmitter `id`, one line per path, with the columns of [`Self::HEADER`].
    pub(crate) fn format_rows(&self, id: usize, paths: &[PropagationPath]) -> String {
        let mut text = String::new();
        for (i, path) in paths.iter().enumerate() {
            let letters: String = path.interactions.iter().map(interaction_letter).collect();
            let letters = if letters.is_empty() { "LOS" } else { &letters };
            let names: Vec<&str> =
                path.interactions.iter().map(|interaction| self.obstacle_name(interaction)).collect();
            let directions = [path.departure, path.arrival, self.receiver_from_world * path.arrival];
            let angles = directions.map(azimuth_elevation_deg);
            let angles = angles.map(|(azimuth, elevation)| format!("{azimuth:.4},{elevation:.4}")).join(",");
            writeln!(
                text,
                "{id},{},{letters},{:.6e},{:.6e},{:.3},{:.5},{:.6},{angles},\"{}\"",
                i + 1,
                path.gain.re,
                path.gain.im,
                20.0 * path.gain.norm().log10(),
                path.delay() * 1e9,
                path.length,
                cell(&names.join(">")).replace('"', "\"\"")
            )
            .expect("text grows");
        }
        text
    }

    /// Returns the name of the face or edge of an interaction.
    fn obstacle_name(&self, interaction: &Interaction) -> &str {
        match *interaction {
            Interaction::Reflection { face, .. }
            | Interaction::Transmission { face, .. }
            | Interaction::Scattering { face, .. } => &self.faces[face as usize],
            Interaction::Diffraction { edge, .. } => &self.edges[edge as usize],
        }
    }
}

/// Returns the letter of an interaction.
fn interaction_letter(interaction: &Interaction) -> char {
    match interaction {
        Interaction::Reflection { .. } => 'R',
        Interaction::Transmission { .. } => 'T',
        Interaction::Diffraction { .. } => 'D',
        Interaction::Scattering { .. } => 'S',
    }
}
