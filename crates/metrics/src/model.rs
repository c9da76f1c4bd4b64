//! Metrics of the model: distance from the point cloud, eq. (16), number of Gaussians N, and size in bytes.

use crate::{create_measurement, no_gaussians, not_a_model, single_measurement};
use pwrfgs_core::{Evaluation, Goal, JsonSchema, Measurement, Metric, Real, Result, Scope, Values, neighbours};
use serde::{Deserialize, Serialize};

/// Distance of the Gaussians from the surfaces of the scene: the sum of the two mean squared distances, m².
///
/// Key `chamfer`, eq. (16): from each point to its nearest centre, and from each centre to its nearest point. The paper
/// reports 0.22 with initialisation from the point cloud and 7.51 with random initialisation. Pruning alone increases
/// the first term. `n/a` for baselines and for scenes without a point cloud.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("Chamfer()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Chamfer {}

#[typetag::serde]
impl Metric for Chamfer {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let points = &evaluation.scene.points;
        let values = match evaluation.model {
            None => not_a_model(),
            Some(_) if points.is_empty() => Values::NotApplicable("the scene has no point cloud".to_owned()),
            Some(model) if model.means.is_empty() => no_gaussians(),
            Some(model) => {
                Values::Whole(mean_squared_distance(points, model.means) + mean_squared_distance(model.means, points))
            }
        };
        Ok(single_measurement("chamfer", "m²", Goal::Lower, values))
    }

    fn scope(&self) -> Scope {
        Scope::Model
    }
}

/// Returns the mean squared distance from each of `from` to the nearest of `to`, m².
fn mean_squared_distance(from: &[[Real; 3]], to: &[[Real; 3]]) -> f64 {
    let sum: f64 = neighbours::nearest_squared(from, to).iter().map(|d| *d as f64).sum();
    sum / from.len() as f64
}

/// Number of Gaussians of the model: the horizontal axis of the trade-off in the paper (fig. 2b).
///
/// Key `gaussians`. `n/a` for baselines, and for methods without Gaussians.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("GaussianCount()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct GaussianCount {}

#[typetag::serde]
impl Metric for GaussianCount {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let values = match evaluation.model {
            None => not_a_model(),
            Some(model) if model.means.is_empty() => no_gaussians(),
            Some(model) => Values::Whole(model.means.len() as f64),
        };
        Ok(single_measurement("gaussians", "", Goal::Lower, values))
    }

    fn scope(&self) -> Scope {
        Scope::Model
    }
}

/// Size of the Gaussians in memory, and of the whole model file, bytes.
///
/// Keys `gaussian_bytes` and `model_bytes`. The 100-fold storage reduction of the paper counts only the Gaussians. The
/// size of the deformation network does not depend on N and dominates for small N. `pwrfgs compress` writes smaller
/// files. `n/a` for baselines, which store the measured spectra instead.
///
/// ```
/// # use pwrfgs_metrics as _;
/// # use pwrfgs_core::{Metric, Plugin};
/// Plugin::<dyn Metric>::parse("ModelSize()")?;
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ModelSize {}

#[typetag::serde]
impl Metric for ModelSize {
    fn evaluate(&self, evaluation: &Evaluation<'_>) -> Result<Vec<Measurement>> {
        let size = |key, bytes: Option<usize>| {
            let values = match bytes {
                None => not_a_model(),
                Some(0) => no_gaussians(),
                Some(bytes) => Values::Whole(bytes as f64),
            };
            create_measurement(key, "B", Goal::Lower, values)
        };
        let model = evaluation.model;
        let gaussians = size("gaussian_bytes", model.map(|model| model.gaussian_bytes));
        Ok(vec![gaussians, size("model_bytes", model.map(|model| model.file_bytes))])
    }

    fn scope(&self) -> Scope {
        Scope::Model
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{of_model, scene, value};
    use pwrfgs_core::ModelFacts;

    fn model(means: &[[Real; 3]]) -> ModelFacts<'_> {
        ModelFacts { means, gaussian_bytes: 0, file_bytes: 0 }
    }

    #[test]
    fn chamfer_adds_mean_squared_distances_of_both_directions() {
        let points = [[0.0; 3], [2.0, 0.0, 0.0]];
        let means = [[0.0, 1.0, 0.0]];
        let measured = of_model(&Chamfer {}, Some(model(&means)), &scene(&points));
        // The points are 1 and 5 m² away, the centre 1 m².
        assert!((value(&measured[0]) - (3.0 + 1.0)).abs() < 1e-6);
        let measured = of_model(&Chamfer {}, Some(model(&points)), &scene(&points));
        assert_eq!(value(&measured[0]), 0.0);
    }

