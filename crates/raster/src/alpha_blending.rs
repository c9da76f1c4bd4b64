//! `AlphaBlending`: the rasterizer of the paper, eqs. (7) and (8).

use crate::blend::{
    ALPHA_MIN, Backward, CONIC, EXISTENCE, Forward, GEOMETRY, MEAN, OPACITY, PIXELS, TILE, Tile, WEIGHT,
};
use crate::canvas::{gather_tile, patches};
use crate::survey::SurveyTile;
use crate::tiles::{Support, TileLists};
use pwrfgs_core::{
    Cache, ImagePlane, JsonSchema, Misfit, Rasterizer, Real, Render, RenderVjp, SignalSplats, SplatStats, Splats,
    SurveyInputs, cached, widest,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Front-to-back alpha blending in depth order, tile by tile, with an exact backward pass.
///
/// `Exact` draws a Gaussian in all pixels where its γ is at least 1/255; tiles do not affect the spectra. `TileSquares`
/// draws it in all 16 × 16 tiles that intersect the square of three standard deviations, as in the released code. The
/// spectra then show tile edges, and azimuth does not wrap around. Use `TileSquares` only to compare with published
/// code.
///
/// *Differentiable* in means, conics, opacities and signals. *Discontinuous* if γ crosses 1/255, if a pixel becomes
/// opaque (T < 10⁻⁴) and if two Gaussians swap depth. The upper limit 0.99 of γ passes the gradient, as in 3DGS.
///
/// ```
/// use pwrfgs_core::{Plugin, Rasterizer};
/// # use pwrfgs_raster as _;
/// Plugin::<dyn Rasterizer>::parse("AlphaBlending(support: Exact)").unwrap();
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct AlphaBlending {
    /// Pixels that a Gaussian covers.
    pub support: Support,
}

#[typetag::serde]
impl Rasterizer for AlphaBlending {
    fn forward(&self, splats: SignalSplats<'_>) -> Render {
        self.forward_prepared(splats, &self.prepare(splats.geometry, splats.plane))
    }

    fn prepare(&self, splats: &Splats, plane: &ImagePlane) -> Cache {
        Some(Arc::new(TileLists::build(splats, plane, self.support)))
    }

    fn forward_prepared(&self, splats: SignalSplats<'_>, prepared: &Cache) -> Render {
        let SignalSplats { signals, channels, plane, .. } = splats;
        assert_eq!(signals.len(), splats.geometry.len() * channels, "one signal per splat and channel");
        let lists: &TileLists = cached(prepared);
        let size = plane.width * plane.height;
        let (mut pixels, mut transmittance) = (vec![0.0; size * channels], vec![1.0; size]);
        let tiles = patches(&mut pixels, plane).into_par_iter().zip(patches(&mut transmittance, plane));
        tiles.enumerate().for_each_init(
            || vec![0.0; channels * PIXELS],
            |scratch, (t, (mut signal, mut transmittance))| {
                let tile = tile_at(lists, t, splats);
                if tile.list.is_empty() {
                    return; // zeros and ones already
                }
                let remaining = widest(Forward { tile: &tile, out: scratch });
                signal.write_tile(scratch);
                transmittance.write_tile(remaining.remaining().as_flattened());
            },
        );
        Render { pixels, transmittance, cache: prepared.clone() }
    }

    fn backward(&self, splats: SignalSplats<'_>, render: &Render, d_pixels: &[Real]) -> RenderVjp {
        let SignalSplats { geometry, channels, plane, .. } = splats;
        assert_eq!(d_pixels.len(), render.pixels.len(), "one cotangent per pixel and channel");
        let lists: &TileLists = cached(&render.cache);
        let stride = GEOMETRY + channels;
        let mut parts = vec![0.0; lists.splats.len() * stride];
        // Each tile writes its own slice of `parts`.
        let mut remaining = parts.as_mut_slice();
        let mut slices = Vec::with_capacity(lists.tile_count());
        for t in 0..lists.tile_count() {
            let (slice, tail) = remaining.split_at_mut(lists.tile_splats(t).0.len() * stride);
            slices.push(slice);
            remaining = tail;
        }
        slices.into_par_iter().enumerate().for_each_init(
            || (vec![0.0; channels * PIXELS], vec![0.0; channels * PIXELS], vec![[0.0; TILE]; channels]),
            |(pixels, d, d_signal), (t, out)| {
                let tile = tile_at(lists, t, splats);
                if tile.list.is_empty() {
                    return;
                }
                gather_tile(&render.pixels, plane, tile.corner, pixels);
                gather_tile(d_pixels, plane, tile.corner, d);
                widest(Backward { tile: &tile, pixels, d_pixels: d, d_signal, out });
            },
        );
        let mut vjp = sum_over_tiles(lists, geometry.len(), channels, &parts);
        vjp.splats.existence.truncate(geometry.existence.len());
        vjp
    }

    fn blends(&self) -> bool {
        true
    }

    fn survey(
        &self,
        splats: &Splats,
        plane: &ImagePlane,
        render: &Render,
        survey: &SurveyInputs<'_>,
    ) -> Vec<SplatStats> {
        let lists: &TileLists = cached(&render.cache);
        let channels = render.pixels.len() / (plane.width * plane.height);
        let survey_tile = |t: usize| {
            let tile = tile_at(lists, t, splats.with_signals(&[], channels, plane));
            widest(SurveyTile { tile: &tile, drawn: &render.pixels, survey })
        };
        let tiles: Vec<Vec<SplatStats>> = (0..lists.tile_count()).into_par_iter().map(survey_tile).collect();
        // Sums in tile order do not depend on the assignment of tiles to threads.
        let mut sums = vec![SplatStats::default(); splats.len()];
        for (t, stats) in tiles.iter().enumerate() {
            lists.tile_splats(t).0.iter().zip(stats).for_each(|(&i, stats)| sums[i as usize].add(stats));
        }
        sums
    }

    fn min_drawn_opacity(&self) -> Real {
        ALPHA_MIN
    }

    fn check_plane(&self, plane: &ImagePlane) -> Result<(), Misfit> {
        match self.support {
            Support::TileSquares if plane.wraps => Err(Misfit::TilesAtSeam),
            Support::TileSquares if plane.sampling.stride > 1 => Err(Misfit::TilesOfStride),
            _ => Ok(()),
        }
    }
}

/// Returns tile `t` of the image with the splats that may cover it.
fn tile_at<'a>(lists: &'a TileLists, t: usize, splats: SignalSplats<'a>) -> Tile<'a> {
    let (list, rows) = lists.tile_splats(t);
    let SignalSplats { geometry, signals, channels, plane } = splats;
    Tile { splats: geometry, signals, channels, plane, list, rows, corner: lists.corner(t) }
}

/// Sums the cotangents `parts`, one row of [`GEOMETRY`] and `channels` numbers per entry of `lists.splats`, of each of `n`
/// splats over its tiles, in tile order, independent of the threads.
fn sum_over_tiles(lists: &TileLists, n: usize, channels: usize, parts: &[Real]) -> RenderVjp {
    let stride = GEOMETRY + channels;
    // Lists the rows of splat i in `slots[first[i]..first[i + 1]]`, by a counting sort.
    let mut first = vec![0usize; n + 1];
    for &i in &lists.splats {
        first[i as usize + 1] += 1;
    }
    for i in 0..n {
        first[i + 1] += first[i];
    }
    let mut next = first.clone();
    let mut slots = vec![0u32; lists.splats.len()];
    for (slot, &i) in lists.splats.iter().enumerate() {
        slots[next[i as usize]] = slot as u32;
        next[i as usize] += 1;
    }
    let mut d = Splats::zeros(n);
    d.existence = vec![0.0; n];
    let mut signals = vec![0.0; n * channels];
    let mut weights = vec![0.0; n];
    let rows = (d.means2d.par_iter_mut())
        .zip(d.conics.par_iter_mut())
        .zip(d.opacities.par_iter_mut().zip(d.existence.par_iter_mut()))
        .zip(signals.par_chunks_exact_mut(channels))
        .zip(weights.par_iter_mut());
    rows.enumerate().with_min_len(256).for_each(|(i, ((((mean, conic), (opacity, existence)), signal), weight))| {
        for &slot in &slots[first[i]..first[i + 1]] {
            let part = &parts[slot as usize * stride..][..stride];
            mean.iter_mut().zip(&part[MEAN..CONIC]).for_each(|(sum, d)| *sum += d);
            conic.iter_mut().zip(&part[CONIC..OPACITY]).for_each(|(sum, d)| *sum += d);
            *opacity += part[OPACITY];
            *weight += part[WEIGHT];
            *existence += part[EXISTENCE];
            signal.iter_mut().zip(&part[GEOMETRY..]).for_each(|(sum, d)| *sum += d);
        }
    });
    RenderVjp { splats: d, signals, weights }
}
