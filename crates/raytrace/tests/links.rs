//! Several receivers, powers and channels: closed forms, and errors of the stated size.

use crate::common::{CSI, small_room};
use glam::DVec3;
use pwrfgs_core::plugin::Checked;
use pwrfgs_raytrace::array::array_channel;
use pwrfgs_raytrace::{
    Complex, ObservationKind, PreparedReceiver, SPEED_OF_LIGHT, SceneFile, SimulatedObservation, Simulator,
};
use std::f64::consts::{PI, TAU};
use std::path::Path;

/// Returns two receivers with a single antenna in a large room, whose floor alone reflects; `more` are further fields.
fn large_room(floor: &str, more: &str) -> String {
    format!(
        "(name: \"large\", carrier_hz: 2.4e9,
          room: (outline: Box(low: (-50, -50, 0), high: (50, 50, 90)), walls: (material: \"vacuum\"),
              floor: (material: \"{floor}\"), ceiling: (material: \"vacuum\")),
          receiver: (name: \"west\", position: (-3, 0, 2), orientation: Quaternion(0, 0, 0, 1),
              array: (rows: 1, columns: 1, polarization: (0, 0, 1))),
          more_receivers: [(name: \"east\", position: (9, 1, 2.5), orientation: Quaternion(0, 0, 0, 1),
              array: (rows: 1, columns: 1, polarization: (0, 0, 1)))],
          propagation: (order: 1, room_order: 1, diffraction: false),
          {more})"
    )
}

const ANYWHERE: &str = "transmitter: (positions: Uniform(low: (-20, -20, 1), high: (20, 20, 3)))";
const BAND: &str = "subcarriers: (count: 16, bandwidth_hz: 40e6)";

/// Parses a scene.
fn parse(text: &str) -> SceneFile {
    SceneFile::parse(text, Path::new("links.ron")).unwrap()
}

/// Prepares a scene.
fn simulator(text: &str) -> Simulator {
    Simulator::new(&parse(text)).unwrap()
}

/// Returns the observed channel.
fn channel(receiver: &PreparedReceiver, tx: DVec3, snr_db: Option<f64>, sample: Option<u64>) -> Vec<Complex> {
    match receiver.observe(tx, &ObservationKind::Channel { snr_db }, sample).observed {
        SimulatedObservation::Channel(channel) => channel,
        other => panic!("{other:?}"),
    }
}

/// Returns the observed power, dBm.
fn power(receiver: &PreparedReceiver, tx: DVec3, noise_db: f64, sample: Option<u64>) -> f64 {
    match receiver.observe(tx, &ObservationKind::Power { noise_db }, sample).observed {
        SimulatedObservation::Power(dbm) => dbm,
        other => panic!("{other:?}"),
    }
}

/// Returns λ/4πd and the phase of the path, at frequency `f`; the wavelength of the amplitude is that of the carrier.
fn wave(distance: f64, f: f64) -> Complex {
    let wavelength = SPEED_OF_LIGHT / 2.4e9;
    wavelength / (4.0 * PI * distance) * Complex::cis(-TAU * f * distance / SPEED_OF_LIGHT)
}

#[test]
fn subcarriers_are_centred_on_carrier() {
    let even = parse(&large_room("vacuum", &format!("{ANYWHERE}, {BAND}"))).frequencies();
    assert_eq!(even.len(), 16);
    assert_eq!((even[0], even[15]), (2.4e9 - 18.75e6, 2.4e9 + 18.75e6));
    assert_eq!(even[8] - even[7], 2.5e6);
    let odd = large_room("vacuum", &format!("{ANYWHERE}, subcarriers: Subcarriers(count: 3, bandwidth_hz: 30e6)"));
    assert_eq!(parse(&odd).frequencies(), [2.39e9, 2.4e9, 2.41e9]);
    assert_eq!(parse(&large_room("vacuum", ANYWHERE)).frequencies(), [2.4e9]);
}

#[test]
fn free_space_channels_match_closed_form_at_two_receivers() {
    let sent = ANYWHERE.replace("(positions", "(power_dbm: 17, positions");
    let simulator = simulator(&large_room("vacuum", &format!("{sent}, {BAND}")));
    let hz = simulator.scene().frequencies();
    for tx in [DVec3::new(1.0, 2.0, 1.5), DVec3::new(-7.0, 3.0, 2.9)] {
        for receiver in simulator.receivers() {
            let distance = tx.distance(DVec3::from(receiver.pose().position));
            let h = channel(receiver, tx, None, None);
            assert_eq!(h.len(), 16);
            for (h, f) in h.iter().zip(&hz) {
                assert!((h / wave(distance, *f) - 1.0).norm() < 1e-9);
            }
            // The phase turns by -2πτ per hertz.
            let slope = (h[9] / h[8]).arg() / (hz[9] - hz[8]);
            assert!((slope / (-TAU * distance / SPEED_OF_LIGHT) - 1.0).abs() < 1e-6);
            let friis = 17.0 + 20.0 * wave(distance, 2.4e9).norm().log10();
            assert!((power(receiver, tx, 0.0, None) - friis).abs() < 0.001);
        }
    }
}

#[test]
fn two_ray_channel_over_mirror_matches_closed_form() {
    let simulator = simulator(&large_room("perfect_conductor", &format!("{ANYWHERE}, {BAND}")));
    let tx = DVec3::new(2.0, -6.0, 1.3);
    let mirrored = DVec3::new(tx.x, tx.y, -tx.z);
    for receiver in simulator.receivers() {
        let position = DVec3::from(receiver.pose().position);
        let rays = |f: f64| wave(tx.distance(position), f) + wave(mirrored.distance(position), f);
        let h = channel(receiver, tx, None, None);
        for (h, f) in h.iter().zip(simulator.scene().frequencies()) {
            assert!((h / rays(f) - 1.0).norm() < 1e-9);
        }
        let mean = h.iter().map(Complex::norm_sqr).sum::<f64>() / 16.0;
        assert!((power(receiver, tx, 0.0, None) - 10.0 * mean.log10()).abs() < 0.001);
    }
}

#[test]
fn channel_at_carrier_equals_channel_of_spectrum() {
    for wavefront in ["Plane", "Spherical", "Traced"] {
        let text = small_room("subcarriers: (count: 3, bandwidth_hz: 20e6)");
        let text = text.replace("columns: 4)", &format!("columns: 4, wavefront: {wavefront})"));
        let simulator = simulator(&text);
        let (scene, receiver) = (simulator.scene(), &simulator.receivers()[0]);
        let tx = DVec3::new(2.5, 1.2, 1.1);
        let paths = receiver.trace(tx);
        let band = channel(receiver, tx, None, None);
        let middle: Vec<Complex> = band.chunks(3).map(|h| h[1]).collect();
        let alone = receiver.channel(tx, &paths, &[scene.carrier_hz]);
        assert!(middle == alone && alone.len() == 8, "{wavefront}");
        if wavefront != "Traced" {
            let array = &scene.receiver.array;
            let center = DVec3::from(scene.receiver.position);
            let antennas = receiver.antenna_positions();
            assert!(alone == array_channel(&paths, &antennas, center, &[scene.wavelength()], array.wavefront));
            assert!(antennas.iter().all(|antenna| antenna.distance(center) < 0.2));
        }
        // Without subcarriers the power equals that of the spectra, including errors.
        let narrow = Simulator::new(&SceneFile { subcarriers: None, ..scene.clone() }).unwrap();
        let receiver = &narrow.receivers()[0];
        let SimulatedObservation::Spectrum(spectrum) =
            receiver.observe(tx, &ObservationKind::Spectrum, Some(5)).observed
        else {
            panic!("another observation")
        };
        let beside = 10.0 * spectrum.power.log10();
        assert!((power(receiver, tx, 0.0, Some(5)) - beside).abs() < 0.001);
    }
}

#[test]
fn channel_errors_have_set_size() {
    let simulator = simulator(&small_room(CSI));
    let [a, b] = simulator.receivers() else { panic!() };
    let tx = DVec3::new(2.5, 1.2, 1.1);
    let quiet = Simulator::new(&SceneFile { noise: Checked::default(), ..simulator.scene().clone() }).unwrap();
    let a_quiet = &quiet.receivers()[0];
    let clean = channel(a_quiet, tx, None, None);
    assert_eq!(clean, channel(a_quiet, tx, None, Some(3)));
    let ratio = |sample: u64| {
        let noisy = channel(a_quiet, tx, Some(10.0), Some(sample));
        let error: f64 = noisy.iter().zip(&clean).map(|(a, b)| (a - b).norm_sqr()).sum();
        error / clean.iter().map(Complex::norm_sqr).sum::<f64>()
    };
    let mean = (0..400).map(ratio).sum::<f64>() / 400.0;
    assert!((mean / 0.1 - 1.0).abs() < 0.03, "{mean}");
    // Readings of a power, in dB: their mean, their deviation, and none alike.
    let exact = power(a_quiet, tx, 0.0, Some(0));
    let errors: Vec<f64> = (0..2000).map(|sample| power(a_quiet, tx, 3.0, Some(sample)) - exact).collect();
    let mean = errors.iter().sum::<f64>() / 2000.0;
    let deviation = (errors.iter().map(|e| e * e).sum::<f64>() / 2000.0).sqrt();
    assert!(mean.abs() < 0.2 && (deviation - 3.0).abs() < 0.15, "{mean} {deviation}");
    assert_eq!(power(a, tx, 3.0, Some(7)), power(a, tx, 3.0, Some(7)));
    let error = |receiver: &PreparedReceiver| power(receiver, tx, 3.0, Some(7)) - power(receiver, tx, 0.0, Some(7));
    assert!((error(a) - error(b)).abs() > 0.01);
}

#[test]
fn simulates_shipped_link_scenes() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap().join("scenes");
    let open = |name: &str| Simulator::new(&SceneFile::read(&root.join(format!("{name}.ron"))).unwrap()).unwrap();
    let office = SceneFile::read(&root.join("office.ron")).unwrap();
    for (name, receivers, numbers) in
        [("office-links", 4, 16), ("office-channel", 1, 16 * 16), ("office-csi", 1, 8 * 52)]
    {
        let simulator = open(name);
        let scene = simulator.scene();
        assert!(scene.room == office.room && scene.objects == office.objects, "{name}");
        assert_eq!(scene.transmitter, office.transmitter);
        assert_eq!(simulator.receivers().len(), receivers);
        let tx = simulator.draw_positions(1, 0).unwrap()[0];
        for receiver in simulator.receivers() {
            assert_eq!(channel(receiver, tx, Some(30.0), Some(0)).len(), numbers);
            assert!((-90.0..-30.0).contains(&power(receiver, tx, 0.0, None)));
        }
    }
}
