//! Sheets that a scene describes twice: each counts once.

use crate::common::law_scene;
use glam::DVec3;
use pwrfgs_raytrace::world::Triangle;
use pwrfgs_raytrace::{Interaction, PropagationPath, SceneFile, Simulator};
use std::fmt::Write as _;
use std::fs;

const CORNERS: &str = "v 0 -4 -4\nv 0 4 -4\nv 0 4 4\nv 0 -4 4\n";
const FRONT: &str = "f 1 2 3\nf 1 3 4\n";
const TX: DVec3 = DVec3::new(1.0, 0.5, 0.5);
const ROOM: &str = "(outline: Box(low: (-10, -8, 0), high: (10, 8, 6)), walls: (material: \"concrete\"), \
                    floor: (material: \"concrete\"), ceiling: (material: \"wood\", thickness_m: 0.02))";

/// Returns the simulator of an open scene of these meshes in OBJ, each with a material.
fn open_scene(meshes: &[(&str, &str)]) -> Simulator {
    let folder = tempfile::tempdir().unwrap();
    let mut xml = String::from("<scene version=\"2.1.0\">\n");
    for material in ["concrete", "glass"] {
        let kind = format!("<string name=\"type\" value=\"{material}\"/><float name=\"thickness\" value=\"0.2\"/>");
        writeln!(xml, "<bsdf type=\"itu-radio-material\" id=\"{material}\">{kind}</bsdf>").unwrap();
    }
    for (i, (mesh, material)) in meshes.iter().enumerate() {
        fs::write(folder.path().join(format!("{i}.obj")), mesh).unwrap();
        let file = format!("<string name=\"filename\" value=\"{i}.obj\"/><ref id=\"{material}\" name=\"bsdf\"/>");
        writeln!(xml, "<shape type=\"obj\" id=\"w{i}\">{file}</shape>").unwrap();
    }
    fs::write(folder.path().join("s.xml"), xml + "</scene>\n").unwrap();
    let text = "(name: \"s\", carrier_hz: 3.5e9, mitsuba: \"s.xml\",
        receiver: (position: (-2, 0.3, 0.2), orientation: Facing(direction: (1, 0, 0)), array: (rows: 1, columns: 1)),
        transmitter: (positions: Uniform(low: (1, 0, 0), high: (2, 1, 1))),
        propagation: (order: 2, roughness: 0.3, patch_m: 1.0))";
    fs::write(folder.path().join("s.ron"), text).unwrap();
    Simulator::new(&SceneFile::read(&folder.path().join("s.ron")).unwrap()).unwrap()
}

/// Returns the paths without diffuse ones, whose phases depend on the number of the face, in an order of their own; and
/// the number of diffuse ones.
fn traced(simulator: &Simulator, tx: DVec3) -> (Vec<PropagationPath>, usize) {
    let is_diffuse =
        |path: &PropagationPath| path.interactions.iter().any(|i| matches!(i, Interaction::Scattering { .. }));
    let (diffuse, mut rest): (Vec<_>, Vec<_>) = simulator.trace(tx).into_iter().partition(is_diffuse);
    rest.sort_by(|a, b| a.length.total_cmp(&b.length));
    (rest, diffuse.len())
}

/// Asserts equal paths and areas.
fn assert_equal(simulator: &Simulator, expected: &Simulator, case: &str) {
    assert_equal_to(1e-9, simulator, expected, case);
}

/// Asserts equal paths and areas, gains of diffracted paths to a relative error: the diffraction at a rim depends on the
/// corner order.
fn assert_equal_to(rims: f64, simulator: &Simulator, expected: &Simulator, case: &str) {
    for tx in [TX, DVec3::new(-1.0, -2.0, 1.5), DVec3::new(0.7, 5.0, 0.3)] {
        let ((paths, patches), (expected_paths, expected_patches)) = (traced(simulator, tx), traced(expected, tx));
        assert_eq!(paths.len(), expected_paths.len(), "{case}");
        for (a, b) in paths.iter().zip(&expected_paths) {
            assert_eq!(a.interactions.len(), b.interactions.len(), "{case}");
            assert!((a.length - b.length).abs() < 1e-9, "{case}: {} and {} m", a.length, b.length);
            let is_diffracted = a.interactions.iter().any(|i| matches!(i, Interaction::Diffraction { .. }));
            let error = if is_diffracted { rims } else { 1e-9 };
            assert!((a.gain - b.gain).norm() < error * b.gain.norm(), "{case}: {} and {}", a.gain, b.gain);
        }
        assert!(
            patches.abs_diff(expected_patches) <= expected_patches / 4,
            "{case}: {patches} and {expected_patches} patches"
        );
    }
    let area = |s: &Simulator| s.world().triangles.iter().map(Triangle::area).sum::<f64>();
    assert!((area(simulator) - area(expected)).abs() < 1e-6 * area(expected), "{case}: {} m²", area(simulator));
}

