//! Checks of received powers: codes, the unit, and values that many links share.

use super::finding::{Finding, name_link};
use super::relation::LevelLinks;
use pwrfgs_core::statistics::{bounds, median};
use pwrfgs_core::{Dataset, LoneValue, PowerUnit, Real, lone_values, shared_values};

/// Largest number of values in a sentence.
const NAMED: usize = 3;
/// Distance of observed powers from all known ones above which they are in another unit or codes, dB.
const FAR_DB: f64 = 20.0;

/// Finds codes among the powers of `data`, values that many share, and powers that are not in dBm.
pub(super) fn check_powers(data: &Dataset, powers: &[Real]) -> Vec<Finding> {
    let codes = lone_values(powers);
    let is_code = |value: &Real| codes.iter().any(|code| code.value == *value);
    let readings: Vec<Real> = powers.iter().filter(|value| !is_code(value)).copied().collect();
    let shared = shared_values(powers).into_iter().filter(|entry| !is_code(&entry.value)).collect();
    let unit = check_unit(data, &readings);
    lone_value_finding(data, codes).into_iter().chain(unit).chain(shared_finding(data, shared)).collect()
}

/// Returns the finding on lone values; `None` without any.
fn lone_value_finding(data: &Dataset, mut codes: Vec<LoneValue>) -> Option<Finding> {
    codes.sort_by_key(|code| std::cmp::Reverse(code.count));
    let most_frequent = codes.first()?;
    let describe = |code: &LoneValue| {
        let verb = if code.count == 1 { "is" } else { "are" };
        format!("{} {verb} {}, {:.1} dB from the next value", code.count, code.value, code.gap)
    };
    let list: Vec<String> = codes.iter().take(NAMED).map(describe).collect();
    let more = match codes.len().saturating_sub(NAMED) {
        0 => String::new(),
        1 => "; and 1 other value".into(),
        count => format!("; and {count} other values"),
    };
    let (total, example) = (data.len(), name_link(data, most_frequent.first));
    let problem = format!("of {total} received powers, {}{more} (for example {example})", list.join("; "));
    let mend = format!(
        "if they mean that nothing was received, leave these cells empty, or use `--missing {}` of `pwrfgs import --table`",
        most_frequent.value
    );
    let count = codes.iter().map(|code| code.count).sum();
    Some(Finding::new("lone-value", count, problem, mend))
}

/// Finds powers among `observed`, such as those of transmitters to locate, that are far from all powers of `data`: in another
/// unit, or codes. NaN is ignored. `None` without such powers, or if `data` have other observations.
pub fn check_observed(data: &Dataset, observed: &[Real]) -> Option<Finding> {
    let (low, high) = bounds(data.observations.powers()?.iter().map(|dbm| *dbm as f64));
    let outside = |value: &&Real| (**value as f64) < low - FAR_DB || **value as f64 > high + FAR_DB;
    let first = observed.iter().find(outside)?;
    let count = observed.iter().filter(outside).count();
    let [low, high, first] = [low, high, *first as f64].map(format_power);
    let known = format!("the known ones, {low} to {high} dBm");
    let problem = format!("{count} powers are more than {FAR_DB} dB from {known} (for example {first})");
    let units: Vec<String> = PowerUnit::guess(observed).iter().map(|unit| describe_conversion(*unit)).collect();
    Some(match &units[..] {
        [] => {
            Finding::new("lone-value", count, problem, "if they mean that nothing was received, leave them empty (NaN)")
        }
        units => Finding::new("power-unit", count, problem, units.join("; ")),
    })
}

/// Describes the conversion to dBm from a unit.
fn describe_conversion(unit: PowerUnit) -> String {
    let [_, name, formula] = unit.words();
    format!("if these are {name}, {formula}")
}

/// Formats a power with at most three decimals, or below 0.001 with an exponent.
fn format_power(value: f64) -> String {
    if value.abs() < 1e-3 && value != 0.0 { format!("{value:.4e}") } else { format!("{}", (value * 1e3).round() / 1e3) }
}

/// Returns the finding on values that many links share; `None` without any.
fn shared_finding(data: &Dataset, shared: Vec<LoneValue>) -> Option<Finding> {
    let LoneValue { value, count, first, .. } = shared.into_iter().max_by_key(|entry| entry.count)?;
    let problem = format!(
        "{count} of {} received powers are {value} dBm, many more than the next values (for example {})",
        data.len(),
        name_link(data, first)
    );
    let mend =
        format!("if it is a code or the limit of the receiver, use `--missing {value}` of `pwrfgs import --table`");
    Some(Finding::new("shared-power", count, problem, mend))
}

/// Finds powers that are probably not in dBm, and the conversions to dBm; `None` if dBm are plausible. `readings` are the powers
/// without codes.
fn check_unit(data: &Dataset, readings: &[Real]) -> Option<Finding> {
    let units = PowerUnit::guess(readings);
    let first = data.observations.powers()?.iter().position(|value| readings.first() == Some(value))?;
    // Only dBm without their sign rise with the distance.
    let (_, slope) = LevelLinks::of(data).map_or((0.0, 0.0), |links| links.fit_recorded());
    let fits = |unit: &&PowerUnit| slope == 0.0 || (**unit == PowerUnit::PositiveDbm) == (slope > 0.0);
    let may_lack_sign = units.contains(&PowerUnit::PositiveDbm);
    let units = units.iter().filter(|unit| !may_lack_sign || fits(unit));
    let values = || readings.iter().map(|value| *value as f64);
    let ((low, high), middle) = (bounds(values()), median(values()));
    let convert = |unit: &PowerUnit| {
        let option = unit.words()[0];
        let is_linear = matches!(unit, PowerUnit::Milliwatts | PowerUnit::Watts) && middle > 0.0;
        let dbm = unit.dbm(middle).filter(|_| is_linear);
        let result = dbm.map_or_else(String::new, |dbm| format!(", median {dbm:.1} dBm"));
        format!("{} (`--unit {option}` of `pwrfgs import --table`){result}", describe_conversion(*unit))
    };
    let mends: Vec<String> = units.map(convert).collect();
    let [low, high, median] = [low, high, middle].map(format_power);
    let example = name_link(data, first);
    let problem = format!("powers of {low} to {high}, median {median}, are not in dBm (for example {example})");
    (!mends.is_empty()).then(|| Finding::new("power-unit", readings.len(), problem, mends.join("; ")))
}
