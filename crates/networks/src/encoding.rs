//! `Encoding`: positional encodings. That of octaves is γ(x) = [x, sin 2⁰x, cos 2⁰x, …, sin 2^(L-1)x, cos 2^(L-1)x], each
//! block three wide.
//!
//! γ has no factor π and no scaling: x is in metres and 2^k x in radians (as in WRF-GS). The result is feature-major,
//! `[3 + 6L, R]`, as the layers expect it (see `dense`).
//!
//! Only sine and cosine of x itself are computed by the library, in double precision. Each next frequency follows by
//! sin 2a = 2 sin a cos a, cos 2a = 1 - 2 sin² a. Each doubling multiplies the error by two to four, which in single
//! precision would exceed 3e-5 after nine doublings. In double precision, for coordinates up to 40 m, the largest error
//! found is 1.2e-12 at L = 10 and 2e-10 at L = 16, below the rounding of the result to `f32`.

use crate::dense;
use crate::linear::{Linear, WIDEST};
use pwrfgs_core::{Conditions, JsonSchema, Real, WeightSpec, rng};
use serde::{Deserialize, Serialize};

/// Maximum number of frequencies for which angle doubling gives full single precision; 2¹⁵ rad/m is a period of 0.2 mm.
pub const MOST_FREQUENCIES: usize = 16;

/// Rejects more than [`MOST_FREQUENCIES`] frequencies; the error names the setting.
pub(crate) fn check_frequencies(name: &str, frequencies: usize) -> Result<(), String> {
    if frequencies > MOST_FREQUENCIES {
        return Err(format!("{name} is {frequencies}; give a number from 0 to {MOST_FREQUENCIES}"));
    }
    Ok(())
}

/// Returns the number of components of γ per point, 3 + 6L.
pub fn encoded_width(frequencies: usize) -> usize {
    3 + 6 * frequencies
}

/// Encodes R points with octaves into `out` `[3 + 6L, R]`.
pub fn encode(points: impl ExactSizeIterator<Item = [Real; 3]>, frequencies: usize, out: &mut [Real]) {
    let rows = points.len();
    assert_eq!(out.len(), rows * encoded_width(frequencies), "one column per point");
    let (plain, mut waves) = out.split_at_mut(3 * rows);
    for (r, x) in points.enumerate() {
        (0..3).for_each(|k| plain[k * rows + r] = x[k]);
    }
    if frequencies == 0 {
        return;
    }
    let (mut sines, mut cosines): (Vec<f64>, Vec<f64>) = plain.iter().map(|&x| f64::from(x).sin_cos()).unzip();
    loop {
        let (block, later) = waves.split_at_mut(6 * rows);
        let (s_out, c_out) = block.split_at_mut(3 * rows);
        let is_last = later.is_empty();
        store_and_double(s_out, c_out, &mut sines, &mut cosines);
        if is_last {
            return;
        }
        waves = later;
    }
}

/// Stores `sines` and `cosines` in `s_out` and `c_out`, then doubles the angles of the former in place.
fn store_and_double(s_out: &mut [Real], c_out: &mut [Real], sines: &mut [f64], cosines: &mut [f64]) {
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            for (((s_out, c_out), s), c) in s_out.iter_mut().zip(c_out).zip(sines).zip(cosines) {
                (*s_out, *c_out) = (*s as Real, *c as Real);
                (*s, *c) = (2.0 * *s * *c, 1.0 - 2.0 * *s * *s);
            }
        },
    );
}

/// Adds the derivative through γ to `d_points`; `encoded` is the result of [`encode`], `d` its cotangent.
pub fn encode_vjp(encoded: &[Real], d: &[Real], frequencies: usize, d_points: &mut [[Real; 3]]) {
    let rows = d_points.len();
    assert!(encoded.len() == rows * encoded_width(frequencies) && d.len() == encoded.len(), "one column per point");
    for (r, d_point) in d_points.iter_mut().enumerate() {
        for (k, d_x) in d_point.iter_mut().enumerate() {
            let mut sum = d[k * rows + r];
            let mut scale = 1.0;
            for f in 0..frequencies {
                let (s, c) = ((3 + 6 * f + k) * rows + r, (6 + 6 * f + k) * rows + r);
                sum += scale * (encoded[c] * d[s] - encoded[s] * d[c]);
                scale *= 2.0;
            }
            *d_x += sum;
        }
    }
}

