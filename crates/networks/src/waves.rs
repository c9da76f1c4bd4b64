//! `Encoding`: what a network sees of a position.

use super::mlp::{WIDEST, check_frequencies};
use crate::layers::encoding::{self, encode, encode_vjp};
use pwrfgs_core::{Conditions, JsonSchema, Real, WeightSpec, rng};
use serde::{Deserialize, Serialize};

/// The encoding γ(p) of a position: the coordinates, and waves over the room.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub enum Encoding {
    /// Sine and cosine of 2⁰…2^(L-1) rad/m along each axis (`NeRF`). 5 ends at 16 rad/m, near 2π/λ at 920 MHz, beyond
    /// which no wave from a transmitter varies.
    Octaves(usize),
    /// Sine and cosine of kᵢ·p for `count` wave vectors k of any direction, their lengths evenly from 0 to `reach`
    /// (random Fourier features, shaped for a band-limited field). Drawn from `seed`: networks of one ensemble had
    /// better each have their own. They are not learned.
    Waves {
        /// Number of wave vectors.
        count: usize,
        /// Length of the longest wave vector, rad/m; slightly above 2π/λ.
        reach: f64,
        /// Random seed of the wave vectors.
        #[serde(default)]
        seed: u64,
    },
    /// Sine and cosine of 2π/λ along each axis for `count` wavelengths in equal ratios, and the coordinates times 2π over
    /// the longest: for fields that vary slowly over tens of metres, such as received powers.
    Wavelengths {
        /// Number of wavelengths.
        count: usize,
        /// Longest wavelength, metres; about the size of the site.
        longest_m: f64,
        /// Shortest wavelength, metres. Faster variations cannot be represented, which reduces overfitting to noise.
        shortest_m: f64,
    },
    /// No position, but the vector that the data have in its place, as it is; of the transmitter only. The network's
    /// features then hold it too, so that signals may be linear in it.
    Features {
        /// Length of the feature vector.
        width: usize,
        /// Factor that scales the features to about 1.
        #[serde(default = "one")]
        gain: f64,
    },
    /// No position, but the vector that the data have in its place, made a pseudo-position: 2 tanh of three learned linear
    /// maps of it, then sine and cosine of `octaves` frequencies, as `GSRF` has it. Of the transmitter only.
    PseudoPosition {
        /// Length of the feature vector.
        width: usize,
        /// Factor that scales the features to about 1.
        #[serde(default = "one")]
        gain: f64,
        /// Frequencies 2⁰…2^(L-1) of the encoding.
        octaves: usize,
    },
}

fn one() -> f64 {
    1.0
}

impl Default for Encoding {
    fn default() -> Self {
        Self::Octaves(5)
    }
}

impl Encoding {
    /// How many numbers γ has.
    pub(super) fn width(&self) -> usize {
        match *self {
            Self::Octaves(frequencies) => encoding::width(frequencies),
            Self::Waves { count, .. } => 3 + 2 * count,
            Self::Wavelengths { count, .. } => 3 + 6 * count,
            Self::Features { width, .. } => width,
            Self::PseudoPosition { octaves, .. } => encoding::width(octaves),
        }
    }

    /// Numbers that it reads of a transmitter.
    pub(super) fn inputs(&self) -> usize {
        match *self {
            Self::Features { width, .. } | Self::PseudoPosition { width, .. } => width,
            _ => 3,
        }
    }

