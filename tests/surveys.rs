//! Statistics of Gaussians against brute force: weights from the channel of each Gaussian alone, derivatives by central
//! differences; and existence gates, whose closed Gaussians have a derivative.

use crate::common::{MOMENT, batch, cloud, plugin, stages, with_column};
use pwrfgs::core::testing::check_vjp;
use pwrfgs::core::{
    Call, ColumnSpec, DeformationInputs, ImagePlane, MeasurementSetup, Parameters, PassStatistics, PixelSubset,
    Receiver, Statistic, Task, rng,
};
use pwrfgs::methods::{Readout, Splatting};
use pwrfgs::model::Stages;
use pwrfgs::prelude::*;
use pwrfgs::train::{Batch, RenderingLoss, loss_and_gradients};
use std::sync::Arc;

const DOUBLE: bool = size_of::<Real>() == 8;
const N: usize = 5;
const EVERYTHING: [Statistic; 8] = [
    Statistic::Weight,
    Statistic::LargestWeight,
    Statistic::WeightPerArea,
    Statistic::SignalWeight,
    Statistic::Error { high: 0.3 },
    Statistic::Top { count: 2 },
    Statistic::Sensitivity,
    Statistic::Fisher,
];

/// Some Gaussians, transmitters, and what was measured of these.
struct Sight {
    stages: Arc<Stages>,
    cloud: GaussianCloud,
    weights: Vec<Real>,
    batch: Batch,
}

impl Sight {
    fn new(deformation: &str, readout: Readout) -> Self {
        let stages = stages(deformation, readout);
        let weights = stages.layout().init(&mut rng::stream(4, "network", 0));
        let batch = batch(2, &stages);
        Self { stages, cloud: cloud(N, 8), weights, batch }
    }

    fn survey(&self, statistics: &[Statistic]) -> PassStatistics {
        let needs = Needs::of(statistics, 0);
        let mut found = self.stages.method.survey(&self.call(self.parameters()), &self.batch.truths, &needs);
        found.finish_means();
        found
    }

    fn parameters(&self) -> Parameters<'_> {
        Parameters { cloud: &self.cloud, gate: None, existence: None, weights: &self.weights }
    }

    fn call<'a>(&'a self, parameters: Parameters<'a>) -> Call<'a> {
        Call { setup: &self.stages.setup, parameters, links: &self.batch.inputs, pixels: &PixelSubset::All }
    }

    /// Observations with a factor on each Gaussian's part, links one after another.
    fn observed(&self, cloud: &GaussianCloud, existence: &[Real]) -> Vec<Real> {
        let parameters = Parameters { cloud, existence: Some(existence), ..self.parameters() };
        self.stages.method.forward(&self.call(parameters), &None).numbers
    }

    fn deltas(&self, splatting: &Splatting) -> Deltas {
        let conditions = self.batch.inputs.conditions();
        let pose = self.stages.setup.pose();
        splatting
            .deformation
            .forward(&DeformationInputs::new(&self.weights, &self.cloud.means, conditions, &pose), &None)
    }

    /// Blending weights of each Gaussian, `[N][pixels]`, of link `b`: each draws a channel of its own.
    fn one_hot(&self, b: usize) -> Vec<Vec<Real>> {
        let splatting = self.stages.settings::<Splatting>().unwrap();
        let view = &splatting.views(&self.stages.setup)[0];
        let deltas = self.deltas(splatting);
        let splats = splatting.geometry(view, &self.parameters(), &deltas, b).splats;
        let signals: Vec<Real> = (0..N * N).map(|k| Real::from(u8::from(k / N == k % N))).collect();
        let pixels = splatting.rasterizer.forward(splats.with_signals(&signals, N, &view.plane)).pixels;
        pixels.chunks_exact(view.plane.width * view.plane.height).map(<[Real]>::to_vec).collect()
    }

    /// ‖s‖ of each Gaussian for link `b`.
    fn strengths(&self, b: usize) -> Vec<Real> {
        let splatting = self.stages.settings::<Splatting>().unwrap();
        let deltas = self.deltas(splatting);
        let signals = splatting.activation().signals(&self.cloud, &deltas, b..b + 1);
        signals.chunks_exact(2).map(|s| s[0].hypot(s[1])).collect()
    }
}

fn near(found: &[Real], expected: &[Real], what: &str) {
    let tolerance = if DOUBLE { 1e-9 } else { 1e-4 };
    let largest = expected.iter().fold(0.0, |m: Real, v| m.max(v.abs()));
    assert!(largest > 0.0, "{what}: the test sees something");
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= tolerance * largest, "{what} of {i}: {a} is not {b}");
    }
    assert_eq!(found.len(), expected.len(), "{what}");
}

