//! The field `h[m,a,f] = Σ gate·s(u)·exp(-jkd)/d` with d = |p − (v + R r)| and k = 2πf/c, and its derivative.
//!
//! Eq. (1) of the paper in space, coherent over the whole room. v `[N,3]` is the mean of a Gaussian, s its signal, R
//! the rotation of its quaternion, r `[A,3]` an antenna of the fixed node in its own frame, p `[M,3]` the moving node.
//! It is exact for the mirror images of the node in flat walls if nothing occludes them. Scales and opacities are
//! ignored. With an extra column of [`HARMONICS`], the signal depends on the direction u from v to p: s(u) = s + Σ
//! c·Y(u).
//!
//! Forward and backward pass process Gaussians in groups of [`LANES`] and items on threads; the order of sums does not
//! depend on the number of threads.

use crate::virtual_transmitters::cis::Cis;
use crate::virtual_transmitters::harmonics::{
    CLOSEST, HARMONICS, MOST, direction_and_distance, direction_vjp, harmonic_gradients, harmonics,
};
use crate::virtual_transmitters::links::ChannelInputs;
use crate::virtual_transmitters::turn::{rotate_vector, rotation_matrix, rotation_matrix_vjp, unit_quat};
use pwrfgs_core::{GaussianCloud, Real, SPEED_OF_LIGHT, consts::TAU, widest};
use rayon::prelude::*;

/// Number of Gaussians processed together.
const LANES: usize = 16;
/// Number of blocks of items whose derivatives are summed separately, then in order.
const BLOCKS: usize = 16;

type Lane = [Real; LANES];
const ZERO: Lane = [0.0; LANES];

/// Derivative of a scalar by all inputs of [`field`] from a cloud.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldVjp {
    /// Derivatives by `means`, `quats`, `signals` and [`HARMONICS`]; the other columns are zero.
    pub cloud: GaussianCloud,
    /// Derivatives by the gates `[N]`, also if no gates were given.
    pub gate: Vec<Real>,
}

/// Group of LANES Gaussians: antennas `[A]` as x, y, z, and gains.
struct AntennaGroup {
    antennas: Vec<[Lane; 3]>,
    means: [[f64; 3]; LANES],
    /// Gains per harmonic `[K]`, including the gate.
    gains: Vec<[Lane; 2]>,
}

impl AntennaGroup {
    /// Returns the signals of the LANES Gaussians in the direction of `p`.
    #[inline(always)]
    fn signal(&self, p: [Real; 3]) -> [Lane; 2] {
        if let [only] = &self.gains[..] {
            return *only;
        }
        let (p, mut out) = (p.map(f64::from), [ZERO; 2]);
        for l in 0..LANES {
            let y = harmonics(direction_and_distance(self.means[l], p).0);
            for (gain, y) in self.gains.iter().zip(y) {
                out[0][l] += gain[0][l] * y as Real;
                out[1][l] += gain[1][l] * y as Real;
            }
        }
        out
    }
}

/// Computes h `[M,A,F]` of all Gaussians, each multiplied by its gate.
///
/// The cost is about 40 operations per value of h and Gaussian. `gate` is `[N]`, or `None` for all 1.
///
/// # Panics
/// If the number of gates is not N, or if the cloud has harmonics above the third order.
pub fn field(cloud: &GaussianCloud, gate: Option<&[Real]>, links: &ChannelInputs<'_>) -> Vec<[Real; 2]> {
    let groups = antenna_groups(cloud, gate, links);
    let (antennas, subcarriers) = (links.antennas.len(), links.frequencies.len());
    let per_metre = wavelengths_per_metre(links);
    let mut out = vec![[0.0; 2]; links.value_count()];
    let scratch = || (vec![[ZERO; 2]; groups.len()], vec![[ZERO; 2]; groups.len()]);
    let items = out.par_chunks_mut((antennas * subcarriers).max(1)).zip(links.positions);
    items.for_each_init(scratch, |(signals, distances), (h, p)| {
        signals.iter_mut().zip(&groups).for_each(|(signal, group)| *signal = group.signal(*p));
        for (a, h) in h.chunks_exact_mut(subcarriers).enumerate() {
            widest(AntennaField { groups: &groups, signals, a, p: *p, per_metre: &per_metre, distances, h });
        }
    });
    out
}

