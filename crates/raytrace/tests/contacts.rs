//! Objects on walls and on each other, and openings, compared with closed forms.

use crate::common::law_scene as scene;
use glam::DVec3;
use pwrfgs_raytrace::fresnel::{reflection, transmission};
use pwrfgs_raytrace::world::Triangle;
use pwrfgs_raytrace::{Complex, Interaction, PropagationPath, SceneFile, Simulator};
use std::f64::consts::PI;

const WALLS: &str = "(outline: Box(low: (-10, -8, 0), high: (10, 8, 6)), walls: (material: \"concrete\"), \
                     floor: (material: \"concrete\"), ceiling: (material: \"wood\", thickness_m: 0.02))";
const ONCE: &str = "order: 1, room_order: 1, diffraction: false";
const WAVELENGTH: f64 = 299_792_458.0 / 2e9;

/// Returns a panel 1 cm thick.
fn panel(name: &str, from: &str, to: &str, heights: &str, material: &str) -> String {
    format!(
        "Panel(name: \"{name}\", from: {from}, to: {to}, heights: {heights}, \
         finish: (material: \"{material}\", thickness_m: 0.01)),"
    )
}

/// Returns an opening called `door`.
fn opening(from: &str, to: &str, heights: &str) -> String {
    format!("Opening(name: \"door\", from: {from}, to: {to}, heights: {heights}),")
}

/// Prepares the walls with these objects and a receiver at `rx`.
fn simulator(objects: &str, rx: [f64; 3], propagation: &str) -> Simulator {
    Simulator::new(&scene(WALLS, objects, rx, propagation)).unwrap()
}

/// Returns the error of a scene with these objects.
fn refused(objects: &str) -> String {
    let error = Simulator::new(&scene(WALLS, objects, [5.0, 0.0, 1.0], ONCE)).unwrap_err();
    assert!(error.is_input());
    error.to_string()
}

/// Returns the paths of a single reflection, at x = `x`.
fn single_reflections(paths: &[PropagationPath], x: f64) -> Vec<&PropagationPath> {
    let is_single_reflection = |p: &&PropagationPath| match p.interactions[..] {
        [Interaction::Reflection { point, .. }] => (point.x - x).abs() < 1e-3,
        _ => false,
    };
    paths.iter().filter(is_single_reflection).collect()
}

/// Returns the TE gain of the path from (4, -y) by the plane x = 10 to (4, y), at one height.
fn expected_gain(material: &str, thickness: Option<f64>, y: f64) -> Complex {
    let eta = pwrfgs_raytrace::material::itu_material(material).unwrap().permittivity(2e9);
    let length = 2.0 * 6.0_f64.hypot(y);
    reflection(eta, thickness, 6.0 / 6.0_f64.hypot(y), WAVELENGTH).te * WAVELENGTH / (4.0 * PI * length)
}

/// Returns the traced gain of that path, the only reflection there.
fn traced_gain(objects: &str, y: f64, z: f64) -> Complex {
    let paths = simulator(objects, [4.0, y, z], ONCE).trace(DVec3::new(4.0, -y, z));
    let [path] = single_reflections(&paths, 10.0)[..] else {
        panic!("one path, not {:?}", single_reflections(&paths, 10.0))
    };
    path.gain
}

/// Asserts equal gains, to rounding.
fn assert_near(gain: Complex, expected: Complex) {
    assert!((gain - expected).norm() < 1e-9 * expected.norm(), "{gain} and {expected}");
}

#[test]
fn panel_on_wall_replaces_reflection_of_wall() {
    for material in ["metal", "wood"] {
        // In the plane of the wall, and within the contact tolerance of 0.1 mm on either side.
        for x in ["10", "9.99995", "10.00005"] {
            let board = panel("board", &format!("({x}, -2)"), &format!("({x}, 2)"), "(1, 3)", material);
            let gain = traced_gain(&board, 3.0, 2.0);
            let truth = expected_gain(material, Some(0.01), 3.0);
            assert!((gain - truth).norm() < 1e-4 * truth.norm(), "{material} at {x}: {gain} and {truth}");
            if x == "10" {
                assert_near(gain, truth);
            }
            assert_near(traced_gain(&board, 3.0, 4.0), expected_gain("concrete", None, 3.0)); // above it
        }
    }
}

