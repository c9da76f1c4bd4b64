//! Rooms of the tests.

use pwrfgs_raytrace::SceneFile;
use std::path::Path;

/// Returns the room of the reference, empty, with specular reflections up to `order` alone.
pub(crate) fn reference_room(carrier_hz: f64, slab: bool, order: usize) -> SceneFile {
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
    SceneFile::parse(&text, Path::new("reference.ron")).unwrap()
}

/// Returns the scene from its objects, receiver and further fields; the room is a large box.
pub(crate) fn law_scene(room: &str, objects: &str, receiver: [f64; 3], propagation: &str) -> SceneFile {
    let text = format!(
        "(name: \"law\", carrier_hz: 2e9, room: {room}, objects: [{objects}],
          receiver: (position: {receiver:?}, orientation: Quaternion(0, 0, 0, 1), array: (polarization: (0, 0, 1))),
          transmitter: (positions: Uniform(low: (-1, -1, 1), high: (1, 1, 2))),
          propagation: ({propagation}))"
    );
    let text = text.replace("position: [", "position: (").replace("], orientation", "), orientation");
    SceneFile::parse(&text, Path::new("law.ron")).unwrap()
}

/// Returns a small room with one of everything and two receivers; `more` are further fields.
pub(crate) fn small_room(more: &str) -> String {
    format!(
        "(name: \"small\", carrier_hz: 2.4e9,
          room: (outline: Box(low: (0, 0, 0), high: (4, 3, 2.5)), walls: (material: \"plasterboard\", thickness_m: 0.1),
              floor: (material: \"concrete\"), ceiling: (material: \"wood\", thickness_m: 0.02, roughness: 0.3)),
          objects: [Box(name: \"desk\", low: (1, 1, 0), high: (2, 2, 0.7), finish: (material: \"metal\"))],
          receiver: (position: (0.2, 1.5, 1.5), orientation: Facing(direction: (1, 0, 0)), array: (rows: 2, columns: 4)),
          more_receivers: [(name: \"b\", position: (3.7, 1, 2), orientation: Facing(direction: (-1, 0, 0)),
              array: (rows: 4, columns: 2))],
          transmitter: (positions: Uniform(low: (0.9, 0.9, 0.4), high: (3.5, 2.5, 1.5))),
          noise: (snr_db: 20, phase_error_deg: 3),
          {more})"
    )
}

/// Six subcarriers for it.
pub(crate) const CSI: &str = "subcarriers: (count: 6, bandwidth_hz: 20e6)";
