//! Codes and units of received powers: values that are probably not readings, and the probable unit of values.

use crate::Real;
use crate::statistics::median;
use std::str::FromStr;

/// Distance of a code from the next value, dB.
const GAP_DB: f64 = 20.0;
/// Smallest number of equal powers that are a code.
const SEVERAL: usize = 3;
/// Powers outside this range are no readings, dBm: a watt, and less than the thermal noise in some hertz.
const RANGE_DBM: std::ops::RangeInclusive<f64> = -150.0..=30.0;
/// Smallest number of powers with the lowest value, and share of all powers above which it is a code.
const LOWEST_COUNT: usize = 10;
const LOWEST_SHARE: f64 = 0.2;
/// Share of the powers with one value above which it is notable.
const SHARED: f64 = 0.05;
/// Absolute value below which all powers are probably linear.
const FAINT: f64 = 0.1;

/// Distinct value of received powers, such as a code for "not received".
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoneValue {
    /// The value.
    pub value: Real,
    /// Number of powers with this value.
    pub count: usize,
    /// Index of the first of them.
    pub first: usize,
    /// Distance to the nearest other value, dB; infinite if there is none. For a code beyond all readings, the next value is that
    /// towards the readings.
    pub gap: f64,
}

/// Finds values of `powers` in dBm that are probably codes. NaN and infinities are ignored.
///
/// - Three or more equal powers at either end, more than 20 dB from the next value.
/// - Powers above 30 dBm or below -150 dBm, unless the median of all powers that the first rule leaves is outside too.
/// - The lowest of more than two values, if at least ten powers, more than a fifth of all and twice as many as the next
///   value have it.
///
/// ```
/// let powers = [-61.0, 100.0, -70.5, 100.0, -64.0, 100.0];
/// let [code] = pwrfgs_core::lone_values(&powers)[..] else { panic!() };
/// assert_eq!((code.value, code.count, code.first, code.gap), (100.0, 3, 1, 161.0));
/// ```
pub fn lone_values(powers: &[Real]) -> Vec<LoneValue> {
    let values = histogram(powers);
    let mut inner = &values[..];
    let mut codes = take_ends(&mut inner, |entry| entry.count >= SEVERAL && entry.gap > GAP_DB);
    let readings = || inner.iter().flat_map(|entry| std::iter::repeat_n(entry.value as f64, entry.count));
    // The middle of powers in another unit may lie outside.
    if RANGE_DBM.contains(&median(readings())) {
        codes.extend(take_ends(&mut inner, |entry| !RANGE_DBM.contains(&(entry.value as f64))));
    }
    let lowest = inner.first().zip(inner.get(1)).filter(|_| inner.len() > 2);
    let is_code = |entry: &LoneValue, next: &LoneValue| {
        entry.count >= LOWEST_COUNT.max(2 * next.count) && entry.count as f64 > LOWEST_SHARE * powers.len() as f64
    };
    codes.extend(lowest.filter(|(entry, next)| is_code(entry, next)).map(|(entry, _)| *entry));
    codes
}

/// Finds values of more than 5 % of the powers that are also more than four times as frequent as the fourth most frequent value;
/// none if there are fewer than four values. [`lone_values`] may be among them. NaN and infinities are ignored.
pub fn shared_values(powers: &[Real]) -> Vec<LoneValue> {
    let mut values = histogram(powers);
    values.sort_by_key(|entry| std::cmp::Reverse(entry.count));
    // At most three values are notable, and readings repeat too: the fourth shows how often.
    let usual = values.get(3).map_or(usize::MAX, |entry| 4 * entry.count);
    let is_shared = |entry: &LoneValue| entry.count as f64 > SHARED * powers.len() as f64 && entry.count > usual;
    values.into_iter().take(3).filter(is_shared).collect()
}

