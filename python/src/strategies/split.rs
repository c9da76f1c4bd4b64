//! A class of Python's as a split.

use super::Strategy;
use super::objects::{generator, links_object};
use crate::arrays::numbers;
use crate::border::wrong;
use pwrfgs_core::{Dataset, Error, Partition, Result, Split, rng};
use pyo3::prelude::*;

impl Split for Strategy {
    fn typetag_name(&self) -> &'static str {
        "Python"
    }

    fn typetag_deserialize(&self) {}

    fn split(&self, data: &Dataset, random: &mut rng::Rng) -> Result<Partition> {
        let count = data.len();
        let lists = self.try_with(|py, own| {
            let links = links_object(py, data, &(0..count).collect::<Vec<_>>())?;
            let found = own.call_method1("split", (links, generator(py, random)?))?;
            let lists = found.try_iter()?.map(|part| part_of(&part?, count)).collect::<PyResult<Vec<_>>>()?;
            match lists.len() {
                2 | 3 => Ok(lists),
                n => Err(wrong(py, &format!("split gave {n} parts; give (train, test) or (train, validation, test)"))),
            }
        })?;
        let mut lists = lists.into_iter();
        let train = lists.next().unwrap_or_default();
        let (validation, test) = match (lists.next(), lists.next()) {
            (Some(validation), Some(test)) => (validation, test),
            (Some(test), None) => (Vec::new(), test),
            _ => Default::default(),
        };
        let mut all: Vec<usize> = [&train, &validation, &test].into_iter().flatten().copied().collect();
        all.sort_unstable();
        let twice = all.windows(2).find_map(|pair| (pair[0] == pair[1]).then(|| pair[0]));
        if let Some(twice) = twice {
            return Err(Error::Config(format!("split: link {twice} is in two parts")));
        }
        Ok(Partition { train, validation, test })
    }
}

/// Places of links, sorted, from a mask or from places.
fn part_of(part: &Bound<'_, PyAny>, count: usize) -> PyResult<Vec<usize>> {
    if let Ok(mask) = numbers::<bool>("a part", part, &[Some(count)]) {
        return Ok((0..count).filter(|&i| mask[i]).collect());
    }
    let places =
        numbers::<i64>("a part of a split, which is places of links or a mask of all of them,", part, &[None])?;
    if let Some(bad) = places.iter().find(|i| usize::try_from(**i).is_err() || **i as usize >= count) {
        return Err(wrong(part.py(), &format!("split: there is no link {bad}; there are {count}, counted from 0")));
    }
    let mut places: Vec<usize> = places.into_iter().map(|i| i as usize).collect();
    places.sort_unstable();
    Ok(places)
}
