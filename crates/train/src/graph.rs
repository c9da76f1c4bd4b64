//! One step's graph: the stages as ops on the dfdx tape, from the leaves of a cloud to the loss, and back.
//!
//! ```text
//! cloud ── pruners.gate ──► M [N]
//!   │  means, p_tx ─► deform ─► ΔS, ΔR, Δs
//!   └──── draw: activate(cloud, Δ, M) ─► project ─► rasterize ─► read out ─► P̂ ─► loss (+ penalty)
//! ```
//! Gaussians that cannot show, because their gate is 0, or they are too faint or out of sight, are left out of `deform`
//! and `draw`: they have no derivative either. A deformation that couples Gaussians is the exception: all go through,
//! and the rasterizer skips those that do not show.

use crate::loss::RenderingLoss;
use dfdx::prelude::{AsArray, Cpu, Tensor};
use dfdx::tensor_ops::{Backward, SumTo};
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::tape::{Trace, TraceScalar, Traced, op, values};
use pwrfgs_core::{CloudStats, DeformationInputs, Deltas, Error, GaussianCloud, Moment, Pruner, Real, Result};
use pwrfgs_model::{ActivationVjp, Calibration, Drawing, Stages};
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;

/// Transmitters of a step and what was measured for them.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Positions `[B,3]`, metres.
    pub txs: Vec<[Real; 3]>,
    /// Spectra `[B, H·W]` in [0, 1].
    pub truths: Vec<Real>,
}

/// Loss of a step and its derivatives.
#[derive(Clone, Debug)]
pub struct LossAndGradients {
    /// Rendering loss, eq. (9).
    pub loss: Real,
    /// Sum of the pruners' penalties, the `λ·L_m` of eq. (13).
    pub penalty: Real,
    /// Derivative in every column of the cloud.
    pub d_cloud: GaussianCloud,
    /// Derivative in the network.
    pub d_weights: Vec<Real>,
    /// What was seen of each Gaussian in this step.
    pub seen: CloudStats,
}

/// Runs the graph forward and backward.
///
/// # Errors
/// [`Error::NonFinite`] where the loss is not a number.
pub fn loss_and_gradients(
    stages: &Arc<Stages>,
    cloud: &GaussianCloud,
    weights: &Arc<Vec<Real>>,
    batch: &Batch,
    objective: &RenderingLoss,
    pruners: &[Plugin<dyn Pruner>],
    moment: &Moment,
) -> Result<LossAndGradients> {
    let traced = Traced::new(cloud);
    let gate = pruners.iter().filter_map(|p| p.gate(&traced, moment)).reduce(|a, b| a * b);
    let penalty = pruners.iter().filter_map(|p| p.penalty(&traced, moment)).reduce(|a, b| a + b);
    let seen = Rc::new(RefCell::new(CloudStats::zeros(cloud.len())));
    let d_weights = Rc::new(RefCell::new(vec![0.0; weights.len()]));
    let graph = Graph {
        stages: Arc::clone(stages),
        txs: Arc::new(batch.txs.clone()),
        open: Rc::new(Open::of(stages, cloud, gate.as_ref())),
        weights: Arc::clone(weights),
        d_weights: Rc::clone(&d_weights),
        seen: Rc::clone(&seen),
    };

    let deltas = graph.deform(&traced);
    let image = graph.picture(&traced, gate, deltas);
    let loss = graph.loss(image, &batch.truths, objective);

    let value = loss.array();
    let penalty_value = penalty.as_ref().map_or(0.0, AsArray::array);
    if !(value + penalty_value).is_finite() {
        return Err(Error::NonFinite { what: "the loss".into(), step: moment.step });
    }
    let total = match penalty {
        Some(penalty) => loss + penalty,
        None => loss,
    };
    let mut gradients = total.backward();
    let mut read = |leaf: &Tensor<(usize,), Real, Cpu>| {
        gradients.get_or_alloc_mut(leaf).map(|g| g.to_vec()).expect("host memory holds one more column")
    };
    let mut d_cloud = cloud.zeros_like();
    for (name, _, values) in d_cloud.columns_mut() {
        values.copy_from_slice(&read(traced.leaf(name)));
    }
    let (seen, d_weights) = (seen.take(), d_weights.take());
    Ok(LossAndGradients { loss: value, penalty: penalty_value, d_cloud, d_weights, seen })
}

/// The Gaussians that can be drawn ([`Stages::drawable`]), as a cloud of their own.
struct Open {
    /// Their rows in the whole cloud.
    rows: Vec<usize>,
    cloud: GaussianCloud,
    gate: Option<Vec<Real>>,
    /// Rows of the whole cloud.
    all: usize,
}

impl Open {
    fn of(stages: &Stages, cloud: &GaussianCloud, gate: Option<&Trace>) -> Self {
        let gate = gate.map(values);
        let rows = stages.drawable(cloud, gate.as_deref());
        let gate = gate.map(|g| rows.iter().map(|&i| g[i]).collect());
        Self { cloud: cloud.select(&rows), rows, gate, all: cloud.len() }
    }

    /// Rows of `width` numbers, put back where they belong in the whole cloud.
    fn scatter(&self, width: usize, values: &[Real]) -> Vec<Real> {
        let mut all = vec![0.0; self.all * width];
        for (row, values) in self.rows.iter().zip(values.chunks_exact(width)) {
            all[row * width..(row + 1) * width].copy_from_slice(values);
        }
        all
    }
}

