//! Mean, order statistics and thinning.

/// Returns the mean of values; NaN without any.
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0.0), |(sum, count), v| (sum + v, count + 1.0));
    sum / count
}

/// Returns the standard deviation of values about their mean, with divisor N; NaN without values.
pub fn deviation(values: &[f64]) -> f64 {
    let middle = mean(values.iter().copied());
    mean(values.iter().map(|value| (value - middle).powi(2))).sqrt()
}

/// Returns at most `count` of the `items`, evenly spaced from the first.
pub fn evenly<T: Clone>(items: &[T], count: usize) -> Vec<T> {
    let n = items.len().min(count);
    (0..n).map(|i| items[i * items.len() / n].clone()).collect()
}

/// Returns the smallest and largest value; `(∞, −∞)` for none. NaN is ignored.
pub fn bounds(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    values.into_iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

/// Returns the values in ascending order; NaN is last, or first if its sign is negative.
pub fn sorted(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values
}

/// Returns the quantile `q` from 0 to 1 of ascending values, interpolated; NaN for none.
///
/// # Panics
/// If `q` is above 1.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let rank = q * last as f64;
    let (low, fraction) = (rank as usize, rank.fract());
    if fraction == 0.0 { sorted[low] } else { sorted[low] * (1.0 - fraction) + sorted[low + 1] * fraction }
}

/// Returns the median of values in any order; NaN for none.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    quantile(&sorted(values), 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate_and_ignore_the_order_of_values() {
        let values = sorted([3.0, 1.0, 2.0, 4.0]);
        assert_eq!(values, [1.0, 2.0, 3.0, 4.0]);
        assert_eq!([0.0, 0.25, 0.5, 1.0].map(|q| quantile(&values, q)), [1.0, 1.75, 2.5, 4.0]);
        assert_eq!((median([5.0, 1.0, 3.0]), median([2.0, 1.0]), bounds([2.0, f64::NAN, 1.0])), (3.0, 1.5, (1.0, 2.0)));
        assert!(quantile(&[], 0.5).is_nan() && median([]).is_nan() && bounds([]).0 > bounds([]).1);
    }

    #[test]
    fn selects_evenly_spaced_samples() {
        let part: Vec<usize> = (100..110).collect();
        assert_eq!(evenly(&part, 3), [100, 103, 106]);
        assert_eq!(evenly(&part, 50), part);
        assert!(evenly(&part, 0).is_empty() && evenly::<usize>(&[], 5).is_empty());
    }
}
