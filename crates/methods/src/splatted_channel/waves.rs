//! Channels: the waves of all Gaussians, summed per antenna and subcarrier of a receiver.
//!
//! `h(a, f) = Σ_g m_g s_g exp(−j k_f d_ga)/d_ga` with d the distance from Gaussian g to antenna a, `k_f = 2πf/c` and
//! the gate m. Gaussians are points here, without projection or occlusion. The transmitter affects only the signals s,
//! so that the waves W `[2AF, N]` are computed once for all links of a receiver.

use crate::ActivationVjp;
use glam::DVec3;
use pwrfgs_core::{Call, MeasurementSetup, Parameters, Real, ReceiverState, SPEED_OF_LIGHT, gain_indices};
use rayon::prelude::*;

/// Smallest distance between a Gaussian and an antenna in the model, metres.
const NEAREST_M: f64 = 0.05;

/// Wave of each Gaussian with a signal of 1 at a receiver: real parts `[A·F, N]` and imaginary parts; each row is an
/// antenna and a subcarrier.
#[derive(Debug)]
pub(super) struct Waves {
    re: Vec<Real>,
    im: Vec<Real>,
    /// Number of Gaussians N.
    n: usize,
    /// Number of subcarriers F.
    columns: usize,
}

/// Returns the antenna positions `[A]` of a receiver, metres from the origin of the setup.
fn antenna_positions(setup: &MeasurementSetup, ReceiverState { receiver, pose }: ReceiverState) -> Vec<[f64; 3]> {
    let position = |antenna: &[f64; 3]| {
        let offset = pose.turned(*antenna);
        std::array::from_fn(|k| pose.position[k] + offset[k])
    };
    setup.receivers[receiver].antennas.iter().map(position).collect()
}

/// Returns the vector from antenna to Gaussian, and its length of at least [`NEAREST_M`].
fn offset_and_distance(mean: &[Real; 3], antenna: &[f64; 3]) -> ([f64; 3], f64) {
    let offset: [f64; 3] = std::array::from_fn(|k| mean[k] as f64 - antenna[k]);
    (offset, offset.iter().map(|v| v * v).sum::<f64>().sqrt().max(NEAREST_M))
}

/// Returns the factor s such that s · gate · offset is the derivative of Re(d* wave) by the offset from antenna to Gaussian;
/// zero up to [`NEAREST_M`]. `d` is the cotangent of the wave (real, imaginary) and `k` the wavenumber; sine and cosine are
/// those of k · distance.
fn wave_slope([d_re, d_im]: [f64; 2], k: f64, distance: f64, (sin, cos): (f64, f64)) -> f64 {
    if distance <= NEAREST_M {
        return 0.0;
    }
    let slope_re = -k * sin / distance - cos / (distance * distance);
    let slope_im = -k * cos / distance + sin / (distance * distance);
    (d_re * slope_re + d_im * slope_im) / distance
}

impl Waves {
    /// Computes the gated waves exp(−jkd)/d of all Gaussians at a receiver.
    pub(super) fn new(setup: &MeasurementSetup, state: ReceiverState, p: &Parameters<'_>) -> Self {
        let Parameters { cloud, gate, .. } = *p;
        let (n, frequencies) = (cloud.len(), setup.frequencies_of(state.receiver));
        let (columns, antennas) = (frequencies.len(), antenna_positions(setup, state));
        let mut both = vec![[0.0; 2]; antennas.len() * columns * n];
        both.par_chunks_exact_mut(n.max(1)).enumerate().for_each(|(row, out)| {
            let (antenna, hz) = (&antennas[row / columns], frequencies[row % columns]);
            let k = std::f64::consts::TAU * hz / SPEED_OF_LIGHT;
            for (i, out) in out.iter_mut().enumerate() {
                let d = offset_and_distance(&cloud.means[i], antenna).1;
                let level = gate.map_or(1.0, |gate| gate[i] as f64) / d;
                let (sin, cos) = (k * d).sin_cos();
                *out = [(level * cos) as Real, (-level * sin) as Real];
            }
        });
        let part = |k: usize| both.iter().map(|w| w[k]).collect();
        Self { re: part(0), im: part(1), n, columns }
    }

