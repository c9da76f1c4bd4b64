//! `Nearest`: the k nearest of some places, found by looking at all of them: 80,000 take less than a millisecond.

/// Places of any dimension, and the samples that they are of.
pub(super) struct Nearest {
    /// `[S,width]`, sample by sample.
    places: Vec<f64>,
    width: usize,
    samples: Vec<usize>,
}

/// |a - b|, in the unit of both; in space it is [`pwrfgs_core::neighbours::distance`] to the bit.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

impl Nearest {
    /// Samples with their places, metres or any other unit, all of `width` numbers.
    pub(super) fn new<P: AsRef<[f64]>>(samples: Vec<usize>, width: usize, place: impl Fn(usize) -> P) -> Self {
        let mut places = Vec::with_capacity(samples.len() * width);
        samples.iter().for_each(|&i| places.extend_from_slice(place(i).as_ref()));
        Self { places, width: width.max(1), samples }
    }

    /// The samples at `at` exactly, all of them, and the `k` nearest (all where there are fewer), nearest first, with
    /// their distances. Ties go to the lower sample.
    pub(super) fn find(&self, at: &[f64], k: usize) -> (Vec<usize>, Vec<(f64, usize)>) {
        /// Candidates that are kept beyond the k before the worst of them are dropped.
        const SPARE: usize = 1024;
        let k = k.clamp(1, self.samples.len().max(1));
        let by_distance = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let keep_nearest = |near: &mut Vec<(f64, usize)>| {
            if near.len() > k {
                near.select_nth_unstable_by(k - 1, by_distance);
                near.truncate(k);
            }
        };
        let (mut exact, mut near, mut worst) = (Vec::new(), Vec::with_capacity(k + SPARE), f64::INFINITY);
        for (place, &sample) in self.places.chunks_exact(self.width).zip(&self.samples) {
            let distance = distance(place, at);
            if distance == 0.0 {
                exact.push(sample);
            }
            if distance <= worst {
                near.push((distance, sample));
                if near.len() == k + SPARE {
                    keep_nearest(&mut near);
                    worst = near.iter().fold(0.0, |worst, n| worst.max(n.0));
                }
            }
        }
        keep_nearest(&mut near);
        near.sort_unstable_by(by_distance);
        (exact, near)
    }
}
