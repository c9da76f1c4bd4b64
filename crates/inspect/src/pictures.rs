//! What the pictures hold: range, normalisation, and those that are constant, saturated or there twice.

use crate::look::Looks;
use pwrfgs_core::{Dataset, Image, Number};
use pwrfgs_experiment::scores::quantile;
use std::collections::BTreeMap;

/// A picture is saturated where more than this part of the sky has its largest value: a disc of 8 degrees.
const SATURATED: f64 = 0.01;
/// How near to 0 or 1 counts as there.
const THERE: f64 = 1e-6;

/// The pictures of a data set.
#[derive(Clone, Debug)]
pub struct Pictures {
    /// How many were looked at.
    pub looked_at: usize,
    /// Columns and rows.
    pub size: [usize; 2],
    /// How a pixel is stored.
    pub number: Number,
    /// Smallest and largest pixel of all.
    pub range: [f64; 2],
    /// Quantiles 0.05, 0.5 and 0.95 of the largest pixel of a picture.
    pub largest: [f64; 3],
    /// Pictures whose smallest pixel is 0.
    pub from_zero: usize,
    /// Pictures whose largest pixel is 1.
    pub to_one: usize,
    /// Pictures of which both holds.
    pub stretched: usize,
    /// Ids of pictures with one value alone.
    pub constant: Vec<u32>,
    /// Ids of pictures that are cut off at the top.
    pub saturated: Vec<u32>,
    /// Ids of pictures that are equal, pixel by pixel; constant ones apart.
    pub twins: Vec<Vec<u32>>,
    /// The mean picture.
    pub mean: Image,
}

impl Pictures {
    /// How pictures are normalised, as far as shown.
    pub fn normalisation(&self) -> String {
        let Self { looked_at, from_zero, to_one, stretched, range, largest, .. } = self;
        let all = |count: &usize| *count + self.constant.len() >= *looked_at;
        match () {
            () if all(stretched) => {
                "each picture runs from 0 to 1: it was shifted and stretched, and absolute power is lost".into()
            }
            () if all(to_one) => "each picture's largest value is 1: it was scaled, and absolute power is lost".into(),
            () if *to_one * 10 > *looked_at * 9 => {
                format!(
                    "{to_one} of {looked_at} pictures reach 1 and {from_zero} reach 0: normalised one by one, but not all"
                )
            }
            () => format!(
                "pictures share one scale: their largest values are {:.3} to {:.3} (5 % to 95 %), that of all is {:.3}",
                largest[0], largest[2], range[1]
            ),
        }
    }
}

/// Of the pictures that were looked at.
pub(crate) fn pictures(data: &Dataset, looks: &Looks) -> Pictures {
    let id = |sample: usize| data.sample(sample).id;
    let each = &looks.each;
    let count = |test: &dyn Fn((f64, f64)) -> bool| each.iter().filter(|l| test(l.range)).count();
    let mut largest: Vec<f64> = each.iter().map(|l| l.range.1).collect();
    largest.sort_by(f64::total_cmp);
    let mut alike: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
    each.iter().filter(|l| l.strongest.is_some()).for_each(|l| alike.entry(l.hash).or_default().push(l.sample));
    let equal = |group: &Vec<usize>| {
        group.len() > 1 && group.windows(2).all(|w| data.observations.raw(w[0]) == data.observations.raw(w[1]))
    };
    let mut twins: Vec<Vec<u32>> =
        alike.into_values().filter(equal).map(|group| group.into_iter().map(id).collect()).collect();
    twins.sort();
    let (zero, one) = (|low: f64| low.abs() < THERE, |high: f64| (high - 1.0).abs() < THERE);
    Pictures {
        looked_at: each.len(),
        size: [data.width, data.height],
        number: data.observations.number(),
        range: [each.iter().map(|l| l.range.0).fold(f64::INFINITY, f64::min), quantile(&largest, 1.0)],
        largest: [0.05, 0.5, 0.95].map(|q| quantile(&largest, q)),
        from_zero: count(&|(low, _)| zero(low)),
        to_one: count(&|(_, high)| one(high)),
        stretched: count(&|(low, high)| zero(low) && one(high)),
        constant: each.iter().filter(|l| l.strongest.is_none()).map(|l| id(l.sample)).collect(),
        saturated: each
            .iter()
            .filter(|l| l.strongest.is_some() && l.plateau > SATURATED)
            .map(|l| id(l.sample))
            .collect(),
        twins,
        mean: looks.mean.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    fn of(pixels: Vec<u8>) -> Pictures {
        let count = pixels.len() / 32;
        let samples = (1..=count as u32).map(|id| Sample::new(id, [f64::from(id); 3])).collect();
        let data =
            Dataset::new("few", Pose::IDENTITY, vec![], samples, Spectra::grey((8, 4), pixels).unwrap()).unwrap();
        pictures(&data, &Looks::of(&data, &|_, _| {}).unwrap())
    }

    #[test]
    fn what_is_odd_is_found() {
        let ramp = |top: u8| (0..32).map(move |k| if k == 31 { top } else { k });
        let mut pixels: Vec<u8> = ramp(255).chain(ramp(200)).chain([9; 32]).chain(ramp(255)).collect();
        pixels.extend((0..32).map(|k| if k < 8 { 255 } else { k }));
        let found = of(pixels);
        assert_eq!((found.constant, found.saturated, found.twins), (vec![3], vec![5], vec![vec![1, 4]]));
        assert_eq!((found.from_zero, found.to_one, found.stretched), (3, 3, 2));
    }

    #[test]
    fn the_normalisation_is_named() {
        let said = |tops: [u8; 3], low: u8| {
            of(tops.iter().flat_map(|t| (0..32).map(|k| if k == 7 { *t } else { low + k })).collect()).normalisation()
        };
        assert!(said([255; 3], 0).starts_with("each picture runs from 0 to 1"));
        assert!(said([255; 3], 3).starts_with("each picture's largest value is 1"));
        assert!(said([200, 90, 250], 0).starts_with("pictures share one scale"));
    }
}