#[test]
fn panel_on_box_and_box_in_wall_reflect() {
    // In either order of the file, and once where both are the same.
    let cupboard = "Box(name: \"cupboard\", low: (10, -3, 0), high: (10.5, 3, 3), finish: (material: \"marble\")),";
    assert_near(traced_gain(cupboard, 3.0, 2.0), expected_gain("marble", None, 3.0));
    let board = panel("board", "(10, -1)", "(10, 1)", "(1, 3)", "wood");
    for objects in [cupboard.to_owned() + &board, board.clone() + cupboard] {
        assert_near(traced_gain(&objects, 3.0, 2.0), expected_gain("wood", Some(0.01), 3.0));
    }
    let twice = board + &panel("board 2", "(10, -1)", "(10, 1)", "(1, 3)", "metal");
    assert_near(traced_gain(&twice, 3.0, 2.0), expected_gain("wood", Some(0.01), 3.0));
}

#[test]
fn waves_pass_both_of_two_coincident_sheets() {
    let partition = panel("partition", "(0, -5)", "(0, 5)", "(0.1, 5)", "glass");
    let board = panel("board", "(0, -1)", "(0, 1)", "(1, 3)", "wood");
    let through = |objects: &str| {
        let paths = simulator(objects, [4.0, 0.0, 2.0], ONCE).trace(DVec3::new(-4.0, 0.0, 2.0));
        let is_straight =
            |p: &PropagationPath| p.interactions.iter().all(|i| matches!(i, Interaction::Transmission { .. }));
        let straight: Vec<PropagationPath> = paths.into_iter().filter(is_straight).collect();
        assert_eq!(straight.len(), 1);
        straight[0].gain
    };
    let t = |material: &str| {
        let eta = pwrfgs_raytrace::material::itu_material(material).unwrap().permittivity(2e9);
        transmission(eta, 0.01, 1.0, WAVELENGTH).te
    };
    let free = WAVELENGTH / (4.0 * PI * 8.0);
    assert_near(through(&partition), t("glass") * free);
    assert_near(through(&(partition + &board)), t("glass") * t("wood") * free);
}

#[test]
fn back_of_wall_reflects_and_ignores_panel_in_front() {
    // A U about a yard: from the right leg waves pass the wall x = 2, and meet the wall x = -2 from behind.
    let corners = "(-6, -6), (-2, -6), (-2, 0), (2, 0), (2, -6), (6, -6), (6, 6), (-6, 6)";
    let room = format!(
        "(outline: Plan(corners: [{corners}], ceiling: 4), walls: (material: \"plasterboard\", thickness_m: 0.02), \
          floor: (material: \"concrete\"), ceiling: (material: \"concrete\"))"
    );
    let traced_gain = |objects: &str, x: f64| {
        let simulator = Simulator::new(&scene(&room, objects, [x, -2.0, 2.0], ONCE)).unwrap();
        let is_there =
            |i: &Interaction| matches!(i, Interaction::Reflection { point, .. } if (point.x + 2.0).abs() < 1e-9);
        let mut paths = simulator.trace(DVec3::new(x, -3.0, 2.0));
        paths.retain(|p| p.interactions.iter().any(is_there));
        let [path] = &paths[..] else { panic!("one path, not {paths:?}") };
        assert_eq!(path.interactions.len(), if x > 0.0 { 3 } else { 1 });
        path.gain
    };
    let board = panel("board", "(-2, -5)", "(-2, -0.1)", "(0.5, 3.5)", "metal");
    assert_near(traced_gain(&board, 4.0), traced_gain("", 4.0));
    assert!(traced_gain(&board, -4.0).norm() > 1.5 * traced_gain("", -4.0).norm());
}

#[test]
fn opening_transmits_all_and_reflects_none() {
    let wall = panel("partition", "(0, -5)", "(0, 5)", "(0.1, 5)", "metal");
    let door = opening("(0, -1)", "(0, 1)", "(1, 3)");
    let paths = |objects: &str, to: [f64; 3]| simulator(objects, to, ONCE).trace(DVec3::new(-4.0, 0.0, 2.0));
    let straight = |paths: &[PropagationPath]| paths.iter().find(|p| p.interactions.is_empty()).map(|p| p.gain);
    let both = wall.clone() + &door;
    assert_near(straight(&paths(&both, [4.0, 0.0, 2.0])).unwrap(), (WAVELENGTH / (4.0 * PI * 8.0)).into());
    assert!(straight(&paths(&wall, [4.0, 0.0, 2.0])).is_none());
    assert!(straight(&paths(&both, [4.0, 4.0, 2.0])).is_none());
    // Its middle reflects nothing, the partition beside it does.
    assert_eq!(single_reflections(&paths(&both, [-3.0, 0.0, 2.0]), 0.0).len(), 0);
    assert_eq!(single_reflections(&paths(&wall, [-3.0, 0.0, 2.0]), 0.0).len(), 1);
    assert_eq!(single_reflections(&paths(&both, [-4.0, 4.0, 2.0]), 0.0).len(), 1);
    // The door is closed again by what comes after it.
    let closed = both + &panel("leaf", "(0, -1)", "(0, 1)", "(1, 3)", "wood");
    let met = paths(&closed, [-4.0, 0.5, 2.0]);
    let [path] = single_reflections(&met, 0.0)[..] else { panic!("one path") };
    assert!(path.gain.norm() < 0.5 * expected_gain("metal", None, 0.25).norm());
    // In a wall of the room, with its floor to the ground.
    let out = simulator(&opening("(10, -1)", "(10, 1)", "(0, 3)"), [4.0, 3.0, 2.0], ONCE);
    assert_eq!(single_reflections(&out.trace(DVec3::new(4.0, -3.0, 2.0)), 10.0).len(), 0);
    assert_eq!(single_reflections(&out.trace(DVec3::new(4.0, 1.0, 2.0)), 10.0).len(), 1);
}

