//! Graph of one step: method and loss as ops on the dfdx tape, from the leaves of a cloud to the loss and back.
//!
//! ```text
//! cloud ── pruners.gate ──► M [N] (opacity and scale), existence [N] (weight in blending)
//!   └──── observed_loss: the method makes observations of cloud, gates and Θ ─► loss (+ penalty)
//! ```
//! Gaussians that cannot be visible (closed gate, too faint, or out of view) are excluded from `observed_loss`; their
//! derivatives are zero. If a deformation couples Gaussians, all pass through it and the rasterizer skips the invisible
//! ones.

use crate::loss::Objective;
use crate::plan::TrainingPlan;
use dfdx::prelude::{AsArray, Cpu, Tensor};
use dfdx::tensor_ops::{Backward, SumTo};
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::tape::{Trace, TraceScalar, TracedCloud, op, values};
use pwrfgs_core::{
    Call, CloudStats, Error, Gate, GaussianCloud, LinkInputs, MeasurementSetup, MethodTraits, MethodVjp, Parameters,
    PixelSubset, Pruner, Real, Result, StepContext, WantedInputs, prune_contexts,
};
use pwrfgs_model::Stages;
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;

/// Links of a step and their observations.
#[derive(Clone, Debug, Default)]
pub struct Batch {
    /// Links between transmitters of the batch and receivers, grouped by transmitter, with the network inputs.
    pub inputs: LinkInputs,
    /// Selected values of the observations.
    pub pixels: PixelSubset,
    /// Observations `[L, numbers]`: spectra in [0, 1], powers in dBm, channels.
    pub truths: Vec<Real>,
}

impl Batch {
    /// Splits a batch with one pixel per link into parts of at most `most` links; `None` for other batches, and if no split
    /// is needed.
    fn split(&self, most: usize) -> Option<impl Iterator<Item = Self>> {
        let PixelSubset::Each(pixels) = &self.pixels else { return None };
        let parts = self.inputs.pairs.chunks(most).zip(pixels.chunks(most)).zip(self.truths.chunks(most));
        let part = |((links, pixels), truths): ((&[_], &[usize]), &[Real])| Self {
            inputs: LinkInputs { pairs: links.to_vec(), ..self.inputs.clone() },
            pixels: PixelSubset::Each(pixels.into()),
            truths: truths.to_vec(),
        };
        (pixels.len() > most).then(|| parts.map(part))
    }

    /// Returns the call of a method for these links.
    pub(crate) fn call<'a>(&'a self, setup: &'a MeasurementSetup, parameters: Parameters<'a>) -> Call<'a> {
        Call { setup, parameters, links: &self.inputs, pixels: &self.pixels }
    }
}

/// Loss of a step and its derivatives.
#[derive(Clone, Debug)]
pub struct LossAndGradients {
    /// Loss of the observations; for spectra the rendering loss, eq. (9).
    pub loss: Real,
    /// Sum of the penalties of the pruners, `λ·L_m` of eq. (13).
    pub penalty: Real,
    /// Derivative with respect to every column of the cloud.
    pub d_cloud: GaussianCloud,
    /// Derivative with respect to the network weights.
    pub d_weights: Vec<Real>,
    /// Statistics of each Gaussian in this step.
    pub stats: CloudStats,
}

