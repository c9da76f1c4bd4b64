//! Channels `[L, A, F]`: a complex gain per antenna and subcarrier.

use super::{Ceiling, Columns, Description, Headline};
use crate::{Image, Real};

pub(super) static CHANNEL: Description = Description {
    name: "channel",
    singular: "channel",
    plural: "channels",
    counted: ["channel", "channels"],
    headline: Headline {
        key: "snr_db",
        short: "SNR",
        name: "SNR [dB]",
        higher: true,
        best: None,
        columns: ["snr_db_mean", "snr_db_median", "snr_all_db"],
    },
    main_metrics: ["snr_db", "snr_all_db", "gaussians", "latency_total_ms"],
    ceiling: Ceiling { note: "repeatability of two measured channels at one position", share: 1.0 },
    method: "method: VirtualTransmitters() or SplattedChannel()",
    level_name: ["mean power of the channel", "dB"],
    mean_name: "mean of the receiver",
    comparison: "methods-channels",
    intervals: None,
    has_path_loss: false,
    has_pixels: false,
    is_scalar: false,
    is_complex: true,
    // Two rows per antenna: half as many gains as numbers.
    level: |image| 10.0 * (2.0 * energy(image.pixels.iter().copied()) / image.pixels.len().max(1) as f64).log10(),
    score: |prediction, truth| {
        let error = energy(prediction.pixels.iter().zip(&truth.pixels).map(|(p, t)| p - t));
        10.0 * (energy(truth.pixels.iter().copied()) / error).log10()
    },
    likeness: |prediction, truth| {
        let pairs = prediction.pixels.iter().zip(&truth.pixels);
        -pairs.map(|(p, t)| (*p as f64 - *t as f64).powi(2)).sum::<f64>()
    },
    shape: |(width, height)| vec![height / 2, width],
    size: |shape| (shape[1], 2 * shape[0]),
    size_text: |(width, height)| {
        let several = |n: usize, noun: &str| format!("{n} {noun}{}", if n == 1 { "" } else { "s" });
        Some(format!("{} x {}", several(height / 2, "antenna"), several(width, "subcarrier")))
    },
};

/// Returns the sum of squares, computed in double precision.
fn energy(values: impl Iterator<Item = Real>) -> f64 {
    values.map(|v| (v as f64).powi(2)).sum()
}

/// Returns the indices of the real and the imaginary part of a gain in an observation of `subcarriers` columns. Only
/// this function defines the layout of a channel in an array, just as only
/// [`ImagePlane::direction`](crate::ImagePlane::direction) defines the direction of a pixel.
pub fn gain_indices(antenna: usize, subcarrier: usize, subcarriers: usize) -> [usize; 2] {
    let real = 2 * antenna * subcarriers + subcarrier;
    [real, real + subcarriers]
}

/// Converts gains `[.., A, F]` to observations `[.., 2A, F]`.
pub fn rows_of(gains: &[[Real; 2]], subcarriers: usize) -> Vec<Real> {
    let mut rows = vec![0.0; 2 * gains.len()];
    for (i, gain) in gains.iter().enumerate() {
        let [re, im] = gain_indices(i / subcarriers, i % subcarriers, subcarriers);
        [rows[re], rows[im]] = *gain;
    }
    rows
}

/// Converts observations `[.., 2A, F]` to gains `[.., A, F]`.
pub fn gains_of(rows: &[Real], subcarriers: usize) -> Vec<[Real; 2]> {
    let gain = |i: usize| gain_indices(i / subcarriers, i % subcarriers, subcarriers).map(|at| rows[at]);
    (0..rows.len() / 2).map(gain).collect()
}

/// Maximum real or imaginary part of a gain: sums of its squares stay finite in single precision.
const MAX_GAIN: f64 = 1e9;

/// Returns the error in a gain, given as real and imaginary part, with the next step; `None` if it is valid. The text begins
/// with `is`: the caller names the gain.
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