#[test]
fn second_side_in_a_mesh_changes_nothing() {
    let alone = open_scene(&[(&(CORNERS.to_owned() + FRONT), "concrete")]);
    let (paths, _) = traced(&alone, TX);
    assert!(matches!(paths[0].interactions[..], [Interaction::Transmission { .. }]) && paths.len() == 5);
    let middle = "v 0 0.5 -1\n";
    for (case, faces) in [
        ("opposite order", "f 3 2 1\nf 4 3 1\n"),
        ("same order", "f 2 3 1\nf 1 3 4\n"),
        ("three times", "f 3 2 1\nf 4 3 1\nf 1 2 3\nf 1 3 4\n"),
        ("other diagonal", "f 4 2 1\nf 4 3 2\n"),
        ("finer", "v 0 0.5 -1\nf 5 2 1\nf 5 3 2\nf 5 4 3\nf 5 1 4\n"),
        ("own corners", "v 0 -4 -4\nv 0 4 -4\nv 0 4 4\nv 0 -4 4\nf 7 6 5\nf 8 7 5\n"),
        ("rounded corners", "v 1e-7 -4 -4\nv 0 4.0000001 -4\nv 0 4 4\nv 0 -4 4\nf 7 6 5\nf 8 7 5\n"),
    ] {
        assert_equal(&open_scene(&[(&format!("{CORNERS}{FRONT}{faces}"), "concrete")]), &alone, case);
    }
    let coarser = format!("{CORNERS}{middle}f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\nf 3 2 1\nf 4 3 1\n");
    assert_equal(&open_scene(&[(&coarser, "concrete")]), &alone, "coarser");
    // From -4 to 2 on one side, from -2 to 4 on the other.
    let halves = "v 0 -4 -4\nv 0 2 -4\nv 0 2 4\nv 0 -4 4\nv 0 -2 -4\nv 0 4 -4\nv 0 4 4\nv 0 -2 4\n\
                  f 1 2 3\nf 1 3 4\nf 7 6 5\nf 8 7 5\n";
    assert_equal_to(3.0, &open_scene(&[(halves, "concrete")]), &alone, "opposite overlap");
    let halves = halves.replace("f 7 6 5\nf 8 7 5", "f 5 6 7\nf 5 7 8");
    assert_equal(&open_scene(&[(&halves, "concrete")]), &alone, "overlap");
    // Halves that share no corner on their seam.
    let seam = "v 0 -4 -4\nv 0 0 -4\nv 0 0 4\nv 0 -4 4\nv 0 4 -4\nv 0 4 4\nv 0 1e-7 0\nv 0 1e-7 -4\nv 0 1e-7 4\n\
                f 1 2 3\nf 1 3 4\nf 8 5 7\nf 5 6 7\nf 7 6 9\n";
    assert_equal(&open_scene(&[(seam, "concrete")]), &alone, "seam");
}

#[test]
fn sheet_in_two_meshes_counts_once() {
    let front = CORNERS.to_owned() + FRONT;
    let alone = open_scene(&[(&front, "concrete")]);
    for (case, back) in [
        ("opposite order", "f 3 2 1\nf 4 3 1\n"),
        ("same order", FRONT),
        ("other diagonal", "f 4 2 1\nf 4 3 2\n"),
        ("finer", "v 0 0.5 -1\nf 5 2 1\nf 5 3 2\nf 5 4 3\nf 5 1 4\n"),
        ("smaller", "v 0 -1 -1\nv 0 1 -1\nv 0 1 1\nf 5 6 7\n"),
    ] {
        let back = CORNERS.to_owned() + back;
        assert_equal(&open_scene(&[(&front, "concrete"), (&back, "concrete")]), &alone, case);
    }
    let one = "v 0 -4 -4\nv 0 2 -4\nv 0 2 4\nv 0 -4 4\nf 1 2 3\nf 1 3 4\n";
    let other = "v 0 -2 -4\nv 0 4 -4\nv 0 4 4\nv 0 -2 4\n";
    let overlap = |faces: &str| open_scene(&[(one, "concrete"), (&format!("{other}{faces}"), "concrete")]);
    assert_equal(&overlap(FRONT), &alone, "overlap");
    assert_equal_to(3.0, &overlap("f 3 2 1\nf 4 3 1\n"), &alone, "opposite overlap");
    // Sheets of different materials are two sheets.
    let (paths, _) = traced(&open_scene(&[(&front, "concrete"), (&front, "glass")]), TX);
    assert_eq!(paths[0].interactions.len(), 2);
}

