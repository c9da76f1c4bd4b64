//! Angle between the strongest predicted and the strongest measured direction.

use crate::{one, per_sample};
use pwrfgs_core::{
    Evaluation, Goal, Image, ImagePlane, JsonSchema, Measurement, Metric, Real, Result, Scope, Task, Values,
};
use serde::{Deserialize, Serialize};

/// Great-circle angle in degrees between the strongest directions of prediction and measurement.
///
/// Key `direction_error`. A distance in pixels would misjudge both the seam in azimuth and the zenith, where many
/// columns are one direction; this does not. The strongest pixel is taken before clamping, the first in row-major order
/// where several are equal. Two equally strong paths make it jump, so look at the median. `n/a` with the released
/// projection, whose pixels mean no angle.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("DirectionError()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DirectionError {}

#[typetag::serde]
impl Metric for DirectionError {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let plane = evaluation.plane;
        let values = if plane.angles.is_some() {
            per_sample(self, evaluation, |p, t| match (strongest(plane, p), strongest(plane, t)) {
                (Some(a), Some(b)) => angle_deg(a, b),
                _ => f64::NAN,
            })?
        } else {
            Values::NotApplicable("a pixel of this projection means no angle".to_owned())
        };
        Ok(one("direction_error", "deg", Goal::Lower, values))
    }

    fn supports(&self, task: Task) -> bool {
        task.has_pixels
    }

    fn scope(&self) -> Scope {
        Scope::Sample
    }
}

/// Unit vector of the strongest pixel.
fn strongest(plane: &ImagePlane, image: &Image) -> Option<[f64; 3]> {
    let (best, width) = (image.argmax(), image.width.max(1));
    let direction = plane.direction((best % width) as Real, (best / width) as Real)?;
    Some(direction.map(|v| v as f64))
}

/// Angle between two unit vectors; exact for small ones, as the arc cosine is not.
fn angle_deg(a: [f64; 3], b: [f64; 3]) -> f64 {
    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    cross.iter().map(|c| c * c).sum::<f64>().sqrt().atan2(dot).to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{of_pictures, of_plane, plane, spots, value};

    fn error(a: (usize, usize), b: (usize, usize)) -> f64 {
        let peak = |(x, y)| spots(360, 90, &[(x, y, 1.0)]);
        value(&of_pictures(&DirectionError {}, &peak(a), &peak(b)))
    }

    #[test]
    fn angles_are_measured_on_the_sphere() {
        let close = |a: f64, b: f64| assert!((a - b).abs() < 2e-4, "{a} instead of {b}");
        close(error((10, 20), (10, 20)), 0.0);
        close(error((359, 0), (1, 0)), 2.0); // across the seam
        close(error((7, 30), (7, 75)), 45.0);
        close(error((0, 89), (180, 89)), 2.0); // over the zenith
        close(error((0, 60), (90, 60)), (0.75f64).acos().to_degrees());
    }

    #[test]
    fn a_plane_without_angles_has_no_direction() {
        let peak = spots(4, 3, &[(1, 1, 1.0)]);
        let blind = ImagePlane { angles: None, ..plane(4, 3) };
        let found = of_plane(&DirectionError {}, &peak, &peak, &blind);
        assert!(matches!(found.values, Values::NotApplicable(_)));
    }
}
