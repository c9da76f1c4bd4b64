//! Activation: from a cloud and its calibration terms to [`Primitives`] and signals, and the backward pass. Eq. (6) of
//! the paper.
//!
//! Base parameters are unconstrained. Here they become scales, unit quaternions and opacities, are combined with the
//! outputs of the deformation, and are multiplied by the gate M of the pruners (opacity and scale alike, as in
//! Compact-3DGS).

use pwrfgs_core::{Deltas, GaussianCloud, JsonSchema, Primitives, Real, sigmoid};
use serde::{Deserialize, Serialize};

/// How outputs of the deformation network are combined with the learned parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Calibration {
    /// Scales exp(log s) + Δ, not below 0.1 mm; rotations normalise(q/|q| + Δ); signals s + Δ, signed.
    #[default]
    Physical,
    /// As in the released code: scales may become negative, rotations are not normalised again, signals become colours
    /// max(0, 0.2821·(s + |Δ|) + 0.5), and the blended spectrum is clamped to [0, 1] before the loss. A network that
    /// replaces the signals gives them with their sign.
    AsReleased,
}

/// Smallest scale of [`Calibration::Physical`], metres: far below a pixel at any distance in a room.
const SCALE_FLOOR: Real = 1e-4;
/// Norm up to which a quaternion has no direction.
const NORM_FLOOR: Real = 1e-12;
/// Constant spherical harmonic Y₀₀.
const SH_C0: Real = 0.282_094_791_773_878_14;

/// Settings of the activation of Gaussians.
#[derive(Clone, Copy, Debug)]
pub struct Activation {
    /// Combination of the outputs of the deformation with the learned parameters.
    pub calibration: Calibration,
    /// Whether the deformation's signals replace the cloud's.
    pub replaces_signals: bool,
    /// Number of channels per signal: 1 or 2.
    pub channels: usize,
}

/// Accumulated derivatives with respect to the inputs of an [`Activation`].
#[derive(Clone, Debug)]
pub struct ActivationVjp {
    /// Derivative with respect to the cloud; extra columns stay 0.
    pub cloud: GaussianCloud,
    /// Derivative with respect to the calibration terms.
    pub deltas: Deltas,
    /// Derivative with respect to the gate, `[N]`.
    pub gate: Vec<Real>,
}

impl ActivationVjp {
    /// Creates zeros of the shapes of `cloud` and `deltas`.
    pub fn zeros(cloud: &GaussianCloud, deltas: &Deltas) -> Self {
        Self { cloud: cloud.zeros_like(), deltas: deltas.zeros_like(), gate: vec![0.0; cloud.len()] }
    }
}

impl Activation {
    /// Returns the geometry for transmitter `b` of the batch in `deltas`, whose missing terms are 0, with scales and opacities
    /// times `gate` `[N]` (`None`: all open).
    pub fn geometry(&self, cloud: &GaussianCloud, deltas: &Deltas, b: usize, gate: Option<&[Real]>) -> Primitives {
        let n = cloud.len();
        let mut out = Primitives::zeros(n);
        out.means.copy_from_slice(&cloud.means);
        for i in 0..n {
            let m = gate.map_or(1.0, |g| g[i]);
            let d_scale = deltas.scales.get(b * n + i).copied().unwrap_or_default();
            let d_quat = deltas.quats.get(b * n + i).copied().unwrap_or_default();
            for k in 0..3 {
                let s = cloud.log_scales[i][k].exp() + d_scale[k];
                out.scales[i][k] = m * if self.calibration == Calibration::Physical { s.max(SCALE_FLOOR) } else { s };
            }
            let sum = sum_quats(normalise_quat(cloud.quats[i]), d_quat);
            out.quats[i] = match self.calibration {
                Calibration::Physical => normalise_quat(sum),
                Calibration::AsReleased => sum,
            };
            out.opacities[i] = m * sigmoid(cloud.opacity_logits[i]);
        }
        out
    }

