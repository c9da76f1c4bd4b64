use super::*;
use glam::DVec3;

/// Returns the integral of a function of the outgoing direction over the hemisphere about z: midpoints in azimuth,
/// which are exact for a polynomial, and Simpson's rule in the cosine.
fn over_hemisphere(function: impl Fn(DVec3) -> f64) -> f64 {
    let (rings, around) = (400, 64);
    let ring = |i: i32| {
        let z = f64::from(i) / f64::from(rings);
        let flat = (1.0 - z * z).max(0.0).sqrt();
        let at = |j: i32| TAU * (f64::from(j) + 0.5) / f64::from(around);
        (0..around).map(|j| function(DVec3::new(flat * at(j).cos(), flat * at(j).sin(), z))).sum::<f64>() * TAU
            / f64::from(around)
    };
    let weight = |i: i32| if i == 0 || i == rings { 1.0 } else { f64::from(2 + 2 * (i % 2)) };
    (0..=rings).map(|i| weight(i) * ring(i)).sum::<f64>() / (3.0 * f64::from(rings))
}

fn lobes() -> impl Iterator<Item = Lobe> {
    let narrow = [20, 40].into_iter();
    std::iter::once(Lobe::Lambertian).chain((0..=10).chain(narrow).map(|exponent| Lobe::Directive { exponent }))
}

#[test]
fn every_lobe_integrates_to_one_at_every_incidence() {
    let mut worst = 0.0_f64;
    for lobe in lobes() {
        for cos in [0.0, 0.1, 0.5, 0.9, 1.0_f64] {
            let specular = DVec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
            let total = over_hemisphere(|out| lobe.density(cos, out.z, out.dot(specular)));
            worst = worst.max((total - 1.0).abs());
        }
    }
    println!("worst deviation from 1: {worst:.1e}");
    assert!(worst < 1e-6);
}

#[test]
fn lobe_integral_at_normal_incidence_has_closed_form() {
    // ψ is the angle from the normal: 2π ∫ ((1 + z)/2)^α dz from 0 to 1.
    for exponent in [0, 1, 2, 5, 10, 64, 256] {
        let power = f64::from(exponent) + 1.0;
        let expected = 4.0 * PI / power * (1.0 - 0.5_f64.powf(power));
        let integral = 1.0 / Lobe::Directive { exponent }.density(1.0, 1.0, 1.0);
        assert!((integral / expected - 1.0).abs() < 1e-12, "{exponent}: {integral} {expected}");
    }
}

#[test]
fn lambertian_lobe_is_cosine() {
    assert_eq!(Lobe::Lambertian.density(0.3, 0.5, -0.2), 0.5 / PI);
    assert_eq!(Lobe::Lambertian.density(1.0, 0.0, 0.0), 0.0);
}

#[test]
fn directive_lobe_peaks_at_specular_direction() {
    let lobe = Lobe::Directive { exponent: 4 };
    assert!(lobe.density(0.6, 0.6, 1.0) > lobe.density(0.6, 0.9, 0.9));
    assert_eq!(lobe.density(0.6, 0.6, -1.0), 0.0);
    assert!((lobe.density(0.6, 0.6, 0.0) / lobe.density(0.6, 0.6, 1.0) - 1.0 / 16.0).abs() < 1e-15);
    let wider = Lobe::Directive { exponent: 2 };
    assert!(lobe.density(0.6, 0.6, 1.0) > wider.density(0.6, 0.6, 1.0));
}

/// Received power of a patch at all points of a far sphere, each with the aperture λ²/4π: S²|Γ|² of the incident power.
#[test]
fn scattered_power_is_set_share_of_incident_power() {
    let (s, gamma, area, cos, near, far, wavelength) = (0.4, 0.6, 0.01, 0.7_f64, 2.0, 30.0, 0.125);
    let aperture = wavelength * wavelength / (4.0 * PI);
    let fallen = area * cos / (4.0 * PI * near * near);
    let specular = DVec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
    for lobe in lobes() {
        let received = over_hemisphere(|out| {
            let density = lobe.density(cos, out.z, out.dot(specular));
            patch_amplitude(s, gamma, density, area, cos, (near, far), wavelength).powi(2) / aperture * far * far
        });
        assert!((received / (s * s * gamma * gamma * fallen) - 1.0).abs() < 1e-6, "{lobe:?}");
    }
}

#[test]
fn smooth_surface_and_back_side_do_not_scatter() {
    assert_eq!(patch_amplitude(0.0, 1.0, 0.3, 0.1, 0.5, (1.0, 1.0), 0.1), 0.0);
    assert_eq!(patch_amplitude(0.5, 1.0, 0.3, 0.1, -0.5, (1.0, 1.0), 0.1), 0.0);
}

#[test]
fn parses_and_validates_lobe() {
    assert_eq!(ron::from_str("Lambertian"), Ok(Lobe::Lambertian));
    assert!(ron::from_str::<Lobe>("Directive(width: 4)").is_err());
    Lobe::Directive { exponent: NARROWEST }.check().unwrap();
    let fault = Lobe::Directive { exponent: u32::MAX }.check().unwrap_err();
    assert!(fault.contains("4294967295"), "{fault}");
}
