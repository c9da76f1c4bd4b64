//! All paths of one transmitter, and a whole simulated spectrum, on one thread.
//!
//! `cargo bench -p pwrfgs-sim --bench trace`. The empty room is that of the reference paths: 6 x 5 x 3 m, order 3.

use criterion::Criterion;
use glam::DVec3;
use pwrfgs_sim::{Scene, Simulator};
use std::hint::black_box;
use std::path::Path;

const EMPTY_ROOM: &str = r#"(name: "empty", carrier_hz: 920e6,
    room: (outline: Box(low: (-3, -2.5, 0), high: (3, 2.5, 3)), walls: (material: "concrete", thickness_m: 0.2),
        floor: (material: "wood", thickness_m: 0.03), ceiling: (material: "plasterboard", thickness_m: 0.025)),
    receiver: (position: (1.7, -0.9, 1.3), orientation: Quaternion(0, 0, 0, 1)),
    transmitter: (positions: Uniform(low: (-2.5, -2, 0.5), high: (2.5, 2, 2.5))),
    propagation: (order: 3, room_order: 3, diffraction: false))"#;

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    let empty = Scene::parse(EMPTY_ROOM, Path::new("empty room")).expect("the scene is sound");
    let office = Scene::read(&scenes.join("office.ron")).expect("the scene ships");
    for (name, scene) in [("empty room, order 3", empty), ("office", office)] {
        let simulator = Simulator::new(&scene).expect("the scene is sound");
        let positions = simulator.positions(24, 0).expect("there is room");
        let mut next = 0;
        let mut tx = || -> DVec3 {
            next += 1;
            positions[next % positions.len()]
        };
        let mut group = criterion.benchmark_group(name);
        group.bench_function("paths", |b| b.iter(|| simulator.trace(black_box(tx()))));
        group.bench_function("spectrum", |b| b.iter(|| simulator.spectrum(black_box(tx()), Some(0))));
        group.bench_function("new scene", |b| b.iter(|| Simulator::new(black_box(&scene))));
        group.finish();
    }
    criterion.final_summary();
}