    pub(super) fn check(&self, field: &str) -> Result<(), String> {
        match *self {
            Self::Octaves(frequencies) => check_frequencies(field, frequencies),
            Self::Waves { count, .. } if count > WIDEST => {
                Err(format!("{field}: count is {count}; give a number from 0 to {WIDEST}"))
            }
            Self::Waves { reach, .. } if !(reach > 0.0 && reach.is_finite()) => {
                Err(format!("{field}: reach is {reach}; give rad/m above 0, about 2π over the wavelength"))
            }
            Self::Wavelengths { count, longest_m, shortest_m } => {
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
            Self::Features { width, gain } | Self::PseudoPosition { width, gain, .. } => {
                if let Self::PseudoPosition { octaves, .. } = *self {
                    check_frequencies(field, octaves)?;
                }
                if !(1..=WIDEST).contains(&width) || !gain.is_finite() || gain == 0.0 {
                    return Err(format!("{field}: give a width from 1 to {WIDEST} and a gain that is not 0"));
                }
                Ok(())
            }
            Self::Waves { .. } => Ok(()),
        }
    }

    /// The wave vectors `[count, 3]`, rad/m, as the model file holds them: nobody else can draw them from the seed.
    pub(super) fn constants(&self, field: &str) -> Option<(WeightSpec, Vec<Real>)> {
        let Encoder::Waves(vectors, _) = self.encoder() else { return None };
        let spec = WeightSpec::zeros(field, vec![vectors.len(), 3]);
        Some((spec, vectors.into_flattened().into_iter().map(|k| k as Real).collect()))
    }

    pub(super) fn encoder(&self) -> Encoder {
        match *self {
            Self::Octaves(frequencies) => Encoder::Octaves(frequencies),
            Self::Waves { count, reach, seed } => {
                let mut random = rng::stream(seed, "waves", 0);
                let vector = |i: usize| {
                    let direction = [(); 3].map(|()| f64::from(rng::normal(&mut random)));
                    let norm = direction.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9);
                    direction.map(|v| v / norm * length(i, count) * reach)
                };
                Encoder::Waves((0..count).map(vector).collect(), 1.0)
            }
            Self::Wavelengths { count, longest_m, shortest_m } => {
                let ratio = |i: usize| i as f64 / count.saturating_sub(1).max(1) as f64;
                let number = |i: usize| std::f64::consts::TAU / (longest_m * (shortest_m / longest_m).powf(ratio(i)));
                let along =
                    |i: usize| (0..3).map(move |axis| std::array::from_fn(|k| if k == axis { number(i) } else { 0.0 }));
                Encoder::Waves((0..count).flat_map(along).collect(), std::f64::consts::TAU / longest_m)
            }
            Self::Features { width, gain } => Encoder::Features(width, gain),
            Self::PseudoPosition { octaves, .. } => Encoder::Octaves(octaves),
        }
    }
}

/// Length of wave vector `i` of `count`, over the reach.
fn length(i: usize, count: usize) -> f64 {
    (i as f64 + 0.5) / count as f64
}

/// A [`Encoding`] ready for use.
#[derive(Debug)]
pub(super) enum Encoder {
    Octaves(usize),
    /// Wave vectors, and the factor on the coordinates.
    Waves(Vec<[f64; 3]>, f64),
    /// Width and gain.
    Features(usize, f64),
}

impl Encoder {
    /// γ of B transmitters into `out` `[·, B]`.
    pub(super) fn encode_all(&self, txs: Conditions<'_>, out: &mut [Real]) {
        let Self::Features(width, gain) = *self else { return self.encode(txs.positions(), out) };
        let rows = txs.len();
        for (r, row) in txs.values().chunks_exact(width).enumerate() {
            row.iter().enumerate().for_each(|(k, v)| out[k * rows + r] = v * gain as Real);
        }
    }

    /// γ of B points into `out` `[·, B]`.
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

    /// Adds to `d_points` the derivative through the waves, given their values `[·, N]` (γ without its first three rows)
    /// and their cotangents.
    pub(super) fn waves_vjp(&self, waves: &[Real], d_waves: &[Real], d_points: &mut [[Real; 3]]) {
        let rows = d_points.len();
        match self {
            Self::Octaves(frequencies) => {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waves_have_their_lengths_and_another_seed_other_directions() {
        let vectors = |seed| match (Encoding::Waves { count: 40, reach: 20.0, seed }).encoder() {
            Encoder::Waves(vectors, _) => vectors,
            _ => unreachable!("they are waves"),
        };
        let lengths: Vec<f64> = vectors(0).iter().map(|k| k.iter().map(|v| v * v).sum::<f64>().sqrt()).collect();
        assert!(lengths.iter().enumerate().all(|(i, l)| (l - 0.5 * (i as f64 + 0.5)).abs() < 1e-6));
        assert_eq!(vectors(0), vectors(0));
        assert_ne!(vectors(0), vectors(1));
    }
}
