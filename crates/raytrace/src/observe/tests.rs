use super::*;
use crate::scene::Orientation;
use pwrfgs_core::plugin::{Check as _, Checked};

/// Returns a channel of unequal gains.
fn channel(elements: usize) -> Vec<Complex> {
    (0..elements).map(|k| 1e-3 * Complex::cis(0.7 * k as f64) * (1.0 + (k % 3) as f64)).collect()
}

/// Returns that channel with the noise of sample `draw`.
fn noisy_channel(noise: &Noise, draw: u64) -> Vec<Complex> {
    let mut channel = channel(16);
    add_default_noise(noise, &mut channel, draw);
    channel
}

fn receiver(name: &str) -> SceneReceiver {
    let orientation = Orientation::Quaternion(0.0, 0.0, 0.0, 1.0);
    SceneReceiver { name: name.into(), position: [0.0; 3], orientation, array: Checked::default() }
}

/// Adds the noise of one sample at the default receiver.
fn add_default_noise(noise: &Noise, channel: &mut [Complex], sample: u64) {
    add_noise(noise, channel, 1, NoiseDraw { receiver: &receiver("gateway1"), sample });
}

#[test]
fn default_noise_leaves_channel_unchanged() {
    assert_eq!(noisy_channel(&Noise::default(), 5), channel(16));
}

#[test]
fn noise_has_set_power_and_uniform_phase() {
    for snr in [-10.0, 0.0, 20.0] {
        let noise = Noise { snr_db: Some(snr), ..Noise::default() };
        let clean = channel(16);
        let draws: Vec<Complex> = (0..2000)
            .flat_map(|draw| {
                noisy_channel(&noise, draw).into_iter().zip(&clean).map(|(a, b)| a - b).collect::<Vec<_>>()
            })
            .collect();
        let expected = mean_power(&clean) * 10f64.powf(-snr / 10.0);
        // 32,000 draws: the standard error of the power is 0.6 %, of a mean 0.6 % of its root.
        assert!((mean_power(&draws) / expected - 1.0).abs() < 0.03, "{snr} dB");
        let count = draws.len() as f64;
        let mean = draws.iter().sum::<Complex>() / count;
        let pseudo = draws.iter().map(|n| n * n).sum::<Complex>() / count;
        let neighbours = draws.windows(2).map(|w| w[0] * w[1].conj()).sum::<Complex>() / count;
        assert!(mean.norm() < 0.03 * expected.sqrt());
        assert!(pseudo.norm() < 0.03 * expected && neighbours.norm() < 0.03 * expected);
    }
}

#[test]
fn phase_errors_depend_on_receiver_not_sample() {
    let noise = Noise { phase_error_deg: 10.0, ..Noise::default() };
    assert_eq!(noisy_channel(&noise, 0), noisy_channel(&noise, 1));
    assert_ne!(noisy_channel(&noise, 0), noisy_channel(&Noise { seed: 1, ..noise.clone() }, 0));
    let mut many = channel(1024);
    add_default_noise(&noise, &mut many, 0);
    let turned: Vec<f64> = many.iter().zip(channel(1024)).map(|(a, b)| (a / b).arg().to_degrees()).collect();
    let mean = turned.iter().sum::<f64>() / 1024.0;
    let deviation = (turned.iter().map(|d| d * d).sum::<f64>() / 1024.0).sqrt();
    assert!(mean.abs() < 1.5 && (deviation - 10.0).abs() < 1.0, "{mean} {deviation}");
    assert!(many.iter().zip(channel(1024)).all(|(a, b)| (a.norm() / b.norm() - 1.0).abs() < 1e-12));
}

#[test]
fn noise_is_bit_identical_in_any_order() {
    let noise = Noise { snr_db: Some(10.0), phase_error_deg: 3.0, seed: 4 };
    let forwards: Vec<_> = (0..8).map(|draw| noisy_channel(&noise, draw)).collect();
    let backwards: Vec<_> = (0..8).rev().map(|draw| noisy_channel(&noise, draw)).collect();
    assert!(forwards.iter().eq(backwards.iter().rev()));
    assert_ne!(forwards[0], forwards[1]);
    assert_ne!(forwards[0], noisy_channel(&Noise { seed: 5, ..noise }, 0));
}

#[test]
fn noise_leaves_zero_channel_at_zero() {
    let mut silent = vec![Complex::ZERO; 16];
    add_default_noise(&Noise { snr_db: Some(10.0), phase_error_deg: 3.0, seed: 0 }, &mut silent, 0);
    assert_eq!(silent, vec![Complex::ZERO; 16]);
}

#[test]
fn reports_settings_out_of_range() {
    let check = |snr_db, phase_error_deg| Noise { snr_db, phase_error_deg, seed: 0 }.check();
    assert_eq!(check(Some(20.0), 5.0), Ok(()));
    assert!(check(Some(f64::NAN), 0.0).unwrap_err().starts_with("noise: `snr_db` is NaN"));
    assert!(check(Some(f64::INFINITY), 0.0).is_err());
    assert!(check(None, -1.0).unwrap_err().starts_with("noise: `phase_error_deg` is -1"));
}

#[test]
fn phase_errors_differ_per_receiver_and_not_per_subcarrier() {
    let noise = Noise { phase_error_deg: 10.0, ..Noise::default() };
    let noisy = |noise: &Noise, name: &str, subcarriers: usize| {
        let mut channel = channel(16);
        add_noise(noise, &mut channel, subcarriers, NoiseDraw { receiver: &receiver(name), sample: 2 });
        channel
    };
    assert_ne!(noisy(&noise, "north", 1), noisy(&noise, "south", 1));
    let turns: Vec<Complex> = noisy(&noise, "north", 4).iter().zip(channel(16)).map(|(a, b)| a / b).collect();
    assert!(turns.chunks(4).all(|antenna| antenna.iter().all(|turn| (turn - antenna[0]).norm() < 1e-12)));
    assert!((turns[0] - turns[4]).norm() > 1e-6);
    // Only seed and name matter: the default name has the same draws as a scene without names.
    let noise = Noise { snr_db: Some(10.0), seed: 3, ..Noise::default() };
    let mut old = channel(16);
    let deviation = (mean_power(&old) * 0.1).sqrt() * FRAC_1_SQRT_2;
    let mut random = rng::stream(3, "receiver noise", 2);
    let mut normal = || deviation * rng::normal(&mut random) as f64;
    old.iter_mut().for_each(|h| *h += Complex::new(normal(), normal()));
    assert_eq!(noisy(&noise, "gateway1", 1), old);
    assert_eq!(noisy(&noise, "gateway1", 4), old);
    assert_ne!(noisy(&noise, "north", 1), old);
}