/// Positional encoding γ(p).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub enum Encoding {
    /// Sine and cosine of 2⁰…2^(L-1) rad/m along each axis (`NeRF`). L = 5 ends at 16 rad/m, close to 2π/λ at 920 MHz;
    /// the field of a transmitter varies no faster.
    Octaves(usize),
    /// Sine and cosine of kᵢ·p for `count` wave vectors k of random direction (random Fourier features for a
    /// band-limited field). Their lengths are evenly spaced from 0 to `reach`. They follow from `seed` and are not
    /// learned; use different seeds for the models of an ensemble.
    Waves {
        /// Number of wave vectors.
        count: usize,
        /// Length of the longest wave vector, rad/m; slightly above 2π/λ.
        reach: f64,
        /// Random seed of the wave vectors.
        #[serde(default)]
        seed: u64,
    },
    /// Sine and cosine of 2π/λ along each axis, or along random directions, for `count` wavelengths in geometric sequence,
    /// and the coordinates times 2π over the longest wavelength. For fields that vary slowly over tens of metres, such as
    /// received powers.
    Wavelengths {
        /// Number of wavelengths.
        count: usize,
        /// Longest wavelength, metres; about the size of the site.
        longest_m: f64,
        /// Shortest wavelength, metres. Faster variations cannot be represented, which reduces overfitting to noise.
        shortest_m: f64,
        /// Random seed of the directions of three waves per wavelength. Without it they lie along the axes, and errors
        /// appear as stripes along the axes.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        seed: Option<u64>,
    },
    /// Feature vector that replaces the transmitter position in the data, unchanged. Only for the transmitter.
    /// The features of the network then include it, so that signals may be linear in it.
    Features {
        /// Length of the feature vector.
        width: usize,
        /// Factor that scales the features to about 1.
        #[serde(default = "default_gain")]
        gain: f64,
    },
    /// Pseudo-position from the feature vector that replaces the transmitter position, as in `GSRF`. It is 2 tanh of
    /// three learned linear maps of the features, encoded by sine and cosine of `octaves` frequencies. Only for the
    /// transmitter.
    PseudoPosition {
        /// Length of the feature vector.
        width: usize,
        /// Factor that scales the features to about 1.
        #[serde(default = "default_gain")]
        gain: f64,
        /// Number of frequencies 2⁰…2^(L-1) of the encoding.
        octaves: usize,
    },
}

/// Returns the default of `gain`.
fn default_gain() -> f64 {
    1.0
}

impl Default for Encoding {
    fn default() -> Self {
        Self::Octaves(5)
    }
}

impl Encoding {
    /// Returns the number of components of γ.
    pub(super) fn width(&self) -> usize {
        match *self {
            Self::Octaves(frequencies) => encoded_width(frequencies),
            Self::Waves { count, .. } => 3 + 2 * count,
            Self::Wavelengths { count, .. } => 3 + 6 * count,
            Self::Features { width, .. } => width,
            Self::PseudoPosition { octaves, .. } => encoded_width(octaves),
        }
    }

    /// Returns the number of values per transmitter that the encoding reads.
    pub(super) fn input_count(&self) -> usize {
        match *self {
            Self::Features { width, .. } | Self::PseudoPosition { width, .. } => width,
            _ => 3,
        }
    }

    /// Returns whether the encoding reads features in place of a position.
    pub(super) fn requires_features(&self) -> bool {
        matches!(self, Self::Features { .. } | Self::PseudoPosition { .. })
    }

    /// Rejects invalid settings; the error names the `field` that holds this encoding.
    pub(super) fn check(&self, field: &str) -> Result<(), String> {
        match *self {
            Self::Octaves(frequencies) => check_frequencies(field, frequencies),
            Self::Waves { count, .. } if count > WIDEST => {
                Err(format!("{field}: count is {count}; give a number from 0 to {WIDEST}"))
            }
            Self::Waves { reach, .. } if !(reach > 0.0 && reach.is_finite()) => {
                Err(format!("{field}: reach is {reach}; give rad/m above 0, about 2π over the wavelength"))
            }
            Self::Wavelengths { count, longest_m, shortest_m, .. } => {
                // Three waves per wavelength.
                if count > WIDEST / 3 {
                    return Err(format!("{field}: count is {count}; give a number from 0 to {}", WIDEST / 3));
                }
                if shortest_m > 0.0 && longest_m >= shortest_m && longest_m.is_finite() {
                    return Ok(());
                }
                Err(format!(
                    "{field}: wavelengths of {longest_m} to {shortest_m} m; give the longest, then a shorter one above 0"
                ))
            }
            Self::PseudoPosition { octaves, .. } if octaves > MOST_FREQUENCIES => {
                check_frequencies(&format!("{field}: octaves"), octaves)
            }
            Self::Features { width, .. } | Self::PseudoPosition { width, .. } if !(1..=WIDEST).contains(&width) => {
                Err(format!("{field}: width is {width}; give a number from 1 to {WIDEST}"))
            }
            Self::Features { gain, .. } | Self::PseudoPosition { gain, .. } if !gain.is_finite() || gain == 0.0 => {
                Err(format!("{field}: gain is {gain}; give a finite number that is not 0"))
            }
            Self::Waves { .. } | Self::Features { .. } | Self::PseudoPosition { .. } => Ok(()),
        }
    }

