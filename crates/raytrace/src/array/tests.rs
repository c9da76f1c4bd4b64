use super::*;
use crate::SPEED_OF_LIGHT;
use glam::DMat3;
use pwrfgs_core::testing::shared;
use std::collections::HashMap;

const WAVELENGTH: f64 = 0.3258;

/// Returns the line of sight between isotropic antennas.
fn line_of_sight(from: DVec3, to: DVec3) -> PropagationPath {
    let length = from.distance(to);
    PropagationPath {
        gain: Complex::new(WAVELENGTH / (2.0 * TAU * length), 0.0),
        length,
        departure: (to - from) / length,
        arrival: (from - to) / length,
        source: from,
        before: 0.0,
        interactions: vec![],
    }
}

#[test]
fn reports_each_invalid_array() {
    let good = Array::default();
    assert_eq!(good.check(), Ok(()));
    let cases = [
        (Array { rows: 0, ..good.clone() }, "array: `rows` is 0; give 1 to 32 antennas"),
        (
            Array { positions_wavelengths: vec![[0.0; 3]; 2], ..good.clone() },
            "array: `positions_wavelengths`: antennas 1 and 2 are both at (0, 0, 0); give each antenna its own position",
        ),
        (
            Array { polarization: [0.0; 3], ..good.clone() },
            "array: `polarization` is [0.0, 0.0, 0.0]; give an axis such as (0, 1, 0)",
        ),
        (
            Array { element: Element::Patch { exponent: -1.0 }, ..good.clone() },
            "array: `exponent` of Patch is -1; give 0 to 100, usually 1",
        ),
    ];
    for (array, message) in cases {
        assert_eq!(array.check(), Err(message.to_owned()));
    }
    assert!(Array { polarization: [0.0, f64::INFINITY, 0.0], ..good }.check().is_err());
}

#[test]
fn vertical_axis_gives_theta_polarisation() {
    for (zenith, azimuth) in [(0.3, 0.1), (1.2, 2.5), (2.9, -1.0), (1e-7, 0.4), (1e-11, 0.4)] {
        let ((st, ct), (sp, cp)) = (f64::sin_cos(zenith), f64::sin_cos(azimuth));
        let direction = DVec3::new(st * cp, st * sp, ct);
        let (amplitude, field) = Element::Isotropic.response(DVec3::Z, direction);
        assert!(field.abs_diff_eq(DVec3::new(ct * cp, ct * sp, -st), 1e-9), "{zenith}: {field}");
        assert!(field.dot(direction).abs() < 1e-15);
        assert_eq!(amplitude, 1.0);
        let (amplitude, _) = Element::Dipole.response(DVec3::Z, direction);
        assert!((amplitude - st).abs() < 1e-15);
    }
}

#[test]
fn field_on_axis_is_unit_vector() {
    for axis in [DVec3::X, DVec3::Y, DVec3::NEG_Z, DVec3::new(1.0, 2.0, -3.0).normalize()] {
        for direction in [axis, -axis] {
            for (element, amplitude) in [(Element::Isotropic, 1.0), (Element::Dipole, 0.0)] {
                let (computed, field) = element.response(axis, direction);
                assert!((computed - amplitude).abs() < 1e-15);
                assert!((field.length() - 1.0).abs() < 1e-14 && field.dot(direction).abs() < 1e-14, "{axis} {field}");
            }
        }
    }
}

#[test]
fn patch_antenna_has_no_backward_radiation() {
    let patch = Element::Patch { exponent: 2.0 };
    let towards = |z: f64| patch.response(DVec3::Y, DVec3::new((1.0 - z * z).sqrt(), 0.0, z)).0;
    assert_eq!([towards(1.0), towards(0.5), towards(0.0), towards(-0.5)], [1.0, 0.25, 0.0, 0.0]);
    let half_space = Element::Patch { exponent: 0.0 };
    assert_eq!(half_space.response(DVec3::Y, DVec3::X).0, 0.0);
    assert_eq!(half_space.response(DVec3::Y, DVec3::Z).0, 1.0);
}

#[test]
fn spherical_wave_approaches_plane_wave_at_distance() {
    let array = Array::default();
    let center = DVec3::new(1.0, -2.0, 0.5);
    let turn = DMat3::from_euler(glam::EulerRot::ZYX, 0.4, -1.1, 2.0);
    let direction = DVec3::new(0.3, -0.5, 0.8).normalize();
    // The sagitta a²/(2d) of the farthest element, a = 0.35 m, makes the difference: 2π/λ · 0.06/d radians.
    for distance in [10.0, 100.0, 1000.0] {
        let path = line_of_sight(center + turn * direction * distance, center);
        let elements: Vec<DVec3> = array.offsets(WAVELENGTH).iter().map(|offset| center + turn * *offset).collect();
        let channel =
            |wavefront| array_channel(std::slice::from_ref(&path), &elements, center, &[WAVELENGTH], wavefront);
        let (spherical, plane) = (channel(ArrayWavefront::Spherical), channel(ArrayWavefront::Plane));
        let worst = spherical.iter().zip(&plane).map(|(a, b)| (a / b - 1.0).norm()).fold(0.0, f64::max);
        assert!(worst < 1.2 / distance && worst > 0.1 / distance, "{distance} m: {worst}");
        let expected =
            |offset: &DVec3| path.baseband_gain(WAVELENGTH) * Complex::cis(TAU / WAVELENGTH * offset.dot(direction));
        for (h, offset) in plane.iter().zip(array.offsets(WAVELENGTH)) {
            assert!((h / expected(&offset) - 1.0).norm() < 1e-9);
        }
    }
}

