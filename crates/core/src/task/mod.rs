//! `Task`: measurement type of a link. `Observations`: the observations of all links, as flat arrays.
//!
//! Each measurement type has one file: `spectrum.rs`, `power.rs`, `channel.rs`. Code for all types reads the
//! [`Description`]; it does not match on [`Task`].

mod channel;
mod power;
mod spectrum;

use crate::{Elevation, Image, ImagePlane, JsonSchema, Number, Real, Receiver, Result, Sampling, Spectra, ssim};
pub use channel::{Channels, gain_fault, gain_indices, gains_of, rows_of};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt::Debug;
use std::ops::Deref;

/// Speed of light in vacuum, m/s.
pub const SPEED_OF_LIGHT: f64 = 299_792_458.0;

/// Measurement type. It dereferences to its [`Description`]: `task.plural`, `task.headline.key`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Task {
    /// Spatial spectrum: an image of the receiver's sky.
    #[default]
    Spectrum,
    /// Received power, one number in dBm.
    Power,
    /// Channel: a complex number per antenna and subcarrier.
    Channel,
}

impl Task {
    /// All measurement types.
    pub const ALL: [Self; 3] = [Self::Spectrum, Self::Power, Self::Channel];

    /// Returns the type with this [`Description::name`]; `None` if there is none.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|task| task.name == name)
    }
}

impl Deref for Task {
    type Target = Description;

    fn deref(&self) -> &Description {
        match self {
            Self::Spectrum => &spectrum::SPECTRUM,
            Self::Power => &power::POWER,
            Self::Channel => &channel::CHANNEL,
        }
    }
}

impl Task {
    /// Returns name and unit of the level of observations at `receivers`; powers are relative if a receiver is not calibrated.
    pub fn level_name_at(self, receivers: &[Receiver]) -> [&'static str; 2] {
        let is_relative = self.is_scalar && receivers.iter().any(|receiver| receiver.is_relative);
        if is_relative { ["relative received power", "dB"] } else { self.level_name }
    }
}