#[test]
fn survey_statistics_equal_single_image_statistics() {
    // A geometry for all transmitters, and one for each.
    let deformations =
        ["Factored(width: 12, depth: 2)", "Mlp(depth: 2, width: 8, skip: None, tx_hidden: 8, tx_features: 4)"];
    for deformation in deformations {
        let sight = Sight::new(deformation, Readout::Magnitude);
        let pixels = sight.stages.value_count();
        let found = sight.survey(&EVERYTHING);
        let mut expected = PassStatistics::zeros(&Needs::of(&EVERYTHING, 0), N);
        let made = sight.observed(&sight.cloud, &[1.0; N]);
        for b in 0..2 {
            let (weights, strengths) = (sight.one_hot(b), sight.strengths(b));
            let truth = &sight.batch.truths[b * pixels..][..pixels];
            let errors: Vec<Real> = made[b * pixels..].iter().zip(truth).map(|(a, b)| (a - b).abs()).collect();
            let low = errors.iter().copied().fold(Real::INFINITY, Real::min);
            let most = errors.iter().copied().fold(0.0, Real::max);
            let mean = errors.iter().sum::<Real>() / pixels as Real;
            for i in 0..N {
                let own = &weights[i];
                let (sum, area) = (own.iter().sum::<Real>(), own.iter().filter(|w| **w > 0.0).count());
                expected.weight[i] += sum;
                expected.largest_weight[i] = own.iter().copied().fold(expected.largest_weight[i], Real::max);
                expected.weight_per_area[i] += sum / area.max(1) as Real;
                expected.signal_mean[i] += sum * strengths[i] / 2.0;
                expected.signal_max[i] = expected.signal_max[i].max(sum * strengths[i]);
                expected.error[i] += own.iter().zip(&errors).map(|(w, e)| w * e).sum::<Real>();
                let high = |p: &usize| own[*p] > 0.0 && errors[*p] > low + 0.3 * (most - low);
                expected.high_error[i] += mean * (0..pixels).filter(high).count() as Real;
            }
            for p in 0..pixels {
                let value = |i: usize| (-(strengths[i] - truth[p]).abs()).exp() * weights[i][p];
                let mut order: Vec<usize> = (0..N).filter(|&i| weights[i][p] > 0.0).collect();
                order.sort_by(|&i, &j| value(j).total_cmp(&value(i)));
                order.into_iter().take(2).for_each(|i| expected.top[i] = true);
            }
        }
        assert_eq!(found.links, 2);
        near(&found.weight, &expected.weight, "weight");
        near(&found.largest_weight, &expected.largest_weight, "largest weight");
        near(&found.weight_per_area, &expected.weight_per_area, "weight per area");
        near(&found.signal_mean, &expected.signal_mean, "mean signal");
        near(&found.signal_max, &expected.signal_max, "largest signal");
        near(&found.error, &expected.error, "error");
        near(&found.high_error, &expected.high_error, "high error");
        assert_eq!(found.top, expected.top, "{deformation}");
        // Where only weights are asked for, all transmitters of a geometry are weighed at once.
        let few = sight.survey(&EVERYTHING[..4]);
        near(&few.weight, &expected.weight, "weight alone");
        near(&few.weight_per_area, &expected.weight_per_area, "weight per area alone");
        near(&few.signal_mean, &expected.signal_mean, "mean signal alone");
        near(&few.signal_max, &expected.signal_max, "largest signal alone");
        assert!(few.sensitivity.is_empty() && few.fisher.is_empty(), "nothing is computed that nobody asked for");
    }
}

/// Σ over numbers of the products of central differences by each of `count` inputs.
fn products(observe: impl Fn(usize, Real) -> Vec<Real>, count: usize) -> Vec<Vec<Real>> {
    const H: Real = 1e-6;
    let slope = |k: usize| -> Vec<Real> {
        observe(k, H).iter().zip(observe(k, -H)).map(|(up, down)| (up - down) / (2.0 * H)).collect()
    };
    let slopes: Vec<Vec<Real>> = (0..count).map(slope).collect();
    let dot = |a: &[Real], b: &[Real]| a.iter().zip(b).map(|(a, b)| a * b).sum();
    slopes.iter().map(|a| slopes.iter().map(|b| dot(a, b)).collect()).collect()
}

