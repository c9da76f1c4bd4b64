//! Correlation of a plan, and where its length scale comes from.

use pwrfgs_core::kriging::Correlation;
use pwrfgs_core::{Dataset, Error, Result};
use pwrfgs_planning::{default_correlation, learn_correlation, longest_length};

/// Returns the correlation of the first step: of `length`, the value of `--length-scale`, else learned from the known
/// measurements `measured`, else the default of the region. An invalid length is an error.
pub(super) fn first_correlation(
    length: Option<f64>,
    measured: Option<&Dataset>,
    region: &[[f64; 3]],
) -> Result<Correlation> {
    let default = default_correlation(region);
    if let Some(length) = length {
        if !(1e-6..=1e8).contains(&length) {
            return Err(Error::Config(format!("--length-scale {length}: expected metres, more than 0, such as 0.5")));
        }
        return Ok(Correlation { scales: [length, length, length, f64::INFINITY], ..default });
    }
    let learned = measured.and_then(|data| learn_correlation(data, &all_transmitters(data)));
    Ok(learned.unwrap_or(default))
}

/// Lists all transmitters of `data`.
fn all_transmitters(data: &Dataset) -> Vec<usize> {
    (0..data.locations.len()).collect()
}

/// Describes where a length scale comes from that measurements do not determine; otherwise empty. `default` is the correlation
/// without measurements, `learned` lists the transmitters of a simulated survey that the
/// correlation was learned from, without which all measurements were.
pub(super) fn describe_length(
    data: Option<&Dataset>,
    [correlation, default]: [&Correlation; 2],
    learned: &[usize],
) -> &'static str {
    if correlation == default {
        return " (assumed: a fifth of the diagonal of the region)";
    }
    let learned = |data| if learned.is_empty() { all_transmitters(data) } else { learned.to_vec() };
    let is_longest = data.is_some_and(|data| correlation.scales[0] >= longest_length(data, &learned(data)));
    if is_longest { " (the longest tried: the measurements do not determine it)" } else { "" }
}
