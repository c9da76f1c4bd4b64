//! `FingerprintFeatures`: the numbers in which two observations are compared.

use pwrfgs_core::{Dataset, Image, Real, Task, gain_indices};

/// Largest number of features of a spectrum; a finer one is reduced to the means of square blocks.
const MOST: usize = 3_600;
/// Added to a value before its root, relative to 1 for spectra and to the mean power for channels. It limits the weight of
/// faint values, whose noise the root would amplify.
const FAINTEST: f64 = 1e-4;
/// Largest number of links from which the mean power of channels is computed.
const LINKS: usize = 200;

/// Features of an observation of one link.
///
/// - Spectrum: roots of the means of square blocks of pixels. The root weighs faint directions more than the pixels
///   themselves do; they tell neighbouring positions apart.
/// - Received power: the power in dBm.
/// - Channel: roots of the magnitudes of the gains. Phases turn once per wavelength and are not compared.
#[derive(Clone, Debug)]
pub struct FingerprintFeatures {
    task: Task,
    width: usize,
    height: usize,
    /// Side of a block of pixels.
    block: usize,
    /// Added to a level before its root, see [`FAINTEST`].
    faintest: Real,
}

impl FingerprintFeatures {
    /// Creates the features of the observations of `data`. The `training` links give the mean power of channels.
    pub fn new(data: &Dataset, training: &[usize]) -> Self {
        let (task, width, height) = (data.task(), data.width, data.height);
        let block = if task.has_pixels {
            (1..=width.max(height)).find(|b| width.div_ceil(*b) * height.div_ceil(*b) <= MOST).unwrap_or(1)
        } else {
            1
        };
        let mut faintest = FAINTEST;
        if task.is_complex {
            let links = || training.iter().step_by(training.len().div_ceil(LINKS).max(1));
            let power = |i: &usize| data.image(*i).pixels.iter().map(|v| (*v as f64).powi(2)).sum::<f64>();
            let count = (links().count() * width * height / 2).max(1) as f64;
            faintest *= links().map(power).sum::<f64>() / count;
        }
        Self { task, width, height, block, faintest: faintest as Real }
    }

    /// Returns the measurement type.
    pub fn task(&self) -> Task {
        self.task
    }

    /// Returns width and height of an observation.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Returns the number of features of an observation.
    pub fn count(&self) -> usize {
        if self.task.is_complex {
            return self.width * self.height / 2; // a gain has a real and an imaginary part
        }
        self.width.div_ceil(self.block) * self.height.div_ceil(self.block)
    }

    /// Returns the features of an observation, `[count]`.
    pub fn extract(&self, image: &Image) -> Vec<f32> {
        if self.task.is_scalar {
            return image.pixels.iter().map(|v| *v as f32).collect();
        }
        self.levels(image).iter().map(|level| self.root(*level) as f32).collect()
    }

    /// Returns the derivative by the pixels of the observation `image`, given the derivative `d` by its features `[count]`.
    pub fn vjp(&self, image: &Image, d: &[f32]) -> Vec<Real> {
        if self.task.is_scalar {
            return d.iter().map(|d| Real::from(*d)).collect();
        }
        let slope = |(level, d): (&Real, &f32)| Real::from(*d) * self.root_slope(*level);
        let d_levels: Vec<Real> = self.levels(image).iter().zip(d).map(slope).collect();
        let mut d_pixels = vec![0.0; image.pixels.len()];
        if self.task.is_complex {
            for (i, d) in d_levels.iter().enumerate() {
                for at in gain_indices(i / self.width, i % self.width, self.width) {
                    d_pixels[at] = 2.0 * d * image.pixels[at];
                }
            }
            return d_pixels;
        }
        for (k, d) in d_pixels.iter_mut().enumerate() {
            let (block, count) = self.pixel_block(k);
            *d = if image.pixels[k] > 0.0 { d_levels[block] / count } else { 0.0 };
        }
        d_pixels
    }

    /// Returns the levels `[count]` before the root: the mean of every block, with negative pixels as 0, or the power of
    /// every gain.
    fn levels(&self, image: &Image) -> Vec<Real> {
        let mut levels = vec![0.0; self.count()];
        if self.task.is_complex {
            for (i, level) in levels.iter_mut().enumerate() {
                let gain = gain_indices(i / self.width, i % self.width, self.width);
                *level = gain.iter().map(|at| image.pixels[*at].powi(2)).sum();
            }
        } else {
            for (k, pixel) in image.pixels.iter().enumerate() {
                let (block, count) = self.pixel_block(k);
                levels[block] += pixel.max(0.0) / count;
            }
        }
        levels
    }

    /// Returns the index of the block of pixel `k`, and the number of pixels of this block.
    fn pixel_block(&self, k: usize) -> (usize, Real) {
        let (b, x, y) = (self.block, k % self.width / self.block, k / self.width / self.block);
        let side = |index: usize, size: usize| b.min(size - index * b);
        (y * self.width.div_ceil(b) + x, (side(x, self.width) * side(y, self.height)) as Real)
    }

    /// Returns the feature of a level v: √(v + ε) with the faintest level ε; for channels, whose levels are powers, the
    /// fourth root of v + ε.
    fn root(&self, level: Real) -> Real {
        let root = (level + self.faintest).sqrt();
        if self.task.is_complex { root.sqrt() } else { root }
    }

    /// Returns the derivative of [`Self::root`] by the level.
    fn root_slope(&self, level: Real) -> Real {
        let root = (level + self.faintest).sqrt();
        if self.task.is_complex { 0.25 / (root * root.sqrt()) } else { 0.5 / root }
    }
}