#[test]
fn folded_and_closed_surfaces_count_once() {
    let fold = "v 0 -4 -4\nv 0 4 -4\nv 0 4 4\nv 0 -4 4\nv 3 4 -4\nv 3 4 4\nf 1 2 3\nf 1 3 4\nf 2 5 6\nf 2 6 3\n";
    let back = "f 3 2 1\nf 4 3 1\nf 6 5 2\nf 3 6 2\n";
    let alone = open_scene(&[(fold, "concrete")]);
    assert_equal(&open_scene(&[(&format!("{fold}{back}"), "concrete")]), &alone, "two-sided fold");
    assert_equal(&open_scene(&[(fold, "concrete"), (fold, "concrete")]), &alone, "two folds");
    // The second mesh repeats a wing, or the first does.
    let wing = "v 0 4 -4\nv 3 4 -4\nv 3 4 4\nv 0 4 4\nf 1 2 3\nf 1 3 4\n";
    assert_equal(&open_scene(&[(fold, "concrete"), (wing, "concrete")]), &alone, "fold and wing");
    assert_equal(&open_scene(&[(wing, "concrete"), (fold, "concrete")]), &alone, "wing and fold");
    let cube = "v 2 -1 -1\nv 4 -1 -1\nv 4 1 -1\nv 2 1 -1\nv 2 -1 1\nv 4 -1 1\nv 4 1 1\nv 2 1 1\n\
                f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    let inner = "f 1 2 3 4\nf 8 7 6 5\nf 5 6 2 1\nf 6 7 3 2\nf 7 8 4 3\nf 8 5 1 4\n";
    let alone = open_scene(&[(cube, "glass")]);
    assert_equal(&open_scene(&[(&format!("{cube}{inner}"), "glass")]), &alone, "two-sided cube");
    assert_equal(&open_scene(&[(cube, "glass"), (cube, "glass")]), &alone, "two cubes");
}

#[test]
fn two_sided_body_is_solid_and_two_sided_plate_is_open() {
    let folder = tempfile::tempdir().unwrap();
    let simulator = |mesh: &str, finish: &str| {
        let file = folder.path().join("m.obj");
        fs::write(&file, mesh).unwrap();
        let object = format!("Mesh(name: \"m\", file: {file:?}, finish: (material: \"wood\"{finish})),");
        Simulator::new(&law_scene(ROOM, &object, [-3.0, 0.0, 2.0], "order: 2, room_order: 1"))
    };
    let cube = "v 2 -1 1\nv 4 -1 1\nv 4 1 1\nv 2 1 1\nv 2 -1 3\nv 4 -1 3\nv 4 1 3\nv 2 1 3\n\
                f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    let inner = "f 1 2 3 4\nf 8 7 6 5\nf 5 6 2 1\nf 6 7 3 2\nf 7 8 4 3\nf 8 5 1 4\n";
    for finish in ["", ", thickness_m: 0.02"] {
        let alone = simulator(cube, finish).unwrap();
        for mesh in [
            format!("{cube}{inner}"),
            format!("{}{inner}{}", &cube[..cube.find('f').unwrap()], &cube[cube.find('f').unwrap()..]),
        ] {
            let two_sided = simulator(&mesh, finish).unwrap();
            assert_equal(&two_sided, &alone, finish);
            let error = two_sided.world().check_free(DVec3::new(3.0, 0.0, 2.0)).unwrap_err();
            assert!(error.contains("inside `m`"), "{error}");
        }
    }
    let plate = "v 2 -1 1\nv 2 1 1\nv 2 1 3\nf 1 2 3\nf 3 2 1\n";
    assert!(simulator(plate, "").unwrap_err().to_string().contains("is open"));
    // Bodies that touch in one mesh are closed, and their common side is one sheet.
    let second = "v 6 -1 1\nv 6 1 1\nv 6 -1 3\nv 6 1 3\nf 2 3 10 9\nf 6 11 12 7\nf 2 9 11 6\nf 9 10 12 11\nf 10 3 7 12\nf 2 6 7 3\n";
    let pair = format!("{cube}{second}");
    assert!(simulator(&pair, "").is_ok());
    let through = |simulator: &Simulator| traced(simulator, DVec3::new(8.0, 0.0, 2.0)).0[0].interactions.len();
    assert_eq!(through(&simulator(&pair, ", thickness_m: 0.02").unwrap()), 3);
    // Boxes that touch have two shells.
    let boxes = "Box(name: \"a\", low: (2, -1, 1), high: (4, 1, 3), finish: (material: \"wood\", thickness_m: 0.02)),\
                 Box(name: \"b\", low: (4, -1, 1), high: (6, 1, 3), finish: (material: \"wood\", thickness_m: 0.02)),";
    let scene = law_scene(ROOM, boxes, [-3.0, 0.0, 2.0], "order: 2, room_order: 1");
    assert_eq!(through(&Simulator::new(&scene).unwrap()), 4);
    // An opening before the second box leaves one of the two sheets.
    let opening = "Opening(name: \"o\", from: (4, -1), to: (4, 1), heights: (1, 3)), Box(name: \"b\"";
    let scene =
        law_scene(ROOM, &boxes.replace("Box(name: \"b\"", opening), [-3.0, 0.0, 2.0], "order: 2, room_order: 1");
    assert_eq!(through(&Simulator::new(&scene).unwrap()), 3);
}
