//! `Gate`: what a pruner multiplies Gaussians by while training.

use crate::tape::Trace;

/// A factor `[N]` on Gaussians while training, on the step's tape.
#[allow(missing_debug_implementations)] // a tape has no use as text
pub enum Gate {
    /// On opacity and scale. A Gaussian whose factor is 0 is left out of the step: it costs nothing and has no derivative.
    /// What `factor.into()` gives.
    Whole(Trace),
    /// On the light that it takes, and on nothing else: γ = M·min(0.99, o·G). A Gaussian whose factor is 0 takes part in
    /// the derivative still, so that it can come back.
    Presence(Trace),
}

impl Gate {
    /// The factor, whatever it is on.
    pub fn factor(self) -> Trace {
        match self {
            Self::Whole(factor) | Self::Presence(factor) => factor,
        }
    }
}

impl From<Trace> for Gate {
    fn from(factor: Trace) -> Self {
        Self::Whole(factor)
    }
}
