//! Principal components: how many fixed pictures, mixed, give every picture.

use super::scattered;
use crate::eigen::symmetric;
use pwrfgs_core::{Dataset, evenly};
use pwrfgs_experiment::scores::quantile;

/// Pictures that components are made of, pictures that they are tried on, and pixels looked at.
const LEARNED: usize = 192;
const TRIED: usize = 48;
const PIXELS: usize = 1_200;
/// Above rounding by this factor counts as rounding: components are themselves made of rounded pictures.
const SLACK: f64 = 1.25;

/// How well mixtures of fixed pictures reproduce pictures that had no part in making them.
#[derive(Clone, Debug)]
pub struct Components {
    /// Pictures the components were made of.
    pub of: usize,
    /// Median RMS of what is left after 0, 1, 2, .. components beside the mean picture.
    pub residuals: Vec<f64>,
    /// Components until rounding alone is left; `None` where all do not suffice.
    pub to_rounding: Option<usize>,
}

impl Components {
    /// Components until no more than `rms` is left.
    pub fn until(&self, rms: f64) -> Option<usize> {
        self.residuals.iter().position(|r| *r <= rms)
    }
}

/// Of the pictures `lively`, whose rounding has the RMS `rounding`.
pub(super) fn components(data: &Dataset, lively: &[usize], rounding: f64) -> Option<Components> {
    let chosen = evenly(lively, LEARNED + TRIED);
    if chosen.len() < 8 {
        return None;
    }
    let pixels = scattered(PIXELS, (data.width, data.height));
    let read = |&i: &usize| -> Vec<f64> {
        let image = data.image(i);
        pixels.iter().map(|&p| image.pixels[p] as f64).collect()
    };
    // Every fifth is tried, so that both come from the whole trajectory.
    let (mut tried, mut learned): (Vec<Vec<f64>>, Vec<Vec<f64>>) = Default::default();
    chosen.iter().enumerate().for_each(|(k, i)| if k % 5 == 2 { tried.push(read(i)) } else { learned.push(read(i)) });
    let n = learned.len();
    let mean: Vec<f64> = (0..pixels.len()).map(|p| learned.iter().map(|x| x[p]).sum::<f64>() / n as f64).collect();
    let centre = |x: &mut Vec<f64>| x.iter_mut().zip(&mean).for_each(|(x, m)| *x -= m);
    learned.iter_mut().for_each(centre);
    tried.iter_mut().for_each(centre);
    let gram = (0..n * n).map(|i| dot(&learned[i / n], &learned[i % n])).collect();
    let (values, vectors) = symmetric(gram, n);
    let mut squares: Vec<f64> = tried.iter().map(|x| dot(x, x)).collect();
    let left = |squares: &[f64]| {
        let mut rms: Vec<f64> = squares.iter().map(|s| (s.max(0.0) / pixels.len() as f64).sqrt()).collect();
        rms.sort_by(f64::total_cmp);
        quantile(&rms, 0.5)
    };
    let mut residuals = vec![left(&squares)];
    for (value, vector) in values.iter().zip(vectors) {
        if *value <= 1e-13 * values[0] {
            break;
        }
        let mut component = vec![0.0; pixels.len()];
        for (x, v) in learned.iter().zip(vector) {
            component.iter_mut().zip(x).for_each(|(c, x)| *c += v * x / value.sqrt());
        }
        squares.iter_mut().zip(&tried).for_each(|(s, x)| *s -= dot(x, &component).powi(2));
        residuals.push(left(&squares));
    }
    let to_rounding = residuals.iter().position(|r| *r <= SLACK * rounding);
    Some(Components { of: n, residuals, to_rounding })
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
