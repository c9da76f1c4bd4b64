use super::*;
use crate::SPEED_OF_LIGHT;
use crate::waves::material::itu_material;
use glam::DVec3;
use pwrfgs_core::testing::shared;

const WAVELENGTH: f64 = 0.3258;
const COSINES: [f64; 7] = [0.0, 1e-9, 0.01, 0.3, 0.7, 0.99, 1.0];
const THICKNESSES: [f64; 6] = [0.0, 1e-9, 0.003, 0.02, 0.2, 5.0];

fn lossless(permittivity: f64) -> Complex {
    Complex::new(permittivity, -0.0)
}

/// Returns both polarisations.
fn both(pair: Polarized) -> [Complex; 2] {
    [pair.te, pair.tm]
}

fn close(a: Polarized, b: Polarized, tolerance: f64) -> bool {
    (a.te - b.te).norm() <= tolerance && (a.tm - b.tm).norm() <= tolerance
}

/// Returns equal coefficients of both polarisations.
fn equal_pair(value: f64) -> Polarized {
    Polarized { te: value.into(), tm: value.into() }
}

#[test]
fn vacuum_slab_transmits_all_and_reflects_none() {
    for cos in COSINES {
        assert!(close(reflection(lossless(1.0), None, cos, WAVELENGTH), equal_pair(0.0), 1e-15));
        for depth in THICKNESSES {
            assert!(
                close(reflection(lossless(1.0), Some(depth), cos, WAVELENGTH), equal_pair(0.0), 1e-15),
                "{cos}, {depth}"
            );
            assert!(
                close(transmission(lossless(1.0), depth, cos, WAVELENGTH), equal_pair(1.0), 1e-14),
                "{cos}, {depth}"
            );
        }
    }
}

#[test]
fn lossless_slab_conserves_energy_and_lossy_slab_absorbs() {
    for cos in COSINES {
        for depth in THICKNESSES {
            for permittivity in [0.4, 1.99, 5.24, 80.0] {
                let eta = lossless(permittivity);
                let back = both(reflection(eta, Some(depth), cos, WAVELENGTH));
                let on = both(transmission(eta, depth, cos, WAVELENGTH));
                for (r, t) in back.iter().zip(on) {
                    let energy = r.norm_sqr() + t.norm_sqr();
                    assert!((energy - 1.0).abs() < 1e-12, "η {eta}, cos {cos}, d {depth}: {energy}");
                }
            }
            for name in crate::waves::material::itu_material_names() {
                let eta = itu_material(name).unwrap().permittivity(SPEED_OF_LIGHT / WAVELENGTH);
                let back = both(reflection(eta, Some(depth), cos, WAVELENGTH));
                let on = both(transmission(eta, depth, cos, WAVELENGTH));
                for (r, t) in back.iter().zip(on) {
                    assert!(r.norm_sqr() + t.norm_sqr() <= 1.0 + 1e-14, "{name}, cos {cos}, d {depth}: {r}, {t}");
                }
            }
        }
    }
}

#[test]
fn tm_reflection_is_zero_at_brewster_angle() {
    for permittivity in [1.99_f64, 5.24] {
        let cos = 1.0 / (1.0 + permittivity).sqrt(); // tan θ = √ε
        let half_space = reflection(lossless(permittivity), None, cos, WAVELENGTH);
        assert!(half_space.tm.norm() < 1e-15 && half_space.te.norm() > 0.3);
        let slab = reflection(lossless(permittivity), Some(0.05), cos, WAVELENGTH);
        assert!(slab.tm.norm() < 1e-15 && slab.te.norm() > 0.3);
        assert!((transmission(lossless(permittivity), 0.05, cos, WAVELENGTH).tm.norm() - 1.0).abs() < 1e-14);
    }
}

#[test]
fn polarisations_agree_at_normal_incidence() {
    let eta = itu_material("concrete").unwrap().permittivity(2.4e9);
    let n = eta.sqrt();
    let expected = (1.0 - n) / (1.0 + n);
    for thickness in [None, Some(0.01), Some(0.2)] {
        let r = reflection(eta, thickness, 1.0, WAVELENGTH);
        assert!((r.te + r.tm).norm() < 1e-15);
        if thickness.is_none() {
            assert!((r.te - expected).norm() < 1e-15);
        }
    }
    let t = transmission(eta, 0.2, 1.0, WAVELENGTH);
    assert!((t.te - t.tm).norm() < 1e-15);
}

