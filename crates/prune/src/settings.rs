//! Checks of settings of pruners.

use pwrfgs_core::Real;

/// Rejects a number outside 0 to 1; the error names the `field`.
pub(crate) fn check_share(field: &str, value: Real) -> Result<(), String> {
    if (0.0..=1.0).contains(&value) { Ok(()) } else { Err(format!("`{field}` is {value}; give a number from 0 to 1")) }
}

/// Rejects a number outside 0 to below 1; the error names the `field`.
pub(crate) fn check_below_one(field: &str, value: Real) -> Result<(), String> {
    if (0.0..1.0).contains(&value) {
        return Ok(());
    }
    Err(format!("`{field}` is {value}; give a number from 0 to below 1"))
}

/// Rejects a number that is negative or not finite; the error names the `field`.
pub(crate) fn check_weight(field: &str, value: Real) -> Result<(), String> {
    if value.is_finite() && value >= 0.0 { Ok(()) } else { Err(format!("`{field}` is {value}; give 0 or more")) }
}

/// Rejects a learning rate that is not finite and above 0.
pub(crate) fn check_rate(value: Real) -> Result<(), String> {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(format!("`learning_rate` is {value}; give a positive number, such as 0.01"))
}
