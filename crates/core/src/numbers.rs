//! Text format of numbers.

/// Size from which numbers have an exponent: more digits are not measured, and 1e300 has 300.
const LARGE: f64 = 1e15;

/// Formats a number with four significant digits, below 0.1 with four decimals, and from 1,000 without decimals. Integers from
/// 10 to 1e15 are in full; sizes below 1e-4 and from 1e15 have an exponent and three digits. NaN is `n/a`, infinity `∞`.
pub fn number(value: f64) -> String {
    let size = value.abs();
    if let Some(text) = non_finite(value) {
        return text.into();
    }
    if value.fract() == 0.0 && (10.0..LARGE).contains(&size) {
        return grouped(value as i64);
    }
    match size {
        0.0 => "0".into(),
        s if s >= LARGE => format!("{value:.2e}"),
        s if s >= 1000.0 => grouped(value.round() as i64),
        s if s >= 100.0 => format!("{value:.1}"),
        s if s >= 10.0 => format!("{value:.2}"),
        s if s >= 1.0 => format!("{value:.3}"),
        s if s >= 1e-4 => format!("{value:.4}"),
        _ => format!("{value:.2e}"),
    }
}

/// Formats a number with `decimals` decimals, or with up to six if two significant digits need more. Sizes below 1e-5 keep
/// `decimals`, and so do integers if it is 0. Without decimals, thousands are grouped. Sizes from 1e15 have an exponent. NaN is
/// `n/a`, infinity `∞`.
pub fn fixed(value: f64, decimals: usize) -> String {
    if let Some(text) = non_finite(value) {
        return text.into();
    }
    if value.abs() >= LARGE {
        return format!("{value:.2e}").replace('-', "−");
    }
    let needed = (1.0 - value.abs().log10().floor()).clamp(0.0, 99.0) as usize;
    let is_as_given = (value.fract() == 0.0 && decimals == 0) || needed > 6;
    let text = format!("{:.*}", if is_as_given { decimals } else { decimals.max(needed) }, value.abs());
    let text = if decimals == 0 && value.abs() >= 1e3 { grouped(value.abs().round() as i64) } else { text };
    // Values rounded to 0 have no sign.
    let negative = value < 0.0 && text.bytes().any(|b| (b'1'..=b'9').contains(&b));
    if negative { format!("−{text}") } else { text }
}

/// Returns the text of NaN or an infinity; `None` for a finite number.
fn non_finite(value: f64) -> Option<&'static str> {
    match value {
        v if v.is_finite() => None,
        v if v.is_nan() => Some("n/a"),
        v => Some(if v > 0.0 { "∞" } else { "−∞" }),
    }
}

/// Formats an integer with groups of three digits: 65469 as `65,469`.
pub fn grouped(value: i64) -> String {
    let digits = value.unsigned_abs().to_string();
    let mut out = String::from(if value < 0 { "-" } else { "" });
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn formats_numbers_with_four_digits() {
        let formatted = [0.0, 0.88125, 12.345, 65469.0, 1e-6, f64::INFINITY, 123.456, 1e300, -1.5e20].map(number);
        assert_eq!(formatted, ["0", "0.8812", "12.35", "65,469", "1.00e-6", "∞", "123.5", "1.00e300", "-1.50e20"]);
    }

    #[test]
    fn formats_two_digits_without_negative_zero() {
        let values = [
            (0.8012, 3),
            (0.0035, 3),
            (12.3, 0),
            (8.666, 0),
            (8.0, 0),
            (12_345.6, 0),
            (-0.25, 2),
            (-1e-9, 3),
            (0.0, 3),
            (-1e300, 3),
        ];
        let formatted = values.map(|(value, decimals)| fixed(value, decimals));
        assert_eq!(formatted, ["0.801", "0.0035", "12", "8.7", "8", "12,346", "−0.25", "0.000", "0.000", "−1.00e300"]);
        assert_eq!([f64::INFINITY, f64::NEG_INFINITY, f64::NAN].map(|v| fixed(v, 3)), ["∞", "−∞", "n/a"]);
    }
}
