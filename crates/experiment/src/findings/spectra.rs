//! Single pass over the spectra: range, normalisation, strongest direction, constant and equal spectra.

use glam::DVec3;
use pwrfgs_core::{Camera, Dataset, Image, ImagePlane, Progress, Real, Result, evenly};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hasher as _};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Angle from the first of several maximum pixels within which they count as one direction, degrees.
const PLATEAU_DEG: f64 = 15.0;
/// Tolerance around 0 and 1 for rounding.
const ROUNDING: f64 = 1e-6;
/// Largest number of listed ids.
const NAMED: usize = 5;

/// Summary of one spectrum.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpectrumSummary {
    /// Sample index.
    pub(crate) sample: usize,
    /// Smallest and largest pixel.
    range: (f64, f64),
    /// Strongest direction, a unit vector in the receiver frame; `None` for a constant spectrum.
    pub(crate) strongest: Option<DVec3>,
    /// Hash, equal for equal spectra.
    hash: u64,
}

/// Summarises at most `most` evenly chosen spectra, in the order of samples.
///
/// # Errors
/// If a spectrum cannot be read.
pub(crate) fn summarise(data: &Dataset, most: usize, progress: Progress<'_>) -> Result<Vec<SpectrumSummary>> {
    let chosen = evenly(&(0..data.len()).collect::<Vec<_>>(), most);
    let directions = pixel_directions(&data.plane());
    let done = AtomicUsize::new(0);
    let summary = |&sample: &usize| {
        let mut hasher = DefaultHasher::new();
        hasher.write(&data.observations.raw(sample));
        let (range, strongest) = range_and_direction(&data.image(sample), &directions);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1, chosen.len());
        SpectrumSummary { sample, range, strongest, hash: hasher.finish() }
    };
    let summaries = chosen.par_iter().map(summary).collect();
    data.observations.check()?;
    Ok(summaries)
}

/// Returns the unit vectors of all pixels in the receiver frame, row by row; zero for pixels without a direction.
fn pixel_directions(plane: &ImagePlane) -> Vec<DVec3> {
    let pixels = (0..plane.height).flat_map(|y| (0..plane.width).map(move |x| (x, y)));
    let direction = |(x, y)| plane.direction(x as Real, y as Real).unwrap_or_default().map(|v| v as f64);
    pixels.map(|pixel| DVec3::from_array(direction(pixel)).normalize_or_zero()).collect()
}

/// Returns the smallest and largest pixel, and the unit vector (receiver frame) to the centre of the plateau of largest pixels;
/// `None` for a constant image.
fn range_and_direction(image: &Image, directions: &[DVec3]) -> ((f64, f64), Option<DVec3>) {
    let widen = |(low, high): (Real, Real), p: &Real| (low.min(*p), high.max(*p));
    let (low, high) = image.pixels.iter().fold((Real::INFINITY, Real::NEG_INFINITY), widen);
    // Rounding gives the strongest direction a plateau of equal pixels: its centre is used, not its first corner.
    let first = directions[image.argmax()];
    let cos = PLATEAU_DEG.to_radians().cos();
    let plateau = image.pixels.iter().zip(directions).filter(|(p, d)| **p == high && d.dot(first) > cos);
    let middle: DVec3 = plateau.map(|(_, d)| *d * d.x.hypot(d.y)).sum(); // weighted by solid angle
    ((low as f64, high as f64), (low < high).then(|| middle.try_normalize().unwrap_or(first)))
}

/// Describes elevations or camera, storage, normalisation and unusual spectra as names and texts.
pub(crate) fn describe(data: &Dataset, summaries: &[SpectrumSummary]) -> Vec<(&'static str, String)> {
    let widen = |(low, high): (f64, f64), s: &SpectrumSummary| (low.min(s.range.0), high.max(s.range.1));
    let (low, high) = summaries.iter().fold((f64::INFINITY, f64::NEG_INFINITY), widen);
    let id = |summary: &SpectrumSummary| data.sample(summary.sample).id;
    let constant: Vec<u32> = summaries.iter().filter(|s| s.strongest.is_none()).map(id).collect();
    let mut groups: BTreeMap<u64, Vec<u32>> = BTreeMap::new();
    summaries.iter().filter(|s| s.strongest.is_some()).for_each(|s| groups.entry(s.hash).or_default().push(id(s)));
    let mut equal: Vec<u32> = groups.into_values().filter(|ids| ids.len() > 1).flatten().collect();
    equal.sort_unstable();
    let pixels = match data.camera() {
        Some(Camera { focal: [fx, fy], centre: [cx, cy] }) => {
            ("camera", format!("focal lengths {fx:.1} and {fy:.1} px, principal point ({cx:.1}, {cy:.1}) px"))
        }
        None => ("elevations", format!("{}° to {}°, top row to bottom", data.elevation.first, data.elevation.last)),
    };
    vec![
        pixels,
        ("grey values", format!("{low:.3} to {high:.3}, stored as {:?}", data.observations.number())),
        ("normalisation", describe_normalisation(summaries, constant.len()).into()),
        ("unusual", [count_with_ids("constant", &constant), count_with_ids("equal to another", &equal)].join(", ")),
    ]
}

