//! Physical laws in every room: closed forms, reciprocity, occlusion, energy.

use crate::common::law_scene as scene;
use glam::DVec3;
use proptest::prelude::*;
use pwrfgs_raytrace::fresnel::reflection;
use pwrfgs_raytrace::{Complex, Interaction, PropagationPath, Simulator};
use std::f64::consts::{PI, TAU};

const WALLS: &str = "(outline: Box(low: (-10, -8, 0), high: (10, 8, 6)), walls: (material: \"concrete\"), \
                     floor: (material: \"concrete\"), ceiling: (material: \"wood\", thickness_m: 0.02))";
const NOTHING: &str = "order: 0, room_order: 0, diffraction: false";

#[test]
fn free_space_gain_matches_friis() {
    let rx = [1.0, -2.0, 3.0];
    let simulator = Simulator::new(&scene(WALLS, "", rx, NOTHING)).unwrap();
    let wavelength = simulator.scene().wavelength();
    for tx in [[-9.0, 7.0, 0.5], [1.0, -1.5, 1.0], [9.9, -7.9, 5.9]] {
        let paths = simulator.trace(DVec3::from(tx));
        let distance = DVec3::from(tx).distance(DVec3::from(rx));
        let [path] = &paths[..] else { panic!("one path") };
        let friis = wavelength / (4.0 * PI * distance);
        assert!((path.gain - friis).norm() < 1e-15 * friis.max(1.0));
        assert!((path.delay() - distance / 299_792_458.0).abs() < 1e-20);
    }
}

#[test]
fn two_rays_over_ground_follow_the_closed_form() {
    // Only the floor reflects: the walls are of air.
    let air = "(outline: Box(low: (-200, -8, 0), high: (200, 8, 60)), walls: (material: \"vacuum\", thickness_m: 0.1), \
               floor: (material: \"medium_dry_ground\"), ceiling: (material: \"vacuum\", thickness_m: 0.1))";
    let simulator =
        Simulator::new(&scene(air, "", [-90.0, 0.0, 2.0], "order: 1, room_order: 1, diffraction: false")).unwrap();
    let wavelength = simulator.scene().wavelength();
    let eta = simulator.scene().material("medium_dry_ground").unwrap().permittivity(2e9);
    for distance in [5.0, 11.0, 30.0, 70.0, 180.0] {
        let height = 1.5;
        let paths = simulator.trace(DVec3::new(-90.0 + distance, 0.0, height));
        let field: Complex = paths.iter().map(|p| p.baseband_gain(wavelength)).sum();
        let wave = |length: f64| Complex::cis(-TAU * length / wavelength) * wavelength / (4.0 * PI * length);
        let (direct, reflected) = (distance.hypot(2.0 - height), distance.hypot(2.0 + height));
        // Upright antennas radiate a TM wave towards the ground.
        let expected =
            wave(direct) + reflection(eta, None, (2.0 + height) / reflected, wavelength).tm * wave(reflected);
        assert!((field - expected).norm() < 1e-12 * expected.norm().max(1e-9), "{distance} m: {field} and {expected}");
    }
}

