//! `Layout`: the weights of a network as they lie in one flat vector.

use crate::{Real, rng, rng::Rng};

/// The tensors of a network: those that are learned, in the order in which they lie in the flat weight vector, and those
/// that are not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layout {
    /// Learned tensors.
    pub weights: Vec<WeightSpec>,
    /// Tensors that follow from a seed in the settings and are never learned, with their numbers. The model file holds
    /// them, because its other readers cannot draw them again.
    pub constants: Vec<(WeightSpec, Vec<Real>)>,
}

impl Layout {
    /// Numbers in the flat weight vector.
    pub fn numbers(&self) -> usize {
        self.weights.iter().map(WeightSpec::len).sum()
    }

    /// Fresh weights.
    pub fn init(&self, rng: &mut Rng) -> Vec<Real> {
        let mut flat = Vec::with_capacity(self.numbers());
        for spec in &self.weights {
            match spec.bound {
                Some(bound) => flat.extend((0..spec.len()).map(|_| (2.0 * rng::uniform(rng) - 1.0) * bound as Real)),
                None => flat.resize(flat.len() + spec.len(), 0.0),
            }
        }
        flat
    }

    /// Factors on the flat weight vector that silence a share `rate` of the hidden units and multiply the others by
    /// 1/(1 − rate): dropout, with one draw for all transmitters of a step. `None` if no layer is
    /// [hidden](WeightSpec::hidden).
    pub fn dropout(&self, rate: Real, rng: &mut Rng) -> Option<Vec<Real>> {
        self.weights.iter().any(|spec| spec.hidden).then(|| {
            let (mut factors, mut units) = (Vec::with_capacity(self.numbers()), Vec::new());
            for spec in &self.weights {
                if !spec.hidden {
                    factors.resize(factors.len() + spec.len(), 1.0);
                    continue;
                }
                if spec.shape.len() > 1 {
                    let kept = |_| if rng::uniform(rng) < rate { 0.0 } else { 1.0 / (1.0 - rate) };
                    units = (0..spec.shape[0]).map(kept).collect();
                }
                let of_unit = spec.len() / units.len().max(1);
                factors.extend(units.iter().flat_map(|factor| std::iter::repeat_n(*factor, of_unit)));
            }
            factors
        })
    }
}

/// Name, shape and initial values of a tensor.
#[derive(Clone, Debug, PartialEq)]
pub struct WeightSpec {
    /// Such as `trunk.0.weight`.
    pub name: String,
    /// Shape, row-major; a linear layer's weight is `[out, in]`.
    pub shape: Vec<usize>,
    /// Initial values are uniform within ± this; `None`: zeros.
    pub bound: Option<f64>,
    /// Whether its rows are hidden units behind a ReLU, which [`Layout::dropout`] may silence. The bias of such a layer comes
    /// right after its weight.
    pub hidden: bool,
}

impl WeightSpec {
    /// A tensor that begins with zeros.
    pub fn zeros(name: impl Into<String>, shape: Vec<usize>) -> Self {
        Self { name: name.into(), shape, bound: None, hidden: false }
    }

    /// A tensor with initial values uniform within ±`bound`.
    pub fn uniform(name: impl Into<String>, shape: Vec<usize>, bound: f64) -> Self {
        Self { bound: Some(bound), ..Self::zeros(name, shape) }
    }

    /// Numbers in it.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Whether it holds no number.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropout_silences_whole_units_and_nothing_else() {
        let hidden = |name: &str, shape| WeightSpec { hidden: true, ..WeightSpec::uniform(name, shape, 1.0) };
        let weights = vec![
            WeightSpec::zeros("other", vec![3]),
            hidden("layer.weight", vec![64, 2]),
            hidden("layer.bias", vec![64]),
        ];
        let layout = Layout { weights, constants: Vec::new() };
        let factors = layout.dropout(0.5, &mut rng::stream(1, "dropout", 0)).unwrap();
        assert_eq!(factors.len(), layout.numbers());
        assert_eq!(factors[..3], [1.0; 3]);
        let (rows, biases) = factors[3..].split_at(128);
        assert!(rows.chunks(2).zip(biases).all(|(row, bias)| row == [*bias; 2]));
        assert!(biases.contains(&0.0) && biases.contains(&2.0) && biases.iter().all(|f| [0.0, 2.0].contains(f)));
        assert!(Layout::default().dropout(0.5, &mut rng::stream(1, "dropout", 0)).is_none());
    }
}