/// As [`near`], to what differences can tell.
fn close(found: &[Real], expected: &[Real], what: &str) {
    let largest = expected.iter().fold(0.0, |m: Real, v| m.max(v.abs()));
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= 1e-5 * largest, "{what} of {i}: {a} is not {b}");
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn sensitivity_and_fisher_agree_with_central_differences() {
    for readout in [Readout::Magnitude, Readout::Power, Readout::ReceivedPower { sky_deg: 15, filter_deg2: 67.5 }] {
        let is_power = readout.task() == Task::Power;
        let mut sight = Sight::new("Fixed()", if is_power { Readout::Magnitude } else { readout });
        if is_power {
            let mut stages = sight.stages.with(|splatting: &mut Splatting| splatting.readout = readout);
            let receivers = vec![Receiver::new("a", stages.setup.receivers[0].pose)];
            let plane = ImagePlane::plain(1, 1);
            stages.setup = MeasurementSetup { task: Task::Power, plane, receivers, ..stages.setup.clone() };
            sight.weights = stages.layout().init(&mut rng::stream(4, "network", 0));
            sight.stages = Arc::new(stages);
            sight.batch.truths.truncate(2);
        }
        let found = sight.survey(&[Statistic::Sensitivity, Statistic::Fisher]);
        let mut sensitivity = Vec::new();
        for i in 0..N {
            let of_presence = |_: usize, h: Real| {
                let mut existence = vec![1.0; N];
                existence[i] += h;
                sight.observed(&sight.cloud, &existence)
            };
            sensitivity.push(products(of_presence, 1)[0][0]);
            let of_shape = |k: usize, h: Real| {
                let mut cloud = sight.cloud.clone();
                if k < 3 {
                    cloud.means[i][k] += h;
                } else {
                    cloud.log_scales[i][k - 3] += h;
                }
                sight.observed(&cloud, &[1.0; N])
            };
            let full = products(of_shape, 6);
            let triangle: Vec<Real> = (0..6).flat_map(|a| full[a][a..].to_vec()).collect();
            close(&found.fisher[i], &triangle, "fisher");
        }
        close(&found.sensitivity, &sensitivity, "sensitivity");
    }
}

/// A gate of presence that is a column itself.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
struct There {}

#[typetag::serde]
impl Pruner for There {
    fn traits(&self) -> PrunerTraits {
        PrunerTraits { columns: vec![ColumnSpec::learned("there", 1.0, 0.01)], ..PrunerTraits::default() }
    }
    fn gate(&self, cloud: &TracedCloud, _: &StepContext) -> Option<Gate> {
        Some(Gate::Existence(cloud.column("there")))
    }
}

fn present(sight: &Sight, existence: &[Real]) -> pwrfgs::train::LossAndGradients {
    let cloud = with_column(sight.cloud.clone(), "there", existence.to_vec());
    let weights = Arc::new(sight.weights.clone());
    let pruners = [plugin("There()")];
    loss_and_gradients(&sight.stages, &cloud, &weights, &sight.batch, &RenderingLoss::new(0.3), &pruners, &MOMENT)
        .unwrap()
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn absent_gaussian_has_existence_derivative() {
    for rasterizer in ["AlphaBlending()", "ArrayResponse()"] {
        let mut sight = Sight::new("Factored(width: 12, depth: 2)", Readout::Magnitude);
        sight.stages =
            Arc::new(sight.stages.with(|splatting: &mut Splatting| splatting.rasterizer = plugin(rasterizer)));
        derivatives_of_presence(&sight);
    }
}

fn derivatives_of_presence(sight: &Sight) {
    // Gone, half there, and whole; the others' derivatives too.
    let existence = [0.0, 0.5, 1.0, 0.0, 0.8];
    let loss = |x: &[Real]| vec![present(sight, x).loss];
    let vjp = |x: &[Real], d: &[Real]| {
        let found = present(sight, x);
        found.d_cloud.extra("there").unwrap().values.iter().map(|v| v * d[0]).collect()
    };
    check_vjp("presence", &existence, loss, vjp, 1e-6, 1e-5);
    let found = present(sight, &existence);
    assert!(found.d_cloud.extra("there").unwrap().values[0] != 0.0);
    assert_eq!(found.d_cloud.opacity_logits[0], 0.0, "what takes no light has no other derivative");
    for name in ["means", "log_scales", "opacity_logits"] {
        let columns = |cloud: &GaussianCloud| cloud.columns().find(|c| c.0 == name).unwrap().2.to_vec();
        let with = |x: &[Real]| {
            let mut other = Sight {
                cloud: sight.cloud.clone(),
                stages: Arc::clone(&sight.stages),
                weights: sight.weights.clone(),
                batch: sight.batch.clone(),
            };
            other.cloud.columns_mut().find(|c| c.0 == name).unwrap().2.copy_from_slice(x);
            present(&other, &existence)
        };
        check_vjp(
            name,
            &columns(&sight.cloud),
            |x| vec![with(x).loss],
            |x, d| columns(&with(x).d_cloud).iter().map(|v| v * d[0]).collect(),
            1e-6,
            1e-4,
        );
    }
}

#[test]
fn absent_gaussians_do_not_change_image() {
    let sight = Sight::new("Factored(width: 12, depth: 2)", Readout::Magnitude);
    let rows = [0, 2, 4];
    let few = Sight {
        cloud: sight.cloud.select(&rows),
        stages: Arc::clone(&sight.stages),
        weights: sight.weights.clone(),
        batch: sight.batch.clone(),
    };
    let whole = sight.observed(&sight.cloud, &[1.0, 0.0, 1.0, 0.0, 1.0]);
    let others = few.observed(&few.cloud, &[1.0; 3]);
    assert!(whole == others);
}