/// Objects of every kind.
const CLUTTER: &str = "
    Box(name: \"desk\", low: (-1, -2, 0.7), high: (1.5, -1, 0.75), yaw_deg: 20, finish: (material: \"wood\", thickness_m: 0.03)),
    Box(name: \"cupboard\", low: (2, 1, 0), high: (3, 2, 2), finish: (material: \"metal\")),
    Panel(name: \"glass\", from: (-3, -3), to: (-2, 3), heights: (0.2, 2.5), finish: (material: \"glass\", thickness_m: 0.01))";

/// Prepares the room with all objects.
fn cluttered(rx: [f64; 3], propagation: &str) -> Simulator {
    Simulator::new(&scene(WALLS, CLUTTER, rx, propagation)).unwrap()
}

/// Three pairs of positions in the cluttered room.
const PAIRS: [([f64; 3], [f64; 3]); 3] =
    [([-6.0, 1.0, 1.2], [5.0, -3.0, 2.2]), ([0.3, 4.0, 0.4], [-4.0, -5.0, 5.0]), ([2.5, 3.0, 1.0], [2.4, -0.5, 1.1])];

/// Returns the paths from `a` to `b` and from `b` to `a`.
fn both_directions((a, b): ([f64; 3], [f64; 3]), propagation: &str) -> [Vec<PropagationPath>; 2] {
    [(a, b), (b, a)].map(|(from, to)| cluttered(to, propagation).trace(DVec3::from(from)))
}

/// Returns the length and gain of every path, sorted, for comparison of sets.
fn sorted(paths: &[PropagationPath]) -> Vec<(f64, Complex)> {
    let mut all: Vec<(f64, Complex)> = paths.iter().map(|p| (p.length, p.gain)).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.norm().total_cmp(&b.1.norm())));
    all
}

/// Asserts that both sets have the same lengths and gains, to rounding.
fn assert_same(there: &[PropagationPath], back: &[PropagationPath]) {
    assert_eq!(there.len(), back.len());
    for (x, y) in sorted(there).into_iter().zip(sorted(back)) {
        assert!((x.0 - y.0).abs() < 1e-9 && (x.1 - y.1).norm() < 1e-9 * x.1.norm().max(1e-3), "{x:?} and {y:?}");
    }
}

/// Returns the field of all paths at the carrier of [`scene`].
fn field(paths: &[PropagationPath]) -> Complex {
    paths.iter().map(|p| p.baseband_gain(299_792_458.0 / 2e9)).sum()
}

#[test]
fn paths_without_scattering_are_reciprocal() {
    for pair in PAIRS {
        let [there, back] = both_directions(pair, "order: 2, room_order: 3");
        assert_same(&there, &back);
        let (h, reversed) = (field(&there), field(&back));
        assert!((h - reversed).norm() < 1e-9 * h.norm(), "{pair:?}: {h} and {reversed}");
    }
}

/// Effective roughness takes |Γ| at the angle of incidence, and projects the polarisation for the outgoing direction:
/// neither is the same backwards. All other paths are reciprocal.
#[test]
fn scattering_is_not_reciprocal() {
    let is_scattered = |p: &PropagationPath| p.interactions.iter().any(|i| matches!(i, Interaction::Scattering { .. }));
    let mut worst = [0.0_f64; 3];
    for pair in PAIRS {
        let both = both_directions(pair, "order: 2, room_order: 3, roughness: 0.3, patch_m: 1.5");
        let [h, reversed] = both.each_ref().map(|paths| field(paths).norm_sqr());
        let [(rough, smooth), (rough_back, smooth_back)] =
            both.map(|paths| paths.into_iter().partition::<Vec<PropagationPath>, _>(is_scattered));
        assert_same(&smooth, &smooth_back);
        assert!(rough.len() > 100 && rough.len() == rough_back.len(), "{} {}", rough.len(), rough_back.len());
        let decibel = |a: f64, b: f64| 10.0 * (a / b).log10().abs();
        let power = |paths: &[PropagationPath]| paths.iter().map(|p| p.gain.norm_sqr()).sum::<f64>();
        let single = rough.iter().zip(&rough_back).map(|(x, y)| {
            assert!((x.length - y.length).abs() < 1e-9, "the same patches in the same order");
            decibel(x.gain.norm_sqr(), y.gain.norm_sqr())
        });
        let differences =
            [single.fold(0.0, f64::max), decibel(power(&rough), power(&rough_back)), decibel(h, reversed)];
        worst = std::array::from_fn(|k| worst[k].max(differences[k]));
    }
    // One weak patch, all patches together, and the whole field; docs/lab/simulator.md has more pairs.
    for (difference, expected) in worst.into_iter().zip([24.780, 0.463, 0.645]) {
        assert!((difference - expected).abs() < 2e-3, "{worst:?} dB");
    }
}

#[test]
fn solid_blocks_line_of_sight_and_sheet_attenuates_it() {
    let rx = [4.0, 1.5, 1.0];
    let tx = DVec3::new(0.0, 1.5, 1.0); // the cupboard stands between them
    let line_of_sight = |s: &Simulator, tx: DVec3| {
        let direct = |p: &PropagationPath| p.interactions.iter().all(|i| matches!(i, Interaction::Transmission { .. }));
        s.trace(tx).into_iter().find(direct)
    };
    assert!(line_of_sight(&cluttered(rx, NOTHING), tx).is_none());
    assert!(line_of_sight(&cluttered(rx, NOTHING), DVec3::new(0.0, 1.5, 5.5)).is_some());
    let glass = cluttered([-6.0, 0.1, 1.0], NOTHING);
    let behind = line_of_sight(&glass, DVec3::new(0.0, 0.1, 1.0)).unwrap();
    let free = glass.scene().wavelength() / (4.0 * PI * 6.0);
    assert!(matches!(behind.interactions[..], [Interaction::Transmission { .. }]));
    assert!(behind.gain.norm() < 0.95 * free && behind.gain.norm() > 0.5 * free);
    let closed = cluttered([-6.0, 0.1, 1.0], "order: 0, room_order: 0, diffraction: false, transmission: false");
    assert!(line_of_sight(&closed, DVec3::new(0.0, 0.1, 1.0)).is_none());
}

/// Returns the field at the receiver behind the rim of a board, in a room of air.
fn behind_a_board(material: &str, tx: DVec3) -> Complex {
    let air = "(material: \"vacuum\", thickness_m: 0.1)";
    let room =
        format!("(outline: Box(low: (-10, -50, -50), high: (10, 50, 50)), walls: {air}, floor: {air}, ceiling: {air})");
    let board = "Panel(name: \"board\", from: (0, -40), to: (0, 0), heights: (-45, 45), \
                 finish: (material: \"MATERIAL\", thickness_m: 0.01))";
    let board = &board.replace("MATERIAL", material);
    let simulator = Simulator::new(&scene(&room, board, [4.0, -1.5, 0.3], "order: 1, room_order: 0")).unwrap();
    let wavelength = simulator.scene().wavelength();
    simulator.trace(tx).iter().map(|p| p.baseband_gain(wavelength)).sum()
}

#[test]
fn diffraction_makes_field_continuous_at_shadow_edge() {
    // From (-4, y) the line of sight touches the rim (0, 0) at y = 1.5.
    let at = |y: f64| behind_a_board("metal", DVec3::new(-4.0, y, 0.0));
    let jump = (at(1.5 + 1e-6) - at(1.5 - 1e-6)).norm();
    assert!(jump < 1e-3 * at(1.5 + 1e-6).norm(), "{jump:e}");
    // Half of the free field is left there, and it fades into the shadow.
    let free = 299_792_458.0 / 2e9 / (4.0 * PI * DVec3::new(8.0, 3.0, 0.3).length());
    assert!((at(1.5 - 1e-6).norm() / free - 0.5).abs() < 0.02);
    assert!(at(0.5).norm() < 0.25 * free && at(-3.0).norm() < at(0.5).norm());
}

#[test]
fn sheet_edge_diffracts_blocked_field() {
    // Continuous at the edge of the glass, and without effect at the edge of a sheet of air.
    let at = |y: f64| behind_a_board("glass", DVec3::new(-4.0, y, 0.0));
    let jump = (at(1.5 + 1e-6) - at(1.5 - 1e-6)).norm();
    assert!(jump < 1e-3 * at(1.5 + 1e-6).norm(), "{jump:e}");
    for y in [-2.0, 1.4, 1.6, 3.0] {
        let distance = DVec3::new(-4.0, y, 0.0).distance(DVec3::new(4.0, -1.5, 0.3));
        let wavelength = 299_792_458.0 / 2e9;
        let free = Complex::cis(-TAU * distance / wavelength) * wavelength / (4.0 * PI * distance);
        let field = behind_a_board("vacuum", DVec3::new(-4.0, y, 0.0));
        assert!((field - free).norm() < 1e-9 * free.norm(), "{y}: {field} and {free}");
    }
}

#[test]
fn coplanar_faces_reflect_once() {
    let bench = |name: &str, high: &str| {
        format!("Box(name: \"{name}\", low: (-1, -1, 0.5), high: {high}, finish: (material: \"wood\")),")
    };
    let paths = |objects: &str| {
        let simulator = Simulator::new(&scene(WALLS, objects, [0.4, 0.3, 2.0], "order: 1, room_order: 0")).unwrap();
        let paths = simulator.trace(DVec3::new(-0.6, -0.7, 1.8));
        paths.iter().filter(|p| matches!(p.interactions[..], [Interaction::Reflection { .. }])).count()
    };
    let one = paths(&bench("a", "(1, 1, 0.8)"));
    assert_eq!(paths(&(bench("a", "(1, 1, 0.8)") + &bench("b", "(1, 1, 0.8)"))), one);
}

#[test]
fn finds_all_visible_image_sequences_in_cluttered_room() {
    // Every image is tried against a brute force over all pairs of faces, without beams.
    let simulator = cluttered([0.5, 0.5, 1.4], "order: 2, room_order: 2, diffraction: false, transmission: false");
    let world = simulator.world();
    for tx in [[-5.0, 2.0, 1.0], [4.0, -4.0, 3.0], [0.0, -1.5, 0.5]] {
        let tx = DVec3::from(tx);
        let rx = DVec3::new(0.5, 0.5, 1.4);
        let paths = simulator.trace(tx);
        let mut count = 0;
        let faces = world.faces.len() as u32;
        let mut sheets = Vec::new();
        let mut check = |sequence: &[u32]| {
            // Mirror the transmitter, then walk back from the receiver.
            let images: Vec<DVec3> = sequence
                .iter()
                .scan(tx, |image, &f| {
                    *image = world.faces[f as usize].mirror(*image);
                    Some(*image)
                })
                .collect();
            let (mut from, mut open) = (rx, true);
            for (k, &f) in sequence.iter().enumerate().rev() {
                let face = &world.faces[f as usize];
                let (h, g) = (face.height(from), face.height(images[k]));
                if h * g >= 0.0 {
                    return;
                }
                let point = from.lerp(images[k], h / (h - g));
                open &= world.is_on_face(f, point)
                    && world.collect_sheets(from, point, [&[], &[]], &mut sheets)
                    && sheets.is_empty();
                from = point;
            }
            open &= world.collect_sheets(from, tx, [&[], &[]], &mut sheets) && sheets.is_empty();
            count += usize::from(open);
        };
        check(&[]);
        for a in 0..faces {
            check(&[a]);
            (0..faces).filter(|b| *b != a).for_each(|b| check(&[a, b]));
        }
        assert_eq!(paths.len(), count, "from {tx}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn reflection_does_not_increase_energy(x in -4.0..4.0f64, y in -4.0..4.0f64, z in 0.3..5.0f64) {
        let simulator = cluttered([6.0, -5.0, 2.0], "order: 2, room_order: 3, diffraction: false");
        let wavelength = simulator.scene().wavelength();
        let tx = DVec3::new(x, y, z);
        prop_assume!(simulator.world().check_free(tx).is_ok());
        for path in simulator.trace(tx) {
            prop_assert!(path.gain.norm() <= wavelength / (4.0 * PI * path.length) * (1.0 + 1e-12));
            prop_assert!((path.departure.length() - 1.0).abs() < 1e-12 && (path.arrival.length() - 1.0).abs() < 1e-12);
            // The pieces add up to the length.
            let mut at = tx;
            let mut length = 0.0;
            for interaction in &path.interactions {
                let (Interaction::Reflection { point, .. } | Interaction::Transmission { point, .. }
                    | Interaction::Diffraction { point, .. } | Interaction::Scattering { point, .. }) = *interaction;
                length += at.distance(point);
                at = point;
            }
            length += at.distance(DVec3::new(6.0, -5.0, 2.0));
            prop_assert!((length - path.length).abs() < 1e-9);
        }
    }
}
