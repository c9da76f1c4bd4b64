//! `Layout`: the weights of a network in one flat vector.

use crate::{Real, rng, rng::Rng};
use std::ops::Range;

/// Tensors of a network: learned ones, in the order of the flat weight vector, and constants.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layout {
    /// Learned tensors.
    pub weights: Vec<WeightSpec>,
    /// Constant tensors that follow from a seed in the settings, with their values. The model file stores them, because
    /// other programs cannot reproduce them.
    pub constants: Vec<(WeightSpec, Vec<Real>)>,
}

impl Layout {
    /// Returns the length of the flat weight vector.
    pub fn weight_count(&self) -> usize {
        self.weights.iter().map(WeightSpec::len).sum()
    }

    /// Returns the ranges of the flat weight vector that [learn](WeightSpec::learns). Adjacent tensors share a range
    /// unless their weight decay differs.
    pub fn groups(&self) -> Vec<WeightGroup> {
        let (mut groups, mut start): (Vec<WeightGroup>, usize) = (Vec::new(), 0);
        for spec in &self.weights {
            let range = start..start + spec.len();
            start = range.end;
            match groups.last_mut() {
                _ if !spec.learns => {}
                Some(last) if (last.range.end, last.decays) == (range.start, spec.decays) => last.range.end = range.end,
                _ => groups.push(WeightGroup { range, decays: spec.decays }),
            }
        }
        groups
    }

    /// Draws the flat weight vector: uniform within the bound of each tensor, or zeros.
    pub fn init(&self, rng: &mut Rng) -> Vec<Real> {
        let mut flat = Vec::with_capacity(self.weight_count());
        for spec in &self.weights {
            match spec.bound {
                Some(bound) => flat.extend((0..spec.len()).map(|_| (2.0 * rng::uniform(rng) - 1.0) * bound as Real)),
                None => flat.resize(flat.len() + spec.len(), 0.0),
            }
        }
        flat
    }

    /// Draws dropout factors, one per number of the flat weight vector: a hidden unit gets 0 with probability `rate`
    /// (below 1), and 1/(1 − rate) otherwise; all other weights get 1. All transmitters of a step share the draw.
    /// `None` if no layer is [hidden](WeightSpec::hidden).
    pub fn draw_dropout(&self, rate: Real, rng: &mut Rng) -> Option<Vec<Real>> {
        if !self.weights.iter().any(|spec| spec.hidden) {
            return None;
        }
        let (mut factors, mut units) = (Vec::with_capacity(self.weight_count()), Vec::new());
        for spec in &self.weights {
            if !spec.hidden {
                factors.resize(factors.len() + spec.len(), 1.0);
                continue;
            }
            // A bias, with one axis, shares the draws of its weight, which precedes it.
            if spec.shape.len() > 1 {
                let factor = |_| if rng::uniform(rng) < rate { 0.0 } else { 1.0 / (1.0 - rate) };
                units = (0..spec.shape[0]).map(factor).collect();
            }
            let weights_per_unit = spec.len() / units.len().max(1);
            factors.extend(units.iter().flat_map(|factor| std::iter::repeat_n(*factor, weights_per_unit)));
        }
        Some(factors)
    }
}

/// Learned weights that the optimiser treats alike.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WeightGroup {
    /// Range of the flat weight vector.
    pub range: Range<usize>,
    /// Whether weight decay applies.
    pub decays: bool,
}

/// Name, shape and initial values of a tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct WeightSpec {
    /// Name, such as `trunk.0.weight`.
    pub name: String,
    /// Shape, row-major; the weight of a linear layer is `[out, in]`.
    pub shape: Vec<usize>,
    /// Bound of the uniform initial values; `None` for zeros.
    pub bound: Option<f64>,
    /// Whether its rows are hidden units before a ReLU, to which [`Layout::draw_dropout`] may apply. The bias of such a
    /// layer follows its weight directly.
    pub hidden: bool,
    /// Whether it learns; otherwise its values follow from the training set.
    pub learns: bool,
    /// Whether weight decay applies: not to offsets of receivers, whose values are physical.
    pub decays: bool,
}

impl WeightSpec {
    /// Creates a tensor with initial values of zero.
    pub fn zeros(name: impl Into<String>, shape: Vec<usize>) -> Self {
        Self { name: name.into(), shape, bound: None, hidden: false, learns: true, decays: true }
    }

    /// Creates a tensor with initial values uniform within ±`bound`.
    pub fn uniform(name: impl Into<String>, shape: Vec<usize>, bound: f64) -> Self {
        Self { bound: Some(bound), ..Self::zeros(name, shape) }
    }

    /// Returns the number of values.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Returns whether it has no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropout_zeroes_whole_hidden_units_only() {
        let hidden = |name: &str, shape| WeightSpec { hidden: true, ..WeightSpec::uniform(name, shape, 1.0) };
        let weights = vec![
            WeightSpec::zeros("other", vec![3]),
            hidden("layer.weight", vec![64, 2]),
            hidden("layer.bias", vec![64]),
        ];
        let layout = Layout { weights, constants: Vec::new() };
        let factors = layout.draw_dropout(0.5, &mut rng::stream(1, "dropout", 0)).unwrap();
        assert_eq!(factors.len(), layout.weight_count());
        assert_eq!(factors[..3], [1.0; 3]);
        let (rows, biases) = factors[3..].split_at(128);
        assert!(rows.chunks(2).zip(biases).all(|(row, bias)| row == [*bias; 2]));
        assert!(biases.contains(&0.0) && biases.contains(&2.0) && biases.iter().all(|f| [0.0, 2.0].contains(f)));
        assert!(Layout::default().draw_dropout(0.5, &mut rng::stream(1, "dropout", 0)).is_none());
    }
}
