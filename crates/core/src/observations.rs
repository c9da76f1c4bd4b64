//! `Observations`: what was observed of every link, and what a number of it is.

use crate::{Documented, Error, Image, Number, Real, Result, Sampling, Spectra};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// The three tasks of the field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Documented)]
pub enum Kind {
    /// A spatial spectrum: a picture of the receiver's sky.
    #[default]
    Spectrum,
    /// A received power, one number in dBm.
    Power,
    /// A channel: a complex number for every antenna and subcarrier.
    Channel,
}

impl Kind {
    /// All three.
    pub const ALL: [Self; 3] = [Self::Spectrum, Self::Power, Self::Channel];

    /// As they are counted: 120 spectra, 120 links.
    pub fn counted(self) -> &'static str {
        match self {
            Self::Spectrum => "spectra",
            Self::Power => "links",
            Self::Channel => "channels",
        }
    }

    /// As it is called in a sentence, in the plural.
    pub fn plural(self) -> &'static str {
        match self {
            Self::Spectrum => "spatial spectra",
            Self::Power => "received powers",
            Self::Channel => "channels",
        }
    }
}

/// Metres a second, in vacuum.
pub const SPEED_OF_LIGHT: f64 = 299_792_458.0;

/// Where the real and the imaginary part of a gain stand in an observation of `subcarriers` columns. Here alone a place in an
/// array of a channel gets its meaning, as that in a picture does in [`ImagePlane::direction`](crate::ImagePlane::direction).
pub fn gain_at(antenna: usize, subcarrier: usize, subcarriers: usize) -> [usize; 2] {
    let real = 2 * antenna * subcarriers + subcarrier;
    [real, real + subcarriers]
}

/// Gains `[.., A, F]` as observations `[.., 2A, F]`.
pub fn rows_of(gains: &[[Real; 2]], subcarriers: usize) -> Vec<Real> {
    let mut rows = vec![0.0; 2 * gains.len()];
    for (i, gain) in gains.iter().enumerate() {
        let [re, im] = gain_at(i / subcarriers, i % subcarriers, subcarriers);
        [rows[re], rows[im]] = *gain;
    }
    rows
}

/// The gains `[.., A, F]` of observations `[.., 2A, F]`.
pub fn gains_of(rows: &[Real], subcarriers: usize) -> Vec<[Real; 2]> {
    let gain = |i: usize| gain_at(i / subcarriers, i % subcarriers, subcarriers).map(|at| rows[at]);
    (0..rows.len() / 2).map(gain).collect()
}

/// Largest part of a gain: sums of its squares stay finite in single precision.
const MAX_GAIN: f64 = 1e9;

/// What is wrong with a gain, real and imaginary part, and what to do.
pub fn gain_fault([re, im]: [f64; 2]) -> Option<String> {
    let advice = if !(re.is_finite() && im.is_finite()) {
        "give finite numbers".to_owned()
    } else if re.abs().max(im.abs()) > MAX_GAIN {
        format!("give at most {MAX_GAIN:e}, such as all channels divided by their largest modulus")
    } else {
        return None;
    };
    Some(format!("is {:?}; {advice}", (re, im)))
}

/// Channels `[L, A, F]`, complex, in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Channels {
    /// A, antennas of a receiver.
    pub antennas: usize,
    /// Frequencies of the subcarriers `[F]`, Hz.
    pub frequencies_hz: Vec<f64>,
    /// Real and imaginary part of every gain.
    pub gains: Vec<[Real; 2]>,
}

impl Channels {
    /// Numbers of one: rows (real parts of an antenna, then its imaginary parts) by columns (subcarriers).
    fn size(&self) -> (usize, usize) {
        (self.frequencies_hz.len(), 2 * self.antennas)
    }

    /// The gains of link `i`, `[A, F]`.
    pub fn of(&self, i: usize) -> &[[Real; 2]] {
        let of_one = self.antennas * self.frequencies_hz.len();
        &self.gains[i * of_one..][..of_one]
    }

    /// Those of link `i` as an observation.
    fn rows(&self, i: usize) -> Vec<Real> {
        rows_of(self.of(i), self.frequencies_hz.len())
    }
}