#[test]
fn channel_without_paths_is_zero() {
    let elements = Array::default().offsets(1.0);
    let channel = array_channel(&[], &elements, DVec3::ZERO, &[1.0], ArrayWavefront::Spherical);
    assert_eq!(channel, vec![Complex::ZERO; 16]);
}

type Row = HashMap<String, String>;

/// Returns a number of a reference table.
fn number(row: &Row, name: &str) -> f64 {
    row[name].parse().unwrap()
}

/// Returns the rows of a reference table by column; `None` with a note if it is missing.
fn reference(name: &str) -> Option<Vec<Row>> {
    let mut reader = csv::Reader::from_path(shared(&format!("reference/paths/sceneA/{name}"))?).unwrap();
    Some(reader.deserialize().map(|row| row.unwrap()).collect())
}

/// Position of the reference's receiver.
const CENTER: DVec3 = DVec3::new(1.7, -0.9, 1.3);

/// Returns the path of the reference. Its directions have single precision, so the image of the transmitter is computed
/// from the names of the walls.
fn reference_path(row: &Row) -> PropagationPath {
    let mut source = match row["tx"].as_str() {
        "tx1" => DVec3::new(-2.1, 1.4, 1.1),
        "tx2" => DVec3::new(0.45, -1.85, 2.35),
        _ => DVec3::new(-1.3, -0.65, 0.8),
    };
    for surface in row["surfaces"].split('>') {
        let (coordinate, wall) = match surface {
            "wall_xneg" => (&mut source.x, -3.0),
            "wall_xpos" => (&mut source.x, 3.0),
            "wall_yneg" => (&mut source.y, -2.5),
            "wall_ypos" => (&mut source.y, 2.5),
            "floor" => (&mut source.z, 0.0),
            "ceiling" => (&mut source.z, 3.0),
            _ => continue,
        };
        *coordinate = 2.0 * wall - *coordinate;
    }
    let length = number(row, "ref_len_m");
    let arrival = (source - CENTER) / length;
    let (az, el) = (number(row, "aoa_az_rad"), number(row, "aoa_el_rad"));
    let reference = DVec3::new(el.cos() * az.cos(), el.cos() * az.sin(), el.sin());
    assert!(arrival.abs_diff_eq(reference, 1e-4) && (source.distance(CENTER) - length).abs() < 1e-10);
    let gain = Complex::new(number(row, "ref_a_re"), number(row, "ref_a_im"));
    PropagationPath { gain, length, departure: DVec3::X, arrival, source, before: 0.0, interactions: vec![] }
}

#[test]
fn channel_matches_reference_array() {
    let (Some(array), Some(paths)) = (reference("array_4x4_920MHz_slab.csv"), reference("paths_920MHz_slab.csv"))
    else {
        return;
    };
    let wavelength = SPEED_OF_LIGHT / 920e6;
    let (mut plane_error, mut spherical_error) = (0.0, 0.0);
    for tx in ["tx1", "tx2", "tx3"] {
        let rows: Vec<&Row> = array.iter().filter(|row| row["tx"] == tx).collect();
        let paths: Vec<PropagationPath> = paths.iter().filter(|row| row["tx"] == tx).map(reference_path).collect();
        assert_eq!((rows.len(), paths.len()), (16, 63));
        let rel = |row: &&Row| DVec3::new(number(row, "rel_x"), number(row, "rel_y"), number(row, "rel_z"));
        let elements: Vec<DVec3> = rows.iter().map(|row| CENTER + rel(row)).collect();
        let plane = array_channel(&paths, &elements, CENTER, &[wavelength], ArrayWavefront::Plane);
        let spherical = array_channel(&paths, &elements, CENTER, &[wavelength], ArrayWavefront::Spherical);
        for ((row, plane), spherical) in rows.iter().zip(plane).zip(spherical) {
            let expected =
                |name: &str| Complex::new(number(row, &format!("{name}_re")), number(row, &format!("{name}_im")));
            let synthetic = expected("ref_syn");
            let error = (plane - synthetic).norm() / synthetic.norm();
            assert!(error < 1e-8, "{tx}, element {}: {error:e}", row["elem"]);
            let real = expected("ref_real");
            plane_error += (plane - real).norm_sqr();
            spherical_error += (spherical - real).norm_sqr();
        }
    }
    println!("against separately traced paths: plane {}, spherical {}", plane_error.sqrt(), spherical_error.sqrt());
    assert!(spherical_error < 0.2 * plane_error, "{spherical_error:e} against {plane_error:e}");
}
