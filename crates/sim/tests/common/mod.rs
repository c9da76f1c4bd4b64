//! The reference room, and where the reference lies.
#![allow(clippy::unwrap_used, clippy::print_stdout, dead_code)] // each test file uses its own part

use pwrfgs_sim::Scene;
use std::path::{Path, PathBuf};

/// The folder of reference paths, or a note where it is absent.
pub(crate) fn reference() -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap();
    let shared = std::env::var_os("PWRFGS_SHARED").map_or_else(|| root.join("../shared"), PathBuf::from);
    let folder = shared.join("reference/paths");
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: {} is not there", folder.display());
    None
}

/// The room of the reference, empty, with specular reflections up to `order` alone.
pub(crate) fn reference_room(carrier_hz: f64, slab: bool, order: usize) -> Scene {
    let finish = |material: &str, thickness: f64| {
        let thickness = if slab { format!(", thickness_m: {thickness}") } else { String::new() };
        format!("(material: \"{material}\"{thickness})")
    };
    let text = format!(
        "(name: \"reference\", carrier_hz: {carrier_hz:?},
          room: (outline: Box(low: (-3, -2.5, 0), high: (3, 2.5, 3)), walls: {}, floor: {}, ceiling: {}),
          receiver: (position: (1.7, -0.9, 1.3), orientation: Quaternion(0, 0, 0, 1), array: (polarization: (0, 0, 1))),
          transmitter: (positions: Uniform(low: (-2, -2, 0.5), high: (2, 2, 2.5))),
          propagation: (order: {order}, room_order: {order}, diffraction: false))",
        finish("concrete", 0.2),
        finish("wood", 0.03),
        finish("plasterboard", 0.025),
    );
    Scene::parse(&text, Path::new("reference.ron")).unwrap()
}
