//! `WaveMixture`: coefficients of the waves per transmitter, and the signals of Gaussians that follow from them.

use crate::dense;
use pwrfgs_core::{Lanes, Real};

/// Number of Gaussians that a kernel processes together.
pub(super) const LANES: usize = 64;

/// Encoded centres φ(μ), scaled (see `FactoredLayers::wave_scale`), in tiles of [`LANES`] Gaussians, `[tiles, waves]` rows
/// of lanes. Unused lanes of the last tile are 0.
pub(super) struct Basis {
    pub(super) lanes: Vec<[Real; LANES]>,
    pub(super) n: usize,
}

/// Coefficients of the waves per transmitter: per channel `[waves, B]`, and the constant terms `[B]`.
pub(super) struct WaveMixture {
    pub(super) waves: [Vec<Real>; 2],
    pub(super) base: [Vec<Real>; 2],
}

impl WaveMixture {
    /// Creates zeros for `batch` transmitters.
    pub(super) fn zeros(waves: usize, batch: usize) -> Self {
        Self { waves: [(); 2].map(|()| vec![0.0; waves * batch]), base: [(); 2].map(|()| vec![0.0; batch]) }
    }

    /// Joins the coefficients of single transmitters: `[waves, 1]` each, into `[waves, B]`.
    pub(super) fn join(each: &[Self]) -> Self {
        let waves = each.first().map_or(0, |mixed| mixed.waves[0].len());
        Self {
            waves: [0, 1].map(|c| (0..waves).flat_map(|k| each.iter().map(move |mixed| mixed.waves[c][k])).collect()),
            base: [0, 1].map(|c| each.iter().map(|mixed| mixed.base[c][0]).collect()),
        }
    }

    /// Adds the coefficients of `other`.
    pub(super) fn add_mixture(&mut self, other: &Self) {
        for c in 0..2 {
            dense::add_assign(&mut self.waves[c], &other.waves[c]);
            dense::add_assign(&mut self.base[c], &other.base[c]);
        }
    }
}

/// Signals of one transmitter for the Gaussians of some tiles: s = v·φ + v₀, each summed in the order of the waves.
pub(super) struct SignalKernel<'a> {
    pub(super) tiles: &'a [[Real; LANES]],
    pub(super) waves: usize,
    pub(super) mixed: &'a WaveMixture,
    pub(super) signals: &'a mut [[Real; 2]],
}

impl pulp::WithSimd for SignalKernel<'_> {
    type Output = ();
    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) {
        let Self { tiles, waves, mixed: WaveMixture { waves: [re, im], base }, signals } = self;
        for (tile, signals) in tiles.chunks_exact(waves).zip(signals.chunks_mut(LANES)) {
            let mut sums = [[0.0; LANES]; 2];
            Real::two_sums(simd, &mut sums, [re, im], tile);
            for (lane, signal) in signals.iter_mut().enumerate() {
                *signal = [base[0][0] + sums[0][lane], base[1][0] + sums[1][lane]];
            }
        }
    }
}