/// Airy's sum over the multiple reflections inside a slab, from the coefficients of its two faces, which differ from
/// those of the closed form: t₁₂t₂₁ in place of 1 - r².
#[test]
fn slab_equals_sum_of_internal_reflections() {
    let eta = itu_material("concrete").unwrap().permittivity(3.5e9);
    let (cos, depth) = (0.6, 0.02);
    let s = (eta - 1.0 + cos * cos).sqrt();
    let n = eta.sqrt();
    let inside = s / n; // cosine of the refracted angle
    let q = s * (TAU * depth / WAVELENGTH);
    let hop = (-Complex::I * q).exp();
    let te = ((cos - s) / (cos + s), 2.0 * cos / (cos + s), 2.0 * s / (cos + s));
    let tm = (
        (n * cos - inside) / (n * cos + inside),
        2.0 * cos / (n * cos + inside),
        2.0 * n * inside / (n * cos + inside),
    );
    let beams = |(r, enter, leave): (Complex, Complex, Complex)| {
        let (mut back, mut on, mut beam) = (r, Complex::ZERO, enter * hop);
        for _ in 0..200 {
            on += beam * leave;
            beam *= -r * hop;
            back += beam * leave;
            beam *= -r * hop;
        }
        (back, on * Complex::cis(TAU * depth / WAVELENGTH * cos))
    };
    let (r, t) = (reflection(eta, Some(depth), cos, WAVELENGTH), transmission(eta, depth, cos, WAVELENGTH));
    for ((back, on), (r, t)) in [(beams(te), (r.te, t.te)), (beams(tm), (r.tm, t.tm))] {
        assert!((back - r).norm() < 1e-13 && (on - t).norm() < 1e-13, "{back} {r}, {on} {t}");
    }
}

#[test]
fn slab_approaches_half_space_if_thick_and_air_if_thin() {
    let eta = itu_material("concrete").unwrap().permittivity(SPEED_OF_LIGHT / WAVELENGTH);
    for cos in COSINES {
        let half_space = reflection(eta, None, cos, WAVELENGTH);
        assert!(close(reflection(eta, Some(1000.0), cos, WAVELENGTH), half_space, 1e-14));
        assert!(close(transmission(eta, 1000.0, cos, WAVELENGTH), equal_pair(0.0), 1e-14));
    }
    for cos in [0.01, 0.3, 1.0] {
        for depth in [0.0, 1e-12] {
            assert!(close(reflection(eta, Some(depth), cos, WAVELENGTH), equal_pair(0.0), 1e-8));
            assert!(close(transmission(eta, depth, cos, WAVELENGTH), equal_pair(1.0), 1e-8));
        }
        // R ~ r·2jq/(1 - r²) to first order.
        let s = (eta - 1.0 + cos * cos).sqrt();
        let r = (cos - s) / (cos + s);
        let first = r * 2.0 * Complex::I * s * (TAU * 1e-9 / WAVELENGTH) / (1.0 - r * r);
        assert!((reflection(eta, Some(1e-9), cos, WAVELENGTH).te - first).norm() < 1e-5 * first.norm());
    }
}

#[test]
fn grazing_wave_is_fully_reflected() {
    for name in ["concrete", "wood", "metal"] {
        let eta = itu_material(name).unwrap().permittivity(2.4e9);
        for thickness in [None, Some(0.01)] {
            assert!(close(reflection(eta, thickness, 0.0, WAVELENGTH), equal_pair(-1.0), 1e-12), "{name}");
        }
        assert!(close(transmission(eta, 0.01, 0.0, WAVELENGTH), equal_pair(0.0), 1e-12), "{name}");
    }
}