/// Description of a measurement type.
#[derive(Debug)]
#[allow(clippy::struct_excessive_bools)] // independent properties
pub struct Description {
    /// Name in files and in Python: `power`.
    pub name: &'static str,
    /// Singular in a sentence: `received power`.
    pub singular: &'static str,
    /// Plural: `received powers`.
    pub plural: &'static str,
    /// Counted unit in tables, singular and plural: `link`, `links`.
    pub counted: [&'static str; 2],
    /// First metric, on curves, in examples and during training.
    pub headline: Headline,
    /// Keys of the metrics in the short table of scores, the first metric first.
    pub main_metrics: [&'static str; 4],
    /// Estimate of the noise ceiling from two readings at one position.
    pub ceiling: Ceiling,
    /// Pipeline field that selects a suitable method, as advice.
    pub method: &'static str,
    /// Name and unit of [`Self::level`].
    pub level_name: [&'static str; 2],
    /// Name of the mean of the training observations as a predictor.
    pub mean_name: &'static str,
    /// Name of the shipped experiment that compares methods.
    pub comparison: &'static str,
    /// Columns and units of prediction intervals; `None` if these are not supported.
    pub intervals: Option<Intervals>,
    /// Whether observations fall with the logarithm of the distance.
    pub has_path_loss: bool,
    /// Whether the values of an observation are pixels of an image of the sky, from 0 to 1.
    pub has_pixels: bool,
    /// Whether an observation is one number.
    pub is_scalar: bool,
    /// Whether an observation is complex: see [`gain_indices`].
    pub is_complex: bool,
    level: fn(&Image) -> f64,
    likeness: fn(&Image, &Image) -> f64,
    score: fn(&Image, &Image) -> f64,
    shape: fn((usize, usize)) -> Vec<usize>,
    size: fn(&[usize]) -> (usize, usize),
    size_text: fn((usize, usize)) -> Option<String>,
}

/// First metric of a measurement type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Headline {
    /// Key in tables of scores.
    pub key: &'static str,
    /// Name in titles and sentences.
    pub short: &'static str,
    /// Name on an axis, with its unit.
    pub name: &'static str,
    /// Whether larger is better.
    pub higher: bool,
    /// Value of a perfect prediction; `None` if it is unlimited.
    pub best: Option<f64>,
    /// Columns of `validation.csv` after the step: mean, median, and one further value.
    pub columns: [&'static str; 3],
}

impl Headline {
    /// Returns the cost of a score, by which predictors and samples are ranked: smaller is better, infinite for NaN.
    pub fn cost(&self, score: f64) -> f64 {
        match score {
            _ if score.is_nan() => f64::INFINITY,
            _ if self.higher => -score,
            _ => score,
        }
    }
}

/// Words of prediction intervals.
#[derive(Debug)]
pub struct Intervals {
    /// Columns of the table of test samples at level 0.9.
    pub columns: &'static [&'static str],
    /// Plural of the values of which a share is inside.
    pub values: &'static str,
    /// Unit of the width, with a blank before it.
    pub unit: &'static str,
}

/// Estimate of the noise ceiling from two readings at one position.
#[derive(Debug)]
pub struct Ceiling {
    /// Meaning of the row in a table of scores.
    pub note: &'static str,
    /// Score of a perfect predictor of the mean reading, relative to the score between two readings.
    pub share: f64,
}

impl Description {
    /// Returns the strength of an observation, in the unit of [`Self::level_name`].
    pub fn level(&self, image: &Image) -> f64 {
        (self.level)(image)
    }

    /// Returns the first metric, [`Self::headline`], of one prediction.
    pub fn score(&self, prediction: &Image, truth: &Image) -> f64 {
        (self.score)(prediction, truth)
    }

    /// Returns the SSIM of a prediction from [`Self::shown`]; `None` without pixels.
    pub fn ssim(&self, prediction: &Image, truth: &Image) -> Option<f64> {
        self.has_pixels.then(|| ssim::evaluation(prediction, truth))
    }

    /// Returns the similarity of prediction and observation by which a baseline chooses its settings; higher is better.
    pub fn likeness(&self, prediction: &Image, truth: &Image) -> f64 {
        (self.likeness)(prediction, truth)
    }

    /// Returns the shape of one observation of `size` (columns, rows) as an array: `[H, W]`, `[]` or `[A, F]`.
    pub fn shape(&self, size: (usize, usize)) -> Vec<usize> {
        (self.shape)(size)
    }

    /// Returns columns and rows of one observation of a [`Self::shape`].
    ///
    /// # Panics
    /// If `shape` has fewer axes than observations of this type.
    pub fn size(&self, shape: &[usize]) -> (usize, usize) {
        (self.size)(shape)
    }

    /// Returns the size of one observation in words, `360 x 90 pixels`; `None` for a single number.
    pub fn size_text(&self, size: (usize, usize)) -> Option<String> {
        (self.size_text)(size)
    }

    /// Returns a prediction as it is displayed and scored: pixels are clamped to [0, 1].
    pub fn shown(&self, prediction: Image) -> Image {
        if self.has_pixels { prediction.clamped() } else { prediction }
    }

    /// Converts the derivative `d` by the result of [`Self::shown`] to that by its argument `values`: 0 for clamped pixels.
    pub fn shown_vjp(&self, values: &[Real], d: &mut [Real]) {
        if self.has_pixels {
            d.iter_mut().zip(values).filter(|(_, v)| !(0.0..=1.0).contains(*v)).for_each(|(d, _)| *d = 0.0);
        }
    }

    /// Returns the stride of rows and columns at which an observation is sampled: `stride` for pixels, otherwise 1.
    pub fn stride(&self, stride: usize) -> usize {
        if self.has_pixels { stride } else { 1 }
    }

    /// Returns the grid of an observation of `size` (columns, rows): columns of pixels cover the full circle, rows are
    /// `elevation`. Other observations have a grid without angles.
    pub fn plane(&self, (width, height): (usize, usize), elevation: Elevation) -> ImagePlane {
        if self.has_pixels { ImagePlane::around(width, height, elevation) } else { ImagePlane::plain(width, height) }
    }
}

/// Observations of all links, in the order of the links, as flat arrays. It dereferences to its [`Columns`].
#[derive(Clone, Debug)]
pub enum Observations {
    /// Spatial spectra `[L, H, W]`.
    Spectra(Spectra),
    /// Received powers `[L]`, dBm.
    Powers(Vec<Real>),
    /// Channels `[L, A, F]`.
    Channels(Channels),
}

impl From<Spectra> for Observations {
    fn from(spectra: Spectra) -> Self {
        Self::Spectra(spectra)
    }
}

impl From<Channels> for Observations {
    fn from(channels: Channels) -> Self {
        Self::Channels(channels)
    }
}

/// Received powers `[L]`, dBm.
impl From<Vec<Real>> for Observations {
    fn from(powers: Vec<Real>) -> Self {
        Self::Powers(powers)
    }
}

impl Deref for Observations {
    type Target = dyn Columns;

    fn deref(&self) -> &(dyn Columns + 'static) {
        match self {
            Self::Spectra(spectra) => spectra,
            Self::Powers(powers) => powers,
            Self::Channels(channels) => channels,
        }
    }
}

/// Operations on observations of any measurement type.
///
/// The observation of one link is available as an array of numbers, an [`Image`]. A spectrum is an image; a power has
/// one row and one column; a channel has two rows per antenna (real parts, imaginary parts) and one column per
/// subcarrier.
#[allow(clippy::len_without_is_empty)] // a data set has at least one link
pub trait Columns: Debug + Send + Sync {
    /// Returns the number of links L.
    fn len(&self) -> usize;

    /// Returns columns and rows of one observation.
    fn size(&self) -> (usize, usize);

    /// Returns observation `i` as an array of numbers.
    fn image(&self, i: usize) -> Image;

    /// Writes the pixels of image `i` that `sampling` selects to `out`, row-major. The default, for observations without
    /// pixels, ignores `sampling` and writes all values.
    fn sampled(&self, i: usize, sampling: Sampling, out: &mut [Real]) {
        let _ = sampling;
        out.iter_mut().zip(self.image(i).pixels).for_each(|(out, v)| *out = v);
    }

    /// Adds `weight` times the stored values of observation `i`, of which [`Self::full_scale`] represents 1, to `sum`.
    fn add(&self, i: usize, weight: f64, sum: &mut [f64]) {
        sum.iter_mut().zip(self.image(i).pixels).for_each(|(sum, v)| *sum += weight * v as f64);
    }

    /// Returns the storage format of numbers.
    fn number(&self) -> Number {
        if size_of::<Real>() == 8 { Number::F64 } else { Number::F32 }
    }

    /// Returns the value that represents 1 in [`Self::add`].
    fn full_scale(&self) -> f64 {
        self.number().full_scale()
    }

    /// Returns observation `i` as bytes: equal observations have equal bytes.
    fn raw(&self, i: usize) -> Cow<'_, [u8]> {
        Cow::Owned(self.image(i).pixels.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    /// Returns the number of bytes in memory.
    fn bytes_in_memory(&self) -> usize;

    /// Checks that all reads so far succeeded.
    ///
    /// # Errors
    /// [`Error::Read`](crate::Error::Read) if the file of spectra cannot be read.
    fn check(&self) -> Result<()> {
        Ok(())
    }

    /// Returns the number of antennas per receiver; `None` if observations do not depend on it.
    fn antennas(&self) -> Option<usize> {
        None
    }

    /// Returns the subcarrier frequencies, Hz; empty without subcarriers.
    fn frequencies_hz(&self) -> &[f64] {
        &[]
    }

    /// Returns the error in the values, with the next step; `None` if they are valid.
    fn fault(&self) -> Option<String> {
        None
    }
}

impl Observations {
    /// Returns the measurement type.
    pub fn task(&self) -> Task {
        match self {
            Self::Spectra(_) => Task::Spectrum,
            Self::Powers(_) => Task::Power,
            Self::Channels(_) => Task::Channel,
        }
    }

    /// Returns the observations of `links`, in memory.
    ///
    /// # Errors
    /// [`Error::Read`](crate::Error::Read) if a spectrum cannot be read.
    pub(crate) fn subset(&self, links: &[usize]) -> Result<Self> {
        Ok(match self {
            Self::Spectra(spectra) => {
                let bytes = links.iter().flat_map(|&i| spectra.raw(i).into_owned()).collect();
                spectra.check()?;
                Spectra::in_memory(self.size(), spectra.number(), bytes)?.into()
            }
            Self::Powers(powers) => Self::Powers(links.iter().map(|&i| powers[i]).collect()),
            Self::Channels(channels) => {
                let gains = links.iter().flat_map(|&i| channels.of(i)).copied().collect();
                Channels { gains, frequencies_hz: channels.frequencies_hz.clone(), ..*channels }.into()
            }
        })
    }

    /// Returns the observations of `links`, each of which occurs once, as [`Self::subset`] does. Channels are moved in place.
    ///
    /// # Errors
    /// As [`Self::subset`].
    pub(crate) fn into_subset(self, links: &[usize]) -> Result<Self> {
        match self {
            whole if links.len() == whole.len() && links.is_sorted() => Ok(whole),
            Self::Channels(mut channels) => {
                channel::select_rows(&mut channels.gains, channels.antennas * channels.frequencies_hz.len(), links);
                Ok(channels.into())
            }
            other => other.subset(links),
        }
    }

    /// Returns the spectra; `None` for other types.
    pub fn spectra(&self) -> Option<&Spectra> {
        if let Self::Spectra(spectra) = self { Some(spectra) } else { None }
    }

    /// Returns the received powers, dBm; `None` for other types.
    pub fn powers(&self) -> Option<&[Real]> {
        if let Self::Powers(powers) = self { Some(powers) } else { None }
    }

    /// Returns the channels; `None` for other types.
    pub fn channels(&self) -> Option<&Channels> {
        if let Self::Channels(channels) = self { Some(channels) } else { None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two() -> Observations {
        let gains = (0..12).map(|i| [i as Real, -(i as Real)]).collect();
        Channels { antennas: 2, frequencies_hz: vec![1e9, 2e9, 3e9], gains }.into()
    }

    #[test]
    fn channel_has_rows_of_real_and_imaginary_parts() {
        let all = two();
        assert_eq!((all.len(), all.size(), all.task()), (2, (3, 4), Task::Channel));
        let second = all.image(1);
        assert_eq!(second.pixels, [6.0, 7.0, 8.0, -6.0, -7.0, -8.0, 9.0, 10.0, 11.0, -9.0, -10.0, -11.0]);
        assert_eq!(gain_indices(1, 2, 3).map(|at| second.pixels[at]), [11.0, -11.0]);
        assert_eq!(gains_of(&second.pixels, 3), all.channels().unwrap().of(1));
        let mut sum = vec![0.0; 12];
        all.add(1, 2.0, &mut sum);
        assert_eq!(sum[3], -12.0);
    }

    #[test]
    fn reports_position_of_invalid_values() {
        assert!(Observations::Powers(vec![-3.0, Real::NAN]).fault().unwrap().starts_with("powers[1] is NaN"));
        let Observations::Channels(mut channels) = two() else { unreachable!() };
        channels.gains[10] = [0.0, Real::INFINITY];
        assert!(channels.fault().unwrap().starts_with("channels[1, 1, 1] is"));
        channels.gains.pop();
        assert!(channels.fault().unwrap().contains("11 gains are not a multiple of 2 antennas"));
        assert!(two().fault().is_none() && two().spectra().is_none());
    }

    #[test]
    fn task_names_and_shapes_match_observations() {
        for task in Task::ALL {
            assert_eq!(Task::named(task.name), Some(task));
            let size = if task.is_scalar { (1, 1) } else { (5, 4) };
            let numbers: usize = task.shape(size).iter().product();
            assert_eq!(numbers * (1 + usize::from(task.is_complex)), size.0 * size.1);
            assert_eq!(task.size_text(size).is_none(), task.is_scalar);
        }
        assert_eq!(Task::named("picture"), None);
    }

    #[test]
    fn nan_ranks_last_by_cost() {
        for (task, expected) in [(Task::Spectrum, [0.9, 0.2]), (Task::Power, [0.2, 0.9])] {
            let mut scores = [f64::NAN, 0.2, -f64::NAN, 0.9];
            scores.sort_by(|a, b| task.headline.cost(*a).total_cmp(&task.headline.cost(*b)));
            assert_eq!(scores[..2], expected, "{}", task.name);
            assert!(scores[2..].iter().all(|score| score.is_nan()));
        }
    }

    #[test]
    fn task_levels_and_scores_have_their_units() {
        let image = |pixels: &[Real]| Image { width: 1, height: pixels.len(), pixels: pixels.to_vec() };
        assert_eq!(Task::Spectrum.level(&image(&[0.1, 0.75])), 0.75);
        assert_eq!(Task::Power.level(&image(&[-61.0])), -61.0);
        assert!((Task::Channel.level(&image(&[0.0, 0.1])) + 20.0).abs() < 1e-5, "|h|² is 0.01");
        assert_eq!(Task::Power.score(&image(&[-70.5]), &image(&[-60.0])), 10.5);
        assert!((Task::Channel.score(&image(&[0.9, 0.0]), &image(&[1.0, 0.0])) - 20.0).abs() < 1e-4);
        assert_eq!(Task::Spectrum.shown(image(&[1.5])).pixels, [1.0]);
        assert_eq!(Task::Power.shown(image(&[1.5])).pixels, [1.5]);
    }
}
