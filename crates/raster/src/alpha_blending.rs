//! `AlphaBlending`: the rasterizer of the paper, eq. (7) and (8).

use crate::blend::{ALPHA_MIN, Backward, Forward, GEOMETRY, PIXELS, Tile};
use crate::simd::widest;
use crate::tiles::{TILE, TileLists};
use pwrfgs_core::{ImagePlane, Cache, Rasterizer, Real, Render, RenderVjp, Splats, cached};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Front-to-back alpha blending in order of depth, tile by tile, with an exact backward pass.
///
/// | field | meaning | default |
/// |---|---|---|
/// | `support` | which pixels a Gaussian can reach | `Exact` |
///
/// `Exact`: those where its γ is at least 1/255; tiles are bookkeeping that no picture shows. `TileSquares`: those of
/// the 16 × 16 tiles that meet the square of three standard deviations, as released; the picture then shows tile edges,
/// and azimuth does not come round. It exists to compare with published code.
///
/// *Differentiable* in means, conics, opacities and signals. *Discontinuous* where γ crosses 1/255, where a pixel fills
/// up (T < 10⁻⁴) and where two Gaussians swap depth; the 0.99 ceiling of γ passes the gradient, as in 3DGS.
///
/// ```
/// use pwrfgs_core::{Plugin, Rasterizer};
/// # use pwrfgs_raster as _;
/// Plugin::<dyn Rasterizer>::parse("AlphaBlending(support: Exact)").unwrap();
/// ```
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlphaBlending {
    /// Which pixels a Gaussian can reach.
    pub support: Support,
}

/// Which pixels a Gaussian can reach.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Support {
    /// Those where γ ≥ 1/255.
    #[default]
    Exact,
    /// Those of whole tiles around the square of radius 3σ, as released.
    TileSquares,
}

#[typetag::serde]
impl Rasterizer for AlphaBlending {
    fn forward(&self, splats: &Splats, signals: &[Real], channels: usize, plane: &ImagePlane) -> Render {
        self.forward_prepared(splats, signals, channels, plane, &self.prepare(splats, plane))
    }

    fn prepare(&self, splats: &Splats, plane: &ImagePlane) -> Cache {
        Some(Arc::new(TileLists::build(splats, plane, self.support)))
    }

    fn forward_prepared(
        &self,
        splats: &Splats,
        signals: &[Real],
        channels: usize,
        plane: &ImagePlane,
        prepared: &Cache,
    ) -> Render {
        assert_eq!(signals.len(), splats.len() * channels, "one signal a splat and channel");
        let lists: &TileLists = cached(prepared);
        let size = plane.width * plane.height;
        let (mut pixels, mut transmittance) = (vec![0.0; size * channels], vec![1.0; size]);
        let pictures = (Canvas::new(&mut pixels, plane), Canvas::new(&mut transmittance, plane));
        (0..lists.len()).into_par_iter().for_each_init(
            || vec![0.0; channels * PIXELS],
            |scratch, t| {
                let tile = tile(lists, t, splats, signals, channels, plane);
                if tile.list.is_empty() {
                    return; // zeros and ones already
                }
                let light = widest(Forward { tile: &tile, out: scratch });
                pictures.0.put(tile.corner, scratch);
                pictures.1.put(tile.corner, light.left().as_flattened());
            },
        );
        Render { pixels, transmittance, cache: prepared.clone() }
    }

    fn backward(
        &self,
        splats: &Splats,
        signals: &[Real],
        channels: usize,
        plane: &ImagePlane,
        render: &Render,
        d_pixels: &[Real],
    ) -> RenderVjp {
        assert_eq!(d_pixels.len(), render.pixels.len(), "one cotangent a pixel and channel");
        let lists: &TileLists = cached(&render.cache);
        let stride = GEOMETRY + channels;
        let mut parts = vec![0.0; lists.splats.len() * stride];
        let mut rest = parts.as_mut_slice();
        let mut slices = Vec::with_capacity(lists.len());
        for t in 0..lists.len() {
            let (own, tail) = rest.split_at_mut(lists.of(t).0.len() * stride);
            slices.push(own);
            rest = tail;
        }
        slices.into_par_iter().enumerate().for_each_init(
            || (vec![0.0; channels * PIXELS], vec![0.0; channels * PIXELS], vec![[0.0; TILE]; channels]),
            |(pixels, d, d_signal), (t, out)| {
                let tile = tile(lists, t, splats, signals, channels, plane);
                if tile.list.is_empty() {
                    return;
                }
                gather(&render.pixels, plane, tile.corner, pixels);
                gather(d_pixels, plane, tile.corner, d);
                widest(Backward { tile: &tile, pixels, d_pixels: d, d_signal, out });
            },
        );
        sum_over_tiles(lists, splats.len(), channels, &parts)
    }

