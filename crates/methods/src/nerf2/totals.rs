//! Sums over rays, added up per link, and the observations that they give.

use crate::nerf2::group::{GroupLinks, Passes, RayGroup};
use pwrfgs_core::{Call, MeasurementSetup, Real};
use std::ops::Range;

/// Scale of received powers as released, dB: |R| from 0 to 1 is −100 to 0 dBm.
const POWER_SCALE: Real = 100.0;

/// Converts sums R over rays `[L, pixels or bands]` to observations: pixels |R|, powers 100 |R| − 100 dBm, or channels R.
pub(crate) fn observations(setup: &MeasurementSetup, totals: &[[Real; 2]]) -> Vec<Real> {
    if setup.task.is_complex {
        return pwrfgs_core::rows_of(totals, band_count(setup));
    }
    let size = totals.iter().map(|[re, im]| re.hypot(*im));
    if setup.task.is_scalar { size.map(|size| POWER_SCALE * size - POWER_SCALE).collect() } else { size.collect() }
}

/// Returns the cotangents of the sums, given those `d` of the observations; 0 for |R| at R = 0.
pub(crate) fn observations_vjp(setup: &MeasurementSetup, totals: &[[Real; 2]], d: &[Real]) -> Vec<[Real; 2]> {
    if setup.task.is_complex {
        return pwrfgs_core::gains_of(d, band_count(setup));
    }
    let along = |([re, im], d): (&[Real; 2], &Real)| {
        let size = re.hypot(*im);
        if size > 0.0 { [d * re / size, d * im / size] } else { [0.0; 2] }
    };
    let each = totals.iter().zip(d).map(along);
    if setup.task.is_scalar { each.map(|d| d.map(|d| POWER_SCALE * d)).collect() } else { each.collect() }
}

/// Adds up the sums of chunks (group, rays, sums), in order; returns the totals `[L, pixels or bands]`.
pub(crate) fn collect_sums(
    call: &Call<'_>,
    groups: &[RayGroup<'_>],
    chunks: impl Iterator<Item = (usize, Range<usize>, Passes)>,
) -> Vec<[Real; 2]> {
    let setup = call.setup;
    let width = if setup.task.has_pixels { call.pixels.count_per_link(setup.value_count()) } else { band_count(setup) };
    let mut totals = vec![[0.0; 2]; call.links.pairs.len() * width];
    for (group, rays, passes) in chunks {
        let bands = band_count(setup);
        for (pass, sums) in passes.into_iter().enumerate() {
            for (i, sum) in sums.into_iter().enumerate() {
                let (ray, band) = (rays.start + i / bands, i % bands);
                let total = &mut totals[total_index(setup, &groups[group].links, width, [pass, ray, band])];
                total[0] += sum[0];
                total[1] += sum[1];
            }
        }
    }
    totals
}

/// Returns the index of the total to which a ray contributes, for totals of `width` values per link.
pub(crate) fn total_index(
    setup: &MeasurementSetup,
    links: &GroupLinks,
    width: usize,
    [pass, ray, band]: [usize; 3],
) -> usize {
    let link = links.link_index(pass, ray);
    match (setup.task.has_pixels, links) {
        (true, GroupLinks::All(_)) => link * width + ray,
        (true, GroupLinks::OnePerRay(_)) => link,
        _ => link * width + band,
    }
}

/// Returns the number of complex outputs per sample.
pub(crate) fn band_count(setup: &MeasurementSetup) -> usize {
    setup.frequencies_hz.len().max(1)
}
