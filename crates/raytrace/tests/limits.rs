//! Extreme scenes are rejected as invalid input before they need much memory or time.

use crate::common::law_scene;
use pwrfgs_raytrace::{SceneFile, Simulator};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

const ROOM: &str = "(outline: Box(low: (-10, -8, 0), high: (10, 8, 6)), walls: (material: \"concrete\"), \
                    floor: (material: \"concrete\"), ceiling: (material: \"concrete\"))";

/// Returns the error for the scene with `from` replaced by `to`, within seconds.
fn error_after(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from}");
    let begun = Instant::now();
    let scene = SceneFile::parse(&text.replacen(from, to, 1), Path::new("a.ron"));
    let error = scene.and_then(|scene| Simulator::new(&scene).map(|_| ())).expect_err(to);
    assert!(error.is_input() && begun.elapsed() < Duration::from_secs(20), "{to}: {error}");
    let message = error.to_string();
    assert!(message.len() < 2000, "{} letters", message.len());
    message
}

/// Returns the text of a valid scene.
fn valid_scene() -> String {
    let object =
        "Box(name: \"crate\", low: (1, 1, 1), high: (2, 2, 2), finish: (material: \"wood\", thickness_m: 0.02)),";
    law_scene(ROOM, object, [0.0, 0.0, 2.0], "order: 1, room_order: 1").to_ron()
}

#[test]
fn reports_numbers_out_of_range() {
    let text = valid_scene();
    for (from, to, expected) in [
        ("position: (0.0, 0.0, 2.0)", "position: (1e308, 0, 0)", "receiver: `position`"),
        ("position: (0.0, 0.0, 2.0)", "position: (NaN, 0, 0)", "receiver: `position`"),
        ("high: (2.0, 2.0, 2.0)", "high: (1e30, 2, 2)", "object `crate`"),
        ("high: (2.0, 2.0, 2.0)", "high: (1, 2, 2)", "object `crate`"),
        ("high: (10.0, 8.0, 6.0)", "high: (inf, 8, 6)", "room:"),
        ("order: 1", "order: 50", "`order` is 50"),
        ("rows: 4", "rows: 1000000", "`rows` is 1000000"),
        ("rows: 4", "rows: 18446744073709551616", "a.ron:"),
        ("carrier_hz: 2000000000.0", "carrier_hz: 0", "`carrier_hz` is 0"),
        ("materials: {}", "materials: {\"wood\": (a: 1e300, c: 0)}", "material `wood`: `a`"),
        ("materials: {}", "materials: {\"wood\": (a: 1e-30, c: 0)}", "material `wood` has a relative permittivity"),
        (
            "element: Isotropic,\n        polarization: (0.0, 0.0, 1.0),\n    ),\n    propagation",
            "element: Patch(exponent: NaN), ), propagation",
            "transmitter: `exponent`",
        ),
        ("roughness: 0.0,\n", "roughness: 0.5, patch_m: 0.02, seed: 0, ) ,//", "a.ron:"),
    ] {
        let message = error_after(&text, from, to);
        assert!(message.contains(expected), "{to}: {message}");
    }
}

#[test]
fn rejects_long_names_and_control_characters() {
    let long = "x".repeat(5_000_000);
    for name in [long.as_str(), "a\u{1b}[31mb"] {
        for (from, expected) in
            [("\"law\"", "`name`"), ("\"crate\"", "the name of object 1"), ("\"wood\"", "the name of a material")]
        {
            let message = error_after(&valid_scene(), from, &format!("\"{name}\""));
            assert!(
                message.contains(expected) && message.contains("holds control characters or more than 200 letters"),
                "{message}"
            );
        }
    }
}

