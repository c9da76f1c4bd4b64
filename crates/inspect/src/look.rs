//! One pass over the pictures: what each says by itself, and their mean.

use glam::DVec3;
use pwrfgs_core::{Dataset, Image, ImagePlane, Progress, Real, Result, evenly};
use rayon::prelude::*;
use std::hash::{DefaultHasher, Hasher as _};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Most pictures that are looked at: of more, so many evenly chosen.
const PICTURES: usize = 20_000;
/// Pictures that one thread adds up. Sums are made in this order at any number of threads.
const CHUNK: usize = 128;
/// How far from the first strongest pixel others of the same value belong to the same direction, degrees.
const PLATEAU_DEG: f64 = 15.0;

/// What one picture says.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    /// Which sample.
    pub(crate) sample: usize,
    /// Smallest and largest pixel.
    pub(crate) range: (f64, f64),
    /// Where it is strongest, a unit vector in the receiver frame; `None` of a constant picture.
    pub(crate) strongest: Option<DVec3>,
    /// The share of the sky that has the largest value, one pixel of it apart.
    pub(crate) plateau: f64,
    /// Alike in equal pictures.
    pub(crate) hash: u64,
}

/// All looks, and the mean picture.
#[derive(Clone, Debug)]
pub(crate) struct Looks {
    pub(crate) each: Vec<Look>,
    pub(crate) mean: Image,
}

impl Looks {
    /// Looks at every picture, or at 20,000 of more.
    ///
    /// # Errors
    /// Where a picture cannot be read.
    pub(crate) fn of(data: &Dataset, progress: Progress<'_>) -> Result<Self> {
        let all: Vec<usize> = (0..data.len()).collect();
        let chosen = evenly(&all, PICTURES);
        let sky = Sky::of(&data.plane());
        let done = AtomicUsize::new(0);
        let part = |samples: &[usize]| {
            let mut sum = vec![0.0; data.width * data.height];
            let look = |&sample: &usize| {
                let raw = data.observations.raw(sample);
                let image = data.image(sample);
                sum.iter_mut().zip(&image.pixels).for_each(|(sum, p)| *sum += *p as f64);
                progress(done.fetch_add(1, Ordering::Relaxed) + 1, chosen.len());
                sky.look(sample, &image, &raw)
            };
            (samples.iter().map(look).collect::<Vec<Look>>(), sum)
        };
        // A few chunks at a time: their sums are all that is held.
        let (mut each, mut sum) = (Vec::with_capacity(chosen.len()), vec![0.0; data.width * data.height]);
        for some in chosen.chunks(CHUNK * 16) {
            let parts: Vec<(Vec<Look>, Vec<f64>)> = some.par_chunks(CHUNK).map(part).collect();
            for (looks, part) in parts {
                each.extend(looks);
                sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
            }
        }
        data.observations.check()?;
        let pixels = sum.iter().map(|s| (s / chosen.len().max(1) as f64) as Real).collect();
        Ok(Self { each, mean: Image { width: data.width, height: data.height, pixels } })
    }
}

/// Directions of all pixels, and how much sky each covers.
struct Sky {
    directions: Vec<DVec3>,
    /// They add up to 1.
    areas: Vec<f64>,
}

impl Sky {
    fn of(plane: &ImagePlane) -> Self {
        let pixels = (0..plane.height).flat_map(|y| (0..plane.width).map(move |x| (x, y)));
        let direction = |(x, y)| {
            let direction = plane.direction(x as Real, y as Real).unwrap_or_default();
            DVec3::from_array(direction.map(|v| v as f64)).normalize_or_zero()
        };
        let directions: Vec<DVec3> = pixels.map(direction).collect();
        let areas: Vec<f64> = directions.iter().map(|d| d.x.hypot(d.y)).collect();
        let whole: f64 = areas.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        Self { directions, areas: areas.iter().map(|a| a / whole).collect() }
    }

    fn look(&self, sample: usize, image: &Image, raw: &[u8]) -> Look {
        let (low, high) =
            image.pixels.iter().fold((Real::INFINITY, Real::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
        let mut hasher = DefaultHasher::new();
        hasher.write(raw);
        // Rounding gives the strongest direction a plateau of equal pixels: its middle is meant, not its first corner.
        let first = self.directions[image.argmax()];
        let cos = PLATEAU_DEG.to_radians().cos();
        let (mut middle, mut plateau) = (DVec3::ZERO, -self.areas[image.argmax()]);
        for ((p, direction), area) in image.pixels.iter().zip(&self.directions).zip(&self.areas) {
            if *p == high {
                plateau += area;
                if direction.dot(first) > cos {
                    middle += *direction * *area;
                }
            }
        }
        let strongest = (low < high).then(|| middle.try_normalize().unwrap_or(first));
        Look { sample, range: (low as f64, high as f64), strongest, plateau, hash: hasher.finish() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Sample, Spectra};

    #[test]
    fn the_strongest_direction_is_the_middle_of_its_plateau_also_over_the_seam() {
        let (width, height) = (36, 9);
        let mut pixels = vec![0u8; 2 * width * height];
        for (row, column) in [(3, 35), (3, 0), (3, 1), (8, 18)] {
            pixels[row * width + column] = 200; // the last is another peak, equally strong
        }
        let samples = (1..=2).map(|id| Sample::new(id, [f64::from(id); 3])).collect();
        let spectra = Spectra::grey((width, height), pixels).unwrap();
        let data = Dataset::new("two", Pose::IDENTITY, vec![], samples, spectra).unwrap();
        let looks = Looks::of(&data, &|_, _| {}).unwrap();
        let found = looks.each[0].strongest.unwrap();
        let expected = DVec3::new(30f64.to_radians().cos(), 0.0, 0.5);
        assert!(found.angle_between(expected).to_degrees() < 0.5, "{found}");
        assert!(looks.each[1].strongest.is_none(), "a constant picture points nowhere");
        assert_eq!(looks.each[0].range, (0.0, f64::from(200f32 / 255.0)));
        assert!((looks.mean.pixels[3 * width] as f64 - 100.0 / 255.0).abs() < 1e-6);
        assert_ne!(looks.each[0].hash, looks.each[1].hash);
    }
}
