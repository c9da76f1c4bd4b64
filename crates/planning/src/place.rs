//! Coverage of receivers: the 10th percentile, over transmitters, of the power of the strongest receiver.

/// Share of the transmitters below the coverage.
const SHARE: f64 = 0.1;
/// Smoothing of the soft maximum and of the soft percentile, dB.
const SMOOTHING_DB: f64 = 1.0;
/// Halvings in the search for the soft percentile.
const HALVINGS: usize = 60;

/// 10th percentile of the strongest power, with linear interpolation between transmitters. `powers` holds one slice of powers
/// in dBm `[T]` per receiver. NaN without transmitters or receivers.
pub fn coverage(powers: &[&[f64]]) -> f64 {
    let mut strongest = strongest(powers);
    if strongest.is_empty() {
        return f64::NAN;
    }
    let rank = SHARE * (strongest.len() - 1) as f64;
    let (_, low, above) = strongest.select_nth_unstable_by(rank as usize, f64::total_cmp);
    let next = above.iter().copied().fold(f64::INFINITY, f64::min);
    if rank.fract() > 0.0 { *low + rank.fract() * (next - *low) } else { *low }
}

/// Strongest power per transmitter `[T]`, dBm; `powers` holds one slice of powers `[T]` per receiver.
pub fn strongest(powers: &[&[f64]]) -> Vec<f64> {
    over_receivers(powers, largest)
}

/// Smooth [`coverage`]: the q at which the mean of 1 / (1 + exp((v − q) / 1 dB)) is 0.1, over soft maxima v of the powers.
pub fn soft_coverage(powers: &[&[f64]]) -> f64 {
    let soft = over_receivers(powers, |values| {
        let largest = largest(values);
        largest + SMOOTHING_DB * values.iter().map(|v| ((v - largest) / SMOOTHING_DB).exp()).sum::<f64>().ln()
    });
    if soft.is_empty() {
        return f64::NAN;
    }
    let ends = soft.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let (mut low, mut high) = (ends.0 - 10.0 * SMOOTHING_DB, ends.1 + 10.0 * SMOOTHING_DB);
    let share = |q: f64| soft.iter().map(|v| 1.0 / (1.0 + ((v - q) / SMOOTHING_DB).exp())).sum::<f64>();
    for _ in 0..HALVINGS {
        let middle = f64::midpoint(low, high);
        if share(middle) < SHARE * soft.len() as f64 { low = middle } else { high = middle }
    }
    f64::midpoint(low, high)
}

/// `reduce` of the powers of all receivers, per transmitter.
fn over_receivers(powers: &[&[f64]], reduce: impl Fn(&[f64]) -> f64) -> Vec<f64> {
    let mut values = vec![0.0; powers.len()];
    let of = |t: usize| {
        values.iter_mut().zip(powers).for_each(|(value, own)| *value = own[t]);
        reduce(&values)
    };
    (0..powers.first().map_or(0, |own| own.len())).map(of).collect()
}

/// Largest value.
fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_is_percentile_of_strongest_power() {
        let (rising, falling): (Vec<f64>, Vec<f64>) = (0..=100).map(|k| (f64::from(k), f64::from(100 - k))).unzip();
        assert!((coverage(&[&rising]) - 10.0).abs() < 1e-12);
        assert!((coverage(&[&rising, &falling]) - 55.0).abs() < 1e-12, "the strongest powers are 50, 51, 51, ..");
        assert!((coverage(&[&[0.0, 1.0]]) - 0.1).abs() < 1e-12, "interpolated");
        assert!(coverage(&[]).is_nan() && coverage(&[&[]]).is_nan() && soft_coverage(&[]).is_nan());
        assert_eq!(coverage(&[&[-3.0]]), -3.0);
    }

    #[test]
    fn soft_coverage_is_near_coverage_and_rises_with_powers() {
        let powers: Vec<f64> = (0..200).map(|k| -80.0 + 0.2 * f64::from(k)).collect();
        let soft = soft_coverage(&[&powers]);
        assert!((soft - coverage(&[&powers])).abs() < 0.5, "{soft}");
        let more: Vec<f64> = powers.iter().map(|v| v + 1.0).collect();
        assert!((soft_coverage(&[&more]) - soft - 1.0).abs() < 1e-9);
        assert!(soft_coverage(&[&powers, &powers]) > soft);
    }
}