    fn faintest(&self) -> Real {
        ALPHA_MIN
    }

    fn check_plane(&self, plane: &ImagePlane) -> Result<(), String> {
        if self.support == Support::TileSquares && plane.wraps {
            return Err("support: TileSquares cannot draw across the seam; use support: Exact, or WrfgsCompat()".into());
        }
        Ok(())
    }

    fn about(&self) -> &'static str {
        "front-to-back alpha blending in depth order, as in the paper; exact backward"
    }
}

fn tile<'a>(
    lists: &'a TileLists,
    t: usize,
    splats: &'a Splats,
    signals: &'a [Real],
    channels: usize,
    plane: &'a ImagePlane,
) -> Tile<'a> {
    let (list, rows) = lists.of(t);
    Tile { splats, signals, channels, plane, list, rows, corner: lists.corner(t) }
}

/// Copies a tile out of pictures `[channels, H, W]`; pixels beyond the edge are 0.
fn gather(pictures: &[Real], plane: &ImagePlane, (x, y): (usize, usize), out: &mut [Real]) {
    let columns = (plane.width - x).min(TILE);
    let rows = (plane.height - y).min(TILE);
    out.fill(0.0);
    for (picture, out) in pictures.chunks_exact(plane.width * plane.height).zip(out.chunks_exact_mut(PIXELS)) {
        for row in 0..rows {
            let from = (y + row) * plane.width + x;
            copy_row(&mut out[row * TILE..], &picture[from..], columns);
        }
    }
}

/// Copies the pixels of a tile in one row; where it is whole, in registers: calls of `memcpy` for 64 bytes were a tenth of
/// a training step.
fn copy_row(to: &mut [Real], from: &[Real], columns: usize) {
    match (to.first_chunk_mut::<TILE>(), from.first_chunk::<TILE>()) {
        (Some(to), Some(from)) if columns == TILE => *to = *from,
        _ => to[..columns].copy_from_slice(&from[..columns]),
    }
}

/// Adds up each splat's cotangents over the tiles it meets, in tile order, whatever thread made them.
fn sum_over_tiles(lists: &TileLists, n: usize, channels: usize, parts: &[Real]) -> RenderVjp {
    let stride = GEOMETRY + channels;
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
    let mut signals = vec![0.0; n * channels];
    let mut weights = vec![0.0; n];
    let rows = (d.means2d.par_iter_mut())
        .zip(d.conics.par_iter_mut())
        .zip(d.opacities.par_iter_mut())
        .zip(signals.par_chunks_exact_mut(channels))
        .zip(weights.par_iter_mut());
    rows.enumerate().with_min_len(256).for_each(|(i, ((((mean, conic), opacity), signal), weight))| {
        for &slot in &slots[first[i]..first[i + 1]] {
            let part = &parts[slot as usize * stride..][..stride];
            mean.iter_mut().zip(&part[..2]).for_each(|(sum, d)| *sum += d);
            conic.iter_mut().zip(&part[2..5]).for_each(|(sum, d)| *sum += d);
            *opacity += part[5];
            *weight += part[6];
            signal.iter_mut().zip(&part[GEOMETRY..]).for_each(|(sum, d)| *sum += d);
        }
    });
    RenderVjp { splats: d, signals, weights }
}

/// Pictures `[channels, H, W]` that tiles write side by side.
struct Canvas {
    start: *mut Real,
    len: usize,
    width: usize,
    height: usize,
}

// SAFETY: a canvas is only written through `put`, and each tile is put once, by one thread; tiles do not overlap.
#[allow(unsafe_code)]
unsafe impl Sync for Canvas {}

impl Canvas {
    fn new(pixels: &mut [Real], plane: &ImagePlane) -> Self {
        Self { start: pixels.as_mut_ptr(), len: pixels.len(), width: plane.width, height: plane.height }
    }

    /// Copies `[channels][PIXELS]` of the tile at `corner` into the pictures.
    #[allow(unsafe_code)]
    fn put(&self, (x, y): (usize, usize), tile: &[Real]) {
        let columns = (self.width - x).min(TILE);
        let rows = (self.height - y).min(TILE);
        for (c, tile) in tile.chunks_exact(PIXELS).enumerate() {
            for row in 0..rows {
                let at = (c * self.height + y + row) * self.width + x;
                assert!(at + columns <= self.len, "a tile lies inside the picture");
                // SAFETY: the range is inside the allocation (asserted) and belongs to this tile alone; the vector
                // behind it outlives the canvas, which does not leave `forward`.
                let to = unsafe { std::slice::from_raw_parts_mut(self.start.add(at), columns) };
                copy_row(to, &tile[row * TILE..], columns);
            }
        }
    }
}
