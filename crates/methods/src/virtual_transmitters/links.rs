//! `ChannelInputs`: receiving positions, antennas and subcarriers. `VirtualSources`: the virtual transmitters. `snr_db`:
//! score of a channel.

use crate::virtual_transmitters::harmonics::{self, HARMONICS};
use pwrfgs_core::{ExtraColumn, GaussianCloud, Real, SPEED_OF_LIGHT};

/// Positions, antennas and frequencies of a channel h `[M,A,F]`.
#[derive(Clone, Copy, Debug)]
pub struct ChannelInputs<'a> {
    /// Positions of the moving node `[M,3]`, metres.
    pub positions: &'a [[Real; 3]],
    /// Antenna positions of the fixed node in its frame `[A,3]`, metres; one at zero without an array.
    pub antennas: &'a [[Real; 3]],
    /// Subcarrier frequencies `[F]`, Hz.
    pub frequencies: &'a [f64],
}

impl ChannelInputs<'_> {
    /// Returns the number of complex values of h: M · A · F.
    pub fn value_count(&self) -> usize {
        self.positions.len() * self.antennas.len() * self.frequencies.len()
    }

    /// Returns the wavelength at the highest subcarrier, metres.
    pub fn shortest_wavelength(&self) -> f64 {
        SPEED_OF_LIGHT / self.frequencies.iter().copied().fold(f64::MIN_POSITIVE, f64::max)
    }

    /// Returns whether an antenna is off the origin, so that a rotation of the fixed node matters.
    pub fn has_orientation(&self) -> bool {
        self.antennas.iter().any(|a| *a != [0.0; 3])
    }

    /// Checks that all inputs are finite and in range, and that `channel` has matching length, is finite and not all
    /// zero; the error is a message for users.
    pub(crate) fn check_channel(&self, channel: &[&[[Real; 2]]]) -> Result<(), String> {
        if self.value_count() == 0 {
            let [m, a, f] = [self.positions.len(), self.antennas.len(), self.frequencies.len()];
            return Err(format!("{m} positions, {a} antennas and {f} subcarriers; each must be 1 or more"));
        }
        if let Some(i) = (self.positions.iter()).position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(format!("position {i} is {:?}; give finite metres", self.positions[i]));
        }
        if let Some(i) = self.antennas.iter().position(|a| !a.iter().all(|x| x.is_finite())) {
            return Err(format!("antenna {i} is at {:?}; give finite metres", self.antennas[i]));
        }
        if let Some(f) = self.frequencies.iter().find(|f| !(1e3..=1e13).contains(*f)) {
            return Err(format!("a subcarrier at {f} Hz; give 1e3 to 1e13 Hz, such as 2.4e9"));
        }
        let each = self.antennas.len() * self.frequencies.len();
        if channel.len() != self.positions.len() || channel.iter().any(|h| h.len() != each) {
            let (given, expected) = (channel.iter().map(|h| h.len()).sum::<usize>(), self.value_count());
            return Err(format!(
                "{given} complex numbers, expected {expected}; give one per position, antenna and subcarrier"
            ));
        }
        let values = || channel.iter().copied().flatten();
        if let Some((i, value)) = values().enumerate().find(|(_, value)| !value.iter().all(|part| part.is_finite())) {
            return Err(format!("channel {i} is {value:?}; give finite numbers"));
        }
        if values().all(|h| *h == [0.0; 2]) {
            return Err("the channel is zero everywhere; check the data".into());
        }
        Ok(())
    }
}

/// N virtual transmitters in double precision, one column per quantity.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VirtualSources {
    /// Positions v `[N,3]`, metres.
    pub positions: Vec<[f64; 3]>,
    /// Unit quaternions of the array rotations `[N,4]` as w, x, y, z.
    pub quats: Vec<[f64; 4]>,
    /// Complex signals s `[N,K,2]`, one per harmonic. h = s·exp(-jkd)/d, so s has the unit of h times metres.
    pub gains: Vec<[f64; 2]>,
    /// Order of the harmonics: K = (order + 1)².
    pub order: usize,
}

impl VirtualSources {
    /// Creates an empty set with harmonics up to `order`.
    pub fn new(order: usize) -> Self {
        Self { order, ..Self::default() }
    }

    /// Returns the number of harmonics K.
    pub fn harmonic_count(&self) -> usize {
        harmonics::harmonic_count(self.order)
    }

    /// Returns the gains of source `g`, one per harmonic `[K]`.
    pub fn source_gains(&self, g: usize) -> &[[f64; 2]] {
        &self.gains[g * self.harmonic_count()..(g + 1) * self.harmonic_count()]
    }

    /// Returns the number of sources N.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Returns whether N = 0.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Adds a source with equal gain in all directions.
    pub fn push(&mut self, position: [f64; 3], quat: [f64; 4], gain: [f64; 2]) {
        self.positions.push(position);
        self.quats.push(quat);
        self.gains.push(gain);
        self.gains.resize(self.len() * self.harmonic_count(), [0.0; 2]);
    }

    /// Adds the sources of `other`, whose order must be equal.
    pub fn extend(&mut self, other: Self) {
        self.positions.extend(other.positions);
        self.quats.extend(other.quats);
        self.gains.extend(other.gains);
    }

    /// Returns the listed sources, in that order.
    pub fn select(&self, rows: &[usize]) -> Self {
        let mut out = Self::new(self.order);
        for &i in rows {
            out.positions.push(self.positions[i]);
            out.quats.push(self.quats[i]);
            out.gains.extend(self.source_gains(i));
        }
        out
    }

    /// Returns all sources except that of index `row`.
    pub fn without(&self, row: usize) -> Self {
        self.select(&(0..self.len()).filter(|i| *i != row).collect::<Vec<_>>())
    }

    /// Converts to a cloud: means, quaternions, signals and harmonics; scales of 1 m and opacities of ½, which the
    /// field ignores.
    pub fn to_cloud(&self) -> GaussianCloud {
        let mut cloud = GaussianCloud::zeros(self.len());
        for i in 0..self.len() {
            cloud.means[i] = self.positions[i].map(|x| x as Real);
            cloud.quats[i] = self.quats[i].map(|x| x as Real);
            cloud.signals[i] = self.source_gains(i)[0].map(|x| x as Real);
        }
        if self.order > 0 {
            let more = (0..self.len()).flat_map(|i| self.source_gains(i)[1..].as_flattened());
            let values = more.map(|x| *x as Real).collect();
            cloud.extra.push(ExtraColumn { name: HARMONICS.into(), width: 2 * (self.harmonic_count() - 1), values });
        }
        cloud
    }
}

/// Returns the signal-to-noise ratio −10 log10(Σ|h' − h|²/Σ|h|²) of predicted channels over all values, dB; infinite if they
/// are equal, NaN if both are zero.
pub fn snr_db<'a>(predicted: &[[Real; 2]], truth: impl IntoIterator<Item = &'a [Real; 2]>) -> f64 {
    let (mut error, mut energy) = (0.0, 0.0);
    for (p, t) in predicted.iter().zip(truth) {
        let [p, t] = [p, t].map(|z| z.map(f64::from));
        error += (p[0] - t[0]).powi(2) + (p[1] - t[1]).powi(2);
        energy += t[0] * t[0] + t[1] * t[1];
    }
    -10.0 * (error / energy).log10()
}
