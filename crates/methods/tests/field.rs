//! Tests of the field against closed forms and central differences.

use pwrfgs_core::testing::check_vjp;
use pwrfgs_core::{GaussianCloud, Real, SPEED_OF_LIGHT, rng};
use pwrfgs_methods::virtual_transmitters::{ChannelInputs, HARMONICS, field, field_vjp};

/// Creates a few Gaussians at distances of some metres, with quaternions of any length and gains of `terms` harmonics.
fn cloud(n: usize, terms: usize, seed: u64) -> GaussianCloud {
    let mut random = rng::stream(seed, "cloud", 0);
    let mut cloud = GaussianCloud::zeros(n);
    if terms > 1 {
        cloud.add_missing_columns(&[(HARMONICS, 2 * (terms - 1))]).unwrap();
        cloud.extra[0].values.fill_with(|| 0.3 * rng::normal(&mut random));
    }
    for i in 0..n {
        cloud.means[i] = [0; 3].map(|_| 4.0 * rng::normal(&mut random));
        cloud.quats[i] = [0; 4].map(|_| rng::normal(&mut random));
        cloud.signals[i] = [0; 2].map(|_| rng::normal(&mut random));
    }
    cloud
}

const POSITIONS: [[Real; 3]; 5] =
    [[0.3, 0.2, 1.0], [1.3, -0.7, 1.5], [-0.4, 1.9, 0.2], [0.0, 0.0, 0.0], [2.0, 1.0, 1.0]];
const ANTENNAS: [[Real; 3]; 3] = [[0.0; 3], [0.0, 0.16, 0.0], [0.05, 0.0, 0.16]];
const FREQUENCIES: [f64; 2] = [0.9e9, 0.92e9];
const LINKS: ChannelInputs<'_> =
    ChannelInputs { positions: &POSITIONS, antennas: &ANTENNAS, frequencies: &FREQUENCIES };

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn field_derivative_agrees_with_differences() {
    for (n, terms) in [(3, 1), (19, 1), (3, 4), (2, 9), (18, 16)] {
        let x = cloud(n, terms, n as u64);
        let gate: Vec<Real> = (0..n).map(|i| 0.1 + 0.05 * i as Real).collect();
        let flat = |cloud: &GaussianCloud, gate: &[Real]| {
            let more = cloud.extra.first().map_or(&[][..], |c| &c.values);
            let (means, quats, signals) = (&cloud.means, &cloud.quats, &cloud.signals);
            [means.as_flattened(), quats.as_flattened(), signals.as_flattened(), more, gate].concat()
        };
        let unpack = |x: &[Real]| {
            let mut cloud = cloud(n, terms, 0);
            let mut rest = x;
            let mut take = |into: &mut [Real]| {
                let (own, tail) = rest.split_at(into.len());
                into.copy_from_slice(own);
                rest = tail;
            };
            take(cloud.means.as_flattened_mut());
            take(cloud.quats.as_flattened_mut());
            take(cloud.signals.as_flattened_mut());
            cloud.extra.iter_mut().for_each(|c| take(&mut c.values));
            (cloud, rest.to_vec())
        };
        check_vjp(
            "field",
            &flat(&x, &gate),
            |x| {
                let (cloud, gate) = unpack(x);
                field(&cloud, Some(&gate), &LINKS).into_flattened()
            },
            |x, d| {
                let (cloud, gate) = unpack(x);
                let out = field_vjp(&cloud, Some(&gate), &LINKS, d.as_chunks::<2>().0);
                flat(&out.cloud, &out.gate)
            },
            1e-6,
            1e-5,
        );
    }
}

/// A node in front of a wall at x = 0: two rays, the second from the mirror image with the sign of its reflection.
#[test]
fn one_virtual_transmitter_equals_two_ray_model() {
    let (node, gain, reflection) = ([2.0, 0.5, 1.5], 0.026, -0.8);
    let mut pair = GaussianCloud::zeros(2);
    pair.quats = vec![[1.0, 0.0, 0.0, 0.0]; 2];
    pair.means = vec![node, [-node[0], node[1], node[2]]];
    pair.signals = vec![[gain, 0.0], [reflection * gain, 0.0]];
    let links = ChannelInputs { antennas: &[[0.0; 3]], ..LINKS };
    let found = field(&pair, None, &links);
    for (m, p) in POSITIONS.iter().enumerate() {
        for (f, frequency) in FREQUENCIES.iter().enumerate() {
            let d2 = |x: f64| {
                let by = [x - p[0] as f64, node[1] as f64 - p[1] as f64, node[2] as f64 - p[2] as f64];
                by.iter().map(|x| x * x).sum::<f64>().sqrt()
            };
            let k = std::f64::consts::TAU * frequency / SPEED_OF_LIGHT;
            let (a, b) = (d2(node[0] as f64), d2(-node[0] as f64));
            let re = gain as f64 * ((k * a).cos() / a + reflection as f64 * (k * b).cos() / b);
            let im = -gain as f64 * ((k * a).sin() / a + reflection as f64 * (k * b).sin() / b);
            let h = found[2 * m + f];
            let tolerance = if size_of::<Real>() == 8 { 1e-12 } else { 1e-6 };
            assert!((h[0] as f64 - re).abs() < tolerance && (h[1] as f64 - im).abs() < tolerance, "{m} {f}: {h:?}");
        }
    }
}
