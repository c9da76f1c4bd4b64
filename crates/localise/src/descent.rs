//! Descent to the least value of a function of a position, by quasi-Newton steps (BFGS).

/// Largest number of steps.
const STEPS: usize = 20;
/// Number of lengths of a step that are tried, each half of the one before.
const HALVINGS: usize = 8;
/// Relative decrease below which the descent ends.
const END: f64 = 1e-4;
/// Share of the expected decrease that a step must reach (Armijo).
const ENOUGH: f64 = 1e-4;
/// Curvature along a step below which it may be a rounding error and would spoil the Hessian.
const FLAT: f64 = 1e-12;

/// Returns the position of the least value that the descent from `start` finds, and this value. `scales` are the lengths
/// along the axes over which the function is expected to change, metres; no step is longer. `function` returns value and
/// gradient. `None` if `function` returns `None`, for lack of a gradient.
pub(crate) fn descend(
    start: [f64; 3],
    scales: [f64; 3],
    function: impl Fn([f64; 3]) -> Option<(f64, [f64; 3])>,
) -> Option<([f64; 3], f64)> {
    let position = |u: [f64; 3]| std::array::from_fn(|k| start[k] + scales[k] * u[k]);
    let scaled = |u: [f64; 3]| {
        let (value, gradient) = function(position(u))?;
        Some((value, [0, 1, 2].map(|k| gradient[k] * scales[k])))
    };
    let mut inverse = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut u = [0.0; 3];
    let (mut value, mut gradient) = scaled(u)?;
    for _ in 0..STEPS {
        let mut direction = inverse.map(|row| -dot(row, gradient));
        let mut slope = dot(direction, gradient);
        if slope.is_nan() || slope >= 0.0 {
            // Not downhill: follows the gradient.
            (direction, slope) = (gradient.map(|g| -g), -dot(gradient, gradient));
        }
        let mut share = 1.0 / dot(direction, direction).sqrt().max(1.0);
        let mut accepted = None;
        for _ in 0..HALVINGS {
            let next = [0, 1, 2].map(|k| u[k] + share * direction[k]);
            let (next_value, next_gradient) = scaled(next)?;
            if next_value <= value + ENOUGH * share * slope {
                accepted = Some((next, next_value, next_gradient));
                break;
            }
            share *= 0.5;
        }
        let Some((next, next_value, next_gradient)) = accepted else { break };
        let (step, change) = ([0, 1, 2].map(|k| next[k] - u[k]), [0, 1, 2].map(|k| next_gradient[k] - gradient[k]));
        inverse = bfgs_update(inverse, step, change);
        let decrease = value - next_value;
        (u, value, gradient) = (next, next_value, next_gradient);
        if decrease < END * value.abs() {
            break;
        }
    }
    Some((position(u), value))
}

/// Returns the estimate of the inverse Hessian after a `step` that changed the gradient by `change` (BFGS); `inverse` itself
/// without positive curvature along the step.
fn bfgs_update(inverse: [[f64; 3]; 3], step: [f64; 3], change: [f64; 3]) -> [[f64; 3]; 3] {
    let curvature = dot(step, change);
    if curvature.is_nan() || curvature <= FLAT {
        return inverse;
    }
    let product = inverse.map(|row| dot(row, change));
    let outer = (1.0 + dot(change, product) / curvature) / curvature;
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            inverse[i][j] + outer * step[i] * step[j] - (product[i] * step[j] + step[i] * product[j]) / curvature
        })
    })
}

/// Returns the scalar product.
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descent_finds_the_minimum_of_a_skewed_quadratic() {
        let least = [0.3, -0.2, 1.1];
        let bowl = |x: [f64; 3]| {
            let d = [0, 1, 2].map(|k| x[k] - least[k]);
            let g = [8.0 * d[0] + d[1], d[0] + 2.0 * d[1], 0.5 * d[2]];
            Some((0.5 * dot(d, g), g))
        };
        let (position, value) = descend([0.0; 3], [0.5; 3], bowl).unwrap();
        assert!((0..3).all(|k| (position[k] - least[k]).abs() < 1e-2) && value < 1e-3, "{position:?}: {value}");
        assert!(descend([0.0; 3], [1.0; 3], |_| None).is_none());
    }
}