/// Describes the normalisation that all spectra have; `constant` is the number of constant ones, which fit any.
fn describe_normalisation(summaries: &[SpectrumSummary], constant: usize) -> &'static str {
    let is_zero = |s: &&SpectrumSummary| s.range.0.abs() < ROUNDING;
    let is_one = |s: &&SpectrumSummary| (s.range.1 - 1.0).abs() < ROUNDING;
    if summaries.iter().filter(is_one).filter(is_zero).count() + constant >= summaries.len() {
        "each spectrum runs from 0 to 1: it was shifted and scaled, and absolute power is lost"
    } else if summaries.iter().filter(is_one).count() + constant >= summaries.len() {
        "the largest value of each spectrum is 1: it was scaled, and absolute power is lost"
    } else {
        "spectra share one scale"
    }
}

/// Formats a count with ids, such as `3 constant (ids 4, 7, 9)`.
fn count_with_ids(kind: &str, ids: &[u32]) -> String {
    if ids.is_empty() {
        return format!("none {kind}");
    }
    let shown = ids.iter().take(NAMED).map(u32::to_string).collect::<Vec<_>>().join(", ");
    let more = if ids.len() > NAMED { ", .." } else { "" };
    format!("{} {kind} ({} {shown}{more})", ids.len(), if ids.len() == 1 { "id" } else { "ids" })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    fn data((width, height): (usize, usize), pixels: Vec<u8>) -> Dataset {
        let count = (pixels.len() / (width * height)) as u32;
        let samples = (1..=count).map(|id| Sample::new(id, [f64::from(id); 3])).collect();
        Dataset::new("few", Pose::IDENTITY, vec![], samples, Spectra::grey((width, height), pixels).unwrap()).unwrap()
    }

    #[test]
    fn peak_direction_is_centre_of_plateau_across_seam() {
        let (width, height) = (36, 9);
        let mut pixels = vec![0u8; 2 * width * height];
        for (row, column) in [(3, 35), (3, 0), (3, 1), (8, 18)] {
            pixels[row * width + column] = 200; // the last is another peak, equally strong
        }
        let summaries = summarise(&data((width, height), pixels), 2, &|_, _| {}).unwrap();
        let direction = summaries[0].strongest.unwrap();
        let expected = DVec3::new(30f64.to_radians().cos(), 0.0, 0.5);
        assert!(direction.angle_between(expected).to_degrees() < 0.5, "{direction}");
        assert!(summaries[1].strongest.is_none(), "a constant spectrum has no strongest direction");
        assert_eq!(summaries[0].range, (0.0, f64::from(200f32 / 255.0)));
    }

    fn facts_of(pixels: Vec<u8>) -> Vec<String> {
        let data = data((8, 4), pixels);
        describe(&data, &summarise(&data, 100, &|_, _| {}).unwrap()).into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn finds_constant_and_equal_spectra() {
        let ramp = |top: u8| (0..32).map(move |k| if k == 31 { top } else { k });
        let facts = facts_of(ramp(255).chain(ramp(200)).chain([9; 32]).chain(ramp(255)).collect());
        assert_eq!(facts[3], "1 constant (id 3), 2 equal to another (ids 1, 4)");
    }

    #[test]
    fn detects_normalisation_of_spectra() {
        let normalisation = |tops: [u8; 3], low: u8| {
            let spectrum = |t: &u8| (0..32).map(|k| if k == 7 { *t } else { low + k }).collect::<Vec<_>>();
            facts_of(tops.iter().flat_map(spectrum).collect())[2].clone()
        };
        assert!(normalisation([255; 3], 0).starts_with("each spectrum runs from 0 to 1"));
        assert!(normalisation([255; 3], 3).starts_with("the largest value of each spectrum is 1"));
        assert_eq!(normalisation([200, 90, 250], 0), "spectra share one scale");
    }
}