/// Removes entries that `is_code` from either end of `entries`, which keeps at least two, and returns them, each with its
/// distance to the next entry.
fn take_ends(entries: &mut &[LoneValue], is_code: impl Fn(&LoneValue) -> bool) -> Vec<LoneValue> {
    let mut codes = Vec::new();
    while let [first, second, .., before, last] | [first, second @ before, last] = *entries {
        let with_gap = |entry: &LoneValue, next: &LoneValue| LoneValue {
            gap: (next.value as f64 - entry.value as f64).abs(),
            ..*entry
        };
        let (low, high) = (with_gap(first, second), with_gap(last, before));
        if is_code(&low) {
            codes.push(low);
            *entries = &entries[1..];
        } else if is_code(&high) {
            codes.push(high);
            *entries = &entries[..entries.len() - 1];
        } else {
            break;
        }
    }
    codes
}

/// Lists the distinct finite values in ascending order, each with its distance to the nearest other one.
fn histogram(powers: &[Real]) -> Vec<LoneValue> {
    let mut order: Vec<usize> = (0..powers.len()).filter(|i| powers[*i].is_finite()).collect();
    order.sort_by(|a, b| powers[*a].total_cmp(&powers[*b]).then(a.cmp(b)));
    let groups: Vec<&[usize]> = order.chunk_by(|a, b| powers[*a] == powers[*b]).collect();
    let value = |k: usize| groups.get(k).map_or(f64::INFINITY, |group| powers[group[0]] as f64);
    let entry = |(k, group): (usize, &&[usize])| {
        let below = if k == 0 { f64::INFINITY } else { value(k) - value(k - 1) };
        let gap = below.min(value(k + 1) - value(k));
        LoneValue { value: powers[group[0]], count: group.len(), first: group[0], gap }
    };
    groups.iter().enumerate().map(entry).collect()
}

/// Unit of received powers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PowerUnit {
    /// dBm.
    #[default]
    Dbm,
    /// dBm without the minus sign.
    PositiveDbm,
    /// Signal quality from 0 to 100 %: 0 is -100 dBm, 100 is -50 dBm.
    Percent,
    /// Decibels over a floor, dBm.
    OverFloor(f64),
    /// Milliwatts; 0 is no signal.
    Milliwatts,
    /// Watts; 0 is no signal.
    Watts,
}

impl PowerUnit {
    /// Returns the units that `powers` probably have; none if they are plausible in dBm, all 0, or if there are none. The floor
    /// is an example. Leave out [`lone_values`] first.
    pub fn guess(powers: &[Real]) -> &'static [Self] {
        let values = || powers.iter().map(|value| *value as f64).filter(|value| value.is_finite());
        let (low, high) = crate::statistics::bounds(values());
        if low > high || low == 0.0 && high == 0.0 {
            &[]
        } else if low.abs().max(high.abs()) <= FAINT || low > 0.0 && high > 1e3 * low {
            // Linear powers are tiny, or positive over more than three decades.
            &[Self::Milliwatts, Self::Watts]
        } else if low < 0.0 && median(values()) <= *RANGE_DBM.end() {
            &[]
        } else if high <= 100.0 {
            // Up to 100, a percentage too.
            &[Self::PositiveDbm, Self::Percent, Self::OverFloor(-100.0)]
        } else if high <= -RANGE_DBM.start() {
            &[Self::PositiveDbm, Self::OverFloor(-100.0)]
        } else {
            &[Self::Milliwatts]
        }
    }

    /// Returns the value of the option `--unit`, the name in a sentence, and the conversion to dBm. A floor is the example of
    /// [`Self::guess`].
    pub fn words(self) -> [&'static str; 3] {
        match self {
            Self::Dbm => ["dBm", "dBm", "keep them"],
            Self::PositiveDbm => ["positive-dBm", "-dBm (the minus sign is missing)", "negate them"],
            Self::Percent => ["percent", "per cent of quality", "give value / 2 - 100"],
            Self::OverFloor(_) => ["dB:-100", "decibels over a floor", "add the floor in dBm, such as -100"],
            Self::Milliwatts => ["mW", "milliwatts", "give 10 * log10(mW)"],
            Self::Watts => ["W", "watts", "give 10 * log10(W) + 30"],
        }
    }

    /// Converts a value to dBm; `None` for no signal, NaN for a negative linear power.
    pub fn dbm(self, value: f64) -> Option<f64> {
        let dbm = match self {
            Self::Dbm => value,
            Self::PositiveDbm => -value,
            Self::Percent => 0.5 * value - 100.0,
            Self::OverFloor(floor) => value + floor,
            Self::Milliwatts => 10.0 * value.log10(),
            Self::Watts => 10.0 * value.log10() + 30.0,
        };
        (dbm != f64::NEG_INFINITY).then_some(dbm)
    }
}

