//! Published pruners that score below random removal on s23 at every N, as plugins. `use more_pruners as _;` links them
//! into a program.

mod fast_gs;
mod reduced_3dgs;
#[cfg(test)]
mod tests;

pub use fast_gs::FastGs;
pub use reduced_3dgs::Reduced3dgs;

/// Checks for a number from 0 to 1.
fn check_share(field: &str, value: pwrfgs::core::Real) -> Result<(), String> {
    if (0.0..=1.0).contains(&value) { Ok(()) } else { Err(format!("`{field}` is {value}; give a number from 0 to 1")) }
}