/// Runs the graph of a batch, or of a part of it, forward and backward.
///
/// # Errors
/// [`Error::NonFinite`] if the loss is not finite.
fn run_graph(
    stages: &Arc<Stages>,
    cloud: &GaussianCloud,
    weights: &Arc<Vec<Real>>,
    batch: &Batch,
    objective: &dyn Objective,
    pruners: &[Plugin<dyn Pruner>],
    context: &StepContext,
) -> Result<LossAndGradients> {
    let traced = TracedCloud::new(cloud);
    let gates = Gates::of(&traced, pruners, context);
    let penalties =
        pruners.iter().zip(prune_contexts(pruners, context)).filter_map(|(p, context)| p.penalty(&traced, &context));
    let penalty = penalties.reduce(|a, b| a + b);
    let stats = Rc::new(RefCell::new(CloudStats::zeros(cloud.len())));
    let d_weights = Rc::new(RefCell::new(vec![0.0; weights.len()]));
    let graph = Graph {
        stages: Arc::clone(stages),
        batch: Arc::new(batch.clone()),
        drawable: Rc::new(DrawableGaussians::of(stages, cloud, &gates)),
        weights: Arc::clone(weights),
        d_weights: Rc::clone(&d_weights),
        stats: Rc::clone(&stats),
    };
    let loss = graph.observed_loss(&traced, gates, objective);
    let value = loss.array();
    let penalty_value = penalty.as_ref().map_or(0.0, AsArray::array);
    if !(value + penalty_value).is_finite() {
        return Err(Error::NonFinite { tensor: "the loss".into(), step: context.step });
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
    let (stats, d_weights) = (stats.take(), d_weights.take());
    Ok(LossAndGradients { loss: value, penalty: penalty_value, d_cloud, d_weights, stats })
}

/// Runs the graph forward and backward, split into parts if the method limits the number of [links at
/// once](pwrfgs_core::Cost::links_at_once); the loss is a mean over links.
///
/// # Errors
/// [`Error::NonFinite`] if the loss is not finite.
pub fn loss_and_gradients(
    stages: &Arc<Stages>,
    cloud: &GaussianCloud,
    weights: &Arc<Vec<Real>>,
    batch: &Batch,
    objective: &dyn Objective,
    pruners: &[Plugin<dyn Pruner>],
    context: &StepContext,
) -> Result<LossAndGradients> {
    let pass = |part: &Batch| run_graph(stages, cloud, weights, part, objective, pruners, context);
    let pixels = batch.pixels.count_per_link(stages.value_count());
    let at_once = stages.method.cost(&stages.setup, batch.inputs.pairs.len(), pixels).links_at_once;
    let Some(parts) = batch.split(at_once) else { return pass(batch) };
    let mut sum = LossAndGradients {
        loss: 0.0,
        penalty: 0.0,
        d_cloud: cloud.zeros_like(),
        d_weights: vec![0.0; weights.len()],
        stats: CloudStats::zeros(cloud.len()),
    };
    for part in parts {
        let (gradients, share) = (pass(&part)?, part.inputs.pairs.len() as Real / batch.inputs.pairs.len() as Real);
        let add_share = |sum: &mut [Real], d: &[Real]| sum.iter_mut().zip(d).for_each(|(sum, d)| *sum += share * d);
        sum.loss += share * gradients.loss;
        sum.penalty = gradients.penalty;
        add_share(&mut sum.d_weights, &gradients.d_weights);
        let columns = sum.d_cloud.columns_mut().zip(gradients.d_cloud.columns());
        columns.for_each(|((_, _, sum), (_, _, d))| add_share(sum, d));
        sum.stats.merge(&gradients.stats);
    }
    Ok(sum)
}

/// Joint factors of all pruners on the Gaussians.
struct Gates {
    whole: Option<Trace>,
    existence: Option<Trace>,
}

impl Gates {
    /// Multiplies the gates of all pruners, separately for each kind of [`Gate`].
    fn of(traced: &TracedCloud, pruners: &[Plugin<dyn Pruner>], context: &StepContext) -> Self {
        let mut gates = Self { whole: None, existence: None };
        let with_contexts = pruners.iter().zip(prune_contexts(pruners, context));
        for gate in with_contexts.filter_map(|(pruner, context)| pruner.gate(traced, &context)) {
            match gate {
                Gate::Whole(factor) => multiply(&mut gates.whole, factor),
                Gate::Existence(factor) => multiply(&mut gates.existence, factor),
            }
        }
        gates
    }
}

/// Multiplies `product` by `factor`; a product of `None` is 1.
fn multiply(product: &mut Option<Trace>, factor: Trace) {
    *product = Some(match product.take() {
        Some(product) => product * factor,
        None => factor,
    });
}

/// Returns the product `[N]` of those gates that allow to skip closed Gaussians; `None` without such a gate.
pub(crate) fn gate_product(cloud: &GaussianCloud, plan: &TrainingPlan, context: &StepContext) -> Option<Vec<Real>> {
    Gates::of(&TracedCloud::new(cloud), &plan.pruners, context).whole.as_ref().map(values)
}

/// Returns whether the gates of this step leave each Gaussian open, `[N]`, also those of existence. `None` without a gate.
pub(crate) fn drawn_mask(cloud: &GaussianCloud, plan: &TrainingPlan, context: &StepContext) -> Option<Vec<bool>> {
    let Gates { whole, existence } = Gates::of(&TracedCloud::new(cloud), &plan.pruners, context);
    // An existence gate is 0 or 1 but for the rounding of its straight-through mask.
    let open_mask = |gate: &Trace, least: Real| values(gate).into_iter().map(|m| m > least).collect::<Vec<_>>();
    let masks = [whole.map(|gate| open_mask(&gate, 0.0)), existence.map(|gate| open_mask(&gate, 0.5))];
    masks.into_iter().flatten().reduce(|a, b| a.into_iter().zip(b).map(|(a, b)| a && b).collect())
}

/// Gaussians that can be visible ([`Stages::drawable`]), as a separate cloud.
struct DrawableGaussians {
    /// Their rows in the whole cloud.
    rows: Vec<usize>,
    cloud: GaussianCloud,
    gate: Option<Vec<Real>>,
    existence: Option<Vec<Real>>,
    /// Number of rows of the whole cloud.
    whole_len: usize,
}

impl DrawableGaussians {
    /// Selects the Gaussians of `cloud` that can be visible, with the values of their gates. Existence gates of a
    /// method that does not support them are multiplied into the other gate.
    fn of(stages: &Stages, cloud: &GaussianCloud, gates: &Gates) -> Self {
        let [mut gate, mut existence] = [&gates.whole, &gates.existence].map(|gate| gate.as_ref().map(values));
        let rows = stages.drawable(cloud, gate.as_deref());
        if !stages.method.traits().supports_existence_gate
            && let Some(existence) = existence.take()
        {
            let gate = gate.get_or_insert_with(|| vec![1.0; cloud.len()]);
            gate.iter_mut().zip(existence).for_each(|(gate, factor)| *gate *= factor);
        }
        let pick = |factors: Vec<Real>| rows.iter().map(|&i| factors[i]).collect();
        let (gate, existence) = (gate.map(pick), existence.map(pick));
        Self { cloud: cloud.select(&rows), rows, gate, existence, whole_len: cloud.len() }
    }

    /// Returns the parameters of these Gaussians, with the weights of the network.
    fn parameters<'a>(&'a self, weights: &'a [Real]) -> Parameters<'a> {
        Parameters { cloud: &self.cloud, gate: self.gate.as_deref(), existence: self.existence.as_deref(), weights }
    }

    /// Returns rows of `width` numbers at their positions in the whole cloud; zeros for all other Gaussians.
    fn scatter(&self, width: usize, values: &[Real]) -> Vec<Real> {
        let mut scattered = vec![0.0; self.whole_len * width];
        for (row, values) in self.rows.iter().zip(values.chunks_exact(width)) {
            scattered[row * width..(row + 1) * width].copy_from_slice(values);
        }
        scattered
    }

    /// Returns the derivatives of the whole cloud by the columns `names` and the gates, in the order of [`Graph::inputs`].
    /// Writes statistics.
    fn scatter_all(&self, names: &[&str], sums: &MethodVjp, stats: &mut CloudStats) -> Vec<Vec<Real>> {
        for ((_, column), (_, drawn)) in stats.columns_mut().into_iter().zip(sums.stats.columns()) {
            *column = self.scatter(1, drawn);
        }
        let column = |name: &&str| sums.cloud.columns().find(|column| column.0 == *name);
        let columns = names.iter().filter_map(column).map(|(_, width, values)| self.scatter(width, values));
        let gate = self.gate.is_some().then(|| self.scatter(1, &sums.gate));
        let existence = self.existence.is_some().then(|| self.scatter(1, &sums.existence));
        columns.chain(gate).chain(existence).collect()
    }
}

/// Method, batch and parameters of a step, and the sums that its backward pass fills.
struct Graph {
    stages: Arc<Stages>,
    batch: Arc<Batch>,
    drawable: Rc<DrawableGaussians>,
    /// Weights Θ and their derivative. They are not on the tape, which would copy each of them several times; only the
    /// method reads the former and writes the latter.
    weights: Arc<Vec<Real>>,
    d_weights: Rc<RefCell<Vec<Real>>>,
    stats: Rc<RefCell<CloudStats>>,
}

impl Graph {
    /// Returns the loss on the tape: one op of columns and gates if the method computes it, otherwise an op for the
    /// observations `[L, numbers]` and [another](Self::loss) for their loss. Fills `d_weights` and `stats`, now or in the
    /// backward pass.
    fn observed_loss(&self, traced: &TracedCloud, gates: Gates, objective: &dyn Objective) -> TraceScalar {
        let (names, inputs) = self.inputs(traced, gates);
        let call = self.batch.call(&self.stages.setup, self.drawable.parameters(&self.weights));
        let is_whole = self.batch.pixels == PixelSubset::All;
        let loss = objective.as_spectrum_loss(&self.batch.truths).filter(|_| is_whole);
        if let Some((value, mut sums)) = loss.and_then(|loss| self.stages.method.loss_vjp(&call, &loss)) {
            *self.d_weights.borrow_mut() = std::mem::take(&mut sums.weights);
            let d_inputs = self.drawable.scatter_all(&names, &sums, &mut self.stats.borrow_mut());
            // The loss is a term of the root of the tape: its cotangent is 1.
            let loss = op(inputs, vec![vec![value]], move |_| d_inputs);
            return loss.into_iter().next().expect("one output").sum();
        }
        let (stages, batch, drawable) = (Arc::clone(&self.stages), Arc::clone(&self.batch), Rc::clone(&self.drawable));
        let (weights, d_weights, stats) =
            (Arc::clone(&self.weights), Rc::clone(&self.d_weights), Rc::clone(&self.stats));
        let mut observed = stages.method.forward(&call, &None);
        let numbers = std::mem::take(&mut observed.numbers);
        let vjp = move |d: Vec<Vec<Real>>| {
            let call = batch.call(&stages.setup, drawable.parameters(&weights));
            let mut sums = MethodVjp::zeros(&call, WantedInputs::default());
            stages.method.vjp(&call, observed, &d[0], &mut sums);
            *d_weights.borrow_mut() = std::mem::take(&mut sums.weights);
            drawable.scatter_all(&names, &sums, &mut stats.borrow_mut())
        };
        self.loss(op(inputs, vec![numbers], vjp).remove(0), objective)
    }

    /// Returns the names of the columns that the method reads, and these columns with the gates.
    fn inputs(&self, traced: &TracedCloud, mut gates: Gates) -> (Vec<&'static str>, Vec<Trace>) {
        // Takes standard columns and those of the method: columns of pruners act through the gate.
        let MethodTraits { columns, supports_existence_gate, .. } = self.stages.method.traits();
        let method_columns = columns.into_iter().map(|(name, _)| name);
        let names: Vec<&str> = pwrfgs_core::COLUMN_NAMES.into_iter().chain(method_columns).collect();
        let columns = names.iter().map(|name| traced.column(name));
        if !supports_existence_gate && let Some(existence) = gates.existence.take() {
            multiply(&mut gates.whole, existence);
        }
        let inputs = columns.chain(gates.whole).chain(gates.existence).collect();
        (names, inputs)
    }

    /// Runs the loss as an op: observations `[L, numbers]` → a scalar.
    fn loss(&self, observed: Trace, objective: &dyn Objective) -> TraceScalar {
        let plane = &self.stages.plane;
        let size = match self.batch.pixels {
            PixelSubset::All => (plane.width, plane.height),
            // Only losses without SSIM receive selected pixels: their shape has no effect.
            _ => (self.batch.truths.len(), 1),
        };
        let (value, d_observed) = objective.evaluate(&observed.as_vec(), &self.batch.truths, size);
        let loss = op(vec![observed], vec![vec![value]], move |d| {
            let upstream = d[0][0];
            vec![d_observed.iter().map(|d| upstream * d).collect()]
        });
        loss.into_iter().next().expect("one output").sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::Link;

    #[test]
    fn batch_parts_cover_batch_in_order() {
        let links: Vec<Link> = (0..20).map(|k| Link { location: k / 3, receiver: 0 }).collect();
        let pixels = PixelSubset::Each((0..20).map(|k| 7 * k % 11).collect());
        let truths = (0..20).map(|k| k as Real).collect();
        let inputs = LinkInputs { values: vec![1.0; 21], width: 3, pairs: links, ..LinkInputs::default() };
        let batch = Batch { inputs, pixels, truths };
        assert!(batch.split(20).is_none() && Batch { pixels: PixelSubset::All, ..batch.clone() }.split(7).is_none());
        let parts: Vec<Batch> = batch.split(7).unwrap().collect();
        assert_eq!(parts.iter().map(|part| part.inputs.pairs.len()).collect::<Vec<_>>(), [7, 7, 6]);
        let pixels = |part: &Batch| match &part.pixels {
            PixelSubset::Each(pixels) => pixels.to_vec(),
            _ => Vec::new(),
        };
        assert_eq!(parts.iter().flat_map(pixels).collect::<Vec<_>>(), pixels(&batch));
        assert_eq!(parts.iter().flat_map(|part| part.inputs.pairs.clone()).collect::<Vec<_>>(), batch.inputs.pairs);
        assert_eq!(parts.iter().flat_map(|part| part.truths.clone()).collect::<Vec<_>>(), batch.truths);
    }
}