struct Graph {
    stages: Arc<Stages>,
    txs: Arc<Vec<[Real; 3]>>,
    open: Rc<Open>,
    /// Θ, and its derivative. They are not on the tape, which would copy each of them several times: nothing but the
    /// network reads the one and writes the other.
    weights: Arc<Vec<Real>>,
    d_weights: Rc<RefCell<Vec<Real>>>,
    seen: Rc<RefCell<CloudStats>>,
}

/// Calibration terms: their values, and the ones that are on the tape.
struct TracedDeltas {
    values: Rc<Deltas>,
    traces: Vec<Trace>,
}

impl Graph {
    /// The deformation network as an op: means (and Θ, beside the tape) → the terms that it gives.
    fn deform(&self, traced: &Traced) -> TracedDeltas {
        let Stages { deformation, pose, .. } = &*self.stages;
        let values = Rc::new(deformation.forward(&self.weights, &self.open.cloud.means, &self.txs, pose));
        let outputs: Vec<Vec<Real>> = values.to_columns().collect();
        if outputs.is_empty() {
            return TracedDeltas { values, traces: Vec::new() };
        }
        let (stages, txs, open, shape) =
            (Arc::clone(&self.stages), Arc::clone(&self.txs), Rc::clone(&self.open), Rc::clone(&values));
        let (theta, d_weights) = (Arc::clone(&self.weights), Rc::clone(&self.d_weights));
        let traces = op(vec![traced.column("means")], outputs, move |d| {
            let d = shape.from_columns(d);
            let mut d_means = vec![[0.0; 3]; open.rows.len()];
            let inputs = DeformationInputs { weights: &theta, means: &open.cloud.means, txs: &txs, pose: &stages.pose };
            stages.deformation.vjp(&inputs, &d, &mut d_weights.borrow_mut(), Some(&mut d_means));
            vec![open.scatter(3, d_means.as_flattened())]
        });
        TracedDeltas { values, traces }
    }

    /// P̂ `[B, H·W]`: one drawing for all transmitters where they share geometry, else one each.
    fn picture(&self, traced: &Traced, gate: Option<Trace>, deltas: TracedDeltas) -> Trace {
        let batch = self.txs.len();
        let shared = if self.stages.deformation.varies_geometry() { 1 } else { batch };
        let groups = (0..batch).step_by(shared).map(|b| b..b + shared);
        let inputs: Vec<Trace> = (pwrfgs_core::COLUMN_NAMES.iter().map(|name| traced.column(name)))
            .chain(gate)
            .chain(deltas.traces)
            .collect();
        let Stages { readout, plane, .. } = &*self.stages;
        let (cloud, gate) = (&self.open.cloud, self.open.gate.as_deref());
        let drawings: Vec<Drawing> =
            groups.map(|group| self.stages.draw(cloud, &deltas.values, group, gate, None)).collect();
        let pixels = plane.width * plane.height;
        let mut blended = drawings.iter().map(|d| d.render.pixels.as_slice()).collect::<Vec<_>>().concat();
        if self.stages.calibration == Calibration::AsReleased {
            blended.iter_mut().for_each(|p| *p = p.clamp(0.0, 1.0));
        }
        let image = readout.forward(&blended, pixels);

        let (stages, open, seen, values) =
            (Arc::clone(&self.stages), Rc::clone(&self.open), Rc::clone(&self.seen), deltas.values);
        let vjp = move |mut d: Vec<Vec<Real>>| {
            let mut d_blended = stages.readout.vjp(&blended, pixels, &d.remove(0));
            let mut sums = ActivationVjp::zeros(&open.cloud, &values);
            let (gate, count) = (open.gate.as_deref(), drawings.len());
            let mut rest = d_blended.as_mut_slice();
            for drawing in drawings {
                let (own, tail) = rest.split_at_mut(drawing.render.pixels.len());
                rest = tail;
                if stages.calibration == Calibration::AsReleased {
                    // The clamp to [0, 1] passes the derivative on the closed interval only.
                    let inside = |p: &Real| (0.0..=1.0).contains(p);
                    own.iter_mut().zip(&drawing.render.pixels).filter(|(_, p)| !inside(p)).for_each(|(d, _)| *d = 0.0);
                }
                let d = stages.draw_vjp(&drawing, &open.cloud, &values, gate, own, &mut sums);
                seen.borrow_mut().observe(&open.rows, &drawing.geometry.splats, &d, &stages.plane, count);
            }
            let columns = sums.cloud.columns().take(5).map(|(_, width, values)| open.scatter(width, values));
            let gate = gate.is_some().then(|| open.scatter(1, &sums.gate));
            columns.chain(gate).chain(sums.deltas.to_columns()).collect()
        };
        op(inputs, vec![image], vjp).remove(0)
    }

    /// The rendering loss as an op.
    fn loss(&self, image: Trace, truths: &[Real], objective: &RenderingLoss) -> TraceScalar {
        let plane = &self.stages.plane;
        let (value, d_image) = objective.evaluate(&image.as_vec(), truths, (plane.width, plane.height));
        let loss = op(vec![image], vec![vec![value]], move |d| {
            let upstream = d[0][0];
            vec![d_image.iter().map(|d| upstream * d).collect()]
        });
        loss.into_iter().next().expect("one output").sum()
    }
}