/// Complex channels `[L, A, F]` in memory.
#[derive(Clone, Debug, PartialEq)]
pub struct Channels {
    /// Number of antennas A per receiver.
    pub antennas: usize,
    /// Subcarrier frequencies `[F]`, Hz.
    pub frequencies_hz: Vec<f64>,
    /// Gains as real and imaginary part, `[L, A, F]`.
    pub gains: Vec<[Real; 2]>,
}

impl Channels {
    /// Returns the gains of link `i`, `[A, F]`.
    pub fn of(&self, i: usize) -> &[[Real; 2]] {
        let gains = self.antennas * self.frequencies_hz.len();
        &self.gains[i * gains..][..gains]
    }
}

impl Columns for Channels {
    fn len(&self) -> usize {
        self.gains.len() / (self.antennas * self.frequencies_hz.len())
    }

    /// Columns are subcarriers; rows are the real parts of an antenna, then its imaginary parts.
    fn size(&self) -> (usize, usize) {
        (self.frequencies_hz.len(), 2 * self.antennas)
    }

    fn image(&self, i: usize) -> Image {
        let (width, height) = self.size();
        Image { width, height, pixels: rows_of(self.of(i), width) }
    }

    fn bytes_in_memory(&self) -> usize {
        size_of_val(self.gains.as_slice())
    }

    fn antennas(&self) -> Option<usize> {
        Some(self.antennas)
    }

    fn frequencies_hz(&self) -> &[f64] {
        &self.frequencies_hz
    }

    fn fault(&self) -> Option<String> {
        let Self { antennas, frequencies_hz, gains } = self;
        let (subcarriers, have) = (frequencies_hz.len(), gains.len());
        let channel_gains = antennas * subcarriers;
        if channel_gains == 0 || gains.is_empty() || !have.is_multiple_of(channel_gains) {
            return Some(format!(
                "{have} gains are not a multiple of {antennas} antennas x {subcarriers} subcarriers; give at least one \
                 complete channel"
            ));
        }
        if let Some(f) = frequencies_hz.iter().find(|f| !(f.is_finite() && **f > 0.0)) {
            return Some(format!("subcarrier at {f} Hz; give frequencies above 0"));
        }
        let mut faults = gains.iter().map(|gain| gain_fault(gain.map(|v| v as f64))).enumerate();
        let (i, fault) = faults.find_map(|(i, fault)| Some((i, fault?)))?;
        let [l, a, f] = [i / channel_gains, i % channel_gains / subcarriers, i % subcarriers];
        Some(format!("channels[{l}, {a}, {f}] {fault}"))
    }
}

/// Moves row `order[i]` of `width` values to row i, and removes all other rows. Each row occurs at most once.
pub(super) fn select_rows<T>(values: &mut Vec<T>, width: usize, order: &[usize]) {
    let rows = values.len() / width;
    // Row in each slot, and slot of each row.
    let (mut row_at, mut slot_of): (Vec<usize>, Vec<usize>) = ((0..rows).collect(), (0..rows).collect());
    for (slot, &row) in order.iter().enumerate() {
        let from = slot_of[row]; // at `slot` or behind it, because earlier slots have other rows
        if from != slot {
            let (before, behind) = values.split_at_mut(from * width);
            before[slot * width..][..width].swap_with_slice(&mut behind[..width]);
            row_at.swap(slot, from);
            slot_of[row_at[from]] = from;
        }
    }
    values.truncate(order.len() * width);
    values.shrink_to_fit();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_selected_in_place() {
        let all: Vec<usize> = (0..12).collect();
        for order in [&[][..], &[1, 3, 4, 5], &[5, 0, 1, 2, 3, 4], &[0, 3, 1, 4, 2, 5], &[4, 0], &[2, 5, 0]] {
            let mut values = all.clone();
            select_rows(&mut values, 2, order);
            let expected: Vec<usize> = order.iter().flat_map(|row| [2 * row, 2 * row + 1]).collect();
            assert_eq!((values.capacity(), values), (expected.len(), expected), "{order:?}");
        }
    }
}