    /// Returns the wave vectors `[vectors, 3]`, rad/m, as tensor `field` of the model file, since other programs cannot
    /// reproduce them from the seed; `None` for encodings without wave vectors.
    pub(super) fn constants(&self, field: &str) -> Option<(WeightSpec, Vec<Real>)> {
        let Encoder::Waves(vectors, _) = self.encoder() else { return None };
        let spec = WeightSpec::zeros(field, vec![vectors.len(), 3]);
        Some((spec, vectors.into_flattened().into_iter().map(|k| k as Real).collect()))
    }

    /// Returns the encoder; computes its wave vectors.
    pub(super) fn encoder(&self) -> Encoder {
        match *self {
            Self::Octaves(frequencies) => Encoder::Octaves(frequencies),
            Self::Waves { count, reach, seed } => {
                let mut direction = random_directions(seed);
                let vector = |i: usize| direction().map(|v| v * ((i as f64 + 0.5) / count as f64) * reach);
                Encoder::Waves((0..count).map(vector).collect(), 1.0)
            }
            Self::Wavelengths { count, longest_m, shortest_m, seed } => {
                // From 0 for the longest to 1 for the shortest.
                let ratio = |i: usize| i as f64 / count.saturating_sub(1).max(1) as f64;
                let wavenumber =
                    |i: usize| std::f64::consts::TAU / (longest_m * (shortest_m / longest_m).powf(ratio(i)));
                let axis = |i: usize| std::array::from_fn(|k| if k == i % 3 { wavenumber(i / 3) } else { 0.0 });
                // Three waves per wavelength.
                let vectors = match seed.map(random_directions) {
                    None => (0..3 * count).map(axis).collect(),
                    Some(mut direction) => (0..3 * count).map(|i| direction().map(|v| v * wavenumber(i / 3))).collect(),
                };
                Encoder::Waves(vectors, std::f64::consts::TAU / longest_m)
            }
            Self::Features { width, gain } => Encoder::Features(width, gain),
            Self::PseudoPosition { octaves, .. } => Encoder::Octaves(octaves),
        }
    }
}

/// Returns a generator of random unit vectors.
fn random_directions(seed: u64) -> impl FnMut() -> [f64; 3] {
    let mut random = rng::stream(seed, "waves", 0);
    move || {
        let direction = [(); 3].map(|()| f64::from(rng::normal(&mut random)));
        let norm = direction.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9); // no division by 0
        direction.map(|v| v / norm)
    }
}

/// Encoding with its constants computed.
#[derive(Debug)]
pub(super) enum Encoder {
    Octaves(usize),
    /// Wave vectors, and the factor on the coordinates.
    Waves(Vec<[f64; 3]>, f64),
    /// Width and gain of the features.
    Features(usize, f64),
}

impl Encoder {
    /// Encodes B transmitters, by position or features, into `out` `[width, B]`, with [`Encoding::width`].
    pub(super) fn encode_transmitters(&self, txs: Conditions<'_>, out: &mut [Real]) {
        let Self::Features(width, gain) = *self else { return self.encode(txs.positions(), out) };
        let rows = txs.len();
        for (r, row) in txs.values().chunks_exact(width).enumerate() {
            row.iter().enumerate().for_each(|(k, v)| out[k * rows + r] = v * gain as Real);
        }
    }