/// What was observed of the links, in their order, as flat arrays.
///
/// Whatever it is, an observation of one link can be had as an array of numbers [`Image`]: a picture is one, a power has
/// one row and one column, a channel has two rows an antenna (real parts, imaginary parts) and a column a subcarrier.
#[derive(Clone, Debug)]
pub enum Observations {
    /// Spatial spectra `[L, H, W]`.
    Pictures(Spectra),
    /// Received powers `[L]`, dBm.
    Powers(Vec<Real>),
    /// Channels `[L, A, F]`.
    Channels(Channels),
}

impl From<Spectra> for Observations {
    fn from(spectra: Spectra) -> Self {
        Self::Pictures(spectra)
    }
}

impl Observations {
    /// Which of the three.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Pictures(_) => Kind::Spectrum,
            Self::Powers(_) => Kind::Power,
            Self::Channels(_) => Kind::Channel,
        }
    }

    /// L, links.
    pub fn len(&self) -> usize {
        match self {
            Self::Pictures(spectra) => spectra.len(),
            Self::Powers(powers) => powers.len(),
            Self::Channels(channels) => channels.gains.len() / (channels.antennas * channels.frequencies_hz.len()),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Columns and rows of one observation.
    pub fn size(&self) -> (usize, usize) {
        match self {
            Self::Pictures(spectra) => (spectra.width(), spectra.height()),
            Self::Powers(_) => (1, 1),
            Self::Channels(channels) => channels.size(),
        }
    }

    /// Observation `i` as an array of numbers.
    pub fn image(&self, i: usize) -> Image {
        let (width, height) = self.size();
        match self {
            Self::Pictures(spectra) => spectra.image(i),
            Self::Powers(powers) => Image { width, height, pixels: vec![powers[i]] },
            Self::Channels(channels) => Image { width, height, pixels: channels.rows(i) },
        }
    }

    /// The pixels of picture `i` that `sampling` names, row-major; the whole of anything else.
    pub fn sampled(&self, i: usize, sampling: Sampling, out: &mut [Real]) {
        match self {
            Self::Pictures(spectra) => spectra.sampled(i, sampling, out),
            Self::Powers(powers) => out[0] = powers[i],
            Self::Channels(channels) => out.iter_mut().zip(channels.rows(i)).for_each(|(out, v)| *out = v),
        }
    }

    /// Adds `weight` times observation `i`, in units of which [`Self::full_scale`] are 1, to `sum`.
    pub fn add(&self, i: usize, weight: f64, sum: &mut [f64]) {
        match self {
            Self::Pictures(spectra) => spectra.add(i, weight, sum),
            Self::Powers(powers) => sum[0] += weight * powers[i] as f64,
            Self::Channels(channels) => {
                sum.iter_mut().zip(channels.rows(i)).for_each(|(sum, v)| *sum += weight * v as f64);
            }
        }
    }

    /// What stands for 1 in [`Self::add`].
    pub fn full_scale(&self) -> f64 {
        match self {
            Self::Pictures(spectra) => spectra.number().full_scale(),
            _ => 1.0,
        }
    }

    /// Observation `i` as bytes: two that are equal have the same.
    pub fn raw(&self, i: usize) -> Cow<'_, [u8]> {
        match self {
            Self::Pictures(spectra) => spectra.raw(i),
            other => Cow::Owned(other.image(i).pixels.iter().flat_map(|v| v.to_le_bytes()).collect()),
        }
    }

    /// How the numbers of a picture are stored; what is no picture is held as floats.
    pub fn number(&self) -> Number {
        match self {
            Self::Pictures(spectra) => spectra.number(),
            _ if size_of::<Real>() == 8 => Number::F64,
            _ => Number::F32,
        }
    }

    /// Bytes held in memory.
    pub fn bytes_in_memory(&self) -> usize {
        match self {
            Self::Pictures(spectra) => spectra.bytes_in_memory(),
            Self::Powers(powers) => size_of_val(powers.as_slice()),
            Self::Channels(channels) => size_of_val(channels.gains.as_slice()),
        }
    }

    /// Whether all that was read so far could be read.
    ///
    /// # Errors
    /// [`Error::Read`] of the file of pictures.
    pub fn check(&self) -> Result<()> {
        match self {
            Self::Pictures(spectra) => spectra.check(),
            _ => Ok(()),
        }
    }

    /// The pictures, for who can do with nothing else.
    ///
    /// # Errors
    /// [`Error::Config`] naming `who` where these are something else.
    pub fn pictures(&self, who: &str) -> Result<&Spectra> {
        match self {
            Self::Pictures(spectra) => Ok(spectra),
            other => {
                Err(Error::Config(format!("{who} needs spatial spectra, and these data are {}", other.kind().plural())))
            }
        }
    }

    /// What cannot be: nothing observed, half an observation, a number that is none.
    pub(crate) fn fault(&self) -> Option<String> {
        let not_finite = |values: &[Real]| values.iter().position(|v| !v.is_finite());
        match self {
            Self::Pictures(_) => None,
            Self::Powers(powers) if powers.is_empty() => Some("there is no power; give at least one".into()),
            Self::Powers(powers) => not_finite(powers).map(|i| format!("powers[{i}] is {}; give dBm", powers[i])),
            Self::Channels(channels) => {
                let of_one = channels.antennas * channels.frequencies_hz.len();
                if of_one == 0 || channels.gains.is_empty() || !channels.gains.len().is_multiple_of(of_one) {
                    let have = channels.gains.len();
                    let what =
                        format!("{} antennas by {} subcarriers", channels.antennas, channels.frequencies_hz.len());
                    return Some(format!("{have} gains are no channels of {what}; give at least one, and whole ones"));
                }
                if let Some(f) = channels.frequencies_hz.iter().find(|f| !(f.is_finite() && **f > 0.0)) {
                    return Some(format!("a subcarrier at {f} Hz; give frequencies above 0"));
                }
                let mut faults = channels.gains.iter().map(|gain| gain_fault(gain.map(|v| v as f64))).enumerate();
                let (i, fault) = faults.find_map(|(i, fault)| Some((i, fault?)))?;
                let [l, a, f] =
                    [i / of_one, i % of_one / channels.frequencies_hz.len(), i % channels.frequencies_hz.len()];
                Some(format!("channels[{l}, {a}, {f}] {fault}"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> Observations {
        let gains = (0..12).map(|i| [i as Real, -(i as Real)]).collect();
        Observations::Channels(Channels { antennas: 2, frequencies_hz: vec![1e9, 2e9, 3e9], gains })
    }

    #[test]
    fn a_channel_is_rows_of_real_and_imaginary_parts() {
        let all = two();
        assert_eq!((all.len(), all.size(), all.kind()), (2, (3, 4), Kind::Channel));
        let second = all.image(1);
        assert_eq!(second.pixels, [6.0, 7.0, 8.0, -6.0, -7.0, -8.0, 9.0, 10.0, 11.0, -9.0, -10.0, -11.0]);
        assert_eq!(gain_at(1, 2, 3).map(|at| second.pixels[at]), [11.0, -11.0]);
        let Observations::Channels(channels) = &all else { unreachable!() };
        assert_eq!(gains_of(&second.pixels, 3), channels.of(1));
        let mut sum = vec![0.0; 12];
        all.add(1, 2.0, &mut sum);
        assert_eq!(sum[3], -12.0);
    }

    #[test]
    fn what_cannot_be_is_told_with_its_place() {
        assert!(Observations::Powers(vec![-3.0, Real::NAN]).fault().unwrap().starts_with("powers[1] is NaN"));
        let Observations::Channels(mut channels) = two() else { unreachable!() };
        channels.gains[10] = [0.0, Real::INFINITY];
        assert!(Observations::Channels(channels.clone()).fault().unwrap().starts_with("channels[1, 1, 1] is"));
        channels.gains.pop();
        assert!(Observations::Channels(channels).fault().unwrap().contains("11 gains are no channels of 2 antennas"));
        assert!(two().fault().is_none() && two().pictures("`inspect`").is_err());
    }
}