    /// Adds the derivatives of [`Self::geometry`] to `sums` (transmitter `b` of its deltas), given the cotangents `d`.
    pub fn geometry_vjp(
        &self,
        cloud: &GaussianCloud,
        deltas: &Deltas,
        b: usize,
        gate: Option<&[Real]>,
        d: &Primitives,
        sums: &mut ActivationVjp,
    ) {
        let ActivationVjp { cloud: d_cloud, deltas: d_deltas, gate: d_gate } = sums;
        let n = cloud.len();
        for i in 0..n {
            let m = gate.map_or(1.0, |g| g[i]);
            let d_scale = deltas.scales.get(b * n + i).copied().unwrap_or_default();
            for k in 0..3 {
                d_cloud.means[i][k] += d.means[i][k];
                let base = cloud.log_scales[i][k].exp();
                let s = base + d_scale[k];
                let floored = self.calibration == Calibration::Physical && s < SCALE_FLOOR;
                d_gate[i] += d.scales[i][k] * if floored { SCALE_FLOOR } else { s };
                if !floored {
                    d_cloud.log_scales[i][k] += m * d.scales[i][k] * base;
                    if let Some(row) = d_deltas.scales.get_mut(b * n + i) {
                        row[k] += m * d.scales[i][k];
                    }
                }
            }
            let mut d_quat = d.quats[i];
            if self.calibration == Calibration::Physical {
                let delta = deltas.quats.get(b * n + i).copied().unwrap_or_default();
                d_quat = normalise_quat_vjp(sum_quats(normalise_quat(cloud.quats[i]), delta), d_quat);
            }
            if let Some(row) = d_deltas.quats.get_mut(b * n + i) {
                *row = sum_quats(*row, d_quat);
            }
            d_cloud.quats[i] = sum_quats(d_cloud.quats[i], normalise_quat_vjp(cloud.quats[i], d_quat));
            let o = sigmoid(cloud.opacity_logits[i]);
            d_gate[i] += d.opacities[i] * o;
            d_cloud.opacity_logits[i] += m * d.opacities[i] * o * (1.0 - o);
        }
    }

    /// Returns the signals of the transmitters `batch` of `deltas`, whose missing terms are 0, for the rasterizer,
    /// `[N, batch · channels]`.
    pub fn signals(&self, cloud: &GaussianCloud, deltas: &Deltas, batch: std::ops::Range<usize>) -> Vec<Real> {
        let n = cloud.len();
        let mut out = Vec::with_capacity(n * batch.len() * self.channels);
        for i in 0..n {
            for b in batch.clone() {
                for c in 0..self.channels {
                    let s = self.signal(cloud, deltas, b * n + i, i, c);
                    out.push(match self.calibration {
                        Calibration::Physical => s,
                        Calibration::AsReleased => (SH_C0 * s + 0.5).max(0.0),
                    });
                }
            }
        }
        out
    }

    /// Adds the derivatives of [`Self::signals`] to `sums`, given the cotangents `d` `[N, batch · channels]`.
    pub fn signals_vjp(
        &self,
        cloud: &GaussianCloud,
        deltas: &Deltas,
        batch: std::ops::Range<usize>,
        d: &[Real],
        sums: &mut ActivationVjp,
    ) {
        let ActivationVjp { cloud: d_cloud, deltas: d_deltas, .. } = sums;
        let n = cloud.len();
        let mut d = d.iter();
        for i in 0..n {
            for b in batch.clone() {
                for c in 0..self.channels {
                    let mut d_signal = *d.next().expect("one cotangent per signal");
                    if self.calibration == Calibration::AsReleased {
                        let colour = SH_C0 * self.signal(cloud, deltas, b * n + i, i, c) + 0.5;
                        d_signal *= if colour > 0.0 { SH_C0 } else { 0.0 };
                    }
                    if !self.replaces_signals {
                        d_cloud.signals[i][c] += d_signal;
                    }
                    if let Some(row) = d_deltas.signals.get_mut(b * n + i) {
                        let is_negated = self.requires_magnitudes() && deltas.signals[b * n + i][c] < 0.0;
                        row[c] += if is_negated { -d_signal } else { d_signal };
                    }
                }
            }
        }
    }

    /// Returns whether a signal is s + |Δ|: WRF-GS+ adds the magnitude of the complex output of its network.
    fn requires_magnitudes(&self) -> bool {
        self.calibration == Calibration::AsReleased && !self.replaces_signals
    }

    /// Returns channel `c` of the signal of Gaussian `i` with the terms of `row`, before the released colour conversion.
    fn signal(&self, cloud: &GaussianCloud, deltas: &Deltas, row: usize, i: usize, c: usize) -> Real {
        let base = if self.replaces_signals { 0.0 } else { cloud.signals[i][c] };
        let delta = deltas.signals.get(row).map_or(0.0, |d| d[c]);
        base + if self.requires_magnitudes() { delta.abs() } else { delta }
    }
}

/// Returns the sum of two quaternions, component by component.
fn sum_quats(a: [Real; 4], b: [Real; 4]) -> [Real; 4] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]]
}

/// Returns the scalar product of two quaternions.
fn dot_quats(a: [Real; 4], b: [Real; 4]) -> Real {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
}

/// Divides all components of a quaternion by `norm`.
fn divide_quat(q: [Real; 4], norm: Real) -> [Real; 4] {
    [q[0] / norm, q[1] / norm, q[2] / norm, q[3] / norm]
}