/// Computes the derivative of [`field`]: Σ ⟨d, h⟩ by means, quaternions, signals, harmonics and gates, for a cotangent
/// d `[M,A,F]`.
///
/// # Panics
/// If `d` has another length than the field, if there are fewer gates than Gaussians, or if the cloud has harmonics above
/// the third order.
pub fn field_vjp(cloud: &GaussianCloud, gate: Option<&[Real]>, links: &ChannelInputs<'_>, d: &[[Real; 2]]) -> FieldVjp {
    assert_eq!(d.len(), links.value_count(), "one cotangent per link");
    let groups = antenna_groups(cloud, None, links);
    let per_metre = wavelengths_per_metre(links);
    let block = links.positions.len().div_ceil(BLOCKS).max(64); // positions; fewer are not worth a task
    let blocks = links.positions.len().div_ceil(block);
    let tasks = (0..groups.len() * blocks).into_par_iter().map(|t| {
        let (group, from) = (&groups[t / blocks], t % blocks * block);
        let to = (from + block).min(links.positions.len());
        widest(AntennaFieldVjp { group, links, per_metre: &per_metre, items: from..to, d })
    });
    let sums: Vec<Cotangents> = tasks.collect();
    let mut out = FieldVjp { cloud: cloud.zeros_like(), gate: vec![0.0; cloud.len()] };
    let more = out.cloud.extra.iter().position(|c| c.name == HARMONICS);
    for i in 0..cloud.len() {
        let blocks = &sums[i / LANES * blocks..][..blocks];
        let total = |column: &dyn Fn(&Cotangents) -> &Lane| blocks.iter().map(|b| column(b)[i % LANES]).sum::<Real>();
        let open = gate.map_or(1.0, |g| g[i]);
        let gain = |k: usize| [0, 1].map(|part| open * total(&|b| &b.gains[k][part]));
        out.gate[i] = total(&|b| &b.gate);
        out.cloud.signals[i] = gain(0);
        out.cloud.means[i] = [0, 1, 2].map(|k| open * total(&|b| &b.mean[k]));
        let d_rotation = [0, 1, 2].map(|r| [0, 1, 2].map(|c| f64::from(open * total(&|b| &b.rotation[r][c]))));
        out.cloud.quats[i] = rotation_matrix_vjp(cloud.quats[i].map(f64::from), &d_rotation).map(|x| x as Real);
        if let Some(column) = more.map(|c| &mut out.cloud.extra[c]) {
            let row = &mut column.values[i * column.width..(i + 1) * column.width];
            (1..).zip(row.as_chunks_mut::<2>().0).for_each(|(k, d)| *d = gain(k));
        }
    }
    out
}

/// Returns the wavelengths per metre f/c of the subcarriers `[F]`.
fn wavelengths_per_metre(links: &ChannelInputs<'_>) -> Vec<Real> {
    links.frequencies.iter().map(|f| (f / SPEED_OF_LIGHT) as Real).collect()
}

/// Gathers the Gaussians in groups of LANES, with rotated antennas and gated gains; pads the last group with signal 0.
///
/// # Panics
/// If the number of gates is not that of Gaussians, or if the cloud has more than [`MOST`] harmonics.
fn antenna_groups(cloud: &GaussianCloud, gate: Option<&[Real]>, links: &ChannelInputs<'_>) -> Vec<AntennaGroup> {
    assert!(gate.is_none_or(|g| g.len() == cloud.len()), "one gate per Gaussian");
    let more = cloud.extra(HARMONICS);
    let terms = 1 + more.map_or(0, |c| c.width / 2);
    assert!(terms <= MOST, "at most {MOST} harmonics");
    let group = |g: usize| {
        let mut out = AntennaGroup {
            antennas: vec![[ZERO; 3]; links.antennas.len()],
            means: [[0.0; 3]; LANES],
            gains: vec![[ZERO; 2]; terms],
        };
        for l in 0..LANES {
            let i = g * LANES + l;
            // Padding of the last group repeats its first Gaussian with signal 0.
            let row = if i < cloud.len() { i } else { g * LANES };
            let rotation = rotation_matrix(unit_quat(cloud.quats[row].map(f64::from)));
            out.means[l] = cloud.means[row].map(f64::from);
            for (antenna, r) in out.antennas.iter_mut().zip(links.antennas) {
                let r = rotate_vector(&rotation, r.map(f64::from));
                for k in 0..3 {
                    antenna[k][l] = (out.means[l][k] + r[k]) as Real;
                }
            }
            if i < cloud.len() {
                let gate = gate.map_or(1.0, |g| g[i]);
                let more = more.map_or(&[][..], |c| c.values[i * c.width..(i + 1) * c.width].as_chunks::<2>().0);
                for (gain, [x, y]) in out.gains.iter_mut().zip(std::iter::once(&cloud.signals[i]).chain(more)) {
                    (gain[0][l], gain[1][l]) = (gate * x, gate * y);
                }
            }
        }
        out
    };
    (0..cloud.len().div_ceil(LANES)).into_par_iter().with_min_len(16).map(group).collect()
}