    /// Encodes B points into `out` `[width, B]`: the coordinates, then sine and cosine wave by wave, or as [`encode`] for
    /// octaves. Does nothing for features.
    pub(super) fn encode(&self, points: &[[Real; 3]], out: &mut [Real]) {
        let (vectors, scale) = match self {
            Self::Octaves(frequencies) => return encode(points.iter().copied(), *frequencies, out),
            Self::Waves(vectors, scale) => (vectors, *scale as Real),
            Self::Features(..) => return,
        };
        let rows = points.len();
        for (r, point) in points.iter().enumerate() {
            let x = point.map(f64::from);
            (0..3).for_each(|k| out[k * rows + r] = scale * point[k]);
            for (i, k) in vectors.iter().enumerate() {
                let (sin, cos) = (k[0] * x[0] + k[1] * x[1] + k[2] * x[2]).sin_cos();
                let row = 3 + 2 * i;
                (out[row * rows + r], out[(row + 1) * rows + r]) = (sin as Real, cos as Real);
            }
        }
    }

    /// Adds the derivative of [`Self::encode`] to `d_points`, given γ of points and its cotangent, `[width, B]` each.
    pub(super) fn encode_vjp(&self, (gamma, d_gamma): (&[Real], &[Real]), d_points: &mut [[Real; 3]]) {
        let rows = d_points.len();
        let scale = if let Self::Waves(_, scale) = self { *scale as Real } else { 1.0 };
        for (r, d_point) in d_points.iter_mut().enumerate() {
            d_point.iter_mut().enumerate().for_each(|(k, sum)| *sum += scale * d_gamma[k * rows + r]);
        }
        self.waves_vjp(&gamma[3 * rows..], &d_gamma[3 * rows..], d_points);
    }

    /// Adds the derivative through the waves to `d_points`, given their values `[width - 3, N]` (γ without the
    /// coordinates) and their cotangents.
    pub(super) fn waves_vjp(&self, waves: &[Real], d_waves: &[Real], d_points: &mut [[Real; 3]]) {
        let rows = d_points.len();
        match self {
            Self::Octaves(frequencies) => {
                // [`encode_vjp`] expects the coordinates too.
                let padded = |waves: &[Real]| [vec![0.0; 3 * rows].as_slice(), waves].concat();
                encode_vjp(&padded(waves), &padded(d_waves), *frequencies, d_points);
            }
            Self::Features(..) => {}
            Self::Waves(vectors, _) => {
                for (i, k) in vectors.iter().enumerate() {
                    let (sines, cosines) = (2 * i * rows, (2 * i + 1) * rows);
                    for (r, d_point) in d_points.iter_mut().enumerate() {
                        let d = waves[cosines + r] * d_waves[sines + r] - waves[sines + r] * d_waves[cosines + r];
                        d_point.iter_mut().zip(k).for_each(|(sum, k)| *sum += *k as Real * d);
                    }
                }
            }
        }
    }
}

/// Pseudo-position from the features of the data: 2 tanh of a linear layer.
pub(super) struct Pseudo {
    pub(super) layer: Linear,
    pub(super) gain: Real,
    pub(super) octaves: usize,
}

impl Pseudo {
    /// Returns the features times the gain, `[width, B]`.
    fn scaled_features(&self, txs: Conditions<'_>) -> Vec<Real> {
        let (rows, width) = (txs.len(), self.layer.inputs);
        let value = |i: usize| txs.values()[(i % rows) * width + i / rows] * self.gain;
        (0..rows * width).map(value).collect()
    }

    /// Returns the pseudo-positions of B transmitters, coordinates from -2 to 2.
    pub(super) fn positions(&self, weights: &[Real], txs: Conditions<'_>) -> Vec<[Real; 3]> {
        let (rows, mut y) = (txs.len(), Vec::new());
        self.layer.apply(weights, &self.scaled_features(txs), &mut y);
        (0..rows).map(|r| std::array::from_fn(|k| 2.0 * y[k * rows + r].tanh())).collect()
    }