    #[test]
    fn chamfer_requires_points_and_gaussians() {
        let points = [[0.0; 3]];
        for (model, points) in [(None, &points[..]), (Some(model(&points)), &[]), (Some(model(&[])), &points)] {
            let measured = of_model(&Chamfer {}, model, &scene(points));
            assert!(matches!(measured[0].values, Values::NotApplicable(_)));
        }
    }

    /// Returns the distance between two sets of points.
    fn between(points: &[[Real; 3]], means: &[[Real; 3]]) -> f64 {
        value(&of_model(&Chamfer {}, Some(model(means)), &scene(points))[0])
    }

    /// Creates `n` × `n` points in a plane perpendicular to z, with a spacing of `spacing` metres.
    fn plane(n: usize, spacing: f64, [x, y, z]: [f64; 3]) -> Vec<[Real; 3]> {
        let at = |i: usize| [x + spacing * (i % n) as f64, y + spacing * (i / n) as f64, z].map(|v| v as Real);
        (0..n * n).map(at).collect()
    }

    #[test]
    fn chamfer_of_parallel_planes_is_twice_squared_distance() {
        let floor = plane(30, 0.1, [0.0; 3]);
        for distance in [0.0, 0.04, 0.5, 2.0] {
            let measured = between(&floor, &plane(30, 0.1, [0.0, 0.0, distance]));
            assert!((measured - 2.0 * distance * distance).abs() < 1e-6, "{distance} m: {measured}");
        }
        // Finely sampled planes need not have equal points: at most a quarter of the cell diagonal is added.
        let measured = between(&floor, &plane(25, 0.12, [0.0, 0.0, 0.5]));
        assert!((0.5..0.5 + 2.0 * 0.12 * 0.12).contains(&measured), "{measured}");
    }

    #[test]
    fn chamfer_of_shifted_plane_depends_on_rim_only() {
        // A shift by two spacings leaves two rows on each side without a counterpart, one and two spacings away.
        let (n, spacing) = (20, 0.1);
        let measured = between(&plane(n, spacing, [0.0; 3]), &plane(n, spacing, [2.0 * spacing, 0.0, 0.0]));
        let expected = 2.0 * (1.0 + 4.0) * spacing * spacing / n as f64;
        assert!((measured - expected).abs() < 1e-7, "{measured} against {expected}");
    }

    #[test]
    fn chamfer_of_concentric_spheres_has_closed_form() {
        // Fibonacci points; the nearest point of the other sphere has the same direction.
        let sphere = |radius: f64| -> Vec<[Real; 3]> {
            let point = |i: usize| {
                let (up, turn) = (1.0 - (2.0 * i as f64 + 1.0) / 500.0, 2.399_963_229_728_653 * i as f64);
                let around = (1.0 - up * up).sqrt();
                [around * turn.cos(), around * turn.sin(), up].map(|v| (radius * v) as Real)
            };
            (0..500).map(point).collect()
        };
        let measured = between(&sphere(2.0), &sphere(2.3));
        assert!((measured - 2.0 * 0.3 * 0.3).abs() < 1e-5, "{measured}");
    }

    #[test]
    fn counts_gaussian_centres() {
        let means = [[0.0; 3]; 5];
        let model = ModelFacts { means: &means, gaussian_bytes: 0, file_bytes: 0 };
        assert_eq!(value(&of_model(&GaussianCount {}, Some(model), &scene(&[]))[0]), 5.0);
        let baseline = of_model(&GaussianCount {}, None, &scene(&[]));
        assert!(matches!(baseline[0].values, Values::NotApplicable(_)));
    }

    #[test]
    fn model_bytes_are_those_of_the_file() {
        let model = ModelFacts { means: &[], gaussian_bytes: 560, file_bytes: 600 };
        let measured = of_model(&ModelSize {}, Some(model), &scene(&[]));
        assert_eq!((measured[0].key.as_str(), value(&measured[0])), ("gaussian_bytes", 560.0));
        assert_eq!((measured[1].key.as_str(), value(&measured[1])), ("model_bytes", 600.0));
        assert!(
            of_model(&ModelSize {}, None, &scene(&[])).iter().all(|m| matches!(m.values, Values::NotApplicable(_)))
        );
    }
}