    /// Sums the waves of all Gaussians with the signals `[N, L, 2]` of L links; returns observations `[L, 2A, F]`.
    pub(super) fn superpose(&self, signals: &[Real], links: usize) -> Vec<Real> {
        let numbers = 2 * self.re.len() / self.n.max(1);
        let mut out = vec![0.0; links * numbers];
        out.par_chunks_exact_mut(numbers.max(1)).enumerate().for_each(|(l, out)| {
            let link_signals: Vec<[Real; 2]> =
                (0..self.n).map(|i| [0, 1].map(|c| signals[(i * links + l) * 2 + c])).collect();
            for row in 0..numbers / 2 {
                let (re, im) = (&self.re[row * self.n..][..self.n], &self.im[row * self.n..][..self.n]);
                let mut sum = [0.0; 2];
                for ((re, im), [a, b]) in re.iter().zip(im).zip(&link_signals) {
                    sum[0] += re * a - im * b;
                    sum[1] += re * b + im * a;
                }
                let at = self.real_index(row);
                (out[at], out[at + self.columns]) = (sum[0], sum[1]);
            }
        });
        out
    }

    /// Returns the received channel of each of J functions of the Gaussians, given their values `[N, J]`: complex,
    /// `[A·F, J]`.
    pub(super) fn basis_channels(&self, basis: &[Real], functions: usize) -> Vec<[f64; 2]> {
        let mut out = vec![[0.0; 2]; self.re.len() / self.n.max(1) * functions];
        out.par_chunks_exact_mut(functions.max(1)).enumerate().for_each(|(row, out)| {
            for (i, values) in basis.chunks_exact(functions).enumerate() {
                let (re, im) = (self.re[row * self.n + i] as f64, self.im[row * self.n + i] as f64);
                for (out, v) in out.iter_mut().zip(values) {
                    out[0] += re * *v as f64;
                    out[1] += im * *v as f64;
                }
            }
        });
        out
    }

    /// Returns the index of the real part of row (antenna, subcarrier) in an observation; the imaginary part is one row
    /// below.
    fn real_index(&self, row: usize) -> usize {
        gain_indices(row / self.columns, row % self.columns, self.columns)[0]
    }

    /// Returns the cotangents of the signals `[N, L, 2]` and of the waves (real, imaginary, in the layout of
    /// [`Waves`]), given those `d` of the observations.
    pub(super) fn superpose_vjp(&self, signals: &[Real], links: usize, d: &[Real]) -> (Vec<Real>, Vec<[Real; 2]>) {
        let (n, numbers) = (self.n, 2 * self.re.len() / self.n.max(1));
        let mut d_signals = vec![0.0; signals.len()];
        d_signals.par_chunks_exact_mut((2 * links).max(1)).enumerate().for_each(|(i, d_signals)| {
            for (d_signal, d) in d_signals.chunks_exact_mut(2).zip(d.chunks_exact(numbers)) {
                for row in 0..numbers / 2 {
                    let (re, im, at) = (self.re[row * n + i], self.im[row * n + i], self.real_index(row));
                    let (dr, di) = (d[at], d[at + self.columns]);
                    d_signal[0] += re * dr + im * di;
                    d_signal[1] += re * di - im * dr;
                }
            }
        });
        let mut d_waves = vec![[0.0; 2]; self.re.len()];
        d_waves.par_chunks_exact_mut(n.max(1)).enumerate().for_each(|(row, d_row)| {
            let at = self.real_index(row);
            for (l, d) in d.chunks_exact(numbers).enumerate() {
                let (dr, di) = (d[at], d[at + self.columns]);
                for (i, d_wave) in d_row.iter_mut().enumerate() {
                    let [a, b] = [0, 1].map(|c| signals[(i * links + l) * 2 + c]);
                    d_wave[0] += dr * a + di * b;
                    d_wave[1] += di * a - dr * b;
                }
            }
        });
        (d_signals, d_waves)
    }

