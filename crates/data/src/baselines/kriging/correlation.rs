//! How much the spectra at two places have in common.

/// Shape of a correlation over distance in units of the length scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// exp(-d), Matern 1/2: continuous and rough.
    Exponential,
    /// (1 + sqrt(3) d) exp(-sqrt(3) d): differentiable once.
    Matern32,
    /// exp(-d^2 / 2): smooth.
    SquaredExponential,
}

impl Kind {
    pub(super) const ALL: [Self; 3] = [Self::Exponential, Self::Matern32, Self::SquaredExponential];

    /// As a sentence says it.
    pub(super) fn words(self) -> &'static str {
        match self {
            Self::Exponential => "exponential",
            Self::Matern32 => "Matern 3/2",
            Self::SquaredExponential => "squared exponential",
        }
    }

    /// Of distance `d` in length scales.
    pub(super) fn at(self, d: f64) -> f64 {
        match self {
            Self::Exponential => (-d).exp(),
            Self::Matern32 => {
                let d = 3f64.sqrt() * d;
                (1.0 + d) * (-d).exp()
            }
            Self::SquaredExponential => (-0.5 * d * d).exp(),
        }
    }
}

/// A Gaussian process of variance 1, and the noise of each measurement of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Correlation {
    pub(super) kind: Kind,
    /// Length scales of x, y and z, metres.
    pub(super) scales_m: [f64; 3],
    /// Variance of the noise, in units of that of the process.
    pub(super) noise: f64,
}

impl Correlation {
    /// A place in units of the length scales.
    pub(super) fn scaled(&self, place: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| place[k] / self.scales_m[k])
    }
}
