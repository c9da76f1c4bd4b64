//! Spectra stretched to [0, 1] from their smallest value to their largest.

use crate::Real;

/// A picture whose values differ by less than this share of the largest shows nothing but rounding.
const NO_CONTRAST: Real = 1e-6;

/// Smallest and largest value; zeros for none. NaN stays out, and shows in the picture itself.
pub fn range(values: &[Real]) -> (Real, Real) {
    let first = values.first().copied().unwrap_or(0.0);
    let (mut low, mut high) = ([first; 16], [first; 16]);
    pulp::Arch::new().dispatch(
        #[inline(always)]
        || {
            let (whole, rest) = values.as_chunks::<16>();
            let mut widen = |lane: usize, v: Real| {
                low[lane] = if v < low[lane] { v } else { low[lane] };
                high[lane] = if v > high[lane] { v } else { high[lane] };
            };
            for chunk in whole {
                for lane in 0..16 {
                    widen(lane, chunk[lane]);
                }
            }
            for (lane, v) in rest.iter().enumerate() {
                widen(lane, *v);
            }
        },
    );
    (low.into_iter().fold(first, Real::min), high.into_iter().fold(first, Real::max))
}

/// 1/(max − min), or 0 where the picture has no contrast.
pub fn gain(low: Real, high: Real) -> Real {
    if high - low > NO_CONTRAST * high { 1.0 / (high - low) } else { 0.0 }
}

/// Stretches a picture from its smallest value to its largest, as the readout `MinMax` does: one that is looked at in few
/// places has to be stretched again, because between them lie its darkest and its brightest.
pub fn stretch(image: &mut [Real]) {
    let (low, high) = range(image);
    let gain = gain(low, high);
    image.iter_mut().for_each(|v| *v = (*v - low) * gain);
}
