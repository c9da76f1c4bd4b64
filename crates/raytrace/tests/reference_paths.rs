//! Every path of the reference room against an independent tracer in double precision: three transmitters, two
//! frequencies, two models of a wall.

use crate::common::reference_room;
use glam::DVec3;
use pwrfgs_core::testing::shared;
use pwrfgs_raytrace::{Complex, Interaction, PropagationPath, Simulator};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// A row of the reference.
struct Row {
    order: usize,
    surfaces: String,
    gain: Complex,
    baseband: Complex,
    length: f64,
    departure: DVec3,
    arrival: DVec3,
    points: Vec<DVec3>,
}

/// Reads the rows of a reference file by transmitter; `None` if the file is missing.
fn rows(file: &str) -> Option<BTreeMap<String, Vec<Row>>> {
    let mut reader = csv::Reader::from_path(shared("reference/paths/sceneA")?.join(file)).unwrap();
    let mut rows: BTreeMap<String, Vec<Row>> = BTreeMap::new();
    for record in reader.deserialize() {
        let r: BTreeMap<String, String> = record.unwrap();
        let number = |key: &str| r[key].parse::<f64>().unwrap();
        let direction = |which: &str| {
            let (az, el) = (number(&format!("{which}_az_rad")), number(&format!("{which}_el_rad")));
            DVec3::new(el.cos() * az.cos(), el.cos() * az.sin(), el.sin())
        };
        let order = number("order") as usize;
        let point =
            |i: usize| DVec3::new(number(&format!("p{i}x")), number(&format!("p{i}y")), number(&format!("p{i}z")));
        rows.entry(r["tx"].clone()).or_default().push(Row {
            order,
            surfaces: r["surfaces"].clone(),
            gain: Complex::new(number("ref_a_re"), number("ref_a_im")),
            baseband: Complex::new(number("ref_abb_re"), number("ref_abb_im")),
            length: number("ref_len_m"),
            departure: direction("aod"),
            arrival: direction("aoa"),
            points: (1..=order).map(point).collect(),
        });
    }
    Some(rows)
}

/// Returns the reference's name of a face.
fn name(simulator: &Simulator, face: u32) -> &'static str {
    let n = simulator.world().faces[face as usize].normal;
    let names =
        [(DVec3::X, "wall_xneg"), (DVec3::NEG_X, "wall_xpos"), (DVec3::Y, "wall_yneg"), (DVec3::NEG_Y, "wall_ypos")];
    let walls = names.into_iter().chain([(DVec3::Z, "floor"), (DVec3::NEG_Z, "ceiling")]);
    walls.into_iter().find(|(normal, _)| normal.dot(n) > 0.999).unwrap().1
}

/// Returns the names of the reflecting faces, as in the reference.
fn surfaces(simulator: &Simulator, path: &PropagationPath) -> String {
    if path.interactions.is_empty() {
        return "LOS".into();
    }
    let names = path.interactions.iter().map(|i| match i {
        Interaction::Reflection { face, .. } => name(simulator, *face),
        other => panic!("{other:?} in an empty room"),
    });
    names.collect::<Vec<_>>().join(">")
}

/// Returns the reflection points.
fn points(path: &PropagationPath) -> Vec<DVec3> {
    let point = |i: &Interaction| match i {
        Interaction::Reflection { point, .. } => Some(*point),
        _ => None,
    };
    path.interactions.iter().filter_map(point).collect()
}