/// Returns the vectors from p to LANES positions, metres, their lengths of at least [`CLOSEST`], and the reciprocals.
#[inline(always)]
fn path_vectors(positions: &[Lane; 3], p: [Real; 3]) -> ([Lane; 3], Lane, Lane) {
    let (mut by, mut d, mut inverse) = ([ZERO; 3], ZERO, ZERO);
    for l in 0..LANES {
        (by[0][l], by[1][l], by[2][l]) = (positions[0][l] - p[0], positions[1][l] - p[1], positions[2][l] - p[2]);
        d[l] = (by[0][l] * by[0][l] + by[1][l] * by[1][l] + by[2][l] * by[2][l]).sqrt().max(CLOSEST as Real);
        inverse[l] = 1.0 / d[l];
    }
    (by, d, inverse)
}

/// Field at one antenna for one item: `h` `[F]`.
struct AntennaField<'a> {
    groups: &'a [AntennaGroup],
    /// Signals of each group in the direction of the item.
    signals: &'a [[Lane; 2]],
    a: usize,
    p: [Real; 3],
    per_metre: &'a [Real],
    /// Distances and their reciprocals, one row per group: a work buffer.
    distances: &'a mut [[Lane; 2]],
    h: &'a mut [[Real; 2]],
}

impl pulp::WithSimd for AntennaField<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        for g in 0..self.groups.len() {
            let (_, d, inverse) = path_vectors(&self.groups[g].antennas[self.a], self.p);
            self.distances[g] = [d, inverse];
        }
        for f in 0..self.h.len() {
            let per_metre = self.per_metre[f];
            let (mut re, mut im) = (ZERO, ZERO);
            for g in 0..self.groups.len() {
                let ([x, y], [d, inverse]) = (&self.signals[g], &self.distances[g]);
                for l in 0..LANES {
                    let (cos, sin) = Real::cis(d[l] * per_metre);
                    re[l] += (x[l] * cos + y[l] * sin) * inverse[l];
                    im[l] += (y[l] * cos - x[l] * sin) * inverse[l];
                }
            }
            self.h[f] = [lane_sum(&re), lane_sum(&im)];
        }
    }
}

/// Sums the lanes in order.
#[inline(always)]
fn lane_sum(lane: &Lane) -> Real {
    let mut total = 0.0;
    for l in 0..LANES {
        total += lane[l];
    }
    total
}

/// Cotangents of LANES Gaussians as if every gate were 1.
struct Cotangents {
    mean: [Lane; 3],
    /// Cotangent of R, by rows.
    rotation: [[Lane; 3]; 3],
    /// Cotangents of the gains per harmonic `[K]`.
    gains: Vec<[Lane; 2]>,
    gate: Lane,
}

/// Backward pass of one group and one block of items.
struct AntennaFieldVjp<'a> {
    group: &'a AntennaGroup,
    links: &'a ChannelInputs<'a>,
    per_metre: &'a [Real],
    items: std::ops::Range<usize>,
    /// Cotangent of the field `[M,A,F]`.
    d: &'a [[Real; 2]],
}