/// Returns q/|q| of a quaternion w, x, y, z; the identity for a quaternion close to zero.
pub fn normalise_quat(q: [Real; 4]) -> [Real; 4] {
    let norm = dot_quats(q, q).sqrt();
    if norm > NORM_FLOOR { divide_quat(q, norm) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Returns the cotangent of q, given that `d` of [`normalise_quat`]; zero for a quaternion close to zero.
pub fn normalise_quat_vjp(q: [Real; 4], d: [Real; 4]) -> [Real; 4] {
    let norm = dot_quats(q, q).sqrt();
    if norm <= NORM_FLOOR {
        return [0.0; 4];
    }
    let unit = divide_quat(q, norm);
    let along = dot_quats(unit, d);
    let across = |k: usize| (d[k] - unit[k] * along) / norm;
    [across(0), across(1), across(2), across(3)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::rng;
    use pwrfgs_core::testing::check_vjp;

    const N: usize = 3;
    const BATCH: usize = 2;

    /// Splits one flat vector into cloud, deltas and gate, to differentiate with respect to every input.
    fn unpack(x: &[Real]) -> (GaussianCloud, Deltas, Vec<Real>) {
        let mut x = x.iter().copied();
        let mut next = || x.next().unwrap();
        let mut cloud = GaussianCloud::zeros(N);
        cloud.columns_mut().for_each(|(_, _, v)| v.iter_mut().for_each(|v| *v = next()));
        let mut deltas = Deltas {
            scales: vec![[0.0; 3]; N * BATCH],
            quats: vec![[0.0; 4]; N * BATCH],
            signals: vec![[0.0; 2]; N * BATCH],
        };
        deltas.scales.as_flattened_mut().iter_mut().for_each(|v| *v = 0.2 * next());
        deltas.quats.as_flattened_mut().iter_mut().for_each(|v| *v = 0.2 * next());
        deltas.signals.as_flattened_mut().iter_mut().for_each(|v| *v = next());
        let gate = (0..N).map(|_| next()).collect();
        (cloud, deltas, gate)
    }

    fn pack(cloud: &GaussianCloud, deltas: &Deltas, gate: &[Real]) -> Vec<Real> {
        let mut x: Vec<Real> = cloud.columns().flat_map(|(_, _, v)| v.to_vec()).collect();
        x.extend(deltas.scales.as_flattened().iter().map(|v| 0.2 * v));
        x.extend(deltas.quats.as_flattened().iter().map(|v| 0.2 * v));
        x.extend(deltas.signals.as_flattened());
        x.extend(gate);
        x
    }

    fn check(activation: Activation) {
        let mut random = rng::stream(3, "activate", 0);
        let size = N * 13 + N * BATCH * 9 + N;
        let x: Vec<Real> = (0..size).map(|_| 0.5 * rng::normal(&mut random) + 0.3).collect();
        let b = 1;
        let f = |x: &[Real]| {
            let (cloud, deltas, gate) = unpack(x);
            let g = activation.geometry(&cloud, &deltas, b, Some(&gate));
            let mut out: Vec<Real> = g.means.as_flattened().to_vec();
            out.extend(g.scales.as_flattened());
            out.extend(g.quats.as_flattened());
            out.extend(&g.opacities);
            out.extend(activation.signals(&cloud, &deltas, 0..BATCH));
            out
        };
        let vjp = |x: &[Real], d: &[Real]| {
            let (cloud, deltas, gate) = unpack(x);
            let mut g = Primitives::zeros(N);
            let mut d = d.iter().copied();
            let mut fill = |v: &mut [Real]| v.iter_mut().for_each(|v| *v = d.next().unwrap());
            fill(g.means.as_flattened_mut());
            fill(g.scales.as_flattened_mut());
            fill(g.quats.as_flattened_mut());
            fill(&mut g.opacities);
            let d_signals: Vec<Real> = d.collect();
            let mut sums = ActivationVjp::zeros(&cloud, &deltas);
            activation.geometry_vjp(&cloud, &deltas, b, Some(&gate), &g, &mut sums);
            activation.signals_vjp(&cloud, &deltas, 0..BATCH, &d_signals, &mut sums);
            pack(&sums.cloud, &sums.deltas, &sums.gate)
        };
        check_vjp("activate", &x, f, vjp, 1e-6, 1e-6);
    }

    #[test]
    fn released_signals_add_magnitudes_of_network() {
        let (mut cloud, deltas) =
            (GaussianCloud::zeros(1), Deltas { signals: vec![[-0.5, 0.25]], ..Deltas::default() });
        cloud.signals[0] = [0.1, -0.2];
        let colours = |replaces_signals| {
            let activation = Activation { calibration: Calibration::AsReleased, replaces_signals, channels: 2 };
            activation.signals(&cloud, &deltas, 0..1)
        };
        assert_eq!(colours(false), [0.6, 0.05].map(|s: Real| SH_C0 * s + 0.5), "s + |Δ|, as in WRF-GS+");
        assert_eq!(colours(true), [-0.5, 0.25].map(|s: Real| SH_C0 * s + 0.5), "a Wrfgs network gives signals");
    }

    #[test]
    #[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
    fn derivatives_agree_with_differences() {
        for calibration in [Calibration::Physical, Calibration::AsReleased] {
            for (replaces_signals, channels) in [(false, 2), (true, 1)] {
                check(Activation { calibration, replaces_signals, channels });
            }
        }
    }
}