#[test]
fn rejects_oversized_scene_before_tracing() {
    let text = valid_scene();
    let with = |objects: &str| error_after(&text, "objects: [", &format!("objects: [{objects}"));
    let boxes: Vec<String> = (0..30_000)
        .map(|i| format!("Box(name: \"{i}\", low: (1, 1, 1), high: (2, 2, 2), finish: (material: \"wood\")),"))
        .collect();
    assert!(with(&boxes.concat()).contains("more than 300000; simplify"));
    let panel = |i: usize| {
        format!(
            "Panel(name: \"{i}\", from: (3, 0), to: (3, 1), heights: (1, 2), finish: (material: \"wood\", thickness_m: 0.01)),"
        )
    };
    assert!(with(&(0..4000).map(panel).collect::<String>()).contains("millions of its faces lie on each other"));
    let traced =
        text.replace("rows: 4", "rows: 32").replace("columns: 4", "columns: 32").replace("order: 1", "order: 7");
    let traced = traced.replace("position: (0.0, 0.0, 2.0)", "position: (-4, 0, 2)");
    let message = error_after(&traced, "wavefront: Spherical", "wavefront: Traced");
    assert!(message.contains("tracing to each of 1024 antennas would take"), "{message}");
    let rough = text.replace("roughness: 0.0", "roughness: 0.5");
    assert!(error_after(&rough, "patch_m: 0.5", "patch_m: 0.02").contains("in patches of 0.02 m are too many"));
    let corners: Vec<String> = (0..2000).map(|i| format!("({i}, {})", i % 2)).collect();
    let outline = "Box(\n            low: (-10.0, -8.0, 0.0),\n            high: (10.0, 8.0, 6.0),\n        )";
    let plan = |corners: &str| format!("Plan(corners: [{corners}], ceiling: 6)");
    assert!(error_after(&text, outline, &plan(&corners.join(","))).contains("has 2000 corners; give at most 1000"));
    for flat in ["(0, 0), (4, 0), (8, 0)", "(-9, -9), (9, -9), (8, -9), (8, 9), (-9, 9)"] {
        assert!(error_after(&text, outline, &plan(flat)).contains("cross or touch"));
    }
}

#[test]
fn deeply_nested_brackets_do_not_overflow_stack() {
    for (bracket, field) in
        [("(", "objects: ["), ("[", "objects: ["), ("Some(", "noise: "), ("{", "materials: {"), ("/*", "(")]
    {
        error_after(&valid_scene(), field, &format!("{field}{}", bracket.repeat(100_000)));
    }
}

#[test]
fn reports_meshes_that_cannot_be_traced() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = |name: &str| {
        let file = folder.path().join(name);
        let object = format!("Mesh(name: \"m\", file: {file:?}, finish: (material: \"wood\", thickness_m: 0.01)),");
        error_after(&valid_scene(), "objects: [", &format!("objects: [{object}"))
    };
    let vertices = "v 1 1 1\nv 2 1 1\n";
    let fan: Vec<String> = (0..100).map(|i| format!("v 1 {} {}\nf 1 2 {}\n", 2 + i, 1 + i * i, i + 3)).collect();
    fs::write(folder.path().join("fan.obj"), vertices.to_owned() + &fan.concat()).unwrap();
    assert!(mesh("fan.obj").contains("fan.obj: has an edge that 100 triangles share"));
    let many = "f 1 2 3\n".repeat(300_001);
    fs::write(folder.path().join("many.obj"), format!("{vertices}v 1 2 1\n{many}")).unwrap();
    assert!(mesh("many.obj").contains("the mesh has more than 300000 triangles; simplify it"));
    let huge = fs::File::create(folder.path().join("huge.obj")).unwrap();
    huge.set_len(1 << 40).unwrap();
    assert!(mesh("huge.obj").contains("huge.obj: the file needs 10995.1 GB of memory, more than the "));
    assert!(mesh(".").contains("unsupported mesh format"));
    let made = std::process::Command::new("mkfifo").arg(folder.path().join("pipe.obj")).status();
    if made.is_ok_and(|status| status.success()) {
        assert!(mesh("pipe.obj").contains("this is a named pipe"));
        assert!(
            SceneFile::read(&folder.path().join("pipe.obj")).unwrap_err().to_string().contains("this is a named pipe")
        );
    }
}