impl FromStr for PowerUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let floor = || text.strip_prefix("dB:")?.parse().ok().filter(|floor: &f64| floor.is_finite());
        let named = [Self::Dbm, Self::PositiveDbm, Self::Percent, Self::Milliwatts, Self::Watts];
        let unit = named.into_iter().find(|unit| unit.words()[0] == text).or_else(|| floor().map(Self::OverFloor));
        unit.ok_or_else(|| {
            format!(
                "{text}: expected dBm, positive-dBm (sign lost), percent (percent / 2 - 100 dBm), dB:FLOOR (over a floor in \
                 dBm, such as dB:-95), mW or W"
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn codes(powers: &[Real]) -> Vec<(Real, usize)> {
        lone_values(powers).iter().map(|code| (code.value, code.count)).collect()
    }

    #[test]
    fn finds_codes_at_either_end() {
        let readings = || (0..30).map(|k| -50.0 - k as Real);
        for code in [0.0, 1.0, 100.0, -110.0, -200.0, 60.0, -999.0] {
            let powers: Vec<Real> = readings().chain([code; 4]).collect();
            assert_eq!(codes(&powers), [(code, 4)]);
        }
        let both: Vec<Real> = readings().chain([100.0; 90]).chain([-200.0; 3]).chain([45.0]).collect();
        assert_eq!(codes(&both), [(-200.0, 3), (100.0, 90), (45.0, 1)]);
        assert_eq!(codes(&readings().collect::<Vec<_>>()), []);
    }

    #[test]
    fn lowest_value_is_a_code_if_a_fifth_has_it() {
        let powers = |lowest: Real| (0..70).map(|k| -90.0 + k as Real / 2.0).chain([lowest; 30]).collect::<Vec<_>>();
        assert_eq!(codes(&powers(-100.0)), [(-100.0, 30)]);
        // A reading, since lower values exist; the number is still notable.
        let twin: Vec<Real> = powers(-100.0).into_iter().chain([-101.0, -107.0]).collect();
        assert_eq!(codes(&twin), []);
        assert_eq!(shared_values(&twin).iter().map(|v| (v.value, v.count)).collect::<Vec<_>>(), [(-100.0, 30)]);
        assert_eq!(codes(&[-60.0, Real::NAN]), []);
    }

    #[test]
    fn guesses_units() {
        use PowerUnit::*;
        assert_eq!(PowerUnit::guess(&[-60.0, -90.0, 3.0]), []);
        assert_eq!(PowerUnit::guess(&[5.1e-8, 1.2e-9]), [Milliwatts, Watts]);
        assert_eq!(PowerUnit::guess(&[42.9, 59.2]), [PositiveDbm, Percent, OverFloor(-100.0)]);
        assert_eq!(PowerUnit::guess(&[42.9, 109.2]), [PositiveDbm, OverFloor(-100.0)]);
        assert_eq!([PowerUnit::guess(&[]), PowerUnit::guess(&[0.0])], [&[]; 2]);
        assert!(lone_values(&[42.0, 43.0, 44.0, 61.0]).is_empty());
    }
}
