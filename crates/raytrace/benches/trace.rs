//! All paths of one transmitter, and a whole simulated spectrum, on one thread.
//!
//! `cargo bench -p pwrfgs-raytrace --bench trace`. The empty room is that of the reference paths: 6 x 5 x 3 m, order 3.

#![allow(clippy::print_stdout)] // a benchmark reports

use criterion::Criterion;
use glam::DVec3;
use pwrfgs_raytrace::{ObservationKind, SceneFile, Simulator};
use std::hint::black_box;
use std::path::Path;

const EMPTY_ROOM: &str = r#"(name: "empty", carrier_hz: 920e6,
    room: (outline: Box(low: (-3, -2.5, 0), high: (3, 2.5, 3)), walls: (material: "concrete", thickness_m: 0.2),
        floor: (material: "wood", thickness_m: 0.03), ceiling: (material: "plasterboard", thickness_m: 0.025)),
    receiver: (position: (1.7, -0.9, 1.3), orientation: Quaternion(0, 0, 0, 1)),
    transmitter: (positions: Uniform(low: (-2.5, -2, 0.5), high: (2.5, 2, 2.5))),
    propagation: (order: 3, room_order: 3, diffraction: false))"#;

/// Returns a room of 10 x 8 x 3 m with 30 boxes in three rows: 186 planes.
fn thirty_boxes() -> SceneFile {
    let object = |i: usize| {
        let (x, y) = (0.5 + 0.9 * (i % 10) as f64, 1.0 + 2.5 * (i / 10) as f64);
        let (width, height) = (0.4 + 0.02 * (i % 7) as f64, 0.5 + 0.11 * (i % 11) as f64);
        format!(
            "Box(name: \"box {i}\", low: ({x}, {y}, 0.1), high: ({}, {}, {height}), yaw_deg: {}, \
             finish: (material: \"wood\", thickness_m: 0.02)),",
            x + width,
            y + 0.6,
            7 * i
        )
    };
    let objects: String = (0..30).map(object).collect();
    let text = format!(
        "(name: \"boxes\", carrier_hz: 2.4e9, objects: [{objects}],
          room: (outline: Box(low: (0, 0, 0), high: (10, 8, 3)), walls: (material: \"brick\"),
              floor: (material: \"concrete\"), ceiling: (material: \"concrete\")),
          receiver: (position: (5.2, 7.6, 2.3), orientation: Facing(direction: (0, -1, 0))),
          transmitter: (positions: Uniform(low: (0.3, 0.2, 1.7), high: (9.7, 7, 2.8))),
          propagation: (diffraction: false))"
    );
    SceneFile::parse(&text, Path::new("thirty boxes")).expect("the scene is sound")
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    let empty = SceneFile::parse(EMPTY_ROOM, Path::new("empty room")).expect("the scene is sound");
    let office = SceneFile::read(&scenes.join("office.ron")).expect("the scene ships");
    for (name, scene) in [("empty room, order 3", empty), ("office", office), ("30 boxes", thirty_boxes())] {
        let simulator = Simulator::new(&scene).expect("the scene is sound");
        let positions = simulator.draw_positions(24, 0).expect("there is room");
        println!("{name}: {} faces", simulator.world().faces.len());
        let mut next = 0;
        let mut tx = || -> DVec3 {
            next += 1;
            positions[next % positions.len()]
        };
        let mut group = criterion.benchmark_group(name);
        group.bench_function("paths", |b| b.iter(|| simulator.trace(black_box(tx()))));
        let kind = ObservationKind::Spectrum;
        group.bench_function("spectrum", |b| {
            b.iter(|| simulator.receivers()[0].observe(black_box(tx()), &kind, Some(0)));
        });
        group.bench_function("new scene", |b| b.iter(|| Simulator::new(black_box(&scene))));
        group.finish();
    }
    criterion.final_summary();
}