impl pulp::WithSimd for AntennaFieldVjp<'_> {
    type Output = Cotangents;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Cotangents {
        let gains = vec![[ZERO; 2]; self.group.gains.len()];
        let mut out = Cotangents { mean: [ZERO; 3], rotation: [[ZERO; 3]; 3], gains, gate: ZERO };
        let subcarriers = self.per_metre.len();
        for m in self.items {
            let p = self.links.positions[m];
            let (signal, mut d_signal) = (self.group.signal(p), [ZERO; 2]);
            for a in 0..self.links.antennas.len() {
                let first = (m * self.links.antennas.len() + a) * subcarriers;
                let (d_h, r) = (&self.d[first..first + subcarriers], self.links.antennas[a]);
                let (by, d, inverse) = path_vectors(&self.group.antennas[a], p);
                let along = distance_vjp(&signal, &d, &inverse, self.per_metre, d_h, &mut d_signal);
                for l in 0..LANES {
                    let along = if d[l] > CLOSEST as Real { along[l] * inverse[l] } else { 0.0 };
                    for k in 0..3 {
                        let d_antenna = along * by[k][l];
                        out.mean[k][l] += d_antenna;
                        for c in 0..3 {
                            out.rotation[k][c][l] += d_antenna * r[c];
                        }
                    }
                }
            }
            for l in 0..LANES {
                out.gate[l] += signal[0][l] * d_signal[0][l] + signal[1][l] * d_signal[1][l];
                out.gains[0][0][l] += d_signal[0][l];
                out.gains[0][1][l] += d_signal[1][l];
            }
            if out.gains.len() > 1 {
                add_direction_vjp(self.group, p, &d_signal, &mut out);
            }
        }
        out
    }
}

/// Adds the derivatives by the harmonics except the first, and by the means through the direction, to `out`.
fn add_direction_vjp(group: &AntennaGroup, p: [Real; 3], d_signal: &[Lane; 2], out: &mut Cotangents) {
    for l in 0..LANES {
        let (u, d) = direction_and_distance(group.means[l], p.map(f64::from));
        let (y, slopes, mut d_u) = (harmonics(u), harmonic_gradients(u), [0.0; 3]);
        for k in 1..group.gains.len() {
            let mut d_y = 0.0;
            for part in 0..2 {
                out.gains[k][part][l] += d_signal[part][l] * y[k] as Real;
                d_y += f64::from(group.gains[k][part][l] * d_signal[part][l]);
            }
            (0..3).for_each(|c| d_u[c] += d_y * slopes[k][c]);
        }
        let d_mean = direction_vjp(u, d, d_u);
        (0..3).for_each(|c| out.mean[c][l] += d_mean[c] as Real);
    }
}

/// Returns the derivative of ⟨`d_h`, h⟩ by the distance at LANES positions, and adds that by the signal to `d_signal`.
#[inline(always)]
fn distance_vjp(
    [x, y]: &[Lane; 2],
    d: &Lane,
    inverse: &Lane,
    per_metre: &[Real],
    d_h: &[[Real; 2]],
    d_signal: &mut [Lane; 2],
) -> Lane {
    let mut along = ZERO;
    for f in 0..per_metre.len() {
        let ([re, im], k) = (d_h[f], TAU * per_metre[f]);
        for l in 0..LANES {
            let (cos, sin) = Real::cis(d[l] * per_metre[f]);
            // w = conj(d_h)·e with e = exp(-jkd)/d.
            let w = [(re * cos - im * sin) * inverse[l], -(re * sin + im * cos) * inverse[l]];
            let (real, imaginary) = (x[l] * w[0] - y[l] * w[1], x[l] * w[1] + y[l] * w[0]);
            d_signal[0][l] += w[0];
            d_signal[1][l] -= w[1];
            along[l] += k * imaginary - real * inverse[l];
        }
    }
    along
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn padding_and_empty_clouds_give_zero_field() {
        let links = ChannelInputs {
            positions: &[[1.0, 0.0, 0.0], [0.0, 2.0, 0.5]],
            antennas: &[[0.0; 3]],
            frequencies: &[1e9],
        };
        assert_eq!(field(&GaussianCloud::zeros(0), None, &links), vec![[0.0; 2]; 2]);
        let mut one = GaussianCloud::zeros(1);
        one.signals[0] = [1.0, 0.0];
        let h = field(&one, None, &links);
        assert!((h[0][0].hypot(h[0][1]) - 1.0).abs() < 1e-6);
        let gone = field(&one, Some(&[0.0]), &links);
        assert_eq!(gone, vec![[0.0; 2]; 2]);
        assert_eq!(field_vjp(&GaussianCloud::zeros(0), None, &links, &h).gate, Vec::<Real>::new());
    }
}
