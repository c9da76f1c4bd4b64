//! Subsets of positions that cover an area evenly.

use rayon::prelude::*;

/// Number of positions that one thread processes at a time.
const CHUNK: usize = 16_384;

/// Selects at most `count` of `points`: the first, then each time the one farthest from all selected ones (ties: the first).
/// Returns their indices in ascending order; all if there are no more than `count`. `progress` receives the number of selected
/// points and returns whether to continue.
pub fn select_farthest(points: &[[f64; 3]], count: usize, mut progress: impl FnMut(usize) -> bool) -> Vec<usize> {
    if points.len() <= count {
        return (0..points.len()).collect();
    }
    let (mut selected, mut last, mut gaps) = (Vec::with_capacity(count), 0, vec![f64::INFINITY; points.len()]);
    while selected.len() < count && progress(selected.len()) {
        selected.push(last);
        gaps[last] = -1.0; // duplicates have the gap 0
        let from = points[last];
        // The first of the farthest points of a chunk.
        let farthest = |(chunk, (gaps, points)): (usize, (&mut [f64], &[[f64; 3]]))| {
            let mut best = (f64::NEG_INFINITY, 0);
            for (k, (gap, p)) in gaps.iter_mut().zip(points).enumerate() {
                let (x, y, z) = (p[0] - from[0], p[1] - from[1], p[2] - from[2]);
                *gap = gap.min(x * x + y * y + z * z);
                best = if *gap > best.0 { (*gap, chunk * CHUNK + k) } else { best };
            }
            best
        };
        let chunks = gaps.par_chunks_mut(CHUNK).zip(points.par_chunks(CHUNK)).enumerate().map(farthest);
        // The larger gap, and of equal gaps the smaller index.
        let first = |a: (f64, usize), b: (f64, usize)| if (b.0, a.1) > (a.0, b.1) { b } else { a };
        last = chunks.reduce(|| (f64::NEG_INFINITY, usize::MAX), first).1;
    }
    selected.sort_unstable();
    selected
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn farthest_points_cover_clusters_before_they_are_dense() {
        let cluster =
            |x: f64| (0..20_000).map(move |k| [x + f64::from(k % 100) * 1e-3, f64::from(k / 100) * 1e-3, 1.0]);
        let points: Vec<[f64; 3]> = [0.0, 5.0, 9.0].into_iter().flat_map(cluster).collect();
        let three = select_farthest(&points, 3, |_| true);
        assert_eq!(three.iter().map(|k| k / 20_000).collect::<Vec<_>>(), [0, 1, 2]);
        assert_eq!(three[0], 0);
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let many = select_farthest(&points, 200, |_| true);
        assert!(many.is_sorted() && one.install(|| select_farthest(&points, 200, |_| true)) == many);
        let duplicates = select_farthest(&[[1.0; 3]; 9], 4, |_| true);
        assert_eq!(duplicates, [0, 1, 2, 3], "each only once");
        assert_eq!(select_farthest(&points[..5], 9, |_| true), [0, 1, 2, 3, 4]);
        assert_eq!(select_farthest(&points, 9, |done| done < 2).len(), 2);
    }
}
