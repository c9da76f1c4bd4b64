use super::*;

#[test]
fn material_names_are_unique_and_values_valid() {
    let names = itu_material_names();
    for (i, name) in names.iter().enumerate() {
        assert!(!names[..i].contains(name), "{name} twice");
        let material = itu_material(name).unwrap();
        material.check().unwrap();
        let eta = material.permittivity(920e6);
        assert!(eta.re >= 1.0 && eta.im <= 0.0 && eta.is_finite(), "{name}: {eta}");
    }
    assert_eq!(itu_material("cheese"), None);
}

#[test]
fn conductivity_and_permittivity_match_reference() {
    // eta of an independent program at 0.92 and 3.5 GHz.
    let expected = [
        ("concrete", 920e6, 5.24, -0.845_668_956_628_028_4),
        ("wood", 920e6, 1.99, -0.083_978_715_134_983_5),
        ("plasterboard", 920e6, 2.73, -0.153_561_082_140_277_22),
        ("concrete", 3.5e9, 5.24, -0.632_143_035_061_149_7),
        ("wood", 3.5e9, 1.99, -0.092_434_340_140_272_33),
        ("plasterboard", 3.5e9, 2.73, -0.141_636_181_854_694_3),
    ];
    for (name, hz, re, im) in expected {
        let eta = itu_material(name).unwrap().permittivity(hz);
        assert!((eta - Complex::new(re, im)).norm() < 1e-14, "{name}: {eta}");
    }
}

#[test]
fn permittivity_falls_with_frequency_if_b_is_negative() {
    let ground = itu_material("wet_ground").unwrap();
    assert!((ground.permittivity(10e9).re - 30.0 * 10f64.powf(-0.4)).abs() < 1e-13);
}

#[test]
fn material_is_valid_in_its_frequency_range_only() {
    let concrete = itu_material("concrete").unwrap();
    assert!(!concrete.is_in_valid_range(920e6));
    assert!(concrete.is_in_valid_range(1e9) && concrete.is_in_valid_range(100e9));
    assert!(!concrete.is_in_valid_range(101e9) && !concrete.is_in_valid_range(f64::NAN));
    assert!(itu_material("perfect_conductor").unwrap().is_in_valid_range(1.0));
}

#[test]
fn custom_material_requires_a_and_c() {
    let plain: Material = ron::from_str("(a: 2, c: 0.01)").unwrap();
    assert_eq!(plain, Material { a: 2.0, b: 0.0, c: 0.01, d: 0.0, range_ghz: EVERYWHERE });
    assert!(ron::from_str::<Material>("(a: 2, c: 0.01, e: 1)").is_err());
    for name in itu_material_names() {
        let material = itu_material(name).unwrap();
        let json = serde_json::to_string(&material).unwrap();
        assert_eq!(serde_json::from_str::<Material>(&json).unwrap(), material, "{json}");
        let ron = ron::to_string(&material).unwrap();
        assert_eq!(ron::from_str::<Material>(&ron).unwrap(), material, "{ron}");
    }
}

#[test]
fn reports_invalid_material_values() {
    let good = itu_material("wood").unwrap();
    let faulty = [
        ("`a`", Material { a: 0.0, ..good.clone() }),
        ("`a`", Material { a: f64::INFINITY, ..good.clone() }),
        ("`b`", Material { b: f64::NAN, ..good.clone() }),
        ("`c`", Material { c: -1e-9, ..good.clone() }),
        ("`c`", Material { c: f64::INFINITY, ..good.clone() }),
        ("`d`", Material { d: 11.0, ..good.clone() }),
        ("`range_ghz`", Material { range_ghz: (2.0, 1.0), ..good.clone() }),
        ("`range_ghz`", Material { range_ghz: (f64::NAN, 1.0), ..good }),
    ];
    for (field, material) in faulty {
        let fault = material.check().unwrap_err();
        assert!(fault.starts_with(field), "{fault}");
    }
}