    /// Adds the derivatives of the layer to `d_weights`, given the encoding γ of the pseudo-positions and its cotangent.
    pub(super) fn vjp(
        &self,
        weights: &[Real],
        txs: Conditions<'_>,
        (gamma, d_gamma): (&[Real], &[Real]),
        d_weights: &mut [Real],
    ) {
        let (rows, positions) = (txs.len(), self.positions(weights, txs));
        let mut d_positions = vec![[0.0; 3]; rows];
        encode_vjp(gamma, d_gamma, self.octaves, &mut d_positions);
        // The derivative of 2 tanh y is 2 (1 - tanh² y).
        let through_tanh = |k: usize, r: usize| d_positions[r][k] * 2.0 * (1.0 - (positions[r][k] / 2.0).powi(2));
        let d_y: Vec<Real> = (0..3 * rows).map(|i| through_tanh(i / rows, i % rows)).collect();
        dense::add_bias_vjp(&d_y, self.layer.bias_mut(d_weights));
        self.layer.whole().weight_vjp(d_weights, &self.scaled_features(txs), &d_y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::testing::check_vjp;

    fn points(n: usize, size: Real) -> Vec<[Real; 3]> {
        let mut random = rng::stream(3, "encoding", 0);
        (0..n).map(|_| std::array::from_fn(|_| size * (2.0 * rng::uniform(&mut random) - 1.0))).collect()
    }

    /// Returns the largest error over points in a cube of ±40 m.
    fn worst_error(frequencies: usize) -> f64 {
        let points = points(2000, 40.0);
        let mut out = vec![0.0; points.len() * encoded_width(frequencies)];
        encode(points.iter().copied(), frequencies, &mut out);
        let mut worst: f64 = 0.0;
        for (r, x) in points.iter().enumerate() {
            for k in 0..3 {
                let at = |feature: usize| f64::from(out[(feature + k) * points.len() + r]);
                assert_eq!(at(0), f64::from(x[k]));
                for f in 0..frequencies {
                    let (sin, cos) = (f64::from(x[k]) * f64::from(1 << f)).sin_cos();
                    worst = worst.max((at(3 + 6 * f) - sin).abs()).max((at(6 + 6 * f) - cos).abs());
                }
            }
        }
        worst
    }

    #[test]
    fn angle_doubling_is_as_accurate_as_sin_cos_at_40_m() {
        let (ten, most) = (worst_error(10), worst_error(MOST_FREQUENCIES));
        let (ten_allowed, most_allowed) = if size_of::<Real>() == 8 { (2e-12, 2e-8) } else { (4e-8, 1e-7) };
        assert!(ten < ten_allowed && most < most_allowed, "largest errors {ten}, {most}");
    }

    #[test]
    fn encoding_without_frequencies_returns_position() {
        let mut out = vec![0.0; 6];
        encode([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]].into_iter(), 0, &mut out);
        assert_eq!(out, [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
    }

    #[test]
    #[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
    fn derivative_agrees_with_central_differences() {
        let x = points(3, 1.0);
        let encoded = |x: &[Real]| {
            let mut out = vec![0.0; x.len() / 3 * encoded_width(4)];
            encode(x.as_chunks::<3>().0.iter().copied(), 4, &mut out);
            out
        };
        let vjp = |x: &[Real], d: &[Real]| {
            let mut d_x = vec![[0.0; 3]; x.len() / 3];
            encode_vjp(&encoded(x), d, 4, &mut d_x);
            d_x.into_flattened()
        };
        check_vjp("encoding", x.as_flattened(), encoded, vjp, 1e-6, 1e-7);
    }

    #[test]
    fn encoding_waves_have_set_lengths_and_seeded_directions() {
        let vectors = |seed| match (Encoding::Waves { count: 40, reach: 20.0, seed }).encoder() {
            Encoder::Waves(vectors, _) => vectors,
            _ => unreachable!("they are waves"),
        };
        let lengths: Vec<f64> = vectors(0).iter().map(|k| k.iter().map(|v| v * v).sum::<f64>().sqrt()).collect();
        assert!(lengths.iter().enumerate().all(|(i, l)| (l - 0.5 * (i as f64 + 0.5)).abs() < 1e-6));
        assert_eq!(vectors(0), vectors(0));
        assert_ne!(vectors(0), vectors(1));
        let along = |seed| (Encoding::Wavelengths { count: 2, longest_m: 8.0, shortest_m: 2.0, seed }).encoder();
        let Encoder::Waves(turned, _) = along(Some(0)) else { unreachable!("they are waves") };
        let Encoder::Waves(axes, _) = along(None) else { unreachable!("they are waves") };
        assert!(axes.iter().all(|k| k.iter().filter(|v| **v == 0.0).count() == 2), "{axes:?}");
        assert!(turned.iter().flatten().all(|v| *v != 0.0), "{turned:?}");
        let norm = |k: &[f64; 3]| k.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!(axes.iter().zip(&turned).all(|(a, b)| (norm(a) - norm(b)).abs() < 1e-9), "equal wavelengths");
    }
}
