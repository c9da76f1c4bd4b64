//! Confidence: whether the members of an ensemble differ where their mean is wrong.

use crate::observer::staged;
use crate::session::{Session, check_stopped};
use crate::text::{Lines, csv_rows};
use pwrfgs_core::{Dataset, Image, Result};
use pwrfgs_model::Prepared;
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Test spectra that are predicted together.
const CHUNK: usize = 64;

/// Spread of the members and error of their mean, one of each a test sample.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Confidence {
    /// Ids of the test samples.
    pub ids: Vec<u32>,
    /// Root mean square over the pixels of the standard deviation between members (n in the denominator).
    pub spreads: Vec<f64>,
    /// Root mean square over the pixels of prediction minus measurement, the prediction clamped to [0, 1].
    pub errors: Vec<f64>,
}

impl Confidence {
    /// Of the samples `part`.
    ///
    /// # Errors
    /// A spectrum that cannot be read; [`pwrfgs_core::Error::Stopped`] once the session is.
    pub fn measure(model: &Prepared<'_>, data: &Dataset, part: &[usize], session: &mut Session<'_>) -> Result<Self> {
        let stop = session.stop;
        staged(session.observer, "measuring the spread of members", |progress| {
            let mut all = Self { ids: part.iter().map(|&i| data.label(i)).collect(), ..Self::default() };
            let done = AtomicUsize::new(0);
            let of = |&i: &usize| {
                let (mean, deviation, _) = model.predict_with_deviation(data.query(i));
                let pair = (size(&deviation), distance(&data.task().shown(mean), &data.image(i)));
                progress(done.fetch_add(1, Ordering::Relaxed) + 1, part.len());
                pair
            };
            for chunk in part.chunks(CHUNK) {
                check_stopped(stop)?;
                let pairs: Vec<(f64, f64)> = chunk.par_iter().map(of).collect();
                all.spreads.extend(pairs.iter().map(|pair| pair.0));
                all.errors.extend(pairs.iter().map(|pair| pair.1));
            }
            data.observations.check()?;
            Ok(all)
        })
    }

    /// Spearman's rank correlation of spread and error: 1 where the order by spread is the order by error, 0 where spread
    /// says nothing; NaN where all are equal.
    pub fn rank_correlation(&self) -> f64 {
        correlation(&ranks(&self.spreads), &ranks(&self.errors))
    }

    /// Equally many samples a group, by spread: mean spread and the sorted errors of each.
    pub fn groups(&self, count: usize) -> Vec<(f64, Vec<f64>)> {
        let mut order: Vec<usize> = (0..self.spreads.len()).collect();
        order.sort_by(|&a, &b| self.spreads[a].total_cmp(&self.spreads[b]).then(a.cmp(&b)));
        let group = |k: usize| {
            let rows = &order[k * order.len() / count..(k + 1) * order.len() / count];
            let mut errors: Vec<f64> = rows.iter().map(|&i| self.errors[i]).collect();
            errors.sort_by(f64::total_cmp);
            (rows.iter().map(|&i| self.spreads[i]).sum::<f64>() / rows.len() as f64, errors)
        };
        (0..count).map(group).filter(|(_, errors)| !errors.is_empty()).collect()
    }

    /// Reads `confidence.csv`.
    ///
    /// # Errors
    /// [`pwrfgs_core::Error::Read`], or [`pwrfgs_core::Error::Input`] with the line if the file is damaged.
    pub fn read(path: &Path) -> Result<Self> {
        let mut all = Self::default();
        for (id, spread, error) in csv_rows(path)? {
            all.ids.push(id);
            all.spreads.push(spread);
            all.errors.push(error);
        }
        Ok(all)
    }

    /// The text of `confidence.csv`: a test id, spread and error.
    pub fn to_csv(&self) -> String {
        let mut lines = Lines::new(["sample", "spread", "error"]);
        for ((id, spread), error) in self.ids.iter().zip(&self.spreads).zip(&self.errors) {
            lines.put([&id.to_string(), &spread.to_string(), &error.to_string()]);
        }
        lines.text()
    }
}

/// Root mean square of the pixels.
fn size(image: &Image) -> f64 {
    let sum: f64 = image.pixels.iter().map(|p| (*p as f64).powi(2)).sum();
    (sum / image.pixels.len() as f64).sqrt()
}

/// Root mean square of the difference.
fn distance(a: &Image, b: &Image) -> f64 {
    let sum: f64 = a.pixels.iter().zip(&b.pixels).map(|(a, b)| (*a as f64 - *b as f64).powi(2)).sum();
    (sum / a.pixels.len() as f64).sqrt()
}

/// The rank of each value; equal ones share the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut ranks = vec![0.0; values.len()];
    let mut first = 0;
    for equal in order.chunk_by(|&a, &b| values[a].total_cmp(&values[b]).is_eq()) {
        let mean = first as f64 + (equal.len() - 1) as f64 / 2.0;
        equal.iter().for_each(|&i| ranks[i] = mean);
        first += equal.len();
    }
    ranks
}

/// Pearson's.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let product =
        |f: &dyn Fn(f64, f64) -> f64| -> f64 { a.iter().zip(b).map(|(a, b)| f(a - mean_a, b - mean_b)).sum() };
    product(&|a, b| a * b) / (product(&|a, _| a * a) * product(&|_, b| b * b)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn confidence(spreads: &[f64], errors: &[f64]) -> Confidence {
        Confidence { ids: (1..).take(spreads.len()).collect(), spreads: spreads.to_vec(), errors: errors.to_vec() }
    }

    #[test]
    fn correlations_are_those_of_scipy() {
        // scipy.stats.spearmanr([1, 2, 2, 4, 5, 3], [2, 1, 3, 9, 4, 4]) = 0.7941176470588235
        let c = confidence(&[1.0, 2.0, 2.0, 4.0, 5.0, 3.0], &[2.0, 1.0, 3.0, 9.0, 4.0, 4.0]);
        assert!((c.rank_correlation() - 0.794_117_647_058_823_5).abs() < 1e-12, "{}", c.rank_correlation());
        assert!((confidence(&[1.0, 2.0, 3.0], &[3.0, 5.0, 50.0]).rank_correlation() - 1.0).abs() < 1e-12);
        assert!(confidence(&[1.0, 1.0], &[3.0, 5.0]).rank_correlation().is_nan());
    }

    #[test]
    fn groups_are_of_equal_size_and_rise_in_spread() {
        let c = confidence(&[0.4, 0.1, 0.3, 0.2], &[4.0, 1.0, 3.0, 2.0]);
        let groups = c.groups(2);
        assert!((groups[0].0 - 0.15).abs() < 1e-12 && (groups[1].0 - 0.35).abs() < 1e-12);
        assert_eq!((&groups[0].1, &groups[1].1), (&vec![1.0, 2.0], &vec![3.0, 4.0]));
        assert_eq!(c.groups(9).len(), 4, "no group is empty");
    }
}