#[test]
fn opening_removes_patches_points_and_area() {
    let rough = "order: 0, room_order: 0, diffraction: false, roughness: 0.4, patch_m: 0.5";
    let open = simulator(&opening("(10, -2)", "(10, 2)", "(0, 3)"), [0.0, 0.0, 2.0], rough);
    let is_inside = |p: DVec3| p.x > 9.999 && p.y.abs() < 2.0 && p.z < 3.0;
    let scattered = |s: &Simulator| {
        let points = s.trace(DVec3::new(1.0, 1.0, 1.0)).into_iter().filter_map(|p| match p.interactions[..] {
            [Interaction::Scattering { point, .. }] => Some(point),
            _ => None,
        });
        points.collect::<Vec<DVec3>>()
    };
    let closed = simulator("", [0.0, 0.0, 2.0], rough);
    assert_eq!(scattered(&closed).iter().filter(|p| is_inside(**p)).count(), 8 * 6);
    assert_eq!(scattered(&open).len(), scattered(&closed).len() - 8 * 6);
    assert!(!scattered(&open).into_iter().any(is_inside));
    assert!(!open.surface_points(5000, 0).points.into_iter().any(is_inside));
    let area = |s: &Simulator| s.world().triangles.iter().map(Triangle::area).sum::<f64>();
    assert!((area(&closed) - area(&open) - 12.0).abs() < 1e-9);
    // A patch under a board scatters from the board alone.
    let covered = simulator(&panel("board", "(10, -2)", "(10, 2)", "(0, 3)", "wood"), [0.0, 0.0, 2.0], rough);
    assert_eq!(scattered(&covered).len(), scattered(&closed).len());
}

const AIR: &str = "(outline: Box(low: (-10, -50, -50), high: (10, 50, 50)), walls: (material: \"vacuum\", thickness_m: 0.1), \
                   floor: (material: \"vacuum\", thickness_m: 0.1), ceiling: (material: \"vacuum\", thickness_m: 0.1))";

/// Returns the field at a receiver behind the plane x = 0, in a room of air.
fn field_behind(objects: &str, tx: DVec3) -> Complex {
    let simulator = Simulator::new(&scene(AIR, objects, [4.0, -1.5, 0.3], "order: 1, room_order: 0")).unwrap();
    simulator.trace(tx).iter().map(|p| p.baseband_gain(WAVELENGTH)).sum()
}

#[test]
fn opening_to_panel_end_equals_shorter_panel() {
    for material in ["metal", "glass"] {
        let short = panel("a", "(0, -40)", "(0, 0)", "(-45, 45)", material);
        let long = panel("a", "(0, -40)", "(0, 20)", "(-45, 45)", material);
        let cut = long.clone() + &opening("(0, 0)", "(0, 20)", "(-45, 45)");
        for y in [-3.0, 0.5, 1.4, 1.6, 3.0] {
            let tx = DVec3::new(-4.0, y, 0.0);
            let (field, truth) = (field_behind(&cut, tx), field_behind(&short, tx));
            assert!((field - truth).norm() < 1e-9 * truth.norm(), "{material} {y}: {field} and {truth}");
        }
    }
    // The side of a box: if one of two faces is removed, the other gets a rim.
    let closet =
        "Box(name: \"closet\", low: (0, -4, -3), high: (2, 0, 3), finish: (material: \"metal\", thickness_m: 0.01)),";
    let edges =
        |objects: &str| Simulator::new(&scene(AIR, objects, [4.0, -1.5, 0.3], ONCE)).unwrap().world().edges.clone();
    assert_eq!(edges(closet).len(), 12);
    let open = edges(&(closet.to_owned() + &opening("(0, -4)", "(0, 0)", "(-3, 3)")));
    assert_eq!((open.len(), open.iter().filter(|e| e.faces[0] == e.faces[1]).count()), (12, 4));
}

