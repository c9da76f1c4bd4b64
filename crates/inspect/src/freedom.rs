//! Degrees of freedom: how many numbers reproduce the pictures to their rounding, and whether they are those of an array.

mod array;
mod components;

pub use array::{Array, Kind};
pub use components::Components;

use crate::look::Look;
use pwrfgs_core::{Dataset, Number, evenly};

/// What was found.
#[derive(Clone, Debug)]
pub struct Freedom {
    /// The step between two grey values; `None` of floats that are no multiples of 1/255 or 1/65,535.
    pub step: Option<f64>,
    /// Of all pictures together; nothing of fewer than eight that differ.
    pub components: Option<Components>,
    /// The smallest array whose pictures they are.
    pub array: Option<Array>,
}

/// How far from a whole number of steps single precision may put a multiple.
const ROUNDED: f64 = 0.01;
/// What floats are taken to be rounded to.
const FLOAT: f64 = 1e-6;

impl Freedom {
    /// RMS of rounding: that of a number uniform within one step.
    pub fn rounding(&self) -> f64 {
        self.step.unwrap_or(FLOAT) / 12f64.sqrt()
    }
}

/// Degrees of freedom of the pictures that are not constant.
pub(crate) fn freedom(data: &Dataset, looks: &[Look]) -> Freedom {
    let lively: Vec<usize> = looks.iter().filter(|l| l.strongest.is_some()).map(|l| l.sample).collect();
    let mut found = Freedom { step: step(data, &lively), components: None, array: None };
    found.components = components::components(data, &lively, found.rounding());
    found.array = array::array(data, &lively, found.rounding());
    found
}

/// The step between grey values: that of the 8 or 16 bits which the numbers are, or were made from.
fn step(data: &Dataset, lively: &[usize]) -> Option<f64> {
    if data.observations.number() == Number::U8 {
        return Some(1.0 / 255.0);
    }
    let pixels: Vec<f64> = evenly(lively, 8).into_iter().flat_map(|i| data.image(i).pixels).map(|p| p as f64).collect();
    let multiples = |steps: f64| pixels.iter().all(|p| (p * steps - (p * steps).round()).abs() < ROUNDED);
    [255.0, 65_535.0].into_iter().find(|steps| !pixels.is_empty() && multiples(*steps)).map(|steps| 1.0 / steps)
}

/// `count` pixels spread evenly over a picture of `width` by `height` (the R2 sequence of M. Roberts, 2018).
fn scattered(count: usize, (width, height): (usize, usize)) -> Vec<usize> {
    const PLASTIC: f64 = 1.324_717_957_244_746;
    let part = |k: usize, step: f64| (0.5 + step * k as f64).fract();
    let pixel = |k: usize| {
        let (x, y) = (part(k, 1.0 / PLASTIC), part(k, 1.0 / (PLASTIC * PLASTIC)));
        (y * height as f64) as usize * width + (x * width as f64) as usize
    };
    let mut pixels: Vec<usize> = (1..=count).map(pixel).collect();
    pixels.sort_unstable();
    pixels.dedup();
    pixels
}