    /// Adds to the cotangents of means and gate in `grads`, given those `d_waves` of [`Self::superpose_vjp`].
    pub(super) fn vjp(call: &Call<'_>, state: ReceiverState, d_waves: &[[Real; 2]], grads: &mut ActivationVjp) {
        let Call { setup, parameters: Parameters { cloud, gate, .. }, .. } = *call;
        let (n, frequencies) = (cloud.len(), setup.frequencies_of(state.receiver));
        let (columns, antennas) = (frequencies.len(), antenna_positions(setup, state));
        grads.cloud.means.par_iter_mut().zip(&mut grads.gate).enumerate().for_each(|(i, (d_mean, d_gate))| {
            let open = gate.map_or(1.0, |gate| gate[i] as f64);
            for (row, d) in d_waves.chunks_exact(n).enumerate() {
                let d = d[i].map(|d| d as f64);
                let k = std::f64::consts::TAU * frequencies[row % columns] / SPEED_OF_LIGHT;
                let (offset, distance) = offset_and_distance(&cloud.means[i], &antennas[row / columns]);
                let (sin, cos) = (k * distance).sin_cos();
                *d_gate += ((d[0] * cos - d[1] * sin) / distance) as Real;
                let along = open * wave_slope(d, k, distance, (sin, cos));
                d_mean.iter_mut().zip(offset).for_each(|(sum, v)| *sum += (along * v) as Real);
            }
        });
    }

    /// Returns the cotangents of position and orientation (x, y, z, w) of the receiver, given those `d_waves` of
    /// [`Self::superpose_vjp`].
    pub(super) fn pose_vjp(call: &Call<'_>, state: ReceiverState, d_waves: &[[Real; 2]]) -> ([f64; 3], [f64; 4]) {
        let Call { setup, parameters: Parameters { cloud, gate, .. }, .. } = *call;
        let frequencies = setup.frequencies_of(state.receiver);
        let (centre, mut d_position, mut d_rotation) = (DVec3::from(state.pose.position), DVec3::ZERO, DVec3::ZERO);
        let antenna_waves = d_waves.chunks_exact((frequencies.len() * cloud.len()).max(1));
        for (antenna, d_waves) in antenna_positions(setup, state).into_iter().zip(antenna_waves) {
            let mut d_antenna = DVec3::ZERO;
            for (hz, d) in frequencies.iter().zip(d_waves.chunks_exact(cloud.len())) {
                let k = std::f64::consts::TAU * hz / SPEED_OF_LIGHT;
                for (i, (mean, d)) in cloud.means.iter().zip(d).enumerate() {
                    let (offset, distance) = offset_and_distance(mean, &antenna);
                    let open = gate.map_or(1.0, |gate| gate[i] as f64);
                    let along = wave_slope(d.map(|d| d as f64), k, distance, (k * distance).sin_cos());
                    d_antenna -= open * along * DVec3::from(offset);
                }
            }
            d_position += d_antenna;
            d_rotation += (DVec3::from(antenna) - centre).cross(d_antenna);
        }
        (d_position.into(), state.pose.rotation_vjp(d_rotation.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{GaussianCloud, ImagePlane, LinkInputs, Origin, PixelSubset, Pose};

    #[test]
    fn pose_derivative_without_gaussians_is_zero() {
        let setup = MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, ImagePlane::plain(1, 1));
        let setup = MeasurementSetup { frequencies_hz: vec![1e9], ..setup };
        let (cloud, links) = (GaussianCloud::zeros(0), LinkInputs::default());
        let parameters = Parameters { cloud: &cloud, gate: None, existence: None, weights: &[] };
        let call = Call { setup: &setup, parameters, links: &links, pixels: &PixelSubset::All };
        let state = ReceiverState { receiver: 0, pose: Pose::IDENTITY };
        assert_eq!(Waves::pose_vjp(&call, state, &[]), ([0.0; 3], [0.0; 4]));
    }
}