#[test]
fn perfect_conductor_reflects_te_inverted_and_tm_unchanged() {
    for hz in [1e6, 920e6, 300e9] {
        let eta = itu_material("perfect_conductor").unwrap().permittivity(hz);
        for cos in [1e-6, 0.3, 1.0] {
            for thickness in [None, Some(1e-6), Some(0.1)] {
                let r = reflection(eta, thickness, cos, SPEED_OF_LIGHT / hz);
                assert!(close(r, Polarized::PERFECT_CONDUCTOR, 1e-12), "{hz} Hz, cos {cos}: {r:?}");
            }
            assert!(close(transmission(eta, 1e-6, cos, SPEED_OF_LIGHT / hz), equal_pair(0.0), 1e-12));
        }
    }
}

/// Returns θ̂ of a direction.
fn polar(direction: DVec3) -> DVec3 {
    let flat = direction.x.hypot(direction.y);
    DVec3::new(direction.z * direction.x / flat, direction.z * direction.y / flat, -flat)
}

/// Returns the gain of one reflection according to the reference, from the geometry: image of the transmitter, one
/// interaction.
fn one_bounce(tx: DVec3, rx: DVec3, face: &str, thick: bool, hz: f64) -> (Complex, f64) {
    let (normal, offset, name, depth) = match face {
        "floor" => (DVec3::Z, 0.0, "wood", 0.03),
        "ceiling" => (-DVec3::Z, -3.0, "plasterboard", 0.025),
        "wall_xneg" => (DVec3::X, -3.0, "concrete", 0.2),
        "wall_xpos" => (-DVec3::X, -3.0, "concrete", 0.2),
        "wall_yneg" => (DVec3::Y, -2.5, "concrete", 0.2),
        _ => (-DVec3::Y, -2.5, "concrete", 0.2),
    };
    let image = tx - 2.0 * (tx.dot(normal) - offset) * normal;
    let length = image.distance(rx);
    let after = (rx - image) / length;
    let before = after - 2.0 * after.dot(normal) * normal;
    let s = before.cross(normal).normalize();
    let eta = itu_material(name).unwrap().permittivity(hz);
    let wavelength = SPEED_OF_LIGHT / hz;
    let r = reflection(eta, thick.then_some(depth), before.dot(normal), wavelength);
    let (sent, received) = (polar(before), polar(-after));
    let field = r.te * sent.dot(s) * s.dot(received) + r.tm * sent.dot(s.cross(before)) * s.cross(after).dot(received);
    let spreading = wavelength / (2.0 * TAU * length);
    (field * spreading, spreading)
}

#[test]
fn single_reflections_match_reference_room() {
    let Some(folder) = shared("reference/paths/sceneA") else { return };
    let (mut worst, mut count) = (0.0_f64, 0);
    for (file, hz, thick) in [
        ("paths_920MHz_slab.csv", 920e6, true),
        ("paths_920MHz_halfspace.csv", 920e6, false),
        ("paths_3500MHz_slab.csv", 3.5e9, true),
        ("paths_3500MHz_halfspace.csv", 3.5e9, false),
    ] {
        let mut rows = csv::Reader::from_path(folder.join(file)).unwrap();
        let header = rows.headers().unwrap().clone();
        let column = |name: &str| header.iter().position(|h| h == name).unwrap();
        for row in rows.records().map(Result::unwrap).filter(|row| &row[column("order")] == "1") {
            let tx = match &row[0] {
                "tx1" => DVec3::new(-2.1, 1.4, 1.1),
                "tx2" => DVec3::new(0.45, -1.85, 2.35),
                _ => DVec3::new(-1.3, -0.65, 0.8),
            };
            let number = |name: &str| row[column(name)].parse::<f64>().unwrap();
            let expected = Complex::new(number("ref_a_re"), number("ref_a_im"));
            let rx = DVec3::new(1.7, -0.9, 1.3);
            let (gain, spreading) = one_bounce(tx, rx, &row[column("surfaces")], thick, hz);
            worst = worst.max((gain - expected).norm() / spreading);
            count += 1;
        }
    }
    println!("{count} single bounces, worst deviation {worst:.1e} of free space");
    assert_eq!(count, 4 * 3 * 6);
    assert!(worst < 1e-9);
}