#[test]
fn edges_of_opening_diffract() {
    let wall = panel("a", "(0, -40)", "(0, 40)", "(-45, 45)", "metal") + &opening("(0, 0)", "(0, 3)", "(-20, 20)");
    // From (-4, y) the line of sight touches the rim at y = 0 for y = 1.5, and that at y = 3 for y = 7.5.
    for y in [1.5, 7.5] {
        let at = |y: f64| field_behind(&wall, DVec3::new(-4.0, y, 0.0));
        let jump = (at(y + 1e-6) - at(y - 1e-6)).norm();
        assert!(jump < 2e-3 * at(y).norm(), "{y}: {jump:e}");
    }
    let rims = Simulator::new(&scene(AIR, &wall, [4.0, -1.5, 0.3], ONCE)).unwrap().world().edges.len();
    assert_eq!(rims, 4 + 4);
    // A board on a wall has no rim, and takes no edge from the wall.
    let closet =
        "Box(name: \"closet\", low: (0, -4, -3), high: (2, 0, 3), finish: (material: \"metal\", thickness_m: 0.01)),";
    let board = closet.to_owned() + &panel("b", "(0, -4)", "(0, 0)", "(-3, 3)", "wood");
    assert_eq!(Simulator::new(&scene(AIR, &board, [4.0, -1.5, 0.3], ONCE)).unwrap().world().edges.len(), 12);
}

#[test]
fn rejects_opening_outside_surface() {
    let nothing = refused(&opening("(1, 0)", "(2, 0)", "(0, 2)"));
    assert!(
        nothing.contains("opening `door` does not lie wholly on a wall, a panel or the side of a box"),
        "{nothing}"
    );
    refused(&opening("(10, 0)", "(10, 1)", "(-0.5, 2)")); // half of it below the floor
    refused(&(opening("(1, 0)", "(2, 0)", "(0, 2)") + &panel("late", "(0, 0)", "(3, 0)", "(0, 3)", "wood")));
    let solid = "Box(name: \"safe\", low: (0, 0, 0), high: (2, 2, 2), finish: (material: \"metal\")),";
    let message = refused(&(solid.to_owned() + &opening("(0, 0.5)", "(0, 1)", "(0.5, 1)")));
    assert!(message.contains("opens `safe`, which is solid"), "{message}");
}

#[test]
fn opening_moves_with_its_wall_in_perturbed_scene() {
    use pwrfgs_core::{Baseline, DataSource, FittingSet, Plugin};
    let folder = tempfile::tempdir().unwrap();
    let objects = opening("(10, -1)", "(10, 1)", "(0, 6)")
        + "Box(name: \"closet\", low: (2, 2, 0), high: (4, 4, 2), yaw_deg: 20, finish: (material: \"wood\", thickness_m: 0.02)),"
        + &panel("partition", "(-5, -5)", "(-5, 5)", "(0.1, 5)", "glass")
        + "Opening(name: \"door 2\", from: (-5, 1), to: (-5, 2), heights: (0.1, 2)),";
    let file = folder.path().join("open.ron");
    std::fs::write(&file, scene(WALLS, &objects, [0.0, 0.0, 1.0], ONCE).to_ron()).unwrap();
    let source: Plugin<dyn DataSource> =
        Plugin::parse("Simulated(scene: \"open.ron\", samples: 5, points: 100, cache: false)").unwrap();
    let data = source.load(folder.path(), &|_, _| {}).unwrap();
    for seed in 0..5 {
        let text = format!("RayTracing(material_error: 0.2, position_error_m: 0.05, seed: {seed})");
        let baseline: Plugin<dyn Baseline> = Plugin::parse(&text).unwrap();
        baseline.fit(&data, FittingSet::default()).map(|_| ()).unwrap();
    }
}

/// The scene survives being written.
#[test]
fn opening_round_trips_through_ron() {
    let made = scene(WALLS, &opening("(10, -1)", "(10, 1)", "(0, 3)"), [0.0, 0.0, 1.0], ONCE);
    assert_eq!(SceneFile::parse(&made.to_ron(), std::path::Path::new("a.ron")).unwrap(), made);
}
