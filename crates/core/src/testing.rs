//! Checks that every differentiable piece owes: central differences against the hand-written derivative.

use crate::{Real, rng};

/// Asserts that `vjp` is the derivative of `f` at `x`: for a random cotangent d, ∂⟨d, f(x)⟩/∂xₖ by central differences
/// with step `h` agrees with `vjp(x, d)ₖ` to `tolerance`, relative to the larger of the two and of 1 % of the largest
/// component. Call it in the f64 build: in single precision differences say little.
pub fn check_vjp(
    name: &str,
    x: &[Real],
    f: impl Fn(&[Real]) -> Vec<Real>,
    vjp: impl Fn(&[Real], &[Real]) -> Vec<Real>,
    h: Real,
    tolerance: Real,
) {
    let mut random = rng::stream(0, name, 0);
    let d: Vec<Real> = (0..f(x).len()).map(|_| rng::normal(&mut random)).collect();
    let analytic = vjp(x, &d);
    assert_eq!(analytic.len(), x.len(), "{name}: one derivative an input");
    let along = |x: &[Real]| -> Real { f(x).iter().zip(&d).map(|(f, d)| f * d).sum() };
    let largest = analytic.iter().fold(0.0, |m: Real, g| m.max(g.abs()));
    for k in 0..x.len() {
        let (mut up, mut down) = (x.to_vec(), x.to_vec());
        up[k] += h;
        down[k] -= h;
        let numeric = (along(&up) - along(&down)) / (2.0 * h);
        let scale = numeric.abs().max(analytic[k].abs()).max(0.01 * largest).max(1e-12);
        assert!(
            (numeric - analytic[k]).abs() <= tolerance * scale,
            "{name}: input {k}: central difference {numeric}, derivative {}",
            analytic[k]
        );
    }
}