#[test]
fn finds_every_path_of_reference_room_with_its_gain() {
    let txs = [("tx1", [-2.1, 1.4, 1.1]), ("tx2", [0.45, -1.85, 2.35]), ("tx3", [-1.3, -0.65, 0.8])];
    for (megahertz, model) in [(920, "slab"), (920, "halfspace"), (3500, "slab"), (3500, "halfspace")] {
        let Some(expected) = rows(&format!("paths_{megahertz}MHz_{model}.csv")) else { return };
        let simulator = Simulator::new(&reference_room(f64::from(megahertz) * 1e6, model == "slab", 3)).unwrap();
        let wavelength = simulator.scene().wavelength();
        for (tx, position) in txs {
            let paths = simulator.trace(DVec3::from(position));
            assert_eq!(paths.len(), 63);
            let by_name: BTreeMap<String, &PropagationPath> =
                paths.iter().map(|p| (surfaces(&simulator, p), p)).collect();
            let rows = &expected[tx];
            for row in rows {
                let path = by_name.get(&row.surfaces).unwrap_or_else(|| panic!("{tx}: no path {}", row.surfaces));
                let free_space = wavelength / (4.0 * PI * row.length);
                assert_eq!(path.interactions.len(), row.order);
                assert!((path.length - row.length).abs() < 1e-10, "{tx} {}", row.surfaces);
                let error = (path.gain - row.gain).norm() / free_space;
                assert!(error < 1e-9, "{tx} {} {megahertz} {model}: {error:e}", row.surfaces);
                // The directions of the reference have single precision.
                assert!(path.departure.distance(row.departure) < 1e-4 && path.arrival.distance(row.arrival) < 1e-4);
                assert!(points(path).iter().zip(&row.points).all(|(a, b)| a.distance(*b) < 5e-4));
                assert!(path.length_to(DVec3::new(1.7, -0.9, 1.3)) - path.length < 1e-12);
            }
            let sum: Complex = paths.iter().map(|p| p.baseband_gain(wavelength)).sum();
            let reference: Complex = rows.iter().map(|row| row.baseband).sum();
            assert!((sum - reference).norm() < 1e-8 * reference.norm(), "{tx}: {sum} against {reference}");
        }
    }
}

#[test]
fn empty_box_has_known_number_of_images() {
    for (order, count) in [(0, 1), (1, 7), (2, 25), (3, 63), (4, 129), (5, 231)] {
        let simulator = Simulator::new(&reference_room(920e6, true, order)).unwrap();
        for tx in [[-2.1, 1.4, 1.1], [0.45, -1.85, 2.35], [-1.3, -0.65, 0.8]] {
            assert_eq!(simulator.trace(DVec3::from(tx)).len(), count, "order {order}");
        }
    }
}

#[test]
fn separately_traced_antennas_match_reference_channel() {
    let Some(folder) = shared("reference/paths") else { return };
    let mut reader = csv::Reader::from_path(folder.join("sceneA/array_4x4_920MHz_slab.csv")).unwrap();
    let txs = [("tx1", [-2.1, 1.4, 1.1]), ("tx2", [0.45, -1.85, 2.35]), ("tx3", [-1.3, -0.65, 0.8])];
    let mut rows = 0;
    for record in reader.deserialize() {
        let r: BTreeMap<String, String> = record.unwrap();
        let number = |key: &str| r[key].parse::<f64>().unwrap();
        let mut scene = reference_room(920e6, true, 3);
        scene.receiver.position = ["pos_x", "pos_y", "pos_z"].map(number); // single precision, as they were traced
        let simulator = Simulator::new(&scene).unwrap();
        let tx = txs.iter().find(|(name, _)| *name == r["tx"]).unwrap().1;
        let paths = simulator.trace(DVec3::from(tx));
        assert_eq!(paths.len(), number("npaths_ref") as usize);
        let channel: Complex = paths.iter().map(|p| p.baseband_gain(scene.wavelength())).sum();
        let expected = Complex::new(number("ref_real_re"), number("ref_real_im"));
        // The error is relative to the line of sight, because the sum is small in a fade.
        assert!(
            (channel - expected).norm() < 1e-8 * paths[0].gain.norm(),
            "{} {}: {channel} {expected}",
            r["tx"],
            r["elem"]
        );
        rows += 1;
    }
    assert_eq!(rows, 48);
}
